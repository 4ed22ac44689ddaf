"""A run of the solver as a trial of the log's schema."""

import numpy as np

from fishmj.errors import LogError
from fishmj.log import SCHEMA, Trial, numbered
from fishmj.mjcf.geometry import link_centres
from fishmj.mjcf.identity import identity
from fishmj.source import made_by


def trial(run) -> Trial:
    """Of a `Run` so far: commands at the start of each tick, the rest at its end, wrenches as means.

    Raises:
        LogError: nothing was recorded yet.
    """
    if not run.rows:
        raise LogError("oracle run: no tick was finished, nothing to write")
    began, t, cmd, pose, joint, rate, power, raw, whole = (np.array(column) for column in zip(*run.rows, strict=True))
    servo = run.robot.servo
    truth = dict(zip(("x", "y", "yaw", "vx", "vy", "wz"), pose.T, strict=True))
    tables = {
        "cmd": {"t": began, **numbered("c#", cmd)},
        "joint": {"t": t, **numbered("j#", joint), **numbered("w#", rate)},
        "pose": {"t": t, "x": pose[:, 0], "y": pose[:, 1], "yaw": pose[:, 2]},
        "power": {"t": t, "V": np.full(len(t), servo.voltage), "I": (power + servo.idle_power) / servo.voltage},
        "truth": {"t": t, **truth, **numbered("j#", joint), **numbered("k#", rate)},
        "flow": {"t": began, **_flow(run, began, pose, joint)},
        "wrench": {"t": t, **_wrench(whole, "f#x", "f#y", "m#"), **_wrench(raw, "r#x", "r#y", "n#")},
    }
    if run.prescribed:  # what the servos would have drawn is not known
        del tables["power"]
    return Trial(_meta(run, tables), tables)


def _body_frame(run, rates: np.ndarray) -> list[float]:
    """Rates of the reference point (3,) in the tank frame as surge, sway [m/s] and yaw rate [rad/s]."""
    c, s = np.cos(run.first[2]), np.sin(run.first[2])
    return [float(c * rates[0] + s * rates[1]), float(c * rates[1] - s * rates[0]), float(rates[2])]


def _flow(run, began, pose, joint) -> dict:
    """Undisturbed flow at the links' centres at the start of each tick, as columns."""
    flow = run.coupled.fluid.flow
    q = np.concatenate([run.first[None], np.concatenate([pose[:, :3], joint], 1)[:-1]])
    at = link_centres(run.robot, q)
    if flow.rms == 0.0:
        u = np.broadcast_to(flow.mean[:2], at.shape)
    else:
        deep = np.concatenate([at, np.zeros((*at.shape[:2], 1))], -1)
        u = np.stack([flow.at(x, float(run.start + t))[:, :2] for x, t in zip(deep, began, strict=True)])
    return {**numbered("u#x", u[..., 0]), **numbered("u#y", u[..., 1])}


def _meta(run, tables) -> dict:
    """What a reader must know about the run."""
    fluid, edge = run.coupled.fluid, run.coupled.boundary
    flow, lattice = fluid.flow, fluid.lattice
    water = {"dx": lattice.dx, "dt": lattice.dt, "shape": list(fluid.shape), "slip": run.coupled.slip}
    water |= {"subgrid": fluid.subgrid, "kernel": edge.width, "passes": edge.passes, "markers": edge.count}
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
        "push": _body_frame(run, run.pushed),
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


def _wrench(values: np.ndarray, x: str, y: str, turn: str) -> dict:
    """(T, L, 6) -> planar columns."""
    return {**numbered(x, values[:, :, 0]), **numbered(y, values[:, :, 1]), **numbered(turn, values[:, :, 5])}
