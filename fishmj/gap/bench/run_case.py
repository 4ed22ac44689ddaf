"""One case: makes the data, hides the effect, runs the search, and records answer and truth."""

import time
from collections.abc import Callable
from functools import cache

import numpy as np

from fishmj.base.errors import SimDiverged
from fishmj.gap.bench.cases import BenchCase
from fishmj.gap.null.null_runs import SimulatedNull
from fishmj.gap.null.whitening import residual_and_tangents
from fishmj.gap.records.records import Record, ResidualLayout, record_of
from fishmj.gap.thresholds import Gates
from fishmj.gap.verdict import NamedEffect, Verdict
from fishmj.gap.workflow import investigate
from fishmj.log import Trial


@cache
def fish(model: str = "fish"):
    """The model of the second robot, a name or a TOML file, made once a process."""
    from fishmj.gap.models.swimming_fish import SwimmingFish

    return SwimmingFish(model)


def run(
    plant, case: BenchCase, gates: Gates, null: SimulatedNull, trials: list[Trial] | None = None, weighed: bool = False
) -> dict:
    """One row of the benchmark. For a fish that left the finite numbers, the row gives that as its answer.

    trials: data of another generator; by default the second robot's. weighed: the search also gets the page
    of its weighings, whose errors are the same at every noise.
    """
    from fishmj.gap.laboratory.virtual_robot import generate
    from fishmj.gap.laboratory.virtual_robot.trials import page as weighings

    start = time.monotonic()
    row = {"id": case.id, "kind": case.kind, "truth": case.effects, "seed": case.seed}
    row |= {"noise": case.noise, "logs": len(case.logs), "weighed": weighed}
    try:
        trials = trials or generate(case.effects, case.logs, case.seed, case.noise, robot=plant.robot)
        row["true_gap"], row["each_gap"] = sizes(true_gap, plant, case)
        row["beyond_gap"], row["each_beyond"] = sizes(beyond_gap, plant, case)
    except SimDiverged as error:
        return row | {"answer": "DIVERGED", "reason": str(error)}
    page = weighings(case.effects, case.seed, robot=plant.robot) if weighed else None
    verdict = investigate(plant, trials, gates=gates, null=null, page=page, mass_known=False, seed=case.seed).verdict
    return row | answered_by(verdict) | {"seconds": time.monotonic() - start}


def answered_by(verdict: Verdict) -> dict:
    """Entries of a row on a search's answer."""
    out: dict = {
        "answer": verdict.answer,
        "said": [effect_row(e) for e in verdict.effects],
        "rivals": [r["name"] for r in verdict.rivals],
    }
    out |= {"gap_before": verdict.gap_before, "gap_after": verdict.gap_after, "gap_unseen": verdict.gap_after_unseen}
    out |= {"gap_unseen_before": verdict.gap_unseen_before, "explained": verdict.explained, "gates": verdict.gates}
    return out | {"steps": verdict.steps, "warnings": verdict.warnings}


def records_of(plant, case: BenchCase, effects: dict, noise: float = 0.0) -> list[Record]:
    """Records of a case's experiments with its robot and these effects. noise: factor on the sensors' noise."""
    from fishmj.gap.laboratory.virtual_robot import generate

    return [record_of(t, plant.dt) for t in generate(effects, case.logs, case.seed, noise, robot=plant.robot)]


def sizes(gap: Callable, plant, case: BenchCase) -> tuple[float, dict]:
    """(gap of all hidden effects together, {name: gap of each alone})."""
    whole = gap(plant, case, case.effects)
    return whole, {n: gap(plant, case, {n: v}) if len(case.effects) > 1 else whole for n, v in case.effects.items()}


def effect_row(effect: NamedEffect) -> dict:
    """A named effect in short: values as [value, low, high]; values of what is the same on a robot."""
    values = {k: [v.value, v.low, v.high] for k, v in effect.parameters.items()}
    same = {name: {k: v.value for k, v in there.items()} for name, there in effect.same.items()}
    return {"name": effect.name, "p_best": effect.p_best, "values": values} | ({"same": same} if same else {})


def true_gap(plant, case: BenchCase, hidden: dict) -> float:
    """1 + mean square of the change by the `hidden` effects, over the sensors' own noise, without noise and scatter.

    It compares the same fish with and without its effects; every record and channel counts alike.
    """
    if not hidden:
        return 1.0
    (first,) = records_of(plant, case._replace(logs=case.logs[:1]), {}, case.noise)
    noise = {s: getattr(first, s).sigma for s in ("joint", "pose", "power") if getattr(first, s) is not None}
    pairs = zip(records_of(plant, case, hidden), records_of(plant, case, {}), strict=True)
    return 1.0 + float(np.mean([r for a, b in pairs for r in _ratios(a, b, noise)]))


def beyond_gap(plant, case: BenchCase, hidden: dict) -> float:
    """The same for the part of the change that the fish's own constants, each within its tolerance, cannot imitate.

    With s the change by the effects, T the change by the constants' tolerances, both over the noise: 1 + s (1 + T^T T)^-1 s / m.
    """
    if not hidden:
        return 1.0
    with_, without = records_of(plant, case, hidden), records_of(plant, case, {})
    noisy = ResidualLayout(records_of(plant, case, {}, case.noise))
    layout = ResidualLayout(without)
    _, tangents = residual_and_tangents(plant, without, layout, plant.null)
    means = [ResidualLayout(r).measured for r in (with_, without)]
    noise = layout.aligned(noisy, noisy.noise())
    known = np.isfinite(noise)
    s = (layout.aligned(ResidualLayout(with_), means[0]) - means[1])[known] / noise[known]
    t = tangents[:, known] / noise[known]
    seen = t @ s
    return 1.0 + float(s @ s - seen @ np.linalg.solve(np.eye(len(t)) + t @ t.T, seen)) / len(s)


def _ratios(a: Record, b: Record, noise: dict) -> list[float]:
    """Mean square difference of each channel of two records, over its noise; channels of unknown noise are left out."""
    out = []
    for block, other in zip(ResidualLayout([a]).blocks, ResidualLayout([b]).blocks, strict=True):
        sigma = noise[block.sensor][block.column] if block.sensor in noise else np.nan
        if np.isfinite(sigma) and sigma > 0:
            x, y = getattr(a, block.sensor), getattr(b, other.sensor)
            t = x.t[x.t <= y.t[-1]]
            difference = x.values[: len(t), block.column] - np.interp(t, y.t, y.values[:, block.column])
            out.append(float(np.mean((difference / sigma) ** 2)))
    return out
