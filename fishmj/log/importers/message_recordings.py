"""Recordings of messages (MCAP, rosbag2): a mapping turns topics into tables (`topics.py`); without one they become sheets."""

import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from fishmj.base.errors import LogError
from fishmj.log.importers import header, table_forms
from fishmj.log.importers.column_map import is_column
from fishmj.log.importers.decoding import Found, TopicChannel, converted, decoder, read_json
from fishmj.log.importers.joint_names import STATE, column_of
from fishmj.log.importers.quaternion import heading
from fishmj.log.importers.registry import trial_of
from fishmj.log.importers.sheet import DATE, Sheet, checked
from fishmj.log.importers.topics import UNITS, MessageField, Topic, Topics, by_name
from fishmj.log.limits import quoted
from fishmj.log.trial import Table, Trial, table_spec

DAY = 86_400 * 10**9  # ns; stamps further apart than this are on different clocks
DEPTH, WIDTH = 8, 64  # of a message that is spread over columns
NAMES = ("name", "names", "joint_names")  # keys of lists of names beside lists of values
NAMED = ("name", "joint_name", "child_frame_id", "id", "joint_id", "servo_id")  # keys of the name of one object in a list
BESIDE = 2e6  # ns between the messages of one burst; a shift of 2 ms in a stamp is seen as damping
OVERTAKEN, OVERTAKES = 3, 10**9  # messages at least, and ns at most, by which one publisher's stamps fall behind another's
ABSENT = object()  # the value of a joint that a message does not name
TRAJECTORY, PLANS = "trajectory_msgs/msg/JointTrajectory", "trajectories of several points"
SINGLE = ("std_msgs/msg/Float64", "std_msgs/msg/Float32")  # one number, which its topic names
KEPT = {  # types that are spread over sheets without a mapping; any other standard type can be mapped
    *("sensor_msgs/msg/JointState", "sensor_msgs/msg/BatteryState", "sensor_msgs/msg/Imu", "nav_msgs/msg/Odometry"),
    *("geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/Pose", "geometry_msgs/msg/Pose2D"),
    *("geometry_msgs/msg/PoseWithCovarianceStamped", "geometry_msgs/msg/PointStamped", "geometry_msgs/msg/Vector3Stamped"),
    "geometry_msgs/msg/TransformStamped",
    *("geometry_msgs/msg/WrenchStamped", "geometry_msgs/msg/TwistStamped"),
    *(TRAJECTORY, *SINGLE, "std_msgs/msg/Float64MultiArray", "std_msgs/msg/Float32MultiArray"),
}


# ---------------------------------------------------------------------------------------------------- with a mapping
def mapped(path: Path, found: Found, wanted: Topics, own: dict | None = None, notes: Sequence[str] = ()) -> dict[str, Trial]:
    """Reads one trial, named after the file.

    Args:
        own: meta data that the file carries as an export of ours: its stamps are on the trial's own clock.
        notes: remarks of the file's reader.

    Raises LogError: a topic, field or value does not match the mapping; file:topic[message]:field.
    """
    stamps, columns, told = {}, {}, []
    for name, entry in wanted.tables.items():
        if entry.topic not in found:
            raise LogError(f"{path}: no topic {entry.topic!r} for table {name!r}; it has {listed(found)}")
        stamps[name], columns[name], left_out, apart = _columns(path, entry, found[entry.topic])
        if own is None and (several := next((said for c, said in apart.items() if c not in (entry.columns or ())), "")):
            raise LogError(f"{path}:{entry.topic}: {several}")
        told += left_out
    times, moved = _seconds(stamps) if own is None else ({name: np.array(ns, float) / 1e9 for name, ns in stamps.items()}, [])
    tables = {}
    for name, entry in wanted.tables.items():
        order = np.argsort(times[name], kind="stable")
        table = {"t": times[name][order], **{column: values[order] for column, values in columns[name].items()}}
        tables[name] = (table, _place(path, entry.topic, order))
    clocks = {name: str(entry.clock) for name, entry in wanted.tables.items()}
    meta = {"clock": clocks, "source": path.name, **wanted.meta} if own is None else own
    return {path.stem: trial_of(path.stem, meta, tables, [*notes, *moved, *told])}


