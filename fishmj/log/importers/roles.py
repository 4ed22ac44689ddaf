"""What one column may be, by its name alone: a table and column of ours, several, or none with the reason."""

from dataclasses import dataclass, field

from fishmj.log.importers import header
from fishmj.log.importers.column_units import measures
from fishmj.log.importers.header import Header

AXES = {"x", "y", "z"}


@dataclass(frozen=True)
class Role:
    """`places`: "cmd.c#" and the like, # for the column's number; none: left out because of `why`; several: unclear."""

    places: tuple[str, ...] = ()
    why: str = ""
    context: frozenset[str] = field(default_factory=frozenset)


def role(name: Header, context: set[str]) -> Role:
    """The places that a column's name allows.

    Args:
        context: words of the file's name or the topic: `commands.csv` tells what its columns are.
    """
    for rule in (_force, _exact, _time, _power, _imu, _velocity, _place, _heading, _joint):
        if found := rule(name, context):
            return found
    return Role(why="the name says nothing that the log's schema knows")


def _exact(name: Header, context: set[str]) -> Role | None:
    """Names of the schema itself."""
    if name.words in (("c",), ("j",)) and name.number is not None and measures(name.unit) in ("", "angle"):
        return Role(("cmd.c#" if name.words == ("c",) else "joint.j#",), "the schema's own name")
    if name.words == ("w",) and name.number is not None:
        return Role(("joint.w#",), "the schema's own name")
    if name.words == ("on",) and name.number is not None:
        return Role(("cmd.on#",), "the schema's own name")
    if name.words in (("amplitude",), ("bias",)) and measures(name.unit) in ("", "angle"):
        return Role((f"gait.{name.words[0]}",), "the schema's own name")
    return None


def _force(name: Header, context: set[str]) -> Role | None:
    if (
        name.has(header.FORCE)
        or measures(name.unit) in ("force", "torque")
        or (context & header.FORCE and not name.has(header.TIME))
    ):
        return Role(why="a force or torque; the schema's wrench holds those of every link, so it is left out")
    if measures(name.unit) in ("mass", "power", "share", "count") and not name.has(header.SERVO | header.JOINT):
        return Role(why=f"{name.unit}: the schema has no such column")
    if name.has(header.NOWHERE):
        return Role(why="the schema has no such column")
    return None


def _time(name: Header, context: set[str]) -> Role | None:
    if not name.has(header.TIME) or name.has(AXES | header.SERVO | header.JOINT) or measures(name.unit) not in ("", "time"):
        return None
    if name.has({"rx", "arrival", "received", "delay", "delta", "dt", "duration", "since"}):
        return Role(why="a time, but not the stamp of the row")
    return Role(("t",), "a word for time" + (" and its unit" if name.unit else ""))


def _power(name: Header, context: set[str]) -> Role | None:
    if name.has(header.CAMERA):  # cam_u, cam_v
        return None
    said, alone = measures(name.unit), not name.has(header.SERVO | header.JOINT) and name.number is None
    battery = name.has(header.BATTERY) or not context.isdisjoint(header.BATTERY)
    volts = name.has(header.VOLT - {"u"}) or name.words in (("v",), ("u",)) or (battery and name.has({"v", "u"}))
    if said == "voltage" or (volts and not said):
        return Role(("power.V",), "a word or unit of voltage") if alone else Role(why="the voltage of one servo")
    amps = name.has(header.CURRENT) or (name.words == ("i",) and alone) or (battery and name.has({"i"}))
    if said == "current" or (amps and not said):
        return Role(("power.I",), "a word or unit of current") if alone else Role(why="the current of one servo")
    if name.has(header.BATTERY - {"bus", "power", "supply"}) and alone:
        return Role(("power.V", "power.I"), "a battery's voltage or its current?")
    if name.has(header.TEMPERATURE):
        if name.number is not None:
            return Role(("joint.temp#",), "a servo's temperature")
        return Role(why="a temperature of no servo")
    return None


