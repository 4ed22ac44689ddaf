"""Arrays on disk without pickle: `.npz` archives, safetensors files that carry their own checksum, checkpoints of these."""

import hashlib
import io
import json
import math
import os
import struct
import tokenize
import warnings
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fishmj.base.console import plain
from fishmj.base.errors import StoreError
from fishmj.base.plain_file import why_unreadable
from fishmj.base.store.atomic import write_bytes

UNPACKED = 2**28  # bytes that one archive may hold; more where FISHMJ_MAX_UNPACKED says so
MEMBERS = 10_000
_BROKEN = (  # what NumPy and zipfile raise on damaged input
    *(zipfile.BadZipFile, zlib.error, struct.error, tokenize.TokenError, SyntaxError, ValueError, TypeError, KeyError),
    *(EOFError, OSError, NotImplementedError, RuntimeError, OverflowError, MemoryError, IndexError, AttributeError),
)


def write_npz(path: str | Path, arrays: dict[str, np.ndarray]) -> Path:
    """Replaces a compressed `.npz` archive atomically; object arrays are refused (they would need pickle)."""
    arrays = {name: np.asarray(value) for name, value in arrays.items()}
    for name, value in arrays.items():
        _refuse(path, name, value, "O")
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    return write_bytes(path, buffer.getvalue())


def read_npz(path: str | Path, *, widened: bool = False) -> dict[str, np.ndarray]:
    """All arrays of an `.npz`. Checks every member's CRC, refuses pickled objects, and checks the size before unpacking.

    Args:
        widened: the caller turns every number into float64, so each counts as 8 bytes (a byte of zeros takes up eight then).

    Raises StoreError: missing, truncated, bit-flipped, not an archive, with pickled objects, or too large when unpacked.
    """
    path, arrays, wide = Path(path), {}, 0
    if why := why_unreadable(path):
        raise StoreError(f"{path}: {why}")
    try:
        with zipfile.ZipFile(path) as archive:
            _measure(path, archive)
            for member in archive.namelist():
                if member.endswith(".pkl"):
                    raise _pickle_error(path, member)
                data = io.BytesIO(archive.read(member))  # a whole read checks the CRC
                shape, dtype = _npy_header(data)
                if dtype.hasobject:
                    raise _pickle_error(path, member.removesuffix(".npy"))
                held, told = len(data.getbuffer()) - data.tell(), math.prod(shape) * dtype.itemsize
                if told > held:  # NumPy would set aside what the header says before it reads
                    raise ValueError(f"{member}: its header tells of {told} bytes, it holds {held}")
                wide += 8 * math.prod(shape)
                if widened and wide > unpacked_limit():
                    whole = 8 * sum(info.file_size for info in archive.infolist())
                    raise StoreError(
                        f"{path}: {wide} bytes as float64 up to array {member[:60]!r}, at most {unpacked_limit()} bytes. "
                        f"Split it, or, where you trust it, set FISHMJ_MAX_UNPACKED={whole}"
                    )
                data.seek(0)
                arrays[member.removesuffix(".npy")] = np.lib.format.read_array(data, allow_pickle=False)
    except StoreError:
        raise
    except _BROKEN as error:
        with open(path, "rb") as file:
            if _looks_pickled(file.read(2)):
                raise _pickle_error(path, "the whole file") from error
        raise StoreError(
            f"{path}: damaged or not an .npz archive ({type(error).__name__}: {error}); "
            f"{path.stat().st_size} bytes on disk; restore it or write it again"
        ) from error
    return arrays


def write_tensors(path: str | Path, arrays: dict[str, np.ndarray], meta: dict) -> Path:
    """Writes named arrays and a JSON `meta` as one safetensors file that carries its own sha256.

    Shapes survive as they are, 0-d included. Raises StoreError for object or text arrays and for a failed write.
    """
    from safetensors.numpy import save

    packed = {}
    for name, value in arrays.items():
        value = np.array(value, order="C")  # ascontiguousarray would turn 0-d into 1-d
        _refuse(path, name, value, "OUSVMm")
        packed[name] = value.astype(value.dtype.newbyteorder("="), copy=False)
    header = json.dumps(plain(meta), sort_keys=True)
    return write_bytes(path, save(packed, {"fishmj": header, "sha256": _digest(packed, header)}))


def read_tensors(path: str | Path) -> tuple[dict[str, np.ndarray], dict]:
    """Arrays and meta of a file written by `write_tensors`; the embedded sha256 is checked before anything is returned.

    Raises StoreError: missing, truncated, bit-flipped, pickled, or written by something else.
    """
    from safetensors import SafetensorError
    from safetensors.numpy import load

    path = Path(path)
    if why := why_unreadable(path):
        raise StoreError(f"{path}: {why}")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise StoreError(f"{path}: cannot be read: {error.strerror or error}") from error
    try:
        size = int.from_bytes(data[:8], "little")
        header = json.loads(data[8 : 8 + size])["__metadata__"]
        arrays, expected = dict(load(data)), header["sha256"]
        got, meta = _digest(arrays, header["fishmj"]), json.loads(header["fishmj"])
    except (SafetensorError, *_BROKEN) as error:
        if _looks_pickled(data[:2]) or data[:2] == b"PK":  # torch.save writes a zip with a pickle inside
            raise _pickle_error(path, "the whole file") from error
        raise StoreError(
            f"{path}: truncated, damaged or not a fishmj tensor file ({type(error).__name__}: {error}); {len(data)} bytes on disk"
        ) from error
    if got != expected:
        raise StoreError(f"{path}: sha256 mismatch: expected {expected}, got {got}; the file changed after it was written")
    return arrays, meta