def named_like_tables(found: Found) -> Topics:
    """Mapping of JSON topics that are named like tables and whose first message has columns of that table."""
    wanted = by_name({topic for topic, channel in found.items() if channel.encoding == "json" and channel.messages})
    first = {topic: read_json(topic, found[topic].messages[0][2]) for topic in {entry.topic for entry in wanted.tables.values()}}
    return Topics({n: e for n, e in wanted.tables.items() if any(is_column(table_spec(n), key) for key in first[e.topic])})


def listed(found: Found) -> str:
    """Names of the topics for a message, sorted and shortened; `none` without any."""
    return ", ".join(map(repr, sorted(found)))[:300] or "none"


def _place(path: Path, topic: str, order: np.ndarray):
    return lambda row, column: f"{path}:{topic}[{order[row] if 0 <= row < len(order) else 0}]:{column or 't'}"


def _columns(path: Path, entry: Topic, channel: TopicChannel) -> tuple[list[int], Table, list[str], dict[str, str]]:
    """Stamps [ns], columns, notes and what tells robots apart. A message that names only other joints is left out."""
    if not channel.messages:
        raise LogError(f"{path}: topic {entry.topic!r} has no message; leave its table out")
    decode = decoder(path, entry.topic, channel)
    first = decode(0)
    texts = {key for key in table_forms.labels(first) if isinstance(first.get(key), str)}
    fields = entry.columns or {key: MessageField((key,)) for key in first if key != "t" and key not in texts}
    clock = entry.clock
    if entry.columns is None and clock == "log_time" and "t" in first:
        clock = MessageField(("t",), "s")
    stamps, rows, joints, others, labels = [], [], {}, 0, []
    for i, (log_time, publish_time, _) in enumerate(channel.messages):
        where, content = f"{path}:{entry.topic}[{i}]", decode(i)
        labels.append(table_forms.labels(content))
        found = [_dig(where, content, f) for f in fields.values()]
        if any(value is ABSENT for value, _ in found):
            others += 1
            continue
        for f, (_, joint) in zip(fields.values(), found, strict=True):
            if joints.setdefault(f, joint) != joint:
                raise LogError(
                    f"{where}: {f} is of joint {quoted(joint)}, in messages before it of {quoted(joints[f])}: the order of its "
                    f"names changes; name the joint in the mapping: {'.'.join((*f.path[:-1], joints[f] or joint))}"
                )
        if isinstance(clock, MessageField):
            stamps.append(_stamp(f"{where}:{clock}", clock, _dig(where, content, clock)[0]))
        else:
            stamps.append(log_time if clock == "log_time" else publish_time)
        rows.append([_number(f"{where}:{f}", value) * f.factor for f, (value, _) in zip(fields.values(), found, strict=True)])
    if not rows:
        names = ", ".join(map(quoted, _names(first) or ()))
        raise LogError(f"{path}: no message of topic {entry.topic!r} names all joints of the mapping; the first has {names}")
    notes = (
        [f"{entry.topic}: {others} of {len(channel.messages)} messages left out: not all of its joints are named"]
        if others
        else []
    )
    values = np.array(rows, float).reshape(len(rows), len(fields)).T.copy()
    return stamps, dict(zip(fields, values, strict=True)), notes, table_forms.told_apart(labels)