def _imu(name: Header, context: set[str]) -> Role | None:
    axis = next((word for word in name.words if word in AXES), "")
    if axis and (name.has(header.ACCELERATION) or measures(name.unit) == "acceleration"):
        return Role((f"imu.a{axis}",), "an acceleration")
    if name.words[-1:] in (("ax",), ("ay",), ("az",)):
        return Role((f"imu.{name.words[-1]}",), "an acceleration")
    if axis and (name.has({"gyro", "gyroscope", "angular"}) or ("omega" in name.words)):
        return Role((f"imu.w{axis}",), "a turning rate")
    if name.words[-1:] in (("gx",), ("gy",), ("gz",), ("wx",), ("wy",), ("wz",)):
        return Role((f"imu.w{name.words[-1][1]}",), "a turning rate")
    return None


def _velocity(name: Header, context: set[str]) -> Role | None:
    if name.words[-1:] in (("surge",), ("sway",)):
        return Role((f"velocity.{name.words[-1]}",), "a velocity of the body")
    if name.has(header.HEADING - {"theta"}) and name.has(header.RATE):
        return Role(("velocity.yaw_rate",), "the rate of the heading")
    if (
        (name.has(AXES) and name.has(header.RATE))
        or name.words[-1:] in (("vx",), ("vy",), ("vz",))
        or measures(name.unit) == "speed"
    ):
        return Role(why="a velocity that may be of the tank or of the body; the schema's is the body's surge and sway")
    return None


def _place(name: Header, context: set[str]) -> Role | None:
    axis = next((word for word in reversed(name.words) if word in AXES), "")
    if not axis or measures(name.unit) not in ("", "length"):
        return None
    if axis == "z":
        return Role(why="the schema's poses lie in the plane")
    if name.has(header.COMMAND):
        return Role((f"target.{axis}",), "where it should be")
    if name.number is not None and (name.has({"marker", "markers", "point", "led", "dot", "p"}) or name.words == (axis,)):
        return Role((f"markers.p#{axis}",), "a numbered point")
    if context & {"target", "goal", "setpoint", "waypoint"} or (name.words == (axis,) and context & header.COMMAND):
        return Role((f"target.{axis}",), "the file's name says that it is a target")
    return Role((f"pose.{axis}",), "a position" + (" of the camera" if name.has(header.CAMERA) else ""))


def _heading(name: Header, context: set[str]) -> Role | None:
    if name.has(header.COMPASS):
        return Role(
            why="a compass bearing runs clockwise from north, yaw the other way from x: map it with sign = -1 and zero = 90"
        )
    if (
        name.has(header.HEADING)
        and name.number is None
        and measures(name.unit) in ("", "angle")
        and not name.has(header.SERVO | {"joint"})
    ):
        if name.has(header.COMMAND):
            return Role(why="a wanted heading; the schema has none")
        return Role(("pose.yaw",), "a word for the heading")
    return None


def _joint(name: Header, context: set[str]) -> Role | None:
    said = measures(name.unit)
    known = name.has(header.SERVO | header.JOINT | header.PART)
    if name.number is not None and name.words in (("value",), ("data",), ("values",)):  # an array on a topic of angles
        known = bool(context & (header.SERVO | header.JOINT))
    numbered = name.number is not None and (name.has(header.COMMAND | header.MEASURED) or said == "angle")
    if not (known or numbered) or said not in ("", "angle", "rate"):
        return Role(why=f"{name.unit} measures no angle") if known and said else None
    if name.has(header.RATE) or said == "rate":
        return (
            Role(("joint.w#",), "the rate of a joint")
            if not name.has(header.COMMAND)
            else Role(why="a commanded rate; the schema has none")
        )
    if name.has({"load"}):
        return Role(("joint.load#",), "a servo's load")
    if name.has({"enabled", "enable", "torque", "mode", "status"}):
        return Role(why="a state, no angle")
    if name.has(header.COMMAND):
        return Role(("cmd.c#",), "a word for a command")
    if name.has(header.MEASURED):
        return Role(("joint.j#",), "a word for a measurement")
    if not context.isdisjoint(header.COMMAND):
        return Role(("cmd.c#",), "the file's name says that these are commands")
    if not context.isdisjoint(header.MEASURED):
        return Role(("joint.j#",), "the file's name says that these are measured")
    if name.has(header.SERVO):
        return Role(("cmd.c#", "joint.j#"), "a servo's angle: commanded, unless others are", frozenset({"servo"}))
    return Role(("cmd.c#", "joint.j#"), "an angle: commanded or measured?")
