"""Folder of the solver's family of robots, made by `python -m studies.solver_family`: the names of its files, and its plan.

plan.json                                 models, robots, hidden effects: opened by the score, never by a search
sets/ROBOT-free.npz, CASE.npz             free swims for a calibration; a session
truth.json                                {case: {"effects", "detectable"}}
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from fishmj.base import console
from fishmj.base.errors import StoreError
from fishmj.base.options import setting
from fishmj.base.store import read_json
from fishmj.gap.bench.cases import BenchCase
from fishmj.mjcf.description import Robot
from fishmj.mjcf.reading import load_robot

SOLVER = "solver"  # name of the family, in rows and in the structural error
SCHEMA = "fishmj.solver_family/1"
PLAN, SETS, TRUTH = "plan.json", "sets", "truth.json"
FREE = "free"  # of the set that a robot is calibrated by


@dataclass(frozen=True)
class PlanSettings:
    """Settings of a plan. models: name -> description."""

    models: dict[str, str]
    robots: int = setting(14, console.whole(1, 500), "of --plan: of each model (default 14)", metavar="N")
    singles: int = setting(2, console.whole(0, 20), "of --plan: of each robot (default 2)", metavar="N")
    seed: int = setting(0, console.whole(0, 10_000), "of --plan: draws everything anew (default 0)", metavar="N")
    seconds: float = setting(10.0, console.number(1, 60), "of --plan: to which experiments are cut, s (default 10)", metavar="S")
    calibration: float = setting(8.0, console.number(1, 60), "of --plan: to which free swims are cut, s (default 8)", metavar="S")
    domain: str = "window_coarse"


class PlannedRobot(NamedTuple):
    """One robot: its model's name, its seed, the experiments of its session, and its cases. forecasts: of each."""

    id: str
    model: str
    seed: int
    experiments: tuple[str, ...]
    cases: tuple[BenchCase, ...]
    forecasts: tuple[float | None, ...]


class FamilyPlan(NamedTuple):
    """The whole plan. descriptions: of the models, by name."""

    asked: PlanSettings
    robots: tuple[PlannedRobot, ...]
    descriptions: dict[str, Robot]


def read(folder: Path) -> FamilyPlan:
    """The plan of a folder. Raises StoreError: there is none, or it is invalid."""
    content: dict[str, Any] = read_json(folder / PLAN)
    if content.get("schema") != SCHEMA:
        raise StoreError(f"{folder / PLAN}: schema {content.get('schema')!r}, expected {SCHEMA!r}")
    asked = PlanSettings(**content["asked"])
    places = {name: str(folder / source) if (folder / source).is_file() else source for name, source in asked.models.items()}
    robots = []
    for one in content["robots"]:
        runs = tuple(one["experiments"])
        cases = tuple(BenchCase(c["id"], c["kind"], c["effects"], 1.0, runs, one["seed"]) for c in one["cases"])
        robots.append(PlannedRobot(one["id"], one["model"], one["seed"], runs, cases, tuple(c["forecast"] for c in one["cases"])))
    return FamilyPlan(asked, tuple(robots), {name: load_robot(place) for name, place in places.items()})
