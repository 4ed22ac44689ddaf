"""Tensors of a file of `torch.save`, read without torch and without running its pickle.

Such a file is a zip of data.pkl and one raw file a storage. The opcodes of data.pkl are read one by one (`pickletools.genops`,
which executes nothing); only those of a dictionary of tensors are known, and any other is refused.
"""

import pickletools
import zipfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fishmj.base.errors import LogError
from fishmj.log.limits import DAMAGE, bare, check_size, quoted, regular

STORAGES = {
    **{"FloatStorage": "<f4", "DoubleStorage": "<f8", "HalfStorage": "<f2", "LongStorage": "<i8", "IntStorage": "<i4"},
    **{"ShortStorage": "<i2", "CharStorage": "<i1", "ByteStorage": "<u1", "BoolStorage": "?"},
}
REBUILD, ORDERED = "torch._utils _rebuild_tensor_v2", "collections OrderedDict"
MARK = object()
LONGEST = 1 << 20  # bytes of data.pkl
CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False, "EMPTY_TUPLE": ()}
NUMBERS = ("BININT", "BININT1", "BININT2", "LONG1", "BINUNICODE", "SHORT_BINUNICODE")
TUPLES = {"TUPLE1": 1, "TUPLE2": 2, "TUPLE3": 3}


class GlobalName(NamedTuple):
    """A name that a pickle asks for; it is never imported."""

    name: str


class RawStorage(NamedTuple):
    """One raw file: its type and key."""

    kind: str
    key: str


class RawTensor(NamedTuple):
    """Place of a tensor in its storage, in elements."""

    storage: RawStorage
    offset: int
    size: tuple[int, ...]
    stride: tuple[int, ...]


def read_tensors(path: Path) -> dict[str, np.ndarray]:
    """Tensors by name. Raises LogError: no such file, damaged, or more than a dictionary of tensors."""
    regular(path)
    try:
        with zipfile.ZipFile(path) as archive:
            inside = {info.filename.partition("/")[2]: info for info in archive.infolist()}
            check_size(path, sum(info.file_size for info in inside.values()), "unpacks to")
            if "data.pkl" not in inside or inside["data.pkl"].file_size > LONGEST:
                raise LogError(f"{path}: no data.pkl of torch.save in it; write its columns as CSV where it was made")
            if "byteorder" in inside and archive.read(inside["byteorder"]).strip() != b"little":
                raise LogError(f"{path}: its numbers are not little-endian; write its columns as CSV where it was made")
            found = _dictionary(path, archive.read(inside["data.pkl"]))
            return {name: _array(path, archive, inside, raw) for name, raw in found.items()}
    except LogError:
        raise
    except (zipfile.BadZipFile, NotImplementedError, *DAMAGE) as error:
        why = f"damaged, or not of torch.save in its zip format ({type(error).__name__}: {bare(error, 100)})"
        raise LogError(f"{path}: {why}; write its columns as CSV where it was made") from error


def _dictionary(path: Path, text: bytes) -> dict[str, RawTensor]:
    """The top of data.pkl."""
    stack: list[Any] = []
    memo: dict[int, Any] = {}
    for opcode, value, _ in pickletools.genops(text):
        name = opcode.name
        if name in ("PROTO", "FRAME", "STOP"):
            continue
        if name in NUMBERS:
            stack.append(value)
        elif name in CONSTANTS:
            stack.append(CONSTANTS[name])
        elif name == "MARK":
            stack.append(MARK)
        elif name in ("EMPTY_DICT", "EMPTY_LIST"):
            stack.append({} if name == "EMPTY_DICT" else [])
        elif name in ("BINPUT", "LONG_BINPUT", "MEMOIZE"):
            memo[len(memo) if value is None else int(value)] = stack[-1]
        elif name in ("BINGET", "LONG_BINGET"):
            stack.append(memo[int(value or 0)])
        elif name in TUPLES:
            stack[-TUPLES[name] :] = [tuple(stack[-TUPLES[name] :])]
        elif name == "TUPLE":
            stack.append(tuple(_since_mark(stack)))
        elif name == "GLOBAL":
            stack.append(GlobalName(str(value)))
        elif name == "STACK_GLOBAL":
            stack[-2:] = [GlobalName(f"{stack[-2]} {stack[-1]}")]
        elif name == "BINPERSID":
            stack.append(_storage(path, stack.pop()))
        elif name == "REDUCE":
            stack[-2:] = [_made(path, stack[-2], stack[-1])]
        elif name == "SETITEMS":
            pairs = _since_mark(stack)
            stack[-1].update(zip(pairs[::2], pairs[1::2], strict=True))
        elif name == "SETITEM":
            key, item = stack[-2:]
            del stack[-2:]
            stack[-1][key] = item
        else:
            raise LogError(f"{path}: its pickle holds {quoted(name)}; only a dictionary of tensors is read. Save it as .npz")
    found = stack[-1] if stack else None
    if not isinstance(found, dict) or not found or not all(isinstance(v, RawTensor) for v in found.values()):
        raise LogError(f"{path}: no dictionary of tensors; save it as .npz, one array a column")
    return {str(name): tensor for name, tensor in found.items()}


def _since_mark(stack: list[Any]) -> list[Any]:
    """Entries above the last mark, which are taken off with it."""
    place = max(i for i, entry in enumerate(stack) if entry is MARK)
    out = stack[place + 1 :]
    del stack[place:]
    return out


def _storage(path: Path, told: Any) -> RawStorage:
    if isinstance(told, tuple) and len(told) == 5 and told[0] == "storage" and isinstance(told[1], GlobalName):
        module, _, kind = told[1].name.partition(" ")
        if module == "torch" and kind in STORAGES:
            return RawStorage(kind, str(told[2]))
    raise LogError(f"{path}: a storage of {quoted(told, 80)}; only numbers are read. Save it as .npz")


def _made(path: Path, called: Any, given: Any) -> Any:
    """The result of a call that a pickle asks for: a tensor, or an empty dictionary of its hooks."""
    if called == GlobalName(ORDERED) and given == ():
        return {}
    if called == GlobalName(REBUILD) and isinstance(given[0], RawStorage):
        return RawTensor(given[0], int(given[1]), tuple(map(int, given[2])), tuple(map(int, given[3])))
    name = called.name if isinstance(called, GlobalName) else str(called)
    raise LogError(f"{path}: its pickle calls {quoted(name, 80)}, which is not done; only tensors are read. Save it as .npz")


def _array(path: Path, archive: zipfile.ZipFile, inside: dict[str, zipfile.ZipInfo], raw: RawTensor) -> np.ndarray:
    """The numbers of a tensor."""
    info = inside.get(f"data/{raw.storage.key}")
    if info is None:
        raise LogError(f"{path}: storage {quoted(raw.storage.key)} is absent; copy the file again")
    flat = np.frombuffer(archive.read(info), STORAGES[raw.storage.kind])
    last = raw.offset + sum((n - 1) * s for n, s in zip(raw.size, raw.stride, strict=True))
    if min(*raw.stride, *raw.size, raw.offset, 0) < 0 or (0 not in raw.size and last >= len(flat)):
        raise LogError(f"{path}: a tensor of {raw.size} in a storage of {len(flat)} numbers; copy the file again")
    strides = [s * flat.itemsize for s in raw.stride]
    return np.lib.stride_tricks.as_strided(flat[raw.offset :], raw.size, strides, writeable=False).copy()
