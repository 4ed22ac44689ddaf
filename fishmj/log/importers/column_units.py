"""Units of laboratories, the quantities that they measure, and their factor to SI.

If no name states the unit, the numbers decide: by size, by spread from the first row, by the step of the stamps. Each verdict is
(unit or "" if the values allow two, reason). Between two units lies a grey zone, never a sharp bound.
"""

import math
import re
from collections.abc import Mapping, Sequence

import numpy as np

from fishmj.log.importers.sheet import DATE, EPOCH
from fishmj.log.limits import quoted
from fishmj.log.trial_check import bounds_of, usual

SI = {  # what is measured -> the schema's unit
    **{"time": "s", "angle": "rad", "rate": "rad/s", "length": "m", "speed": "m/s", "voltage": "V", "current": "A"},
    **{"acceleration": "m/s^2", "frequency": "Hz", "temperature": "deg C", "": ""},
}
_DEG = math.pi / 180
UNITS: dict[str, tuple[str, float]] = {  # unit -> (what is measured, factor to SI)
    **{"s": ("time", 1.0), "ms": ("time", 1e-3), "us": ("time", 1e-6), "ns": ("time", 1e-9), "min": ("time", 60.0)},
    **{"cs": ("time", 1e-2), "h": ("time", 3600.0), "day": ("time", 86400.0)},
    **{"rad": ("angle", 1.0), "mrad": ("angle", 1e-3), "deg": ("angle", _DEG), "rev": ("angle", 2 * math.pi)},
    **{"mdeg": ("angle", 1e-3 * _DEG), "cdeg": ("angle", 1e-2 * _DEG), "gon": ("angle", 0.9 * _DEG)},
    **{"rad/s": ("rate", 1.0), "deg/s": ("rate", _DEG), "rpm": ("rate", 2 * math.pi / 60)},
    **{"mrad/s": ("rate", 1e-3), "mdeg/s": ("rate", 1e-3 * _DEG), "rev/s": ("rate", 2 * math.pi)},
    **{"m": ("length", 1.0), "cm": ("length", 1e-2), "mm": ("length", 1e-3), "px": ("length", math.nan)},
    **{"um": ("length", 1e-6), "dm": ("length", 0.1), "km": ("length", 1e3), "in": ("length", 0.0254), "ft": ("length", 0.3048)},
    **{"m/s": ("speed", 1.0), "cm/s": ("speed", 1e-2), "mm/s": ("speed", 1e-3)},
    **{"km/h": ("speed", 1 / 3.6), "kn": ("speed", 1852 / 3600), "ft/s": ("speed", 0.3048), "mph": ("speed", 0.44704)},
    **{"V": ("voltage", 1.0), "mV": ("voltage", 1e-3), "A": ("current", 1.0), "mA": ("current", 1e-3)},
    **{"m/s^2": ("acceleration", 1.0), "g": ("acceleration", 9.80665), "mg": ("acceleration", 9.80665e-3)},
    **{"deg C": ("temperature", 1.0), "Hz": ("frequency", 1.0)},
    **{"N": ("force", math.nan), "mN": ("force", math.nan), "N m": ("torque", math.nan), "mN m": ("torque", math.nan)},
    **{"kg": ("mass", math.nan), "W": ("power", math.nan), "%": ("share", math.nan), "count": ("count", math.nan)},
    **{"norm": ("share", math.nan)},  # of full deflection
}
STAMPED = ("s", "ms", "us", "ns")  # units of stamps
TICKING = (11_644_473_600, 62_135_596_800)  # s before 1970 at which the ticks of Windows and of .NET begin
PARTS = {"ns": "nanoseconds", "us": "microseconds", "ms": "milliseconds"}  # units of what is added to a stamp -> keys of a map
_SPELLED = {
    **dict.fromkeys(("sec", "secs", "second", "seconds", "sek", "sekunde", "sekunden", "s."), "s"),
    **dict.fromkeys(("msec", "msecs", "millis", "millisec", "milliseconds", "millisecond", "millisekunden"), "ms"),
    **dict.fromkeys(("µs", "μs", "usec", "usecs", "micros", "microsec", "microseconds", "microsecond"), "us"),
    **dict.fromkeys(("nsec", "nsecs", "nanos", "nanosec", "nanoseconds", "nanosecond"), "ns"),
    **dict.fromkeys(("minute", "minutes"), "min"),
    **dict.fromkeys(("hour", "hours", "hr", "hrs", "stunde", "stunden"), "h"),
    **dict.fromkeys(("days", "tag", "tage"), "day"),
    **dict.fromkeys(("csec", "centisec", "centiseconds"), "cs"),
    **dict.fromkeys(("millideg", "millidegrees"), "mdeg"),
    **dict.fromkeys(("centideg", "centidegrees"), "cdeg"),
    **dict.fromkeys(("gradian", "gradians", "gons"), "gon"),
    **dict.fromkeys(("µm", "μm", "micron", "microns", "micrometre", "micrometer"), "um"),
    **dict.fromkeys(("decimetre", "decimeter"), "dm"),
    **dict.fromkeys(("kilometre", "kilometer"), "km"),
    **dict.fromkeys(("inch", "inches"), "in"),
    **dict.fromkeys(("foot", "feet"), "ft"),
    **dict.fromkeys(("kmh", "kph"), "km/h"),
    **dict.fromkeys(("knot", "knots", "kt", "kts"), "kn"),
    **dict.fromkeys(("radian", "radians", "rads"), "rad"),
    **dict.fromkeys(("degree", "degrees", "degs", "grad", "°", "º"), "deg"),
    **dict.fromkeys(("revs", "turn", "turns"), "rev"),
    **dict.fromkeys(("radps", "rad s", "rad/sec", "rads/s"), "rad/s"),
    **dict.fromkeys(("dps", "degps", "deg s", "deg/sec", "°/s", "degrees/s"), "deg/s"),
    **{"mrad s": "mrad/s", "mdps": "mdeg/s", "ft s": "ft/s"},
    **dict.fromkeys(("metre", "metres", "meter", "meters"), "m"),
    **dict.fromkeys(("centimetre", "centimetres", "centimeter", "centimeters", "zentimeter"), "cm"),
    **dict.fromkeys(("millimetre", "millimetres", "millimeter", "millimeters"), "mm"),
    **dict.fromkeys(("pix", "pixel", "pixels"), "px"),
    **dict.fromkeys(("mps", "m s", "m/sec"), "m/s"),
    **dict.fromkeys(("mm s", "mmps"), "mm/s"),
    **dict.fromkeys(("cm s", "cmps"), "cm/s"),
    **dict.fromkeys(("volt", "volts"), "V"),
    **dict.fromkeys(("millivolt", "millivolts", "mvolt"), "mV"),
    **dict.fromkeys(("amp", "amps", "ampere", "amperes"), "A"),
    **dict.fromkeys(("milliamp", "milliamps", "mamp"), "mA"),
    **dict.fromkeys(("m/s2", "m/s²", "ms2", "m s2", "mps2", "m s-2", "m s^-2"), "m/s^2"),
    **dict.fromkeys(("hertz",), "Hz"),
    **dict.fromkeys(("°c", "degc", "celsius", "deg c"), "deg C"),
    **dict.fromkeys(("newton", "newtons"), "N"),
    **dict.fromkeys(("nm", "n*m", "n.m", "newtonmetre", "newtonmeter"), "N m"),
    **dict.fromkeys(("mnm",), "mN m"),
    **dict.fromkeys(("watt", "watts"), "W"),
    **dict.fromkeys(("percent", "pct"), "%"),
    **dict.fromkeys(("normalized", "normalised", "normed"), "norm"),
    **dict.fromkeys(("ticks", "tick", "counts", "raw"), "count"),
}
_LOWER = {unit.lower(): unit for unit in UNITS if unit not in ("mV", "mA")} | {"mv": "mV", "ma": "mA"}
# units whose factor is not certain: body lengths, a servo's counts, decivolts or a change of voltage, turns or rad a second
UNCERTAIN = set("bl bls bodylength bodylengths l a.u. lsb dv rps".split()) | {"body length", "body lengths"}
PLAIN = set("day foot in min raw second tag".split())  # words beside which a name's brackets hold no unit
_SCALE = re.compile(r"[*×/^]\s*[-+]?\d|\d\s*[*×/^]|\d[.,-]+\d|\d\s*e-?\d|\bx\s*\d|[°%π]", re.IGNORECASE)
RARE = set(
    "rev mrad min rpm g cs h day mdeg cdeg gon um dm km in ft km/h kn mrad/s mdeg/s rev/s ft/s mph mg".split()
)  # taken where a name says so, only
LONG = ("min", "h", "day")  # of stamps; a name that ends with one means another thing as often
# a full turn in each unit; a heading that wraps by it is asked about
TURNS_OF = [(400.0, "gon"), (36e3, "cdeg"), (36e4, "mdeg"), (2e3 * math.pi, "mrad"), (1.0, "rev"), (2.0, "rev*0.5")]
COUNTS_OF = [(3600, "deg*0.1"), (5760, "deg*0.0625"), *((2**n, f"rev*{2.0**-n:.9g}") for n in (8, 10, 12, 14, 16))]  # whole
TINY_ANGLE = 0.03  # rad or deg: nothing moves, so nothing tells
RAD, DEG = 2.1, 6.5  # a joint's largest angle: up to RAD it is rad, beyond DEG deg
COUNTS = 130.0  # deg; a joint beyond is counted in ticks, or from its servo's end
STRAIGHT = 0.35  # a heading that stays within is rad whatever its name says: in deg no fish swims so straight
TICKS = "Say the scale here, or the scale and zero in a map"
APART = (20.0, 170.0)  # times that two joints' largest angles differ when one is in rad, one in deg: 57.3, and 3 either way
SHORT = 2e-4  # s; a median step below is a rate that no servo, camera or battery has
CLOCKS = 2e-3  # s by which two columns of one clock differ in a row
LEAST, SLIM = 0.002, 1 / 300  # m that a swim spans on either axis at least, and its share of the other's
STIRS = 0.1  # rad or deg that a moving joint or heading leaves its middle by
SUPPLY = 36.0  # V; a robot's supply is below
TURN = 0.2  # between two rows of a heading: as rad, more than a fish turns between two pictures
FLUTTER = 30.0  # a spread beyond is cm, mm or px


