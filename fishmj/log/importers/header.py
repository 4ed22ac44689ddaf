"""Parses the name of a column: its words, number and unit; and the places that the name allows."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from fishmj.log.importers.column_units import STAMPED, UNITS, measures, other_unit, unit_of

# Words in English, German, French, Spanish, Italian and Portuguese that have one meaning in a log. The user decides on `tension`
# (of a tendon) and `cap` (a capacity).
TIME = set("time t ts stamp timestamp tstamp clock elapsed utc epoch date datetime uptime".split())
TIME |= set("tick ticks tv".split())
TIME |= set("zeit stempel datum temps horodatage heure tiempo hora tempo ora tijd tid czas aika zaman idő čas timp".split())
TIME |= set("время 时间 时间戳 時刻 時間 タイムスタンプ 시간".split())
TIME_PARTS = ("zeit", "time", "stamp", "stempel", "tijd")  # of a compound that begins or ends with it: kamerazeit, frametime
NO_STAMP = set("rx arrival received delay delta dt duration since exposure shutter timeout latency cycle lifetime loop".split())
NO_STAMP |= set("offset diff difference remaining zone timezone".split())
ORIGIN = set("boot bootup start startup power on up reset epoch begin beginning launch init unix the system program".split())
COMMAND = set("action cmd cmds command commands commanded goal target des desired ref reference set setpoint sp wanted".split())
COMMAND |= set("soll stell vorgabe consigne comando mandado".split())
ORDERED = COMMAND - set("action des ref reference set sp wanted".split())  # in the name of a file
MEASURED = set("meas measured measurement measurements pos position actual act present fb feedback enc encoder real".split())
MEASURED |= set("state states sensor sensed read ist gemessen mesure medido".split())
SERVO = set("servo servos motor motors servomotor".split())
JOINT = set("joint joints angle angles ang theta q dof hinge phi winkel gelenk articulation".split())
ALONG = {"nose": -1, "snout": -1, "head": 0, "kopf": 0, "body": 1, "trunk": 1, "torso": 1, "rumpf": 1, "peduncle": 2}
ALONG |= {"tail": 3, "schwanz": 3, "caudal": 4, "fin": 4, "flosse": 4, "fluke": 4}  # parts of a fish in their order from the nose
BESIDE = set("left right pectoral pelvic dorsal anal ventral side links rechts".split())  # fins that are in no chain
PART = set("peduncle caudal fluke tail fin hinge schwanz flosse".split())  # what a joint may be called after
ENDS = {"nose", "snout"} | PART - {"hinge"}  # points of a fish that are not its centre of mass
RATE = set("twist vel velocity speed rate omega dot gyro geschwindigkeit drehzahl vitesse velocidad".split())
CAMERA = set("cam camera track tracker tracking vicon mocap optitrack pose tank world com centroid head fish body kamera".split())
FILM = set("cam camera kamera tracker tracking vicon mocap optitrack meas measured".split())  # of no target, whatever the file
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
ASIDE = set("std stdev stddev sd var variance cov covariance sigma min minimum max maximum limit limits threshold".split())
ASIDE |= set("offset trim zero bias deadband gain kp ki kd pid amplitude phase freq frequency width attack".split())
ASIDE |= set("cos sin diff change relative rel".split())
THINGS = set("wall walls light lamp feeder food prey bait obstacle buoy dock origin corner".split())  # beside the fish
PULSE = set("pulse pulses pulsewidth".split())
PULSES = (
    "pulses of a servo, no angles: map them with unit = 'deg', scale = the degrees a us and zero = the us of the straight joint"
)
GLOBE = "latitude and longitude are angles on the globe: write x and y in m about the first row"
TILTS = "a roll or pitch; the schema's fish swims in the plane, its heading is yaw"
_GLUED = {  # names without a mark between their words; a unit comes last, so no quantity does
    **{"posx": "pos x", "posy": "pos y", "xpos": "pos x", "ypos": "pos y", "camx": "cam x", "camy": "cam y"},
    **{"vbat": "volt battery", "vbatt": "volt battery", "vin": "volt supply"},
    **{"ibat": "current battery", "ibatt": "current battery", "motorstrom": "motor strom"},
    **{"akkuspannung": "spannung akku", "batteriespannung": "spannung akku"},
    **{"akkustrom": "strom akku", "batteriestrom": "strom akku", "sollwert": "soll", "istwert": "ist"},
    **{"sollwinkel": "soll winkel", "stellwinkel": "soll winkel", "istwinkel": "ist winkel"},
    **{"sollmoment": "soll drehmoment", "stellmoment": "soll drehmoment", "istmoment": "ist drehmoment"},
    **{"sollstrom": "soll strom", "iststrom": "ist strom", "gelenkwinkel": "gelenk winkel"},
    **{"setpoint": "target", "zeitstempel": "zeit stempel", "winkelgeschwindigkeit": "winkel rate"},
    **{"yawrate": "yaw rate", "gierrate": "yaw rate", "rollrate": "roll rate"},
    **{"yawangle": "yaw angle", "gierwinkel": "yaw angle", "easting": "x east", "northing": "y north"},
    **{"accx": "acc x", "accy": "acc y", "accz": "acc z", "gyrox": "gyro x", "gyroy": "gyro y", "gyroz": "gyro z"},
    **{"ψ": "psi", "θ": "theta"},
}
NO_SUFFIX = {"g", "min", "h", "in"}  # units that a name may end with and mean another thing
AXES = {"x", "y", "z"}
TRANSLATION = {"tx": "x", "ty": "y", "tz": "z"}  # of the trajectories of TUM, as evo writes them
ARRAY = (("value",), ("data",), ("values",), ("field", "data"))  # words for an element of an array
_BRACKET = re.compile(r"(.*?)\s*[\[(<{]([^\])>}]*)[\])>}]\s*\Z", re.DOTALL)
_SCALED = re.compile(
    r"(.*[^\W_])[\W_]+(([^\W\d_]+?)[\W_]*(?:x[\s_]*10+|[*×/]\s*\d+))\s*\Z", re.DOTALL | re.IGNORECASE
)  # _deg_x10
_RATES = {("deg", "s"), ("rad", "s"), ("m", "s"), ("mm", "s"), ("cm", "s"), ("m", "s2"), ("ft", "s"), ("mrad", "s")}


@dataclass(frozen=True)
class Header:
    """Parsed name of a column: `words` in lower case without number and unit."""

    words: tuple[str, ...]
    number: int | None = None
    unit: str = ""
    other: str = ""  # unit that has no factor here: 0.1 deg, BL

    def has(self, words: set[str]) -> bool:
        """Returns True if one of `words` is among its own."""
        return not words.isdisjoint(self.words)


def words(text: str) -> list[str]:
    """Words of a name: `servo1Goal_deg` -> servo, 1, goal, deg."""
    text = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", text[:200]).lower()
    out: list[str] = []
    for part in re.findall(r"[^\W\d_]+|\d+|°|%", text):
        out += _GLUED.get(part, part).split()
    return out


def parse(raw: str) -> Header:
    """Words, number and unit of one column's name."""
    unit, other, name = "", "", raw
    found = _BRACKET.match(raw[:200])
    if found and not found[2].strip().isdecimal() and found[2].strip().lower() not in AXES:  # data[0], v_{x}: indices
        first, _, then = found[2].partition(",")  # (deg, left)
        name, unit = found[1], unit_of(found[2]) or time_unit(words(found[2]))
        unit = unit or ("" if unit_of(then) or other_unit(then) else unit_of(first))
        other = "" if unit else other_unit(found[2])
    elif (found := _SCALED.match(raw[:200])) and unit_of(found[3]):
        name, other = found[1], found[2]
    said = words(name) or words(raw)
    rest, mark, last = re.sub(r"[\s.\-]", "_", name.strip()).rpartition("_")
    if not unit and (early := time_unit(said)):
        unit, said = early, [word for word in said if measures(unit_of(word)) != "time"]
    elif not unit and len(said) > 2 and tuple(said[-2:]) in _RATES:
        unit, said = unit_of(" ".join(said[-2:])), said[:-2]
    elif not unit and not other and mark and last and unit_of(last) and words(rest) and last.lower() not in NO_SUFFIX:
        unit, said = unit_of(last), words(rest)  # as it is written: mV is no m V
    elif not unit and not other and len(said) > 1 and unit_of(said[-1]) and said[-1] not in NO_SUFFIX:
        unit, said = unit_of(said[-1]), said[:-1]
    elif len(said) == 1 and unit_of(said[0]) in STAMPED:  # a unit alone: a stamp in it
        unit, said = unit_of(said[0]), ["time"]
    numbers = [int(word) for word in said if word.isdecimal() and len(word) < 4]
    plain = tuple(word for word in said if not word.isdecimal())
    return Header(plain, numbers[-1] if numbers else None, unit if unit in UNITS else "", other)


