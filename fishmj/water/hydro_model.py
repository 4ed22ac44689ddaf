"""Fitted water: strip coefficients, the learnt residual with its range, and their provenance. TOML and safetensors.

    model = HydroModel.load("swift")            a shipped one, or a path to its .toml; "swift#2" is its member 2
    sw = model.swimmer(robot)                   the robot in this water
    model.learnt                                the residual, or None; `residual_hooks` adds it to a step
    model.base_only                             the strip model fitted without a residual, as a separate water

A model is a pair of files: `<name>.toml` has the readable numbers and the sha256 of `<name>.safetensors`, which has the weights.
Neither can run code.
"""

import hashlib
import os
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fishmj.base import calib, names
from fishmj.base.calib import read_toml
from fishmj.base.errors import ConfigError, DescriptionError, FishmjError, StoreError, UnknownName
from fishmj.base.names import checked
from fishmj.base.store import plain, read_tensors, sha256, write_tensors, write_text
from fishmj.log.toml import dumps
from fishmj.mjcf.description import Robot
from fishmj.mjcf.description_schema import shown
from fishmj.mjcf.identity import body_sha256
from fishmj.water import residual_hooks
from fishmj.water.choice import FAMILY_SCHEMA
from fishmj.water.dynamics import planar_chain, strip_forces
from fishmj.water.prior import flat, unflat

SCHEMA = "fishmj.water/1"
FULL = ", residual=1.0)"  # left out of hashes, so that files older than this coefficient keep theirs
UNITS = "SI: m, s, kg, N, N m, rad, W; coefficients without a unit"
FOLDERS = calib.WATERS


def robot_hash(robot: Robot) -> str:
    """sha256 of a robot's description without its water; a model stores the hash of its robot."""
    return hashlib.sha256(repr(replace(robot, water={"stations": robot.water.get("stations")})).encode()).hexdigest()


def shipped() -> list[str]:
    """Names of the fitted waters that come with fishmj."""
    return calib.waters()


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
    residual: Annotated[float, Field(ge=0.0, le=2.0)] = 1.0


class CoefficientRow(_Table):
    """Result of the fit for one coefficient."""

    value: float
    status: str


class FitStage(_Table):
    """One stage of the fit."""

    parameters: dict[str, CoefficientRow] = {}


class WaterFile(_Table):
    """The whole file."""

    schema_: Literal["fishmj.water/1"] = Field(alias="schema")
    name: FileName
    robot: str
    robot_sha256: Digest
    body_sha256: Digest | None = None
    dt: Annotated[float, Field(gt=0.0, le=0.1)]
    slip: Annotated[float, Field(ge=0.0, le=1.0)]
    notes: str = ""
    preview: bool = False
    weights: Weights
    base: Base
    found: dict[str, FitStage] = {}
    dataset: dict[str, Any] = {}
    band: Band = {}
    band_alone: Band = {}
    scores: dict[str, Any] = {}
    calibration: dict[str, Any] = {}


def check(table: dict, where: str) -> None:
    """Checks a parsed TOML against the schema. Raises DescriptionError: every key that does not fit, one line each."""
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