def unit_of(text: str) -> str:
    """Unit that `text` spells, "" if it spells none."""
    text = text.strip()
    lower = re.sub(r"[\s.·*]+s\^?[-−⁻][1¹]\Z", "/s", text.lower())  # m s^-1
    return text if text in UNITS else _SPELLED.get(lower, "") or _LOWER.get(lower, "")


def other_unit(text: str) -> str:
    """Text in a name's brackets if it is a unit without a known factor (deg*2, BL/s, -1..1); "" for a unit or plain words."""
    text = text.strip()
    if unit_of(text):
        return ""
    said = [word for word in re.findall(r"[^\W\d]+(?!\w)", text) if word.lower() not in PLAIN]  # 10deg, but not m1
    known = any(word in ("m", "s", "V") or len(word) > 1 and (word.lower() in UNCERTAIN or unit_of(word)) for word in said)
    number = re.search(r"\d", text) and not re.search(r"[^\W\d]", text)
    return text if known or number or text.lower() in UNCERTAIN or _SCALE.search(text) else ""


def measures(unit: str) -> str:
    """Quantity that a unit measures; "" for no unit."""
    return UNITS[unit][0] if unit in UNITS else ""


def likely(what: str) -> list[str]:
    """Units that a laboratory's column is likely to use; the others need a name that states them."""
    return [unit for unit, (measured, _) in UNITS.items() if measured == what and unit not in RARE]


