"""A training that starts from a policy's network instead of random weights: `fishmj train --begin POLICY`.

The actor is the policy's; the critic, which no policy file holds, starts fresh. Exploration starts at SIGMA: the usual deviation
of u would push a fish that can swim off its course before the critic has learnt the cost of that. For a training in the flow
solver, where steps are dear, the critic learns before: the returns of this same policy in the robot's own water.
"""

from collections.abc import Mapping
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

SIGMA = 0.2  # initial standard deviation of u
LESSONS = 1_000_000  # control steps in which a critic learns a policy's returns; seconds on the compiled engine
CHEAP = {"envs": 512, "horizon": 32, "minibatches": 8, "learning_rate": 1e-3}  # settings of PPO there


def begin_with(source: str, settings: Settings, asked: Mapping[str, Any]) -> tuple[Policy, Settings]:
    """Policy, and the settings with its widths, activation, memory, command path and control step.

    Args:
        source: shipped name, policy file or folder of a training.
        asked: the given ones of the options --hidden, --activation, --memory, --command-path, --control-dt and --sigma.

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
    made = change(settings, command_path=path, control_dt=step, task={"memory": policy.memory}, algorithm=network)
    robot = robot_for(made)
    LearnedController(robot, source)  # refuses one for another structure
    if not np.allclose(policy.meta["scale"], input_scale(robot.n_joints)):
        raise ConfigError(f"--begin {source}: it divides its observations by other numbers than trainings of this version do")
    return policy, made


def begun(training, policy: Policy, settings: Settings):
    """Fresh train state whose actor is the policy's; in the flow solver its critic knows the policy's returns elsewhere."""
    layers = [(jnp.asarray(w.T, jnp.float32), jnp.asarray(b, jnp.float32)) for w, b in policy.weights]
    shapes = lambda actor: [(w.shape, b.shape) for w, b in actor]
    if shapes(layers) != shapes(training.actor):
        raise ConfigError(f"--begin: the policy's layers are {shapes(layers)}, this training's {shapes(training.actor)}")
    training = training._replace(actor=layers)
    return training._replace(critic=taught(training, settings)) if settings.engine == LBM else training


def taught(training, settings: Settings):
    """Critic that has learnt the returns of the actor in the robot's own water, where the actor stands still."""
    near = change(settings, engine="auto", water="auto", algorithm=CHEAP)
    learner = PPO(environment(near), config_of(near), LESSONS, moves=False)
    state = learner.init(jax.random.key(settings.seed))
    state = state._replace(actor=jax.tree.map(jnp.array, training.actor), log_sigma=jnp.array(training.log_sigma))
    with console.Progress(LESSONS, "teach the critic", "steps") as bar:
        for done in range(0, LESSONS, learner.steps_per_iteration):
            state, figures = learner.iterate(state)
            bar.update(done, reward=float(figures["reward"]))
    return state.critic
