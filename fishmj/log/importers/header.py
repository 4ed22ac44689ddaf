"""What the name of a column says: its words, its number, its unit."""

import re
from dataclasses import dataclass

from fishmj.log.importers.column_units import UNITS, unit_of

# In English, German, French, Spanish, Italian and Portuguese, as far as a word has one meaning in a log: `tension` (a tendon's)
# and `cap` (a capacity) are left to the user.
TIME = set("time t ts stamp timestamp tstamp clock elapsed utc epoch date datetime uptime".split())
TIME |= set("zeit stempel uhrzeit datum temps tiempo tempo".split())
COMMAND = set("cmd cmds command commands commanded goal target des desired ref reference set setpoint sp wanted".split())
COMMAND |= set("soll stell vorgabe consigne comando mandado".split())
MEASURED = set("meas measured measurement measurements pos position actual act present fb feedback enc encoder real".split())
MEASURED |= set("state states sensor sensed read ist gemessen mesure medido".split())
SERVO = set("servo servos motor motors servomotor".split())
JOINT = set("joint joints angle angles ang theta q dof hinge phi winkel gelenk articulation".split())
PART = set("tail fin hinge schwanz flosse".split())  # what a joint may be called after
RATE = set("vel velocity speed rate omega dot gyro geschwindigkeit drehzahl vitesse velocidad".split())
CAMERA = set("cam camera track tracker tracking vicon mocap optitrack pose tank world com centroid head fish body kamera".split())
HEADING = set("yaw heading hdg theta psi orientation kurs gier orientierung ausrichtung lacet rumbo".split())
COMPASS = set("bearing compass course azimuth kompass peilung azimut".split())
FORCE = set("force forces fx fy fz torque torques thrust wrench moment mx my mz effort tau newton kraft drehmoment".split())
ACCELERATION = set("acc accel acceleration accelerometer beschl beschleunigung".split())
VOLT = set("volt volts voltage vbat vbatt vcc vdd u spannung voltaje".split())
CURRENT = set("current curr amp amps ampere ibat ibatt strom courant corriente".split())
BATTERY = set("batt battery supply bus power bat akku batterie bateria batteria lipo".split())
TEMPERATURE = set("temp temperature temperatur temperatura".split())
NOWHERE = set(
    "error err pwm duty pitch roll depth lat latitude lon longitude percent soc id seq pressure druck tiefe fehler".split()
)
_GLUED = {  # names without a mark between their words; a unit comes last, so no quantity does
    **{"posx": "pos x", "posy": "pos y", "xpos": "pos x", "ypos": "pos y", "camx": "cam x", "camy": "cam y"},
    **{
        "vbat": "volt battery",
        "vbatt": "volt battery",
        "vin": "volt supply",
        "ibat": "current battery",
        "ibatt": "current battery",
    },
    **{
        "akkuspannung": "spannung akku",
        "batteriespannung": "spannung akku",
        "akkustrom": "strom akku",
        "batteriestrom": "strom akku",
    },
    **{
        "sollwinkel": "soll winkel",
        "stellwinkel": "soll winkel",
        "istwinkel": "ist winkel",
        "sollwert": "soll",
        "istwert": "ist",
    },
    **{"setpoint": "target", "zeitstempel": "zeit stempel", "motorstrom": "motor strom"},
    **{
        "yawrate": "yaw rate",
        "gierrate": "yaw rate",
        "rollrate": "roll rate",
        "yawangle": "yaw angle",
        "gierwinkel": "yaw angle",
    },
    **{"winkelgeschwindigkeit": "winkel rate", "accx": "acc x", "accy": "acc y", "accz": "acc z"},
    **{
        "gyrox": "gyro x",
        "gyroy": "gyro y",
        "gyroz": "gyro z",
        "ψ": "psi",
        "θ": "theta",
        "easting": "x east",
        "northing": "y north",
    },
}
_BRACKET = re.compile(r"(.*?)\s*[\[(<{]([^\])>}]*)[\])>}]\s*\Z", re.DOTALL)
_RATES = {("deg", "s"), ("rad", "s"), ("m", "s"), ("mm", "s"), ("cm", "s"), ("m", "s2")}


@dataclass(frozen=True)
class Header:
    """`words` in lower case without number and unit."""

    raw: str
    words: tuple[str, ...]
    number: int | None = None
    unit: str = ""

    def has(self, words: set[str]) -> bool:
        """Whether one of `words` is among its own."""
        return not words.isdisjoint(self.words)


def words(text: str) -> list[str]:
    """`servo1Goal_deg` -> servo, 1, goal, deg."""
    text = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", text[:200]).lower()
    out: list[str] = []
    for part in re.findall(r"[^\W\d_]+|\d+|°|%", text):
        out += _GLUED.get(part, part).split()
    return out


def parse(raw: str) -> Header:
    """Words, number and unit of one column's name."""
    unit, name = "", raw
    if found := _BRACKET.match(raw[:200]):
        name, unit = found[1], unit_of(found[2])
    said = words(name) or words(raw)
    rest, mark, last = re.sub(r"[\s.\-]", "_", name.strip()).rpartition("_")
    if not unit and len(said) > 2 and tuple(said[-2:]) in _RATES:
        unit, said = unit_of(" ".join(said[-2:])), said[:-2]
    elif not unit and mark and last and unit_of(last) and words(rest) and last.lower() not in ("g", "min"):
        unit, said = unit_of(last), words(rest)  # as it is written: mV is no m V
    elif not unit and len(said) > 1 and unit_of(said[-1]) and said[-1] not in ("g", "min"):
        unit, said = unit_of(said[-1]), said[:-1]
    elif len(said) == 1 and said[0] in (
        "ms",
        "us",
        "ns",
        "sec",
        "secs",
        "seconds",
        "millis",
        "micros",
        "msec",
        "usec",
        "nanos",
        "s",
    ):
        unit, said = unit_of(said[0]), ["time"]
    numbers = [int(word) for word in said if word.isdecimal() and len(word) < 4]
    plain = tuple(word for word in said if not word.isdecimal())
    return Header(raw, plain, numbers[-1] if numbers else None, unit if unit in UNITS else "")