def _dig(where: str, content, wanted: MessageField) -> tuple[Any, str]:
    """Value at a path, and the joint that the message names for it; (ABSENT, joint) if the message lacks that joint.

    `position.tail_joint` is the value at the place of `tail_joint` in the message's own list of names.
    """
    value, names, joint = content, None, ""
    for k, part in enumerate(wanted.path):
        if isinstance(value, dict):
            names = _names(value) or names
        if isinstance(value, dict) and part in value:
            value = value[part]
        elif isinstance(value, dict) and part == "yaw" and set(value) == set("xyzw"):
            value = _yaw(f"{where}:{wanted}", value)
        elif isinstance(value, list) and part.isdecimal() and len(part) < 9 and int(part) < len(value):
            joint = names[int(part)] if names and len(names) == len(value) else joint
            value = value[int(part)]
        elif isinstance(value, list) and names and not part.isdecimal():
            joint = ".".join(wanted.path[k:])  # a name may hold dots itself
            if joint not in names:
                return ABSENT, joint
            if len(value) != len(names) or names.count(joint) > 1:
                raise LogError(f"{where}: {len(value)} values for the names {', '.join(map(quoted, names))}; record it again")
            return value[names.index(joint)], joint
        else:
            has = ", ".join(map(str, value))[:200] if isinstance(value, dict) else type(value).__name__
            raise LogError(f"{where}: no field {str(wanted)!r}; at {part!r} there is {has}. Name the field in the mapping")
    return value, joint


def _yaw(where: str, value: dict) -> float:
    """Heading [rad] of one quaternion."""
    yaw, doubt = heading(np.array([[_number(f"{where}:{part}", value[part]) for part in "xyzw"]]), where)
    if doubt or not np.isfinite(yaw[0]):
        raise LogError(f"{where}: {doubt or 'the quaternion is 0, 0, 0, 0: it was not set'}; leave yaw out of the mapping")
    return float(yaw[0])


def _names(value: dict) -> list[str] | None:
    """Joint names in a message beside lists of their values; None without any."""
    for key in NAMES:
        names = value.get(key)
        if isinstance(names, list) and names and all(isinstance(name, str) for name in names):
            return names
    return None


def _number(where: str, value) -> float:
    if not isinstance(value, bool | int | float) or not abs(value) < 1e300:
        raise LogError(f"{where} = {str(value)[:30]!r}; expected a finite number. Leave the message out")
    return float(value)


def _stamp(where: str, clock: MessageField, value) -> int:
    """Time of a field in ns: a number in the clock's unit (s by default), or an object {sec, nanosec}."""
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
def sheets(path: Path, found: Found, notes: Sequence[str] = ()) -> list[Sheet]:
    """Sheets of all topics whose messages hold numbers, spread over columns: `pose.position.x`; stamps as s since 1970.

    Raises LogError: no such topic, or a message that does not decode.
    """
    rows: dict[str, _Rows] = {}
    notes = list(notes)
    for topic, channel in sorted(found.items()):
        if not channel.messages:
            continue
        if channel.encoding not in ("json", "cdr"):
            notes.append(f"{topic}: messages encoded as {quoted(channel.encoding)} are not read; {converted(channel.encoding)}")
            continue
        if channel.encoding != "json" and channel.type not in KEPT:
            notes.append(f"{topic}: messages of {quoted(channel.type or channel.encoding)} need a mapping (--topics); left out")
            continue
        if (read := _rows(path, topic, channel)) is not None:
            rows[topic] = read
        else:
            notes.append(f"{topic}: no number in its {len(channel.messages)} messages; left out")
    if not rows:
        text = f" ({'; '.join(notes)[:300]})" if notes else ""
        raise LogError(f"{path}: no topic with numbers; it has {listed(found)}{text}")
    foreign = {topic for topic, read in rows.items() if abs(read.ahead) > DAY}
    for topic in sorted(foreign) if foreign < set(rows) else ():
        notes.append(f"{topic}: the stamps of its headers are on another clock; stamped by its receipt, as other topics are")
        rows[topic].stamps = rows[topic].receipts
    rows = _together(rows, {topic: found[topic].type for topic in rows})
    out = [read.sheet(path, topic, found[topic].type if topic in found else "") for topic, read in rows.items()]
    return [out[0].noted(*notes), *out[1:]]


