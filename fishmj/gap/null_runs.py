"""Null runs: the experiments of the records once more, with an independent simulator in which nothing is hidden.

    make(records, n, seed) -> n sets of records        same commands, start and push; constants, network and noise drawn anew
    residuals(plant, layout, sets) -> (n, m)           what the model makes of them

The simulator is `virtual_robot`: other equations for water, servos, network and camera. A set takes the time of its
experiments divided by several hundred.
"""

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from fishmj.errors import SimDiverged
from fishmj.excitation import Excitation
from fishmj.gap.features import Layout
from fishmj.gap.records import Record, record_of

SEED = 1_000_000  # null runs are drawn beyond every seed that a data set may have


def make(
    records: list[Record], n: int, seed: int = 0, nuisance: float = 0.1, noise: float = 1.0, progress=None
) -> list[list[Record]]:
    """n sets of null runs."""
    from fishmj.virtual_robot import generate

    experiments = [experiment(r) for r in records]
    flows = [r.flow for r in records]

    def one(i: int) -> list[Record] | None:
        try:
            made = []
            for k, (what, flow) in enumerate(zip(experiments, flows, strict=True)):
                polar = (float(np.hypot(*flow)), float(np.arctan2(flow[1], flow[0])))
                trial = generate({}, [what], SEED + seed * 10_000 + i, noise, nuisance, flow=polar)[0]
                made.append(record_of(trial, records[k].dt))
        except SimDiverged:
            return None
        if progress:
            progress(i)
        return made

    with ThreadPoolExecutor(2) as pool:
        return [s for s in pool.map(one, range(n)) if s is not None]


def experiment(record: Record) -> Excitation:
    """What was commanded, as an experiment that can be repeated."""
    stride = round(0.02 / record.dt)
    return Excitation(
        id=record.excitation or record.name,
        commands=record.commands[::stride],
        about="a record repeated",
        start=tuple(map(float, record.start)),
        push=tuple(map(float, record.push)),
    )


def residuals(plant, layout: Layout, sets: list[list[Record]]) -> np.ndarray:
    """(n, m) residuals of the model as it is on every null set, at the windows of `layout`."""
    out = []
    for records in sets:
        theirs = Layout(records)
        out.append(layout.aligned(theirs, theirs.residuals(plant.predict(records, plant.null))[0]))
    return np.array(out)
