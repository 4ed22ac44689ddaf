"""From settings to the pieces of a run: robot, engine, environment, algorithm, and the policy that comes out."""

from dataclasses import replace

import numpy as np

from fishmj.errors import ConfigError, MissingExtra, UnknownName
from fishmj.mjcf.description import COMMAND_PATHS, load_robot
from fishmj.policy import Policy
from fishmj.train.networks import scale
from fishmj.train.settings import Settings


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
    """The robot with the run's command path."""
    if settings.command_path not in COMMAND_PATHS:
        raise UnknownName("command path", settings.command_path, COMMAND_PATHS)
    robot = load_robot(settings.robot)
    return replace(robot, timing=replace(robot.timing, command_path=settings.command_path))


def environment(settings: Settings, box: str = "train"):
    """The training environment, or with box="tune" the one that picks the best policy."""
    from fishmj.tasks.env import Options, StationHold

    return StationHold(robot_for(settings), pick_engine(settings.engine), _made(Options, {**settings.task, "box": box}), **settings.reward)


def algorithm(settings: Settings, env):
    """The learner named by settings.algo."""
    if settings.algo == "ppo":
        from fishmj.train.ppo import PPO, Config

        return PPO(env, _made(Config, settings.algorithm), settings.steps)
    if settings.algo == "sac":
        from fishmj.train.sac import SAC, Config

        return SAC(env, _made(Config, settings.algorithm), settings.steps)
    raise MissingExtra("stable-baselines3", "sb3", f"--algo {settings.algo}")


def _made(kind, table: dict):
    try:
        return kind(**table)
    except TypeError as error:
        raise ConfigError(f"{kind.__module__}.{kind.__name__}: {error}") from error


def policy_of(actor, settings: Settings, meta: dict) -> Policy:
    """The NumPy policy for a trained actor: list of (weights (in, out), bias)."""
    robot = robot_for(settings)
    joints = robot.n_joints
    layers = [(np.asarray(w, np.float32).T, np.asarray(b, np.float32)) for w, b in actor]
    w, b = layers[-1]
    layers[-1] = (w[:joints], b[:joints])  # SAC's actor also gives log sigma
    header = {
        "robot": robot.name,
        "joints": joints,
        "observation": "target_x target_y velocity_x velocity_y yaw_rate joint*J joint_rate*J, body frame, SI",
        "action": f"joint angle over {robot.servo.range:.6f} rad",
        "scale": scale(joints).tolist(),
        "activation": settings.algorithm.get("activation", {"ppo": "tanh"}.get(settings.algo, "relu")),
        "memory": settings.task.get("memory", 1),
        "control_dt": robot.timing.control_dt,
        "command_path": settings.command_path,
        "algorithm": settings.algo,
        "seed": settings.seed,
        "origin": "synthetic",  # trained in simulation only
        **meta,
    }
    return Policy(layers, header)
