"""Physical checks of a whole trial: signs, headings and readings that no swimming robot produces.

`trial_check` judges one table by the schema and by magnitudes. These checks compare tables with each other. `CHECKS` is the list;
every threshold is a bound of `data/calib/plausible.toml` (unit and source stand there) that a trial relaxes in `[plausible]`.
`log import`, `log check`, `gap find` and `calibrate` run the same list. A trial that cannot tell (no turn, no swim, no command)
passes.

    failed read     reading that leaves the joint's path and returns within a few rows: the servo did not answer
    joint speed     steps that no servo can follow
    standing still  commands move, the joint does not
    stale reading   a moving joint repeats its last value
    joint sign      a joint that runs against its command at every plausible delay
    heading         course over ground against yaw: clockwise, offset by 90 or 180 deg, in degrees
    handedness      the head recoils against the tail's swing; a picture in a mirror shows it swing along
"""

from cmath import phase
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from math import log, pi, sqrt
from typing import NamedTuple

import numpy as np

from fishmj.log.trial import Table, Trial, stacked
from fishmj.log.trial_check import Plausible, bounds_of

IMPORT, USE, NOTE = "import", "use", "note"  # a finding refuses: the import and all after it; gap find and calibrate; nothing
LONGEST = 3600.0  # s of a trial that are looked at
GRID = 0.02  # s, step of the common clock on which channels are compared
SHORT, OFTEN = 5, 3  # rows of one failed read at most; times that the same value must come back
DRIVEN = 0.05  # rad, span of a command that moves a joint
FOLLOWS = np.arange(0.0, 0.31, GRID)  # s by which a joint follows its command
SEEN = np.arange(0.0, 0.21, GRID)  # s by which a camera's heading is late behind the joints; behind the commands: FOLLOWS
BEAT = 0.5  # rad/s, root mean square of the tail's rate from which a recoil is expected
OTHER = 0.4  # correlation of the opposite sign from which the sign is not told
PACE, APART = 1.0, 0.25  # s over which a course is taken, and between two of them
TURN = 0.5  # rad that a course must turn through before a heading's sense is told
CLEAR = 0.25  # rad, scatter of course against heading that still counts as one relation
FEWEST = 8  # courses
NEAR = 20.0  # deg from a quarter turn that still is one


class Finding(NamedTuple):
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


def examine(trial: Trial, only: Iterable[str] = ()) -> list[Finding]:
    """Findings of all checks on one trial; [] where it is sound or cannot tell.

    Args:
        only: names of checks; all by default.
    Raises:
        LogError: `[plausible]` of the trial is no table of bounds.
    """
    bounds = bounds_of(trial.meta, trial.name or "trial")
    wanted = set(only) or {check.name for check in CHECKS}
    return [
        Finding(check.name, level, f"{text}; if it is right, allow it with {check.bound} in [plausible] of meta.toml")
        for check in CHECKS
        if check.name in wanted
        for level, text in check.find(trial, bounds)
    ]


def without_failed_reads(trial: Trial) -> tuple[Trial, list[str]]:
    """The trial without the rows in which a joint was not read, and a note on them; the trial itself where there are none."""
    table = trial.tables.get("joint")
    if table is None:
        return trial, []
    bad, notes = failed_reads(table, bounds_of(trial.meta, trial.name or "trial"))
    if not bad.any():
        return trial, []
    kept = {column: np.asarray(values)[~bad] for column, values in table.items()}
    return replace(trial, tables={**trial.tables, "joint": kept}), notes


