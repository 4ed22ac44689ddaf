"""Schema of a study, `fishmj.study/1`: all blocks and keys with units and bounds.

    read_study("my.toml")     reads and checks a file; one ConfigError lists the errors, one per line
    variants(study)           {name: the study with the keys of one [[variant]] replaced}

A study executes no code: file names are matched literally, columns and effects are looked up by name.
"""

from collections.abc import Mapping
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, NamedTuple, get_args, get_origin

from pydantic import BaseModel, Field, ValidationError
from pydantic.fields import FieldInfo

from fishmj import effects
from fishmj.base.calib import read_toml, shown_path
from fishmj.base.errors import ConfigError, DescriptionError, LogError, closest_name
from fishmj.base.names import nearest
from fishmj.gap.measured import planar_body, servo_model
from fishmj.gap.measured.decoy_terms import COAST_RIVALS, RIVALS
from fishmj.gap.measured.planar_body import DRIVES, Hull
from fishmj.gap.measured.servo_model import ServoMotor
from fishmj.log.importers import column_map
from fishmj.log.importers.column_units import SI, UNITS, measures
from fishmj.mjcf.description_schema import Name, Text, TomlTable, name, number, shown, text, whole

SCHEMA = "fishmj.study/1"
PLANTS = ("body", "servo", "coast")
FOLDS = 50  # most groups for leave-one-out
ANY = "any"  # of a column: any unit, or none


class ColumnRule(NamedTuple):
    """Column of a study. kind: quantity ("" no unit, or ANY); needed: True if required; about: meaning."""

    kind: str
    needed: bool
    about: str


COLUMNS: dict[str, dict[str, ColumnRule]] = {
    "body": {
        "x": ColumnRule("length", True, "position in a frame that does not move"),
        "y": ColumnRule("length", True, "position, 90 degrees counter-clockwise from x"),
        "yaw": ColumnRule("angle", True, "heading, counter-clockwise from x; it may wrap"),
        "amplitude": ColumnRule(ANY, False, "forward command; see baseline.drive"),
        "bias": ColumnRule(ANY, False, "turning command; see baseline.drive"),
    },
    "servo": {
        "goal": ColumnRule("angle", True, "commanded angle"),
        "angle": ColumnRule("angle", True, "measured angle, 0 where the load hangs"),
        "rate": ColumnRule("rate", False, "its rate, for initial rates; without it a record begins at rest"),
        "duty": ColumnRule("", False, "duty cycle set by the firmware, -1 to 1; determines the gain"),
        "on": ColumnRule("", False, "1 while the torque is on"),
        "volts": ColumnRule("voltage", False, "supply"),
    },
    "coast": {"speed": ColumnRule("speed", True, "forward speed over ground, propulsion off")},
}
NOMINAL: dict[str, tuple[str, ...]] = {
    "body": Hull._fields,
    "servo": (*ServoMotor._fields, "mass", "length", "voltage", "gain", "duty"),
    "coast": ("mass", "surge_added", "drag"),
}
NEEDED: dict[str, tuple[str, ...]] = {
    "body": ("mass", "inertia"),
    "servo": (*ServoMotor._fields, "mass", "length", "voltage"),
    "coast": ("mass", "drag"),
}
FITTED: dict[str, tuple[str, ...]] = {"body": Hull._fields[2:], "servo": ServoMotor._fields, "coast": ("drag",)}


def flag(what: str, default: bool = False) -> Any:
    """Field for true or false."""
    return Field(default, description=what, json_schema_extra={"unit": "", "expected": "true or false"})


def listed(what: str, expected: str, default: Any = ()) -> Any:
    """Field for a value other than a number or text: meaning and expected value."""
    return Field(default, description=what, json_schema_extra={"unit": "", "expected": expected})


Words = Annotated[list[Text], Field(max_length=64)]
Positive = Annotated[float, Field(gt=0.0, le=1e6, allow_inf_nan=False)]
Size = Annotated[float, Field(ge=0.0, le=1e9, allow_inf_nan=False)]


