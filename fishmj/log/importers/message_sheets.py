"""Recordings of messages (MCAP, rosbag2) without a mapping: a sheet of columns for each topic."""

import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from itertools import chain, pairwise
from pathlib import Path

import numpy as np

from fishmj.base.errors import LogError
from fishmj.log.importers import header, table_forms
from fishmj.log.importers.decoding import NAMES, Found, TopicChannel, converted, decoder, is_odd_stamp, names_in, own_stamp
from fishmj.log.importers.joint_names import STATE, column_of
from fishmj.log.importers.sheet import DATE, Sheet, checked
from fishmj.log.limits import quoted

DAY = 86_400 * 10**9  # ns; stamps further apart than this are on different clocks
DEPTH, WIDTH = 8, 64  # of a message that is spread over columns
NAMED = ("name", "joint_name", "child_frame_id", "id", "joint_id", "servo_id")  # keys of the name of one object in a list
BESIDE = 2e6  # ns between the messages of one burst; a shift of 2 ms in a stamp is seen as damping
OVERTAKEN, OVERTAKES = 3, 10**9  # messages at least, and ns at most, by which one publisher's stamps fall behind another's
TRAJECTORY, PLANS = "trajectory_msgs/msg/JointTrajectory", "trajectories of several points"
SINGLE = ("std_msgs/msg/Float64", "std_msgs/msg/Float32")  # one number, which its topic names
_NUMBER = re.compile(r"\s*[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?\s*", re.ASCII | re.IGNORECASE)
FOREIGN = "the stamps of its headers are on another clock; stamped by its receipt, as other topics are"
CUT = f"lists are read to {WIDTH} values, fields to {4 * WIDTH} and {DEPTH} levels; map what you need beyond (--topics)"
UNSTAMPED = "no stamp in its header, so that all are stamped by their receipt"
ODD = "its header's stamp is no {sec, nanosec}, so that it is stamped by its receipt; map t to it (--topics) if it is a number"
KEPT = {  # types that are spread over sheets without a mapping; any other standard type can be mapped
    *("sensor_msgs/msg/JointState", "sensor_msgs/msg/BatteryState", "sensor_msgs/msg/Imu", "nav_msgs/msg/Odometry"),
    *("geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/Pose", "geometry_msgs/msg/Pose2D"),
    *("geometry_msgs/msg/PoseWithCovarianceStamped", "geometry_msgs/msg/PointStamped", "geometry_msgs/msg/Vector3Stamped"),
    "geometry_msgs/msg/TransformStamped",
    *("geometry_msgs/msg/WrenchStamped", "geometry_msgs/msg/TwistStamped"),
    *(TRAJECTORY, *SINGLE, "std_msgs/msg/Float64MultiArray", "std_msgs/msg/Float32MultiArray"),
}


def sheets(path: Path, found: Found, notes: Sequence[str] = ()) -> list[Sheet]:
    """Sheets of all topics whose messages hold numbers, spread over columns: `pose.position.x`; stamps as s since 1970.

    Raises LogError: no such topic, or a message that does not decode.
    """
    out, told = readable(path, found)
    told = [*notes, *told]
    if not out:
        text = f" ({'; '.join(told)[:300]})" if told else ""
        raise LogError(f"{path}: no topic with numbers; it has {listed(found)}{text}")
    return [out[0].noted(*told), *out[1:]]


def readable(path: Path, found: Found) -> tuple[list[Sheet], list[str]]:
    """Sheets of all topics whose messages hold numbers, and a note for each other. Raises LogError: a message does not decode."""
    rows: dict[str, _Rows] = {}
    notes = []
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
    foreign = {topic for topic, read in rows.items() if abs(read.ahead) > DAY}
    for topic in sorted(foreign) if foreign < set(rows) else ():
        notes.append(f"{topic}: {FOREIGN}")
        rows[topic].stamps = rows[topic].receipts
    rows = _together(rows, {topic: found[topic].type for topic in rows})
    return [read.sheet(path, topic, found[topic].type if topic in found else "") for topic, read in rows.items()], notes


def listed(found: Found) -> str:
    """Names of the topics for a message, sorted and shortened; `none` without any."""
    return ", ".join(map(repr, sorted(found)))[:300] or "none"


def in_order(stamps: Sequence[int]) -> tuple[np.ndarray, str]:
    """Order (T,) of stamps and a note: sorted if publishers overtake one another, unchanged if the clock was set back once."""
    back = [a - b for a, b in pairwise(stamps) if a > b]
    if len(back) < OVERTAKEN or max(back) >= OVERTAKES:
        return np.arange(len(stamps)), ""
    told = f"stamped before a message that came earlier, sorted by stamp, in {len(back)} of {len(stamps)} messages"
    return np.argsort(np.array(stamps), kind="stable"), told


