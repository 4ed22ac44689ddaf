"""Courses: start of the fish and path of its target, fishmj's and the user's own. One class of pure functions for each task.

    station_hold      paper, Initial State Distribution: fish, target, heading and flow are drawn; the target is fixed
    figure_eight      x = sin p cos p, y = sin p, followed at a constant speed: p(s) by arc length s
    angle_of_attack   the fish starts on its target, turned by a given angle from upstream

The paper states "constant speed" for the figure eight. At constant rate of its parameter p the speed would vary (ds/dp is 0.66 to
1.41), so the target moves by arc length.
"""

import inspect
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from math import pi
from typing import Any, NamedTuple

import numpy as np

from fishmj import engines
from fishmj.base import plugins
from fishmj.base.calib import constant
from fishmj.base.errors import OwnCodeError, UnknownName
from fishmj.base.options import checked
from fishmj.base.units import wrap
from fishmj.engines import Trace
from fishmj.tasks.station_hold import N_START, Start, draw_start, outside

SLOWEST = 1e-3  # least speed of the figure eight, m/s, and least share of its cycle
POINTS = 4096  # of the arc-length table; its error is below 1e-6 m
LONGEST = 1e6  # s
SHORT = 8.0  # s, length of episodes that begin at the target; in short ones, waiting costs a larger part of the return
WITHIN = pi / 4  # rad, largest heading from downstream
TRIED = 5  # number of episodes that test a user's task
UNASKED = ("observe", "observation", "observations", "get_observation", "get_obs", "observation_space", "observation_spec")
SHAPES = {"pose": (3,), "target": (2,), "speed": (), "direction": (), "phase": (), "seconds": ()}  # without the batch axis


class EpisodeStart(NamedTuple):
    """Start of B episodes."""

    start: Start
    phase: Any  # (B,) m, arc length of the target at the start; 0 for fixed targets
    seconds: Any = None  # (B,) s, length of each episode, at most the task's; None: the task's


class StepTruth(NamedTuple):
    """True state of one control step of B episodes (T bus ticks), the input of a reward; policies do not observe it."""

    trace: Trace  # pose (B, T, 3) m, rad; joint, rate (B, T, J) rad, rad/s; velocity (B, T, 3) over ground; power (B, T) W
    target: Any  # (B, 2) m, at the end of the step
    distance: Any  # (B,) m, to it
    action: Any  # (B, J), clipped to [-1, 1]
    time: Any  # (B,) s since the episode began, at the end of the step


def episode_lengths(xp, launch: EpisodeStart, limit: int, dt: float):
    """Returns the lengths (B,) of episodes in control steps of dt [s], at most `limit`."""
    if launch.seconds is None:
        return xp.full(launch.phase.shape, limit, "int32")
    return xp.clip(xp.ceil(launch.seconds / dt - 1e-3), 1, limit).astype("int32")


def begun_at_target(xp, launch: EpisodeStart, uniforms, share: float, longest: float) -> EpisodeStart:
    """Returns starts of which a share, those with the smallest uniforms[:, 3], begins at the target and lasts SHORT.

    Half of these head downstream within WITHIN, the hardest case for a fish that cannot sense the stream; the others anywhere.
    longest: length of the other episodes, s.
    """
    u, start = uniforms[:, 3], launch.start
    there = u < share
    spread = constant("task", "arena") * (2 * (u - share) / max(1 - share, 1e-9) - 1)  # of the others, over the whole arena
    target = xp.where(there[:, None], start.pose[:, :2], xp.stack([spread, start.target[:, 1]], -1))
    downstream = wrap(xp, start.direction + WITHIN * (2 * uniforms[:, 2] - 1))
    yaw = xp.where(u < share / 2, downstream, start.pose[:, 2])
    start = start._replace(pose=xp.concatenate([start.pose[:, :2], yaw[:, None]], -1), target=target)
    return launch._replace(start=start, seconds=xp.where(there, min(SHORT, longest), longest))


@dataclass(frozen=True, kw_only=True)
class StationHoldReference:
    """Course: swim to a fixed target and hold station there."""

    seconds: float = constant("task", "episode_time")

    def launch(self, xp, uniforms) -> EpisodeStart:
        """Starts from uniforms (B, 7)."""
        return EpisodeStart(draw_start(xp, uniforms), xp.zeros_like(uniforms[:, 0]))

    def target(self, xp, launch: EpisodeStart, t):
        """Target (B, 2) m at times t (B,) s."""
        return launch.start.target + 0.0 * t[:, None]


