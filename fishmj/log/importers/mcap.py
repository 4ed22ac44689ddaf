"""MCAP recordings (ROS 2, Foxglove) with JSON messages. Needs the extra `logs`.

Topics become tables as `topics.py` says: by `<recording>.toml` beside the file, by the TOML given, or by their names. Stamps are
log time, publish time or a field of the message; t = 0 is the earliest of them. Messages in other encodings are refused by name:
convert them, for example with `ros2 bag convert`, or write the log as a trial folder.
"""

import json
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from fishmj.errors import LogError, MissingExtra
from fishmj.log.export import as_written, carried
from fishmj.log.importers.assemble import trial_of
from fishmj.log.importers.topics import UNITS, Field, Topic, Topics, by_name, read_topics
from fishmj.log.trial import Table, Trial

MAGIC = b"\x89MCAP0\r\n"
DAY = 86_400 * 10**9  # ns; stamps further apart than this are on different clocks
Stamped = tuple[int, int, dict]  # log time [ns], publish time [ns], content


def sniff(path: Path) -> bool:
    """A file that begins as MCAP does."""
    if not path.is_file():
        return False
    with open(path, "rb") as file:
        return path.suffix == ".mcap" or file.read(8) == MAGIC


def read(path: Path, topics: str | Path | None = None) -> dict[str, Trial]:
    """One trial, named after the file.

    Raises:
        MissingExtra: the package mcap is not installed. LogError: damaged file, unknown topic or field, wrong values.
    """
    beside = path.with_suffix(".toml")
    wanted = read_topics(topics) if topics else read_topics(beside) if beside.is_file() else None
    own = carried(path) if wanted is None else None  # a file of `log export` says itself what it is
    found = _messages(path, wanted)
    if wanted is None:
        wanted = by_name(set(found))
        if not wanted.tables:
            raise LogError(
                f"{path}: no topic is named like a table; it has {_listed(found)}. Say which is which in {beside.name}"
            )
    stamps, columns = {}, {}
    for name, entry in wanted.tables.items():
        if entry.topic not in found:
            raise LogError(f"{path}: no topic {entry.topic!r} for table {name!r}; it has {_listed(found)}")
        stamps[name], columns[name] = _columns(path, entry, found[entry.topic])
    times, notes = _seconds(stamps) if own is None else (as_written(stamps), [])
    tables = {}
    for name, entry in wanted.tables.items():
        order = np.argsort(times[name], kind="stable")
        table = {"t": times[name][order], **{column: values[order] for column, values in columns[name].items()}}
        tables[name] = (table, _place(path, entry.topic, order))
    clocks = {name: str(entry.clock) for name, entry in wanted.tables.items()}
    meta = {"clock": clocks, "source": path.name, **wanted.meta} if own is None else own
    return {path.stem: trial_of(path.stem, meta, tables, notes)}


def _place(path: Path, topic: str, order: np.ndarray):
    return lambda row, column: f"{path}:{topic}[{order[row] if 0 <= row < len(order) else 0}]:{column or 't'}"


def _messages(path: Path, wanted: Topics | None) -> dict[str, list[Stamped]]:
    """The JSON messages of every topic that is wanted (all, without a mapping), in the file's order."""
    needed = {entry.topic for entry in wanted.tables.values()} if wanted else None
    out: dict[str, list[Stamped]] = {}
    for topic, encoding, log_time, publish_time, data in _records(path):
        if needed is not None and topic not in needed:
            out.setdefault(topic, [])
            continue
        where = f"{path}:{topic}[{len(out.setdefault(topic, []))}]"
        if encoding != "json":
            if needed is None:
                continue
            raise LogError(
                f"{where}: messages are encoded as {encoding[:40]!r}; expected json. Convert the recording to JSON messages"
            )
        try:
            content = json.loads(data)
        except (ValueError, RecursionError) as error:
            raise LogError(f"{where}: not valid JSON: {error}; record it again") from error
        if not isinstance(content, dict):
            raise LogError(f"{where}: the message is no JSON object but {type(content).__name__}; expected named fields")
        out[topic].append((log_time, publish_time, content))
    return out


def _records(path: Path) -> Iterator[tuple[str, str, int, int, bytes]]:
    """(topic, encoding, log time, publish time, data) of every message; damage of any kind is one `LogError`."""
    try:
        import zstandard
        from mcap.exceptions import McapError
        from mcap.records import Channel, Message
        from mcap.stream_reader import StreamReader
    except ImportError as error:
        raise MissingExtra("mcap", "logs", "Reading MCAP recordings") from error
    damage = (
        *(McapError, zstandard.ZstdError, struct.error, ValueError, RuntimeError, EOFError, KeyError, TypeError),
        *(MemoryError, OverflowError, IndexError, AttributeError, OSError),
    )
    channels = {}
    try:
        with open(path, "rb") as file:
            # no record is longer than the file, so that a damaged length cannot ask for all memory
            reader = StreamReader(file, validate_crcs=True, record_size_limit=path.stat().st_size)
            records = reader.records
            for record in records:
                if isinstance(record, Channel):
                    channels[record.id] = record
                elif isinstance(record, Message):
                    channel = channels[record.channel_id]
                    yield channel.topic, channel.message_encoding, record.log_time, record.publish_time, record.data
    except LogError:
        raise
    except damage as error:
        raise LogError(
            f"{path}: damaged, cut off, or no MCAP file ({type(error).__name__}: {str(error)[:200]}); "
            "try `mcap recover`, or record it again"
        ) from error


def _columns(path: Path, entry: Topic, messages: list[Stamped]) -> tuple[list[int], Table]:
    """Stamps [ns] and columns of one topic."""
    if not messages:
        raise LogError(f"{path}: topic {entry.topic!r} has no message; leave its table out")
    fields = entry.columns or {key: Field((key,)) for key in messages[0][2] if key != "t"}
    clock = entry.clock
    if entry.columns is None and clock == "log_time" and "t" in messages[0][2]:
        clock = Field(("t",), "s")
    stamps, rows = [], []
    for i, (log_time, publish_time, content) in enumerate(messages):
        where = f"{path}:{entry.topic}[{i}]"
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
        elif isinstance(value, list) and part.isdecimal() and int(part) < len(value):
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
        whole, part = value.get("sec", value.get("secs")), value.get("nanosec", value.get("nsecs", value.get("nsec")))
        if type(whole) is int and type(part) is int and abs(whole) < 1e12 and 0 <= part < 10**9:
            return whole * 10**9 + part
        raise LogError(f"{where} = {str(value)[:60]}; expected {{sec, nanosec}} or a number")
    number = _number(where, value)
    scaled = value * 10**9 * UNITS[clock.unit] if clock.unit != "ns" else value
    if not abs(number) < 1e30:
        raise LogError(f"{where} = {str(value)[:30]!r}; expected a time in {clock.unit or 's'}")
    return round(scaled)


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


def _listed(found: dict) -> str:
    return ", ".join(map(repr, sorted(found)))[:300] or "none"
