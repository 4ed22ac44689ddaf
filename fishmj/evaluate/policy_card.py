"""Card of a policy: its training and cost, conditions in which it holds station, and its worst trial.

    station.safetensors    weights and a header about the training (`fishmj.control.policy`)
    station.card.json      this file: training curve and judgements, from the results.json of `fishmj evaluate`

A card contains the sha256 of its weights. A policy without a card file has the card that its header gives.
"""

import json
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fishmj.base.errors import ConfigError, FishmjError
from fishmj.base.store import read_json, sha256, write_text
from fishmj.control.policy import Policy, file_of
from fishmj.water.choice import fitted_water
from fishmj.water.water_identity import members_of

SCHEMA = "fishmj.policy-card/1"
ENDING = ".card.json"  # in place of the weights' .safetensors
KEYS = ("arrival", "approach_time", "rmse_after_arrival", "rmse_last20", "power")  # of a judgement
KEYS_BY_SPEED = ("arrival", "rmse_after_arrival")
POINTS = 16  # of a training curve
TRAINING = ("command", "algorithm", "preset", "engine", "seed", "steps", "seconds", "machine", "tune")  # keys of the header
OLDER = "judge it again with this fishmj: `fishmj evaluate POLICY --out DIR`"
Name = Annotated[str, Field(max_length=4000)]
Hash = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]


class _CardPart(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True)


class CardFigure(_CardPart):
    """A figure over n trials with its 95 % interval; None where there is none."""

    value: float | None
    low: float | None
    high: float | None
    n: int

    def text(self, digits: int = 3, interval: bool = True) -> str:
        """Text of the figure, `0.041 (0.035 0.048)`."""
        if self.value is None:
            return "-"
        bounds = f" ({self.low:.{digits}f} {self.high:.{digits}f})" if interval and None not in (self.low, self.high) else ""
        return f"{self.value:.{digits}f}{bounds}"


class WorstTrial(_CardPart):
    """Trial with the largest RMS distance after arrival. replay: command that swims it again and writes its replay."""

    trial: Name
    seed: int
    rmse_after_arrival: float | None
    replay: Name


class WaterJudgement(_CardPart):
    """Judgement of one policy in one water.

    Attributes:
        water: name, kind and, where there is one, sha256. held: trials that arrive and stay within the arrival radius (RMS).
        held_by_speed: of these, how many at each speed of the stream; None in a judgement by an older fishmj.
        command: of `fishmj evaluate`. condition: line that names everything on which a figure depends.
    """

    water: dict[str, Name]
    engine: Name
    condition: Name
    command: Name
    n: int
    held: int | None
    held_by_speed: dict[str, int] | None = None
    overall: dict[str, CardFigure]
    by_speed: dict[str, dict[str, CardFigure]]
    worst: WorstTrial

    @property
    def arrived(self) -> str:
        """Number of trials that arrive, `71/72`."""
        return f"{round(self.n * (self.overall['arrival'].value or 0.0))}/{self.n}"

    @property
    def where(self) -> str:
        """Short name of the water; of the flow solver also its box, slip ratio and boundary."""
        solved = self.engine.partition(", ")
        return f"solver, {solved[2]}" if solved[0] == "tanks" else self.water["name"]

    @property
    def speeds(self) -> list[str]:
        """Speeds of the stream, the slowest first."""
        return sorted(self.by_speed, key=float)

    def lost(self) -> dict[str, tuple[int, int]]:
        """Numbers of trials that do not hold, and of all, at each speed at which there are any; {} if all hold.

        Of a judgement that does not count them by speed both numbers are those of all, under "".
        """
        if self.held_by_speed is None or not set(self.by_speed) <= set(self.held_by_speed):
            return {} if self.held in (None, self.n) else {"": (self.n - (self.held or 0), self.n)}
        counts = {u: (self.by_speed[u]["arrival"].n - self.held_by_speed[u], self.by_speed[u]["arrival"].n) for u in self.speeds}
        return {u: count for u, count in counts.items() if count[0]}


class PolicyCard(_CardPart):
    """Card of a policy; the keys of its file."""

    schema_: Literal["fishmj.policy-card/1"] = Field(alias="schema")
    policy: Name
    sha256: Hash
    origin: Literal["synthetic"] = "synthetic"
    waters: list[dict[str, Name]]
    training: dict[str, Any]
    curve: list[dict[str, float]] = []
    judged: list[WaterJudgement] = []

    def plain(self) -> dict:
        """The card as its file has it."""
        return self.model_dump(by_alias=True)


def card_path(source: str | Path) -> Path:
    """Path of a policy's card, beside its weights. Raises UnknownName, StoreError: no such policy."""
    path = file_of(source)
    return path.with_name(path.name.removesuffix(".safetensors") + ENDING)