def fitting(what: str, value: float, unit: str, span: tuple[float, float]) -> list[str]:
    """The likely units in which a value [SI], first read in `unit`, lies within `span`."""
    raw = abs(value) / UNITS[unit or SI[what]][1]
    return [u for u in likely(what) if u != unit and span[0] <= raw * UNITS[u][1] <= span[1]]


def time_unit(t: np.ndarray) -> tuple[str, str]:
    """Unit of time stamps, in the order of the file, and the reason."""
    t = t[np.isfinite(t)]
    if len(t) < 2:
        return "", "fewer than two stamps"
    for unit in STAMPED:
        if 1e9 < t[0] * UNITS[unit][1] < 4e9:
            return unit, f"{unit} since 1970"
    if any(1e9 < 1e-7 * t[0] - before < 4e9 for before in TICKING):
        return "", "ns*100 (ticks of Windows) or ns?"
    step = np.diff(t)
    step = step[step > 0]
    middle = float(np.median(step)) if len(step) else 0.0
    if not middle:
        return "", "it never rises"
    for low, high, unit in ((5e-4, 0.4, "s"), (2.0, 400.0, "ms"), (2e3, 4e5, "us"), (2e6, 4e8, "ns")):
        if low <= middle <= high:
            return unit, f"steps of {middle:.4g}"
    allowed = [unit for unit in STAMPED if 1e-4 <= middle * UNITS[unit][1] <= 100]
    allowed += [unit for unit in LONG if 5e-4 <= middle * UNITS[unit][1] <= 0.4]
    return "", f"steps of {middle:.4g} may be {' or '.join(allowed) or 'none of s, ms, us, ns'}"


