"""Robots of the flow solver as a family of the benchmark: their data sets exist already (`studies.solver_family`).

Each robot's model is calibrated to its own free swims in the solver. The search leaves the solver out, so the null runs are the
second robot's and the structural error comes from other waters.

    robots(folder, kinds) -> [BenchRobot]        those whose data sets are complete
    rows(RobotQuery(robot), folder) -> [row]     as `family_rows.rows`
"""

import hashlib
import json
import shlex
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.base.store import read_json
from fishmj.gap.bench import calibrated
from fishmj.gap.bench import solver_plan as plans
from fishmj.gap.bench.drawn_robots import BenchRobot
from fishmj.gap.bench.family_rows import UNABLE, RobotQuery, case_facts, of_body, refusal_row, search_row, write_rows
from fishmj.gap.bench.solver_plan import FREE, SETS, TRUTH
from fishmj.gap.search.healthy_swims import HealthySwims
from fishmj.log import Trial
from fishmj.log.dataset import read_bundle
from fishmj.mjcf.description import Robot

SHIPPED = "fish"


def robots(folder: Path, kinds, many: int | None = None) -> list[BenchRobot]:
    """Robots with their cases of these kinds, at most `many` in sum, for which data sets exist.

    Raises ConfigError: there are none; StoreError: the folder was not made by `studies.solver_family`.
    """
    plan, known = plans.read(folder), read_json(folder / TRUTH)["cases"]
    out: list[BenchRobot] = []
    left = many or sum(len(one.cases) for one in plan.robots)
    for one in plan.robots:
        mine = tuple(case for case in one.cases if case.kind in kinds and case.id in known)[:left]
        if mine:
            out.append(BenchRobot(one.id, plans.SOLVER, one.model != SHIPPED, one.seed, mine))
        left -= len(mine)
    if not out:
        again = shlex.join(["python", "-m", "studies.solver_family", "--out", str(folder)])
        raise ConfigError(f"gap bench: --sets {folder}: no data set is complete; {again} goes on")
    return out


def rows(one: RobotQuery, folder: Path) -> list[dict]:
    """A row of every case, each written as it is done."""
    return write_rows(one, _rows(one, folder))


def _rows(one: RobotQuery, folder: Path) -> Iterator[dict]:
    plan, truth = plans.read(folder), read_json(folder / TRUTH)["cases"]
    told = next(robot for robot in plan.robots if robot.id == one.robot.id)
    known = plan.descriptions[told.model]
    about: dict = {"model": "drawn" if one.robot.drawn else SHIPPED, "described": told.model, "domain": plan.asked.domain}
    about |= of_body(known) | {"redraws": 0, "calibrated": None}
    try:
        model, error, own = questioned_model(one, known, read_bundle(folder / SETS / f"{one.robot.id}-{FREE}.npz"))
    except UNABLE as refusal:
        yield from (case_facts(case, one) | about | refusal_row(refusal) for case in one.robot.cases)
        return
    about |= {"calibrated": error, "own": own.calibration_residual if own else 0.0}
    for case in one.robot.cases:
        begin = time.process_time()
        trials = read_bundle(folder / SETS / f"{case.id}.npz")
        seen, data = truth[case.id]["detectable"], time.process_time() - begin
        more = {"swum": len(trials), "healthy": seen["healthy"]}
        yield case_facts(case, one) | about | more | search_row(case, one.robot, model, trials, seen, None, data, own)


def questioned_model(one: RobotQuery, known: Robot, free: list[Trial]) -> tuple[object, dict | None, HealthySwims | None]:
    """(questioned model, its speed error on swims left out of its calibration, result of these swims).

    Raises LogError: the free swims contain no information.
    """
    believed, error = known, None
    if one.calibrate:
        path = calibrated.cached([plans.SOLVER, fingerprint(free)], known)
        believed, error = calibrated.read_or_calibrate(path, plans.SOLVER, known, lambda: free)
    model, own = calibrated.compiled_model(believed, plans.SOLVER, free if one.calibrate else [])
    return model, error, own


def fingerprint(trials: list[Trial]) -> str:
    """Hash of all logged values."""
    found = hashlib.sha256()
    for trial in trials:
        found.update(json.dumps(console.plain(trial.meta), sort_keys=True).encode())
        for _, table in sorted(trial.tables.items()):
            for _, values in sorted(table.items()):
                found.update(np.ascontiguousarray(values, float).tobytes())
    return found.hexdigest()
