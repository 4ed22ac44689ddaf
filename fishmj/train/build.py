"""From settings to the pieces of a run: robot, engine, environment, algorithm, and the policy that comes out."""

from dataclasses import fields, replace
from importlib import import_module
from typing import Any

import numpy as np

from fishmj import plugins
from fishmj.engines import in_water, with_effects
from fishmj.errors import ConfigError, UnknownName
from fishmj.mjcf.description import COMMAND_PATHS, load_robot
from fishmj.mjcf.identity import observation_of, structure_of
from fishmj.policy import Policy
from fishmj.tasks.station_hold import visible
from fishmj.train.learner import Learner, PolicyLayers
from fishmj.train.networks import scale
from fishmj.train.settings import ALGORITHMS, Settings


def pick_engine(name: str) -> str:
    """`auto`: MJX on a GPU, else the compiled evaluator, else the closed form in JAX."""
    if name != "auto":
        return name
    import jax

    if jax.default_backend() != "cpu":
        return "mjx"
    try:
        import numba  # noqa: F401
    except ImportError:
        return "planar"
    return "compiled"


def robot_for(settings: Settings):
    """The robot in the run's water, with its command path and the effects that it draws. Raises UnknownName, ConfigError."""
    if settings.command_path not in COMMAND_PATHS:
        raise UnknownName("command path", settings.command_path, COMMAND_PATHS)
    robot = with_effects(in_water(load_robot(settings.robot), settings.water), settings.task.get("effects", ()))
    return replace(robot, timing=replace(robot.timing, command_path=settings.command_path))


def environment(settings: Settings, box: str = "train"):
    """The training environment, or with box="tune" the one that picks the best policy."""
    from fishmj.engines import make
    from fishmj.tasks.env import Options, StationHold

    robot, name = robot_for(settings), pick_engine(settings.engine)
    engine = make(name, robot)
    if not engine.jittable:
        raise ConfigError(
            f"engine {name} cannot be compiled into a learner; train on compiled, planar or mjx, or with --algo sb3-sac"
        )
    return StationHold(robot, engine, from_table("task option", Options, {**settings.task, "box": box}), **settings.reward)


def algorithm(settings: Settings, env) -> Learner:
    """The learner named by settings.algo. Raises ConfigError, UnknownName, OwnCodeError."""
    config = config_of(settings)
    if settings.algo in ALGORITHMS:
        return referred(ALGORITHMS[settings.algo].learner)(env, config, settings.steps)
    from fishmj.train.own_algorithm import OwnAlgorithm

    return OwnAlgorithm(settings.algo, env, config, settings.steps, settings)


def config_of(settings: Settings) -> Any:
    """The algorithm's hyperparameters. Raises UnknownName for an algorithm or a key that is not there, ConfigError."""
    if settings.algo in ALGORITHMS:
        kind = referred(ALGORITHMS[settings.algo].config)
    elif settings.algo in plugins.loaded("algorithm"):  # of the user's own: only what this process has loaded
        from fishmj.train import own_algorithm

        kind = own_algorithm.config_of(settings.algo)
    else:
        raise UnknownName("algorithm", settings.algo, ALGORITHMS)
    return from_table(f"setting of {settings.algo}", kind, settings.algorithm)


def referred(text: str) -> Any:
    """What `module:Name` of the register names."""
    module, _, name = text.partition(":")
    return getattr(import_module(module), name)


def from_table(what: str, kind, table: dict):
    """A frozen dataclass from a table. Raises UnknownName for a key that it does not have."""
    known = [f.name for f in fields(kind)]
    for key in table:
        if key not in known:
            raise UnknownName(what, key, known)
    return kind(**table)


def policy_of(network: PolicyLayers, settings: Settings, meta: dict) -> Policy:
    """The NumPy policy for what `Learner.policy_layers` gives of a trained actor."""
    robot = robot_for(settings)
    joints, memory = robot.n_joints, settings.task.get("memory", 1)
    layers = [(np.asarray(w, np.float32).T, np.asarray(b, np.float32)) for w, b in network.layers]
    seen = visible(joints, settings.task.get("hide", ()))
    seen = seen + ([True] * joints + seen) * (memory - 1)
    layers[0] = (layers[0][0] * np.asarray(seen, np.float32), layers[0][1])  # what training hid stays hidden on the robot
    header = {
        "robot": robot.name,
        "joints": joints,
        "structure": structure_of(robot),
        "observation": observation_of(joints),
        "action": f"joint angle over {robot.servo.range:.6f} rad",
        "scale": scale(joints).tolist(),
        "activation": network.activation,
        "memory": memory,
        "control_dt": robot.timing.control_dt,
        "command_path": settings.command_path,
        "algorithm": settings.algo if settings.algo in ALGORITHMS else plugins.name_of(settings.algo),
        "seed": settings.seed,
        "origin": "synthetic",  # trained in simulation only
        **meta,
    }
    return Policy(layers, header)
