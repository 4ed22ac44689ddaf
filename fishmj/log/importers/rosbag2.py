"""rosbag2: a folder with metadata.yaml and `.db3` (SQLite) or `.mcap` files, or one file alone, packed with zstd or not.

Needs the extra `logs`. The database is opened read only, from tables and never from views, with a limit on what one query may
cost; messages are CDR of ROS 2's standard types. A database whose recorder left a write-ahead log is copied, and the copy is
completed from the log: nothing in the bag's own folder changes.
"""

import io
import re
import shutil
import sqlite3
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from functools import partial
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO

from fishmj.base.errors import LogError
from fishmj.log.importers import mcap, message_recordings
from fishmj.log.importers.decoding import Found, TopicChannel
from fishmj.log.importers.message_sheets import OVERTAKES
from fishmj.log.importers.topics import read_topics
from fishmj.log.limits import DAMAGE, bare, check_size, quoted, regular
from fishmj.log.trial import Trial

SUFFIX, PACKED = ".db3", ".zstd"
STORED = (SUFFIX, mcap.SUFFIX, SUFFIX + PACKED, mcap.SUFFIX + PACKED)  # how the names of a bag's files end
ZSTD = b"\x28\xb5\x2f\xfd"
METADATA = "metadata.yaml"
PART = re.compile(r"(.+)_(\d+)\.(?:db3|mcap)(?:\.zstd)?")  # of a bag that was split: its name and number
PAUSE = 60 * 10**9  # ns between two numbered files, beyond which they are no parts of one recording
LONGEST = 64 << 20  # bytes of one message
STEPS = 10_000  # of SQLite's machine between two looks at what a query has cost
LOOKS = 500_000


def sniff(path: Path) -> bool:
    """Returns True for a bag's folder, with or without metadata.yaml, or for one of its files that is no plain MCAP file."""
    if not path.is_dir():
        return path.is_file() and path.name.endswith(STORED) and path.suffix != mcap.SUFFIX
    files = _files(path)
    return bool(files) and ((path / METADATA).is_file() or _is_split(files))


def read(path: Path, topics: str | Path | None = None, skip: Collection[str] = ()) -> dict[str, Trial]:
    """Reads one trial, named after the bag, by a topic mapping or by topics named like tables, without those in `skip`.

    Raises LogError: damaged, no such topic, or values that do not match the mapping. MissingExtra: rosbags is absent.
    """
    wanted = read_topics(topics) if topics else None
    needed = {entry.topic for entry in wanted.tables.values()} if wanted else None
    found = channels(path, needed)
    return message_recordings.mapped(path, found, wanted, notes=lost(path, found, needed), skip=skip)


def channels(path: Path, needed: set[str] | None = None) -> Found:
    """The messages of every topic in `needed` (all if None), in the order of their receipt.

    Raises LogError: a part is absent, damaged or of another recording; or a topic changes its type.
    """
    found: Found = {}
    end = None
    for file in _parts(path) if path.is_dir() else [path]:
        part = _channels(file, needed)
        stamps = [message[0] for channel in part.values() for message in channel.messages]
        if stamps and end is not None and min(stamps) - end > PAUSE and not (path / METADATA).is_file():
            raise LogError(
                f"{file}: begins {(min(stamps) - end) / 1e9:.0f} s after the file before it ends; is it a part of the same "
                "recording? Put each recording into a folder of its own, or say --trial-each"
            )
        end = max([*stamps, *([] if end is None else [end])], default=None)
        for topic, channel in part.items():
            there = found.setdefault(topic, TopicChannel(channel.encoding, channel.type))
            if (there.encoding, there.type) != (channel.encoding, channel.type):
                raise LogError(f"{file}: topic {quoted(topic)} changes its type within the bag; record it again with one")
            there.messages += channel.messages
    if not found:
        raise LogError(f"{path}: no messages")
    for topic, channel in found.items():
        back = [(a[0] - b[0], i) for i, (a, b) in enumerate(pairwise(channel.messages), 1) if a[0] - b[0] >= OVERTAKES]
        if back:
            raise LogError(
                f"{path}:{topic}[{back[0][1]}]: received {back[0][0] / 1e9:.6g} s before the message in front of it; expected "
                "receipts that rise: the clock was set back. Split the bag there"
            )
        channel.messages.sort(key=lambda message: message[0])
    return found


