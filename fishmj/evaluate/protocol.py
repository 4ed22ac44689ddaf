"""The 72 trials: 3 speeds x 8 directions x 3 repeats, each drawn from its own seed, the same for every controller.

    target - start = distance (cos, sin)(upstream + los),   their midpoint at the tank's centre
los = 0: target straight upstream; positive: to the left of a fish that faces upstream. The water moves to tank +x, so upstream is
-x; the direction of the axes is a convention, because all figures are relative to the stream. A trial's draws depend on (seed,
box, speed, los, repeat) only: a subset has exactly the same trials.

The other two tasks are the courses of `fishmj.tasks.reference`. angle_of_attack: `los` is the start's angle from upstream.
figure_eight: the fish starts at the crossing, and the target follows the path by arc length.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from itertools import product
from math import ceil
from typing import ClassVar, NamedTuple

import numpy as np

from fishmj.base.calib import constant
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.base.options import checked, shown_value
from fishmj.mjcf.description import Robot
from fishmj.tasks import station_hold as task
from fishmj.tasks.episode import LARGEST
from fishmj.tasks.reference import COURSES, EpisodeStart
from fishmj.water import flow as background
from fishmj.water.flow import Current, Flow

HEADINGS = ("upstream", "uniform")
LIMITS: dict[str, tuple] = {"duration": (1, 600), "direction": background.TURN}  # of `Trials`
LIMITS |= {key: (0, LARGEST[key]) for key in ("intensity", "randomisation", "noise")}
MOST = 1000  # largest number of repeats of a condition
SETS = ("tune", "judge")  # sets of turbulence; "train" is never used in evaluations
HOLD, EIGHT, ANGLE = TASKS = ("station_hold", "figure_eight", "angle_of_attack")


class TrialSpec(NamedTuple):
    """One trial's condition and its seed."""

    speed: float  # m/s
    los: float  # rad
    repeat: int
    seed: tuple[int, ...]  # (seed, box, speed in 0.1 mm/s, los in 0.01 deg, repeat)

    @property
    def name(self) -> str:
        """Name in files, behind the controller's: `u0.2_los045_r1`."""
        los = round(float(np.degrees(self.los)), 2) % 360  # as exact as its seed
        return f"u{self.speed:g}_los{f'{los:03.0f}' if los.is_integer() else f'{los:06.2f}'}_r{self.repeat}"

    def draw(self, stream: int) -> np.random.Generator:
        """Fresh generator of one of this trial's streams: 0 fish, 1 flow, 2 heading, 3 sensor noise, 4 noise of its log."""
        return np.random.default_rng([*self.seed, stream])


