"""Recorder of `Sim`: one row for each bus tick in the log's schema, and the last states of a run that diverged."""

import tempfile
from dataclasses import asdict
from pathlib import Path

import numpy as np

from fishmj.base.errors import LogError, SimDiverged
from fishmj.base.source import made_by
from fishmj.effects.sites import SensorReadings
from fishmj.engines.extensions import Extensions
from fishmj.log import SCHEMA, Trial, numbered, write_trial
from fishmj.mjcf.identity import identity
from fishmj.mjcf.model import reference_pose

SANE_SPEED, SANE_SPIN = 20.0, 30.0  # m/s, rad/s; logs with larger values are refused, so rescued rows end before them


class Recorder:
    """Collects rows of one `Sim`."""

    def __init__(self, sim):
        self.sim = sim
        self.rows: list[tuple] = []

    def add(self, command, flow, power: float) -> None:
        """Adds a tick: command (J,) and flow (N, 2) at its start, mean servo power over it [W]."""
        sim = self.sim
        joints = sim.data.qpos[-sim.model.nu :] - sim.swimmer.zero
        start = (sim.tick - 1) * sim.robot.timing.bus_dt
        row = (start, sim.data.time, command, sim.pose, joints, sim.data.qvel[-sim.model.nu :].copy(), flow, power)
        self.rows.append(row)

    def trial(self) -> Trial:
        """Trial of the rows: cmd and flow at the start of each tick, the others at its end."""
        if not self.rows:
            raise LogError("Sim.trial: nothing recorded yet; call Sim.step or Sim.run first")
        start, t, cmd, pose, joint, rate, flow, power = (np.array(column) for column in zip(*self.rows, strict=True))
        servo = self.sim.robot.servo
        seen_pose, seen_joint, seen_rate, total = reported(self.sim.added, t, pose, joint, rate, power + servo.idle_power)
        tables = {
            "cmd": {"t": start, **numbered("c#", cmd)},
            "joint": {"t": t, **numbered("j#", seen_joint), **numbered("w#", seen_rate)},
            "pose": {"t": t, "x": seen_pose[:, 0], "y": seen_pose[:, 1], "yaw": seen_pose[:, 2]},
            "power": {"t": t, "V": np.full(len(t), servo.voltage), "I": total / servo.voltage},
            "truth": truth(t, pose, joint, rate),
            "flow": {"t": start, **numbered("u#x", flow[:, :, 0]), **numbered("u#y", flow[:, :, 1])},
        }
        return Trial(meta_of(self.sim), tables)


def reported(added: Extensions, t, pose, joint, rate, power):
    """Sensor readings at the times t (T,): pose (T, 6), joint (T, J), rate (T, J), power (T,), from the true values.

    Delayed readings come from Hermite cubics through samples and rates (power: linear), constant before the first sample.
    """
    if added.active is None:
        return pose, joint, rate, power
    late = {clock: t - np.asarray(added.late(np, added.row, clock, t)) for clock in ("pose", "joint", "power")}
    x, y, yaw = cubic(t, pose[:, :3], pose[:, 3:], late["pose"]).T
    moved = np.stack([np.interp(late["joint"], t, column) for column in rate.T], 1)
    seen = SensorReadings(t, x, y, yaw, cubic(t, joint, rate, late["joint"]), np.interp(late["power"], t, power))
    seen = added.active.measure(np, added.row.tolist(), seen)
    return np.concatenate([np.stack([seen.x, seen.y, seen.yaw], 1), pose[:, 3:]], 1), seen.joint, moved, seen.power


def cubic(t, values, rates, at):
    """Hermite cubic through evenly spaced samples (T, C) with their rates, evaluated at the times `at`."""
    if len(t) < 2:
        return values
    h = (t[-1] - t[0]) / (len(t) - 1)
    place = np.clip((at - t[0]) / h, 0.0, len(t) - 1.0)
    i = np.minimum(place.astype(int), len(t) - 2)
    s = (place - i)[:, None]
    a, b, da, db = values[i], values[i + 1], h * rates[i], h * rates[i + 1]
    return a + s * (da + s * (3 * (b - a) - 2 * da - db + s * (2 * (a - b) + da + db)))


def truth(t, pose, joint, rate) -> dict:
    """Exact state as a table: pose (T, 6), joint and rate (T, J)."""
    names = ("x", "y", "yaw", "vx", "vy", "wz")
    return {"t": t, **dict(zip(names, pose.T, strict=True)), **numbered("j#", joint), **numbered("k#", rate)}


def meta_of(sim) -> dict:
    """Metadata of a simulated trial."""
    flow, listed = sim.flow, [fitted.name for fitted in sim.robot.effects]
    sensors = "joint and pose are exact"
    if listed:
        sensors = f"joint, pose and power through the sensors of the effects {', '.join(listed)}, which may add to latency"
    return {
        "schema": SCHEMA,
        "origin": "synthetic",
        **identity(sim.robot),
        "medium": "air" if sim.water_name == "none" else "water",
        "flow": {**asdict(flow), "known": True},
        "water": sim.water_name,
        **({} if sim.hybrid is None else {"hybrid": sim.hybrid.report()}),
        "root": sim.root,
        "controller": "open loop",
        "excitation": "",
        "replicate_of": "",
        "start": list(sim.start),
        "push": [0.0, 0.0, 0.0],
        "latency": {"pose": 0.0, "command": sim.delay * sim.robot.timing.physics_dt},
        "seed": flow.seed,
        "clock": {name: "simulation" for name in ("cmd", "joint", "pose", "power", "truth", "flow")},
        **made_by("mujoco", "numpy"),
        "source": "fishmj.sim",
        "licence": "Apache-2.0",
        "notes": f"simulated; {sensors}, without sensor noise or camera latency",
    }


def rescue(sim, error: SimDiverged) -> SimDiverged:
    """Adds the last states to the error, and the folder of the trial in which they are saved."""
    states = [(t, q, v, c) for t, q, v, c in sim.recent if np.isfinite(q).all() and np.isfinite(v).all()]
    sane = [s for s in states if np.abs(s[2][:2]).max() < SANE_SPEED and np.abs(s[2][2:]).max() < SANE_SPIN]
    where = ""
    if sane:
        # mkdtemp: a new folder that other users can neither read nor have prepared
        folder = sim.rescue_folder or Path(tempfile.mkdtemp(prefix="fishmj-diverged-")) / "trial"
        t, q, v, ctrl = (np.array(column) for column in zip(*sane, strict=True))
        n = sim.model.nu
        pose = np.array([_pose_at(sim, *row) for row in zip(q, v, strict=True)])
        meta = meta_of(sim) | {"notes": f"the last {len(t)} physics steps before: {error}"}
        meta |= {"diverged": {"term": error.term, "link": error.link}}
        tables = {"truth": truth(t, pose, q[:, -n:] - sim.swimmer.zero, v[:, -n:]), "cmd": {"t": t, **numbered("c#", ctrl)}}
        where = f"; the last {len(t)} states are in {write_trial(folder, Trial(meta, tables), overwrite=True)}"
    return SimDiverged(f"{error}{where}", time=error.time, term=error.term, link=error.link, states=states)


def _pose_at(sim, qpos, qvel):
    sim.data.qpos[:], sim.data.qvel[:] = qpos, qvel
    return reference_pose(sim.model, sim.data)