@dataclass(frozen=True, kw_only=True)
class AngleOfAttackReference(StationHoldReference):
    """Course: start on the target at an angle from upstream. angle: rad; None draws one of the paper's four."""

    decides = ("pose", "target")  # parts of a start that callers may not fix
    heads_by_flow = True  # the start's heading is relative to the flow

    angle: float | None = None

    def __post_init__(self):
        if self.angle is not None:
            checked("angle_of_attack: angle", self.angle)

    def launch(self, xp, uniforms) -> EpisodeStart:
        """Starts from uniforms (B, 7): target and flow direction drawn, flow speed the paper's."""
        start = draw_start(xp, uniforms)
        angles = xp.asarray(np.radians(constant("experiments", "aoa_deg")), dtype=uniforms.dtype)
        picked = angles[xp.floor(4 * uniforms[:, 2]).astype("int32") % 4]
        angle = picked if self.angle is None else self.angle + 0.0 * picked
        heading = (start.direction + pi + angle + pi) % (2 * pi) - pi
        pose = xp.concatenate([start.target, heading[:, None]], -1)
        speed = constant("experiments", "aoa_speed") + 0.0 * heading
        return EpisodeStart(start._replace(pose=pose, speed=speed), xp.zeros_like(heading))


@dataclass(frozen=True, kw_only=True)
class FigureEightReference:
    """Course: follow a point on a figure eight. phase: m along the path at t = 0; None draws it."""

    decides = ("target",)

    speed: float = constant("experiments", "figure8_speed")  # m/s
    cycles: float = constant("experiments", "figure8_cycles")
    phase: float | None = None

    def __post_init__(self):
        checked("figure_eight: speed", self.speed, SLOWEST, 5)
        checked("figure_eight: cycles", self.cycles, SLOWEST, 1000)
        if self.phase is not None:
            checked("figure_eight: phase", self.phase)

    @property
    def seconds(self) -> float:
        """Time for all cycles, s."""
        return self.cycles * path_length() / self.speed

    def launch(self, xp, uniforms) -> EpisodeStart:
        """Starts at rest on the path, heading along it; uniforms (B, 7) give phase and flow."""
        start = draw_start(xp, uniforms)
        phase = path_length() * uniforms[:, 2] if self.phase is None else self.phase + 0.0 * uniforms[:, 2]
        point, heading = eight(xp, phase)
        return EpisodeStart(start._replace(pose=xp.concatenate([point, heading[:, None]], -1), target=point), phase)

    def target(self, xp, launch: EpisodeStart, t):
        """Target (B, 2) m at times t (B,) s."""
        return eight(xp, launch.phase + self.speed * t)[0]


@cache
def _arc_table() -> tuple[np.ndarray, np.ndarray]:
    """(p, s): parameter and arc length along one cycle; Simpson's rule between the points."""
    p = np.linspace(0, 2 * pi, POINTS)
    rate = lambda p: np.hypot(np.cos(2 * p), np.cos(p))  # ds/dp
    middle = (p[1:] + p[:-1]) / 2
    pieces = (rate(p[1:]) + 4 * rate(middle) + rate(p[:-1])) / 6 * np.diff(p)
    return p, np.concatenate([[0.0], np.cumsum(pieces)])


def path_length() -> float:
    """Length of one figure eight, m."""
    return float(_arc_table()[1][-1])


def eight(xp, s):
    """Point (B, 2) [m] and direction of travel (B,) [rad] at arc lengths s (B,) [m]."""
    p_table, s_table = _arc_table()
    p = xp.interp(s % path_length(), xp.asarray(s_table), xp.asarray(p_table))
    return xp.stack([xp.sin(p) * xp.cos(p), xp.sin(p)], -1), xp.arctan2(xp.cos(p), xp.cos(2 * p))


COURSES = {"station_hold": StationHoldReference, "figure_eight": FigureEightReference, "angle_of_attack": AngleOfAttackReference}


def named(task: Any) -> Any:
    """Returns a name of COURSES, class or object unchanged, and loads `module:Name`.

    It runs that code: use it for text from the user or a Python caller only. Raises UnknownName, OwnCodeError.
    """
    if not isinstance(task, str) or task in COURSES:
        return task
    return plugins.load("task", task, COURSES)


def course_of(task: Any, **options: Any) -> Any:
    """Course of a task. task: name of COURSES, reference that the user loaded in this process, class or object.

    Raises UnknownName: no such task, or a reference that was not loaded, which is never run; OwnCodeError: not a task.
    """
    if isinstance(task, str) and task in COURSES:
        return COURSES[task](**options)
    if isinstance(task, str):
        loaded = plugins.loaded("task")
        if task not in loaded:
            raise UnknownName("task", task, (*COURSES, *loaded))
        return OwnReference(loaded[task], plugins.name_of(task), options)
    return OwnReference(task, getattr(task, "__name__", type(task).__name__), options)


def options_of(task: Any) -> set[str]:
    """Names of a task's own options."""
    task = COURSES.get(task, plugins.loaded("task").get(task)) if isinstance(task, str) else task
    return {f.name for f in fields(task)} if is_dataclass(task) and isinstance(task, type) else set()