@dataclass(frozen=True, kw_only=True)
class Trials:
    """Trials of an evaluation, and their common settings."""

    items: tuple[TrialSpec, ...]
    turbulence: str
    intensity: float
    heading: str
    box: str
    direction: float  # rad, where the water moves to
    randomisation: float
    noise: float
    duration: float  # s
    task: str = HOLD
    effects: tuple[str, ...] = ()  # of the robot, drawn in typical sizes for each trial
    steady: ClassVar[bool] = True  # the mean stream does not change within a trial
    drawn_as: ClassVar[str] = ""  # label for a subclass with other draws than those of the items' seeds

    def __post_init__(self):
        for key, bounds in LIMITS.items():
            checked(f"trials: {key}", getattr(self, key), *bounds)
        for one in self.items:
            checked("trials: speed", one.speed, 0, 1), checked("trials: los", one.los)

    def __len__(self) -> int:
        return len(self.items)

    @property
    def speed(self) -> np.ndarray:
        """Speed of the stream in each trial, (n,) m/s."""
        return np.array([t.speed for t in self.items])

    @property
    def los(self) -> np.ndarray:
        """Direction of the target in each trial, (n,) rad; of angle_of_attack the start's angle from upstream."""
        return np.array([t.los for t in self.items])

    @property
    def upstream(self) -> float:
        """Heading against the mean stream, rad."""
        return self.direction + np.pi

    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Start pose (n, 3) and target (n, 2) at the start, tank frame, m and rad."""
        if self.task != HOLD:
            start = self._launch().start
            return start.pose, start.target
        bearing = self.upstream + self.los
        target = 0.5 * constant("protocol", "distance") * np.stack([np.cos(bearing), np.sin(bearing)], -1)
        heading = np.full(len(self), self.upstream)
        if self.heading == "uniform":
            heading += 2 * np.pi * np.array([t.draw(2).random() for t in self.items])
        return np.concatenate([-target, heading[:, None]], 1), target

    def targets(self, t) -> np.ndarray:
        """Target of each trial at times t (T,) [s], (n, T, 2) m."""
        if self.task != EIGHT:
            return np.repeat(self.ends()[1][:, None], len(t), 1)
        launch, course = self._launch(), course_of_trial(self.task)
        return np.stack([course.target(np, launch, np.full(len(self), at)) for at in t], 1)

    def _launch(self) -> EpisodeStart:
        """Starts of a course in the trials' own stream; its other draws are at their middle."""
        uniforms = np.full((1, task.N_START), 0.5)
        uniforms[:, 6] = (self.direction / np.pi + 1) / 2
        starts = [course_of_trial(self.task, t.los).launch(np, uniforms) for t in self.items]
        start = task.Start(*(np.concatenate(column) for column in zip(*(one.start for one in starts), strict=True)))
        return EpisodeStart(start, np.concatenate([one.phase for one in starts]))

    def flows(self) -> list[Flow]:
        """Background flow of each trial."""
        return [
            Flow(
                speed=t.speed,
                direction=self.direction,
                turbulence=self.turbulence,
                intensity=self.intensity,
                seed=int(t.draw(1).integers(2**31)),
                box=background.BOXES[self.box],
            )
            for t in self.items
        ]

    def stream(self, current: Current, t: float) -> Current:
        """Flow of all trials from time t [s] on, given the previous one; unchanged for a steady stream."""
        return current

    @property
    def flow_seeds(self) -> list:
        """Seed of each trial's flow; "" if it was not drawn."""
        return [flow.seed for flow in self.flows()]

    @property
    def turbulence_said(self) -> str:
        """Kind and strength of the turbulence as text."""
        return "no turbulence" if self.turbulence == "none" else f"{self.turbulence} turbulence {100 * self.intensity:g} %"

    def fish(self, robot: Robot):
        """Randomised fish: (FishParams, camera delay in bus ticks (n,))."""
        uniforms = np.stack([t.draw(0).random(task.n_fish(robot, self.effects)) for t in self.items])
        task.warn_of_streams(robot, None, (self.speed.min(),), self.randomisation)
        return task.draw_fish(np, robot, uniforms, self.randomisation, self.effects, self.speed)

    def sensor_noise(self, robot: Robot, steps: int) -> np.ndarray:
        """Standard normal draws times the wanted strength, (n, steps, 5 + 2 J)."""
        shape = (steps, 5 + 2 * robot.n_joints)
        return self.noise * np.stack([t.draw(3).standard_normal(shape) for t in self.items])


@dataclass(frozen=True, kw_only=True)
class MeasuredTrials(Trials):
    """Trials in the water of a tank, whose turbulence was measured at every speed; `intensity` is their mean.

    intensities: (speed m/s, TI) for each speed of `items`, without those not measured. seen: the water is that of the tank, so
    that no flow was drawn.
    """

    intensities: tuple[tuple[float, float], ...]
    seen: bool = False

    def flows(self) -> list[Flow]:
        """Background flow of each trial, with the intensity measured at its speed."""
        strong = dict(self.intensities)
        flows = zip(self.items, super().flows(), strict=True)
        return [replace(flow, intensity=strong.get(t.speed, flow.intensity)) for t, flow in flows]

    @property
    def flow_seeds(self) -> list:
        """Seed of each trial's flow; "" if it was not drawn."""
        return [""] * len(self) if self.seen else super().flow_seeds

    @property
    def turbulence_said(self) -> str:
        """Kind and strength of the turbulence, for people."""
        if not self.intensities:
            return "turbulence not measured"
        measured = "/".join(f"{100 * strong:.3g}" for _, strong in self.intensities)
        return f"measured turbulence {measured} %" if self.seen else f"{self.turbulence} turbulence {measured} % as measured"


def course_of_trial(name: str, los: float = 0.0):
    """Course of a task other than station holding; los: angle [rad] from upstream at which a fish starts on its target."""
    return COURSES[name](**({"phase": 0.0} if name == EIGHT else {"angle": los}))


