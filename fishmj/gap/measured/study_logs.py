"""Records of a study, from the user's own tables, from trial folders or from a published set; and the group of each.

    logs_of(study)     a Log for each file or trial: its columns in SI with their stamps, and the keys for groups
    group_of(log, by)  "day1_kp200": the log's values of every name in `by`

A name in `by` is a part of the file's name ({day} in data.names), `file` itself, a constant column of the file, or a
key of a trial's meta data. Text of files is only ever compared and shown.
"""

import re
from fnmatch import fnmatchcase
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fishmj.base.calib import shown_path
from fishmj.base.errors import LogError, closest_name
from fishmj.gap.measured.folder import trials
from fishmj.gap.measured.study_schema import COLUMNS, StudyInput
from fishmj.log import Trial
from fishmj.log.dataset import take
from fishmj.log.importers import delimited, table_forms
from fishmj.log.importers.column_units import UNITS
from fishmj.log.importers.sheet import DATE, Sheet
from fishmj.log.limits import bare, quoted

MOST = 2000  # files
LIMITS = {"length": 1e5, "angle": 1e4, "rate": 1e3, "speed": 100.0, "voltage": 1e3, "": 1e3, "any": 1e6}  # SI
LEAST_ROWS = 8
BLANK = 0.2  # share of rows without a number, beyond which a column is not taken
TABLES = {  # ours -> table and column of a trial folder
    "body": {**{k: ("pose", k) for k in ("x", "y", "yaw")}, **{k: ("gait", k) for k in ("amplitude", "bias")}},
    "servo": {
        **{"goal": ("cmd", "c1"), "on": ("cmd", "on1"), "angle": ("joint", "j1"), "rate": ("joint", "w1")},
        **{"duty": ("joint", "load1"), "volts": ("power", "V")},
    },
    "coast": {"speed": ("velocity", "surge")},
}


class Series(NamedTuple):
    """Values (T,) [SI] at stamps t (T,) [s]."""

    t: np.ndarray
    values: np.ndarray


class Log(NamedTuple):
    """One record. where: file or trial, for messages. trial: values of a trial folder; facts: values of the file and its name."""

    name: str
    where: str
    series: dict[str, Series]
    facts: dict[str, str | float]
    trial: Trial | None = None
    notes: tuple[str, ...] = ()


def logs_of(study: StudyInput) -> list[Log]:
    """Every record, in order of its name.

    Raises LogError: no folder, no file, or a table that lacks a column, is damaged, or has impossible numbers.
    """
    data = study.given.data
    if data.set is not None:
        return [_of_trial(study, name, trial) for name, trial in trials(data.set).items()]
    folder = _inside(study)
    if not study.columns:
        if not any(folder.rglob("meta.toml")) and not (folder / "manifest.json").is_file():
            raise LogError(
                f"{study.where}: {shown_path(folder)} holds no trial folders and the study no [columns]; "
                "add [columns] with the names in your tables"
            )
        return [_of_trial(study, name, trial) for name, trial in take(folder).trials.items()]
    return [_of_table(study, folder, path) for path in _files(study, folder)]


def _inside(study: StudyInput) -> Path:
    """The folder of the logs. Raises LogError: there is none."""
    given = Path(str(study.given.data.folder)).expanduser()
    folder = given if given.is_absolute() else study.folder / given
    if not folder.is_dir():
        raise LogError(f"{study.where} [data] folder: {shown_path(folder)}: no such folder; paths are relative to the study file")
    return folder


def _files(study: StudyInput, folder: Path) -> list[Path]:
    """Tables of the folder and of folders in it; links are not followed."""
    pattern = study.given.data.files
    every = (p for p in folder.rglob("*") if not p.is_symlink() and p.is_file() and not p.name.startswith("."))
    found = sorted(p for p in every if fnmatchcase(p.name, pattern) or fnmatchcase(p.relative_to(folder).as_posix(), pattern))
    if not found:
        raise LogError(f"{study.where} [data] files: {quoted(pattern)} matches no file in {shown_path(folder)}")
    if len(found) > MOST:
        raise LogError(f"{study.where} [data] files: {quoted(pattern)} matches {len(found)} files, expected at most {MOST}")
    return found


def _of_table(study: StudyInput, folder: Path, path: Path) -> Log:
    sheet, stamp = delimited.read(path), study.stamp
    if stamp is None:
        raise LogError(f"{study.where} [columns] t: got nothing, expected the column of the stamps")
    used = {stamp.column, *(c.column for c in study.columns.values() if c.column), *study.given.groups.by}
    table_forms.refuse_several(sheet, used)
    t = stamp.factor * _cells(sheet, stamp.column, "t", stamp.unit)
    table_forms.refuse_digits(sheet, stamp.column)
    if stamp.nanoseconds:
        t = t + 1e-9 * _cells(sheet, stamp.nanoseconds, "t", "")
    columns = {}
    for key, c in study.columns.items():
        if c.constant is not None:
            columns[key] = np.full(len(sheet), c.constant)
        else:
            columns[key] = c.factor * (_cells(sheet, str(c.column), key, c.unit) - c.zero)
    good = np.isfinite(t) & np.all([np.isfinite(v) for v in columns.values()], axis=0)
    where = shown_path(path)
    bad = int(np.sum(~good))
    if good.sum() < LEAST_ROWS or bad > BLANK * len(t):
        raise LogError(
            f"{where}: {bad} of {len(t)} rows lack a number in a column that the study reads; "
            f"expected {LEAST_ROWS} whole rows at least and at most {BLANK:.0%} with blanks. Correct the file or leave it out"
        )
    rules = COLUMNS[study.given.plant]
    for key, values in columns.items():
        most = LIMITS[rules[key].kind]
        over = good & (np.abs(values) > most)
        if over.any():
            row = int(np.flatnonzero(over)[0])
            column = study.columns[key].column or key
            raise LogError(
                f"{sheet.place(row, column)}: {key} = {values[row]:.4g} in SI units, expected at most {most:g}; "
                "is the unit in [columns] right?"
            )
    _rising(sheet, np.flatnonzero(good), t, stamp.column)
    t, begin = t[good], float(t[good][0])
    notes = (f"{bare(path.name)}: {bad} row(s) with blanks left out",) if bad else ()
    name = path.relative_to(folder).with_suffix("").as_posix()
    facts: dict[str, str | float] = {"file": name, **_parts(study, name)}
    for by in study.given.groups.by:
        if by not in facts and by in sheet.columns:
            facts[by] = _constant(sheet, by)
    return Log(name, where, {k: Series(t - begin, v[good]) for k, v in columns.items()}, facts, None, notes)


