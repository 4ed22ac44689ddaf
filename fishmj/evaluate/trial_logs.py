"""Trials of a judgement as logs: one trial in the log's schema, trial folders."""

import json
from dataclasses import asdict, replace
from math import ceil
from pathlib import Path

import numpy as np

from fishmj.base.source import made_by
from fishmj.base.store import Manifest
from fishmj.evaluate.metrics import Result
from fishmj.evaluate.protocol import ANGLE, EIGHT, HOLD
from fishmj.log import SCHEMA, Trial, numbered, write_trial
from fishmj.mjcf.identity import identity
from fishmj.tasks.sensing import NOTE, logged, logged_meta
from fishmj.water.dynamics.planar_chain import chain_of
from fishmj.water.flow import sample, stack

MARKS = {HOLD: "STATION HOLDING", ANGLE: "ANGLE OF ATTACK", EIGHT: "FIGURE EIGHT"}
BLOCK = 200  # ticks whose flow is looked up at once


def trial_of(r: Result, i: int) -> Trial:
    """Trial i of a result in the log's schema, origin "synthetic".

    `joint` and `pose` are the readings of encoders and tracker (`tasks.sensing`), `truth` is the exact state. A fish whose
    tank stopped is logged up to that time.
    """
    ticks = ended(r, i)
    t, start, step = r.t[1 : ticks + 1], r.t[:ticks], r.robot.timing.control_dt
    item, flow = r.trials.items[i], r.trials.flows()[i]
    decisions = np.arange(ceil(ticks / round(step / r.robot.timing.bus_dt))) * step
    pose, velocity, joint, rate = (x[i, 1 : ticks + 1] for x in (r.pose, r.velocity, r.joint, r.rate))
    params, camera = replace(r.trials, items=(item,)).fish(r.robot)
    motion = (start, t, r.command[i, :ticks], pose, velocity, joint, rate, r.power[i, :ticks])
    tables = {
        **logged(r.robot, *motion, params, camera, start=r.pose[i, 0], random=item.draw(4), strength=r.trials.noise),
        "obs": {"t": decisions, **numbered("o#", r.obs[i, : len(decisions)])},
        "target": _targets(r, i, decisions),
        "flow": {"t": start, **_flow_at_links(r, i, ticks)},
    }
    if r.action is not None:
        tables["action"] = {"t": decisions, **numbered("a#", r.action[i, : len(decisions)])}
    meta = {
        "schema": SCHEMA,
        "origin": "synthetic",
        **identity(r.robot),
        "timing": {key: getattr(r.robot.timing, key) for key in ("control_dt", "command_path")},  # of options, too
        "medium": "water",
        "flow": {**asdict(flow), "known": True},
        "water": r.water,
        **({} if r.corrections is None else {"hybrid": corrections(r)[i]}),
        "root": "planar",
        "engine": r.engine,
        "controller": r.controller,
        "policy_sha256": r.policy_sha256,
        **({"policy": r.policy} if r.policy else {}),
        "target": r.target[i].tolist(),
        "seed": int(item.seed[0]),
        "condition": {"speed": item.speed, "los_deg": round(float(np.degrees(item.los)), 3), "repeat": item.repeat},
        "randomisation": r.trials.randomisation,
        "excitation": MARKS[r.trials.task].lower(),
        **({"left_out": list(r.left_out)} if r.left_out else {}),
        **logged_meta(r.robot, tables, params, camera, r.pose[i, 0], r.trials.noise),
        **made_by("numpy", "mujoco"),
        "source": "fishmj.evaluate",
        "licence": "Apache-2.0",
        "notes": NOTE if ticks == len(r.t) - 1 else f"{NOTE}; the tank stopped after {ticks * r.robot.timing.bus_dt:.2f} s",
    }
    return Trial(meta, tables)


def _targets(r: Result, i: int, decisions) -> dict:
    """Target at each decision; one row if it stays."""
    if r.trials.task != EIGHT:
        return {"t": np.zeros(1), "x": r.target[i, :1], "y": r.target[i, 1:]}
    x, y = replace(r.trials, items=(r.trials.items[i],)).targets(decisions)[0].T
    return {"t": decisions, "x": x, "y": y}


def name_of(r: Result, i: int) -> str:
    """Folder name of trial i: `dob_u0.2_los045_r1`."""
    return f"{r.controller}_{r.trials.items[i].name}"


def write_logs(r: Result, folder: Path) -> list[Path]:
    """Writes every trial as a folder under `folder`, which with its manifest is a data set."""
    written = [write_trial(folder / name_of(r, i), trial_of(r, i), overwrite=True) for i in range(len(r.trials))]
    Manifest.of(folder, {"source": "fishmj.evaluate", "licence": "Apache-2.0"}).write(folder)
    return written


def ended(r: Result, i: int) -> int:
    """Number of bus ticks swum in trial i: all, or in the flow solver those before its tank stopped."""
    last = len(r.t) - 1
    if r.water != "lbm" or r.left[i] > last:
        return last
    state = np.concatenate([r.pose[i], r.joint[i]], -1)
    moved = np.flatnonzero((np.diff(state, axis=0) != 0).any(-1))
    return int(moved[-1]) + 1 if len(moved) else last


def _flow_at_links(r: Result, i: int, ticks: int) -> dict:
    """Water velocity at the link centres at the start of each tick, as columns."""
    from fishmj.engines.planar import link_centres  # JAX, which the tables do without

    current, chain = stack([r.trials.flows()[i]]), chain_of(r.robot)
    q = np.concatenate([r.pose[i], r.joint[i]], -1)[:ticks]
    rows = []
    for first in range(0, len(q), BLOCK):
        some = q[first : first + BLOCK]
        tick = first + np.arange(len(some))
        many = current._replace(
            **{name: np.repeat(getattr(current, name), len(some), 0) for name in ("mean", "rms", "row", "offset", "turn")}
        )
        rows.append(sample(np, many, link_centres(np, chain, some), tick)[0])
    u = np.concatenate(rows)
    return {**numbered("u#x", u[:, :, 0]), **numbered("u#y", u[:, :, 1])}


def corrections(r: Result) -> list[dict]:
    """Corrections by the solver in each trial (`fishmj.engines.hybrid.Hybrid.report`); empty for waters other than hybrid."""
    return [] if r.corrections is None else [json.loads(str(text)) for text in r.corrections]
