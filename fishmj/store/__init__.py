"""Files that survive a crash: atomic writes, checksums, arrays without pickle, rotating checkpoints. NumPy only."""

from fishmj.store.arrays import read_npz, read_tensors, write_npz, write_tensors
from fishmj.store.atomic import plain, put_in_place, read_json, sync_folder, write_bytes, write_json, write_text
from fishmj.store.checkpoints import Checkpoint, Checkpoints
from fishmj.store.manifest import Change, Manifest, sha256
from fishmj.store.package_data import left_out, shipped

__all__ = [
    "Change",
    "Checkpoint",
    "Checkpoints",
    "Manifest",
    "left_out",
    "plain",
    "read_json",
    "read_npz",
    "read_tensors",
    "sha256",
    "put_in_place",
    "shipped",
    "sync_folder",
    "write_bytes",
    "write_json",
    "write_npz",
    "write_tensors",
    "write_text",
]
