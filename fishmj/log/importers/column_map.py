"""MAP.toml: maps the columns of a lab's file to ours, with their units; docs/search/logs.md shows one.

value = sign * (cell - zero) * scale * unit; zero is in the file's own unit. `skip = ["gripper"]` leaves columns out on purpose.
"""

import re
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from fishmj.base.errors import LogError, closest_name
from fishmj.log import toml
from fishmj.log.importers.column_units import PARTS, SI, UNITS, measures, unit_of
from fishmj.log.importers.sheet import DATE
from fishmj.log.limits import bare, quoted, regular
from fishmj.log.trial import TABLES, YEAR, TableSpec, table_spec

Finite = Annotated[float, Field(allow_inf_nan=False, strict=True)]
_KINDS = {"angle": "angle", "heading": "angle", "rate": "rate", "position": "length", "speed": "speed"}
_NAMED = {"V": "voltage", "I": "current", "frequency": "frequency", "t_rx": "time", "temp#": "temperature"}
_NAMED |= {"ax": "acceleration", "ay": "acceleration", "az": "acceleration"}


def measured(table: str, column: str) -> str:
    """Quantity that a column of ours measures, in the words of the unit table; "" for numbers without a unit."""
    spec = table_spec(table)
    return _KINDS.get(spec.kind(column), "") or _NAMED.get(column.rstrip("0123456789") + "#", "") or _NAMED.get(column, "")


def is_column(spec: TableSpec, column: str) -> bool:
    """Returns True if a table has such a column, other than its stamps."""
    template = re.sub(r"[1-9]\d{0,2}", "#", column)
    return column != "t" and (
        column in (*spec.fixed, *spec.optional) or template in (*spec.numbered, *(o for o in spec.optional if "#" in o))
    )


HEAD = (
    "# Which column of the files is which of fishmj.log/1, in what unit (docs/search/logs.md). Read it, mend it, and "
    "import with it.\n"
)


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


def _known_unit(text: Any) -> str:
    if not isinstance(text, str) or (text and text != DATE and not unit_of(text)):
        raise ValueError(f"unit {quoted(text)} is not known; known: {', '.join(u for u in UNITS)}")
    return DATE if text == DATE else unit_of(text)


Unit = Annotated[str, BeforeValidator(_known_unit)]


class Column(_Strict):
    """One column of ours: a named column of the file, or a constant in SI units."""

    column: str | None = None
    constant: Finite | None = None
    unit: Unit = ""
    sign: Literal[-1, 1] = 1
    zero: Finite = 0.0  # in the file's unit: the cell that means 0
    scale: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 1.0  # m a pixel, rad a count

    @model_validator(mode="before")
    @classmethod
    def _short(cls, value: Any) -> Any:
        if isinstance(value, str):
            return {"column": value}
        return {"constant": value} if isinstance(value, int | float) and not isinstance(value, bool) else value

    @model_validator(mode="after")
    def _one(self) -> "Column":
        if (self.column is None) == (self.constant is None):
            raise ValueError('expected column = "a name in the file", or constant = a number')
        if self.unit == "px" and self.scale == 1.0:
            raise ValueError("px needs scale, the metres of a pixel, for example scale = 0.0012")
        if self.unit and self.unit != DATE and not UNITS[self.unit][1] > 0 and self.unit != "px":
            raise ValueError(f"{self.unit} has no place in the log's schema")
        return self

    @property
    def factor(self) -> float:
        """Factor to SI, sign included."""
        unit = 1.0 if self.unit in ("", "px", DATE) else UNITS[self.unit][1]
        return self.sign * self.scale * unit


class Stamp(_Strict):
    """The time stamps of a table."""

    column: str
    unit: Unit = ""
    scale: Annotated[float, Field(gt=0, allow_inf_nan=False)] = 1.0  # s a frame
    nanoseconds: str | None = None  # a second column that is added, as ROS writes them
    microseconds: str | None = None  # the same, as a struct timeval has them
    milliseconds: str | None = None

    @model_validator(mode="before")
    @classmethod
    def _short(cls, value: Any) -> Any:
        return {"column": value} if isinstance(value, str) else value

    @model_validator(mode="after")
    def _time(self) -> "Stamp":
        if self.unit not in ("", DATE) and measures(self.unit) != "time":
            raise ValueError(f"unit {self.unit} is no unit of time; expected s, ms, us or ns")
        return self

    @property
    def factor(self) -> float:
        """Factor to seconds."""
        return self.scale * (1.0 if self.unit in ("", DATE) else UNITS[self.unit][1])

    @property
    def parts(self) -> dict[str, float]:
        """Columns that are added to the stamp, with the seconds of one count."""
        return {column: UNITS[unit][1] for unit, key in PARTS.items() if (column := getattr(self, key))}


