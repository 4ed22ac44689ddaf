"""Units that laboratories write, what they measure, and their factor to SI."""

import math

SI = {  # what is measured -> the schema's unit
    **{"time": "s", "angle": "rad", "rate": "rad/s", "length": "m", "speed": "m/s", "voltage": "V", "current": "A"},
    **{"acceleration": "m/s^2", "frequency": "Hz", "temperature": "deg C", "": ""},
}
_DEG = math.pi / 180
UNITS: dict[str, tuple[str, float]] = {  # unit -> (what is measured, factor to SI)
    **{"s": ("time", 1.0), "ms": ("time", 1e-3), "us": ("time", 1e-6), "ns": ("time", 1e-9), "min": ("time", 60.0)},
    **{"rad": ("angle", 1.0), "mrad": ("angle", 1e-3), "deg": ("angle", _DEG), "rev": ("angle", 2 * math.pi)},
    **{"rad/s": ("rate", 1.0), "deg/s": ("rate", _DEG), "rpm": ("rate", 2 * math.pi / 60)},
    **{"m": ("length", 1.0), "cm": ("length", 1e-2), "mm": ("length", 1e-3), "px": ("length", math.nan)},
    **{"m/s": ("speed", 1.0), "cm/s": ("speed", 1e-2), "mm/s": ("speed", 1e-3)},
    **{"V": ("voltage", 1.0), "mV": ("voltage", 1e-3), "A": ("current", 1.0), "mA": ("current", 1e-3)},
    **{"m/s^2": ("acceleration", 1.0), "g": ("acceleration", 9.80665), "Hz": ("frequency", 1.0)},
    **{"deg C": ("temperature", 1.0)},
    **{"N": ("force", math.nan), "mN": ("force", math.nan), "N m": ("torque", math.nan), "mN m": ("torque", math.nan)},
    **{"kg": ("mass", math.nan), "W": ("power", math.nan), "%": ("share", math.nan), "count": ("count", math.nan)},
}
_SPELLED = {
    **dict.fromkeys(("sec", "secs", "second", "seconds", "sek", "sekunde", "sekunden", "s."), "s"),
    **dict.fromkeys(("msec", "msecs", "millis", "millisec", "milliseconds", "millisecond", "millisekunden"), "ms"),
    **dict.fromkeys(("µs", "μs", "usec", "usecs", "micros", "microsec", "microseconds", "microsecond"), "us"),
    **dict.fromkeys(("nsec", "nsecs", "nanos", "nanosec", "nanoseconds", "nanosecond"), "ns"),
    **dict.fromkeys(("minute", "minutes"), "min"),
    **dict.fromkeys(("radian", "radians", "rads"), "rad"),
    **dict.fromkeys(("degree", "degrees", "degs", "grad", "°", "º"), "deg"),
    **dict.fromkeys(("revs", "turn", "turns"), "rev"),
    **dict.fromkeys(("radps", "rad s", "rad/sec", "rads/s"), "rad/s"),
    **dict.fromkeys(("dps", "degps", "deg s", "deg/sec", "°/s", "degrees/s"), "deg/s"),
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
    **dict.fromkeys(("m/s2", "m/s²", "ms2", "m s2", "mps2"), "m/s^2"),
    **dict.fromkeys(("hertz",), "Hz"),
    **dict.fromkeys(("°c", "degc", "celsius", "deg c"), "deg C"),
    **dict.fromkeys(("newton", "newtons"), "N"),
    **dict.fromkeys(("nm", "n*m", "n.m", "newtonmetre", "newtonmeter"), "N m"),
    **dict.fromkeys(("mnm",), "mN m"),
    **dict.fromkeys(("watt", "watts"), "W"),
    **dict.fromkeys(("percent", "pct"), "%"),
    **dict.fromkeys(("ticks", "tick", "counts", "raw"), "count"),
}
_LOWER = {unit.lower(): unit for unit in UNITS if unit not in ("mV", "mA")} | {"mv": "mV", "ma": "mA"}


def unit_of(text: str) -> str:
    """The unit that `text` spells, "" when it spells none."""
    text = text.strip()
    lower = text.lower()
    return text if text in UNITS else _SPELLED.get(lower, "") or _LOWER.get(lower, "")


def measures(unit: str) -> str:
    """What a unit measures; "" for none."""
    return UNITS[unit][0] if unit in UNITS else ""


def of_kind(what: str) -> list[str]:
    """The units of one quantity that have a factor, or take a scale (px)."""
    return [unit for unit, (measured, _) in UNITS.items() if measured == what]


def likely(what: str) -> list[str]:
    """Those that a laboratory's column is in; the others are taken where its name says so."""
    return [unit for unit in of_kind(what) if unit not in ("rev", "mrad", "min", "rpm", "g")]


def fitting(what: str, value: float, unit: str, span: tuple[float, float]) -> list[str]:
    """The likely units in which a value [SI] that was read in `unit` lies within `span`."""
    raw = abs(value) / UNITS[unit or SI[what]][1]
    return [u for u in likely(what) if u != unit and span[0] <= raw * UNITS[u][1] <= span[1]]