def failed_reads(table: Table, bounds: Plausible) -> tuple[np.ndarray, list[str]]:
    """(T,) bool rows of `joint` in which a joint was not read, and one note where there are some; none of a damaged table."""
    names = [name for name in ("t", *_joints(table)) if name in table]
    columns = [np.asarray(table[name]) for name in names]
    sound = names[:1] == ["t"] and all(c.ndim == 1 and c.dtype.kind in "fiub" and np.isfinite(c).all() for c in columns)
    if not sound or len({len(c) for c in columns}) > 1:
        return np.zeros(len(columns[0]) if columns else 0, bool), []
    t = columns[0].astype(float)
    bad, told = np.zeros(len(t), bool), []
    for name in _joints(table):
        x = np.asarray(table[name], float)
        rows = _failed(t, x, bounds)
        if rows.any():
            first = int(np.argmax(rows))
            values = sorted(set(np.round(x[rows], 4)))
            seen = f"{values[0]:g} rad" if len(values) == 1 else f"{values[0]:g} to {values[-1]:g} rad"
            fast = _speeds(t, x)[rows[1:] | rows[:-1]].max()
            told.append(f"{name} {int(rows.sum())} times ({seen}, first at t = {t[first]:.3f} s, a jump of {fast:.3g} rad/s)")
            bad |= rows
    if bad.all():
        bad[:] = False
    if not bad.any():
        return bad, []
    return bad, [f"joint: {int(bad.sum())} of {len(t)} rows left out, failed reads of {'; '.join(told)}"]


def _joints(table: Table, letter: str = "j") -> list[str]:
    return [name for name in table if name[0] == letter and name[1:].isdecimal()]


def _speeds(t: np.ndarray, x: np.ndarray) -> np.ndarray:
    return np.abs(np.diff(x)) / np.maximum(np.diff(t), 1e-6)


def _failed(t: np.ndarray, x: np.ndarray, bounds: Plausible) -> np.ndarray:
    """(T,) bool: readings that leave the path and return within a few rows."""
    bad = np.zeros(len(x), bool)
    for _ in range(4):  # what a driver answers again and again first: beside it a good reading looks like a spike
        rows = np.flatnonzero(~bad)
        if len(rows) < 12:
            break
        found = _recurring(x[rows], bounds)
        if not found.any():
            found = _spikes(t[rows], x[rows], bounds)
        if not found.any():
            break
        bad[rows[found]] = True
    return bad


