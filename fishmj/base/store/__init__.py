"""Files that survive a crash: atomic writes, checksums, arrays without pickle, rotating checkpoints. NumPy only."""

from fishmj.base.console import plain
from fishmj.base.store.arrays import Checkpoint, Checkpoints, read_npz, read_tensors, write_npz, write_tensors
from fishmj.base.store.atomic import clear, put_in_place, read_json, sync_folder, write_bytes, write_json, write_text
from fishmj.base.store.manifest import Change, Manifest, json_sha256, left_out, sha256, shipped
from fishmj.base.store.temporary import temporary_beside

__all__ = [
    "Change",
    "Checkpoint",
    "Checkpoints",
    "Manifest",
    "clear",
    "json_sha256",
    "left_out",
    "plain",
    "read_json",
    "read_npz",
    "read_tensors",
    "sha256",
    "put_in_place",
    "shipped",
    "sync_folder",
    "temporary_beside",
    "write_bytes",
    "write_json",
    "write_npz",
    "write_tensors",
    "write_text",
]
