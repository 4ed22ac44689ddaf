"""Physical checks of measured rates: the velocity, and the rates of turn, against the motion of the pose.

`velocity` and `turning` are rows of `physical_checks.CHECKS`; each yields (level, text) of a trial.
"""

from collections.abc import Iterator
from math import log

import numpy as np

from fishmj.log.course import (
    APART,
    FEWEST,
    GRID,
    NOTE,
    OTHER,
    PACE,
    SEEN,
    beating_swim,
    common_clock,
    correlation,
    delayed,
    mean_over,
    stated_stream,
)
from fishmj.log.importers.column_units import UNITS
from fishmj.log.trial import Trial
from fishmj.log.trial_check import Plausible
from fishmj.log.unread_rows import is_sound

MOVES, TURNS = 0.02, 0.1  # m/s, rad/s: least standard deviation of a motion that is compared
LEAST = 0.01  # m/s, deviation of a sway in its beat, and difference of two means, that are told
STRAIGHT = 0.03  # rad, scatter of a heading below which a current along the body is steady
SURE, CLEARER = 0.97, 9.0  # correlation of one motion; times that a reading of the axes leaves less unexplained than the map's
ALIKE = 0.9  # correlation, at its best delay, of two rates of turn of one motion
SLOW = 0.06  # s, median step from which a channel is too coarse for the turns of a beat
TILTED = 0.2  # share of the rate of turn that a gyroscope shows at least: its axis may be tilted
NEAR = log(1.15)  # of a ratio to that of a unit
TANK = "tank"
FAINT = 10.0  # times that a beating fish moves faster than its velocity, in water of which nothing is stated
WAIVED = 10.0  # times; where a trial allows more, neither sign nor axes are judged


def velocity(trial: Trial, bounds: Plausible) -> Iterator[tuple[str, str]]:
    """Findings on the measured velocity against the way of the pose: scale, sign, axes, frame.

    What a steady current adds is left out of both, so that a velocity through the water fits, too. Where no change of pace or
    heading tells the rest, the means must agree, or differ by the stated stream; one that is said to be unknown may be any.
    """
    pose, measured = trial.tables.get("pose", {}), trial.tables.get("velocity", {})
    names: list[str] = [name for name in ("surge", "sway") if name in measured]
    if not is_sound(pose, ["t", "x", "y", "yaw"]) or not is_sound(measured, ["t", *names]) or "surge" not in names:
        return
    grid, rows, every = common_clock(pose["t"], measured["t"]), round(PACE / GRID), round(APART / GRID)
    if len(grid) < rows + 2 * FEWEST * every:
        return
    x, y, yaw = (np.interp(grid, pose["t"], v) for v in (pose["x"], pose["y"], np.unwrap(pose["yaw"])))
    surge, sway = (np.interp(grid, measured["t"], measured[k]) if k in names else 0 * grid for k in ("surge", "sway"))
    told, ahead, moves = surge + 1j * sway, np.exp(1j * yaw), np.gradient(x + 1j * y, GRID)
    mean = lambda v: np.convolve(v, np.ones(rows) / rows, "valid")[::every]
    if "sway" in names:
        readings = {"": told * ahead, "-surge, -sway": -told * ahead, TANK: told}
        readings |= {"-sway, surge": 1j * told * ahead, "sway, -surge": -1j * told * ahead}
        readings |= {"surge, -sway": told.conj() * ahead, "-surge, sway": -told.conj() * ahead}
        readings |= {"sway, surge": 1j * told.conj() * ahead, "-sway, -surge": -1j * told.conj() * ahead}
        seen, current = mean(moves), np.ones((len(mean(x)), 1))
    else:  # along the body, where a current changes with the heading
        readings, seen = {"": told, "-surge": -told}, mean((moves * ahead.conj()).real)
        current = np.stack([mean(ahead.real), mean(ahead.imag)], 1)
    moved = {reading: mean(v) for reading, v in readings.items()}
    rest = lambda v: v - current @ np.linalg.lstsq(current, v, rcond=STRAIGHT)[0]
    found = _misread({reading: rest(v) for reading, v in moved.items()}, rest(seen), bounds)
    fast, pace = (float(np.median(np.abs(v))) for v in (moved[""], seen))
    speed, bearing = stated_stream(trial)
    water = np.full(len(grid), speed * np.exp(1j * bearing))
    carried = mean(water if "sway" in names else (water * ahead.conj()).real)
    own = float(np.median(np.abs(seen - carried)))
    sound = found is not None and not found[0] and abs(log(found[1])) <= log(bounds.agree)
    found = None if sound else found
    known, least, most = trial.value("flow.known"), min(pace, own), max(pace, own, MOVES)
    above = fast > bounds.agree * most and (known or fast - pace > bounds.leap)
    swims = known or (known is None and fast * FAINT < least and beating_swim(trial) is not None)
    if found is None and (above or 0 < fast * bounds.agree < least > 2 * MOVES and swims):
        found = "", fast / max(pace, MOVES), 1.0
    if found is None:
        if max(float(np.median(np.diff(v))) for v in (pose["t"], measured["t"])) <= SLOW:
            yield from _sway_against((moves * ahead.conj()).imag, sway, rows, bounds)
        off = min(float(abs(np.mean(seen - moved[""] - stream))) for stream in (0.0, carried))
        if not sound and known is not False:
            yield from _steadily_off(off, fast, pace, names, bounds)
        return
    reading, times, fit = found
    if reading:
        cause = (
            "along x and y of the tank; expected along the body: compute surge and sway with yaw"
            if reading == TANK
            else f"in other axes: in the map read {', '.join(names)} from {reading} (a minus: sign = -1)"
        )
        yield NOTE, f"velocity: it contradicts the way of the pose (correlation {fit:.2f}; at least {SURE} if it is {cause})"
        return
    yield (
        NOTE,
        f"velocity: it is {times:.3g} times the motion of x and y (1 / {bounds.agree:g} to {bounds.agree:g} is plausible):"
        f" {_scaled('surge', times, 'speed', names)}, or correct the scale of x and y; a velocity through the"
        " water in a changing or unstated current differs, too: the schema's is over ground",
    )