def _cells(sheet: Sheet, column: str, key: str, unit: str) -> np.ndarray:
    """Cells of one column of a file; its unit must match the study's."""
    if column not in sheet.columns:
        near = closest_name(column, sheet.columns)
        hint = f"; did you mean {quoted(near)}?" if near else ""
        names = ", ".join(quoted(n, 24) for n in list(sheet.columns)[:12])
        raise LogError(f"{sheet.where}: no column {quoted(column)}, which [columns] {key} names{hint}; the file has {names}")
    said = sheet.units.get(column, "")
    if said and said != DATE and unit not in ("", said) and said in UNITS:
        raise LogError(f"{sheet.where}: column {quoted(column)} is in {said}, and [columns] {key} says {unit}; write the file's")
    if not np.isfinite(sheet.columns[column]).any():
        raise LogError(f"{sheet.where}: column {quoted(column)} holds no number ([columns] {key}); expected numbers")
    return sheet.columns[column]


def _rising(sheet: Sheet, rows: np.ndarray, t: np.ndarray, column: str) -> None:
    back = np.flatnonzero(np.diff(t[rows]) <= 0)
    if len(back):
        i, j = rows[back[0]], rows[back[0] + 1]
        raise LogError(
            f"{sheet.place(int(j), column)}: time does not rise: {t[j]:.9g} s after {t[i]:.9g} s; "
            "sort the rows, remove duplicates, or split the file where the clock was set"
        )


def _constant(sheet: Sheet, column: str) -> float:
    values = sheet.columns[column]
    finite = values[np.isfinite(values)]
    if not len(finite) or np.ptp(finite) > 1e-9 * max(1.0, float(np.abs(finite).max())):
        raise LogError(f"{sheet.where}: column {quoted(column)} changes or is blank; [groups] by needs one value a file")
    return float(finite[0])


def _parts(study: StudyInput, name: str) -> dict[str, str | float]:
    """Parts of a file's name by data.names: each {part} ends at the first occurrence of the text after it."""
    template = study.given.data.names
    if not template:
        return {}
    pieces = re.split(r"\{([A-Za-z][A-Za-z0-9_]{0,31})\}", template)
    rest, out = name if "/" in template else name.rpartition("/")[2], {}
    wrong = LogError(
        f"{study.where} [data] names: {quoted(template)} does not fit the file {quoted(name)}; rename it or correct names"
    )
    if not rest.startswith(pieces[0]):
        raise wrong
    rest = rest[len(pieces[0]) :]
    for part, after in zip(pieces[1::2], pieces[2::2], strict=True):
        at = rest.find(after, 1) if after else len(rest)
        if at < 1:
            raise wrong
        out[part], rest = rest[:at], rest[at + len(after) :]
    if rest:
        raise wrong
    return {part: _number(text) for part, text in out.items()}


def _number(text: str) -> str | float:
    """A number if the text is one in plain digits, else the text."""
    return float(text) if re.fullmatch(r"[+-]?\d{1,12}(\.\d{1,12})?", text, re.ASCII) else text


def _of_trial(study: StudyInput, name: str, trial: Trial) -> Log:
    series, plant = {}, study.given.plant
    for key, (table, column) in TABLES[plant].items():
        columns = trial.tables.get(table, {})
        rows = len(columns["t"]) if column in columns else 0
        if COLUMNS[plant][key].needed and rows < LEAST_ROWS:
            has = f"{rows} rows" if column in columns else "no such column"
            raise LogError(
                f"trial {bare(name)}: table {table}, column {column}: {has}, expected {LEAST_ROWS} rows at least for a {plant}; "
                "leave the trial out"
            )
        if rows:
            series[key] = Series(columns["t"], columns[column])
    return Log(name, f"trial {bare(name)}", series, {"file": name}, trial)


def log_value(log: Log, key: str) -> str | float:
    """Value of a name in `by` or `where` for a log. Raises LogError: unknown; the known names are listed."""
    value = log.facts.get(key)
    if value is None and log.trial is not None:
        value = log.trial.value(key)
        value = float(value) if isinstance(value, int | float) and not isinstance(value, bool) else value
    if not isinstance(value, str | float) or not np.isfinite(value if isinstance(value, float) else 0.0):
        known = [*log.facts, *([] if log.trial is None else (k for k, v in log.trial.meta.items() if isinstance(v, str)))]
        what = "a key of its meta data" if log.trial is not None else "a part of data.names or a column that does not change"
        raise LogError(f"{log.where}: has no {quoted(key)}; expected {what}. It has {', '.join(map(bare, known))}")
    return value


def group_of(log: Log, by: list[str]) -> str:
    """The group of a log, printable."""
    parts = []
    for key in by:
        value = log_value(log, key)
        parts.append(f"{key.rpartition('.')[2]}{value:g}" if isinstance(value, float) else value)
    return bare("_".join(parts), 300)
