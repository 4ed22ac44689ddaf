"""Data sets: a folder of trial folders with a `manifest.json` that holds the sha256 of every file.

read_dataset    all of it, unchanged: any changed file makes the whole set an error
take            every readable part: a missing manifest or an unreadable trial does not affect the others

A bundle is many short trials in one small file. It stores every column as whole numbers of a step far below its noise: a 20th of
the sensor's (`sigma` of the meta data), 10 us of time stamps. x = step q; q is stored as the first whole number and then its
differences, which deflate packs tightly: half a kilobyte a second of a swim, a tenth of its folder. Columns outside `KEPT`
(such as velocities from a camera's own filter) are left out.
"""

import hashlib
import json
import os
import shlex
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fishmj.base.errors import FishmjError, LogError, StoreError, UnknownName
from fishmj.base.names import checked
from fishmj.base.store import Manifest, plain, read_npz, sha256, write_npz
from fishmj.base.store.manifest import MANIFEST
from fishmj.log import measurements
from fishmj.log.table_files import row_place
from fishmj.log.trial import Trial
from fishmj.log.trial_check import check_table
from fishmj.log.trial_folder import FLAT_FILE, META_FILE, read_trial, write_trial

DEEP, MOST = 3, 20_000  # levels below a data set, and folders in all, where trials are looked for
NEEDED = (
    f"needed is a folder with one folder a trial, in each {META_FILE} and tables (cmd, joint, pose ..) or a {FLAT_FILE};"
    " fishmj log import SRC --out DATASET makes one of other recordings"
)
BUNDLE = "fishmj.bundle/1"  # schema of many trials in one file
KEPT = {"cmd": "tc", "joint": "tj", "pose": "txy", "power": "tVI"}  # first letters of the columns in a bundle
STEPS = {"t": 1e-5, "c": 1e-5}  # s, rad
FINE = 20.0  # steps in a standard deviation of the noise
COARSE = 1e-6  # step of a column whose noise nobody states, of its own range


@dataclass(frozen=True)
class Dataset:
    """Trials by name, each read on request; in order of name."""

    folder: Path
    names: tuple[str, ...]
    meta: dict

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[Trial]:
        return (self[name] for name in self.names)

    def __getitem__(self, name: str) -> Trial:
        if name not in self.names:
            raise UnknownName(f"trial of {self.folder}", name, self.names)
        return read_trial(self.folder / name)


