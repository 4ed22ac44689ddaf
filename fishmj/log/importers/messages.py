"""Recordings of messages (MCAP, rosbag2): topics become tables as a mapping says (`topics.py`), or sheets to be guessed at.

Messages are JSON, or CDR of ROS 2's standard types. Types that a recording defines itself are not read: the decoder would have
to generate code from the file.
"""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fishmj.errors import LogError, MissingExtra
from fishmj.log.importers import header
from fishmj.log.importers.registry import trial_of
from fishmj.log.importers.sheet import DATE, Sheet, checked
from fishmj.log.importers.topics import UNITS, Field, Topic, Topics
from fishmj.log.limits import DAMAGE, bare, quoted
from fishmj.log.trial import Table, Trial

DAY = 86_400 * 10**9  # ns; stamps further apart than this are on different clocks
DEPTH, WIDTH = 8, 64  # of a message that is spread over columns
SEQUENCE = 4096  # longest array of a CDR message that is decoded; pictures and clouds are not
KEPT = {  # types that are spread over sheets without a mapping; any other standard type can be mapped
    *("sensor_msgs/msg/JointState", "sensor_msgs/msg/BatteryState", "sensor_msgs/msg/Imu", "nav_msgs/msg/Odometry"),
    *("geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/Pose", "geometry_msgs/msg/Pose2D"),
    *("geometry_msgs/msg/PoseWithCovarianceStamped", "geometry_msgs/msg/PointStamped", "geometry_msgs/msg/Vector3Stamped"),
    *("geometry_msgs/msg/WrenchStamped", "geometry_msgs/msg/TwistStamped"),
    *("std_msgs/msg/Float64MultiArray", "std_msgs/msg/Float32MultiArray", "std_msgs/msg/Float64", "std_msgs/msg/Float32"),
}


@dataclass
class TopicChannel:
    """One topic: how its messages are written, and (log time [ns], publish time [ns], bytes) of each."""

    encoding: str
    type: str = ""
    messages: list[tuple[int, int, bytes]] = field(default_factory=list)


Found = dict[str, TopicChannel]


# ---------------------------------------------------------------------------------------------------- with a mapping
def mapped(path: Path, found: Found, wanted: Topics, own: dict | None = None) -> dict[str, Trial]:
    """One trial, named after the file.

    Args:
        own: meta data that the file carries as an export of ours: its stamps are on the trial's own clock.

    Raises:
        LogError: a topic, field or value is not as the mapping says; file:topic[message]:field.
    """
    stamps, columns = {}, {}
    for name, entry in wanted.tables.items():
        if entry.topic not in found:
            raise LogError(f"{path}: no topic {entry.topic!r} for table {name!r}; it has {listed(found)}")
        stamps[name], columns[name] = _columns(path, entry, found[entry.topic])
    times, notes = _seconds(stamps) if own is None else ({name: np.array(ns, float) / 1e9 for name, ns in stamps.items()}, [])
    tables = {}
    for name, entry in wanted.tables.items():
        order = np.argsort(times[name], kind="stable")
        table = {"t": times[name][order], **{column: values[order] for column, values in columns[name].items()}}
        tables[name] = (table, _place(path, entry.topic, order))
    clocks = {name: str(entry.clock) for name, entry in wanted.tables.items()}
    meta = {"clock": clocks, "source": path.name, **wanted.meta} if own is None else own
    return {path.stem: trial_of(path.stem, meta, tables, notes)}


def listed(found: Found) -> str:
    return ", ".join(map(repr, sorted(found)))[:300] or "none"


def _place(path: Path, topic: str, order: np.ndarray):
    return lambda row, column: f"{path}:{topic}[{order[row] if 0 <= row < len(order) else 0}]:{column or 't'}"


def _columns(path: Path, entry: Topic, channel: TopicChannel) -> tuple[list[int], Table]:
    """Stamps [ns] and columns of one topic."""
    if not channel.messages:
        raise LogError(f"{path}: topic {entry.topic!r} has no message; leave its table out")
    decode = _decoder(path, entry.topic, channel)
    first = decode(0)
    fields = entry.columns or {key: Field((key,)) for key in first if key != "t"}
    clock = entry.clock
    if entry.columns is None and clock == "log_time" and "t" in first:
        clock = Field(("t",), "s")
    stamps, rows = [], []
    for i, (log_time, publish_time, _) in enumerate(channel.messages):
        where, content = f"{path}:{entry.topic}[{i}]", decode(i)
        if isinstance(clock, Field):
            stamps.append(_stamp(f"{where}:{clock}", clock, _dig(where, content, clock)))
        else:
            stamps.append(log_time if clock == "log_time" else publish_time)
        rows.append([_number(f"{where}:{f}", _dig(where, content, f)) * f.factor for f in fields.values()])
    return stamps, dict(zip(fields, np.array(rows, float).reshape(len(rows), len(fields)).T.copy(), strict=True))


