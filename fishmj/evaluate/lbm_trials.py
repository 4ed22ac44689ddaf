"""The judge in the flow solver: the same trials, controllers and figures, the water solved instead of modelled.

Trials run in groups of tanks side by side on one device. Every finished trial is kept in <folder>/lbm as one npz, so a judgement
that is interrupted goes on with the next trial; a file made with another controller, robot or box of water is not used.
"""

import json
from collections.abc import Callable
from dataclasses import asdict, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fishmj import console, store
from fishmj.calib import calib_folder
from fishmj.evaluate.metrics import Result
from fishmj.evaluate.protocol import Trials
from fishmj.evaluate.run_trials import run
from fishmj.mjcf.description import Robot

KEPT = "lbm"  # folder of finished trials
ARRAYS = ("pose", "velocity", "joint", "rate", "power", "command", "obs", "action", "distance", "left")


class Variation(NamedTuple):
    """How trials are run that ought to come out the same: every fish shifted by so many cells, and time steps in one of the
    domain's."""

    name: str = ""
    nudge: tuple[float, float] = (0.0, 0.0)
    finer: int = 1


UNCHANGED = Variation()


def judge(
    brain,
    robot: Robot,
    trials: Trials,
    folder: Path | None = None,
    *,
    domain: str = "paper",
    slip: float = 1.0,
    device: str = "auto",
    tanks: int = 1,
    variation: Variation = UNCHANGED,
    progress: Callable[[int], None] = lambda done: None,
) -> Result:
    """Judge one controller in the solver, `tanks` trials at a time.

    Args:
        folder: where finished trials are kept and looked for; None keeps nothing. variation: the trials are run so.
        progress: called with the number of control steps done, summed over trials.

    Raises:
        OracleUnstable, ConfigError: the set-up would not run.
    """
    from fishmj.engines.lbm import Engine

    steps = round(trials.duration / robot.timing.control_dt)
    label = "_".join(filter(None, (fingerprint(brain, robot, trials, domain, slip), variation.name)))
    box: dict[str, Any] = {"domain": domain, "slip": slip, "device": device, "finer": variation.finer}
    paths = [None if folder is None else folder / KEPT / f"{name_of(brain, item)}_{label}.npz" for item in trials.items]
    found: dict[int, dict] = {i: store.read_npz(p) for i, p in enumerate(paths) if p is not None and p.is_file()}
    waiting = [i for i in range(len(trials)) if i not in found]
    for group in (waiting[k : k + tanks] for k in range(0, len(waiting), tanks)):
        some = replace(trials, items=tuple(trials.items[i] for i in group))
        engine = Engine(robot, some.flows(), **box)
        done, many = len(found) * steps, len(group)
        x, y = (cells * engine.domain.dx for cells in variation.nudge)
        told = lambda k: progress(done + many * k)  # noqa: B023, E731  called at once
        result = run(brain, robot, some, engine, shift=(x, y), progress=told)
        for row, i in enumerate(group):
            found[i] = {key: getattr(result, key)[row] for key in ARRAYS if getattr(result, key) is not None}
            found[i] |= {"t": result.t, "target": result.target[row]}
            if why := engine.stopped[row]:
                found[i] = ended(found[i], why, engine.ticks[row])
                console.warn(f"{name_of(brain, trials.items[i])}: truncated: {why}")
            if (path := paths[i]) is not None:
                store.write_npz(path, found[i])
    return merged(brain, robot, trials, f"tanks, {domain}, slip {slip:g}", [found[i] for i in range(len(trials))])


def ended(row: dict, why: str, ticks: int) -> dict:
    """The arrays of a trial whose tank stopped after `ticks` bus ticks; the fish was left where it was.

    It counts as one that left the domain at the next tick. Where its water or its motion failed, nobody knows how far from the
    target it would have been: NaN, so that no figure over that time looks better than it is.
    """
    left, distance = min(int(row["left"]), ticks + 1), row["distance"].copy()
    if not why.startswith("left_domain"):
        distance[left:] = np.nan
    return row | {"left": np.array(left), "distance": distance, "stopped": np.array(why)}


def merged(brain, robot: Robot, trials: Trials, engine: str, rows: list[dict]) -> Result:
    """One result from the arrays of every trial."""
    join: dict[str, Any] = {key: np.stack([row[key] for row in rows]) if key in rows[0] else None for key in ARRAYS}
    target = np.stack([row["target"] for row in rows])
    return Result(
        controller=brain.name,
        robot=robot,
        trials=trials,
        engine=engine,
        policy_sha256=getattr(brain, "sha256", ""),
        t=rows[0]["t"],
        target=target,
        **join,
    )


def name_of(brain, item) -> str:
    """File name of one trial."""
    return f"{brain.name}_u{item.speed:g}_los{round(np.degrees(item.los)):03d}_r{item.repeat}"


def fingerprint(brain, robot: Robot, trials: Trials, domain: str, slip: float) -> str:
    """Eight characters that change with anything that would change a trial's outcome."""
    from fishmj.engines.lbm import HELD

    what = {
        "controller": [brain.name, getattr(brain, "sha256", store.sha256(calib_folder() / "controllers.toml"))],
        "robot": repr(robot),
        "trials": {k: v for k, v in asdict(replace(trials, items=())).items() if k != "items"},
        "seed": trials.items[0].seed[:2],
        "water": [domain, slip, HELD],
    }
    return sha256(json.dumps(what, sort_keys=True, default=str).encode()).hexdigest()[:8]
