"""Physical checks of the course: where the fish goes against where its camera says that it heads, and how its body swings.

`heading`, `handedness` and `wave` are rows of `physical_checks.CHECKS`; each yields (level, text) of a trial. `stride` and `sway`
judge the scale of the positions. The comparisons of two channels on a common clock stand here too.
"""

from cmath import phase
from collections.abc import Iterator
from math import log, pi, sqrt

import numpy as np

from fishmj.log.trial import Table, Trial, stacked
from fishmj.log.trial_check import Plausible
from fishmj.log.unread_rows import folds, is_sound

IMPORT, USE, NOTE = "import", "use", "note"  # a finding refuses: the import and all after it; gap find and calibrate; nothing
LONGEST = 3600.0  # s of a trial that are looked at
GRID = 0.02  # s, step of the common clock on which channels are compared
DRIVEN = 0.05  # rad, span of a command that moves a joint
FOLLOWS = np.arange(0.0, 0.31, GRID)  # s by which a joint follows its command
SEEN = np.arange(0.0, 0.21, GRID)  # s by which a camera's heading is late behind the joints; behind the commands: FOLLOWS
BEAT = 0.5  # rad/s, root mean square of the tail's rate from which a recoil is expected
OTHER = 0.4  # correlation of the opposite sign from which the sign is not told
PACE, APART = 1.0, 0.25  # s over which a course is taken, and between two of them
TURN = 0.5  # rad that a course must turn through before a heading's sense is told
LINEAR, ROUND, RESCALED = 0.98, 4.0, 0.2  # squared correlation of course and heading in two units; rad; logarithm of their ratio
SCALES = {  # unit of a heading -> rad, least turn [rad] of the course that tells it from a current, line of a map
    "degrees": (pi / 180, TURN, 'unit = "deg"'),
    "half-turns": (pi, ROUND, 'unit = "rev" and scale = 0.5'),
    "turns": (2 * pi, ROUND, 'unit = "rev"'),
}
CLEAR = 0.25  # rad, scatter of course against heading that still counts as one relation
FEWEST, MOSTLY = 8, 0.9  # courses; share of them within 60 deg of ahead, or of astern
BEATS, SWING, ALIKE = 2.0, 0.02, 0.7  # of a wave; rad, deviation of its joints; how much of one joint's beat its neighbour shows
DOWN = 0.15  # mean sine of the lag from one joint to the next from which the wave runs to the tail
NEAR = 20.0  # deg from a quarter turn that still is one
APACE, STEADY = 0.03, 0.9  # logarithm of two beats' ratio; share of the power of a steady beat that is in its line
SWINGS, TRAVELS, IDLE = 0.05, 10.0, 0.1  # rad of a free head; way over sway; body lengths a beat, of positions too small
RECOIL = 1.0  # of the tail's rate that a head swings with at most
NOD, SPIN = 0.1, 10.0  # s, rad/s: no head swings faster than this, by recoil or in a turn


