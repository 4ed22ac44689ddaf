"""Steps and results of one robot, and the summary of all."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from fishmj.base.store import read_json
from fishmj.evaluate import metrics
from studies.whole_loop import steps, swims
from studies.whole_loop.steps import AFTER, ARMS, BEFORE, HEALTHY, UNPATCHED, Fault, Loop

LATENCY, HORN = "command_latency", "joint_zero_offset"


class Step(NamedTuple):
    """One step of a robot. lockstep: it swims in this process; else it waits for commands in processes of their own."""

    do: Callable[[Loop, int], None]
    lockstep: bool


def chain() -> list[Step]:
    """Steps of one robot, in order."""
    return [
        Step(partial(steps.measure, faulty=False), True),
        Step(steps.calibrate, False),
        Step(partial(steps.measure, faulty=True), True),
        Step(steps.search, False),
        Step(partial(steps.train, arm=AFTER), False),
        Step(partial(steps.train, arm=UNPATCHED), False),
        *(Step(partial(swims.swim, arm=arm), True) for arm in ARMS),
    ]


def row_of(loop: Loop, seed: int) -> dict:
    """Row with the results of one robot."""
    folder, fault = loop.folder(seed), Fault.of(seed)
    found = read_json(folder / "searched.json")
    fitted = {**found["counted_in"], **found["named"]}
    arms = {arm: read_json(path) for arm in ARMS if (path := folder / "swims" / f"{arm}.json").is_file()}
    mean = {arm: float(np.mean([swim["rmse"] for swim in rows])) for arm, rows in arms.items()}
    return {
        "seed": seed,
        "horn": fault.horn,
        "angle_deg": fault.angle_deg,
        "answer": found["answer"],
        "named": sorted(found["named"]),
        "counted_in": sorted(found["counted_in"]),
        "delay_ms": 1e3 * fitted[LATENCY]["delay"] if LATENCY in fitted else None,
        "zeros_deg": float(np.degrees(sum(fitted[HORN].values()))) if HORN in fitted else None,
        "patched": found["patched"],
        **{f"rmse_{arm}": mean.get(arm) for arm in ARMS},
        "incomplete": {arm: sum(not swim["complete"] for swim in rows) for arm, rows in arms.items()},
        "swims": {arm: [swim["rmse"] for swim in rows] for arm, rows in arms.items()},
    }


def summary(rows: list[dict]) -> dict:
    """Summary: counts over robots, and differences of RMSE [m] over those that were patched."""
    has = lambda row, name: name in row["named"]
    both = sum(has(row, LATENCY) and has(row, HORN) for row in rows)
    one = sum(has(row, LATENCY) != has(row, HORN) for row in rows)
    told: dict = {"robots": len(rows), "both": both, "one": one, "none": len(rows) - both - one}
    told["both_fitted"] = sum({LATENCY, HORN} <= {*row["named"], *row["counted_in"]} for row in rows)
    told["others_named"] = sum(bool(set(row["named"]) - {LATENCY, HORN}) for row in rows)
    fixed = [row for row in rows if row["patched"]]
    told |= {f"rmse_{arm}": mean_of([row[f"rmse_{arm}"] for row in fixed]) for arm in ARMS}
    for name, other in (("after_less_before", BEFORE), ("after_less_unpatched", UNPATCHED), ("after_less_healthy", HEALTHY)):
        found = metrics.difference("rmse", *(np.array([row[f"rmse_{arm}"] for row in fixed]) for arm in (other, AFTER)))
        told[name] = [found.value, found.low, found.high]
    return told | {"patched": len(fixed)}


def mean_of(values: list[float]) -> float | None:
    """Mean over robots; None for an empty list."""
    return float(np.mean(values)) if values else None