def _peaks(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """(runs,) first and last row of each run of equal values, how far it stands out on both sides, and what is usual."""
    start = np.flatnonzero(np.r_[True, np.diff(x) != 0])
    end = np.r_[start[1:], len(x)] - 1
    v = x[start]
    if len(v) < 5:
        return start, end, np.zeros(len(v)), np.inf
    up, down = v[1:-1] - v[:-2], v[1:-1] - v[2:]
    out = np.where(up * down > 0, np.minimum(np.abs(up), np.abs(down)), 0.0)
    ends = np.abs([v[0] - v[1], v[-1] - v[-2]])  # the first and the last row have one neighbour
    peak = np.r_[ends[0], out, ends[1]]
    return start, end, np.where(end - start < SHORT, peak, 0.0), float(np.quantile(np.abs(up + down) / 2, 0.75))


def _recurring(x: np.ndarray, bounds: Plausible) -> np.ndarray:
    """Rows of one value that comes back exactly, in short runs, each time far from its neighbours."""
    start, _, peak, _ = _peaks(x)
    large = peak > bounds.spike
    values, counts = np.unique(x[start[large]], return_counts=True)
    for value in values[np.argsort(-counts)][:3]:
        mine, others = x == value, np.flatnonzero(x != value)
        alone, rest = peak[large & (x[start] == value)], x[others]
        if len(alone) < OFTEN or len(rest) < len(x) / 2:
            continue
        usual = _peaks(rest)[3]
        far = np.abs(rest - value).min() > max(0.5, np.ptp(rest))  # beyond all others: wherever it stands
        if far or np.median(alone) > max(bounds.spike, 5 * usual):
            off = np.abs(value - np.interp(np.arange(len(x)), others, rest))  # a joint may pass through it
            return mine & (far | (off > max(bounds.spike / 3, 5 * usual)))
    return np.zeros(len(x), bool)


def _spikes(t: np.ndarray, x: np.ndarray, bounds: Plausible) -> np.ndarray:
    """Rows of peaks that the joint cannot reach and leave in the time that there is."""
    start, end, peak, usual = _peaks(x)
    step = np.abs(np.diff(x[start]))
    fast = step > bounds.rate * (t[start[1:]] - t[end[:-1]])
    found = (peak > max(bounds.spike, 5 * usual)) & np.r_[True, fast] & np.r_[fast, True]
    return np.repeat(found, np.diff(np.r_[start, len(x)]))


# ------------------------------------------------------------------------------------------------------------------ checks
def _failed_reads(trial: Trial, bounds: Plausible) -> Iterator[tuple[str, str]]:
    if "joint" in trial.tables:
        rows, notes = failed_reads(trial.tables["joint"], bounds)
        n, total = int(rows.sum()), len(rows)
        yield from ((USE, note.replace(f"{n} of {total} rows left out, ", f"{n} of {total} rows hold ")) for note in notes)


def _joint_speed(trial: Trial, bounds: Plausible) -> Iterator[tuple[str, str]]:
    table = trial.tables.get("joint", {})
    for name in _joints(table):
        t, x = np.asarray(table["t"], float), np.asarray(table[name], float)
        good = ~_failed(t, x, bounds)
        t, x = t[good], x[good]
        step, speed = np.abs(np.diff(x)), _speeds(t, x)
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


def _standing_still(trial: Trial, bounds: Plausible) -> Iterator[tuple[str, str]]:
    for name, t, c, j in _pairs(trial):
        told, moved = float(np.ptp(c)), float(np.ptp(j))
        if told > 2 * DRIVEN and t[-1] - t[0] > 1.0 and moved < bounds.still * told:
            text = (
                f"joint: {name} stands still ({np.degrees(moved):.2g} deg) while c{name[1:]} moves by {np.degrees(told):.3g} deg;"
                " is the servo unpowered or jammed, or is it another column?"
            )
            yield USE, text


def _stale(trial: Trial, bounds: Plausible) -> Iterator[tuple[str, str]]:
    table = trial.tables.get("joint", {})
    names = _joints(table)
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


def _joint_sign(trial: Trial, bounds: Plausible) -> Iterator[tuple[str, str]]:
    for name, t, c, j in _pairs(trial):
        if np.ptp(c) < DRIVEN or np.ptp(j) < 0.2 * np.ptp(c) or t[-1] - t[0] < 1.0:
            continue
        found = [_correlation(*_late(c, j, lag)) for lag in FOLLOWS]
        worst, best = min(found), max(found)
        if worst < -bounds.against and best < OTHER:
            text = (
                f"joint: {name} runs against its command c{name[1:]} (correlation {worst:.2f}, at no delay up to"
                f" {FOLLOWS[-1]:.1f} s above {best:.2f}); one of the two counts the other way: give columns.{name} or"
                f" columns.c{name[1:]} a sign = -1 in the map"
            )
            yield IMPORT, text


def _heading(trial: Trial, bounds: Plausible) -> Iterator[tuple[str, str]]:
    found = _courses(trial)
    if found is None:
        return
    course, yaw = found
    turned = float(np.ptp(np.unwrap(course)))
    off, mirrored = _relation(course - yaw), _relation(course + yaw)
    scaled = _relation(course - np.radians(yaw))
    mean = np.degrees(off[0])
    if turned > TURN:
        if mirrored[1] < CLEAR and mirrored[1] < off[1] / 3 and bounds.course < pi:
            zero = np.degrees(mirrored[0])
            name = "a compass counts so, from north" if abs(zero - 90) < 25 else "a frame whose z points down counts so"
            text = (
                f"pose: yaw turns clockwise, against the course over ground (they add up to {zero:.0f} deg, scatter"
                f" {np.degrees(mirrored[1]):.0f} deg; expected the same course, counter-clockwise from x); {name}."
                f" In the map give columns.yaw sign = -1 and a zero of {round(zero / 90) * 90:d} deg, in the unit of the file"
            )
            yield IMPORT, text
            return
        if scaled[1] < CLEAR and scaled[1] < off[1] / 3 and np.ptp(yaw) > 10 * turned and bounds.course < pi:
            text = (
                f"pose: yaw turns by {np.ptp(yaw):.3g} while the course turns by {turned:.2g} rad: it is in degrees."
                ' In the map give columns.yaw unit = "deg"'
            )
            yield IMPORT, text
            return
    ahead = _swims_ahead(trial)
    if abs(off[0]) <= bounds.course or off[1] > CLEAR or ahead is False or (turned <= TURN and not ahead):
        return
    told = f"pose: the fish moves {mean:.0f} deg off its heading (scatter {np.degrees(off[1]):.0f} deg)"
    near = round(mean / 90) * 90
    if turned > TURN and near and abs(mean - near) < NEAR:
        yield IMPORT, f"{told}: the heading is offset. In the map give columns.yaw a zero that is {-near:d} deg more"
        return
    compass = np.degrees(np.angle(np.exp(1j * (mirrored[0] - pi / 2))))
    if near and abs(mean - near) < NEAR:
        cause = f"an offset (give columns.yaw a zero that is {-near:d} deg more)"
    elif abs(compass) < NEAR and mirrored[1] < CLEAR:
        cause = "a compass heading, clockwise from north (give columns.yaw sign = -1 and a zero of 90 deg)"
    else:
        cause = "another zero of the heading"
    yield NOTE, f"{told}: {cause}, or a current carries it"


def _handedness(trial: Trial, bounds: Plausible) -> Iterator[tuple[str, str]]:
    if trial.value("medium") == "air" or "pose" not in trial.tables or any(_heading(trial, bounds)):
        return
    pose, measured = trial.tables["pose"], "joint" in trial.tables
    bent = trial.tables.get("joint", trial.tables.get("cmd", {}))
    angles = stacked(bent, "j#" if measured else "c#") if bent else np.zeros((0, 0))
    if min(len(pose["t"]), len(angles)) < 20 or float(np.median(np.diff(pose["t"]))) > 0.1 or not angles.shape[1]:
        return
    grid = _grid(bent["t"], pose["t"])
    if len(grid) < 2.0 / GRID:
        return
    tail = np.interp(grid, bent["t"], angles.sum(1))
    yaw = np.interp(grid, pose["t"], np.unwrap(np.asarray(pose["yaw"], float)))
    swing, turn = (_fast(np.gradient(_smooth(x), GRID)) for x in (tail, yaw))
    if np.std(swing) < BEAT:
        return
    found = [_correlation(*_late(swing, turn, lag)) for lag in (SEEN if measured else FOLLOWS)]
    if max(found) > bounds.hand and min(found) > -OTHER:
        text = (
            f"pose: the head swings with the tail (correlation {max(found):.2f}), a swimming body recoils against it: the"
            " camera's picture is mirrored or a frame counts z down (give columns.y and columns.yaw sign = -1 in the map), yaw"
            " alone counts clockwise (sign = -1), or all joints count the other way (sign = -1 for each c and j)"
        )
        yield USE, text


CHECKS = (
    PhysicalCheck("failed read", "a reading leaves the joint's path and returns within 5 rows", "spike", _failed_reads),
    PhysicalCheck("joint speed", "a step between two rows is faster than any servo", "rate", _joint_speed),
    PhysicalCheck("standing still", "the joint moves by less than this share of its command", "still", _standing_still),
    PhysicalCheck("stale reading", "share of moving rows that repeat the last value", "stale", _stale),
    PhysicalCheck("joint sign", "correlation with the command, negative at every delay to 0.3 s", "against", _joint_sign),
    PhysicalCheck("heading", "course over ground against yaw: sense, offset, unit", "course", _heading),
    PhysicalCheck("handedness", "correlation of yaw rate with the tail's rate, positive to 0.2 s", "hand", _handedness),
)
JOINTS = ("failed read", "joint speed", "standing still", "stale reading", "joint sign")  # those that need no camera


# ----------------------------------------------------------------------------------------------------------------- helpers
def _grid(*stamps: np.ndarray) -> np.ndarray:
    """Common clock of several tables; empty where they do not overlap."""
    start = max(float(t[0]) for t in stamps)
    return np.arange(start, min(start + LONGEST, *(float(t[-1]) for t in stamps)), GRID)


def _pairs(trial: Trial) -> Iterator[tuple[str, np.ndarray, np.ndarray, np.ndarray]]:
    """(name, grid, command, joint) of each joint that has a command, less its mean, while its torque is on."""
    cmd, joint = trial.tables.get("cmd", {}), trial.tables.get("joint", {})
    for name in _joints(joint):
        number = name[1:]
        if f"c{number}" not in cmd or len(cmd["t"]) < 2 or len(joint["t"]) < 2:
            continue
        grid = _grid(cmd["t"], joint["t"])
        if f"on{number}" in cmd and len(grid):
            held = np.searchsorted(cmd["t"], grid, side="right") - 1
            grid = grid[np.asarray(cmd[f"on{number}"])[held] > 0]
        if len(grid) < 20:
            continue
        sent = np.searchsorted(cmd["t"], grid, side="right") - 1
        c = np.asarray(cmd[f"c{number}"], float)[sent]
        yield name, grid, c, np.interp(grid, joint["t"], np.asarray(joint[name], float))


def _late(early: np.ndarray, late: np.ndarray, lag: float) -> tuple[np.ndarray, np.ndarray]:
    """Both channels, the second `lag` s later."""
    rows = round(lag / GRID)
    return early[: len(early) - rows], late[rows:]


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    scale = float(np.std(a) * np.std(b))
    return float(np.mean((a - a.mean()) * (b - b.mean()))) / scale if scale > 0 else 0.0


def _mean_over(x: np.ndarray, rows: int) -> np.ndarray:
    """Moving mean, edges repeated."""
    return np.convolve(np.pad(x, (rows // 2, rows - 1 - rows // 2), "edge"), np.ones(rows) / rows, "valid")


def _smooth(x: np.ndarray) -> np.ndarray:
    return _mean_over(_mean_over(x, 5), 5)


def _fast(x: np.ndarray) -> np.ndarray:
    """The part of x within a beat: turns and drifts are taken off."""
    return x - _mean_over(x, round(1.5 / GRID))


def _relation(angle: np.ndarray) -> tuple[float, float]:
    """Circular mean and scatter of angles, rad."""
    mean = complex(np.mean(np.exp(1j * angle)))
    return phase(mean), sqrt(max(-2 * log(max(abs(mean), 1e-9)), 0.0))


def _swims_ahead(trial: Trial) -> bool | None:
    """A wave runs down the tail and bends it to both sides alike; None where no joint is logged."""
    table, letter = next(((trial.tables[n], c) for n, c in (("joint", "j#"), ("cmd", "c#")) if n in trial.tables), (None, ""))
    if table is None:
        return None
    q = stacked(table, letter)
    if len(q) < 3:
        return False
    swing = np.std(q, axis=0)
    if not q.shape[1] or np.max(swing) < DRIVEN or np.any(np.abs(q.mean(0)) > np.max(swing)):
        return False
    if q.shape[1] == 1:
        return True
    first, last = q[:, 0] - q[:, 0].mean(), q[:, -1] - q[:, -1].mean()
    rate = [np.gradient(x, np.asarray(table["t"], float)) for x in (first, last)]
    lag = np.mean(first * rate[1] - rate[0] * last) / max(np.std(first) * np.std(rate[1]), np.std(last) * np.std(rate[0]), 1e-12)
    return bool(lag > 0.3)  # twice the sine of the lag, of one beat


def _courses(trial: Trial) -> tuple[np.ndarray, np.ndarray] | None:
    """Course through the water and mean yaw, rad, over 1 s each, of the stretches that were swum; None of too few."""
    pose = trial.tables.get("pose", {})
    if len(pose.get("t", ())) < 20 or any(np.atleast_1d(trial.value("push", 0.0))):
        return None
    t = np.asarray(pose["t"], float)
    begin = np.arange(t[0], min(t[-1], t[0] + LONGEST) - PACE, APART)
    if len(begin) < FEWEST:
        return None
    stated = (trial.value(f"flow.{key}", 0.0) for key in ("speed", "direction"))
    speed, bearing = (float(value) if isinstance(value, int | float) else 0.0 for value in stated)
    if speed > 0 and trial.value("flow.known") is False:
        return None
    yaw = np.unwrap(np.asarray(pose["yaw"], float))
    total = np.r_[0.0, np.cumsum(np.diff(t) * (yaw[1:] + yaw[:-1]) / 2)]
    moved = [np.interp(begin + PACE, t, pose[k]) - np.interp(begin, t, pose[k]) for k in "xy"]
    vx, vy = moved[0] / PACE - speed * np.cos(bearing), moved[1] / PACE - speed * np.sin(bearing)
    mean = (np.interp(begin + PACE, t, total) - np.interp(begin, t, total)) / PACE
    pace = np.hypot(vx, vy)
    swum = pace > max(0.03, 0.3 * float(np.quantile(pace, 0.9)))
    return (np.arctan2(vy, vx)[swum], mean[swum]) if swum.sum() >= FEWEST else None