def turning(trial: Trial, bounds: Plausible) -> Iterator[tuple[str, str]]:
    """Findings on measured rates of turn against the turns of the pose: scale and sign."""
    pose = trial.tables.get("pose", {})
    for table, name, least in (("velocity", "yaw_rate", 1 / bounds.agree), ("imu", "wz", min(TILTED, 1 / bounds.agree))):
        measured = trial.tables.get(table, {})
        if not is_sound(pose, ["t", "yaw"]) or not is_sound(measured, ["t", name]):
            continue
        grid = common_clock(pose["t"], measured["t"])
        coarse = max(float(np.median(np.diff(t))) if len(t) > 1 else PACE for t in (pose["t"], measured["t"]))
        if len(grid) < 2 * FEWEST * APART / GRID or coarse > SLOW:
            continue
        seen = _smooth(np.gradient(np.interp(grid, pose["t"], np.unwrap(np.asarray(pose["yaw"], float))), GRID))
        told = _smooth(np.interp(grid, measured["t"], measured[name]))
        if np.std(seen) < TURNS or np.std(told) == 0:
            continue
        lags = _lags(seen, told)
        times = float(np.std(told) / np.std(seen))
        if _opposed(lags, bounds):
            yield (
                NOTE,
                f"{table}: {name} runs against the turns of yaw (correlation {min(lags):.2f}): expected counter-clockwise,"
                f" from above. In the map give columns.{name} sign = -1; or its stamps are half a beat off",
            )
        elif max(lags) > ALIKE and not least <= times <= bounds.agree:
            yield (
                NOTE,
                f"{table}: {name} is {times:.3g} times the turning of yaw ({least:.2g} to {bounds.agree:g} is plausible):"
                f" {_scaled(name, times, 'rate', [name])}",
            )


