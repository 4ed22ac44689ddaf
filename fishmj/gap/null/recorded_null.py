"""Null runs that were swum elsewhere: data sets of the flow solver in which nothing is hidden, one bundle a fish.

    RecordedNull(folder="data/gap/lbm/nulls").residuals(model, records, layout)

As `SimulatedNull`, except that nothing can be made on the spot: an experiment that the sets do not hold has no null.
"""

import hashlib
import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from fishmj.errors import ConfigError, LogError
from fishmj.excitation import Excitation
from fishmj.gap.null import source_digest
from fishmj.gap.null.simulated_null import SimulatedNull, Tick, model_digest
from fishmj.gap.records.records import WINDOW, Record, record_of
from fishmj.log import Trial
from fishmj.log.compact import read_bundle
from fishmj.mjcf.description import Robot
from fishmj.store import sha256

FEWEST = 12  # fish
ALIKE = 1e-3  # rad between two commands, m and rad between two starts
FEWEST_RUNS, MOST_RUNS, LOUDEST, LAST_SEED = 2, 4096, 100.0, 2**31 - 1
DRAWN: dict[str, tuple[type, ...]] = {
    "runs": (int,),
    "noise": (int, float),
    "seed": (int,),
    "folder": (str,),
}  # what a report says of its null runs


@dataclass(frozen=True)
class RecordedNull(SimulatedNull):
    """folder: one bundle (.npz) a fish. without: names of bundles left out. The draws of `SimulatedNull` are not used."""

    folder: Path = Path()
    without: tuple[str, ...] = ()

    def __post_init__(self):
        object.__setattr__(self, "runs", len(self.bundles))  # of a frozen dataclass

    @property
    def bundles(self) -> list[Path]:
        """Of every fish that takes part.

        Raises:
            LogError: too few.
        """
        found = [path for path in sorted(self.folder.glob("*.npz")) if path.stem not in self.without]
        if len(found) < FEWEST:
            raise LogError(f"{self.folder}: {len(found)} null sets; a floor needs {FEWEST} fish or more")
        return found

    def holds(self, excitation: str) -> bool:
        return any(trial.value("excitation") == excitation for trial in trials_of(self.bundles[0]))

    def _run(self, robot: Robot, what: Excitation, record: Record, tick: Tick = lambda done: None) -> list[Record]:
        """The experiment of every fish; noise and constants are what they were."""
        out = [record_of(trial, record.dt) for path in self.bundles for trial in trials_of(path) if _same(trial, what, record)]
        if len(out) != len(self.bundles):
            held = ", ".join(sorted({str(t.value("excitation")) for t in trials_of(self.bundles[0])}))
            did = f"experiment {what.id!r} of record {record.name} was done by {len(out)} of {len(self.bundles)} fish"
            raise LogError(f"{self.folder}: {did}; expected all. The sets hold {held}")
        return out

    def _key(self, model, record: Record, what: Excitation) -> str:
        made = [[sha256(path) for path in self.bundles], source_digest.digest("fishmj.log.compact"), model_digest(model)]
        text = json.dumps([*made, model.fingerprint, what.id, *WINDOW, record.dt, *what.start])
        return hashlib.sha256(text.encode() + what.commands.tobytes()).hexdigest()[:32]


@cache
def trials_of(path: Path) -> tuple[Trial, ...]:
    """The trials of one fish, read once."""
    return tuple(read_bundle(path))


def _same(trial: Trial, what: Excitation, record: Record) -> bool:
    """Whether a trial is that experiment: its name, what was commanded, where it began and how it moved."""
    if str(trial.value("excitation", "")) != what.id:
        return False
    other = record_of(trial, record.dt)
    rows = min(len(other.commands), len(record.commands))
    moved = np.abs(np.subtract([*other.place, *other.push, *other.flow], [*record.place, *record.push, *record.flow])).max()
    return bool(moved < ALIKE and np.mean(np.abs(other.commands[:rows] - record.commands[:rows])) < ALIKE)


def null_of(drawn: dict) -> SimulatedNull:
    """As a report or a version says how null runs are drawn: runs, noise, seed; folder, where they were swum elsewhere.

    Raises:
        ConfigError: another key, or a value of another kind.
    """
    for key, value in drawn.items() if isinstance(drawn, dict) else [("null", drawn)]:
        if key not in DRAWN or not isinstance(value, DRAWN[key]) or isinstance(value, bool):
            expected = "runs, noise, seed and folder"
            raise ConfigError(f"null runs: {str(key)[:40]} = {str(value)[:40]!r}; expected {expected}, as gap find writes them")
    given = SimulatedNull(**{key: value for key, value in drawn.items() if key != "folder"})
    if not (FEWEST_RUNS <= given.runs <= MOST_RUNS and 0 <= given.noise <= LOUDEST and 0 <= given.seed <= LAST_SEED):
        raise ConfigError(f"null runs: runs {given.runs}, noise {given.noise}, seed {given.seed}; out of range")
    return RecordedNull(**drawn | {"folder": Path(drawn["folder"])}) if "folder" in drawn else given
