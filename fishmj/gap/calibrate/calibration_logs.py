"""What a calibration reads, and what it keeps.

trials      sorted by signal, medium and repeat; what is missing is said in one line
parts       finished swims of the solver, robots drawn anew: one JSON file each, so that the same command goes on with the rest;
            a part of other settings or another version of this package is done again
"""

import hashlib
import json
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fishmj.base import interrupt
from fishmj.base.calib import calib_folder
from fishmj.base.errors import LogError, StoreError
from fishmj.base.source import package_sha256
from fishmj.base.store import plain, read_json, write_json
from fishmj.gap.records.datasets import readable_trials
from fishmj.gap.records.records import Record, Sensor, record_of
from fishmj.log import Trial
from fishmj.log.trial import stacked

SIGNALS = ("sine", "square", "impulse")  # the paper's
MEDIA = ("air", "water")
LEAST = 2  # signals: a sine alone has one frequency, at which gain, damping and latency stand in for each other
QUIET = np.radians(2.0)  # of command, peak to peak: less is within dead band and gear play
FOLDER = Path("data") / "calib" / "trials"


def shipped() -> Path:
    """The trials of this checkout, or those of the installed package."""
    return FOLDER if FOLDER.is_dir() else calib_folder() / "trials"


class Logs(NamedTuple):
    """Trials by name, and their records at the plant's step. broken: trials that were left out, and why. notes: on the folder."""

    folder: Path
    trials: dict[str, Trial]
    broken: dict[str, str] = {}  # noqa: RUF012  never changed
    notes: tuple[str, ...] = ()

    def records(self, dt: float, names: "list[str] | None" = None) -> list[Record]:
        """Records of the named trials, or of all."""
        return [record_of(self.trials[name], dt)._replace(name=name) for name in (names or self.trials)]

    def of(self, medium: str, signals) -> list[str]:
        """Names of the trials of some signals in one medium, repeats together."""
        wanted = lambda t: t.value("medium", "water") == medium and t.value("excitation", "") in signals
        return [name for name, trial in self.trials.items() if wanted(trial)]

    def bench(self) -> list[str]:
        """Sine, square and impulse in both media, of trials in which a servo was told to move and its angles were measured.

        Raises:
            LogError: fewer than two signals, of which each tells what the other cannot.
        """
        names = [name for medium in MEDIA for name in self.of(medium, SIGNALS)]
        silent = {name: why for name in names if (why := unfit(self.trials[name]))}
        names = [name for name in names if name not in silent]
        kinds = Counter((str(t.value("excitation", "")), t.value("medium", "water")) for t in map(self.trials.get, names) if t)
        lacking = [signal for signal in SIGNALS if not any(signal == found for found, _ in kinds)]
        if len(lacking) > len(SIGNALS) - LEAST:
            found = ", ".join(f"{n} {signal} in {medium}" for (signal, medium), n in kinds.items()) or "none"
            left = "".join(f"; {name} is left out: {why}" for name, why in silent.items())
            raise LogError(
                f"{self.folder}: a servo calibration needs at least two of {', '.join(SIGNALS)}, and finds {found}{left}. "
                f"Record {', '.join(lacking)} in air and in water, three times each (meta: excitation, medium)"
            )
        return names


def unfit(trial: Trial) -> str:
    """Why a trial says nothing of a servo; "" where it does."""
    if "joint" not in trial.tables:
        return "no table joint, a servo is calibrated by its angles"
    span = float(np.ptp(stacked(trial.table("cmd"), "c#"), axis=0).max())
    if span >= QUIET:
        return ""
    return f"its commands stay within {np.degrees(span):.2g} deg, at least {np.degrees(QUIET):.2g} are needed"


def angles(record: Record) -> Sensor:
    """The measured joint angles. Raises LogError where there are none."""
    if record.joint is None:
        raise LogError(f"trial {record.name}: no table joint; a servo is calibrated by its angles")
    return record.joint


def read(folder: "str | Path") -> Logs:
    """All trials of a data set that can be read, less rows of failed reads; what cannot be is in `broken`.

    Raises:
        LogError, StoreError: none there.
    """
    found = readable_trials(Path(folder))
    return Logs(Path(folder), found.trials, found.broken, found.notes)


class PartialResults:
    """The parts of one command. folder: where they are; about: what all of them depend on, besides the package's own code."""

    def __init__(self, folder: Path, about: dict):
        self.folder = folder
        self.key = hashlib.sha256(json.dumps(plain([about, package_sha256()]), sort_keys=True).encode()).hexdigest()

    def find(self, name: str) -> Any:
        """What a finished part gave, as JSON has it; None where it is not finished."""
        path = self.folder / f"{name}.json"
        try:
            row = read_json(path) if path.is_file() else {}
        except StoreError:  # damaged: done again
            return None
        return row.get("found") if isinstance(row, dict) and row.get("key") == self.key else None

    def keep(self, name: str, found: Any) -> Any:
        """Write what a part gave; returns it as `find` would."""
        write_json(self.folder / f"{name}.json", {"key": self.key, "found": found})
        return self.find(name)

    def words(self, names: list[str], what: str) -> str:
        """What an interrupted command says. names: of all its parts; what: they are."""
        done = sum(self.find(name) is not None for name in names)
        return f"{self.folder} holds {done} of {len(names)} {what}; {interrupt.again()}"
