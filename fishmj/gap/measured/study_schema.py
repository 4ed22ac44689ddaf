"""Schema of a study, `fishmj.study/1`: every block and key with its unit and its bounds.

    read_study("my.toml")     the file, checked: one ConfigError that lists the errors, a line for each
    variants(study)           {name: the same study with the keys of one [[variant]] in place of its own}

Nothing of a study is ever run: names of files are matched letter by letter, columns and effects are looked up by name.
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
FOLDS = 50  # most groups that are left out one by one
ANY = "any"  # of a column: any unit, or none


class ColumnRule(NamedTuple):
    """A column of ours: its quantity ("" no unit, ANY), True if a study needs it, its meaning."""

    kind: str
    needed: bool
    about: str


COLUMNS: dict[str, dict[str, ColumnRule]] = {
    "body": {
        "x": ColumnRule("length", True, "position in a frame that does not move"),
        "y": ColumnRule("length", True, "position, 90 degrees counter-clockwise from x"),
        "yaw": ColumnRule("angle", True, "heading, counter-clockwise from x; it may wrap"),
        "amplitude": ColumnRule(ANY, False, "what drives ahead; see baseline.drive"),
        "bias": ColumnRule(ANY, False, "what turns; see baseline.drive"),
    },
    "servo": {
        "goal": ColumnRule("angle", True, "angle that was commanded"),
        "angle": ColumnRule("angle", True, "angle that was measured, 0 where the load hangs"),
        "rate": ColumnRule("rate", False, "its rate at the start; without it a record begins at rest"),
        "duty": ColumnRule("", False, "duty cycle that the firmware set, -1 to 1; it tells the gain"),
        "on": ColumnRule("", False, "1 while the torque is on"),
        "volts": ColumnRule("voltage", False, "supply"),
    },
    "coast": {"speed": ColumnRule("speed", True, "speed over ground, ahead; the propulsion is off")},
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
    """Field for a value that is neither number nor text: meaning and expected value."""
    return Field(default, description=what, json_schema_extra={"unit": "", "expected": expected})


Words = Annotated[list[Text], Field(max_length=64)]
Positive = Annotated[float, Field(gt=0.0, le=1e6, allow_inf_nan=False)]
Size = Annotated[float, Field(ge=0.0, le=1e9, allow_inf_nan=False)]


class DataBlock(TomlTable):
    """Place of the records."""

    folder: str | None = text("beside this file: tables of your own with [columns], or trial folders", default=None, most=1000)
    set: str | None = text("a published set in the folder that FISHMJ_MEASURED names", default=None, most=64)
    files: str = text("pattern of the files' names", default="*.csv", most=200, least=1)
    names: str = text("what a file's name tells, such as {day}_{setting}_{run}", most=200)


class GroupsBlock(TomlTable):
    """Grouping of the records."""

    by: Annotated[Words, Field(min_length=1, max_length=6)] = listed(
        "records that agree in all of these are a group", "1 to 6 names"
    )


class HeldOutBlock(TomlTable):
    """Records outside every fit."""

    aside: int = whole("groups drawn by the seed for the last figure only", 0, 1000, default=0)
    where: dict[str, str | float | int] = listed("records kept aside instead", 'a table such as { trajectory = "sine" }', {})
    folds: int = whole("0: one group left out at a time; else so many parts of the groups", 0, FOLDS, default=0)


class NoiseBlock(TomlTable):
    """One standard deviation of a reading, which no model explains."""

    position: float = number("body", 0.0, 1e3, "m", default=0.0)
    heading: float = number("body", 0.0, 3.2, "rad", default=0.0)
    angle: float = number("servo", 0.0, 3.2, "rad", default=0.0)
    resolution: float = number("servo: one count of the encoder", 0.0, 3.2, "rad", default=0.0)
    speed: float = number("coast", 0.0, 1e3, "m/s", default=0.0)
    replicates: bool = flag("body: also what runs of one group that start alike differ by")
    near: float = number("how alike, in units of the error's scale", 0.0, 100.0, above=True, default=0.5)


class PredictionBlock(TomlTable):
    """Predicted quantity, and the start of each prediction."""

    horizon: float = number("length of a free run; 0: the whole record", 0.0, 3600.0, "s", default=0.0)
    average: float | None = number("body: the moving average that gives each start and end", 0.0, 600.0, "s", default=None)
    step: float | None = number("body: rows are made even at this step", 1e-3, 10.0, "s", default=None)
    scale: Annotated[list[Positive], Field(min_length=3, max_length=3)] | None = listed(
        "body: unit of error", "[m, m, rad], each above 0", None
    )
    as_logged: bool = flag("body: rows as they are, averaged; servo: the model's step of 2 ms")
    clock: bool = flag("published sets: stamps corrected by the trial's clock_ratio")
    pictures: bool = flag("with clock: runs and averages of the same rows as without")


class BaselineBlock(TomlTable):
    """The model before anything is added."""

    fitted: Annotated[Words, Field(min_length=1)] = listed(
        "nominal sizes that every fit adapts, from a tenth to ten times", "one or more names of [nominal]"
    )
    drive: Literal["tail", "linear", "propeller", "twin"] = listed(
        "body: what the two commands do", ", ".join(map(repr, DRIVES)), "linear"
    )


class CandidatesBlock(TomlTable):
    """Candidate terms; missing keys take the plant's own list."""

    only: Words | None = listed("these in place of the plant's list", "names of effects or rivals", None)
    leave_out: Words = listed("not these", "names of effects or rivals", [])
    rivals: bool = flag("terms outside the catalogue beside it, which a name has to beat", True)


