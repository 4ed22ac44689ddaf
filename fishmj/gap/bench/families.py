"""The families of robots that a benchmark draws from, behind one interface: three forms of water and the second robot.

    trials("foil", {"body_lift": {"coefficient": 0.4}}, runs, seed=7, robot=robot)      [Trial] of one robot
    detectable("foil", effects, runs, seed=7, robot=robot)                              its visible size, by the generator

A seed is a robot. Its noise also depends on the numbers of the trials, so that data sets of one robot differ.
"""

from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from fishmj import effects as catalogue
from fishmj.gap.laboratory import generators
from fishmj.gap.laboratory.generators.detectability import (
    FIRST,
    HEALTHY,
    NOTHING,
    SensedChannels,
    channels,
    mean_squares,
    spreads,
)
from fishmj.gap.laboratory.session import Effects
from fishmj.gap.records.records import mean_speed_and_yaw_rate
from fishmj.log import Trial, excitation
from fishmj.log.excitation import Excitation
from fishmj.mjcf.description import Robot

SECOND = "second_robot"
NAMES = (*generators.NAMES, SECOND)
NUISANCE = 0.1  # each constant by its own tolerance


class EffectPool(NamedTuple):
    """Effects and faults that can be hidden in a family, by name: things with `draw(rng, strength) -> {parameter: value}`."""

    catalogued: dict[str, Any]
    off: dict[str, Any]


@cache
def pool(family: str) -> EffectPool:
    """Effects of the catalogue that change the mean of a log, and faults outside it."""
    if family == SECOND:
        from fishmj.gap.laboratory.virtual_robot import EFFECTS

        steady = {n: e for n, e in EFFECTS.items() if e.catalogued and not e.stochastic}
        return EffectPool(steady, {n: e for n, e in EFFECTS.items() if not e.catalogued})
    known = generators.hidden()
    mean = {n: h for n, h in known.items() if h.catalogued and not catalogue.get(n).stochastic}
    return EffectPool(mean, {n: h for n, h in known.items() if not h.catalogued})


def runs_of(experiments, robot: Robot) -> list[Excitation]:
    """Experiments, given by id or as three-joint commands, laid on a robot's chain."""
    whats = [excitation.get(item) if isinstance(item, str) else item for item in experiments]
    return [replace(what, commands=excitation.bent(what.commands, robot.n_joints)) for what in whats]


def trials(
    family: str, effects: Effects, experiments, seed: int, robot: Robot, *, first: int = 0, noise: float = 1.0
) -> list[Trial]:
    """One trial an experiment. seed: of the robot; first: number of the first trial, which selects its noise.

    Raises SimDiverged: the robot left the finite numbers.
    """
    runs = list(enumerate(runs_of(experiments, robot)))
    if family == SECOND:
        from fishmj.gap.laboratory.virtual_robot.trials import plant
        from fishmj.gap.laboratory.virtual_robot.trials import trial_of as second

        made = plant(effects, seed, nuisance=NUISANCE, robot=robot)
        return [second(made, run, seed, first + i, noise, f"{i + 1:02d}_{run.id}", "", (0.0, 0.0)) for i, run in runs]
    from fishmj.gap.laboratory.generators.generator_trials import robot_of, trial_of

    fish = robot_of(family, effects, seed, nuisance=NUISANCE, robot=robot)
    return [trial_of(fish, run, seed, first + i, noise, f"{i + 1:02d}_{run.id}") for i, run in runs]


def page(family: str, effects: Effects, seed: int, robot: Robot) -> dict:
    """Page of weighings of a robot."""
    from fishmj.gap.laboratory.virtual_robot.trials import page as second

    if family == SECOND:
        return second(effects, seed, robot=robot)
    return generators.page(family, effects, seed, NUISANCE, robot)


def lengths_a_second(family: str, seed: int, robot: Robot) -> float:
    """Speed of this robot in its own water with the standard gait, body lengths a second."""
    rows = trials(family, {}, ["gait"], seed, robot, noise=0.0)[0].table("pose")
    speed, _ = mean_speed_and_yaw_rate(rows["t"], np.stack([rows[c] for c in ("x", "y", "yaw")], 1))
    return speed / robot.length


def detectable(family: str, effects: Effects, experiments, seed: int, robot: Robot) -> dict:
    """Mean squares of the hidden effects over noise and healthy robots, as of `generators.detectable`.

    For the second robot the same figure, from its own healthy robots.
    """
    if family != SECOND:
        return generators.detectable(family, effects, runs_of(experiments, robot), seed, 1.0, NUISANCE, robot)
    if not effects:
        return dict(NOTHING)
    sigma = trials(SECOND, {}, experiments[:1], seed, robot)[0].meta["sigma"]

    def seen(hidden: Effects) -> list[SensedChannels]:
        return [s for t in trials(SECOND, hidden, experiments, seed, robot, noise=0.0) for s in channels(t, sigma)]

    return mean_squares(seen, _second_spread(experiments, robot), effects, HEALTHY)


def _second_spread(experiments, robot: Robot) -> list[np.ndarray]:
    """Variance of the second robot's healthy fish, (K, C) of every record's joints, pose and power; one robot at a time."""
    runs = runs_of(experiments, robot)
    key = repr((robot, [(run.id, run.start, run.push, len(run.commands)) for run in runs]))
    if key not in _spreads:
        fish = [trials(SECOND, {}, experiments, FIRST + k, robot, noise=0.0) for k in range(HEALTHY)]
        seen = [[s for t in swum for s in channels(t, t.meta["sigma"])] for swum in fish]
        _spreads.clear()
        _spreads[key] = [spreads(list(same), same[0]) for same in zip(*seen, strict=True)]
    return _spreads[key]


_spreads: dict[str, list[np.ndarray]] = {}