class OwnReference:
    """Wraps the user's own task as a course, and checks every result.

        class LineFollow:
            seconds = 20.0                          length of an episode
            def launch(self, xp, uniforms): ..      (B, 7) uniforms -> EpisodeStart(Start(pose, target, speed, direction), phase)
            def target(self, xp, launch, t): ..     (B, 2) m at times t (B,) s
            def reward(self, xp, step): ..          (B,) from a StepTruth; optional, the paper's without it
            def outside(self, xp, pose): ..         (B,) bool from poses (B, 3); optional, |x|, |y| > 2 m without it

    `xp` is NumPy or jax.numpy: the same functions serve Gymnasium, dm_control and the trainer. Fields of a dataclass are options.
    The policy sees fishmj's observations; a task with observations of its own is refused, because nothing would call them.

    Attributes:
        name: for reports. seconds: length of an episode. reward: None for the paper's.
    """

    def __init__(self, task: Any, name: str, options: dict):
        self.name, self.what = name, f"task {name}"
        if inspect.isclass(task):
            task = plugins.call(f"{self.what}(options {options})", task, **options)
        elif options:
            raise OwnCodeError(
                f"{self.what}: is an object, which takes no options; got {', '.join(options)}; name a class, or leave them out"
            )
        self.task = task
        for call, count, needed in (
            ("launch(xp, uniforms)", 2, True),
            ("target(xp, launch, t)", 3, True),
            ("reward(xp, step)", 2, False),
            ("outside(xp, pose)", 2, False),
        ):
            function = getattr(task, call.partition("(")[0], None)
            if needed or function is not None:
                plugins.takes(self.what, function, call, count)
        if theirs := [name for name in UNASKED if hasattr(task, name)]:
            raise OwnCodeError(
                f"{self.what}: has {theirs[0]}, which is never called: policies see fishmj's 5 + 2 J observations;"
                " remove it, and use launch, target and reward (docs/simulate/your_own_code.md)"
            )
        self.seconds: Any = getattr(task, "seconds", None)
        if isinstance(self.seconds, bool) or not isinstance(self.seconds, int | float) or not 0 < self.seconds <= LONGEST:
            raise OwnCodeError(
                f"{self.what}: seconds = {self.seconds!r}; expected the length of an episode, above 0 to {LONGEST:g} s"
            )
        self.reward = self._reward if hasattr(task, "reward") else None
        self.outside = self._outside if hasattr(task, "outside") else outside
        self._try()

    def launch(self, xp, uniforms) -> EpisodeStart:
        """Starts from uniforms (B, 7)."""
        n = len(uniforms)
        found = plugins.call(f"{self.what}: launch", self.task.launch, xp, uniforms)
        if not isinstance(found, EpisodeStart):
            raise OwnCodeError(
                f"{self.what}: launch returned {type(found).__name__}; "
                "expected EpisodeStart(Start(pose, target, speed, direction), phase)"
            )
        given = {name: getattr(found.start, name) for name in Start._fields} | {"phase": found.phase}
        given |= {} if found.seconds is None else {"seconds": found.seconds}
        for name, value in given.items():
            self._checked(value, f"launch: {name}", (n, *SHAPES[name]))
        if isinstance(found.seconds, np.ndarray) and not ((found.seconds > 0) & (found.seconds <= self.seconds)).all():
            got = f"{found.seconds.min():g} to {found.seconds.max():g} s"
            raise OwnCodeError(f"{self.what}: launch: seconds {got}; expected above 0, at most the task's {self.seconds:g} s")
        return found

    def target(self, xp, launch: EpisodeStart, t):
        """Target (B, 2) m at times t (B,) s."""
        return self._checked(plugins.call(f"{self.what}: target", self.task.target, xp, launch, t), "target", (len(t), 2))

    def _reward(self, xp, step: StepTruth):
        return self._checked(plugins.call(f"{self.what}: reward", self.task.reward, xp, step), "reward", step.distance.shape)

    def _outside(self, xp, pose):
        found = plugins.call(f"{self.what}: outside", self.task.outside, xp, pose)
        self._checked(found, "outside", pose.shape[:-1])
        if np.dtype(found.dtype) != bool:
            raise OwnCodeError(f"{self.what}: outside returned {found.dtype}; expected bool, True where the episode ends")
        return found

    def _checked(self, value, where: str, shape: tuple):
        """Returns the value; raises OwnCodeError if it has another shape or (outside of tracing) is not finite."""
        got = getattr(value, "shape", None)
        if got != shape:
            raise OwnCodeError(f"{self.what}: {where} has shape {got}, expected {shape}, batch axis first")
        if isinstance(value, np.ndarray) and value.dtype != bool and not np.isfinite(value).all():
            raise OwnCodeError(f"{self.what}: {where} is not finite")
        return value

    def _try(self) -> None:
        """Tests starts, both ends of the target's path and a reward in NumPy, before the task is used."""
        launch = self.launch(np, np.random.default_rng(0).random((TRIED, N_START)))
        for t in (0.0, float(self.seconds)):
            target = self.target(np, launch, np.full(TRIED, t))
        pose = np.repeat(launch.start.pose[:, None], 10, 1)
        still = np.zeros((TRIED, 10, 3))
        trace = engines.Trace(pose, still, still, still, still[..., 0])
        step = StepTruth(trace, target, np.linalg.norm(pose[:, -1, :2] - target, axis=-1), still[:, 0], np.full(TRIED, 0.2))
        if self.reward is not None:
            self.reward(np, step)
        self.outside(np, pose[:, -1])