@dataclass(frozen=True, kw_only=True, eq=False)
class HydroModel:
    """One fitted water.

    Attributes:
        body_sha256: hash of the body; "" in an older file, which is valid for its robot only.
        base: coefficients of the strip model. members: (E, P) those of each ensemble member, flat, for error bars.
        alone: (1 + E, P) base and members of the strip model fitted without a residual.
        learnt: the residual, or None. robot, robot_sha256: robot of the fit. slip: slip ratio of the flow solver in the fit.
        dt: physics step of the fit, s. found: fit results of each coefficient, by stage. dataset: sha256 and seconds.
        band: (offset, share, spread) of the error bar by channel (prediction_interval.py); `band_alone`: without the residual.
        preview: fitted to an incomplete plan or in a coarse small box, so less accurate than a complete fit.
        scores: errors on the validation set. calibration: of the bands, on held-out swims (prediction_interval.py).
    """

    name: str
    robot: str
    robot_sha256: str
    dt: float
    slip: float
    base: strip_forces.Coefficients
    members: np.ndarray
    alone: np.ndarray
    learnt: "residual_hooks.Residual | None" = None
    found: dict = field(default_factory=dict)
    dataset: dict = field(default_factory=dict)
    band: dict = field(default_factory=dict)
    band_alone: dict = field(default_factory=dict)
    scores: dict = field(default_factory=dict)
    calibration: dict = field(default_factory=dict)
    notes: str = ""
    body_sha256: str = ""
    preview: bool = False

    @property
    def base_only(self) -> "HydroModel":
        """Strip model without a residual, with the coefficients fitted for it."""
        if self.learnt is None:
            return self
        water = unflat(self.alone[0].tolist())
        return replace(self, name=f"{self.name}-base", learnt=None, base=water, members=self.alone[1:], band=self.band_alone)

    @property
    def sha256(self) -> str:
        """Hex digest of coefficients and weights."""
        digest = hashlib.sha256(repr([self.base, self.dt]).replace(FULL, ")").encode())
        for key, value in sorted(({} if self.learnt is None else residual_hooks.packed(self.learnt)).items()):
            digest.update(key.encode() + np.ascontiguousarray(value, np.float32).tobytes())
        return digest.hexdigest()

    @property
    def calibrated(self) -> dict[str, float]:
        """Coefficients that the data identify; the others may be used, but their values mean little."""
        rows = {name: row for stage in self.found.values() for name, row in stage.get("parameters", {}).items()}
        return {name: row["value"] for name, row in rows.items() if row["status"] == "identified"}

    def fits_body(self, robot: Robot) -> bool:
        """True if the robot has the body of the fit."""
        return robot_hash(robot) == self.robot_sha256 or body_sha256(robot) == self.body_sha256

    def swimmer(self, robot: Robot) -> planar_chain.Swimmer:
        """Nominal robot in this water, which depends on the body, not on servos, masses or timing.

        Raises ConfigError: the model was fitted for another body or another time step.
        """
        if not self.fits_body(robot):
            raise ConfigError(
                f"water {self.name!r} was fitted for robot {self.robot!r} {(self.body_sha256 or self.robot_sha256)[:12]}, got"
                f" {robot.name!r} {body_sha256(robot)[:12]}: another body; fit it: fishmj hydro_fit --fish FILE"
            )
        if abs(robot.timing.physics_dt - self.dt) > 1e-9:
            raise ConfigError(
                f"water {self.name!r}: fitted at dt = {self.dt} s, the robot steps {robot.timing.physics_dt} s; take physics_dt ="
                f" {self.dt}, --water structured, or fit it: fishmj hydro_fit --fish FILE"
            )
        return planar_chain.nominal(robot)._replace(water=self.base)

    def remark(self, robot: Robot) -> str:
        """Caveat for this robot in this water; empty for the robot of the fit."""
        same = robot_hash(replace(robot, name=self.robot)) == self.robot_sha256
        other = "" if same else "; fitted to this body with other servos, masses or timing"
        return f"; a preview, not fitted to a whole plan{other}" if self.preview else other

    def save(self, folder: "str | Path") -> Path:
        """Writes `<name>.safetensors`, then `<name>.toml`, which names its sha256; each atomically. Returns the TOML's path."""
        folder, arrays = Path(folder), {"members": np.asarray(self.members, float), "alone": np.asarray(self.alone, float)}
        if self.learnt is not None:
            arrays |= {key: value.astype(np.float32) for key, value in residual_hooks.packed(self.learnt).items()}
        weights = write_tensors(folder / f"{self.name}.safetensors", arrays, {"schema": SCHEMA, "name": self.name})
        table: dict[str, Any] = {"schema": SCHEMA, "name": self.name, "units": UNITS, "notes": self.notes}
        table |= {"preview": True} if self.preview else {}
        table |= {"robot": self.robot, "robot_sha256": self.robot_sha256, "dt": self.dt, "slip": self.slip}
        table |= {"body_sha256": self.body_sha256} if self.body_sha256 else {}
        table |= {"weights": {"file": weights.name, "sha256": sha256(weights), "residual": self.learnt is not None}}
        table |= {"base": plain(self.base._asdict()), "calibrated": self.calibrated, "dataset": self.dataset}
        table |= {"band": self.band, "band_alone": self.band_alone, "scores": self.scores, "found": self.found}
        table |= {"calibration": self.calibration} if self.calibration else {}
        return write_text(folder / f"{self.name}.toml", dumps(_finite(plain(table))))

    @classmethod
    def load(cls, source: "str | Path") -> "HydroModel":
        """Reads a model by shipped name or path of its TOML; `NAME-base` is NAME without the residual, `NAME#2` its member 2.

        The path `FOLDER/NAME-base.toml` is `FOLDER/NAME.toml` without the residual, unless there is such a file.

        Raises:
            UnknownName: no such model. StoreError: damaged, or the two files do not belong together. ConfigError: not a model, or
            no such member.
        """
        whole, number = names.split_member(str(source))
        if number is not None:
            return member_of(cls.load(whole), number)
        path = Path(source)
        if path.suffix != ".toml":
            plain_name = str(source).removesuffix("-base")
            found = [folder / f"{plain_name}.toml" for folder in FOLDERS if (folder / f"{plain_name}.toml").is_file()]
            if not found:
                raise UnknownName("fitted water", str(source), shipped())
            model = cls.load(found[0])
            return model.base_only if str(source).endswith("-base") else model
        whole_file = str(path).replace("-base.toml", ".toml")
        alone = not os.path.exists(path) and os.path.isfile(whole_file)  # os.path, because it accepts text that is no valid path
        return _read(Path(whole_file)).base_only if alone else _read(path)


