"""Physical checks of a whole trial: signs, headings and readings that no swimming robot produces.

`trial_check` judges one table by the schema and by magnitudes. These checks compare tables with each other. `CHECKS` is the list;
every threshold is a bound of `data/calib/plausible.toml` (with unit and source) that a trial relaxes in `[plausible]`.
`log import`, `log check`, `gap find` and `calibrate` run the same list. A trial without the needed motion (no turn, no swim, no
command) passes.

    failed read     reading that leaves the joint's path and returns within a few rows: the servo did not answer
    lost pose       pose that jumps away and comes back: the camera lost the fish, or took its tail for its head; or that stays
    two sources     rows that alternate between two paths: two publishers on one topic
    joint speed     steps that no servo can follow
    standing still  commands move, the joint does not, in all of the trial or from some time on
    stale reading   a moving joint repeats its last value, or the pose does while joints move, or is filled in between
    joint sign      a joint that runs against its command at every plausible delay
    joint scale     a joint that moves by a multiple, or a small part, of its command
    joint order     two joints that follow each other's commands
    joint frame     angles of links against the head or the tank, not against the link before
    heading         course over ground against yaw: clockwise, offset by 90 or 180 deg, its unit, of another body; folded
    handedness      the head recoils against the tail's swing, at its beat; a picture in a mirror shows it swing along
    wave            the body wave of a fish that swims ahead runs to its tail
    velocity        measured velocity of another scale, sign or axes than the way of the pose
    turning         measured rate of turn of another scale or sign than that of the pose
    stride          way of a beat over the body's length, where that is known: the scale of the positions
    sway            sway of the body for the swing of its head: positions that are too small
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial
from itertools import pairwise
from math import pi
from typing import NamedTuple

import numpy as np

from fishmj.base.errors import LogError
from fishmj.log.course import (
    DRIVEN,
    FEWEST,
    IMPORT,
    NOTE,
    USE,
    drifts,
    handedness,
    heading,
    stride,
    sway,
    wave,
)
from fishmj.log.joint_checks import joint_frame, joint_order, joint_scale, joint_sign, standing_still
from fishmj.log.measured_rates import turning, velocity
from fishmj.log.trial import Trial
from fishmj.log.trial_check import Plausible, bounds_of
from fishmj.log.unread_rows import (
    MANY,
    OFTEN,
    UNREAD,
    failed_reads,
    failed_rows,
    folds,
    fresh_rows,
    is_coarse,
    is_sound,
    joints,
    leaps,
    left_out,
    lost_poses,
    speeds,
)

APART_BY = {"c": 0.02, "j": 0.02, "x": 0.01, "y": 0.01}  # rad, m: least distance between two sources
RELEASED = 0.02  # m from a pose that was held to the next one
ECHO = 5  # rows by which an echo of a command is late, at most
FROZEN = 0.5  # s of one pose to the last digit while the joints move
ANSWER = 0.4  # s in which a fish at rest answers its joints, and the camera shows it
GONE = 0.25  # of the way at its usual speed by which a fish has gone on behind a pose that repeats; less is a rest
OLD = 0.01  # share of rows that repeat a pose for less than that, or were filled in, from which it is noted
LINE, ROUNDED = 5e-3, 0.03  # of the usual bend between rows, on a straight line: exact numbers, and rounded ones at most
FILLED, RESAMPLED = 3, 0.2  # rows of one line; share of rows on lines from which shorter ones count
STEPS = 1.5  # of the numbers' last digit from row to row, up to which a line is one of rounding: a fish that rests or drifts
SHORTEST = 0.05  # m, of a robotic fish


class PhysicalFinding(NamedTuple):
    """One breach. level: IMPORT, USE or NOTE. text: what, where, got, expected, what to do."""

    check: str
    level: str
    text: str


class PhysicalCheck(NamedTuple):
    """One row of the list. bound: key of plausible.toml that relaxes it; find: yields (level, text) of a trial."""

    name: str
    condition: str
    bound: str
    find: Callable[[Trial, Plausible], Iterator[tuple[str, str]]]


def examine(trial: Trial, only: Iterable[str] = (), length: float = 0.0) -> list[PhysicalFinding]:
    """Findings of all checks on one trial; [] if it is sound or lacks the needed motion.

    Args:
        only: names of checks; all by default. length: of the robot [m]; without it sway is judged for the shortest, stride not.

    Raises LogError: a table has no rows, or `[plausible]` of the trial is no table of bounds.
    """
    for table, columns in trial.tables.items():
        if not min(map(np.size, columns.values()), default=0):
            raise LogError(f"{trial.name or 'trial'}: table {table!r} has no rows; leave an empty table out of the trial")
    bounds = bounds_of(trial.meta, trial.name or "trial")
    about = "body lengths that a beat carries the fish through the water"
    scale = PhysicalCheck("stride", about, "stride", partial(stride, length=length))
    aside = "sway of the body over its length, for a radian that the head swings"
    small = PhysicalCheck("sway", aside, "sway", partial(sway, length=length or SHORTEST))
    checks = (*CHECKS, scale, small) if length else (*CHECKS, small)
    wanted = set(only) or {check.name for check in checks}
    found = lost_poses(trial.tables.get("pose", {}), bounds)
    seen = _without_lost(trial, found[0])
    return [
        PhysicalFinding(check.name, level, f"{text}; if it is right, allow it with {check.bound} in [plausible] of meta.toml")
        for check in checks
        if check.name in wanted
        for level, text in (_lost_poses(trial, bounds, found) if check.find is _lost_poses else check.find(seen, bounds))
    ]


def _without_lost(trial: Trial, lost: np.ndarray) -> Trial:
    """The trial without the rows of its lost poses (T,), where these are many."""
    if not lost.size or lost.mean() <= MANY:
        return trial
    pose = {column: np.asarray(values)[~lost] for column, values in trial.tables["pose"].items()}
    return replace(trial, tables={**trial.tables, "pose": pose})


def without_failed_reads(trial: Trial) -> tuple[Trial, list[str]]:
    """The trial without the rows in which a joint was not read, the fish was not seen or a sensor had no new value, and notes."""
    bounds = bounds_of(trial.meta, trial.name or "trial")
    tables, notes = dict(trial.tables), []
    for name in (name for name in UNREAD if name in tables):
        bad, told = left_out(name, tables[name], bounds)
        if bad.any():
            tables[name] = {column: np.asarray(values)[~bad] for column, values in tables[name].items()}
            notes += told
    for name in tables:
        if is_sound(tables[name], list(tables[name])):
            rows, told = fresh_rows(name, tables[name])
            tables[name] = {c: np.asarray(v)[rows] for c, v in tables[name].items()} if told else tables[name]
            notes += told
    return (replace(trial, tables=tables), notes) if notes else (trial, [])


# ------------------------------------------------------------------------------------------------------------------ checks
def _failed_reads(trial: Trial, bounds: Plausible) -> Iterator[tuple[str, str]]:
    if "joint" in trial.tables:
        yield from _to_leave_out(failed_reads(trial.tables["joint"], bounds)[1])


def _to_leave_out(notes: list[str]) -> Iterator[tuple[str, str]]:
    return ((USE, note.replace(" left out, ", " to leave out, ")) for note in notes)


def _lost_poses(trial: Trial, bounds: Plausible, found: tuple[np.ndarray, list[str]] | None = None) -> Iterator[tuple[str, str]]:
    pose = trial.tables.get("pose", {})
    lost, notes = found or lost_poses(pose, bounds)
    yield from _to_leave_out(notes)
    if not is_sound(pose, ["t", "x", "y", "yaw"]):
        return
    paces = np.hypot(*drifts(pose)[1])
    if len(paces) >= FEWEST and (pace := float(np.median(paces))) > bounds.leap:
        yield (
            USE,
            f"pose: the fish moves at {pace:.3g} m/s (median over a second; at most {bounds.leap:g} m/s is plausible): are x and"
            " y in cm, or in px? State their unit or scale in the map",
        )
    t, x, y, yaw = (np.asarray(pose[name], float)[~lost] for name in ("t", "x", "y", "yaw"))
    few = max(4, len(t) / 50)
    turn = np.abs(np.angle(np.exp(1j * np.diff(yaw))))
    rows = np.flatnonzero((turn > 1.5) & (turn > bounds.rate * np.diff(t)))
    if not len(folds(pose)) and 0 < len(rows) < few:
        yield (
            USE,
            f"pose: yaw jumps by {np.degrees(turn[rows[0]]):.0f} deg at t = {t[rows[0] + 1]:.3f} s ({len(rows)} such rows) and"
            " stays there: did the tracker take the tail for the head? Split the file there",
        )
    for name, step in (("x", np.abs(np.diff(x))), ("y", np.abs(np.diff(y)))):
        rows = leaps(name, t, step, bounds)
        if 0 < len(rows) < few:
            yield (
                USE,
                f"pose: {name} jumps by {step[rows[0]]:.2g} m at t = {t[rows[0] + 1]:.3f} s ({len(rows)} such rows) and stays"
                " there: was the fish moved, or is it a second run? Split the log there",
            )
            break


def _two_sources(trial: Trial, bounds: Plausible) -> Iterator[tuple[str, str]]:
    for table, letters in (("cmd", "c"), ("joint", "j"), ("pose", "xy")):
        columns = trial.tables.get(table, {})
        for name in columns:
            if name[0] not in letters or not (name in ("x", "y") or name[1:].isdecimal()) or len(columns["t"]) < 20:
                continue
            t, x = np.asarray(columns["t"], float), np.asarray(columns[name], float)
            near, far = (float(np.median(np.abs(_between(t, x, rows)))) for rows in (1, 2))
            if near > APART_BY[name[0]] and near > bounds.alternate * far:
                unit = "m" if table == "pose" else "rad"
                yield (
                    IMPORT,
                    f"{table}: {name} alternates row by row between two paths, {near:.2g} {unit} apart in the median (within each"
                    f" {far:.2g}): two publishers on one topic, or commands among the measurements? Record each on its own topic,"
                    " or leave one out",
                )
                break


def _between(t: np.ndarray, x: np.ndarray, rows: int) -> np.ndarray:
    """(T - 2 rows,) difference of each value from the line through the values `rows` before and after it."""
    early, late = slice(None, -2 * rows), slice(2 * rows, None)
    part = (t[rows:-rows] - t[early]) / (t[late] - t[early])
    return x[rows:-rows] - (1 - part) * x[early] - part * x[late]


def _joint_speed(trial: Trial, bounds: Plausible) -> Iterator[tuple[str, str]]:
    table = trial.tables.get("joint", {})
    for name in joints(table):
        t, x = np.asarray(table["t"], float), np.asarray(table[name], float)
        good = ~failed_rows(t, x, bounds)
        t, x = t[good], x[good]
        step, speed = np.abs(np.diff(x)), speeds(t, x)
        usual = float(np.quantile(np.abs(np.diff(x, 2)), 0.75)) if len(x) > 2 else 0.0
        rows = np.flatnonzero((speed > bounds.rate) & (step > max(2 * bounds.spike, 5 * usual if usual < bounds.spike else 0.0)))
        if len(rows):
            i = int(rows[0])
            turns = np.abs(step[rows] - 2 * pi) < 0.3
            why = "the encoder wraps at a turn: unwrap it" if turns.all() else "are angle and time in the stated units?"
            text = (
                f"joint: {name} jumps by {step[i]:.3g} rad, {speed[i]:.3g} rad/s, at t = {t[i + 1]:.3f} s"
                f" ({len(rows)} such rows); at most {bounds.rate:.3g} rad/s is plausible; {why}"
            )
            yield IMPORT, text


def _stale(trial: Trial, bounds: Plausible) -> Iterator[tuple[str, str]]:
    yield from _frozen_pose(trial, bounds)
    yield from _interpolated_pose(trial, bounds)
    table, cmd = trial.tables.get("joint", {}), trial.tables.get("cmd", {})
    pairs = [(name, cmd[f"c{name[1:]}"], table[name]) for name in joints(table) if f"c{name[1:]}" in cmd]
    echo = lambda c, j: np.ptp(c) > 2 * DRIVEN and any(np.array_equal(c[: len(c) - k], j[k:]) for k in range(ECHO))
    if echoes := [name for name, c, j in pairs if len(j) > 50 and bounds.stale < 1 and echo(c, j)]:
        text = f"joint: {', '.join(echoes)}: equal to the command to the last digit: an echo of it, no measurement? Leave it out"
        yield NOTE, text
    names = joints(table)
    if len(names) < 2:
        return
    values = np.stack([np.asarray(table[name], float) for name in names], 1)
    if len(values) < 20:
        return
    steps = np.diff(values, axis=0)
    same = steps[1:-1] == 0
    for k, name in enumerate(names):
        count = np.min(np.abs(steps[:, k])[steps[:, k] != 0], initial=np.inf)
        before, after = steps[:-2, k], steps[2:, k]
        moving = (before * after > 0) & (np.minimum(np.abs(before), np.abs(after)) > max(0.01, 3 * count))
        rows = moving & same[:, k] & ~np.delete(same, k, axis=1).any(1)  # all the others were read anew
        if moving.sum() >= 20 and rows.sum() >= max(OFTEN, bounds.stale * moving.sum()):
            text = (
                f"joint: {name} repeats its last value in {int(rows.sum())} of {int(moving.sum())} rows in which it moves"
                " and the other joints change: a failed read that returns the last value?"
            )
            yield NOTE, text


def _frozen_pose(trial: Trial, bounds: Plausible) -> Iterator[tuple[str, str]]:
    pose, bent = trial.tables.get("pose", {}), trial.tables.get("joint", trial.tables.get("cmd", {}))
    angles = [name for name in bent if name[0] in "jc" and name[1:].isdecimal()]
    if not is_sound(pose, ["t", "x", "y", "yaw"]):
        return
    t, clock = np.asarray(pose["t"], float), np.asarray(bent.get("t", ()), float)
    values = np.stack([pose["x"], pose["y"], np.unwrap(pose["yaw"])])
    steps = np.abs(np.diff(values))
    ends = np.append(np.flatnonzero(steps.any(0)) + 1, len(t))
    pace = (steps**2 / np.maximum(np.diff(t), 1e-6)).sum(1) / np.maximum(steps.sum(1), 1e-12)  # speed, weighed by the way
    digit = np.min(np.where(steps > 0, steps, np.inf), axis=1, initial=np.inf)

    def missed(a: int, b: int) -> bool:
        """Returns True if the fish is elsewhere after rows a to b - 1 of one pose: it did not rest."""
        leap = np.abs(values[:, min(b, len(t) - 1)] - values[:, a])
        return bool((leap > np.maximum(GONE * pace * (t[min(b, len(t) - 1)] - t[a]), 1.5 * digit)).any())

    def bend(first: float, last: float) -> float:
        at = (clock >= first) & (clock <= last)
        return max((np.ptp(bent[name][at]) for name in angles if at.any()), default=0.0)

    def moved(a: int, b: int) -> bool:
        """Returns True if the joints, or the fish without joints, move in rows a to b - 1, and not just before an answer."""
        if not angles:
            return b < len(t) and float(np.hypot(*(values[:2, b] - values[:2, b - 1]))) > RELEASED
        return bend(t[a], t[b - 1] - ANSWER * (not missed(a, b))) > 2 * DRIVEN

    runs = [(a, b) for a, b in pairwise(ends) if t[b - 1] - t[a] >= FROZEN and b - a > FEWEST]
    held = [(t[a], t[b - 1]) for a, b in runs if moved(a, b)]
    whole = sum(b - a for a, b in held)
    doing = "the joints move" if angles else "the fish goes on"
    if held and len(ends) > 20 and whole > bounds.stale * (t[-1] - t[0]):
        text = (
            f"pose: x, y and yaw repeat their values for {whole:.3g} s, first at t = {held[0][0]:.3f} s, while {doing}:"
            " did the tracker stop? Leave these cells blank, or split the file there"
        )
        yield USE, text
    short = [(a, b) for a, b in pairwise((0, *ends)) if b - a > 1 and t[b - 1] - t[a] < FROZEN and missed(a, b)]
    rows = sum(b - a - 1 for a, b in _of_a_swim(trial, short))
    if bounds.stale < 1 and rows >= max(OFTEN, OLD * len(t)) and not is_coarse(steps):
        text = (
            f"pose: {rows} of {len(t)} rows repeat the pose of the row before, while {doing}, and are read as if measured at"
            " their own time: is the camera slower than the log, or did it miss frames? Leave these cells blank, or stamp the"
            " poses by the camera's own clock"
        )
        yield NOTE, text


def _interpolated_pose(trial: Trial, bounds: Plausible) -> Iterator[tuple[str, str]]:
    pose = trial.tables.get("pose", {})
    if bounds.stale >= 1 or not is_sound(pose, ["t", "x", "y", "yaw"]) or len(pose["t"]) < 20:
        return
    t, yaw = np.asarray(pose["t"], float), np.unwrap(np.asarray(pose["yaw"], float))
    values = np.stack([np.asarray(pose["x"], float), np.asarray(pose["y"], float), yaw])
    off = np.abs([_between(t, column, 1) for column in values])
    usual, steps = np.quantile(off, 0.9, axis=1, keepdims=True), np.abs(np.diff(values))
    digit = np.min(np.where(steps > 0, steps, np.inf), axis=1, keepdims=True)  # in which filled rows are rounded
    near = np.maximum(LINE * usual, np.minimum(1.1 * digit, ROUNDED * usual))
    goes = np.any(steps[:2] > 0, axis=0)
    line = np.r_[False, np.all(off <= near, axis=0) & goes[1:] & goes[:-1], False]
    edges = np.flatnonzero(np.diff(line)) + 1
    step = lambda a, b: np.abs(values[:2, b] - values[:2, a - 1]) / (b - a + 1)
    far = lambda a, b: bool((step(a, b) > STEPS * digit[:2, 0]).any())  # else rounding alone makes it straight
    lines = [(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if far(a, b)]
    resampled = sum(b - a for a, b in lines) > RESAMPLED * len(t)
    runs = [(a, b) for a, b in lines if b - a >= FILLED or resampled]
    rows = sum(b - a for a, b in _of_a_swim(trial, runs))
    if rows >= max(OFTEN, OLD * len(t)) and not is_coarse(off):
        text = (
            f"pose: {rows} of {len(t)} rows lie on straight lines between others, first at t = {t[runs[0][0]]:.3f} s, while the"
            " fish swims, and are read as measured: were they interpolated? Leave these cells blank, or import the camera's own"
            " rows with their own stamps"
        )
        yield NOTE, text


def _of_a_swim(trial: Trial, runs: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Those of some runs of rows of `pose`, (first, end), near which the joints move, or without joints the fish."""
    pose, bent = trial.tables["pose"], trial.tables.get("joint", trial.tables.get("cmd", {}))
    angles = [bent[name] for name in bent if name[0] in "jc" and name[1:].isdecimal()]
    clock, seen, least = (bent["t"], angles, 2 * DRIVEN) if angles else (pose["t"], [pose["x"], pose["y"]], RELEASED)
    t = np.asarray(pose["t"], float)
    near = np.searchsorted(clock, [(t[a] - FROZEN, t[b - 1] + FROZEN) for a, b in runs]).reshape(-1, 2)
    return [run for run, (i, j) in zip(runs, near, strict=True) if any(np.ptp(v[i:j]) > least for v in seen if i < j)]