class TableMap(_Strict):
    """One table: its stamps and columns, a pattern for its file if the columns are not unique, and its clock's offset."""

    t: Stamp
    columns: Annotated[dict[str, Column], Field(min_length=1)]
    file: str | None = None
    offset: Annotated[float, Field(ge=-YEAR, le=YEAR, allow_inf_nan=False, strict=True)] = 0.0  # s, added to its stamps


class ColumnMap(_Strict):
    """The whole of MAP.toml."""

    tables: Annotated[dict[str, TableMap], Field(min_length=1)]
    meta: dict[str, Any] = {}
    skip: list[str] = []

    @model_validator(mode="after")
    def _schema(self) -> "ColumnMap":
        for name, entry in self.tables.items():
            if name not in TABLES:
                raise ValueError(f"[tables.{bare(name)}]: no such table{_near(name, TABLES)}; known: {', '.join(TABLES)}")
            spec = table_spec(name)
            known = [*spec.fixed[1:], *(t.replace("#", "1") for t in (*spec.numbered, *spec.optional))]
            for column, source in entry.columns.items():
                if not is_column(spec, column):
                    raise ValueError(
                        f"[tables.{name}]: no column {quoted(column)}{_near(column, known)}; known: "
                        f"{', '.join(known)}, and 2, 3, .. of the numbered"
                    )
                what, got = measured(name, column), measures(source.unit)
                if source.unit and got != what:
                    raise ValueError(
                        f"[tables.{name}] {column}: {source.unit} measures {got or 'a date'}; expected "
                        f"{SI.get(what) or 'no unit'} or its kin"
                    )
        return self


def _near(name: str, known) -> str:
    near = closest_name(name, known)
    return f"; did you mean {near!r}?" if near else ""


def read_map(path: Path) -> ColumnMap:
    """Reads and checks a map. Raises LogError: one line with the block, the key, what is expected and the nearest known name."""
    raw = map_table(path)
    if not raw.get("tables"):
        raise LogError(
            f"{path}: no table; expected at least one block such as [tables.cmd], with t and columns. In a map that --write-map"
            " wrote, complete the commented lines and remove the # in front of them"
        )
    return of_dict(raw, str(path))


def map_table(path: Path) -> dict:
    """TOML of a map, not checked. Raises LogError: no regular file, over 1 MB, or not TOML."""
    if regular(path) > 1 << 20:
        raise LogError(f"{path}: a map of over 1 MB; expected a few dozen lines of TOML")
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError, OSError) as error:
        raise LogError(f"{path}: not valid TOML: {bare(error, 160)}") from error


def of_dict(raw: dict, where: str) -> ColumnMap:
    """Checks a map that is a dictionary already."""
    try:
        return ColumnMap.model_validate(raw)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        at = ".".join(bare(part) for part in first["loc"])
        if first["type"] == "extra_forbidden":
            models: dict[int, type[BaseModel]] = {1: ColumnMap, 3: TableMap, 4: Stamp}
            model = models.get(len(first["loc"]), Column)
            key, known = str(first["loc"][-1]), list(model.model_fields)
            raise LogError(f"{where}: {at}: unknown key{_near(key, known)}; known: {', '.join(known)}") from error
        said = first["msg"].removeprefix("Value error, ")
        got = f", got {quoted(first['input'])}" if isinstance(first["input"], str | int | float) else ""
        raise LogError(f"{where}: {at + ': ' if at else ''}{said}{got}") from error
    except RecursionError as error:
        raise LogError(f"{where}: nested too deeply; expected [meta] and [tables.<name>]") from error


def written(made: ColumnMap) -> str:
    """The map as TOML."""
    plain = made.model_dump(exclude_defaults=True)
    lines = [f"skip = {toml.inline(plain['skip'])}"] if plain.get("skip") else []
    lines += ["", toml.dumps({"meta": plain["meta"]}).rstrip()] if plain.get("meta") else []
    for name, entry in plain["tables"].items():
        lines += ["", f"[tables.{name}]"]
        lines += [f"file = {toml.inline(entry['file'])}"] if "file" in entry else []
        lines += [f"offset = {entry['offset']}"] if "offset" in entry else []
        lines += [f"t = {toml.inline(entry['t'])}", *(f"columns.{c} = {toml.inline(v)}" for c, v in entry["columns"].items())]
    return HEAD + "\n".join(lines) + "\n"
