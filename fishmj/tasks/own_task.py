"""A task of the user's own: own starts, targets, reward and domain over the same 11 observations and the same actions.

    class LineFollow:
        seconds = 20.0                              length of an episode
        def launch(self, xp, uniforms): ..          (B, 7) uniforms -> EpisodeStart(Start(pose, target, speed, direction), phase)
        def target(self, xp, launch, t): ..         (B, 2) m at times t (B,) s
        def reward(self, xp, step): ..              (B,) from a Stride; optional, the paper's without it
        def outside(self, xp, pose): ..             (B,) bool from poses (B, 3); optional, |x|, |y| > 2 m without it

The policy sees fishmj's observations; a task that brings its own is refused, since nothing would ever call them.

`xp` is NumPy or jax.numpy: the same functions serve Gymnasium, dm_control and the trainer. Fields of a dataclass are options.
"""

import inspect
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from fishmj import engines, plugins
from fishmj.errors import OwnCodeError, UnknownName
from fishmj.tasks import station_hold as hold
from fishmj.tasks.reference import COURSES, EpisodeStart, StepTruth

LONGEST = 1e6  # s
TRIED = 5  # episodes of the trial run
UNASKED = ("observe", "observation", "observations", "get_observation", "get_obs", "observation_space", "observation_spec")


def named(task: Any) -> Any:
    """What a caller gave as a task: a name of COURSES as it is, `module:Name` loaded, a class or object as it is.

    For a word that the user typed or an argument of a Python call; runs the code. Raises UnknownName, OwnCodeError.
    """
    if not isinstance(task, str) or task in COURSES:
        return task
    return plugins.load("task", task, COURSES)


def course_of(task: Any, **options: Any) -> Any:
    """A course. task: name of COURSES, text of one that the user loaded in this process, class or object.

    Raises:
        UnknownName: no such task; text that was not loaded is never run. OwnCodeError: it is no task.
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
    """A user's task with the interface of a course; every answer is looked at.

    Attributes:
        name: for reports. seconds: length of an episode. reward: None for the paper's.
    """

    def __init__(self, task: Any, name: str, options: dict):
        self.name, self.what = name, f"task {name}"
        if inspect.isclass(task):
            task = plugins.call(f"{self.what}(options {options})", task, **options)
        elif options:
            raise OwnCodeError(f"{self.what}: is an object, not a class, so it takes no options; got {', '.join(options)}")
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
                f"{self.what}: has {theirs[0]}, which nothing would call: the policy sees the 5 + 2 J observations of fishmj;"
                " put what matters into launch, target and reward, and take it out (docs/guide/your_own_code.md)"
            )
        self.seconds: Any = getattr(task, "seconds", None)
        if isinstance(self.seconds, bool) or not isinstance(self.seconds, int | float) or not 0 < self.seconds <= LONGEST:
            raise OwnCodeError(
                f"{self.what}: seconds = {self.seconds!r}; expected the length of an episode, above 0 to {LONGEST:g} s"
            )
        self.reward = self._reward if hasattr(task, "reward") else None
        self.outside = self._outside if hasattr(task, "outside") else hold.outside
        self._try()

    def launch(self, xp, uniforms) -> EpisodeStart:
        """Starts from uniforms (B, 7)."""
        n = len(uniforms)
        found = plugins.call(f"{self.what}: launch", self.task.launch, xp, uniforms)
        if not isinstance(found, EpisodeStart):
            raise OwnCodeError(
                f"{self.what}: launch gave {type(found).__name__}; "
                "expected EpisodeStart(Start(pose, target, speed, direction), phase)"
            )
        for value, name, shape in zip((*found.start, found.phase), (*found.start._fields, "phase"), SHAPES, strict=True):
            self._checked(value, f"launch: {name}", (n, *shape))
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
            raise OwnCodeError(f"{self.what}: outside gave {found.dtype}; expected bool, True where the episode ends")
        return found

    def _checked(self, value, where: str, shape: tuple):
        """The value, when it has the shape and, where that can be seen, is finite."""
        got = getattr(value, "shape", None)
        if got != shape:
            raise OwnCodeError(f"{self.what}: {where} has shape {got}, expected {shape}, batch axis first")
        if isinstance(value, np.ndarray) and value.dtype != bool and not np.isfinite(value).all():
            raise OwnCodeError(f"{self.what}: {where} is not finite")
        return value

    def _try(self) -> None:
        """One start, both ends of the target's path and one reward in NumPy, before anything is built on it."""
        launch = self.launch(np, np.random.default_rng(0).random((TRIED, hold.N_START)))
        for t in (0.0, float(self.seconds)):
            target = self.target(np, launch, np.full(TRIED, t))
        pose = np.repeat(launch.start.pose[:, None], 10, 1)
        still = np.zeros((TRIED, 10, 3))
        trace = engines.Trace(pose, still, still, still, still[..., 0])
        step = StepTruth(trace, target, np.linalg.norm(pose[:, -1, :2] - target, axis=-1), still[:, 0], np.full(TRIED, 0.2))
        if self.reward is not None:
            self.reward(np, step)
        self.outside(np, pose[:, -1])


SHAPES = ((3,), (2,), (), (), ())  # of pose, target, speed, direction, phase, without the batch axis
