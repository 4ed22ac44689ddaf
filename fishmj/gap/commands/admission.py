"""Checks of a model and its logs before a search, so that poor data or a mistake are not taken for an effect.

searchable, null_fits   the search compiles the model's step and repeats every record with `virtual_robot`: both must support
                        the model
admitted                the trials are of the model's robot (under another name only if the user confirms it), and the motion is
                        physically possible (log/physical_checks.py)
insufficient_data       too few     one record cannot serve both to fit and to validate
                        too short   no record lasts 2 s, about two tail beats
                        too quiet   no command moves, no push, no current: every effect predicts the same rest
admit                   the gap is too large for any effect: wrong units, sign or frame, or another robot

Of 1440 blind sets of the benchmark with one or two effects of up to 1.5 times their typical size, nine have a gap above 1000
(tethers, stiff skins, up to 18,946: bench_2010.json, bench_2011.json in studies/gap_benchmark/rows). So a search stops above FAR
in one channel if a usual mistake is recognised, and above BEYOND in any case. docs/search/results.md states how often that is
wrong.
"""

from collections import Counter
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from shlex import quote
from typing import NamedTuple

import numpy as np

from fishmj import effects
from fishmj.base import console
from fishmj.base.errors import ConfigError, FishmjError, LogError
from fishmj.base.names import strips_of
from fishmj.gap.laboratory.virtual_robot.robot_constants import buildable
from fishmj.gap.null.null_runs import RecordedNull, SimulatedNull, trials_of
from fishmj.gap.records import datasets, mass_properties
from fishmj.gap.records.records import Record, age_of_poses, record_of
from fishmj.gap.search.likelihood import Likelihood
from fishmj.gap.wording import title
from fishmj.log import Trial, measurements, physical_checks
from fishmj.log.dataset import Taken
from fishmj.log.excitation import PERIOD
from fishmj.mjcf.description import Robot
from fishmj.mjcf.identity import another_body
from fishmj.mjcf.reading import load_robot
from fishmj.water.choice import label, residuals_of

SAME_AGE = 1e-3  # s, tolerance of a pose's age at its stamp
SHIPPED = "fish"  # robot of the null sets, which state a name only


def searchable(robot: Robot, model: object) -> None:
    """Raises ConfigError if the search cannot take this robot. model: the user's name for it."""
    buildable(robot, model)
    if residuals_of(robot):
        name = label(robot)
        raise ConfigError(
            f"the search supports strip forces only, and water {name!r} has a learnt force; take its strips:"
            f" --water {strips_of(name)}, or structured"
        )
    ticks = PERIOD / robot.timing.physics_dt
    if abs(ticks - round(ticks)) > 1e-6:
        step = f"{model} has physics_dt = {robot.timing.physics_dt:g} s"
        raise ConfigError(f"the search needs a physics step that divides the command period, {PERIOD:g} s; {step}; take 0.004")


def admitted(
    data: Path, robot: Robot, model: object, agreed: bool, anyway: bool = False
) -> tuple[Taken, tuple[str, ...]]:  # fmt: skip
    """The trials of a data set that can be compared with the model, and notes on them.

    Args:
        agreed: accept logs of a robot with another name or body. anyway: accept physically impossible motion.

    Raises LogError: no trial, another number of joints, another robot's name or body without agreement, or impossible motion (a
    mirrored camera, a joint against its command); ConfigError: weighings in another unit.
    """
    mass_properties.check_page(datasets.page_in(data), robot, data / measurements.FILE)
    given = datasets.readable_trials(data, robot.timing.physics_dt)
    whose = of_this_robot(given.trials.values(), robot, model, agreed)
    broken = (f"{name} left out: {why}" for name, why in given.broken.items())
    notes = (*given.notes, *broken, *whose, *surroundings(given.trials.values(), robot))
    breaches, doubts = unphysical(given.trials.values(), length=robot.length)
    notes = (*notes, *(breaches if anyway else ()), *doubts)
    for note in notes:
        console.warn(note)
    if breaches and not anyway:
        message = f"{data}: {'; '.join(breaches)}"
        if not console.confirmed(f"{message}. Search anyway?"):
            out = f"remove its folder, then run `fishmj log manifest {quote(str(data))}`"
            raise LogError(f"{message}. To search without this trial, {out}. To search with it, add --anyway")
    return given, notes