@dataclass
class _Rows:
    """Messages of one topic as rows: their stamps [ns] by header or receipt, and the numbers of each."""

    receipts: list[int]
    stamps: list[int]
    values: list[dict[str, float]]
    notes: Counter[str]
    apart: dict[str, str] = field(default_factory=dict)
    text: dict[str, str] = field(default_factory=dict)  # column -> a number that is written as text

    @property
    def ahead(self) -> float:
        """Median time from a message's stamp to its receipt [ns]."""
        return float(np.median([receipt - stamp for receipt, stamp in zip(self.receipts, self.stamps, strict=True)]))

    def sheet(self, path: Path, topic: str, kind: str) -> Sheet:
        """The rows as columns; messages of one instant with different fields form one row."""
        stamps: list[int] = []
        rows: list[dict[str, float]] = []
        order, back = in_order(self.stamps)
        for stamp, row in ((self.stamps[i], self.values[i]) for i in order):
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
        if not any(header.parse(key).words in (("t",), ("time",), ("timestamp",), ("stamp",)) for key in columns):
            columns = {"stamp": np.array(stamps, float) * 1e-9, **columns}
            units["stamp"] = DATE
        units = {key: unit for key, unit in units.items() if key in columns}
        told = tuple(f"{topic}: {note}, in {n} of {len(self.values)} messages" for note, n in self.notes.items() if n)
        told = (*told, f"{topic}: {back}") if back else told
        columns |= {key: np.full(len(stamps), math.nan) for key in (*self.apart, *self.text) if key not in columns}
        doubts = _unnamed(columns) | self._planned(columns)
        return checked(Sheet(path, topic, columns, units, text=self.text, notes=told, doubts=doubts, apart=self.apart))

    def _planned(self, columns: Iterable[str]) -> dict[str, str]:
        """Doubts about trajectories of several points."""
        why = "trajectories of several points, of which this is the first: map none of them, or publish one point a message"
        return dict.fromkeys((key for key in columns if key.startswith("command.")), why) if self.notes[PLANS] else {}


def _rows(path: Path, topic: str, channel: TopicChannel) -> _Rows | None:
    """Messages of a topic as rows; None if they hold no number."""
    decode = decoder(path, topic, channel)
    out, keys = _Rows([], [], [], Counter()), set()
    own, labels = [], []
    for i, (log_time, _, _) in enumerate(channel.messages):
        where, content = f"{path}:{topic}[{i}]", decode(i)
        own.append(own_stamp(content))
        out.notes[ODD] += is_odd_stamp(content)
        out.notes[CUT] += channel.type not in SINGLE and _is_cut(content)
        labels.append(table_forms.labels(content))
        if channel.type == TRAJECTORY:
            row = _trajectory(where, content, out)
        else:
            row = _joints(where, content, out) if _is_joint_state(content) else _spread(channel, content, out.text)
        keys |= row.keys()
        if len(keys) + len(out.text) > WIDTH * WIDTH:
            raise LogError(f"{where}: over {WIDTH * WIDTH} different fields; map the ones you need with --topics")
        out.receipts.append(log_time)
        out.values.append(row)
    if any(own) and not all(own):
        out.notes[UNSTAMPED] = sum(not stamp for stamp in own)
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
            lost = sum(map(len, bursts)) - sum(map(len, whole))
            if lost:
                notes[f"{lost} messages left out, without one of each other topic beside them"] = len(whole)
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


def _flat(
    value, prefix: str = "", depth: int = 0, names: list[str] | None = None, *, text: dict[str, str] | None = None
) -> dict[str, float]:
    """Numbers by their path, a list beside a list of equally many names by these names; those written as text into `text`."""
    out: dict[str, float] = {}
    if depth > DEPTH:
        return out
    if isinstance(value, dict):
        names = names_in(value) or names
        for key, item in list(value.items())[: WIDTH * 4]:
            if key not in ("header", "covariance") and (key != "stamp" or not isinstance(item, dict)):
                out |= _flat(item, f"{prefix}.{str(key)[:80]}".lstrip("."), depth + 1, names, text=text)
    elif isinstance(value, list):
        names = names if names and len(names) == len(value) else _names_of(value)
        keys = names or range(len(value))
        for key, item in list(zip(keys, value, strict=True))[:WIDTH]:
            out |= _flat(item, f"{prefix}.{str(key)[:80]}".lstrip("."), depth + 1, text=text)
    else:
        _put(prefix or "value", value, out, {} if text is None else text)
    return out