def heading(trial: Trial, bounds: Plausible) -> Iterator[tuple[str, str]]:
    """Findings on course over ground against yaw: clockwise, offset, in degrees or turns, of another body."""
    if bounds.course >= pi:
        return
    pose = trial.tables.get("pose", {})
    if is_sound(pose, ["t", "x", "y", "yaw"]) and len(pose["t"]) > 20:
        if len(rows := folds(pose)):
            yield (
                IMPORT,
                f"pose: yaw jumps from one edge of half a turn to the other, {len(rows)} times, first at"
                f" t = {pose['t'][rows[0]]:.3f} s: it is an axis, folded into 180 deg, as of an image's moments; expected the"
                " direction of the nose in a full turn. Unfold the column (numpy.unwrap with a period of half a turn), and add"
                " half a turn if it then points to the tail",
            )
            return
        t, yaw = np.asarray(pose["t"], float), np.unwrap(np.asarray(pose["yaw"], float))
        spin = float(np.quantile(np.abs(np.interp(t + NOD, t, yaw) - yaw), 0.9)) / NOD
        if spin > SPIN:
            yield (
                IMPORT,
                f"pose: yaw turns at {spin:.3g} rad/s (over {NOD:g} s; at most {SPIN:g} is plausible): it is in degrees. In the"
                ' map give columns.yaw unit = "deg"',
            )
            return
    found = _courses(trial)
    if found is None:
        return
    begin, course, yaw = found
    turned = float(np.ptp(np.unwrap(course)))
    off, mirrored = _relation(course - yaw), _relation(course + yaw)
    mean = np.degrees(off[0])
    if turned > TURN:
        if mirrored[1] < CLEAR and mirrored[1] < off[1] / 3:
            zero = np.degrees(mirrored[0])
            name = "a compass counts so, from north" if abs(zero - 90) < 25 else "a frame whose z points down counts so"
            text = (
                f"pose: yaw turns clockwise, against the course over ground (they add up to {zero:.0f} deg, scatter"
                f" {np.degrees(mirrored[1]):.0f} deg; expected the same course, counter-clockwise from x); {name}."
                f" In the map give columns.yaw sign = -1 and a zero of {round(zero / 90) * 90:d} deg, in the unit of the file"
            )
            yield IMPORT, text
            return
        for unit, (factor, least, line) in SCALES.items() if off[1] > CLEAR else ():
            _, _, scaled = _courses(trial, factor) or found
            if _relation(course - scaled)[1] < min(CLEAR, off[1] / 3) and turned > least and np.ptp(scaled) > turned / 2:
                text = (
                    f"pose: yaw turns by {np.ptp(scaled) / factor:.3g} while the course turns by {turned:.2g} rad: it is in"
                    f" {unit}. In the map give columns.yaw {line}; where a current carries the fish, state it as flow in [meta]"
                    " or --flow"
                )
                yield IMPORT, text
                return
        whole = np.unwrap(course)
        slope = float(np.polyfit(yaw, whole, 1)[0]) if correlation(yaw, whole) ** 2 > LINEAR else 1.0
        if max(turned, float(np.ptp(yaw))) > ROUND and off[1] > CLEAR and abs(log(abs(slope))) > RESCALED:
            text = (
                f"pose: yaw turns by {np.ptp(yaw):.3g} rad while the course turns by {turned:.3g} rad, all along: is it in"
                f" another unit, such as a sensor's counts? Values times {slope:.3g} would agree: scale of columns.yaw in the map"
            )
            yield USE, text
            return
        around = np.angle(np.exp(1j * course))
        for low, folded in ((0, np.abs(around)), (-90, np.arcsin(np.sin(around)))):
            alike, back = _relation(folded - yaw), float(np.mean(np.cos(folded - around) < 0.9))
            clear = alike[1] < min(CLEAR, off[1] / 3, float(np.std(folded)) / 3) and 1 - MOSTLY < back < MOSTLY
            if clear and abs(alike[0]) < bounds.course:
                text = (
                    f"pose: yaw turns back where the course goes on, at {low} and {low + 180} deg: it is folded into half a turn,"
                    " as by an arc cosine; expected a full turn. Compute it anew, with atan2 of both components"
                )
                yield IMPORT, text
                return
    ahead = _swims_ahead(trial, begin)
    if turned > TURN and ahead and np.ptp(yaw) < bounds.still * turned:
        text = (
            f"pose: yaw stays within {np.degrees(np.ptp(yaw)):.2g} deg while the course turns by {np.degrees(turned):.0f} deg: is"
            " it the heading of the camera or of another body? Name another column, or leave the pose out"
        )
        yield USE, text
        return
    if ahead and np.ptp(pose["yaw"]) == 0:
        yield NOTE, f"pose: yaw is {yaw[0]:.3g} rad in every row while the fish beats and makes way: is the heading not measured?"
        return
    astern = abs(off[0]) > bounds.course and off[1] < 2 * CLEAR and float(np.mean(np.cos(course - yaw) < -0.5)) >= MOSTLY
    astern &= turned > TURN and _swims_ahead(trial, begin, bent=True) is not False  # in a turn a fish slips to the side
    if not astern and (abs(off[0]) <= bounds.course or off[1] > CLEAR or ahead is False):
        return
    message = f"pose: the fish moves {mean:.0f} deg off its heading (scatter {np.degrees(off[1]):.0f} deg)"
    near = 180 if astern else round(mean / 90) * 90
    if astern or (turned > TURN and near and abs(mean - near) < NEAR):
        zero = f"In the map give columns.yaw a zero that is {-near:d} deg more"
        yield (
            IMPORT,
            f"{message}: the heading is offset. {zero}; where a current carries the fish, state it as flow in [meta] or --flow",
        )
        return
    compass = np.degrees(np.angle(np.exp(1j * (mirrored[0] - pi / 2))))
    if near and abs(mean - near) < NEAR:
        cause = f"an offset (give columns.yaw a zero that is {-near:d} deg more)"
    elif abs(compass) < NEAR and mirrored[1] < CLEAR:
        cause = "a compass heading, clockwise from north (give columns.yaw sign = -1 and a zero of 90 deg)"
    else:
        cause = "another zero of the heading"
    yield NOTE, f"{message}: {cause}, or a current carries it"