def _dig(where: str, content, wanted: Field):
    value = content
    for part in wanted.path:
        if isinstance(value, dict) and part in value:
            value = value[part]
        elif isinstance(value, list) and part.isdecimal() and len(part) < 9 and int(part) < len(value):
            value = value[int(part)]
        else:
            has = ", ".join(map(str, value))[:200] if isinstance(value, dict) else type(value).__name__
            raise LogError(f"{where}: no field {str(wanted)!r}; at {part!r} there is {has}. Name the field in the mapping")
    return value


def _number(where: str, value) -> float:
    if not isinstance(value, bool | int | float) or not abs(value) < 1e300:
        raise LogError(f"{where} = {str(value)[:30]!r}; expected a finite number. Leave the message out")
    return float(value)


def _stamp(where: str, clock: Field, value) -> int:
    """A field's time in ns: a number in the clock's unit (s unless said), or an object {sec, nanosec}."""
    if isinstance(value, dict):
        if (whole := _sec_nanosec(value)) is not None:
            return whole
        raise LogError(f"{where} = {str(value)[:60]}; expected {{sec, nanosec}} or a number")
    number = _number(where, value)
    scaled = value * 10**9 * UNITS[clock.unit] if clock.unit != "ns" else value
    if not abs(number) < 1e30:
        raise LogError(f"{where} = {str(value)[:30]!r}; expected a time in {clock.unit or 's'}")
    return round(scaled)


def _sec_nanosec(value: dict) -> int | None:
    whole, part = value.get("sec", value.get("secs")), value.get("nanosec", value.get("nsecs", value.get("nsec")))
    if type(whole) is int and type(part) is int and abs(whole) < 1e12 and 0 <= part < 10**9:
        return whole * 10**9 + part
    return None


def _seconds(stamps: dict[str, list[int]]) -> tuple[dict[str, np.ndarray], list[str]]:
    """Stamps in s after the earliest; a clock more than a day away from it gets its own zero, and a note."""
    first = {name: min(values) for name, values in stamps.items()}
    zero, notes = max(first.values()), []
    near = {name: start for name, start in first.items() if zero - start < DAY}
    zero = min(near.values())
    out = {}
    for name, values in stamps.items():
        own = zero if name in near else first[name]
        if name not in near:
            notes.append(f"{name}: its clock is {(zero - own) / 1e9:.0f} s away from the others; it starts at its own zero")
        out[name] = np.array([value - own for value in values], dtype=float) * 1e-9
    return out, notes


# -------------------------------------------------------------------------------------------------------- as sheets
def sheets(path: Path, found: Found) -> list[Sheet]:
    """Every topic whose messages hold numbers, spread over columns: `pose.position.x`; stamps as s since 1970.

    Raises:
        LogError: no such topic, or a message that does not decode.
    """
    out, notes = [], []
    for topic, channel in sorted(found.items()):
        if not channel.messages:
            continue
        if channel.encoding not in ("json", "cdr"):
            notes.append(f"{topic}: messages encoded as {quoted(channel.encoding)} are not read; {_converted(channel.encoding)}")
            continue
        if channel.encoding != "json" and channel.type not in KEPT:
            notes.append(f"{topic}: messages of {quoted(channel.type or channel.encoding)} need a mapping (--topics); left out")
            continue
        sheet = _spread(path, topic, channel)
        if sheet is not None:
            out.append(sheet)
    if not out:
        said = f" ({'; '.join(notes)[:300]})" if notes else ""
        raise LogError(f"{path}: no topic with numbers; it has {listed(found)}{said}")
    out[0] = out[0].noted(*notes)
    return out


