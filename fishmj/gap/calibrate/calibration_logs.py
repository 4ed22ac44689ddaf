"""Input of a calibration, and its partial results.

trials      sorted by signal, medium and repeat; missing ones are reported in one line
parts       finished swims of the solver, robots drawn anew: one JSON file each, so that the same command continues with the rest;
            a part of other settings or another version of this package is repeated
"""

from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fishmj.base import interrupt
from fishmj.base.calib import calib_folder
from fishmj.base.errors import LogError, StoreError
from fishmj.base.source import package_sha256
from fishmj.base.store import json_sha256, plain, read_json, write_json
from fishmj.gap.records.datasets import readable_trials
from fishmj.gap.records.records import Record, Sensor, record_of
from fishmj.log import Trial
from fishmj.log.trial import stacked

SIGNALS = ("sine", "square", "impulse")  # the paper's
MEDIA = ("air", "water")
LEAST = 2  # signals: a sine alone has one frequency, which cannot separate gain, damping and latency
QUIET = np.radians(2.0)  # least peak-to-peak command: less is within dead band and gear play
SMOOTHED, LIKE, ROWS = 0.15, 3.0, range(3, 26)  # power at an average's zeros to that between; one as deep; rows of the average
SHORT, FEW = 100, 4  # rows of a trial, and trials, of which no smoothing is told
FOLDER = Path("data") / "calib" / "trials"


def shipped() -> Path:
    """The trials of this checkout, or those of the installed package."""
    return FOLDER if FOLDER.is_dir() else calib_folder() / "trials"


class Logs(NamedTuple):
    """Trials by name, and their records at the plant's step.

    broken: omitted trials with reasons. notes: on the folder. verb: of `fishmj calibrate`, for messages.
    """

    folder: Path
    trials: dict[str, Trial]
    broken: dict[str, str] = {}  # noqa: RUF012  never changed
    notes: tuple[str, ...] = ()
    verb: str = "servo"

    def records(self, dt: float, names: "list[str] | None" = None, camera: float | None = None) -> list[Record]:
        """Records of the named trials, or of all. camera: as of `record_of`; None leaves the stamps, to calibrate latencies."""
        return [record_of(self.trials[name], dt, camera)._replace(name=name) for name in (names or self.trials)]

    def of(self, medium: str, signals) -> list[str]:
        """Names of the trials of some signals in one medium, repeats together."""
        wanted = lambda t: t.value("medium", "water") == medium and t.value("excitation", "") in signals
        return [name for name, trial in self.trials.items() if wanted(trial)]

    def bench(self) -> list[str]:
        """Sine, square and impulse in both media, from trials with moving commands and measured joint angles.

        Raises LogError: fewer than two signals, which complement each other.
        """
        names = [name for medium in MEDIA for name in self.of(medium, SIGNALS)]
        silent = {name: why for name in names if (why := unfit(self.trials[name]))}
        names = [name for name in names if name not in silent]
        kinds = Counter((str(t.value("excitation", "")), t.value("medium", "water")) for t in map(self.trials.get, names) if t)
        lacking = [signal for signal in SIGNALS if not any(signal == found for found, _ in kinds)]
        if len(lacking) > len(SIGNALS) - LEAST:
            found = ", ".join(f"{n} {signal} in {medium}" for (signal, medium), n in kinds.items()) or "none"
            left = "".join(f"; {name} is left out: {why}" for name, why in silent.items())
            blind = bool(self.trials) and not any("joint" in t.tables for t in self.trials.values())
            remains = ". A robot without encoders has `fishmj gap find`, which compares commands and poses" if blind else ""
            raise LogError(
                f"{self.folder}: calibrate {self.verb} needs at least two of {', '.join(SIGNALS)}; found: {found}{left}. "
                f"Record {', '.join(lacking)} in air and in water, three times each (meta: excitation, medium);"
                f" for existing trials, name the signal: log import .. --excitation TRIAL={lacking[0]}{remains}"
            )
        return names