def measured(some: Trials, intensities: Mapping[float, float], turbulence: str, seen: bool = False) -> MeasuredTrials:
    """The same trials, speeds and draws, in turbulence of this kind and of a measured TI for each speed [m/s]."""
    known = {field.name: getattr(some, field.name) for field in fields(Trials)} | {"turbulence": turbulence}
    if intensities:
        known["intensity"] = sum(intensities.values()) / len(intensities)
    return MeasuredTrials(**known, intensities=tuple(sorted(intensities.items())), seen=seen)


def trials(
    *,
    speeds=None,
    los_deg=None,
    repeats: int | None = None,
    seed: int = 0,
    box: str = "judge",
    turbulence: str = "default",
    intensity: float | None = None,
    heading: str = "upstream",
    direction: float = 0.0,
    randomisation: float = 1.0,
    noise: float = 1.0,
    duration: float | None = None,
    task: str = HOLD,
    effects: tuple[str, ...] = (),
) -> Trials:
    """The standard 72 trials, or a part of them; those of another task with the paper's speeds, angles and cycles.

    Args:
        speeds: some of 0.1, 0.2, 0.3 m/s (others are possible; the tables mark them).
        los_deg: some of 0, 45, .. 315; of angle_of_attack angles from upstream, -180, -90, 0, 90.
        repeats: 1 to 3 (more are possible).
        heading: of the start, "upstream" or "uniform".
        randomisation, noise: 0 switches them off.
        effects: names of effects that are drawn for each trial; the robot has them (`engines.with_effects`).

    Raises ConfigError, UnknownName: an invalid setting.
    """
    get, of_paper = (lambda key: constant("protocol", key)), (lambda key: constant("experiments", key))
    names: list[tuple[str, str, tuple[str, ...]]] = [("heading", heading, HEADINGS), ("seeds", box, SETS), ("task", task, TASKS)]
    names.append(("turbulence", turbulence, background.PRESETS))
    for kind, name, known in names:
        if name not in known:
            raise UnknownName(kind, name, known)
    if task != HOLD and heading != HEADINGS[0]:
        raise ConfigError(f"trials: heading = {heading!r} with the task {task}, which states its own; leave one of them out")
    if task == EIGHT and los_deg is not None:
        raise ConfigError(
            f"trials: directions {list(los_deg)} with the task {task}, whose fish starts on its path; leave them out"
        )
    if turbulence == "none" and intensity:
        raise ConfigError(f"trials: intensity = {intensity} with turbulence none, which has no eddies; leave one of them out")
    standard = {
        HOLD: lambda: (get("speeds"), get("bearings_deg"), get("duration")),
        EIGHT: lambda: (of_paper("figure8_flows"), (0.0,), ceil(course_of_trial(EIGHT).seconds)),
        ANGLE: lambda: ((of_paper("aoa_speed"),), of_paper("aoa_deg"), course_of_trial(ANGLE).seconds),
    }[task]()
    speeds, los_deg, duration = (b if a is None else a for a, b in zip((speeds, los_deg, duration), standard, strict=True))
    speeds, los_deg = (tuple(value) if np.iterable(value) else (value,) for value in (speeds, los_deg))
    repeats = get("repeats") if repeats is None else repeats
    if not speeds or not los_deg:
        raise ConfigError(
            f"trials: {len(speeds)} speeds x {len(los_deg)} directions give no trials; expected at least one of each"
        )
    for name, values, bounds in (("speeds", speeds, (0, 1)), ("los_deg", los_deg, ())):
        for value in values:
            checked(f"trials: {name}", value, *bounds)
        kinds = [value % 360 for value in values] if name == "los_deg" else list(values)
        if twice := [value for value, kind in zip(values, kinds, strict=True) if kinds.count(kind) > 1]:
            raise ConfigError(f"trials: {name} = {shown_value(list(values))}: {twice[-1]:g} is given twice; give each once")
    repeats, seed = checked("trials: repeats", repeats, 1, MOST, whole=True), checked("trials: seed", seed, 0, whole=True)
    key = lambda u, b: (seed, background.BOXES[box], round(1e4 * u), round(100 * (b % 360)))
    items = tuple(
        TrialSpec(float(u), float(np.radians(b)), r, (*key(u, b), r)) for u, b, r in product(speeds, los_deg, range(repeats))
    )
    return Trials(
        items=items,
        turbulence=turbulence,
        intensity=constant("turbulence", "intensity") if intensity is None else intensity,
        heading=heading,
        box=box,
        direction=direction,
        randomisation=randomisation,
        noise=noise,
        duration=duration,
        task=task,
        effects=tuple(effects),
    )