def handedness(trial: Trial, bounds: Plausible) -> Iterator[tuple[str, str]]:
    """Findings on the recoil of the head, which swings against the tail."""
    if trial.value("medium") == "air" or "pose" not in trial.tables or any(heading(trial, bounds)):
        return
    pose, measured = trial.tables["pose"], "joint" in trial.tables
    bent = trial.tables.get("joint", trial.tables.get("cmd", {}))
    angles = stacked(bent, "j#" if measured else "c#") if bent else np.zeros((0, 0))
    if min(len(pose["t"]), len(angles)) < 20 or float(np.median(np.diff(pose["t"]))) > 0.1 or not angles.shape[1]:
        return
    grid = common_clock(bent["t"], pose["t"])
    if len(grid) < 2.0 / GRID:
        return
    tail = np.interp(grid, bent["t"], angles.sum(1))
    yaw = np.interp(grid, pose["t"], np.unwrap(np.asarray(pose["yaw"], float)))
    swing, turn = (_fast(np.gradient(mean_over(mean_over(x, 5), 5), GRID)) for x in (tail, yaw))
    if np.std(swing) < BEAT:
        return
    tail, head = _beat(swing), _beat(turn)
    if bounds.hand < 1 and tail and head and abs(log(head / tail)) > APACE and abs(head - tail) > 1 / (len(grid) * GRID):
        beats = f"pose: the head swings at {head:.3g} Hz, the tail at {tail:.3g} Hz: are the camera's frames a second right?"
        yield USE, f"{beats} Its stamps times {head / tail:.3g} would agree: scale of t in [tables.pose] of the map"
        return
    ratio = float(np.quantile(np.abs(turn), 0.75) / np.quantile(np.abs(swing), 0.75))
    if bounds.hand < 1 and ratio > RECOIL:
        text = f"pose: the head swings {ratio:.3g} times as fast as the tail bends (at most {RECOIL:g} is plausible)"
        yield USE, f'{text}: is yaw in degrees? In the map give columns.yaw unit = "deg"'
        return
    found = [correlation(*delayed(swing, turn, lag)) for lag in (SEEN if measured else FOLLOWS)]
    if max(found) > bounds.hand and min(found) > -OTHER:
        text = (
            f"pose: the head swings with the tail (correlation {max(found):.2f}), a swimming body recoils against it: the"
            " camera's picture is mirrored or a frame counts z down (give columns.y and columns.yaw sign = -1 in the map), yaw"
            " alone counts clockwise (sign = -1), all joints count the other way (sign = -1 for each c and j), or the pose"
            " is stamped half a beat late (compare the clocks at one sharp move)"
        )
        yield USE, text


def _beat(x: np.ndarray) -> float:
    """Frequency of a steady beat, Hz; 0 for any other motion."""
    power = np.abs(np.fft.rfft(x * np.hanning(len(x)), 4 * len(x))) ** 2
    top = int(np.argmax(power))
    return top / (4 * len(x) * GRID) if power[max(top - 8, 0) : top + 9].sum() > STEADY * power.sum() else 0.0