def clocks_apart(one: np.ndarray, other: np.ndarray, units: tuple[str, str]) -> float:
    """Largest change [s] of the difference of two columns of stamps; 0 within their rounding, or if one counts rows or rests.

    A column of an unknown unit is taken to last as long as the other.
    """
    both = np.isfinite(one) & np.isfinite(other)
    if both.sum() < 2 or not np.ptp(one[both]) * np.ptp(other[both]):
        return 0.0
    t = [(v[both] - v[both][0]) * UNITS.get(unit, ("", 1.0))[1] for v, unit in zip((one, other), units, strict=True)]
    for mine, their, unit in ((0, 1, units[0]), (1, 0, units[1])):
        if not unit and np.ptp(np.diff(t[mine])) == 0:
            return 0.0
        t[mine] = t[mine] if unit else t[mine] * float(np.ptp(t[their]) / np.ptp(t[mine]))
    rounding = (next((q for q in (60.0, 1.0, 0.1, 0.01) if np.abs(v / q - np.round(v / q)).max() < 1e-3), 0.0) for v in t)
    apart = float(np.ptp(t[0] - t[1]))
    return apart if apart > CLOCKS + sum(rounding) else 0.0


def angle_unit(values: np.ndarray) -> tuple[str, str]:
    """Unit of joint angles (all of one family together), and the reason."""
    most = _most(values)
    message = f"up to {most:.3g}"
    if most == 0:
        return "rad", "all zero"
    if most < TINY_ANGLE:
        return "", f"{message}: rad or deg?"
    if most <= RAD:
        return "rad", message
    if most <= DEG:
        return "", f"{message}: rad or deg?"
    if end := _from_end([values]):
        return "", end
    return ("deg", message) if most <= COUNTS else ("", f"{message}: a servo's counts, or degrees from its end? {TICKS}")


def angles_doubt(found: Mapping[str, np.ndarray], family: str) -> str:
    """Reason that the joints of one table cannot share a unit, or that commands may be no angles; "" without one.

    A joint that hardly moves is ignored. Commands that end at exactly 1 are rad, or shares, as the actions of a policy.
    """
    largest = [float(np.max(np.abs(v[np.isfinite(v)]), initial=0.0)) for v in found.values()]
    if family == "cmd.c" and max(largest, default=0.0) == 1.0:
        return f"up to 1 exactly: rad, or shares of full deflection? {TICKS}"
    most = {name: _most(values) for name, values in found.items() if _most(values) >= TINY_ANGLE}
    low, high = min(most, key=most.__getitem__, default=""), max(most, key=most.__getitem__, default="")
    if not most or most[low] > RAD or most[high] <= DEG or not APART[0] <= most[high] / most[low] <= APART[1]:
        return ""
    return f"{quoted(low)} goes up to {most[low]:.3g}, {quoted(high)} to {most[high]:.3g}: one in rad, one in deg?"


def heading_unit(values: np.ndarray) -> tuple[str, str]:
    """Unit of a heading, wrapped or not, and the reason."""
    values = values[np.isfinite(values)]
    most = _most(values)
    jump = float(np.max(np.abs(np.diff(values)), initial=0.0))
    if 5.5 < jump <= 6.4 and most <= 6.4:
        return "rad", f"wraps by {jump:.3g}"
    if 300 < jump <= 361:
        return "deg", f"wraps by {jump:.3g}"
    for turn, unit in TURNS_OF + COUNTS_OF * bool(np.all(values % 1 == 0)):
        if 0.9 * turn < jump <= 1.003 * turn and np.ptp(values) <= 1.003 * turn:
            ends = float(values.max() + values.min()) / turn  # 1 from zero to a turn, 0 to half a turn on either side
            if min(abs(ends), abs(ends - 1)) > 0.1:
                continue
            return "", f"wraps by {jump:.4g}: {unit}?"
    if most == 0:
        return "rad", "all zero"
    if most <= 3.2:
        turn = float(np.quantile(np.abs(np.diff(values)), 0.9)) if len(values) > 1 else 0.0
        return ("", f"turns by {turn:.2g} between rows: rad or deg?") if turn > TURN else ("rad", f"up to {most:.3g}")
    return ("deg", f"up to {most:.4g}") if most > 40 else ("", f"up to {most:.3g}: rad or deg?")


