"""Maps the topics of a message recording to tables, by a small TOML beside the recording, as in docs/search/logs.md.

A field is a path of keys and list indices with dots between. Only units that are stated here are converted. `skip = ["fish_id"]`
at the top reads messages as one robot's whatever this field says.
"""

from dataclasses import dataclass, field
from pathlib import Path

from fishmj.base.errors import LogError
from fishmj.log.importers import column_units
from fishmj.log.table_files import read_toml
from fishmj.log.trial import TABLES

RECEIPT = "log_time"
CLOCKS = (RECEIPT, "publish_time")
_KNOWN = "rad rad/s m m/s s V A Hz m/s^2 deg deg/s rpm g mm cm mm/s cm/s ms us ns mV mA".split()
UNITS = {"": 1.0} | {unit: column_units.UNITS[unit][1] for unit in _KNOWN}  # unit -> factor to the schema's


@dataclass(frozen=True)
class MessageField:
    """A path into a message and the factor to SI."""

    path: tuple[str, ...]
    unit: str = ""

    @property
    def factor(self) -> float:
        """Factor of the field's unit to SI."""
        return UNITS[self.unit]

    def __str__(self) -> str:
        return ".".join(self.path)


@dataclass(frozen=True)
class Topic:
    """One table: its topic, the clock of its stamps (`CLOCKS` or a field; "" for its own), its columns (None: all numbers)."""

    topic: str
    clock: str | MessageField = ""
    columns: dict[str, MessageField] | None = None


@dataclass(frozen=True)
class Topics:
    """The whole mapping, the meta data to write, and fields that are left out; `named`: by the topics' names alone."""

    tables: dict[str, Topic]
    meta: dict = field(default_factory=dict)
    skip: tuple[str, ...] = ()
    named: bool = False


def table_of(topic: str) -> str:
    """Name of the table that a topic is named like; "" for none."""
    name = topic.rsplit("/", 1)[-1]
    return name if name in TABLES else ""


def by_name(topics: set[str]) -> Topics:
    """Mapping without a TOML: a topic that ends in a table's name is that table, and its keys are the columns."""
    return Topics({name: Topic(topic) for topic in sorted(topics) if (name := table_of(topic))}, named=True)


def read_topics(path: str | Path) -> Topics:
    """Reads the TOML. Raises LogError: not TOML (line and column), or a key, table or unit that is not known (named)."""
    path = Path(path)
    spec = read_toml(path)
    unknown = sorted(set(spec) - {"tables", "meta", "skip"})
    tables, meta = spec.get("tables"), spec.get("meta", {})
    if unknown or not isinstance(tables, dict) or not tables or not isinstance(meta, dict):
        text = f"key {unknown[0]!r} is not known" if unknown else "no [tables.<name>]"
        raise LogError(f"{path}: {text}; expected skip, [meta] and one [tables.<name>] each for some of {', '.join(TABLES)}")
    skip = spec.get("skip", [])
    if not isinstance(skip, list) or not all(isinstance(name, str) for name in skip):
        raise LogError(f'{path}: skip = {str(skip)[:60]!r}; expected names of fields, such as ["fish_id"]')
    return Topics({name: _topic(path, name, entry) for name, entry in tables.items()}, meta, tuple(skip))


def _topic(path: Path, name: str, entry) -> Topic:
    where = f"{path}: [tables.{name}]"
    if name not in TABLES:
        raise LogError(f"{where}: no such table; known: {', '.join(TABLES)}")
    if not isinstance(entry, dict) or not isinstance(entry.get("topic"), str):
        raise LogError(f'{where}: topic is missing; write topic = "/name/of/the/topic"')
    if extra := sorted(set(entry) - {"topic", "t", "columns"}):
        raise LogError(f"{where}: key {extra[0]!r} is not known; expected topic, t, columns")
    columns = entry.get("columns")
    clock = entry.get("t", "" if columns is None else RECEIPT)
    if columns is not None and (not isinstance(columns, dict) or not columns or "t" in columns):
        raise LogError(f'{where}: columns must be a table such as {{ x = "pose.x" }}; the stamp goes into t')
    return Topic(
        entry["topic"],
        clock if "t" not in entry or clock in CLOCKS else _field(where, "t", clock),
        None if columns is None else {column: _field(where, column, value) for column, value in columns.items()},
    )


def _field(where: str, key: str, value) -> MessageField:
    value = {"field": value} if isinstance(value, str) else value
    if not isinstance(value, dict) or not isinstance(value.get("field"), str) or not value["field"]:
        raise LogError(f'{where}: {key} = {str(value)[:60]!r}; expected "a.field" or {{ field = "a.field", unit = "deg" }}')
    unit = value.get("unit", "")
    if not isinstance(unit, str) or unit not in UNITS:
        raise LogError(f"{where}: {key}: unit {str(unit)[:20]!r} is not known; expected one of {', '.join(_KNOWN)}")
    return MessageField(tuple(value["field"].split(".")), unit)
