"""What stands in the TOML of a fitted water: `HydroModel.save` writes it, and what `--water FILE` names is held against it."""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fishmj import names
from fishmj.errors import DescriptionError
from fishmj.mjcf.description_schema import shown

Number = Annotated[float, Field(allow_inf_nan=False)]
Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
FileName = Annotated[str, Field(pattern=rf"^{names.PATTERN}$")]
Band = dict[str, Annotated[list[Number], Field(min_length=3, max_length=3)]]


class _Table(BaseModel):
    model_config = ConfigDict(extra="allow", strict=True)


class Weights(_Table):
    """The file beside it."""

    file: FileName
    sha256: Digest
    residual: bool


class Base(_Table):
    """Coefficients of the strip model; `strip_forces.Coefficients` names them."""

    model_config = ConfigDict(extra="forbid", strict=True)

    k: Annotated[list[Number], Field(min_length=2)]
    cn: Annotated[list[Number], Field(min_length=2)]
    cf: Number
    ca_forward: Number
    ca_backward: Number
    ke: Number
    lift_a: Number
    lift_b: Number
    stall_angle: Number
    stall_width: Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
    stall_lag: Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
    suction: Annotated[float, Field(ge=0.0, le=1.0)] = 1.0


class CoefficientRow(_Table):
    """What the data say about one coefficient."""

    value: float
    status: str


class Stage(_Table):
    """One stage of the fit."""

    parameters: dict[str, CoefficientRow] = {}


class WaterFile(_Table):
    """The whole file."""

    schema_: Literal["fishmj.water/1"] = Field(alias="schema")
    name: FileName
    robot: str
    robot_sha256: Digest
    dt: Annotated[float, Field(gt=0.0, le=0.1)]
    slip: Annotated[float, Field(ge=0.0, le=1.0)]
    notes: str = ""
    weights: Weights
    base: Base
    found: dict[str, Stage] = {}
    dataset: dict[str, Any] = {}
    band: Band = {}
    band_alone: Band = {}
    scores: dict[str, Any] = {}
    calibration: dict[str, Any] = {}


def check(table: dict, where: str) -> None:
    """Hold a parsed TOML against the schema.

    Raises:
        DescriptionError: every key that does not fit, one line each.
    """
    try:
        WaterFile.model_validate(table)
    except ValidationError as error:
        lines = []
        for entry in error.errors(include_url=False, include_context=False):
            *block, key = [str(part) for part in entry["loc"]]
            place = f"[{'.'.join(block)}] {key}" if block else key
            expected = entry["msg"].removeprefix("Input should be ")
            got = "nothing" if entry["type"] == "missing" else shown(entry["input"])
            lines.append(f"{where} {place[:120]}: got {got}, expected {expected}; fit the model again")
        raise DescriptionError(lines) from error


__all__ = ["WaterFile", "check"]