def _put(key: str, value, numbers: dict[str, float], text: dict[str, str]) -> None:
    """Puts a value into `numbers`, or into `text` if it is a number that is written as text and no name or identity."""
    if isinstance(value, bool | int | float) and abs(value) < 1e300:
        numbers[key] = float(value)
    elif isinstance(value, str) and _NUMBER.fullmatch(value):
        last = next((part for part in reversed(key.split(".")) if not part.isdecimal()), "")
        if last not in (*NAMES, *NAMED) and not table_forms.may_tell_apart(last):
            text.setdefault(key, value)


def _spread(channel: TopicChannel, content: dict, text: dict[str, str]) -> dict[str, float]:
    """Numbers of one message by their path, or as its type has them; those that are written as text are put into `text`."""
    typed = _TYPED.get(channel.type)
    flat = _flat(content, text=text) if typed is None or channel.encoding == "json" else {}
    return flat if typed is None else typed(content)


def _is_cut(value, depth: int = 0) -> bool:
    """Returns True for a message that holds more than is spread over columns."""
    if not isinstance(value, dict | list):
        return False
    if len(value) > (WIDTH * 4 if isinstance(value, dict) else WIDTH) or depth > DEPTH:
        return bool(value)
    return any(_is_cut(item, depth + 1) for item in (value.values() if isinstance(value, dict) else value))


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


def _joints(where: str, content: dict, read: _Rows) -> dict[str, float]:
    """Columns `joint.NAME`, `joint.NAME.velocity`, `joint.NAME.effort` by the message's own names, by position if it has none.

    Raises LogError: a name appears twice, or there are positions for some of the names only.
    """
    names = names_in(content) or []
    if len(set(names)) < len(names):
        raise LogError(f"{where}: joint {quoted(max(names, key=names.count))} is named twice; record it again")
    out: dict[str, float] = {}
    for key in STATE:
        values = content.get(key)
        if not isinstance(values, list) or not values:
            continue
        if names and len(values) != len(names):
            if key == "position":
                raise LogError(f"{where}: {len(values)} positions for {len(names)} names: which joint is which? Record it again")
            read.notes[f"{key} not read, its list is not as long as that of the names"] += 1
            continue
        for name, value in zip(names or map(str, range(1, len(values) + 1)), values, strict=True):
            _put(column_of(name[:80], key), value, out, read.text)
    return out


def _trajectory(where: str, content: dict, read: _Rows) -> dict[str, float]:
    """Columns `command.NAME` by the message's own names: the angles of its first point.

    Raises LogError: there are angles for some of the names only.
    """
    names, points = names_in(content) or [], content.get("points") or [{}]
    values = points[0].get("positions") or []
    if len(values) != len(names) or len(set(names)) < len(names):
        raise LogError(f"{where}: {len(values)} positions for the names {', '.join(map(quoted, names))}; record it again")
    read.notes[PLANS] += len(points) > 1
    out: dict[str, float] = {}
    for name, value in zip(names, values, strict=True):
        _put(f"command.{name[:80]}", value, out, read.text)
    return out


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
    shown = enumerate(values[:WIDTH] if isinstance(values, list) else (), start=1)
    return {f"value.{i}": float(v) for i, v in shown if isinstance(v, int | float)}


_TYPED: dict[str, Callable[[dict], dict[str, float]]] = {
    "sensor_msgs/msg/BatteryState": _battery,
    "sensor_msgs/msg/Imu": _imu,
    "nav_msgs/msg/Odometry": _odometry,
    "std_msgs/msg/Float64MultiArray": _array,
    "std_msgs/msg/Float32MultiArray": _array,
}
_PLACES = ("pose.position.", "pose.pose.position.", "transform.translation.")
_SPACE = {f"{p}{axis}": "m" for p in (*_PLACES, "position.", "point.") for axis in "xyz"}
_PLACED = ("Pose", "PoseStamped", "PoseWithCovarianceStamped", "PointStamped", "TransformStamped")
_UNITS: dict[str, dict[str, str]] = {  # ROS's own: REP 103
    "sensor_msgs/msg/BatteryState": {"voltage": "V", "current_drawn": "A"},
    "sensor_msgs/msg/Imu": {f"{k}.{axis}": unit for axis in "xyz" for k, unit in (("acc", "m/s^2"), ("gyro", "rad/s"))},
    "nav_msgs/msg/Odometry": {**_SPACE, "surge": "m/s", "sway": "m/s", "yaw_rate": "rad/s"},
    "geometry_msgs/msg/Pose2D": {"x": "m", "y": "m", "theta": "rad"},
    **{f"geometry_msgs/msg/{kind}": _SPACE for kind in _PLACED},
}
