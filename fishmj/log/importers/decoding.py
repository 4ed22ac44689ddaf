"""Decodes messages of recordings to dictionaries, lists and numbers: JSON, or CDR of ROS 2's standard types.

Types that a recording defines itself are not read: the decoder would have to generate code from the file.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fishmj.base.errors import LogError
from fishmj.log.limits import DAMAGE, bare, quoted

NAMES = ("name", "names", "joint_names")  # keys of lists of names beside lists of values
SEQUENCE = 4096  # longest array of a CDR message that is decoded; pictures and clouds are not


@dataclass
class TopicChannel:
    """One topic: the encoding of its messages, and (log time [ns], publish time [ns], bytes) of each."""

    encoding: str
    type: str = ""
    messages: list[tuple[int, int, bytes]] = field(default_factory=list)


Found = dict[str, TopicChannel]


def decoder(path: Path, topic: str, channel: TopicChannel) -> Callable[[int], dict]:
    """Function from a message's number to its content as dictionaries, lists and numbers."""
    if channel.encoding == "json":
        return lambda i: read_json(f"{path}:{topic}[{i}]", channel.messages[i][2])
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
        f"expected json, or cdr of ROS 2's standard types; {converted(channel.encoding)}"
    )


def converted(encoding: str) -> str:
    """Advice on converting a recording in another encoding to a readable one."""
    if encoding == "protobuf":
        return (
            "convert the recording to JSON messages: pip install mcap-protobuf-support and run the lines under "
            '"Protobuf" in docs/search/logs.md (make_reader with its DecoderFactory, MessageToDict, write as json)'
        )
    return "convert the recording to JSON messages"


def read_json(where: str, data: bytes) -> dict:
    """Parses one JSON message to a dictionary of named fields. Raises LogError: not valid JSON, or not an object."""
    try:
        content = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise LogError(f"{where}: not valid JSON: {bare(error, 100)}; record it again") from error
    if not isinstance(content, dict):
        raise LogError(f"{where}: the message is no JSON object but {type(content).__name__}; expected named fields")
    return content


def _standard_types():
    from rosbags.typesys import Stores, get_typestore

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


def names_in(value: dict) -> list[str] | None:
    """Joint names in a message beside lists of their values; None without any."""
    for key in NAMES:
        names = value.get(key)
        if isinstance(names, list) and names and all(isinstance(name, str) for name in names):
            return names
    return None


def sec_nanosec(value: dict) -> int | None:
    """Time in ns of an object {sec, nanosec}; None for any other."""
    whole, part = value.get("sec", value.get("secs")), value.get("nanosec", value.get("nsecs", value.get("nsec")))
    if type(whole) is int and type(part) is int and abs(whole) < 1e12 and 0 <= part < 10**9:
        return whole * 10**9 + part
    return None


def own_stamp(content: dict) -> int | None:
    """Stamp of a message's header, or beside its numbers, in ns; None if it is not set."""
    beside = content.get("header")
    for stamp in (beside.get("stamp") if isinstance(beside, dict) else None, content.get("stamp")):
        if isinstance(stamp, dict):
            return sec_nanosec(stamp)
    return None


def is_odd_stamp(content: dict) -> bool:
    """Returns True for a stamp in a message's header that is a number or a text, so that its clock is not known."""
    stamp = content.get("header", {}).get("stamp") if isinstance(content.get("header"), dict) else None
    return isinstance(stamp, int | float | str) and bool(stamp)