def spread(values: Sequence[np.ndarray]) -> float:
    """Largest span of several columns; 0 without a number."""
    return max((float(np.nanmax(v) - np.nanmin(v)) for v in values if np.isfinite(v).any()), default=0.0)


def length_unit(values: Sequence[np.ndarray]) -> tuple[str, str]:
    """Unit of positions (x and y together), and the reason; the offset of the first row is ignored."""
    far = spread(values)
    message, tank = f"spread {far:.3g}", bounds_of({}, "").tank
    start = max((abs(float(v[np.isfinite(v)][0])) for v in values if np.isfinite(v).any()), default=0.0)
    if far <= tank and start > tank:
        return "", f"{message}, but the first row is at {start:.4g}: m, or cm or mm from a corner of the tank?"
    if far <= tank:
        return "m", message
    return "", f"{message}: m or cm?" if far <= FLUTTER else f"{message}: mm, cm, px or m?"


def other_axis(unit: str, said: Sequence[np.ndarray], silent: Sequence[np.ndarray]) -> tuple[str, str]:
    """Unit of positions without one beside those with `unit`, and the reason; "" if they hardly move in it."""
    far, near = spread(said), spread(silent)
    if UNITS[unit][1] < 1 and 0 < near < max(LEAST / UNITS[unit][1], far * SLIM):
        return "", f"its other axis is in {unit}, where it moves by {near:.2g} {unit} only: {unit} or m?"
    return unit, "as its other axis"


def moves(values: np.ndarray) -> bool:
    """Returns True for a signal: not at rest, and not the noise of a sensor, which changes by more than it spreads."""
    values = values[np.isfinite(values)]
    if len(values) < 3 or float(np.quantile(np.abs(values - np.median(values)), 0.9)) < STIRS:
        return False
    return float(np.std(np.diff(values))) < 0.7 * float(np.std(values))


def rate_unit(values: np.ndarray) -> tuple[str, str]:
    """Unit of angular rates, and the reason."""
    most = _most(values)
    if most <= 12:
        return "rad/s", f"up to {most:.3g}"
    return ("deg/s", f"up to {most:.4g}") if most > 40 else ("", f"up to {most:.3g}: rad/s or deg/s?")


def voltage_unit(values: np.ndarray) -> tuple[str, str]:
    """Unit of a supply voltage, and the reason."""
    values = np.abs(values[np.isfinite(values)])
    middle = float(np.median(values)) if len(values) else 0.0
    if 2 <= middle <= SUPPLY:
        return "V", f"about {middle:.3g}"
    if middle < 1000 and middle > SUPPLY and (values == np.round(values)).all():
        return "", f"about {middle:.3g}: V, tenths of V (V*0.1), or counts?"
    if 2 <= middle <= 100:
        return "V", f"about {middle:.3g}"
    if 2000 <= middle < 4096 and (values == np.round(values)).all():
        return "", f"about {middle:.5g}: mV, or counts of a converter (V*SCALE)?"
    return ("mV", f"about {middle:.5g}") if 2000 <= middle <= 1e5 else ("", f"about {middle:.3g}: V or mV?")


def current_unit(values: np.ndarray) -> tuple[str, str]:
    """Unit of a supply current, and the reason."""
    most = _most(values)
    if most > 120:
        return "mA", f"up to {most:.5g}"
    if most > 1 and (np.nan_to_num(values) % 1 == 0).all():
        return "", f"up to {most:.3g}, whole numbers: A, mA, or counts (A*SCALE)?"
    idle = 1e-3 * usual(values) >= bounds_of({}, "").current_least  # as mA a robot's, at rest
    return ("", f"up to {most:.3g}, usually {usual(values):.3g}: A or mA?") if idle else ("A", f"up to {most:.3g}")