def unphysical(trials: Iterable[Trial], only: Iterable[str] = (), length: float = 0.0) -> tuple[list[str], list[str]]:
    """(breaches, which forbid a comparison with a model; doubts, which do not) of the physical checks, one line for each check.

    only: names of checks; all by default. length: of the robot, m.
    """
    found: dict[tuple[bool, str], list[tuple[str, str]]] = {}
    for trial in trials:
        for finding in physical_checks.examine(trial, only, length):
            doubt = finding.level == physical_checks.NOTE
            found.setdefault((doubt, finding.check), []).append((trial.name, finding.text))
    lines: tuple[list[str], list[str]] = ([], [])
    for (doubt, _), told in found.items():
        names = list(dict.fromkeys(name for name, _ in told))
        more = f" (and {len(names) - 1} more trials: {', '.join(names[1:4])}{', ..' if len(names) > 4 else ''})"
        lines[doubt].append(f"trial {names[0]}: {told[0][1]}{more if len(names) > 1 else ''}")
    return lines


def of_this_robot(trials: Iterable[Trial], robot: Robot, model: object, agreed: bool = False) -> list[str]:
    """Notes on the robot of the trials.

    Args:
        model: the user's name for the robot. agreed: accept logs of another name or body (`--same-robot`).

    Raises LogError: another number of joints, or another robot's name or body without agreement.
    """
    said: Counter[str] = Counter()
    others: set[str] = set()
    for trial in trials:
        joints = joints_of(trial)
        name = str(trial.value("robot", "") or "")[:64]
        said[name] += 1
        if another_body(trial.meta, robot) or name not in ("", robot.name):
            others.add(repr(name) if name != robot.name else f"{name!r} with another body (lengths, sections, fins)")
        if joints and joints != robot.n_joints:
            whose = f"trial {trial.name} ({name or 'no robot named'}) has {joints} joints"
            mine = f"the model {model} ({robot.name}) has {robot.n_joints}"
            raise LogError(f"{whose}, {mine}; name the model of that robot with --model")
    if others:
        differ = f"the logs are of {', '.join(sorted(others))}, the model {model} is {robot.name!r}"
        if not agreed and not console.confirmed(f"{differ}. Is it the same robot?"):
            raise LogError(f"{differ}; name its own model with --model, or pass --same-robot if it is the same robot")
        return [f"{differ}: taken for the same robot"]
    return [f"{said['']} of {said.total()} trials name no robot; taken for {robot.name!r}"] if said[""] else []


def still_water(trials: Iterable[Trial]) -> list[str]:
    """Note on swims that state no current: the model assumes still water, so a current would look like an effect."""
    swims = [t for t in trials if "pose" in t.tables and t.value("medium") != "air"]
    speeds = [(t.value("flow.speed"), t.value("flow.known")) for t in swims]
    unsaid = sum(speed is None or not speed and known is False for speed, known in speeds)
    told = f"{unsaid} of {len(swims)} swims state no current (flow in meta.toml, or log import --flow)"
    return [f"{told}; still water is assumed"] * bool(unsaid)


def surroundings(trials: Collection[Trial], robot: Robot) -> list[str]:
    """Notes on swims that state no current, and on those whose poses are older or newer than the description says."""
    notes, mine = still_water(trials), robot.timing.camera_latency
    stated = [age for trial in trials if "pose" in trial.tables and (age := age_of_poses(trial)) is not None]
    others = [age for age in stated if abs(age - mine) > SAME_AGE]
    if others:
        told = f"{len(others)} trials state the age of a pose at its stamp, latency.pose {min(others):.3g} to {max(others):.3g} s"
        notes.append(f"{told}; it replaces camera_latency = {mine:.3g} s of {robot.name!r}")
    return notes


def joints_of(trial: Trial) -> int:
    """Number of commanded joints; without commands, of measured joints; 0 without either table."""
    for table, letter in (("cmd", "c"), ("joint", "j")):
        columns = trial.tables.get(table, {})
        if columns:
            return sum(1 for name in columns if name[0] == letter and name[1:].isdigit())
    return 0