def make_card(source: str | Path, judged: Sequence[dict], curve: Path | None = None) -> PolicyCard:
    """Makes the card of a policy.

    Args:
        source: shipped name, path, or folder of a training.
        judged: contents of results.json; of each, what judges these weights.
        curve: metrics.jsonl of the training.
    Raises:
        ConfigError: a results.json judges other weights, or lacks what a card shows. UnknownName, StoreError: no such policy.
    """
    path = file_of(source)
    policy, digest = Policy.load(path), sha256(path)
    training = {key: policy.meta[key] for key in TRAINING if policy.meta.get(key) is not None}
    rows = [row for found in judged for row in _rows_of(found, digest, str(source))]
    points = curve_points(curve) if curve is not None else []
    known = {"schema": SCHEMA, "policy": path.stem, "sha256": digest, "waters": waters_of(policy.meta)}
    return _checked(known | {"training": training, "curve": points, "judged": rows}, str(source))


def read_card(source: str | Path) -> PolicyCard:
    """Card of a policy from the file beside its weights; if there is none, that of its header and its run's curve.

    Raises ConfigError: no card, or one of other weights; UnknownName, StoreError: no such policy, or a damaged card.
    """
    path = card_path(source)
    if not path.is_file():
        return make_card(source, (), curve_beside(source))
    card = _checked(read_json(path), str(path))
    if card.sha256 != (digest := sha256(file_of(source))):
        message, name = f"{path}: of the weights {card.sha256[:12]}; these are {digest[:12]}", shlex.quote(str(source))
        raise ConfigError(f"{message}; make the card again with `fishmj policy {name} --judged DIR ..`, or remove it")
    return card


def curve_beside(source: str | Path) -> Path | None:
    """Curve of the training in whose folder a policy lies, metrics.jsonl, or None."""
    beside = file_of(source).with_name("metrics.jsonl")
    return beside if beside.is_file() else None


def write_card(card: PolicyCard, path: Path) -> Path:
    """Writes the file of a card, atomically."""
    return write_text(path, json.dumps(card.plain(), indent=1) + "\n")


def waters_of(meta: dict) -> list[dict[str, str]]:
    """Waters of a training: name, kind and sha256 from the header, then the members of a family.

    A fitted water that is installed with the same hash also has the sha256 of the data set that it is fitted to, `segments`.
    """
    found = [dict(meta["water"]), *members_of(meta["water"])] if meta.get("water") else []
    for water in found:
        try:
            model = fitted_water(water["name"]) if water["kind"] == "fitted" else None
        except FishmjError:
            model = None  # not installed here
        if model is not None and model.sha256 == water.get("sha256") and model.dataset.get("sha256"):
            water["segments"] = model.dataset["sha256"]
    return found


def curve_points(path: Path) -> list[dict[str, float]]:
    """Training curve in POINTS rows: step, seconds, reward, late_distance [m]. Raises ConfigError: no such file."""
    from fishmj.train.curves import read

    columns = read(path)
    count = len(columns["step"])
    if count == 0:
        raise ConfigError(f"{path}: no row with a reward; expected the metrics.jsonl of a training")
    picked = np.unique(np.linspace(0, count - 1, min(POINTS, count)).round().astype(int))
    return [{key: float(values[i]) for key, values in columns.items()} for i in picked]


def _rows_of(found: Any, digest: str, policy: str) -> list[dict]:
    """Judgements of these weights in the contents of a results.json."""
    results = found.get("results") if isinstance(found, dict) else None
    if not isinstance(results, list) or not all(isinstance(row, dict) for row in results):
        raise ConfigError(f"policy {policy}: a results.json without results; expected one of `fishmj evaluate --out DIR`")
    if not all("policy_sha256" in row for row in results):
        raise ConfigError(f"policy {policy}: a results.json that does not say which weights it judges; {OLDER}")
    mine = [row for row in results if row["policy_sha256"] == digest]
    if not mine:
        others = ", ".join(f"{row.get('controller')} {str(row['policy_sha256'])[:12]}".strip() for row in results)
        raise ConfigError(f"policy {policy}: its weights are {digest[:12]}; the results.json judges {others[:200]}; {OLDER}")
    common = {"condition": found.get("condition"), "command": found.get("command")}
    return [common | row | {"overall": _some(row, "overall", KEYS), "by_speed": _by_speed(row)} for row in mine]


def _some(row: dict, name: str, keys: tuple[str, ...]) -> dict:
    return {key: figure for key, figure in (row.get(name) or {}).items() if key in keys}


def _by_speed(row: dict) -> dict:
    return {speed: _some(row["by_speed"], speed, KEYS_BY_SPEED) for speed in row.get("by_speed") or {}}


def _checked(table: Any, where: str) -> PolicyCard:
    """Card from a table. Raises ConfigError with the first wrong key."""
    try:
        return PolicyCard.model_validate(table)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise ConfigError(f"{where}: card: {key or 'the whole'}: {first['msg']}; {OLDER}") from error