def time_unit(said: Sequence[str]) -> str:
    """Unit among the words of a time's name, wherever it stands: ms_since_boot, t_us_mcu; "" if none or several."""
    found = [word for word in said if measures(unit_of(word)) == "time"]
    rest = [word for word in said if word not in found]
    plain = found and found[0] not in ("s", "second") and unit_of(found[0]) in STAMPED and not TIME.isdisjoint(rest)
    return unit_of(found[0]) if len(found) == 1 and (plain or since(rest)) else ""


def stamp_unit(column: str) -> str:
    """Unit of stamps that a name of any other words begins or ends with; "" without one, and for a time that is no stamp."""
    name, said = parse(column), words(column)
    unit = name.unit if name.unit in STAMPED else unit_of(said[0]) if said and len(said[0]) > 1 else ""
    return unit if unit in STAMPED and not name.has(NO_STAMP | SERVO | JOINT | PULSE | COMMAND | MEASURED) else ""


def since(said: Sequence[str]) -> bool:
    """Returns True for a time since the start of a run or a clock, as a stamp is; not for one since the last event."""
    _, mark, what = " ".join(said).partition("since ")
    return bool(mark) and ORIGIN.issuperset(what.split())


def nose_to_tail(names: Sequence[Header]) -> list[int] | None:
    """Numbers 1, 2, .. of joints that are named after parts of the body; None if their names give no order."""
    parts = [max((ALONG[word] for word in name.words if word in ALONG), default=None) for name in names]
    if None in parts or len(set(parts)) < 2 or any(name.has(BESIDE) for name in names):
        return None
    keys = [(part, name.number or 0) for part, name in zip(parts, names, strict=True)]
    return [sorted(keys).index(key) + 1 for key in keys] if len(set(keys)) == len(keys) else None