def _digest(arrays: dict[str, np.ndarray], header: str) -> str:
    """sha256 over the JSON header, then name, dtype, shape and bytes of every array in name order."""
    total = hashlib.sha256(header.encode())
    for name in sorted(arrays):
        value = arrays[name]
        total.update(f"\0{name}\0{value.dtype.str}\0{value.shape}\0".encode())
        total.update(value.tobytes())
    return total.hexdigest()


def unpacked_limit() -> int:
    """Largest number of bytes that a packed file may unpack to: 256 MiB, or FISHMJ_MAX_UNPACKED in bytes.

    Raises StoreError: the variable holds no number.
    """
    text = os.environ.get("FISHMJ_MAX_UNPACKED", "")
    if not text:
        return UNPACKED
    try:
        return int(float(text))
    except (ValueError, OverflowError) as error:
        raise StoreError(f"FISHMJ_MAX_UNPACKED = {text!r}: expected a number of bytes, for example 4e9") from error


def _measure(path: Path, archive: zipfile.ZipFile) -> None:
    """Refuses an archive by the sizes in its directory, before anything is unpacked (zipfile never reads beyond them)."""
    members, limit = archive.infolist(), unpacked_limit()
    size = sum(member.file_size for member in members)
    if size > limit or len(members) > MEMBERS:
        raise StoreError(
            f"{path}: {path.stat().st_size} bytes that unpack to {size} in {len(members)} arrays; at most {limit} bytes and"
            f" {MEMBERS} arrays. Split it, or, where you trust it, set FISHMJ_MAX_UNPACKED={size}"
        )


def _npy_header(data: io.BytesIO) -> tuple[tuple[int, ...], np.dtype]:
    """Shape and dtype as a `.npy` member's header says; leaves the position at the first value."""
    version = np.lib.format.read_magic(data)
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read_header(data)
    return shape, dtype


def _looks_pickled(start: bytes) -> bool:
    """Returns True for data that begin with opcode PROTO and a protocol number 2..5, as every modern pickle does."""
    return start[:1] == b"\x80" and start[1:2] in (b"\x02", b"\x03", b"\x04", b"\x05")


def _pickle_error(path, what) -> StoreError:
    return StoreError(
        f"{path}: {what} holds pickled objects, which can run code when loaded; refused. Load it once where you trust it and "
        "save plain arrays: fishmj.base.store.write_npz(path, {name: numpy.asarray(value, dtype=float)})"
    )


def _refuse(path, name: str, value: np.ndarray, kinds: str) -> None:
    if value.dtype.hasobject or value.dtype.kind in kinds:
        raise StoreError(
            f"{path}: array {name!r} has dtype {value.dtype}; only numbers and bools are stored, put text into the meta"
        )


@dataclass(frozen=True)
class Checkpoint:
    """Checkpoint that `Checkpoints.latest` found. `note` is empty, or lists the newer files that were damaged and skipped."""

    step: int
    arrays: dict
    meta: dict
    path: Path
    note: str = ""


class Checkpoints:
    """The newest `keep` checkpoints of one run, `step_<n>.safetensors`, one writer a folder.

    A damaged newest one is skipped and named, never half-loaded.
    """

    def __init__(self, folder: str | Path, keep: int = 3):
        self.folder, self.keep = Path(folder), max(1, int(keep))

    def paths(self) -> list[Path]:
        """Complete checkpoints, newest step first."""
        found = [p for p in self.folder.glob("step_*.safetensors") if p.stem[5:].isdigit()]
        return sorted(found, key=lambda p: int(p.stem[5:]), reverse=True)

    def save(self, step: int, arrays: dict[str, np.ndarray], meta: dict) -> Path:
        """Writes step `step`, then drops the oldest beyond `keep`."""
        path = write_tensors(self.folder / f"step_{int(step):012d}.safetensors", arrays, {**meta, "step": int(step)})
        for old in self.paths()[self.keep :]:
            old.unlink(missing_ok=True)
        return path

    def latest(self) -> Checkpoint | None:
        """The newest intact checkpoint, or None when there is none at all. A damaged newer one is named in a warning.

        Raises StoreError: there are checkpoints and every one is damaged.
        """
        damage = []
        for path in self.paths():
            try:
                arrays, meta = read_tensors(path)
            except StoreError as error:
                damage.append(str(error))
                continue
            note = f"fell back to {path.name}: " + "; ".join(damage) if damage else ""
            if note:
                warnings.warn(note, RuntimeWarning, stacklevel=2)
            return Checkpoint(int(path.stem[5:]), arrays, meta, path, note)
        if damage:
            raise StoreError(f"{self.folder}: no checkpoint is intact: " + "; ".join(damage) + "; start again without --resume")
        return None