@dataclass
class _Rows:
    """Messages of one topic as rows: their stamps [ns] by header or receipt, and the numbers of each."""

    receipts: list[int]
    stamps: list[int]
    values: list[dict[str, float]]
    notes: Counter[str]
    apart: dict[str, str] = field(default_factory=dict)

    @property
    def ahead(self) -> float:
        """Median time from a message's stamp to its receipt [ns]."""
        return float(np.median([receipt - stamp for receipt, stamp in zip(self.receipts, self.stamps, strict=True)]))

    def sheet(self, path: Path, topic: str, kind: str) -> Sheet:
        """The rows as columns; messages of one instant with different fields form one row."""
        stamps: list[int] = []
        rows: list[dict[str, float]] = []
        for stamp, row in self._in_order():
            if stamps and stamps[-1] == stamp and rows[-1].keys().isdisjoint(row):
                rows[-1] |= row
            else:
                stamps.append(stamp)
                rows.append(dict(row))
        columns = {key: np.array([row.get(key, math.nan) for row in rows], float) for key in dict.fromkeys(chain(*rows))}
        units = dict(_UNITS.get(kind, {}))
        if kind.startswith("sensor_msgs/") and kind.endswith("/JointState"):
            units |= {f"joint.{key}": "rad" for key in _joints_of(columns)}
            units |= {f"joint.{key}.velocity": "rad/s" for key in _joints_of(columns)}
        units |= {key: "rad" for key in columns if kind == TRAJECTORY}
        if not any(header.parse(key).words in (("t",), ("time",), ("timestamp",)) for key in columns):
            columns = {"stamp": np.array(stamps, float) * 1e-9, **columns}
            units["stamp"] = DATE
        units = {key: unit for key, unit in units.items() if key in columns}
        told = tuple(f"{topic}: {note}, in {n} of {len(self.values)} messages" for note, n in self.notes.items() if n)
        columns |= {key: np.full(len(stamps), math.nan) for key in self.apart if key not in columns}
        doubts = _unnamed(columns) | self._planned(columns)
        return checked(Sheet(path, topic, columns, units, notes=told, doubts=doubts, apart=self.apart))

    def _planned(self, columns: Iterable[str]) -> dict[str, str]:
        """Doubts about trajectories of several points."""
        why = "trajectories of several points, of which this is the first: map none of them, or publish one point a message"
        return dict.fromkeys((key for key in columns if key.startswith("command.")), why) if self.notes[PLANS] else {}

    def _in_order(self) -> list[tuple[int, dict[str, float]]]:
        """Stamps and values; sorted if publishers overtake one another, unchanged if the clock was set back once."""
        pairs = list(zip(self.stamps, self.values, strict=True))
        back = [a - b for a, b in pairwise(self.stamps) if a > b]
        if len(back) >= OVERTAKEN and max(back) < OVERTAKES:
            self.notes["stamped before a message that came earlier, sorted by stamp"] = len(back)
            pairs.sort(key=lambda pair: pair[0])
        return pairs


def _rows(path: Path, topic: str, channel: TopicChannel) -> _Rows | None:
    """Messages of a topic as rows; None if they hold no number."""
    decode = decoder(path, topic, channel)
    out, keys = _Rows([], [], [], Counter()), set()
    own, labels = [], []
    for i, (log_time, _, _) in enumerate(channel.messages):
        where, content = f"{path}:{topic}[{i}]", decode(i)
        own.append(_own_stamp(content))
        labels.append(table_forms.labels(content))
        if channel.type == TRAJECTORY:
            row = _trajectory(where, content, out.notes)
        else:
            row = _joints(where, content, out.notes) if _is_joint_state(content) else _TYPED.get(channel.type, _flat)(content)
        keys |= row.keys()
        if len(keys) > WIDTH * WIDTH:
            raise LogError(f"{where}: over {WIDTH * WIDTH} different fields; map the ones you need with --topics")
        out.receipts.append(log_time)
        out.values.append(row)
    if any(own) and not all(own):
        out.notes["no stamp in its header, so that all are stamped by their receipt"] = sum(not stamp for stamp in own)
    out.stamps = [stamp for stamp in own if stamp] if all(own) else out.receipts
    out.apart = table_forms.told_apart(labels)
    return out if keys else None