class Role(NamedTuple):
    """Possible places of a column, such as "cmd.c#" (#: its number). None: left out, for the reason `why`; several: unclear."""

    places: tuple[str, ...] = ()
    why: str = ""


UNKNOWN = "the name says nothing that the log's schema knows"
NO_COLUMN = "the schema has no such column"


def role(name: Header, context: set[str]) -> Role:
    """The places that a column's name allows.

    Args:
        context: words of the file's name or the topic: `commands.csv` tells the meaning of its columns.
    """
    for rule in (_force, _exact, _time, _aside, _power, _imu, _velocity, _place, _heading, _joint):
        if found := rule(name, context):
            return found
    return Role(why=UNKNOWN)


def on_globe(name: Header) -> bool:
    """Returns True for a latitude or longitude."""
    said = name.has({"latitude", "longitude"}) or name.words[-1:] in (("lat",), ("lon",), ("lng",))
    return said and measures(name.unit) in ("", "angle")


def no_place(name: Header) -> str:
    """Reason that servo pulses, a roll or a pitch are in no column of the schema; "" for any other name."""
    if (name.has(PULSE) or name.has({"pwm"}) and name.unit == "us") and not name.has(COMMAND):
        return PULSES
    if on_globe(name):
        return GLOBE
    return TILTS if name.has({"roll", "pitch"}) or name.words in (("rx",), ("ry",)) and measures(name.unit) == "angle" else ""


def _exact(name: Header, context: set[str]) -> Role | None:
    """Role of a name of the schema itself; None for any other name."""
    if name.words in (("c",), ("j",)) and name.number is not None and measures(name.unit) in ("", "angle"):
        return Role(("cmd.c#" if name.words == ("c",) else "joint.j#",), "the schema's own name")
    if name.words in (("w",), ("on",)) and name.number is not None:
        return Role(("joint.w#" if name.words == ("w",) else "cmd.on#",), "the schema's own name")
    if name.words in (("amplitude",), ("bias",)) and measures(name.unit) in ("", "angle"):
        return Role((f"gait.{name.words[0]}",), "the schema's own name")
    return None