def null_fits(null: SimulatedNull, robot: Robot, model: object) -> None:
    """Raises ConfigError if the null sets are of another robot than the searched model."""
    if not isinstance(null, RecordedNull):
        return
    trial = trials_of(null.bundles[0])[0]
    name, joints = str(trial.value("robot", "") or "")[:64], joints_of(trial)
    if joints != robot.n_joints or (name and name != robot.name):
        sets = f"{null.folder}: null sets of {name or 'no robot named'!r} with {joints} joints"
        mine = f"the model {model} is {robot.name!r} with {robot.n_joints}"
        raise ConfigError(f"{sets}; {mine}. Leave out --null: the search then makes its own runs")
    differs = differences(load_robot(SHIPPED), robot)
    if differs:
        sets = f"{null.folder}: its null sets are of the shipped fish, and {model} differs in {', '.join(differs)}"
        raise ConfigError(f"{sets}. Leave out --null: the search then makes its own runs of this model")


def differences(one: Robot, other: Robot) -> list[str]:
    """Fields in which two descriptions differ, apart from water, effects and names."""
    bare = [replace(r, effects=(), water={}, name="", title="") for r in (one, other)]
    out = [key for key in ("links", "fins", "density_water") if getattr(bare[0], key) != getattr(bare[1], key)]
    for table in ("servo", "timing"):
        a, b = (vars(getattr(r, table)) for r in bare)
        out += [
            f"{table}.{key} ({a[key]:g}, {b[key]:g})" if isinstance(a[key], float) else f"{table}.{key}"
            for key in a
            if a[key] != b[key]
        ]
    return out


# -------------------------------------------------------------------------------------------------------------- sufficient data
FEWEST, SHORTEST, QUIETEST = 2, 2.0, np.radians(1.0)  # records, s, rad of command peak to peak
NEXT = 4  # excitations to suggest


@dataclass(frozen=True)
class InsufficientData:
    """Reason why no effect can be named. confounded: effects that the records cannot separate. record: experiments to record."""

    reason: str
    confounded: tuple[str, ...]
    record: tuple[str, ...]

    def text(self) -> str:
        """Text for a terminal."""
        names, todo = ", ".join(map(title, self.confounded)), ", ".join(self.record)
        return f"{self.reason}\nconfounded: {names}\nrecord next: {todo} (fishmj.log.excitation; two runs of each)"


def insufficient_data(given: Taken, robot: Robot) -> InsufficientData | None:
    """Reason why the data cannot separate the effects; None if they can."""
    records = [record_of(t, robot.timing.physics_dt) for t in given.trials.values()]
    moved = max(float(np.ptp(r.commands, 0).max()) for r in records)
    alone = not any(np.any(r.push) or np.any(r.flow) for r in records)
    longest = max(r.seconds for r in records)
    if len(records) < FEWEST:
        reason = f"too few: {len(records)} record, at least {FEWEST} are needed: one to fit, one to validate"
    elif longest < SHORTEST:
        reason = f"too short: the longest record has {longest:.2f} s, at least {SHORTEST:g} s are needed"
    elif moved < QUIETEST and alone:
        reason = f"too quiet: commands move by {np.degrees(moved):.2f} deg at most, without any push or current"
    else:
        return None
    measured = channels(records)
    seen = [e for e in effects.catalogue().values() if not e.stochastic and measured & set(e.shows)]
    names = {e.name for e in seen}
    votes = Counter(x for e in seen for c in e.confusions if c.other in names for x in c.excitations)
    return InsufficientData(reason, tuple(sorted(names)), tuple(x for x, _ in votes.most_common(NEXT)))


def channels(records: list[Record]) -> set[str]:
    """Measured channels."""
    has = lambda name: any(getattr(r, name) is not None for r in records)
    found = {"joint"} if has("joint") else set()
    return found | ({"position", "heading"} if has("pose") else set()) | ({"power"} if has("power") else set())


# ------------------------------------------------------------------------------------------------------------------ too different
FAR, BEYOND = 1e3, 1e5  # mean squares over the floor: of the worst channel, of all
UNITS = {
    "joint": ((57.3, "degrees"),),
    "yaw": ((57.3, "degrees"),),
    "path": ((1000.0, "mm"), (100.0, "cm")),
    "power": ((1000.0, "mW"),),
}
NEAR = 1.35  # an amplitude ratio within this factor of a unit's factor means that unit
AGAINST, ALIKE, STILL = -0.6, 0.8, 0.1  # correlations; part of the model's amplitude
BENT, TURNED, AWAY = 0.35, 0.5, 0.5  # rad of a joint's mean error, rad of a path's direction, m from the stated start
LATE = np.arange(0.02, 0.31, 0.02)  # s, tried extra delays of a joint behind its own command
JUMP = 0.4  # rad between two frames, in at least a tenth of them
MOVES = {"joint": 0.02, "yaw": 0.05, "path": 0.05, "power": 0.2}  # rad, rad, m, W: least movement for a meaningful ratio


