"""Assigns values to joints by name in text tables: `rostopic echo -p` writes a column of names beside each column of values.

`field.name0, field.name1, .., field.position0, field.position1, ..`: each value goes to the joint that its own row names, as in a
recording of the same messages (`message_recordings.py`).
"""

import re
from collections.abc import Mapping, Sequence

import numpy as np

from fishmj.base.errors import LogError
from fishmj.log.limits import quoted
from fishmj.log.trial import Table

ROW = re.compile(
    r"(joint|servo|motor|actuator)s?([ _.-]?(name|id))?|name", re.IGNORECASE
)  # a column that names the joint of its row
QUANTITY = re.compile(r"topic|variable|channel|signal|sensor|parameter|key|field|quantity|measurement|type", re.IGNORECASE)
VALUE = re.compile(r"values?|data|readings?|wert", re.IGNORECASE)  # a column beside it
LONG = 4  # columns of a table with a row for each quantity, at most
STATE = {"position": "", "velocity": ".velocity", "effort": ".effort"}  # lists of a JointState -> ends of their columns
NAME = re.compile(r"(?P<before>.*?)(?P<key>(?:joint_)?names?)(?P<mark>[._\[]?)(?P<number>\d{1,3})\]?", re.IGNORECASE)


def column_of(name: str, key: str) -> str:
    """Column's name: `joint.NAME` for a position, `joint.NAME.velocity`, `joint.NAME.effort`; else `KEY.NAME`."""
    return f"joint.{name}{STATE[key]}" if key in STATE else f"{key}.{name}"


def holds_names(column: str, columns: Sequence[str] = ()) -> bool:
    """Returns True for a column that may hold names of joints: `name0`, `joint_name`; or of quantities, beside one of values."""
    return bool(NAME.fullmatch(column) or ROW.fullmatch(column)) or (
        bool(QUANTITY.fullmatch(column)) and len(columns) <= LONG and any(map(VALUE.fullmatch, columns))
    )


def _refuse_long(where: str, column: str, cells: Sequence[str]) -> None:
    """Refuses a table with a row for each joint or quantity, whose values would be taken for those of one joint."""
    names = list(dict.fromkeys(cells))
    what, value = ("quantity", "VALUE") if QUANTITY.fullmatch(column) else ("joint", "ANGLE")
    if 1 < len(names) <= 64 and len(cells) >= 3 * len(names) and "" not in names:
        raise LogError(
            f"{where}: column {quoted(column)} names the {what} of each row ({', '.join(map(quoted, names[:4]))}); "
            f"expected a column for each {what}: table.pivot(index=TIME, columns={quoted(column)}, values={value}) in pandas"
        )


def by_name(where: str, columns: Table, names: Mapping[str, Sequence[str]]) -> Table:
    """Columns in which those beside a column of names are replaced by one for each named joint.

    Args:
        names: column of names -> name in each row, "" for a blank cell.

    Raises LogError: a value stands beside a blank name.
    """
    out = dict(columns)
    for column, cells in names.items():
        found = NAME.fullmatch(column)
        if not found:
            _refuse_long(where, column, cells)
            continue
        out.pop(column, None)
        cell = np.array(cells, dtype=object)
        ending = re.compile(re.escape(found["before"]) + r"(\w+?)" + re.escape(column[found.end("key") :]))
        for other in [name for name in out if name not in names]:
            if not (value := ending.fullmatch(other)):
                continue
            values = out.pop(other)
            if (lost := np.flatnonzero(np.isfinite(values) & (cell == ""))).size:
                raise LogError(
                    f"{where}: row {lost[0] + 1}: {quoted(other)} has a value and {quoted(column)} is blank: which joint is it?"
                )
            for name in dict.fromkeys(cells):
                if name:
                    mine = out.setdefault(column_of(name, re.sub(r"s\Z", "", value[1].lower())), np.full(len(values), np.nan))
                    mine[cell == name] = values[cell == name]
    return out