def _spread(path: Path, topic: str, channel: TopicChannel) -> Sheet | None:
    decode = _decoder(path, topic, channel)
    stamps, rows, order = [], [], {}
    for i, (log_time, _, _) in enumerate(channel.messages):
        content = decode(i)
        stamp = _own_stamp(content)
        stamps.append(stamp if stamp else log_time)
        row = _TYPED.get(channel.type, _flat)(content)
        for key in row:
            if len(order) > WIDTH * WIDTH:
                raise LogError(f"{path}:{topic}[{i}]: over {WIDTH * WIDTH} different fields; map the ones you need with --topics")
            order.setdefault(key, len(order))
        rows.append(row)
    if not order:
        return None
    columns = {key: np.array([row.get(key, math.nan) for row in rows], float) for key in order}
    units = {}
    if not any(header.parse(key).words in (("t",), ("time",), ("timestamp",)) for key in columns):
        columns = {"stamp": np.array(stamps, float) * 1e-9, **columns}
        units["stamp"] = DATE
    return checked(Sheet(path, topic, columns, units | {k: v for k, v in _UNITS.get(channel.type, {}).items() if k in columns}))


def _own_stamp(content: dict) -> int | None:
    """Of its header, where that is set."""
    stamp = content.get("header", {}).get("stamp") if isinstance(content.get("header"), dict) else content.get("stamp")
    return _sec_nanosec(stamp) if isinstance(stamp, dict) else None


def _flat(value, prefix: str = "", depth: int = 0) -> dict[str, float]:
    """Numbers by their path; the heading of a quaternion as `<path>.yaw`."""
    out: dict[str, float] = {}
    if depth > DEPTH:
        return out
    if isinstance(value, dict):
        if set(value) == {"x", "y", "z", "w"} and all(isinstance(v, int | float) for v in value.values()):
            return {f"{prefix}.yaw".lstrip("."): _yaw(value)}
        for key, item in list(value.items())[: WIDTH * 4]:
            if key not in ("header", "stamp", "covariance"):
                out |= _flat(item, f"{prefix}.{str(key)[:80]}".lstrip("."), depth + 1)
    elif isinstance(value, list):
        for i, item in enumerate(value[:WIDTH]):
            out |= _flat(item, f"{prefix}.{i}".lstrip("."), depth + 1)
    elif isinstance(value, bool | int | float) and abs(value) < 1e300:
        out[prefix or "value"] = float(value)
    return out


def _yaw(q: dict) -> float:
    """Heading of a quaternion [rad]."""
    x, y, z, w = (float(q[k]) if abs(q[k]) < 1e6 else math.nan for k in "xyzw")
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def _joints(content: dict) -> dict[str, float]:
    out = {}
    for ours, theirs in (("joint.{}", "position"), ("joint.{}.velocity", "velocity"), ("joint.{}.effort", "effort")):
        values = content.get(theirs)
        for i, value in enumerate(values[:WIDTH] if isinstance(values, list) else (), start=1):
            if isinstance(value, int | float):
                out[ours.format(i)] = float(value)
    return out


def _battery(content: dict) -> dict[str, float]:
    """ROS counts current into the battery; the log's current is what the robot draws."""
    voltage, current = (content.get(key) for key in ("voltage", "current"))
    out = {"voltage": float(voltage)} if isinstance(voltage, int | float) else {}
    return out | ({"current_drawn": -float(current)} if isinstance(current, int | float) and math.isfinite(current) else {})


def _odometry(content: dict) -> dict[str, float]:
    """Pose in its frame, twist in the body's."""
    pose, twist = (_flat(content.get(key, {})) for key in ("pose", "twist"))
    named = {"twist.linear.x": "surge", "twist.linear.y": "sway", "twist.angular.z": "yaw_rate"}
    return {f"pose.{key}": value for key, value in pose.items()} | {
        ours: twist[key] for key, ours in named.items() if key in twist
    }


def _imu(content: dict) -> dict[str, float]:
    out = {}
    for ours, theirs in (("acc", "linear_acceleration"), ("gyro", "angular_velocity")):
        out |= {f"{ours}.{axis}": value for axis, value in _flat(content.get(theirs, {})).items() if axis in ("x", "y", "z")}
    return out


def _array(content: dict) -> dict[str, float]:
    values = content.get("data")
    return {f"value.{i}": float(v) for i, v in enumerate(values[:WIDTH] if isinstance(values, list) else (), start=1)}


