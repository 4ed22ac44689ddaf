"""Metadata in a log about the flow-solver run that made it."""

import numpy as np

from fishmj.base.source import made_by
from fishmj.lbm_oracle.refined.refined_fluid import RefinedFluid
from fishmj.log import SCHEMA
from fishmj.log.trial_check import shipped_bounds
from fishmj.mjcf.identity import identity


def about(run, tables: dict) -> dict:
    """Metadata of the run: water, immersed boundary, robot, flow and push."""
    fluid, edge = run.coupled.fluid, run.coupled.boundary
    flow, lattice = fluid.flow, fluid.lattice
    (x, y, turn), c, s = run.pushed, np.cos(run.first[2]), np.sin(run.first[2])
    water = {"dx": lattice.dx, "dt": lattice.dt, "shape": list(fluid.extent), "slip": run.coupled.slip}
    water |= {"subgrid": fluid.subgrid, "kernel": edge.width, "passes": edge.passes, "markers": edge.count}
    water["boundary"] = run.boundary_name
    if isinstance(fluid, RefinedFluid):
        coarse = fluid.outer
        water["coarse"] = {"dx": coarse.lattice.dx, "dt": coarse.lattice.dt, "shape": list(coarse.extent)}
    return {
        "schema": SCHEMA,
        "origin": "synthetic",
        **identity(run.robot),
        "medium": "water",
        "flow": {"speed": flow.speed, "direction": flow.direction, "turbulence": flow.turbulence}
        | {"intensity": flow.intensity, "seed": flow.seed, "known": True},
        "excitation": "prescribed joints" if run.prescribed else "servos",
        "replicate_of": "",
        "controller": "open loop",
        "start": run.first[:3].tolist(),
        "push": [float(c * x + s * y), float(c * y - s * x), float(turn)],  # surge, sway m/s and yaw rate rad/s
        "latency": {"pose": 0.0, "command": run.delay * run.coupled.body.dt},
        "water": "lbm",
        "oracle": {**water, "device": str(fluid.device), "tethered": run.tethered}
        | {"refined_ticks": run.refined, "stopped": run.stopped},
        "seed": flow.seed,
        "clock": {name: "simulation" for name in tables},
        **made_by("mujoco", "numpy", "warp-lang"),
        "source": "fishmj.lbm_oracle",
        "licence": "Apache-2.0",
        "notes": "simulated; joint and pose are exact, without sensor noise or camera latency. wrench: means over a tick; r"
        " and n are the raw exchange",
    }


def plausible(rows: list[tuple]) -> list[tuple]:
    """Rows of a run without the last ones that are faster than a log allows; at least one row."""
    last, bounds = len(rows), shipped_bounds()
    while last > 1:
        pose, rate = rows[last - 1][3], rows[last - 1][5]
        if max(abs(pose[5]), np.abs(rate).max(initial=0.0)) < bounds.rate and np.abs(pose[3:5]).max() < bounds.speed:
            break
        last -= 1
    return rows[:last]
