"""The data sets that a search reads: a folder of trial folders, or a bundle; and the null that belongs to one."""

from pathlib import Path

from fishmj.gap.null_runs import Null
from fishmj.gap.null_sets import Sets
from fishmj.log import Trial, measurements
from fishmj.log.bundle import read_bundle
from fishmj.log.dataset import read_dataset
from fishmj.store import sha256
from fishmj.store.manifest import MANIFEST

BUNDLE = ".npz"


def trials_in(data: Path) -> list[Trial]:
    """The trials of a data set under their folders' names, or those of a bundle.

    Raises:
        LogError, StoreError: nothing there that can be read.
    """
    if data.suffix == BUNDLE:
        return read_bundle(data)
    found = read_dataset(data)
    return [named(name, trial) for name, trial in zip(found.names, found, strict=True)]


def page_in(data: Path) -> dict:
    """The page of weighings beside the trials of a data set; {} without one."""
    return {} if data.suffix == BUNDLE else measurements.read(data)


def named(name: str, trial: Trial) -> Trial:
    """The trial under its folder's name."""
    return Trial(trial.meta, trial.tables, name=name, notes=trial.notes)


def digest(data: Path) -> str:
    """sha256 of a bundle, or of a folder's manifest."""
    return sha256(data if data.suffix == BUNDLE else data / MANIFEST)


def null_of(drawn: dict) -> Null:
    """As a report or a version says how null runs are drawn: runs, noise, seed; folder, where they were swum elsewhere."""
    return Sets(**drawn | {"folder": Path(drawn["folder"])}) if "folder" in drawn else Null(**drawn)