_TYPED: dict[str, Callable[[dict], dict[str, float]]] = {
    "sensor_msgs/msg/JointState": _joints,
    "sensor_msgs/msg/BatteryState": _battery,
    "sensor_msgs/msg/Imu": _imu,
    "nav_msgs/msg/Odometry": _odometry,
    "std_msgs/msg/Float64MultiArray": _array,
    "std_msgs/msg/Float32MultiArray": _array,
}
_SPACE = {f"{p}{axis}": "m" for p in ("pose.position.", "pose.pose.position.", "position.", "point.") for axis in "xyz"}
_TURN = {f"{p}orientation.yaw": "rad" for p in ("pose.", "pose.pose.", "")}
_UNITS: dict[str, dict[str, str]] = {  # ROS's own: REP 103
    "sensor_msgs/msg/JointState": {
        f"joint.{i}{end}": unit for i in range(1, WIDTH + 1) for end, unit in (("", "rad"), (".velocity", "rad/s"))
    },
    "sensor_msgs/msg/BatteryState": {"voltage": "V", "current_drawn": "A"},
    "sensor_msgs/msg/Imu": {f"{k}.{axis}": unit for axis in "xyz" for k, unit in (("acc", "m/s^2"), ("gyro", "rad/s"))},
    "nav_msgs/msg/Odometry": {**_SPACE, **_TURN, "surge": "m/s", "sway": "m/s", "yaw_rate": "rad/s"},
    "geometry_msgs/msg/Pose2D": {"x": "m", "y": "m", "theta": "rad"},
    "geometry_msgs/msg/Pose": {**_SPACE, **_TURN},
    "geometry_msgs/msg/PoseStamped": {**_SPACE, **_TURN},
    "geometry_msgs/msg/PoseWithCovarianceStamped": {**_SPACE, **_TURN},
    "geometry_msgs/msg/PointStamped": _SPACE,
}


# ------------------------------------------------------------------------------------------------------------ decoding
def _decoder(path: Path, topic: str, channel: TopicChannel) -> Callable[[int], dict]:
    """Message number -> its content as dictionaries, lists and numbers."""
    if channel.encoding == "json":
        return lambda i: _json(f"{path}:{topic}[{i}]", channel.messages[i][2])
    if channel.encoding == "cdr" and channel.type:
        store = _standard_types()
        if channel.type not in store.fielddefs:
            raise LogError(
                f"{path}:{topic}: messages of type {quoted(channel.type, 80)}, which is none of ROS 2's standard types; "
                "publish the numbers as JointState, PoseStamped or Float64MultiArray, or convert the recording to JSON messages"
            )
        return lambda i: _cdr(f"{path}:{topic}[{i}]", store, channel.type, channel.messages[i][2])
    raise LogError(
        f"{path}:{topic}: messages are encoded as {quoted(channel.encoding)}{'' if channel.type else ' without a schema'}; "
        f"expected json, or cdr of ROS 2's standard types; {_converted(channel.encoding)}"
    )


def _converted(encoding: str) -> str:
    """How a recording in another encoding becomes one that is read."""
    if encoding == "protobuf":
        return (
            "convert the recording to JSON messages: pip install mcap-protobuf-support and run the lines under "
            '"Protobuf" in docs/guide/logs.md (make_reader with its DecoderFactory, MessageToDict, write as json)'
        )
    return "convert the recording to JSON messages"


def _json(where: str, data: bytes) -> dict:
    try:
        content = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise LogError(f"{where}: not valid JSON: {bare(error, 100)}; record it again") from error
    if not isinstance(content, dict):
        raise LogError(f"{where}: the message is no JSON object but {type(content).__name__}; expected named fields")
    return content


def _standard_types():
    try:
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise MissingExtra("rosbags", "logs", "Reading CDR messages of ROS 2") from error
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.max_sequence_length = SEQUENCE
    return store


def _cdr(where: str, store, kind: str, data: bytes) -> dict:
    from rosbags.serde import SerdeError

    try:
        return _plain(store.deserialize_cdr(data, kind))
    except (SerdeError, *DAMAGE) as error:
        raise LogError(f"{where}: not a valid {kind} message ({bare(error, 100)}); record it again") from error


def _plain(message) -> dict:
    """A decoded message as dictionaries."""
    if isinstance(message, np.ndarray | list):
        return [_plain(item) for item in (message.tolist() if isinstance(message, np.ndarray) else message)]  # type: ignore[return-value]
    if hasattr(message, "__dataclass_fields__"):
        return {name: _plain(getattr(message, name)) for name in message.__dataclass_fields__ if not name.startswith("_")}
    return message
