"""Log of a run in the flow solver: its tables, and metadata about the water and the robot."""

import numpy as np

from fishmj.base.errors import LogError
from fishmj.base.source import made_by
from fishmj.lbm_oracle.refined.refined_fluid import RefinedFluid
from fishmj.log import SCHEMA, Trial, numbered
from fishmj.log.trial_check import shipped_bounds
from fishmj.mjcf.description import Robot
from fishmj.mjcf.geometry import link_centres
from fishmj.mjcf.identity import identity
from fishmj.water.flow import Flow


def trial_of(run) -> Trial:
    """All ticks of a run so far in the log's schema, as `Run.trial`. Raises LogError if no tick was finished."""
    if not run.rows:
        raise LogError("oracle run: no tick was finished, nothing to write")
    rows = plausible_rows(run.rows) if run.stopped else run.rows
    began, t, cmd, pose, joint, rate, power, raw, whole = (np.array(column) for column in zip(*rows, strict=True))
    q, v = np.concatenate([pose[:, :3], joint], 1), np.concatenate([pose[:, 3:], rate], 1)
    before = np.concatenate([run.first[None], q[:-1]])  # at the start of each tick
    flow = flow_at_links(run.coupled.fluid.flow, run.robot, before, run.start + began)
    servo, planar = run.robot.servo, [0, 1, 5]
    # with prescribed joints the servos' power is not known
    drawn = None if run.prescribed else (servo.voltage, (power + servo.idle_power) / servo.voltage)
    tables = log_tables(began, t, cmd, q, v, flow, whole[:, :, planar], raw[:, :, planar], drawn)
    return Trial(metadata_of(run, tables), tables)


def log_tables(began, t, command, q, v, flow, whole, raw, power: tuple | None = None) -> dict[str, dict[str, np.ndarray]]:
    """Tables of the log's schema from T ticks of a fish with J joints and L links.

    Args:
        began, t: start and end of each tick, s. command: (T, J) rad. q, v: (T, 3 + J) at its end.
        flow: (T, L, 2) m/s at its start. power: voltage V, and current A (T,), if servos drove the joints.
        whole, raw: (T, L, 3) N, N, N m, means, with and without the interior water.
    """
    place, joint, rate = dict(zip(("x", "y", "yaw"), q[:, :3].T, strict=True)), q[:, 3:], v[:, 3:]
    wrench: dict[str, np.ndarray] = {}
    for names, values in ((("f#x", "f#y", "m#"), whole), (("r#x", "r#y", "n#"), raw)):
        for name, column in zip(names, np.moveaxis(values, -1, 0), strict=True):
            wrench |= numbered(name, column)
    truth = place | dict(zip(("vx", "vy", "wz"), v[:, :3].T, strict=True)) | numbered("j#", joint) | numbered("k#", rate)
    return {
        "cmd": {"t": began, **numbered("c#", command)},
        "joint": {"t": t, **numbered("j#", joint), **numbered("w#", rate)},
        "pose": {"t": t, **place},
        **({} if power is None else {"power": {"t": t, "V": np.full(len(t), power[0]), "I": power[1]}}),
        "truth": {"t": t, **truth},
        "flow": {"t": began, **numbered("u#x", flow[..., 0]), **numbered("u#y", flow[..., 1])},
        "wrench": {"t": t, **wrench},
    }


def flow_at_links(flow: Flow, robot: Robot, q: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Undisturbed flow at the links' centres, (T, N, 2) m/s, for states q (T, 3 + J) at times t (T,) s."""
    points = link_centres(robot, q)
    if flow.rms == 0.0:
        return np.broadcast_to(flow.mean[:2], points.shape).copy()
    deep = np.concatenate([points, np.zeros((*points.shape[:2], 1))], -1)
    return np.stack([flow.at(where, float(when))[:, :2] for where, when in zip(deep, t, strict=True)])


def metadata_of(run, tables: dict) -> dict:
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


def plausible_rows(rows: list[tuple]) -> list[tuple]:
    """Rows of a run without the last ones that are faster than a log allows; at least one row."""
    last, bounds = len(rows), shipped_bounds()
    while last > 1:
        pose, rate = rows[last - 1][3], rows[last - 1][5]
        if max(abs(pose[5]), np.abs(rate).max(initial=0.0)) < bounds.rate and np.abs(pose[3:5]).max() < bounds.speed:
            break
        last -= 1
    return rows[:last]
