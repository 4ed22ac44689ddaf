"""Reads the output of `gap find --out`: every field is checked for its type before any use.

A report may come from an untrusted source: its paths are only read, its names must be in the catalogue, its numbers finite.
"""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from fishmj import effects
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.base.store import read_json
from fishmj.gap.models.robot_description import is_robot
from fishmj.gap.null.null_runs import LAST_SEED, LOUDEST, MOST_RUNS, RUNS
from fishmj.log.trial import look_up

Finite = Annotated[float, Field(allow_inf_nan=False)]
Text = Annotated[str, Field(max_length=4096)]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


def _known(name: str) -> str:
    """Checks the name of an effect of the catalogue."""
    try:
        return effects.get(name).name
    except UnknownName as error:
        raise ValueError(str(error)) from error


def _known_rival(name: str) -> str:
    """Checks the name of an effect, or of an equally likely error of a sensor itself."""
    from fishmj.gap.terms.library import sensor_terms

    return name if any(name == term.formula for term in sensor_terms()) else _known(name)


def _of_robot(name: str) -> str:
    """Checks the name of an effect at a site of a robot in MJCF."""
    if effects.kind_of(name) not in effects.robot_catalogue():
        raise ValueError(f"unknown effect {name[:40]!r} of a robot in MJCF")
    return name


Effect = Annotated[str, AfterValidator(_known)]
RobotKind = Annotated[str, AfterValidator(_of_robot)]
Rival = Annotated[str, AfterValidator(_known_rival)]


class _ReportTable(BaseModel):
    model_config = ConfigDict(strict=True, extra="ignore")


class _Value(_ReportTable):
    value: Finite
    low: Finite
    high: Finite


class _Named(_ReportTable):
    name: Effect
    parameters: dict[str, _Value]
    p_best: Finite = 1.0


Values = dict[Effect, dict[str, Annotated[list[Finite], Field(min_length=3, max_length=3)]]]  # [value, low, high]


class _Rival(_ReportTable):
    name: Rival
    p_best: Finite = 0.0
    values: Values | None = None


class _Explanation(_ReportTable):
    values: Values
    weight: Finite


class _Null(_ReportTable):
    model_config = ConfigDict(strict=True, extra="forbid")
    runs: Annotated[int, Field(ge=2, le=MOST_RUNS)] = RUNS
    noise: Annotated[float, Field(ge=0, le=LOUDEST, allow_inf_nan=False)] = 1.0
    seed: Annotated[int, Field(ge=0, le=LAST_SEED)] = 0
    folder: Text | None = None


class _Context(_ReportTable):
    model: Text
    model_sha256: Sha256
    data: Text
    data_sha256: Sha256
    judged: Annotated[list[Text], Field(min_length=1)]
    null: _Null
    water: Text = "structured"


class _Verdict(_ReportTable):
    answer: Literal["AGREES", "NAMED", "CLASS", "UNEXPLAINED", "NOT_REPEATABLE"]
    effects: list[_Named]
    rivals: list[_Rival] = []
    explanations: list[_Explanation] = []
    next_experiment: Text = ""
    context: _Context | None = None


class _Applied(_Verdict):
    gap_before: Finite
    gap_after: Finite


class _PointValue(_ReportTable):
    value: Finite


class _RobotEffect(_ReportTable):
    name: Text
    parameters: dict[str, _Value]
    same: dict[RobotKind, dict[Text, _PointValue]] = {}


class _RobotRival(_ReportTable):
    name: Text
    instead_of: Text = ""


class RobotContext(_ReportTable):
    """Inputs of the search of a robot in MJCF. judged: names of the logs outside every decision, or outside every fit."""

    model: Text
    model_sha256: Sha256
    data: Text = ""
    columns: Text = ""
    rest: dict[str, Finite] = {}
    data_sha256: Text = ""
    judged: list[Text] = []


class _RobotVerdict(_ReportTable):
    answer: Literal["AGREES", "NAMED", "CLASS", "UNEXPLAINED", "NOT_REPEATABLE"]
    effects: list[_RobotEffect]
    tentative: list[_RobotEffect] = []
    rivals: list[_RobotRival] = []
    by_effect: dict[str, Literal["NAMED", "CLASS"]] = {}
    context: RobotContext
    gap_before: Finite
    gap_after: Finite
    over_floor: dict[str, Annotated[list[Finite], Field(min_length=2, max_length=2)]] = {}


class _Version(_ReportTable):
    parent_text: Text
    parent_sha256: Sha256
    data_sha256: Text = ""
    judged: list[Text]
    null: _Null
    water: Text = "structured"
    judged_gap: Annotated[list[Finite], Field(min_length=2, max_length=2)]


def verdict_file(report: Path) -> Path:
    """The verdict.json of a report, which is that file or its folder."""
    return report / "verdict.json" if report.is_dir() else report


def verdict(report: Path, *, context: bool) -> dict[str, Any]:
    """The verdict from a report's folder or verdict.json. context: the search's inputs must be there, too.

    Raises StoreError: no such file, or not JSON; ConfigError: not written by gap find; names the field.
    """
    path = verdict_file(report)
    found = read_json(path)
    if of_robot(found):
        raise ConfigError(f"{path}: a report on a robot in MJCF; use fishmj gap apply, or see the experiment in report.html")
    told = _checked(_Applied if context else _Verdict, found, str(path), "fishmj gap find DATA --out FOLDER")
    if context and told.context is None:
        raise ConfigError(f"{path}: no verdict with its context; write it with: fishmj gap find DATA --out FOLDER")
    return {**found, **told.model_dump(exclude_none=True)}


def of_robot(found: object) -> bool:
    """Returns True for the contents of a report on a robot in MJCF."""
    return isinstance(found, dict) and is_robot(look_up(found, "context.model", ""))


def is_of_robot(report: Path) -> bool:
    """Returns True for a report's folder or verdict.json on a robot in MJCF."""
    path = verdict_file(report)
    return path.is_file() and path.suffix == ".json" and of_robot(read_json(path))


def robot_verdict(report: Path) -> dict[str, Any] | None:
    """The verdict on a robot in MJCF from a report's folder or verdict.json; None for a report on a fish.

    Raises StoreError: no such file, or not JSON; ConfigError: not written by gap find; names the field.
    """
    path = verdict_file(report)
    found = read_json(path)
    if not of_robot(found):
        return None
    writes = "fishmj gap find LOGS --model robot.xml --out FOLDER"
    return _checked(_RobotVerdict, found, str(path), writes).model_dump()


def version(facts: dict, model: Path) -> dict[str, Any]:
    """The table [version] of a model. Raises ConfigError if it was not written by gap apply."""
    return {**facts, **_checked(_Version, facts, f"{model} [version]", "fishmj gap apply REPORT").model_dump(exclude_none=True)}


def _checked(kind: type[BaseModel], found: object, where: str, writes: str) -> Any:
    try:
        return kind.model_validate(found)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
        place = ".".join(str(part)[:40] for part in first["loc"]) or "the whole"
        got = "" if first["type"] == "missing" else f", got {str(first['input'])[:60]!r}"
        raise ConfigError(
            f"{where}: {place}: {first['msg'][0].lower()}{first['msg'][1:]}{got}; write it with: {writes}"
        ) from error