def _together(rows: dict[str, _Rows], kinds: dict[str, str]) -> dict[str, _Rows]:
    """The topics, with those of one number a joint (`/joint1/command`, `/joint2/command`), sent side by side, joined."""
    groups: dict[str, list[str]] = {}
    for topic, kind in kinds.items():
        said = header.words(topic)
        if kind in SINGLE and not (header.SERVO | header.JOINT).isdisjoint(said):
            rows[topic].values = [{" ".join(said): value for value in row.values()} for row in rows[topic].values]
            groups.setdefault(re.sub(r"\d+", "#", topic), []).append(topic)
    out = dict(rows)
    for name, topics in groups.items():
        sent = sorted(
            (s, t, v) for t in topics for s, row in zip(rows[t].stamps, rows[t].values, strict=True) for v in row.items()
        )
        period = float(np.median(np.diff(rows[topics[0]].stamps))) if len(rows[topics[0]].stamps) > 1 else 0.0
        bursts: list[dict[str, tuple[int, str, tuple]]] = []
        for one in sent:
            if not bursts or one[1] in bursts[-1] or one[0] - next(iter(bursts[-1].values()))[0] > min(period / 2, BESIDE):
                bursts.append({})
            bursts[-1][one[1]] = one
        whole = [burst for burst in bursts if len(burst) == len(topics)]
        if len(topics) > 1 and len(whole) >= max(2, 0.99 * len(bursts)):
            last = [max(one[0] for one in burst.values()) for burst in whole]
            values = [dict(one[2] for one in burst.values()) for burst in whole]
            notes = Counter({f"messages of {', '.join(topics)} are one row, stamped by the last": len(whole)})
            out = {topic: read for topic, read in out.items() if topic not in topics} | {name: _Rows(last, last, values, notes)}
    return out


def _joints_of(columns: Iterable[str]) -> list[str]:
    """Names of the joints in the columns of a JointState."""
    ends = tuple(end for end in STATE.values() if end)
    return [key.removeprefix("joint.") for key in columns if key.startswith("joint.") and not key.endswith(ends)]


def _unnamed(columns: Iterable[str]) -> dict[str, str]:
    """Doubts about joints identified by position, in a topic whose other messages name theirs."""
    joints = _joints_of(columns)
    placed = [name for name in joints if name.isdecimal()]
    why = "messages without names beside messages that name their joints: which joint is it?"
    return {f"joint.{name}": why for name in placed} if len(placed) < len(joints) else {}


def _own_stamp(content: dict) -> int | None:
    """Stamp of a message's header in ns, None if it is not set."""
    stamp = content.get("header", {}).get("stamp") if isinstance(content.get("header"), dict) else content.get("stamp")
    return _sec_nanosec(stamp) if isinstance(stamp, dict) else None


def _flat(value, prefix: str = "", depth: int = 0, names: list[str] | None = None) -> dict[str, float]:
    """Numbers by their path; a list beside a list of equally many names by these names."""
    out: dict[str, float] = {}
    if depth > DEPTH:
        return out
    if isinstance(value, dict):
        names = _names(value) or names
        for key, item in list(value.items())[: WIDTH * 4]:
            if key not in ("header", "stamp", "covariance"):
                out |= _flat(item, f"{prefix}.{str(key)[:80]}".lstrip("."), depth + 1, names)
    elif isinstance(value, list):
        names = names if names and len(names) == len(value) else _names_of(value)
        keys = names or range(len(value))
        for key, item in list(zip(keys, value, strict=True))[:WIDTH]:
            out |= _flat(item, f"{prefix}.{str(key)[:80]}".lstrip("."), depth + 1)
    elif isinstance(value, bool | int | float) and abs(value) < 1e300:
        out[prefix or "value"] = float(value)
    return out