def lost(path: Path, found: Found, needed: set[str] | None = None) -> list[str]:
    """A note for each topic in `needed` (all if None) of fewer messages than metadata.yaml has, and for one part of several."""
    out = []
    if path.is_file() and (path.parent / METADATA).is_file() and len(files := _files(path.parent)) > 1:
        out.append(f"{path.name}: one of {len(files)} files of a bag; import the folder {path.parent.name} for all of it")
    for entry in _metadata(path).get("topics_with_message_count") or ():
        topic, count = entry["topic_metadata"]["name"], entry["message_count"]
        have = len(found[topic].messages) if topic in found else 0
        if (needed is None or topic in needed) and isinstance(count, int) and count > have:
            out.append(f"{topic}: metadata.yaml counts {count} messages, the bag holds {have}: is it cut off?")
    return out


def _metadata(path: Path) -> dict:
    """Contents of a bag's metadata.yaml; empty without one.

    Raises LogError: it is no YAML of a bag. MissingExtra: the package rosbags is not installed.
    """
    file = path / METADATA
    if not file.is_file():
        return {}
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    regular(file)
    check_size(file, 1000 * file.stat().st_size)
    try:
        info = YAML(typ="safe", pure=True).load(file.read_bytes())["rosbag2_bagfile_information"]
        [str(name) for name in info.get("relative_file_paths") or ()]
        [(entry["topic_metadata"]["name"], entry["message_count"]) for entry in info.get("topics_with_message_count") or ()]
    except (YAMLError, RecursionError, *DAMAGE) as error:
        raise LogError(f"{file}: damaged, or not of a bag ({bare(error, 100)}); write it again with ros2 bag reindex") from error
    return info


def _files(path: Path) -> list[Path]:
    """Files of a bag's folder in the order of their numbers; a packed one only where it is not unpacked beside it."""
    files = [p for p in path.iterdir() if p.name.endswith(STORED) and p.is_file() and not p.name.startswith(".")]
    files = [p for p in files if p.suffix != PACKED or p.with_suffix("") not in files]
    return sorted(files, key=lambda p: (m[1], int(m[2]), "") if (m := PART.fullmatch(p.name)) else ("", 0, p.name))


def _is_split(files: list[Path]) -> bool:
    """Returns True for two or more files of one name that are numbered from 0 on."""
    found = [m for file in files if (m := PART.fullmatch(file.name))]
    return len(found) == len(files) > 1 and [(m[1], int(m[2])) for m in found] == [(found[0][1], k) for k in range(len(files))]


def _parts(path: Path) -> list[Path]:
    """The files of a bag. Raises LogError: they differ from the list in its metadata.yaml."""
    files = _files(path)
    listed = {str(name).replace("\\", "/").rpartition("/")[2].removesuffix(PACKED) for name in _listed(path)}
    names = {file.name.removesuffix(PACKED) for file in files}
    if listed and (absent := sorted(listed - names)):
        raise LogError(f"{path}: no file {quoted(absent[0])}, which metadata.yaml lists; copy it there, or run ros2 bag reindex")
    if listed and (other := sorted(names - listed)):
        raise LogError(f"{path}: file {quoted(other[0])} is not in metadata.yaml; move it away, or run ros2 bag reindex")
    return files


def _listed(path: Path) -> list:
    return _metadata(path).get("relative_file_paths") or []


def _channels(path: Path, needed: set[str] | None) -> Found:
    """The messages of one file."""
    with _whole(path) as file:
        try:
            found = mcap.channels(file, needed) if file.suffix == mcap.SUFFIX else _database(file, needed)
        except LogError as error:
            raise LogError(str(error).replace(str(file), str(path))) from error
    size = 0
    for topic, channel in found.items():
        for i, (log_time, publish_time, data) in enumerate(channel.messages):
            if channel.encoding == "cdr" and data[:4] == ZSTD:  # packed one by one
                blocks = []
                for block in _unpacked(f"{path}:{topic}[{i}]", io.BytesIO(data)):
                    check_size(path, size := size + len(block), "unpacks to over")
                    blocks.append(block)
                channel.messages[i] = (log_time, publish_time, b"".join(blocks))
    return found