def _force(name: Header, context: set[str]) -> Role | None:
    stated = measures(name.unit) in ("angle", "rate", "length", "speed", "voltage", "current", "acceleration")
    if name.has(FORCE) or measures(name.unit) in ("force", "torque") or (context & FORCE and not name.has(TIME) and not stated):
        return Role(why="a force or torque; the schema's wrench holds those of every link, so it is left out")
    known = name.has(SERVO | JOINT) or (
        name.unit in ("count", "%", "norm") and name.has(COMMAND | MEASURED) and name.number is not None
    )
    if measures(name.unit) in ("mass", "power", "share", "count") and not known:
        return Role(why=f"{name.unit}: the schema has no such column")
    if why := no_place(name):
        return Role(why=why)
    if name.has(NOWHERE - {"id"} if _of_servo(name) else NOWHERE):
        return Role(why=NO_COLUMN)
    return None


def _of_servo(name: Header) -> bool:
    """Returns True for a servo that is named by its identity on the bus: id1_goal_deg; not for an animal's, as in id1_x."""
    measured = name.has({"present"}) or name.has(MEASURED) and measures(name.unit) == "angle"
    first = name.words[:1] == ("id",) or name.has(SERVO | {"dxl", "xl"}) or measures(name.unit) in ("angle", "count")
    return first and name.number is not None and (measured or name.has(COMMAND)) and not name.has(AXES)


def _time(name: Header, context: set[str]) -> Role | None:
    compound = any(word.startswith(TIME_PARTS) or word.endswith(TIME_PARTS) for word in name.words)
    began = since(name.words)
    if not (compound or began or name.has(TIME)) or name.has(AXES | SERVO | JOINT) or measures(name.unit) not in ("", "time"):
        return None
    if name.has(NO_STAMP - {"since"} if began else NO_STAMP):
        return Role(why="a time, but not the stamp of the row")
    return Role(("t",), "a word for time" + (" and its unit" if name.unit else ""))


def _aside(name: Header, context: set[str]) -> Role | None:
    if name.has(ASIDE) and not name.has(PULSE):
        return Role(why="a setting, a statistic or a function of a quantity, not the quantity")
    return Role(why="a place, but not the fish's") if name.has(THINGS) and name.has(AXES) else None


def _power(name: Header, context: set[str]) -> Role | None:
    if name.has(CAMERA) or (name.words[:-1] in (("v",), ("u",)) and name.has(AXES)):  # cam_u, cam_v; v_x
        return None
    said, alone = measures(name.unit), not name.has(SERVO | JOINT) and name.number is None
    if name.has(VOLT | CURRENT) and name.has(COMMAND):
        return Role(why="a wanted voltage or current; the schema has none")
    battery = name.has(BATTERY) or not context.isdisjoint(BATTERY)
    volts = name.has(VOLT - {"u"}) or name.words in (("v",), ("u",)) or (battery and name.has({"v", "u"}))
    if said == "voltage" or (volts and not said):
        return Role(("power.V",), "a word or unit of voltage") if alone else Role(why="the voltage of one servo")
    amps = name.has(CURRENT) or (name.words == ("i",) and alone) or (battery and name.has({"i"}))
    if said == "current" or (amps and not said):
        return Role(("power.I",), "a word or unit of current") if alone else Role(why="the current of one servo")
    if name.has(BATTERY - {"bus", "power", "supply"}) and alone:
        return Role(("power.V", "power.I"), "a battery's voltage or its current?")
    if name.has(TEMPERATURE):
        if name.number is not None:
            return Role(("joint.temp#",), "a servo's temperature")
        return Role(why="a temperature of no servo")
    return None


def _imu(name: Header, context: set[str]) -> Role | None:
    axis = next((word for word in name.words if word in AXES), "")
    if axis and (name.has(ACCELERATION) or measures(name.unit) == "acceleration"):
        return Role((f"imu.a{axis}",), "an acceleration")
    if name.words[-1:] in (("ax",), ("ay",), ("az",)):
        return Role((f"imu.{name.words[-1]}",), "an acceleration")
    if axis and not name.has({"twist"}) and (name.has({"gyro", "gyroscope", "angular"}) or ("omega" in name.words)):
        return Role((f"imu.w{axis}",), "a turning rate")
    if name.words[-1:] in (("gx",), ("gy",), ("gz",), ("wx",), ("wy",), ("wz",)):
        return Role((f"imu.w{name.words[-1][1]}",), "a turning rate")
    return None


