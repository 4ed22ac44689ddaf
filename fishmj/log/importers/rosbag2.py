"""rosbag2: a folder with metadata.yaml and `.db3` (SQLite) or `.mcap` files, or one `.db3` alone. Needs the extra `logs`.

The database is opened read only, from tables and never from views, with a limit on what one query may cost; messages are CDR of
ROS 2's standard types. Packed storage (`.db3.zstd`) is refused: unpack it first, with `ros2 bag convert`.
"""

import sqlite3
from pathlib import Path

from fishmj.errors import LogError
from fishmj.log.importers import mcap, messages
from fishmj.log.importers.messages import Found, TopicChannel
from fishmj.log.importers.topics import by_name, read_topics
from fishmj.log.limits import bare, check_size, quoted, regular
from fishmj.log.trial import Trial

SUFFIX = ".db3"
MAGIC = b"SQLite format 3\0"
METADATA = "metadata.yaml"
LONGEST = 64 << 20  # bytes of one message
STEPS = 10_000  # of SQLite's machine between two looks at what a query has cost
LOOKS = 500_000


def sniff(path: Path) -> bool:
    """A bag's folder, or one of its databases."""
    if path.is_dir():
        return (path / METADATA).is_file() and bool(_files(path))
    if not path.is_file() or path.suffix != SUFFIX:
        return False
    with open(path, "rb") as file:
        return file.read(16) == MAGIC


def read(path: Path, topics: str | Path | None = None) -> dict[str, Trial]:
    """One trial, named after the bag, by a topic mapping or by topics named like tables.

    Raises:
        LogError: damaged, packed, no such topic, or values that are not as the mapping says. MissingExtra: rosbags is absent.
    """
    wanted = read_topics(topics) if topics else None
    found = channels(path, {entry.topic for entry in wanted.tables.values()} if wanted else None)
    wanted = wanted or by_name(set(found))
    if not wanted.tables:
        raise LogError(
            f"{path}: no topic is named like a table; it has {messages.listed(found)}. Say which is which with --topics"
        )
    return messages.mapped(path, found, wanted)


def channels(path: Path, needed: set[str] | None = None) -> Found:
    """The messages of every topic that is needed (all when None), files in the order of their names."""
    found: Found = {}
    for file in _files(path) if path.is_dir() else [path]:
        part = mcap.channels(file, needed) if file.suffix == mcap.SUFFIX else _database(file, needed)
        for topic, channel in part.items():
            there = found.setdefault(topic, TopicChannel(channel.encoding, channel.type))
            if (there.encoding, there.type) != (channel.encoding, channel.type):
                raise LogError(f"{file}: topic {quoted(topic)} changes its type within the bag; record it again with one")
            there.messages += channel.messages
    if not found:
        packed = ", ".join(p.name for p in path.glob("*.zstd")) if path.is_dir() else ""
        told = f" that are not packed ({packed}); unpack them with ros2 bag convert" if packed else ""
        raise LogError(f"{path}: no messages{told}")
    return found


def _files(path: Path) -> list[Path]:
    return sorted(p for p in path.iterdir() if p.suffix in (SUFFIX, mcap.SUFFIX) and p.is_file() and not p.name.startswith("."))


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
            told = database.execute("SELECT id, name, type, serialization_format FROM topics LIMIT 10000")
            for number, name, kind, encoding in told:
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
    for channel in found.values():
        channel.messages.sort(key=lambda message: message[0])
    return found