class DataBlock(TomlTable):
    """Place of the records."""

    folder: str | None = text("path relative to this file: your tables with [columns], or trial folders", default=None, most=1000)
    set: str | None = text("published set in the folder FISHMJ_MEASURED", default=None, most=64)
    files: str = text("pattern of file names", default="*.csv", most=200, least=1)
    names: str = text("values in a file's name, such as {day}_{setting}_{run}", most=200)


class GroupsBlock(TomlTable):
    """Grouping of the records."""

    by: Annotated[Words, Field(min_length=1, max_length=6)] = listed(
        "records that agree in all of these form a group", "1 to 6 names"
    )


class HeldOutBlock(TomlTable):
    """Records outside every fit."""

    aside: int = whole("number of random groups for the last figure only", 0, 1000, default=0)
    where: dict[str, str | float | int] = listed("records kept aside instead", 'a table such as { trajectory = "sine" }', {})
    folds: int = whole("number of folds; 0: leave one group out at a time", 0, FOLDS, default=0)


class NoiseBlock(TomlTable):
    """Standard deviation of a reading."""

    position: float = number("body", 0.0, 1e3, "m", default=0.0)
    heading: float = number("body", 0.0, 3.2, "rad", default=0.0)
    angle: float = number("servo", 0.0, 3.2, "rad", default=0.0)
    resolution: float = number("servo: one count of the encoder", 0.0, 3.2, "rad", default=0.0)
    speed: float = number("coast", 0.0, 1e3, "m/s", default=0.0)
    replicates: bool = flag("body: also the scatter of similar runs within a group")
    near: float = number("largest difference of similar starts, in error scales", 0.0, 100.0, above=True, default=0.5)


class PredictionBlock(TomlTable):
    """Predicted quantity, and the start of each prediction."""

    horizon: float = number("length of a free run; 0: the whole record", 0.0, 3600.0, "s", default=0.0)
    average: float | None = number("body: averaging time of each start and end", 0.0, 600.0, "s", default=None)
    step: float | None = number("body: step to which rows are resampled", 1e-3, 10.0, "s", default=None)
    scale: Annotated[list[Positive], Field(min_length=3, max_length=3)] | None = listed(
        "body: error scale", "[m, m, rad], each above 0", None
    )
    as_logged: bool = flag("body: average rows without resampling; servo: model step of 2 ms")
    clock: bool = flag("published sets: correct stamps by the trial's clock_ratio")
    pictures: bool = flag("with clock: take runs and averages from the same rows as without")


class BaselineBlock(TomlTable):
    """Model before effects are added."""

    fitted: Annotated[Words, Field(min_length=1)] = listed(
        "nominal values that every fit adapts, by a factor of 0.1 to 10", "one or more names of [nominal]"
    )
    drive: Literal["tail", "linear", "propeller", "twin"] = listed(
        "body: meaning of the two commands", ", ".join(map(repr, DRIVES)), "linear"
    )


class CandidatesBlock(TomlTable):
    """Candidate terms; missing keys take the plant's own list."""

    only: Words | None = listed("candidates in place of the plant's list", "names of effects or rivals", None)
    leave_out: Words = listed("excluded candidates", "names of effects or rivals", [])
    rivals: bool = flag("add terms outside the catalogue, which a named effect must beat", True)


class SearchBlock(TomlTable):
    """Settings of the search."""

    rounds: int = whole("most terms to add", 1, 4, default=2)
    ahead: int = whole("candidates that each fold refits", 2, 60, default=8)
    seed: int = whole("seed of random choices", 0, 2**53 - 1, default=0)