class TooDifferent(FishmjError):
    """Model and logs differ so much that a search would only name an effect that imitates a mistake in the data."""

    def __init__(self, gap: float, channels: dict[str, float], causes: list[str]):
        parts = ", ".join(f"{name} {value:.3g}" for name, value in channels.items())
        size = f"the residual is {gap:.3g} times the floor (mean square; {parts})"
        super().__init__(f"{size}: too large for any missing effect")
        self.gap, self.channels, self.causes = gap, channels, causes

    def report(self, json: bool, **more: object) -> int:
        """Prints the error, with `json` also as JSON; returns the exit code."""
        console.say(str(self), *(f"  {cause}" for cause in self.causes), "to search anyway, add --anyway")
        if json:
            console.emit_json({"reason": str(self), "gap": self.gap, "channels": self.channels, "causes": self.causes} | more)
        return console.CANNOT_TELL


class Pair(NamedTuple):
    """One channel, measured and predicted: all records concatenated, each without its mean."""

    measured: np.ndarray
    predicted: np.ndarray
    offset: float  # mean of measured less predicted

    @property
    def ratio(self) -> float:
        """Ratio of amplitudes, measured over predicted."""
        return float(np.std(self.measured) / max(np.std(self.predicted), 1e-12))

    @property
    def correlation(self) -> float:
        """Correlation of measured and predicted values; 0 if either is constant."""
        scale = float(np.std(self.measured) * np.std(self.predicted))
        return float(np.mean(self.measured * self.predicted)) / scale if scale > 0 else 0.0


def admit(e: Likelihood, anyway: bool = False) -> None:
    """Refuses a search if the gap is too large. anyway: the user has accepted such a gap.

    Raises TooDifferent: the gap is above BEYOND, or above FAR with a recognised cause, and `anyway` is False.
    """
    gap, channels = e.over_floor(e.model.null)
    if anyway or max(gap, *channels.values()) <= FAR:
        return
    causes = likely(e)
    if not causes and gap <= BEYOND:
        return
    found = TooDifferent(gap, channels, causes or ["no usual cause is recognised; are these logs of this robot?"])
    if console.confirmed("\n".join([str(found), *(f"  {c}" for c in found.causes), "Search all the same?"])):
        return
    raise found


def likely(e: Likelihood) -> list[str]:
    """Likely causes, channel by channel."""
    predictions = e.model.predict(e.records, e.model.null)
    sets = list(zip(e.records, predictions, strict=True))
    joints = [pair(sets, "joint", i) for i in range(e.model.joints)]
    out = [text for i, p in enumerate(joints) for text in of_joint(i, p, joints, partial(following, sets, i))]
    yaw = pair(sets, "pose", 2)
    yaws = [r.pose.values[:, 2] for r in e.records if r.pose is not None]
    jump = max((float(np.quantile(np.abs(np.diff(values)), 0.9)) for values in yaws), default=0)
    if jump > JUMP:
        out.append(f"heading: jumps by {jump:.1f} rad from frame to frame: is it in degrees?")
    elif yaw is not None and moves(yaw, "yaw"):
        out += units("heading", yaw, "yaw")
        if yaw.correlation < AGAINST:
            out.append(f"heading: opposite to the model (correlation {yaw.correlation:.2f}): mirrored yaw or image?")
    out += of_path(sets)
    power = pair(sets, "power", 0)
    return out + (units("power", power, "power") if power is not None and moves(power, "power") else [])


def pair(sets, sensor: str, column: int) -> Pair | None:
    """One column over all records that have it."""
    measured, predicted, offsets = [], [], []
    for record, prediction in sets:
        given = getattr(record, sensor)
        if given is not None and given.values.shape[1] > column:
            m, p = given.values[:, column], prediction[sensor][0][:, column]
            offsets.append(float(np.mean(m - p)))
            measured.append(m - m.mean())
            predicted.append(p - p.mean())
    if not measured:
        return None
    return Pair(np.concatenate(measured), np.concatenate(predicted), float(np.median(offsets)))


