"""A training that starts from a policy's network instead of random weights: `fishmj train --begin POLICY`.

The actor is the policy's. A policy file holds no critic, so the critic starts fresh and first learns the returns of this policy:
with an untrained critic, the first updates lowered a policy's return from 100 to 85. For the flow solver, where steps are costly,
the critic learns in the robot's fitted water. Exploration starts at SIGMA, and the learning rate at SLOWER times the usual one:
with the usual values the policy leaves its optimum and does not find it again.
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

SIGMA = 0.05  # initial standard deviation of u, the action before tanh
SLOWER = 0.1  # factor on the learning rate; not in the flow solver, whose preset is made for --begin
LESSONS = 60  # iterations that pretrain the critic; seconds on the compiled engine
RATE = 1e-3  # learning rate of that pretraining
CHEAP = {"envs": 512, "horizon": 32, "minibatches": 8}  # its PPO settings for a run in the flow solver


def begin_with(source: str, settings: Settings, asked: Mapping[str, Any]) -> tuple[Policy, Settings]:
    """Returns the policy, and the settings with its widths, activation, memory, command path and control step.

    Args:
        source: shipped name, policy file or folder of a training.
        asked: those that the user gave of --hidden, --activation, --memory, --command-path, --control-dt, --sigma and
            --learning-rate.

    Raises:
        ConfigError: not PPO, a policy for another structure, or one that contradicts an option.
        UnknownName, StoreError: no such policy, or a damaged one.
    """
    if settings.algo != "ppo":
        raise ConfigError(f"--begin: {settings.algo} cannot start from a policy; take --algo ppo, or leave --begin out")
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
        raise ConfigError(
            f"--begin {source}: its observations are scaled by other divisors than in this version; train without it"
        )
    return policy, made


def start_from_policy(training, policy: Policy, settings: Settings, env):
    """Fresh train state with the policy's actor and a critic pretrained on its returns. env: environment of the training."""
    layers = [(jnp.asarray(w.T, jnp.float32), jnp.asarray(b, jnp.float32)) for w, b in policy.weights]
    shapes = lambda actor: [(w.shape, b.shape) for w, b in actor]
    if shapes(layers) != shapes(training.actor):
        raise ConfigError(f"--begin: the policy's layers are {shapes(layers)}, this training's {shapes(training.actor)}")
    training = training._replace(actor=layers)
    return training._replace(critic=taught(training, settings, env))


def taught(training, settings: Settings, env):
    """Critic pretrained on the returns of the frozen actor; for the flow solver, in the robot's fitted water."""
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