class StudyFile(TomlTable):
    """The whole file."""

    schema_: Literal["fishmj.study/1"] = Field(alias="schema", json_schema_extra={"expected": repr(SCHEMA)})
    name: Name = name("name on pages and in JSON")
    about: Text = text("description, one line", most=500)
    origin: Literal["measured", "synthetic"] = Field("measured", json_schema_extra={"expected": "'measured' or 'synthetic'"})
    plant: Literal["body", "servo", "coast"] = Field(json_schema_extra={"expected": "'body', 'servo' or 'coast'"})
    data: DataBlock = Field(json_schema_extra={"expected": "a block [data]"})
    columns: dict[str, Any] = Field({}, json_schema_extra={"expected": "a block [columns]"})
    groups: GroupsBlock = Field(json_schema_extra={"expected": "a block [groups]"})
    held_out: HeldOutBlock = HeldOutBlock()
    noise: NoiseBlock = Field(json_schema_extra={"expected": "a block [noise]"})
    prediction: PredictionBlock = PredictionBlock()
    baseline: BaselineBlock = Field(json_schema_extra={"expected": "a block [baseline]"})
    nominal: dict[str, Size] = Field(json_schema_extra={"expected": "a block [nominal] of numbers from 0 to 1e9, SI"})
    candidates: CandidatesBlock = CandidatesBlock()
    search: SearchBlock = SearchBlock()
    variant: Annotated[list[dict[str, Any]], Field(max_length=16)] = Field(
        [], json_schema_extra={"expected": "at most 16 blocks [[variant]]"}
    )


class StudyInput(NamedTuple):
    """Study as read from a file. stamp, columns: of the user's tables; folder: of the file; table: parsed TOML."""

    given: StudyFile
    where: str
    folder: Path
    table: dict[str, Any]
    stamp: column_map.Stamp | None
    columns: dict[str, column_map.Column]


def read_study(path: str | Path, changes: Mapping[str, Any] | None = None) -> StudyInput:
    """Reads a study.

    Args:
        changes: keys that replace those of the file, by block.
    Raises:
        ConfigError: no such file, not TOML, or not a study; every error has a line with block, key, got and expected.
    """
    return checked(merged(read_toml(path), changes or {}), shown_path(path), Path(path).resolve().parent)