def wave(trial: Trial, bounds: Plausible) -> Iterator[tuple[str, str]]:
    """Findings on a body wave that runs to the head of a fish that swims ahead: between all joints, or between two of them."""
    found = _courses(trial)
    if found is None or trial.value("medium") == "air" or any(heading(trial, bounds)):
        return
    begin, course, yaw = found
    letter = "j" if "joint" in trial.tables else "c"
    lag, alike, joint = _phase_lags(trial, begin)
    back = np.flatnonzero((np.sin(lag) < -bounds.wave) & (alike > ALIKE))
    if not len(back) or float(np.mean(np.cos(course - yaw) > 0.5)) < MOSTLY:
        return
    early = ", ".join(f"{letter}{joint[k + 1]} {-np.degrees(lag[k]):.0f} deg before {letter}{joint[k]}" for k in back[:3])
    text = (
        f"{'joint' if letter == 'j' else 'cmd'}: the fish swims ahead, but its wave runs to the head ({early}; expected: behind):"
        " are columns of joints reversed or exchanged (change them over in the map), does a joint count the other way (sign = -1"
        " for its c and j), or does a current carry the fish (state flow)?"
    )
    yield (USE if len(back) == len(lag) else NOTE), text


def stride(trial: Trial, bounds: Plausible, length: float) -> Iterator[tuple[str, str]]:
    """Findings on the way through the water in one beat, over the body's length [m]: the scale of the positions.

    A fish that is pushed, or in an unknown stream, is not judged; nor one that glides.
    """
    found = None if trial.value("flow.known") is False else beating_swim(trial)
    if found is None:
        return
    _, _, (vx, vy), beat = found
    flow, bearing = stated_stream(trial)
    pace = float(np.median(np.hypot(vx - flow * np.cos(bearing), vy - flow * np.sin(bearing))))
    lengths = pace / (beat * length)
    if lengths > bounds.stride:
        yield (
            NOTE,
            f"pose: the fish swims {lengths:.3g} body lengths a beat ({pace:.3g} m/s at {beat:.2g} Hz, {length:.3g} m long;"
            f" expected 0.1 to 1, at most {bounds.stride:g}): is the scale of x and y wrong (metres of a pixel, mm for cm)? Film"
            " a rule, and give columns.x and columns.y its unit or scale in the map; where the fish is towed or a current carries"
            " it, state push or flow",
        )


def sway(trial: Trial, bounds: Plausible, length: float) -> Iterator[tuple[str, str]]:
    """Findings on the sway of a beating fish, over the body's length [m] and the swing of its head [rad]: positions too small.

    A slow way proves nothing: the fish may hold station, or swim badly. But in any current a head swings as the body sways, and
    an angle has no scale. A fish on a stand does not swing, one on a pin goes nowhere: the way must be many times the sway. A
    camera may track the point about which the body turns: the way of a beat must be short, too.
    """
    if (found := beating_swim(trial)) is None:
        return
    grid, way, drift, beat = found
    pose = trial.tables["pose"]
    x, y, yaw = (np.interp(grid, pose["t"], v) for v in (pose["x"], pose["y"], np.unwrap(np.asarray(pose["yaw"], float))))
    swing, mean, place = _fast(mean_over(yaw, 5))[way], mean_over(yaw, round(1.5 / GRID)), (x + 1j * y) / length
    aside = (_fast(mean_over(place, 5)) * np.exp(-1j * mean)).imag[way]
    course = mean_over(place, round(1.5 / GRID))
    sways, swings, lengths = float(np.std(aside)), float(np.std(swing)), float(np.median(np.hypot(*drift))) / (beat * length)
    free = np.hypot(np.ptp(course.real), np.ptp(course.imag)) > TRAVELS * sways > 0
    if swings > SWINGS and free and sways < bounds.sway * swings and lengths < IDLE:
        yield (
            NOTE,
            f"pose: the head swings by {np.degrees(swings):.2g} deg, the body sways by {1e3 * length * sways / swings:.2g} mm a"
            f" radian of it (expected 0.04 to 0.15 body lengths, at least {bounds.sway:g}), and a beat carries it"
            f" {1e3 * length * lengths:.2g} mm (0.1 to 1 body lengths): are x and y too small (mm for cm, metres of a pixel)?"
            " Film a rule, and give columns.x and columns.y its unit or scale in the map; where the camera tracks another point"
            " than the centre of mass, state --marker; where the fish is towed, push",
        )


