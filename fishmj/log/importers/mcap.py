"""MCAP recordings (ROS 2, Foxglove): JSON messages, or CDR of ROS 2's standard types. Needs the extra `logs`.

`topics.py` maps topics to tables: by `<recording>.toml` beside the file, by the TOML given, or by their names. Stamps are
log time, publish time or a field of the message; t = 0 is the earliest of them. Messages in other encodings (protobuf) are
refused by name: convert them, or write the log as a trial folder. A chunk is unpacked only up to its stated length.
"""

import io
import tomllib
from collections.abc import Collection, Iterator
from pathlib import Path

from fishmj.base.errors import LogError
from fishmj.log.importers import message_recordings
from fishmj.log.importers.decoding import Found, TopicChannel
from fishmj.log.importers.topics import read_topics
from fishmj.log.limits import DAMAGE, bare, check_size, most_bytes, quoted, regular
from fishmj.log.trial import SCHEMA, Trial
from fishmj.log.trial_check import check_meta
from fishmj.log.trial_folder import META_FILE

MAGIC = b"\x89MCAP0\r\n"
SUFFIX = ".mcap"
CHUNK = 512 << 20  # bytes, unpacked; recorders write 1 to 16 MB


def sniff(path: Path) -> bool:
    """Returns True for a file that begins like MCAP."""
    if not path.is_file():
        return False
    with open(path, "rb") as file:
        return path.suffix == SUFFIX or file.read(8) == MAGIC


def read(path: Path, topics: str | Path | None = None, skip: Collection[str] = ()) -> dict[str, Trial]:
    """One trial, named after the file, without the topics in `skip`.

    Raises MissingExtra: the package mcap is not installed; LogError: damaged file, unknown topic or field, wrong values.
    """
    beside = path.with_suffix(".toml")
    wanted = read_topics(topics) if topics else read_topics(beside) if beside.is_file() else None
    own = carried(path) if wanted is None else None  # a file of `log export` says itself what it is
    found = channels(path, {entry.topic for entry in wanted.tables.values()} if wanted else None)
    return message_recordings.mapped(path, found, wanted, own, skip=skip)


def carried(path: Path) -> dict | None:
    """Meta data in a file of `log export`; None in any other, and without the library."""
    try:
        from mcap.exceptions import McapError
        from mcap.reader import SeekingReader
    except ImportError:
        return None

    try:
        with open(path, "rb") as file:
            reader = SeekingReader(file, record_size_limit=path.stat().st_size)  # a damaged length cannot ask for all memory
            for attachment in reader.iter_attachments() if reader.get_summary() is not None else ():
                if attachment.name == META_FILE:
                    meta = tomllib.loads(attachment.data.decode("utf-8"))
                    check_meta(meta, str(path))
                    return meta if meta.get("schema") == SCHEMA else None
    except (McapError, *DAMAGE):  # whoever reads the messages says what is damaged
        return None
    return None


def channels(path: Path, needed: set[str] | None = None) -> Found:
    """The messages of every topic in `needed` (all if None), in the file's order.

    Raises LogError: damaged, cut off, or larger unpacked than the limit. MissingExtra: the package mcap is not installed.
    """
    regular(path)
    found: Found = {}
    size = 0
    for topic, encoding, kind, log_time, publish_time, data in _records(path):
        channel = found.setdefault(topic, TopicChannel(encoding, kind))
        if needed is not None and topic not in needed:
            continue
        if (channel.encoding, channel.type) != (encoding, kind):
            raise LogError(f"{path}: topic {quoted(topic)} is written in two encodings or types; record it again with one")
        size += len(data)
        check_size(path, size, "holds messages of")
        channel.messages.append((log_time, publish_time, data))
    return found


def _records(path: Path) -> Iterator[tuple[str, str, str, int, int, bytes]]:
    """(topic, encoding, type, log time, publish time, data) of every message; damage of any kind is one `LogError`."""
    import zstandard
    from mcap.exceptions import McapError
    from mcap.records import Channel as ChannelRecord
    from mcap.records import Chunk, Message, Schema
    from mcap.stream_reader import StreamReader, breakup_chunk

    known: dict[int, tuple[str, str, str]] = {}
    kinds: dict[int, str] = {}
    unpacked = 0

    def inside(chunk):
        data = _unpacked(path, chunk)
        return breakup_chunk(
            Chunk(
                **{"compression": "", "data": data, "uncompressed_size": len(data), "uncompressed_crc": chunk.uncompressed_crc},
                **{"message_start_time": chunk.message_start_time, "message_end_time": chunk.message_end_time},
            ),
            validate_crc=True,
        )

    try:
        with open(path, "rb") as file:
            # no record is longer than the file, so that a damaged length cannot request all memory
            reader = StreamReader(file, emit_chunks=True, validate_crcs=True, record_size_limit=path.stat().st_size)
            for outer in reader.records:
                if isinstance(outer, Chunk):
                    unpacked += outer.uncompressed_size
                    check_size(path, unpacked, "unpacks to over")
                for record in inside(outer) if isinstance(outer, Chunk) else (outer,):
                    if isinstance(record, Schema):
                        kinds[record.id] = record.name
                    elif isinstance(record, ChannelRecord):
                        known[record.id] = (record.topic, record.message_encoding, kinds.get(record.schema_id, ""))
                    elif isinstance(record, Message):
                        yield *known[record.channel_id], record.log_time, record.publish_time, record.data
    except LogError:
        raise
    except (McapError, zstandard.ZstdError, *DAMAGE) as error:
        raise LogError(
            f"{path}: damaged, cut off, or no MCAP file ({type(error).__name__}: {bare(error, 200)}); "
            "try `mcap recover`, or record it again"
        ) from error


def _unpacked(path: Path, chunk) -> bytes:
    """Unpacks a chunk's records, up to the length that its header states."""
    size = chunk.uncompressed_size
    if size > min(CHUNK, most_bytes()):
        raise LogError(f"{path}: a chunk that says it unpacks to {size / 1e9:.3g} GB; recorders write megabytes. Is it damaged?")
    if not chunk.compression:
        data = chunk.data
    elif chunk.compression == "zstd":
        import zstandard

        with zstandard.ZstdDecompressor(max_window_size=1 << 27).stream_reader(io.BytesIO(chunk.data)) as stream:
            data = stream.read(size + 1)
    elif chunk.compression == "lz4":
        import lz4.frame

        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    else:
        raise LogError(f"{path}: chunks packed with {quoted(chunk.compression)}; expected zstd or lz4. Run `mcap compress` on it")
    if len(data) != size:
        raise LogError(
            f"{path}: a chunk that says {size} bytes unpacks to {'more' if len(data) > size else len(data)}; it is damaged"
        )
    return data