def member_of(model: HydroModel, number: "str | int") -> HydroModel:
    """Ensemble member as a separate water, with its strip coefficients and its residual, whose spread is zero.

    Raises ConfigError: `number` is not one of 0 to E - 1.
    """
    count = len(model.members)
    if not str(number).isdecimal() or not int(number) < count:
        raise ConfigError(f"water '{model.name}#{number}': got member {number!r}, expected a number from 0 to {count - 1}")
    e = int(number)
    learnt = None if model.learnt is None else residual_hooks.member(model.learnt, e)
    return replace(
        model, name=f"{model.name}#{e}", base=unflat(model.members[e].tolist()), learnt=learnt, members=model.members[e : e + 1]
    )


def _read(path: Path) -> HydroModel:
    try:
        table = read_toml(path)
    except ConfigError as error:
        raise StoreError(str(error)) from error
    if (schema := table.get("schema")) == FAMILY_SCHEMA:
        one = f"name one of its members: {shown(table.get('members'), 200)}"
        raise ConfigError(f"{path}: a family of waters, expected one fitted water; {one}")
    if schema != SCHEMA:
        got = "nothing" if schema is None else shown(schema)
        raise ConfigError(f"{path} schema: got {got}, expected {SCHEMA!r} (a fitted water) or {FAMILY_SCHEMA!r} (a family)")
    check(table, str(path))
    try:
        checked(table["name"], "water", str(path))
        checked(table["robot"], "robot", str(path))
        weights = path.with_name(checked(table["weights"]["file"], "weights file", str(path)))
        expected = table["weights"]["sha256"]
        if sha256(weights) != expected:
            raise StoreError(f"{weights}: expected sha256 {expected}, as {path.name} says, got {sha256(weights)}")
        arrays, _ = read_tensors(weights)
        given = {key: table[key] for key in ("name", "robot", "robot_sha256", "dt", "slip")}
        given |= {key: table.get(key, "") for key in ("notes", "body_sha256")} | {"preview": table.get("preview", False)}
        given |= {key: table.get(key, {}) for key in ("found", "dataset", "band", "band_alone", "scores", "calibration")}
        given |= {"base": strip_forces.Coefficients(**table["base"])}
        given |= {key: _with_residual(arrays[key], given["base"]) for key in ("members", "alone")}
        if table["weights"]["residual"]:
            given["learnt"] = residual_hooks.unpacked({key: value.astype(float) for key, value in arrays.items()})
        return HydroModel(**given)
    except FishmjError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ConfigError(f"{path}: {error!r}; expected what HydroModel.save writes; fit the model again") from error


def _with_residual(rows: np.ndarray, base: strip_forces.Coefficients) -> np.ndarray:
    """Flat coefficients (E, P); adds the column `residual`, 1, if an older file lacks it."""
    return rows if rows.shape[1] == len(flat(base)) else np.column_stack([rows, np.ones(len(rows))])


def _finite(value):
    """Value without None, which TOML does not have."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items() if item is not None}
    return [_finite(item) for item in value if item is not None] if isinstance(value, list) else value