@contextmanager
def _whole(path: Path) -> Iterator[Path]:
    """The file itself; or a copy that is unpacked, or completed from the recorder's write-ahead log.

    Raises LogError: a file beside it, which holds a part of the database, is not finished or absent.
    """
    log, shared, journal = (path.with_name(path.name + end) for end in ("-wal", "-shm", "-journal"))
    packed, logged = path.suffix == PACKED, path.suffix == SUFFIX and log.is_file() and log.stat().st_size > 0
    if path.suffix == SUFFIX and _first(journal).strip(b"\0"):
        raise LogError(
            f"{journal}: a write that its recorder did not finish; copy the bag, run sqlite3 {bare(path.name)} .schema there, "
            "which takes it back, and import the copy"
        )
    if path.suffix == SUFFIX and shared.is_file() and not log.is_file():
        raise LogError(
            f"{path}: its write-ahead log {bare(log.name)} is absent, which holds the last messages; copy it there, or remove "
            f"{bare(shared.name)} if there is none"
        )
    if not packed and not logged:
        yield path
        return
    with TemporaryDirectory() as folder:
        copy = Path(folder) / path.name.removesuffix(PACKED)
        if packed:
            _unpack(path, copy)
        else:
            regular(path, empty=True)
            regular(log)
            shutil.copyfile(path, copy)
            shutil.copyfile(log, copy.with_name(log.name))
            _complete(path, copy)
        yield copy


def _first(path: Path) -> bytes:
    """The first byte of a file; empty if the file is empty or absent."""
    if not path.is_file():
        return b""
    with open(path, "rb") as file:
        return file.read(1)


def _complete(path: Path, copy: Path) -> None:
    """Moves the messages of the write-ahead log into the copy of the database."""
    try:
        database = sqlite3.connect(copy)
        try:
            database.execute("PRAGMA trusted_schema = OFF")
            database.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
        finally:
            database.close()
    except (sqlite3.Error, sqlite3.Warning) as error:
        raise LogError(
            f"{path}: damaged, or not of the write-ahead log beside it ({bare(error, 120)}); record it again"
        ) from error


def _unpack(path: Path, copy: Path) -> None:
    """Unpacks a file, up to the limit on size."""
    regular(path)
    with open(path, "rb") as packed, open(copy, "wb") as plain:
        for block in _unpacked(str(path), packed):
            check_size(path, plain.tell() + len(block), "unpacks to over")
            plain.write(block)


def _unpacked(where: str, packed: BinaryIO) -> Iterator[bytes]:
    """Blocks of data packed with zstd."""
    import zstandard

    try:
        yield from iter(partial(zstandard.ZstdDecompressor(max_window_size=1 << 27).stream_reader(packed).read, 1 << 20), b"")
    except zstandard.ZstdError as error:
        raise LogError(f"{where}: damaged, or not packed with zstd ({bare(error, 100)}); copy it again") from error


def _database(path: Path, needed: set[str] | None) -> Found:
    size, found, looks = regular(path), {}, 0
    names: dict[int, str] = {}

    def look() -> int:
        nonlocal looks
        looks += 1
        return looks > LOOKS  # ends the query

    try:
        database = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
        try:
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, min(LONGEST, size + 4096))
            database.execute("PRAGMA trusted_schema = OFF")
            database.execute("PRAGMA mmap_size = 0")
            database.set_progress_handler(look, STEPS)
            tables = {row[0] for row in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
            if not {"topics", "messages"} <= tables:
                has = ", ".join(map(quoted, sorted(map(str, tables))[:6])) or "none"
                raise LogError(f"{path}: no rosbag2: tables {has}; expected topics and messages")
            rows = database.execute("SELECT id, name, type, serialization_format FROM topics LIMIT 10000")
            for number, name, kind, encoding in rows:
                if not isinstance(number, int) or not all(isinstance(v, str) for v in (name, kind, encoding)):
                    raise LogError(f"{path}: table topics holds {quoted((number, name, kind, encoding), 80)}; it is damaged")
                names[number] = name
                found[name] = TopicChannel(encoding, kind)
            total = 0
            for number, stamp, data in database.execute("SELECT topic_id, timestamp, data FROM messages"):
                if number not in names or not isinstance(stamp, int) or not isinstance(data, bytes):
                    raise LogError(f"{path}: a message of topic {quoted(number)} at {quoted(stamp)} is damaged; record it again")
                if needed is None or names[number] in needed:
                    total += len(data)
                    check_size(path, total, "holds messages of")
                    found[names[number]].messages.append((stamp, stamp, data))
        finally:
            database.close()
    except (sqlite3.Error, sqlite3.Warning, OverflowError, ValueError, MemoryError, OSError) as error:
        if isinstance(error, LogError):
            raise
        raise LogError(f"{path}: damaged or no rosbag2 database ({bare(error, 120)}); record it again") from error
    return found
