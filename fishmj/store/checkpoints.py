"""Rotating checkpoints of one run; a damaged newest one is skipped and named, never half-loaded."""

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fishmj.errors import StoreError
from fishmj.store.arrays import read_tensors, write_tensors


@dataclass(frozen=True)
class Checkpoint:
    """What `Checkpoints.latest` found. `note` is empty, or says which newer files were damaged and skipped."""

    step: int
    arrays: dict
    meta: dict
    path: Path
    note: str = ""


class Checkpoints:
    """The newest `keep` checkpoints of one run, `step_<n>.safetensors`, one writer a folder."""

    def __init__(self, folder: str | Path, keep: int = 3):
        self.folder, self.keep = Path(folder), max(1, int(keep))

    def paths(self) -> list[Path]:
        """Complete checkpoints, newest step first."""
        found = [p for p in self.folder.glob("step_*.safetensors") if p.stem[5:].isdigit()]
        return sorted(found, key=lambda p: int(p.stem[5:]), reverse=True)

    def save(self, step: int, arrays: dict[str, np.ndarray], meta: dict) -> Path:
        """Write step `step`, then drop the oldest beyond `keep` and what a killed writer left behind."""
        path = write_tensors(self.folder / f"step_{int(step):012d}.safetensors", arrays, {**meta, "step": int(step)})
        for old in [*self.paths()[self.keep :], *self.folder.glob(".step_*.tmp")]:
            old.unlink(missing_ok=True)
        return path

    def latest(self) -> Checkpoint | None:
        """The newest intact checkpoint, or None when there is none at all. A damaged newer one is named in a warning.

        Raises:
            StoreError: there are checkpoints and every one is damaged.
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