def merged(table: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Merges the changes into a table; nested tables are merged, other values replaced."""
    out = dict(table)
    for key, value in changes.items():
        both = isinstance(value, Mapping) and isinstance(out.get(key), Mapping)
        out[key] = merged(out[key], value) if both else value
    return out


def variants(study: StudyInput) -> dict[str, StudyInput]:
    """{name: the study with the keys of one [[variant]]}."""
    found = {}
    for i, given in enumerate(study.given.variant):
        label, where = given.get("name"), f"{study.where} [[variant]] {i + 1}"
        if not isinstance(label, str) or not label.isprintable() or not 0 < len(label) <= 200 or label in found:
            raise ConfigError(f"{where}: got name = {shown(label)}, expected unique printable text; describe the difference")
        rest = {key: value for key, value in given.items() if key != "name"}
        table = merged({key: value for key, value in study.table.items() if key != "variant"}, rest)
        found[label] = checked(table, where, study.folder)
    return found


def checked(table: dict[str, Any], where: str, folder: Path) -> StudyInput:
    """Validates a table as a study. Raises ConfigError, which lists the errors, one per line."""
    try:
        given = StudyFile.model_validate(table)
    except ValidationError as error:
        raise DescriptionError(_lines(error, where)) from None
    except RecursionError:
        raise ConfigError(f"{where}: nested too deeply; expected blocks of numbers and names") from None
    lines = [f"{where} {line}" for line in _relations(given)]
    stamp, columns, faults = _columns(given)
    lines += [f"{where} [columns] {line}" for line in faults]
    if lines:
        raise DescriptionError(lines)
    return StudyInput(given, where, folder, table, stamp, columns)


def _lines(error: ValidationError, where: str) -> list[str]:
    """One line for each wrong key."""
    out: dict[tuple, str] = {}
    for entry in error.errors(include_url=False, include_context=False)[:100]:
        place = tuple(part for part in entry["loc"] if not (isinstance(part, str) and part in ("str", "float", "int")))
        keys = [part for part in place if isinstance(part, str)]
        block = f" [{keys[0]}]" if len(keys) > 1 or keys and keys[0] in BLOCKS else ""
        key = ".".join(shown(k)[1:-1] for k in (keys[1:] if block else keys))
        info, known = _field_at(keys)
        head = f"{where}{block}{' ' if key else ''}{key}"
        expected = (info.json_schema_extra or {}).get("expected") if info is not None else None  # type: ignore[union-attr]
        if entry["type"] == "extra_forbidden":
            line = f"{head}: unknown key{_near(keys[-1], known)}, expected {', '.join(known)}"
        elif entry["type"] == "missing":
            line = (
                f"{head}: got nothing, expected {expected or 'it'}; add it ({info.description or 'a study needs it'})"
                if info
                else head
            )
        else:
            line = f"{head}: got {shown(entry['input'])}, expected {expected or entry['msg']}"
        out.setdefault(place[:2], line)
    return list(out.values())


def _near(key: str, known: list[str]) -> str:
    near = closest_name(key, known)
    return f" (did you mean {near!r}?)" if near else ""


def _field_at(keys: list[str]) -> tuple[FieldInfo | None, list[str]]:
    """Field at a place, and the possible keys there."""
    model: Any = StudyFile
    info: FieldInfo | None = None
    known: list[str] = []
    for key in keys:
        if not (isinstance(model, type) and issubclass(model, BaseModel)):
            return info, known
        fields = {f.alias or k: f for k, f in model.model_fields.items()}
        info, known = fields.get(key), list(fields)
        if info is None:
            return None, known
        kind = info.annotation
        if get_origin(kind) in (UnionType,):
            kind = next((k for k in get_args(kind) if isinstance(k, type) and issubclass(k, BaseModel)), kind)
        model = kind
    return info, known


BLOCKS = tuple(
    (f.alias or k)
    for k, f in StudyFile.model_fields.items()
    if isinstance(f.annotation, type) and issubclass(f.annotation, BaseModel) or k in ("columns", "nominal")
)


def _relations(s: StudyFile) -> list[str]:
    """Errors in the combination of keys."""
    out = []
    if (s.data.folder is None) == (s.data.set is None):
        out.append("[data]: got both or none of folder and set, expected one; folder = your tables, set = a published set")
    if s.data.set is not None and not nearest(s.data.set) == s.data.set:
        out.append(f"[data] set: got {shown(s.data.set)}, expected a name; fishmj gap fetch lists them")
    unknown = [k for k in s.nominal if k not in NOMINAL[s.plant]]
    out += [f"[nominal] {shown(k)[1:-1]}: unknown key, expected {', '.join(NOMINAL[s.plant])}" for k in unknown]
    lacking = [k for k in NEEDED[s.plant] if k not in s.nominal]
    out += [f"[nominal] {k}: got nothing, expected a number, SI; a {s.plant} needs it; an estimate is enough" for k in lacking]
    heavy = {"body": ("mass", "inertia"), "coast": ("mass",), "servo": ("voltage",)}[s.plant]
    out += [f"[nominal] {k}: got 0, expected a number above 0" for k in heavy if s.nominal.get(k) == 0.0]
    if (
        s.plant == "servo"
        and s.nominal.get("mass", 0.0) * s.nominal.get("length", 0.0) ** 2 + s.nominal.get("armature", 0.0) <= 0
    ):
        out.append("[nominal]: got no inertia (mass length^2 + armature = 0), expected more than 0 kg m2")
    for k in s.baseline.fitted:
        if k not in FITTED[s.plant]:
            out.append(f"[baseline] fitted: got {shown(k)}, expected of {', '.join(FITTED[s.plant])}")
        elif not s.nominal.get(k):
            out.append(f"[baseline] fitted: got {k}, whose nominal is 0, expected an estimate above 0; a fit multiplies it")
    if len(set(s.baseline.fitted)) < len(s.baseline.fitted):
        out.append("[baseline] fitted: got a name twice, expected each once")
    if s.plant == "body" and not s.prediction.horizon >= 0.2:
        out.append("[prediction] horizon: got none or less than 0.2 s, expected the length of a free run of the body")
    if s.plant == "servo" and 0.0 < s.prediction.horizon < 0.1:
        out.append("[prediction] horizon: got less than 0.1 s, expected 0 (the whole record) or a run of 0.1 s or more")
    if s.prediction.pictures and not s.prediction.clock:
        out.append("[prediction] pictures: got true without clock = true, expected both")
    noise = {"body": ("position", "heading"), "servo": ("angle", "resolution"), "coast": ("speed",)}[s.plant]
    if not any(getattr(s.noise, k) for k in noise) and not s.noise.replicates:
        out.append(f"[noise]: got none of {', '.join(noise)}, expected one above 0; it defines agreement")
    if s.noise.replicates and s.plant != "body":
        out.append(f"[noise] replicates: got true for a {s.plant}, expected true for a body only")
    names = {e.name for e in offered(s.plant)}
    for key, given in (("only", s.candidates.only or []), ("leave_out", s.candidates.leave_out)):
        for n in given:
            if n not in names:
                out.append(f"[candidates] {key}: got {shown(n)}{_near(n, sorted(names))}, expected of {', '.join(sorted(names))}")
    return out


def offered(plant: str) -> list[effects.Effect]:
    """All terms that apply to a plant, rivals included."""
    if plant == "coast":
        return [*map(effects.get, COASTING), *COAST_RIVALS]
    return [*planar_body.acting(), *RIVALS] if plant == "body" else servo_model.acting()


COASTING = ("linear_surge_drag", "steady_current")


def _columns(s: StudyFile) -> tuple[column_map.Stamp | None, dict[str, column_map.Column], list[str]]:
    """Maps the columns of the user's tables to those of a study."""
    rules, lines = COLUMNS[s.plant], []
    stamp: column_map.Stamp | None = None
    columns: dict[str, column_map.Column] = {}
    if not s.columns:
        return None, {}, []
    if s.data.set is not None:
        return None, {}, ["got columns for a published set, expected none; its reader defines them"]
    for key, given in s.columns.items():
        if key != "t" and key not in rules:
            lines.append(f"{shown(key)[1:-1]}: unknown column{_near(key, ['t', *rules])}, expected t, {', '.join(rules)}")
            continue
        try:
            if key == "t":
                stamp = column_map.Stamp.model_validate(given)
                lines += [] if stamp.unit else ["t: got no unit, expected s, ms, us, ns, min or date"]
            else:
                columns[key] = column_map.Column.model_validate(given)
                lines += [f"{key}: {fault}" for fault in _unit_faults(columns[key], rules[key])]
        except (ValidationError, LogError) as error:
            first = error.errors(include_url=False)[0]["msg"] if isinstance(error, ValidationError) else str(error)
            lines.append(
                f"{key}: got {shown(given)}, expected a column with its unit: {first.removeprefix('Value error, ')[:200]}"
            )
    for key in ["t", *(k for k, rule in rules.items() if rule.needed)]:
        if key not in s.columns:
            about = "time of each row" if key == "t" else rules[key].about
            lines.append(f'{key}: got nothing, expected {key} = {{ column = "...", unit = "..." }} ({about})')
    return stamp, columns, lines


def _unit_faults(c: column_map.Column, rule: ColumnRule) -> list[str]:
    if c.constant is not None or rule.kind == ANY:
        return []
    if rule.kind and not c.unit:
        allowed = ", ".join(u for u, (what, factor) in UNITS.items() if what == rule.kind and factor > 0)
        return [f"got no unit, expected one of {allowed}"]
    if (got := measures(c.unit)) != rule.kind:
        return [f"got {c.unit}, which measures {got}, expected {SI.get(rule.kind) or 'no unit'} or a multiple"]
    return []
