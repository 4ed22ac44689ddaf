"""Trials on disk: a folder with `meta.toml` and one file a table, or one flat `samples.csv` on a common clock.

Reading never edits the source. Writing builds the whole folder beside its place and renames it there in one step.
"""

import os
import re
import shlex
import shutil
from pathlib import Path

import numpy as np

from fishmj.base.calib import parse_toml
from fishmj.base.errors import FishmjError, LogError, StoreError
from fishmj.base.plain_file import why_unreadable
from fishmj.base.store import put_in_place, temporary_beside, write_text
from fishmj.log import toml, trial_check
from fishmj.log.limits import listed, quoted
from fishmj.log.table_files import read_archive, read_csv, read_toml, row_place, write_archive, write_csv
from fishmj.log.trial import SCHEMA, TABLES, Table, Trial
from fishmj.log.trial_check import Plausible, bounds_of
from fishmj.log.unread_rows import failed_reads

META_FILE, FLAT_FILE = "meta.toml", "samples.csv"
JOURNAL = "journal"  # folder of rows that the robot's host appends while the fish swims
FLAT = {"c#": "cmd", "j#": "joint", "w#": "joint", "load#": "joint", "x": "pose", "y": "pose", "yaw": "pose", "quality": "pose"}
FLAT |= {"V": "power", "I": "power", "o#": "obs", "a#": "action", "seq": "cmd", "t_rx": "cmd", "on#": "cmd", "temp#": "joint"}
FLAT |= dict.fromkeys(("amplitude", "bias", "frequency"), "gait") | dict.fromkeys(("surge", "sway", "yaw_rate"), "velocity")
OF_ARM = "logs of an arm or another robot in MJCF or URDF go without an import to fishmj gap find LOGS --model robot.xml"


def read_trial(path: str | Path) -> Trial:
    """Reads and checks a trial folder, or a flat `samples.csv` (with `meta.toml` beside it, if there is one).

    Columns come back as float64, meta as nested dictionaries. Missing or unusual things are listed in `trial.notes`.

    Raises:
        LogError: the data break the schema; file:line:column and the fix.
        StoreError: a binary table is damaged or holds pickled objects.
    """
    path = Path(path)
    if path.is_file() and path.suffix == ".csv":
        return _read_flat(path)
    if not path.is_dir():
        why = why if (why := why_unreadable(path)).startswith("is ") else "no such trial"
        raise LogError(f"{path}: {why}; expected a folder with {META_FILE} and tables, or a flat {FLAT_FILE}")
    _inside(path, path / FLAT_FILE)
    if (path / FLAT_FILE).is_file():
        return _read_flat(path / FLAT_FILE)
    meta, notes = read_meta(path / META_FILE, required=True)
    bounds = bounds_of(meta, str(path / META_FILE))
    tables: dict[str, Table] = {}
    for file in sorted(path.iterdir()):
        if file.suffix not in (".csv", ".npz") or file.name.startswith("."):
            if (name := file.name.partition(".")[0].lower()) in TABLES and file.is_file():
                notes.append(f"{file.name}: not read; expected {name}.csv or {name}.npz, unpacked and in lower case")
            continue
        if file.stem not in TABLES:
            notes.append(f"{file.name}: no table of the schema; ignored. Known: {', '.join(TABLES)}")
            continue
        if file.stem in tables:
            raise LogError(f"{path}: table {file.stem!r} is there as .csv and as .npz; remove one of them")
        tables[file.stem], told = _read_table(file, bounds)
        notes += told
    if not tables:
        if (path / JOURNAL).is_dir():
            again = f"fishmj deploy recover {shlex.quote(str(path))}"
            raise LogError(f"{path}: a swim under way, or one whose host was killed; then run: {again}")
        raise LogError(f"{path}: no table found; expected at least one of {', '.join(TABLES)} as .csv or .npz")
    notes += trial_check.check_counts(tables, meta)
    return Trial(meta, tables, name=path.name, notes=tuple(notes))


def _read_table(file: Path, bounds: Plausible) -> tuple[Table, list[str]]:
    """One table of a trial folder, checked, and the notes of its check."""
    _inside(file.parent, file)
    table, place = read_csv(file) if file.suffix == ".csv" else read_archive(file)
    try:
        return table, trial_check.check_table(file.stem, table, place, bounds)
    except trial_check.Implausible as doubt:
        bad, notes = failed_reads(table, bounds) if file.stem == "joint" else (np.zeros(0, bool), [])
        if doubt.bound == "angle" and notes and np.abs(table[doubt.column][~bad]).max() <= bounds.angle:
            told = notes[0].replace("left out", "to leave out")
            raise LogError(f"{doubt.place}: column {doubt.column!r} is {doubt.value:g} rad in single rows; {told}") from doubt
        raise


def _inside(folder: Path, file: Path) -> None:
    """Refuses a link out of the trial's folder: it may lead to any file, and a copy of the trial would lose it."""
    if file.is_symlink() and not Path(os.path.realpath(file)).is_relative_to(os.path.realpath(folder)):
        raise LogError(f"{file}: a link that leads outside {folder}; put the file itself there")


