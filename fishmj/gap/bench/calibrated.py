"""A robot's model before anything was hidden in it: its description, and the water calibrated to the robot's own free swims.

The swims are other experiments than the searched ones, as docs/search/calibrate.md asks: gaits at several
frequencies and amplitudes, turns to both sides, coasting. A calibration is kept on disk, under the hash of all its inputs.
"""

import hashlib
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fishmj.base import console
from fishmj.base.compile_cache import cache_folder
from fishmj.base.errors import StoreError
from fishmj.base.store import read_json, write_json
from fishmj.gap.bench import families
from fishmj.gap.calibrate import water_fit
from fishmj.gap.calibrate.calibration_logs import Logs
from fishmj.gap.calibrate.water_plant import WaterPlant
from fishmj.gap.null.null_runs import SimulatedNull, digest
from fishmj.gap.search import healthy_swims
from fishmj.gap.search.healthy_swims import HealthySwims
from fishmj.log import Trial, excitation
from fishmj.log.excitation import Excitation
from fishmj.mjcf.description import Robot
from fishmj.water.choice import STRUCTURED

FIRST = 500_000  # number of the first trial: its noise is none of a case's
WEST = (-1.4, 0.0, 0.0)


def _beat(name: str, frequency: float, amplitude: float, bias: float = 0.0, seconds: float = 10.0) -> Excitation:
    """A gait as an experiment; Hz, deg, deg, s."""
    commands = excitation.gait(frequency, np.radians(amplitude), excitation.LAG, np.radians(bias), seconds)
    return Excitation(
        id=name, commands=commands, about="free swim to calibrate water by", start=(0.0, 0.0, 0.0) if bias else WEST
    )


SWIMS: tuple[str | Excitation, ...] = (
    *("gait_slow", "gait_small", _beat("gait_brisk", 1.4, 26.0, seconds=8.0), _beat("gait_wide", 0.8, 35.0)),
    *("turn_right", _beat("turn_wide", 1.2, 22.0, -14.0), "spin", "tow_ahead", "tow_sideways", "ramps_2"),
)
CODE = (
    "fishmj.gap.calibrate.water_fit",
    "fishmj.gap.laboratory.generators.generator_trials",
    "fishmj.gap.laboratory.virtual_robot.trials",
    __name__,
)


class CalibratedRobot(NamedTuple):
    """robot: the description with its water; speed_error: {"value", "low", "high"} of swims left out, relative."""

    robot: Robot
    speed_error: dict[str, float]


def calibrate_robot(family: str, seed: int, robot: Robot) -> CalibratedRobot:
    """Calibrated model of the healthy robot of a seed, from disk or made now.

    Raises LogError: the swims contain no information; SimDiverged: the robot left the finite numbers.
    """
    return read_or_calibrate(calibration_path(family, seed, robot), family, robot, lambda: swims(family, seed, robot))


def swims(family: str, seed: int, robot: Robot) -> list[Trial]:
    """The free swims of the healthy robot of a seed. Raises SimDiverged."""
    return families.trials(family, {}, SWIMS, seed, robot, first=FIRST)


def read_or_calibrate(path: Path, family: str, robot: Robot, swims: Callable[[], list[Trial]]) -> CalibratedRobot:
    """Reads the calibration at `path`, or fits it to the swims and writes it there. Raises as `calibrate_robot`."""
    try:
        found = read_json(path)
    except StoreError:
        fit = water_fit.calibrate(Logs(Path(family), {trial.name: trial for trial in swims()}), WaterPlant(robot))
        error = {key: getattr(fit.speed_error, key) for key in ("value", "low", "high")}
        found = console.plain({"water": fit.water, "speed_error": error})
        write_json(path, found)
    return CalibratedRobot(replace(robot, water=found["water"] | {"model": STRUCTURED}), found["speed_error"])


def calibration_path(family: str, seed: int, robot: Robot) -> Path:
    """Path of a cached calibration."""
    swims = [
        [run.id, run.start, run.push, hashlib.sha256(run.commands.tobytes()).hexdigest()]
        for run in families.runs_of(SWIMS, robot)
    ]
    return cached([family, seed, families.NUISANCE, swims], robot)


def compiled_model(robot: Robot, family: str, swims: list[Trial]) -> tuple[object, HealthySwims | None]:
    """(model of a description, its result on the healthy swims to which it was calibrated, or None without any)."""
    from fishmj.gap.models.swimming_fish import SwimmingFish

    model = SwimmingFish(robot)
    _ = model.kernel
    return model, healthy_swims.read_healthy_swims(model, swims, SimulatedNull(without=family)) if swims else None


def cached(inputs: list, robot: Robot) -> Path:
    """Path of a calibration of a description under the hash of its inputs, as JSON, and of the code."""
    text = json.dumps([*inputs, digest(*CODE)]) + repr(robot)
    return cache_folder() / "bench" / f"{hashlib.sha256(text.encode()).hexdigest()[:32]}.json"
