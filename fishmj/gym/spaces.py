"""Spaces and options that the single and the vector environment share."""

from dataclasses import fields
from typing import Any

import numpy as np
from gymnasium import spaces

from fishmj.errors import ConfigError
from fishmj.tasks.episode import TaskOptions, TaskSpec
from fishmj.tasks.own_task import named, options_of

# Bounds of the observations, which Gymnasium wants finite: several times what a fish reaches inside the domain, so the clip
# to them never acts on a sound simulation. Target m, velocity m/s, yaw rate rad/s, joint rad, joint rate rad/s.
TARGET, VELOCITY, YAW_RATE, JOINT, JOINT_RATE = 20.0, 10.0, 50.0, np.pi, 50.0


def rules_of(task: Any, options: dict) -> TaskSpec:
    """Rules from the keyword arguments of `gymnasium.make`: fields of `TaskOptions` and of the task's course.

    task: a name, or one's own as `module:Name`, `file.py:Name` or class; loading it runs it.

    Raises:
        ConfigError, UnknownName: an option or a task that does not exist.
    """
    task = named(task)
    general = {f.name for f in fields(TaskOptions)}
    special = options_of(task) - general
    unknown = sorted(set(options) - general - special)
    if unknown:
        raise ConfigError(f"gym: unknown option {unknown[0]!r}; known: {', '.join(sorted(general | special))}")
    pick = lambda names: {k: v for k, v in options.items() if k in names}
    return TaskSpec(task, TaskOptions(**pick(general)), **pick(special))


def observation_space(rules: TaskSpec) -> spaces.Box:
    """(11,) float32: target, velocity, yaw rate, joints, joint rates."""
    j = rules.n_act
    high = np.array([TARGET] * 2 + [VELOCITY] * 2 + [YAW_RATE] + [JOINT] * j + [JOINT_RATE] * j, np.float32)
    return spaces.Box(-high, high, dtype=np.float32)


def clipped(seen, space: spaces.Box) -> np.ndarray:
    """Observations as the space declares them: float32, inside its bounds."""
    return np.clip(seen, space.low, space.high).astype(np.float32)


def action_space(rules: TaskSpec) -> spaces.Box:
    """(3,) in [-1, 1]: desired joint angles over the servo's range."""
    return spaces.Box(-1.0, 1.0, (rules.n_act,), np.float32)


def fixed_by(rules: TaskSpec, options: dict | None, n: int) -> dict:
    """What `reset(options=...)` fixes of n starts, as arrays: pose (n, 3), target (n, 2), flow speed (n,) and direction (n,).

    Raises:
        ConfigError: an option that does not exist, of the wrong shape, or that this task decides by itself.
    """
    widths = {"pose": (3,), "target": (2,), "speed": (), "direction": ()}
    own = getattr(rules.course, "decides", ())
    fixed = {}
    for name, value in (options or {}).items():
        if name not in widths:
            raise ConfigError(f"reset: unknown option {name!r}; known: {', '.join(widths)}")
        if name in own:
            raise ConfigError(f"reset: {rules.name} decides {name} by itself; its own options go to gymnasium.make")
        try:
            fixed[name] = np.broadcast_to(np.asarray(value, float), (n, *widths[name])).copy()
        except ValueError as error:
            raise ConfigError(
                f"reset: option {name} = {value!r}; expected shape {widths[name]} or {(n, *widths[name])}"
            ) from error
        if not np.isfinite(fixed[name]).all():
            raise ConfigError(f"reset: option {name} = {value!r} is not finite")
    return fixed