# ---------------------------------------------------------------------------------------------------------------------- helpers
def beating_swim(trial: Trial) -> tuple[np.ndarray, np.ndarray, np.ndarray, float] | None:
    """Common clock (T,) s, its rows in stretches of `PACE` with a beat, drifts (2, K) m/s in them, and frequency, Hz.

    None for a fish that hardly beats, is pushed or in air, or has no joints or pose.
    """
    table, letter = _bends(trial)
    pose = trial.tables.get("pose", {})
    if table is None or trial.value("medium") == "air" or len(pose.get("t", ())) < 20:
        return None
    q = stacked(table, letter)
    grid = common_clock(table["t"], pose["t"])
    if any(np.atleast_1d(trial.value("push", 0.0))) or not q.shape[1] or len(grid) < 3.0 / GRID:
        return None
    bend = np.interp(grid, table["t"], q[:, int(np.argmax(np.std(q, axis=0)))])
    x = _fast(mean_over(bend, 5))
    begin, drift = drifts(pose)
    rows = [slice(*np.searchsorted(grid, (at, at + PACE))) for at in begin]
    beats = np.array([r.stop - r.start > 0.9 * PACE / GRID and float(np.std(x[r])) > DRIVEN / 2 for r in rows])
    if beats.sum() < FEWEST:
        return None
    way = np.concatenate([np.arange(r.start, r.stop) for r, yes in zip(rows, beats, strict=True) if yes])
    beat = float(np.std(np.gradient(x, GRID)[way]) / np.std(x[way])) / (2 * pi)
    return grid, way, drift[:, beats], beat


def common_clock(*stamps: np.ndarray) -> np.ndarray:
    """Common clock of several tables; empty where they do not overlap."""
    start = max(float(t[0]) for t in stamps)
    return np.arange(start, min(start + LONGEST, *(float(t[-1]) for t in stamps)), GRID)


def delayed(early: np.ndarray, late: np.ndarray, lag: float) -> tuple[np.ndarray, np.ndarray]:
    """Both channels at equal times, the second `lag` s later."""
    rows = round(lag / GRID)
    return early[: len(early) - rows], late[rows:]


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Correlation coefficient; 0 if either channel is constant."""
    scale = float(np.std(a) * np.std(b))
    return float(np.mean((a - a.mean()) * (b - b.mean()))) / scale if scale > 0 else 0.0


def mean_over(x: np.ndarray, rows: int) -> np.ndarray:
    """Moving mean, edges repeated."""
    return np.convolve(np.pad(x, (rows // 2, rows - 1 - rows // 2), "edge"), np.ones(rows) / rows, "valid")


def _fast(x: np.ndarray) -> np.ndarray:
    """Part of x within a beat: turns and drifts are removed."""
    return x - mean_over(x, round(1.5 / GRID))


def _relation(angle: np.ndarray) -> tuple[float, float]:
    """Circular mean and scatter of angles, rad."""
    mean = complex(np.mean(np.exp(1j * angle)))
    return phase(mean), sqrt(max(-2 * log(max(abs(mean), 1e-9)), 0.0))


def _swims_ahead(trial: Trial, begin: np.ndarray, bent: bool = False) -> bool | None:
    """Returns True if a wave runs down the tail and bends it equally to both sides; None if no joint is logged.

    Args:
        begin: starts of the stretches under way. bent: a tail that bends more to one side counts too.
    """
    table, letter = _bends(trial)
    if table is None:
        return None
    q = stacked(table, letter)
    if len(q) < 3:
        return False
    swing = np.std(q, axis=0)
    if not q.shape[1] or np.max(swing) < DRIVEN or (not bent and np.any(np.abs(q.mean(0)) > np.max(swing))):
        return False
    lag, alike, _ = _phase_lags(trial, begin)
    return q.shape[1] == 1 or bool(len(lag) and np.mean(alike * np.sin(lag)) > DOWN)


def _bends(trial: Trial) -> tuple[Table | None, str]:
    """Table of the measured joints, or else of the commanded ones, and the template of its angles."""
    return next(((trial.tables[n], c) for n, c in (("joint", "j#"), ("cmd", "c#")) if n in trial.tables), (None, ""))


def _phase_lags(trial: Trial, begin: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Phase lag [rad] of each moving joint behind the one before, likeness of the two beats, 0 to 1, and the joints' numbers.

    Args:
        begin: starts [s] of the stretches under way, each of `PACE`; the others are left out. Too few beats in them give no lag.

    For a = A sin(wt) and b = B sin(wt - lag): mean(a b' - a' b) = A B w sin(lag), mean(a b) = A B cos(lag) / 2.
    """
    table, letter = _bends(trial)
    q = stacked(table, letter) if table else np.zeros((0, 0))
    grid = common_clock(table["t"], trial.tables["pose"]["t"]) if table and len(q) > 2 and q.shape[1] > 1 else np.zeros(0)
    row = np.searchsorted(begin, grid, side="right") - 1
    way = (row >= 0) & (grid - begin[row] < PACE)
    if table is None or not way.any():
        return np.zeros(0), np.zeros(0), np.zeros(0, int)
    x = np.stack([_fast(mean_over(np.interp(grid, table["t"], angle), 5)) for angle in q.T])
    x, rate = x[:, way], np.gradient(x, GRID, axis=1)[:, way]
    swing, speed = np.std(x, axis=1), np.std(rate, axis=1)
    moving = np.flatnonzero((swing > SWING) & (speed * way.sum() * GRID > BEATS * 2 * pi * swing))
    x, rate, swing, speed = x[moving], rate[moving], swing[moving], speed[moving]
    across = np.mean(x[:-1] * rate[1:] - rate[:-1] * x[1:], axis=1) / 2 / np.sqrt(swing[:-1] * swing[1:] * speed[:-1] * speed[1:])
    along = np.mean(x[:-1] * x[1:], axis=1) / (swing[:-1] * swing[1:])
    return np.arctan2(across, along), np.hypot(across, along), moving + 1