class SearchBlock(TomlTable):
    """Settings of the search."""

    rounds: int = whole("terms to add at most", 1, 4, default=2)
    ahead: int = whole("candidates that are refitted in a fold", 2, 60, default=8)
    seed: int = whole("of what is drawn", 0, 2**53 - 1, default=0)


class StudyFile(TomlTable):
    """The whole file."""

    schema_: Literal["fishmj.study/1"] = Field(alias="schema", json_schema_extra={"expected": repr(SCHEMA)})
    name: Name = name("on pages and in JSON")
    about: Text = text("one line", most=500)
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
    """A study from its file. stamp, columns: of the user's tables; folder: of the file; table: parsed TOML."""

    given: StudyFile
    where: str
    folder: Path
    table: dict[str, Any]
    stamp: column_map.Stamp | None
    columns: dict[str, column_map.Column]


def read_study(path: str | Path, changes: Mapping[str, Any] | None = None) -> StudyInput:
    """A study from a file.

    Args:
        changes: keys in place of the file's own, by block.
    Raises:
        ConfigError: no such file, not TOML, or not a study; every error has a line with block, key, got and expected.
    """
    return checked(merged(read_toml(path), changes or {}), shown_path(path), Path(path).resolve().parent)


def merged(table: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """The table with the changes in it; tables within are merged, anything else is replaced."""
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
            raise ConfigError(f"{where}: got name = {shown(label)}, expected printable text of its own; say what is different")
        rest = {key: value for key, value in given.items() if key != "name"}
        table = merged({key: value for key, value in study.table.items() if key != "variant"}, rest)
        found[label] = checked(table, where, study.folder)
    return found


def checked(table: dict[str, Any], where: str, folder: Path) -> StudyInput:
    """The table as a study. Raises ConfigError: lists the errors, a line for each."""
    try:
        given = StudyFile.model_validate(table)
    except ValidationError as error:
        raise DescriptionError(_lines(error, where)) from None
    except RecursionError:
        raise ConfigError(f"{where}: nested too deeply; expected blocks of numbers and names") from None
    lines = [f"{where} {line}" for line in _relations(given)]
    stamp, columns, told = _columns(given)
    lines += [f"{where} [columns] {line}" for line in told]
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
    """The field of a place, and the possible keys there."""
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
    """Errors between keys."""
    out = []
    if (s.data.folder is None) == (s.data.set is None):
        out.append("[data]: got both or none of folder and set, expected one; folder = your tables, set = a published set")
    if s.data.set is not None and not nearest(s.data.set) == s.data.set:
        out.append(f"[data] set: got {shown(s.data.set)}, expected a name; fishmj gap fetch lists them")
    unknown = [k for k in s.nominal if k not in NOMINAL[s.plant]]
    out += [f"[nominal] {shown(k)[1:-1]}: unknown key, expected {', '.join(NOMINAL[s.plant])}" for k in unknown]
    lacking = [k for k in NEEDED[s.plant] if k not in s.nominal]
    out += [f"[nominal] {k}: got nothing, expected a number, SI; a {s.plant} needs it, a guess is enough" for k in lacking]
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
            out.append(f"[baseline] fitted: got {k}, whose nominal is 0, expected a guess above 0; a fit multiplies it")
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
        out.append(f"[noise]: got none of {', '.join(noise)}, expected one above 0; without it nothing says what agreement is")
    if s.noise.replicates and s.plant != "body":
        out.append(f"[noise] replicates: got true for a {s.plant}, expected it of a body alone")
    names = {e.name for e in offered(s.plant)}
    for key, given in (("only", s.candidates.only or []), ("leave_out", s.candidates.leave_out)):
        for n in given:
            if n not in names:
                out.append(f"[candidates] {key}: got {shown(n)}{_near(n, sorted(names))}, expected of {', '.join(sorted(names))}")
    return out


def offered(plant: str) -> list[effects.Effect]:
    """Every term that applies to a plant, rivals too."""
    if plant == "coast":
        return [*map(effects.get, COASTING), *COAST_RIVALS]
    return [*planar_body.acting(), *RIVALS] if plant == "body" else servo_model.acting()


COASTING = ("linear_surge_drag", "steady_current")


def _columns(s: StudyFile) -> tuple[column_map.Stamp | None, dict[str, column_map.Column], list[str]]:
    """Maps the columns of the user's tables to ours."""
    rules, lines = COLUMNS[s.plant], []
    stamp: column_map.Stamp | None = None
    columns: dict[str, column_map.Column] = {}
    if not s.columns:
        return None, {}, []
    if s.data.set is not None:
        return None, {}, ["got columns for a published set, expected none; its reader knows them"]
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
        return [f"got {c.unit}, which measures {got}, expected {SI.get(rule.kind) or 'no unit'} or its kin"]
    return []