def following(sets, i: int) -> float:
    """Best correlation of a joint with its own prediction, delayed by one of LATE."""
    found = -1.0
    for late in LATE:
        shifted = []
        for record, prediction in sets:
            if record.joint is not None:
                t, values = record.joint.t, prediction["joint"][0]
                moved = np.stack([np.interp(t - late, t, column) for column in values.T], 1)
                shifted.append((record, {"joint": moved[None]}))
        p = pair(shifted, "joint", i)
        found = max(found, -1.0 if p is None else p.correlation)
    return found


def moves(p: Pair, kind: str) -> bool:
    """Returns True if the model moves enough for a meaningful amplitude ratio."""
    return float(np.std(p.predicted)) > MOVES[kind]


def units(name: str, p: Pair, kind: str) -> list[str]:
    """Likely unit error, if the amplitudes have the ratio of two units; else []."""
    for factor, unit in UNITS[kind]:
        for ratio, text in ((p.ratio, f"in {unit}"), (1 / max(p.ratio, 1e-12), f"divided by {factor:g} once too often")):
            if factor / NEAR < ratio < factor * NEAR:
                return [f"{name}: moves {p.ratio:.3g} times as far as the model: {text}?"]
    return []


def of_joint(i: int, p: Pair | None, joints: list, late: Callable[[], float] = lambda: -1.0) -> list[str]:
    """Likely causes for one joint: unit, sign, order, zero, power.

    late: best correlation with its own delayed prediction. In a gait each joint moves like the one before it, a sixth of a beat
    later, so a delayed joint could be mistaken for its neighbour.
    """
    name = f"joint {i + 1}"
    if p is None:
        return []
    zero = [f"{name}: {np.degrees(p.offset):.0f} deg off on average: wrong zero?"] if abs(p.offset) > BENT else []
    if not moves(p, "joint"):
        return zero
    out = units(name, p, "joint")
    if p.correlation < AGAINST:
        against = f"{name}: opposite to the model (correlation {p.correlation:.2f}): wrong sign of its angle or its command?"
        return [*out, against]
    if out:
        return out
    if p.ratio < STILL:
        return [f"{name}: moves {p.ratio:.0%} of its commanded motion: unpowered, or the wrong column?"]
    across = [-1.0 if q is None or k == i else _across(p, q) for k, q in enumerate(joints)]
    if p.correlation < ALIKE < max(across) and max(across) > p.correlation + 0.2 and late() < max(across):
        return [f"{name}: follows the command of joint {int(np.argmax(across)) + 1}: joints in another order?"]
    return zero


def _across(p: Pair, other: Pair) -> float:
    """Correlation of one joint's measurement with another's prediction."""
    if len(p.measured) != len(other.predicted):
        return -1.0
    return p._replace(predicted=other.predicted).correlation


def of_path(sets) -> list[str]:
    """Likely causes for the path: unit, mirroring, rotation or origin of the frame."""
    steps, away = [], []
    for record, prediction in sets:
        if record.pose is None:
            continue
        m, p = record.pose.values[:, :2], prediction["pose"][0][:, :2]
        steps.append((m - m[0], p - p[0]))
        away.append(float(np.hypot(*(record.start[:2] - record.place[:2]))))
    if not steps:
        return []
    measured, predicted = (np.concatenate([s[k] for s in steps]) @ np.array([1.0, 1.0j]) for k in (0, 1))
    far = max(away)
    origin = [f"position: the fish starts {far:.2g} m from its stated start: another origin of the frame?"] if far > AWAY else []
    sizes = [float(np.sqrt(np.mean(np.abs(path) ** 2))) for path in (measured, predicted)]
    if sizes[1] < MOVES["path"]:
        return origin
    scaled = units("position", Pair(np.array([0.0, sizes[0]]), np.array([0.0, sizes[1]]), 0.0), "path")
    scale = max(sizes[0] * sizes[1], 1e-12)
    straight, mirrored = (np.mean(measured * np.conj(q)) / scale for q in (predicted, np.conj(predicted)))
    out = scaled or origin
    if abs(mirrored) > ALIKE and abs(mirrored) > abs(straight) + 0.2:
        out.append(f"position: fits the model's mirror image (coherence {abs(mirrored):.2f}, unmirrored {abs(straight):.2f})")
    elif abs(straight) > ALIKE and abs(np.angle(straight)) > TURNED:
        out.append(f"position: path is {np.degrees(np.angle(straight)):.0f} deg off the model's: rotated frame or heading?")
    return out
