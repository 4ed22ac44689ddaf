"""The cases of one robot, one after another: describe it, calibrate it, hide, search, write.

    rows(RobotQuery(robot)) -> [row]    one row a case, all in the process that calibrated the robot; kept as each is done

The null runs of a robot are made for its first case and read from disk for the others. They leave out fish of the
robot's own family (`SimulatedNull.without`).
"""

import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import NamedTuple

from fishmj.base import console
from fishmj.base.errors import ConfigError, LogError, SimDiverged
from fishmj.gap.bench import calibrated, families, power
from fishmj.gap.bench.bench_rows import keep
from fishmj.gap.bench.cases import BenchCase
from fishmj.gap.bench.drawn_robots import BenchRobot, describe_robot, is_searched, number_of
from fishmj.gap.bench.run_case import answered_by
from fishmj.gap.null.null_runs import SimulatedNull
from fishmj.gap.progress import QuietBar
from fishmj.gap.search.healthy_swims import HealthySwims
from fishmj.gap.thresholds import frozen
from fishmj.gap.workflow import investigate
from fishmj.log import Trial
from fishmj.mjcf.description import Robot

UNABLE = (ConfigError, LogError, SimDiverged)  # of one robot or its logs; anything else stops the benchmark
APART = 1000  # trials from one case of a robot to the next, so that each has noise of its own


class RobotQuery(NamedTuple):
    """Work of one process: a robot with its pending cases.

    calibrate: calibrate its water first. weighed: with a page of weighings. out: folder of rows.jsonl.
    """

    robot: BenchRobot
    calibrate: bool = True
    weighed: bool = False
    out: Path | None = None


class Stopwatch:
    """Invisible progress bars that add up the process's time by stage."""

    def __init__(self):
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, total: float, label: str, unit: str = "", at_most: bool = False) -> Iterator[QuietBar]:
        begin = time.process_time()
        yield QuietBar()
        self.seconds[label] = self.seconds.get(label, 0.0) + time.process_time() - begin


def rows(one: RobotQuery) -> list[dict]:
    """A row of every case. A case that cannot be searched, or cannot swim, gives the reason in its row."""
    return write_rows(one, _rows(one))


def write_rows(one: RobotQuery, found: Iterable[dict]) -> list[dict]:
    """Passes rows on as they are found, each written into the folder of `one` at once."""
    made = []
    for row in found:
        made.append(console.plain(row))
        if one.out:
            keep(one.out / "rows.jsonl", made[-1])
    return made


def _rows(one: RobotQuery) -> Iterator[dict]:
    robot = one.robot
    about = {"model": "drawn" if robot.drawn else "fish"}
    try:
        known, model, own, more = questioned_model(one)
    except UNABLE as error:
        yield from (case_facts(case, one) | about | refusal_row(error) for case in robot.cases)
        return
    for case in robot.cases:
        yield case_facts(case, one) | about | more | row(one, case, known, model, own)


def questioned_model(one: RobotQuery) -> tuple[Robot, object, HealthySwims | None, dict]:
    """(true description, questioned model, result of its own healthy swims, the row's entries on all three)."""
    begin = time.process_time()
    known, redraws, speed = describe_robot(one.robot)
    facts = of_body(known) | {"redraws": redraws, "lengths_a_second": speed, "calibrated": None}
    believed = known
    if one.calibrate:
        believed, facts["calibrated"] = calibrated.calibrate_robot(one.robot.family, one.robot.seed, known)
    swims = calibrated.swims(one.robot.family, one.robot.seed, known) if one.calibrate else []
    model, own = calibrated.compiled_model(believed, one.robot.family, swims)
    facts["own"] = own.calibration_residual if own else 0.0
    return known, model, own, facts | {"robot_cpu_seconds": time.process_time() - begin}


def row(one: RobotQuery, case: BenchCase, known: Robot, model, own: HealthySwims | None = None) -> dict:
    """Entries of a row on one case of a robot."""
    robot, begin, about = one.robot, time.process_time(), {}
    try:
        if case.times:
            hidden, strength = power.effect_at_strength(robot.family, case, known)
            case, about = case._replace(effects=hidden), {"truth": hidden}
            if not power.reaches(strength, case.times):
                return about | {"answer": power.NOT_REACHED, "detectable": strength}
        number = APART * (1 + number_of(case))
        trials = families.trials(robot.family, case.effects, case.logs, robot.seed, known, first=number, noise=case.noise)
        seen = families.detectable(robot.family, case.effects, case.logs, robot.seed, known)
    except (ConfigError, SimDiverged) as error:  # what is hidden leaves no robot, or one that does not swim
        return {"answer": "DIVERGED", "reason": str(error)}
    page = families.page(robot.family, case.effects, robot.seed, known) if one.weighed else None
    return about | search_row(case, robot, model, trials, seen, page, time.process_time() - begin, own)


def search_row(
    case: BenchCase, robot: BenchRobot, model, trials: list[Trial], seen: Mapping, page: dict | None, data: float,
    own: HealthySwims | None = None,
) -> dict:  # fmt: skip
    """Entries of a row on a search, or on its omission.

    seen: visible size of the hidden effects, by the generator; data: CPU seconds that the trials took; own: result of the swims
    of the calibration.
    """
    about = {"detectable": seen["all"], "each_detectable": seen["each"]}
    about |= {"noise_only": seen["noise_only"], "each_noise_only": seen["each_noise_only"]}
    if not case.times and not is_searched(case, seen["each"]):
        return about | {"answer": "NOT_SEARCHED"}
    made, start, laps = time.process_time(), time.monotonic(), Stopwatch()
    null = SimulatedNull(noise=case.noise, without=robot.family)
    try:
        asked = partial(investigate, model, trials, gates=frozen(), null=null, seed=robot.seed, bars=laps)
        verdict = asked(page=page, mass_known=False, healthy=own).verdict
    except UNABLE as error:
        return about | refusal_row(error)
    cpu = {"data": data, **laps.seconds, "whole search": time.process_time() - made}
    return about | answered_by(verdict) | {"cpu_seconds": cpu, "seconds": data + time.monotonic() - start}


def of_body(robot: Robot) -> dict:
    """Entries of a row on a description."""
    return {"links": len(robot.links), "length": robot.length, "mass": robot.mass}


def case_facts(case: BenchCase, one: RobotQuery) -> dict:
    """Entries of a row on a case before its search. Two rows of one id that differ in them are of two benchmarks."""
    out = {"id": case.id, "kind": case.kind, "truth": case.effects, "noise": case.noise, "logs": len(case.logs)}
    out |= {"times": case.times, "drawn": case.effects} if case.times else {}
    out |= {"experiments": list(case.logs), "weighed": one.weighed, "as_described": not one.calibrate}
    return out | {"family": one.robot.family, "robot": one.robot.id, "seed": one.robot.seed}


def refusal_row(error: Exception) -> dict:
    """Entries of a row on a refused search: it named nothing, and agreed with nothing."""
    return {"answer": "REFUSED", "reason": str(error), "said": [], "rivals": []}