CHECKS = (
    PhysicalCheck("failed read", "a reading leaves the joint's path and returns within 5 rows", "spike", _failed_reads),
    PhysicalCheck("lost pose", "x, y or yaw jumps away and back within 1 s, faster than a fish", "leap", _lost_poses),
    PhysicalCheck("two sources", "distance between alternate rows over that within each source", "alternate", _two_sources),
    PhysicalCheck("joint speed", "a step between two rows is faster than any servo", "rate", _joint_speed),
    PhysicalCheck("standing still", "the joint moves by less than this share of its command", "still", standing_still),
    PhysicalCheck("stale reading", "share of moving rows that repeat the last value", "stale", _stale),
    PhysicalCheck("joint sign", "correlation with the command, negative at every delay to 0.3 s", "against", joint_sign),
    PhysicalCheck("joint scale", "movement of a joint over that of its command", "gain", joint_scale),
    PhysicalCheck("joint order", "two joints follow each other's commands and not their own", "against", joint_order),
    PhysicalCheck("joint frame", "correlation with the heading, or with the sum of the commands to here", "against", joint_frame),
    PhysicalCheck("heading", "course over ground against yaw: sense, offset, unit", "course", heading),
    PhysicalCheck("handedness", "correlation of yaw rate with the tail's rate, positive to 0.2 s", "hand", handedness),
    PhysicalCheck("wave", "sine of the lag from joint to joint of a fish that swims ahead, negative", "wave", wave),
    PhysicalCheck("velocity", "velocity over that of the pose, or against it", "agree", velocity),
    PhysicalCheck("turning", "measured rate of turn over that of yaw, or against it", "agree", turning),
)
JOINTS = tuple(
    check.name for check in CHECKS if check.find not in (_lost_poses, heading, handedness, wave, velocity, turning)
)  # need no camera