# ---------------------------------------------------------------------------------------------------------------------- helpers
def _misread(moved: dict[str, np.ndarray], seen: np.ndarray, bounds: Plausible) -> tuple[str, float, float] | None:
    """The reading of the columns that fits, "" the map's own, its scale and the own reading's correlation; None if none fits.

    Args:
        moved: velocities (K,) m/s in the frame of the tank, complex, of each reading. seen: that of the pose.
    """
    size = float(np.linalg.norm(seen))
    sizes = {reading: float(np.linalg.norm(v)) for reading, v in moved.items()}
    if size < MOVES * len(seen) ** 0.5 or min(sizes.values()) <= 0:
        return None
    fits = {reading: float(np.vdot(v, seen).real) / (sizes[reading] * size) for reading, v in moved.items()}
    best, times = max(fits, key=lambda reading: fits[reading]), sizes[""] / size
    if bounds.agree < WAIVED and fits[best] > SURE and (1 - fits[best]) * CLEARER < 1 - fits[""]:
        return best, times, fits[""]
    return ("", times, fits[""]) if fits[""] > SURE else None


def _sway_against(seen: np.ndarray, told: np.ndarray, rows: int, bounds: Plausible) -> Iterator[tuple[str, str]]:
    """A finding on a measured sway (T,) m/s that runs against the pose's in each beat; rows: of the mean taken from both."""
    aside = [_smooth(v) - mean_over(v, rows) for v in (seen, told)]
    lags = _lags(*aside)
    if np.std(aside[0]) > LEAST and _opposed(lags, bounds):
        yield (
            NOTE,
            f"velocity: sway runs against the pose in each beat (correlation {min(lags):.2f}): expected to the left. In the"
            " map give columns.sway sign = -1; or its stamps are half a beat off, or it is of another point of the body",
        )


def _steadily_off(off: float, fast: float, pace: float, names: list[str], bounds: Plausible) -> Iterator[tuple[str, str]]:
    """A finding on a velocity that is `fast` and `off` the pose's `pace`, all in m/s, by more than the bounds allow."""
    if bounds.agree < WAIVED and off > max(LEAST, (1 - 1 / bounds.agree) * max(fast, pace)):
        yield (
            NOTE,
            f"velocity: it is off the way of the pose by a steady {off:.2g} m/s ({fast:.2g} m/s for {pace:.2g} m/s), and no"
            " change of pace or heading tells why: is it through the water of a stream that is not stated, or of another"
            f" scale or sign? State the water, flow in [meta] or --flow, or mend {_names(names)} in the map",
        )


def _lags(seen: np.ndarray, told: np.ndarray) -> list[float]:
    """Correlations of two channels, each of them delayed by each of `SEEN`."""
    return [correlation(*delayed(*pair, lag)) for lag in SEEN for pair in ((seen, told), (told, seen))]


def _opposed(lags: list[float], bounds: Plausible) -> bool:
    """Returns True if the correlations show channels of opposite sign, and the bounds allow a judgement of signs."""
    return min(lags) < -ALIKE and max(lags) < OTHER and bounds.agree < WAIVED


def _scaled(column: str, times: float, kind: str, columns: list[str]) -> str:
    """Unit that makes columns so many times too large or small, as a question, and the line of a map."""
    si = {"speed": "m/s", "rate": "rad/s"}[kind]
    for unit, (what, factor) in UNITS.items():
        if what == kind and factor != 1:
            for held, read, ratio in ((unit, si, 1 / factor), (si, unit, factor)):
                if abs(log(times / ratio)) < NEAR:
                    return f'is the file in {held}, read as {read}? In the map give {_names(columns)} unit = "{held}"'
    return f"in the map give {_names(columns)} another unit or scale, {1 / times:.3g} times the present one"


def _names(columns: list[str]) -> str:
    return " and ".join(f"columns.{name}" for name in columns)


def _smooth(x: np.ndarray) -> np.ndarray:
    return mean_over(mean_over(x, 5), 5)