def against(unit: str, what: str, values: Sequence[np.ndarray]) -> tuple[str, Sequence[str]]:
    """Reason that the unit in a name is impossible, and the units that are possible; ("", ()) if it is possible.

    Args:
        what: measured quantity; "joint" for the angle of one. values: of the column, and of those that share its unit: the joints
            of one kind, x beside y.
    """
    if unit == DATE:
        return "", ()
    bounds = bounds_of({}, "")
    most = max(map(_most, values), default=0.0)
    if what == "time":
        doubt = _stamps_against(unit, values[0])
        return doubt, likely(what) if doubt else ()
    if what in ("angle", "joint") and unit == "rad" and most > 2 * math.pi:
        more = "" if what == "joint" else ": deg, or a heading that counts turns"
        return f"the name says rad, but {most:.4g} rad is more than a turn{more}", ("deg",) if what == "joint" else ("deg", "rad")
    if what == "joint" and unit == "deg" and TINY_ANGLE <= most <= 0.5 * RAD:
        return f"the name says deg, but no joint goes beyond {math.radians(most):.2g} rad; {most:.3g} may be rad", ("rad", "deg")
    if what == "joint" and unit == "deg" and (end := _from_end(values)):
        return end, ("deg",)
    if what == "angle" and unit == "deg":
        turns = [why for found, why in map(heading_unit, values) if found == "rad" and why.startswith("wraps")]
        if turns or TINY_ANGLE <= most <= STRAIGHT:
            return f"the name says deg, but it {turns[0] if turns else f'stays within {most:.2g}'}, as rad does", ("rad", "deg")
    if what in ("voltage", "current"):
        value, span = max(map(usual, values)) * UNITS[unit][1], bounds.span(what)
    elif what == "length" and unit in ("mm", "cm"):
        extent = max(map(_extent, values))
        if extent * UNITS[unit][1] < LEAST and any(map(moves, values)):
            return f"the name says {unit}, in which it moves by {extent:.3g} only: m?", ("m", unit)
        value, span = extent * UNITS[unit][1], (0.0, bounds.tank)
    else:
        return "", ()
    fits = fitting(what, value, unit, span)
    if not value or span[0] <= value <= span[1] or not fits:
        return "", ()
    allowed = f"{span[0]:g} to {span[1]:g}" if span[0] else f"at most {span[1]:g}"
    message = f'the name says {unit}, which makes it {value:.4g} {SI[what]}, plausible is {allowed}; in a map unit = "{fits[0]}"'
    return message, (*fits, unit)


def _stamps_against(unit: str, t: np.ndarray) -> str:
    """Reason that the unit in the name of the stamps is impossible; "" if it is possible."""
    finite = t[np.isfinite(t)]
    if unit in STAMPED:
        seconds = UNITS[unit][1]
        step = np.diff(finite)
        middle = seconds * float(np.median(step[step > 0])) if (step > 0).any() else SHORT
        if middle < 0.999 * SHORT:
            return f"the name says {unit}, but the steps are {middle:.3g} s, {1 / middle:.3g} rows a second"
    if unit == "s":
        step = float(np.median(np.abs(np.diff(finite)))) if len(finite) > 1 else 0.0
        if step > 5 and abs(finite[0]) < EPOCH:
            return f"the name says s, but the steps are {step:.4g}"
    return ""


def _from_end(values: Sequence[np.ndarray]) -> str:
    """Reason that angles in deg may count from a servo's end, as 90 for straight; "" without one."""
    found = np.concatenate(values)
    found = found[np.isfinite(found)]
    low, middle = (float(np.quantile(found, q)) for q in (0.001, 0.5)) if len(found) else (0.0, 0.0)
    if not (20 < low < middle and 45 < middle < 200):
        return ""
    message = f"{low:.3g} to {_most(found):.4g} deg, never straight: counted from the servo's end?"
    return f'{message} In a map say unit = "deg", zero = {round(middle / 45) * 45:d}'


def _extent(values: np.ndarray) -> float:
    """Largest distance of a position from its first row, or the first row's distance from zero if that is larger."""
    values = values[np.isfinite(values)]
    return max(_most(values - values[0]), abs(float(values[0]))) if len(values) else 0.0


def _most(values: np.ndarray) -> float:
    """Largest magnitude, without spikes in fewer than one cell in a thousand."""
    values = np.abs(values[np.isfinite(values)])
    return float(np.quantile(values, 0.999)) if len(values) > 2000 else float(values.max(initial=0.0))


BY_VALUE = {"angle": angle_unit, "rate": rate_unit, "voltage": voltage_unit, "current": current_unit}