def _courses(trial: Trial, factor: float = 1.0) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Starts [s] of stretches of `PACE` in which the fish swims, course through the water and `factor` times mean yaw in each.

    None if there are few, or in an unknown stream.
    """
    pose, unknown = trial.tables.get("pose", {}), trial.value("flow.known") is False
    if unknown or len(pose.get("t", ())) < 20 or any(np.atleast_1d(trial.value("push", 0.0))):
        return None
    begin, moved = drifts(pose)
    if len(begin) < FEWEST:
        return None
    speed, bearing = stated_stream(trial)
    t, yaw = np.asarray(pose["t"], float), np.unwrap(factor * np.asarray(pose["yaw"], float))
    total = np.r_[0.0, np.cumsum(np.diff(t) * (yaw[1:] + yaw[:-1]) / 2)]
    vx, vy = moved[0] - speed * np.cos(bearing), moved[1] - speed * np.sin(bearing)
    mean = (np.interp(begin + PACE, t, total) - np.interp(begin, t, total)) / PACE
    pace = np.hypot(vx, vy)
    moving = pace > max(0.03, 0.3 * float(np.quantile(pace, 0.9)))
    return (begin[moving], np.arctan2(vy, vx)[moving], mean[moving]) if moving.sum() >= FEWEST else None


def stated_stream(trial: Trial) -> tuple[float, float]:
    """Stated speed [m/s] and direction [rad] of the water; 0 where none is stated."""
    stated = (trial.value(f"flow.{key}", 0.0) for key in ("speed", "direction"))
    speed, bearing = (float(value) if isinstance(value, int | float) else 0.0 for value in stated)
    return speed, bearing


def drifts(pose: dict) -> tuple[np.ndarray, np.ndarray]:
    """Begins (K,) s of stretches of `PACE`, and the mean velocities (2, K) m/s over ground in them."""
    t = np.asarray(pose["t"], float)
    begin = np.arange(t[0], min(t[-1], t[0] + LONGEST) - PACE, APART)
    return begin, np.array([np.interp(begin + PACE, t, pose[k]) - np.interp(begin, t, pose[k]) for k in "xy"]) / PACE