def _velocity(name: Header, context: set[str]) -> Role | None:
    if name.words[-1:] in (("surge",), ("sway",)):
        return Role((f"velocity.{name.words[-1]}",), "a velocity of the body")
    if name.has(HEADING - {"theta"}) and name.has(RATE):
        return Role(("velocity.yaw_rate",), "the rate of the heading")
    component = name.has(AXES) and (name.has(RATE) or name.words[:-1] in (("v",), ("u",)))
    if component or name.words[-1:] in (("vx",), ("vy",), ("vz",)) or measures(name.unit) == "speed":
        return Role(why="a velocity that may be of the tank or of the body; the schema's is the body's surge and sway")
    return None


def _place(name: Header, context: set[str]) -> Role | None:
    axis = next((word for word in reversed(name.words) if word in AXES), TRANSLATION.get(" ".join(name.words), ""))
    if not axis or measures(name.unit) not in ("", "length"):
        return None
    if name.has({"angle", "rot", "rotation", "euler"}):
        return Role(why="an angle about an axis; the heading is that about the upright one")
    if axis == "z":
        return Role(why="the schema's poses lie in the plane")
    if name.has(COMMAND):
        return Role((f"target.{axis}",), "where it should be")
    if name.number is not None and (name.has({"marker", "markers", "point", "led", "dot", "p"}) or name.words == (axis,)):
        return Role((f"markers.p#{axis}",), "a numbered point")
    aim = context & {"target", "goal", "setpoint", "waypoint"} and not name.has(FILM)
    if aim or (name.words == (axis,) and context & COMMAND):
        return Role((f"target.{axis}",), "the file's name says that it is a target")
    return Role((f"pose.{axis}",), "a position" + (" of the camera" if name.has(CAMERA) else ""))


def _heading(name: Header, context: set[str]) -> Role | None:
    if name.has(COMPASS):
        return Role(
            why="a compass bearing runs clockwise from north, yaw the other way from x: map it with sign = -1 and zero = 90"
        )
    stated = measures(name.unit) in ("", "angle") and not name.has(RATE | SERVO | {"joint"})
    if name.has(HEADING) and name.number is None and stated:
        if name.has(COMMAND):
            return Role(why="a wanted heading; the schema has none")
        return Role(("pose.yaw",), "a word for the heading")
    return None


def _joint(name: Header, context: set[str]) -> Role | None:
    said = measures(name.unit)
    known = name.has(SERVO | JOINT | PART) or name.words[:1] == ("action",) or name.words[:2] == ("observation", "state")
    if name.number is not None and name.words in ARRAY:  # an array on a topic of angles
        known = bool(context & (SERVO | JOINT))
    numbered = name.number is not None and (name.has(COMMAND | MEASURED) or said == "angle")
    known |= bool(name.words) and COMMAND.issuperset(name.words) or said == "angle" and name.has(COMMAND | MEASURED)
    counted = said in ("count", "share") and name.has(COMMAND | MEASURED) or said == "time" and numbered and name.has(COMMAND)
    counted = counted and not name.has(RATE | {"load"})  # ticks, or a pulse's width
    if not (known or numbered) or not (counted or said in ("", "angle", "rate")):
        return Role(why=PULSES if name.unit == "us" else f"{name.unit} measures no angle") if known and said else None
    if name.has(RATE) or said == "rate":
        if name.has(COMMAND):
            return Role(why="a commanded rate; the schema has none")
        return Role(("joint.w#",), "the rate of a joint")
    if name.has(ACCELERATION):
        return Role(why="the acceleration of a joint; the schema has none")
    if name.has({"load"}):
        return Role(("joint.load#",), "a servo's load")
    if name.has({"enabled", "enable", "torque", "mode", "status", "moving", "fault"}):
        return Role(why="a state, no angle")
    if name.has(COMMAND):
        return Role(("cmd.c#",), "a word for a command")
    if name.has(MEASURED):
        return Role(("joint.j#",), "a word for a measurement")
    if not context.isdisjoint(COMMAND):
        return Role(("cmd.c#",), "the file's name says that these are commands")
    if not context.isdisjoint(MEASURED):
        return Role(("joint.j#",), "the file's name says that these are measured")
    if name.has(SERVO):
        return Role(("cmd.c#", "joint.j#"), "a servo's angle: commanded, unless others are")
    return Role(("cmd.c#", "joint.j#"), "an angle: commanded or measured?")
