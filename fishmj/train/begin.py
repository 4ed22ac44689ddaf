"""A training that starts from a policy's network instead of random weights: `fishmj train --begin POLICY`.

The actor is the policy's; the critic, which no policy file holds, starts fresh and first learns the returns of this same policy:
the gradients of a critic that knows nothing took a policy's return from 100 to 85. Where steps are dear, in the flow solver, it
learns them in the robot's own water. Exploration starts at SIGMA, the learning rate at SLOWER times the usual one: with those of
a training from nothing the policy leaves its optimum and does not find it again.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.control.learned import LearnedController
from fishmj.control.policy import Policy
from fishmj.tasks.station_hold import input_scale
from fishmj.train.build import config_of, environment, robot_for
from fishmj.train.ppo import PPO
from fishmj.train.settings import Settings, change
from fishmj.water.choice import LBM

SIGMA = 0.05  # initial standard deviation of u
SLOWER = 0.1  # of the learning rate; not in the flow solver, whose preset begins with a policy anyway
LESSONS = 60  # iterations in which a critic learns a policy's returns; seconds on the compiled engine
RATE = 1e-3  # learning rate of the critic then
CHEAP = {"envs": 512, "horizon": 32, "minibatches": 8}  # settings of PPO there


def begin_with(source: str, settings: Settings, asked: Mapping[str, Any]) -> tuple[Policy, Settings]:
    """Policy, and the settings with its widths, activation, memory, command path and control step.

    Args:
        source: shipped name, policy file or folder of a training.
        asked: the given ones of the options --hidden, --activation, --memory, --command-path, --control-dt, --sigma and
            --learning-rate.

    Raises:
        ConfigError: another algorithm than PPO, a policy for another structure, or one that contradicts an option.
        UnknownName, StoreError: no such policy, or a damaged one.
    """
    if settings.algo != "ppo":
        raise ConfigError(f"--begin: {settings.algo} learns from nothing; --algo ppo begins with a policy")
    policy = Policy.load(source)
    hidden, path = tuple(len(b) for _, b in policy.weights[:-1]), policy.meta.get("command_path") or settings.command_path
    step = policy.meta.get("control_dt") or settings.control_dt
    network = {"--hidden": hidden, "--activation": policy.meta["activation"], "--memory": policy.memory, "--command-path": path}
    for option, theirs in (network | {"--control-dt": step}).items():
        if asked.get(option, theirs) != theirs:
            raise ConfigError(f"--begin {source}: {option} {asked[option]}, the policy has {theirs}; leave {option} out")
    network = {"hidden": hidden, "activation": policy.meta["activation"], "sigma": asked.get("--sigma", SIGMA)}
    if settings.engine != LBM and "--learning-rate" not in asked:
        network["learning_rate"] = SLOWER * config_of(settings).learning_rate
    made = change(settings, command_path=path, control_dt=step, task={"memory": policy.memory}, algorithm=network)
    robot = robot_for(made)
    LearnedController(robot, source)  # refuses one for another structure
    if not np.allclose(policy.meta["scale"], input_scale(robot.n_joints)):
        raise ConfigError(f"--begin {source}: it divides its observations by other numbers than trainings of this version do")
    return policy, made


def begun(training, policy: Policy, settings: Settings, env):
    """Fresh train state whose actor is the policy's and whose critic knows the policy's returns. env: of the training."""
    layers = [(jnp.asarray(w.T, jnp.float32), jnp.asarray(b, jnp.float32)) for w, b in policy.weights]
    shapes = lambda actor: [(w.shape, b.shape) for w, b in actor]
    if shapes(layers) != shapes(training.actor):
        raise ConfigError(f"--begin: the policy's layers are {shapes(layers)}, this training's {shapes(training.actor)}")
    training = training._replace(actor=layers)
    return training._replace(critic=taught(training, settings, env))


def taught(training, settings: Settings, env):
    """Critic that has learnt the returns of the actor, which stands still; for the flow solver, in the robot's own water."""
    if settings.engine == LBM:
        settings = change(settings, engine="auto", water="auto", algorithm=CHEAP)
        env = environment(settings)
    config = replace(config_of(settings), learning_rate=RATE)
    learner = PPO(env, config, LESSONS * config.envs * config.horizon, moves=False)
    state = learner.init(jax.random.key(settings.seed))
    state = state._replace(actor=jax.tree.map(jnp.array, training.actor), log_sigma=jnp.array(training.log_sigma))
    with console.Progress(LESSONS, "teach the critic", "iterations") as bar:
        for done in range(LESSONS):
            state, figures = learner.iterate(state)
            bar.update(done, loss=float(figures["loss"]))
    return state.critic