def _names_of(items: list) -> list[str]:
    """Names of the objects in a list, if all have different names; else none."""
    for key in NAMED:
        named = [item[key] for item in items if isinstance(item, dict) and type(item.get(key)) in (str, int)]
        names = list(map(str, named))
        if len(names) == len(items) == len(set(names)):
            return names
    return []


def _is_joint_state(content: dict) -> bool:
    """Returns True for a message of names beside positions, velocities or efforts, in any encoding."""
    return isinstance(content.get("name"), list) and any(isinstance(content.get(key), list) for key in STATE)


def _joints(where: str, content: dict, notes: Counter) -> dict[str, float]:
    """Columns `joint.NAME`, `joint.NAME.velocity`, `joint.NAME.effort` by the message's own names, by position if it has none.

    Raises LogError: a name appears twice, or there are positions for some of the names only.
    """
    names = _names(content) or []
    if len(set(names)) < len(names):
        raise LogError(f"{where}: joint {quoted(max(names, key=names.count))} is named twice; record it again")
    out = {}
    for key in STATE:
        values = content.get(key)
        if not isinstance(values, list) or not values:
            continue
        if names and len(values) != len(names):
            if key == "position":
                raise LogError(f"{where}: {len(values)} positions for {len(names)} names: which joint is which? Record it again")
            notes[f"{key} not read, its list is not as long as that of the names"] += 1
            continue
        for name, value in zip(names or map(str, range(1, len(values) + 1)), values, strict=True):
            if isinstance(value, int | float) and abs(value) < 1e300:
                out[column_of(name[:80], key)] = float(value)
    return out


def _trajectory(where: str, content: dict, notes: Counter) -> dict[str, float]:
    """Columns `command.NAME` by the message's own names: the angles of its first point.

    Raises LogError: there are angles for some of the names only.
    """
    names, points = _names(content) or [], content.get("points") or [{}]
    values = points[0].get("positions") or []
    if len(values) != len(names) or len(set(names)) < len(names):
        raise LogError(f"{where}: {len(values)} positions for the names {', '.join(map(quoted, names))}; record it again")
    notes[PLANS] += len(points) > 1
    return {f"command.{name[:80]}": float(value) for name, value in zip(names, values, strict=True)}


def _battery(content: dict) -> dict[str, float]:
    """Battery values with the current that the robot draws, as in the log; ROS counts current into the battery."""
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
    "sensor_msgs/msg/BatteryState": _battery,
    "sensor_msgs/msg/Imu": _imu,
    "nav_msgs/msg/Odometry": _odometry,
    "std_msgs/msg/Float64MultiArray": _array,
    "std_msgs/msg/Float32MultiArray": _array,
}
_PLACES = ("pose.position.", "pose.pose.position.", "transform.translation.")
_SPACE = {f"{p}{axis}": "m" for p in (*_PLACES, "position.", "point.") for axis in "xyz"}
_UNITS: dict[str, dict[str, str]] = {  # ROS's own: REP 103
    "sensor_msgs/msg/BatteryState": {"voltage": "V", "current_drawn": "A"},
    "sensor_msgs/msg/Imu": {f"{k}.{axis}": unit for axis in "xyz" for k, unit in (("acc", "m/s^2"), ("gyro", "rad/s"))},
    "nav_msgs/msg/Odometry": {**_SPACE, "surge": "m/s", "sway": "m/s", "yaw_rate": "rad/s"},
    "geometry_msgs/msg/Pose2D": {"x": "m", "y": "m", "theta": "rad"},
    "geometry_msgs/msg/Pose": _SPACE,
    "geometry_msgs/msg/PoseStamped": _SPACE,
    "geometry_msgs/msg/PoseWithCovarianceStamped": _SPACE,
    "geometry_msgs/msg/PointStamped": _SPACE,
    "geometry_msgs/msg/TransformStamped": _SPACE,
}
