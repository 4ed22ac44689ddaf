"""One flat csv on a common clock, ours: a header of column names, with or without units: `t [s],c1 [rad],x [m]`.

The columns go to the tables of the schema by their names. A unit outside the schema is refused with the factor to
apply; so are decimal commas, byte order marks and, by size, degrees without a unit. Nothing is converted silently.
"""

import math
import re
from pathlib import Path

from fishmj.base.errors import LogError
from fishmj.log.importers.column_units import UNITS, measures, unit_of
from fishmj.log.table_files import read_csv
from fishmj.log.trial import BY_KIND, Trial, table_spec
from fishmj.log.trial_folder import FLAT, META_FILE, flat_trial, read_meta

_HEADER = re.compile(r"(?P<name>[^\[\]()]+?)\s*[\[(](?P<unit>[^\[\]()]*)[\])]")
_NAMED = {"t": "s", "t_rx": "s", "V": "V", "I": "A", "frequency": "Hz"}


def sniff(path: Path) -> bool:
    """Returns True for a csv file (or a folder with samples.csv) whose first row names a column `t`."""
    file = path / "samples.csv" if path.is_dir() else path
    if file.suffix != ".csv" or not file.is_file():
        return False
    with open(file, "rb") as source:
        start = source.readline(4000).decode("utf-8", "replace").lstrip("\ufeff")
    return any(re.fullmatch(r'\s*"?t\s*([\[(].*)?"?\s*', name) for name in re.split("[,;\t]", start.rstrip("\r\n")))


def read(path: Path) -> dict[str, Trial]:
    """One trial, named after the file, or after its folder when the file is samples.csv."""
    file = path / "samples.csv" if path.is_dir() else path
    named, place = read_csv(file)
    columns, sources = {}, {}
    for header, values in named.items():
        name, unit = _split(header)
        _check_unit(name, unit, place(-1, header))
        if name in columns:
            raise LogError(f"{place(-1, header)}: column {name!r} appears twice; remove one of them")
        columns[name], sources[name] = values, header
    meta, notes = read_meta(file.with_name(META_FILE), required=False)
    trial = flat_trial(columns, lambda row, column: place(row, sources.get(column, column)), file, meta, notes)
    name = trial.name if file.name == "samples.csv" else file.stem
    return {name: Trial({"origin": "measured", **meta}, trial.tables, name, trial.notes)}


def _split(header: str) -> tuple[str, str]:
    found = _HEADER.fullmatch(header.strip())
    return (found["name"].strip(), found["unit"].strip()) if found else (header.strip(), "")


def _check_unit(name: str, unit: str, where: str) -> None:
    """Refuses a unit other than the schema's, with the factor."""
    template = re.sub(r"\d+\Z", "#", name)
    table = FLAT.get(name) or FLAT.get(template)
    kind = table_spec(table).kind(name) if table else ""
    expected = _NAMED.get(name) or BY_KIND.get(kind, "")
    spelled = unit_of(unit)
    if not unit or not expected or spelled == expected:
        return
    factor = UNITS[spelled][1] if measures(spelled) == measures(expected) else math.nan
    fix = f"Multiply the column by {factor:.9g}" if factor > 0 else f"Convert the column to {expected}"
    raise LogError(f"{where}: column {name!r} is in {unit}; the schema says {expected}. {fix} and write [{expected}]")