def read_dataset(folder: str | Path, *, verify: bool = True) -> Dataset:
    """Opens a data set; with `verify` every file is hashed against the manifest first.

    Raises LogError: the folder holds no trial; StoreError: no manifest, or files missing or changed (all are listed).
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise LogError(f"{folder}: no such data set; expected a folder of trial folders with manifest.json")
    manifest = Manifest.read(folder)
    if verify:
        try:
            manifest.verify(folder)
        except StoreError as error:
            raise StoreError(f"{error}; {mend(folder)}") from error
    names = tuple(sorted(str(Path(file).parent) for file in manifest.files if Path(file).name == META_FILE))
    if not names:
        raise LogError(f"{folder}: the manifest names no {META_FILE}; it is not a data set of trials")
    return Dataset(folder, names, manifest.meta)


class Taken(NamedTuple):
    """Readable part of a data set.

    trials: by folder name, in order. broken: folder name -> reason that it was left out. notes: further remarks for a reader.
    sha256: of the manifest's file; without one, of the manifest that the files would have.
    """

    trials: dict[str, Trial]
    broken: dict[str, str]
    notes: tuple[str, ...]
    sha256: str


def take(folder: str | Path) -> Taken:
    """Reads every readable trial of a folder; with a manifest, only those whose files match it.

    Raises:
        LogError: no trial reads, or it is not a folder of trial folders. StoreError: the manifest is damaged, or the page of
            weighings does not match it.
    """
    folder = Path(folder)
    if folder.is_file():
        raise LogError(f"{folder}: one file is at most one trial, and a search or a calibration compares several; {NEEDED}")
    if not folder.is_dir():
        raise LogError(f"{folder}: no such data set; {NEEDED}")
    signed = (folder / MANIFEST).is_file()
    names, broken, notes, digest = _signed(folder) if signed else _unsigned(folder)
    trials: dict[str, Trial] = {}
    for name in names:
        try:
            trials[name] = read_trial(folder / name)
        except (FishmjError, OSError) as error:
            broken[name] = " ".join(str(error).split())
    if not trials:
        first = next(iter(broken.items()), None)
        why = f"; {first[0]}: {first[1]}" if first else ""
        raise LogError(f"{folder}: none of {len(broken)} trials can be read{why}")
    return Taken(trials, dict(sorted(broken.items())), notes, digest)


def mend(folder: Path) -> str:
    """Advice on files that differ from the manifest of a folder."""
    return f"restore it, or if the change is meant: fishmj log manifest {shlex.quote(str(folder))}"


def _signed(folder: Path) -> tuple[list[str], dict[str, str], tuple[str, ...], str]:
    """(trials to read, broken ones, notes, sha256) by the manifest."""
    manifest = Manifest.read(folder)
    names = sorted(str(Path(file).parent) for file in manifest.files if Path(file).name in (META_FILE, FLAT_FILE))
    names = [name for name in dict.fromkeys(names) if name != "."]
    if not names:
        raise LogError(f"{folder}: the manifest names no trial folder; {NEEDED}")
    broken: dict[str, str] = {}
    for change in manifest.check(folder):
        parent = str(Path(change.path).parent)
        if parent in names:
            state = "is gone" if change.got is None else "changed since the manifest was written"
            broken.setdefault(parent, f"{Path(change.path).name} {state}; {mend(folder)}")
        elif change.path == measurements.FILE:
            raise StoreError(f"{folder}: {change}; {mend(folder)}")
    listed = {str(Path(file).parent) for file in manifest.files}
    new = [name for name in _folders(folder) if name not in listed]
    notes = (f"not in the manifest, left out: {', '.join(new[:5])}{' ..' if len(new) > 5 else ''}",) if new else ()
    return [name for name in names if name not in broken], broken, notes, sha256(folder / MANIFEST)


def _unsigned(folder: Path) -> tuple[list[str], dict[str, str], tuple[str, ...], str]:
    """(trials to read, broken ones, notes, sha256) of a folder without a manifest, from its present files."""
    names = _folders(folder)
    if not names:
        if _is_trial(os.listdir(folder)):
            raise LogError(f"{folder}: this is one trial, and a search or a calibration compares several; {NEEDED}")
        raise LogError(f"{folder}: no trial in it; {NEEDED}")
    paths = [p for name in names for p in sorted((folder / name).iterdir()) if p.is_file() and not p.name.startswith(".")]
    paths += [p for p in (folder / measurements.FILE,) if p.is_file()]
    files, broken = {}, {}
    for path in paths:
        try:
            files[path.relative_to(folder).as_posix()] = sha256(path)
        except StoreError as error:
            broken[path.parent.relative_to(folder).as_posix()] = str(error)
    notes = (f"{folder} has no {MANIFEST}: nothing says whether its files are as they were recorded",)
    digest = hashlib.sha256(json.dumps(files, sort_keys=True).encode()).hexdigest()
    return [name for name in names if name not in broken], broken, notes, digest


def _folders(folder: Path) -> list[str]:
    """Names of the trial folders below `folder`, hidden ones and links left out."""
    found, seen = [], 0
    for at, below, files in os.walk(folder):
        seen += 1
        if seen > MOST:
            raise LogError(f"{folder}: more than {MOST} folders; name the folder of the trials themselves")
        name = Path(at).relative_to(folder).as_posix()
        below[:] = [] if name.count("/") >= DEEP - 1 and name != "." else [b for b in below if not b.startswith(".")]
        if name != "." and _is_trial(files):
            found.append(name)
    return sorted(found)


def _is_trial(files: Iterable[str]) -> bool:
    """Returns True for the files of a trial folder: meta data, a flat file, or a table of commands."""
    return bool(set(files) & {META_FILE, FLAT_FILE, "cmd.csv", "cmd.npz"})


def write_dataset(
    folder: str | Path,
    trials: Mapping[str, Trial] | Iterable[tuple[str, Trial]],
    *,
    meta: dict | None = None,
    overwrite: bool = False,
    page: Mapping | None = None,
) -> Path:
    """Writes trials as sub-folders, a page of weighings (measurements.py), and then the manifest, atomically.

    An iterable of trials is consumed one at a time.
    """
    folder = Path(folder)
    count = 0
    for name, trial in trials.items() if isinstance(trials, Mapping) else trials:
        if not name or Path(name).is_absolute() or ".." in Path(name).parts or name.startswith("."):
            raise LogError(f"{folder}: {name!r} cannot name a trial; use letters, digits, - and _")
        write_trial(folder / name, trial, overwrite=overwrite)
        count += 1
    if not count:
        raise LogError(f"{folder}: no trials to write")
    if page:
        measurements.write(folder, page)
    Manifest.of(folder, meta).write(folder)
    return folder


def write_bundle(path: "str | Path", trials: Iterable[Trial]) -> Path:
    """Writes trials (synthetic or measured) into one file, atomically.

    Raises LogError: no trial, two of one name, or a value that is not finite.
    """
    arrays, about = {}, []
    for trial in trials:
        if trial.name in {a["name"] for a in about}:
            raise LogError(f"{path}: two trials named {trial.name!r}; a bundle needs a name of its own for each")
        steps = {}
        for table, letters in KEPT.items():
            for column, values in trial.tables.get(table, {}).items():
                if column[0] in letters and column not in ("vx", "vy"):
                    step = _step(trial, column, values)
                    whole = np.rint(np.asarray(values, float) / step)
                    if not np.isfinite(whole).all():
                        raise LogError(f"{path}: trial {trial.name}, {table}.{column}: a value is not finite")
                    arrays[f"{len(about)}/{table}/{column}"] = _narrow(np.diff(whole.astype(np.int64), prepend=0))
                    steps[f"{table}/{column}"] = step
        about.append({"name": trial.name, "meta": trial.meta, "steps": steps})
    if not about:
        raise LogError(f"{path}: no trials to write")
    text = json.dumps(plain({"schema": BUNDLE, "trials": about}))
    return write_npz(path, arrays | {"about": np.frombuffer(text.encode(), np.uint8)})


def read_bundle(path: "str | Path") -> list[Trial]:
    """The trials of a bundle, in the order in which they were written.

    Raises StoreError: missing, damaged, or no bundle; LogError: a table that breaks the schema; ConfigError: an invalid name.
    """
    arrays = read_npz(path)
    try:
        about = json.loads(arrays.pop("about").tobytes().decode())
        if about["schema"] != BUNDLE:
            raise StoreError(f"{path}: schema {about['schema']!r}, expected {BUNDLE!r}")
        out = []
        for i, one in enumerate(about["trials"]):
            tables: dict = {}
            if not isinstance(one["meta"], dict):
                raise TypeError(f"meta of trial {i + 1} is no table")
            for key, step in one["steps"].items():
                table, column = key.split("/")
                tables.setdefault(table, {})[column] = step * np.cumsum(arrays[f"{i}/{key}"].astype(np.int64))
            name = checked(one["name"], "trial", str(path))
            for table, columns in tables.items():
                check_table(table, columns, row_place(f"{path}:{name}/{table}"))
            out.append(Trial(one["meta"], tables, name=name))
        return out
    except FishmjError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError, OverflowError) as error:
        raise StoreError(f"{path}: not a bundle of trials ({error!r}); write it again with write_bundle") from error


def _step(trial: Trial, column: str, values) -> float:
    """Step of a column, in its own unit."""
    if column[0] in STEPS:
        return STEPS[column[0]]
    sigma = trial.value(f"sigma.{column}")
    return float(sigma) / FINE if sigma else COARSE * float(np.ptp(values) or 1.0)


def _narrow(whole: np.ndarray) -> np.ndarray:
    """Converts whole numbers to the smallest integer type that holds them."""
    size = int(np.abs(whole).max(initial=0))
    kind = next(k for k in (np.int8, np.int16, np.int32, np.int64) if size <= np.iinfo(k).max)
    return whole.astype(kind)