def unfit(trial: Trial) -> str:
    """Reason why a trial cannot be used for a servo fit; "" if it can."""
    if "joint" not in trial.tables:
        return "no table joint, the measured joint angles"
    span = float(np.ptp(stacked(trial.table("cmd"), "c#"), axis=0).max())
    if span >= QUIET:
        return ""
    return f"its commands stay within {np.degrees(span):.2g} deg, at least {np.degrees(QUIET):.2g} are needed"


def smoothing(trials: "list[Trial]") -> str:
    """Warning about joint angles smoothed by a moving average; "" if there is no sign of one.

    An average over w rows has no power at multiples of 1 / w of the rate. Every signal must show that, since a periodic one has
    little power at some frequencies anyway.
    """
    kinds: dict[str, list[list[float]]] = {}
    for trial in trials:
        bend = np.diff(stacked(trial.table("joint"), "j#"), 2, axis=0)
        bend = (bend - bend.mean(0)) * np.hanning(len(bend))[:, None]
        if len(bend) >= SHORT and bend.any():
            moved, zeros = bend[:, bend.any(axis=0)], [(np.arange(1, (w + 1) // 2) / w, 0.5 / w) for w in ROWS]
            deep = [_level(moved, at) - _level(moved, (at + half)[at + half <= 0.5]) for at, half in zeros]
            kinds.setdefault(str(trial.value("excitation", "")), []).append(deep)
    if len(kinds) < LEAST or sum(map(len, kinds.values())) < FEW:
        return ""
    left = np.exp(np.max([np.mean(rows, axis=0) for rows in kinds.values()], axis=0))
    if left.min() > SMOOTHED:
        return ""
    rows = ROWS[int(np.flatnonzero(left <= min(SMOOTHED, LIKE * left.min()))[-1])]
    return (
        f"joint: the angles have no power at multiples of 1/{rows} of their rate, as after a moving average over {rows} rows. A"
        " centred average shortens command_latency and raises kd; use the unsmoothed angles"
    )


def _level(x: np.ndarray, frequencies: np.ndarray) -> float:
    """Mean logarithm of the power of columns (T, J) at some frequencies, 1 / rows."""
    wave = np.exp(-2j * np.pi * np.outer(frequencies, np.arange(len(x))))
    return float(np.log(np.abs(wave @ x) ** 2 + 1e-30).mean())


def angles(record: Record) -> Sensor:
    """The measured joint angles. Raises LogError without any."""
    if record.joint is None:
        raise LogError(f"trial {record.name}: no table joint; a servo calibration needs joint angles")
    return record.joint


def read(folder: "str | Path") -> Logs:
    """All readable trials of a data set, without rows of failed reads; the others are in `broken`.

    Raises LogError, StoreError: none there.
    """
    found = readable_trials(Path(folder))
    return Logs(Path(folder), found.trials, found.broken, found.notes)


class PartialResults:
    """Finished parts of one command. folder: of their files; about: inputs of all of them, besides the package's own code."""

    def __init__(self, folder: Path, about: dict):
        self.folder = folder
        self.key = json_sha256(plain([about, package_sha256()]))

    def find(self, name: str) -> Any:
        """Result of a finished part, from its JSON; None if it is not finished."""
        path = self.folder / f"{name}.json"
        try:
            row = read_json(path) if path.is_file() else {}
        except StoreError:  # damaged: done again
            return None
        return row.get("found") if isinstance(row, dict) and row.get("key") == self.key else None

    def keep(self, name: str, found: Any) -> Any:
        """Writes the result of a part; returns it as `find` would."""
        write_json(self.folder / f"{name}.json", {"key": self.key, "found": found})
        return self.find(name)

    def words(self, names: list[str], what: str) -> str:
        """Message of an interrupted command. names: of all its parts; what: their kind."""
        done = sum(self.find(name) is not None for name in names)
        return f"{self.folder} holds {done} of {len(names)} {what}; {interrupt.again()}"