def faults(path: Path) -> list[str]:
    """Tables of a trial folder that cannot be read, one line each; empty if all can, or if it is no folder."""
    out: list[str] = []
    try:
        meta, _ = read_meta(path / META_FILE, required=True)
        bounds = bounds_of(meta, str(path / META_FILE))
        files = sorted(path.iterdir())
    except (FishmjError, OSError) as error:
        return [str(error)] if path.is_dir() else []
    for file in files:
        if file.suffix in (".csv", ".npz") and file.stem in TABLES:
            try:
                _read_table(file, bounds)
            except FishmjError as error:
                out.append(str(error))
    return out


def write_trial(
    folder: str | Path, trial: Trial, *, overwrite: bool = False, form: str = "auto", precision: str = "auto"
) -> Path:
    """Checks a trial and writes it as a folder, in one step: all of it or nothing.

    Args:
        overwrite: replace an existing trial folder (never a folder that is no trial).
        form: "csv", "npz", or "auto" (npz for synthetic trials, csv for measured ones).
        precision: of npz columns: "auto" (see `table_files.narrow`), "float32" or "float64".

    Raises LogError: the trial breaks the schema; StoreError: the folder exists, or the disk refuses.
    """
    folder = Path(folder)
    meta_text = checked_meta(folder, trial.meta)
    bounds = bounds_of(trial.meta, str(folder / META_FILE))
    tables = {name: {c: np.asarray(v) for c, v in table.items()} for name, table in trial.tables.items()}
    for name, table in tables.items():
        trial_check.check_table(name, table, row_place(folder / name), bounds)
    if not tables:
        raise LogError(f"{folder}: a trial needs at least one table of {', '.join(TABLES)}")
    if form not in ("auto", "csv", "npz"):
        raise LogError(f"form = {form!r}; expected auto, csv or npz")
    binary = form == "npz" or form == "auto" and trial.meta.get("origin") == "synthetic"
    if folder.exists() and not overwrite:
        raise StoreError(f"{folder}: exists; choose another name or pass overwrite=True")
    if folder.exists() and not (folder / META_FILE).is_file():
        raise StoreError(f"{folder}: exists and is no trial (no {META_FILE}); not overwritten. Choose another name")
    temporary = temporary_beside(folder)
    try:
        for name, table in tables.items():
            if binary:
                write_archive(temporary / f"{name}.npz", table, precision)
            else:
                write_csv(temporary / f"{name}.csv", table)
        write_text(temporary / META_FILE, meta_text)
        put_in_place(temporary, folder)
    except OSError as error:
        raise error if isinstance(error, StoreError) else StoreError(f"{folder}: could not be written: {error}") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return folder


def checked_meta(folder: Path, meta: dict) -> str:
    """The text of a trial's meta.toml. Raises LogError: the origin is missing, a value is impossible or has no TOML form."""
    meta = toml.nested({"schema": SCHEMA, **meta})
    if "origin" not in meta:
        raise LogError(f'{folder / META_FILE}: origin is not set; say meta["origin"] = "synthetic" or "measured"')
    text = toml.dumps(meta)
    trial_check.check_meta(parse_toml(text, str(folder / META_FILE)), str(folder / META_FILE))
    return text


def read_meta(path: Path, *, required: bool) -> tuple[dict, list[str]]:
    """The dictionary of a `meta.toml` and the notes of its check; an absent one is empty unless `required`."""
    _inside(path.parent, path)
    why = why_unreadable(path)
    if why and why != "no such file":
        raise LogError(f"{path}: {why}")
    if why:
        if required:
            raise LogError(f'{path}: missing; write at least schema = "{SCHEMA}" and origin = "measured" (or "synthetic")')
        return {}, [f"{path.name}: missing; origin, robot and flow are unknown"]
    meta = read_toml(path)
    return meta, trial_check.check_meta(meta, str(path))


def _read_flat(path: Path) -> Trial:
    samples, place = read_csv(path)
    meta, notes = read_meta(path.with_name(META_FILE), required=False)
    return flat_trial(samples, place, path, meta, notes)


def flat_trial(samples: Table, place: trial_check.Place, path: Path, meta: dict, notes: list[str]) -> Trial:
    """Splits the columns of a flat file over the tables; every table gets the common `t`."""
    if "t" not in samples:
        raise LogError(f"{place(-1, '')}: column 't' is missing; it has {listed(samples)}. Add time stamps in s")
    tables: dict[str, Table] = {}
    notes = list(notes)
    for column, values in samples.items():
        name = FLAT.get(column) or FLAT.get(re.sub(r"\d+\Z", "#", column))
        if name:
            tables.setdefault(name, {"t": samples["t"]})[column] = values
        elif column != "t":
            notes.append(f"{path.name}: column {quoted(column)} belongs to no table; left out. Known: {', '.join(FLAT)}")
    if not tables:
        raise LogError(f"{place(-1, '')}: no column of a known table; known: {', '.join(FLAT)}, # = 1, 2, ..; {OF_ARM}")
    bounds = bounds_of(meta, str(path.with_name(META_FILE)))
    for name, table in tables.items():
        notes += trial_check.check_table(name, table, place, bounds)
    return Trial(meta, tables, name=path.parent.name, notes=(*notes, *trial_check.check_counts(tables, meta)))
