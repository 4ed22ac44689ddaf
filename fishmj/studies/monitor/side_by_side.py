"""Blocks of many swims at once: the monitor's own observer on arrays, one fish a column. Equal to it fish by fish (tests)."""

from collections.abc import Sequence
from math import cos, sin

import numpy as np

from fishmj.deploy.monitor import BLOCK, RUN_IN, Tables
from fishmj.deploy.monitor_prediction import Observer, Seen, channels
from fishmj.deploy.monitor_rows import Ticks
from fishmj.mjcf.description import Robot

Blocks = list[tuple[float, dict]]  # (s, block) of one swim


def blocks_of(robot: Robot, swims: Sequence[Tables], flows: Sequence[tuple[float, float]]) -> list[Blocks]:
    """Blocks of every swim, in float32: hours of them lie side by side. Tables have no pauses; flows: (m/s, rad)."""
    seen = []
    for tables in swims:
        ticks = Ticks(robot)
        ticks.add(tables)
        seen.append([(t, s) for t, s, _ in ticks.taken()])
    count, joints = min(map(len, seen)), robot.n_joints
    stream = np.array([(speed * cos(angle), speed * sin(angle)) for speed, angle in flows]).T
    observer = Observer(robot, np, (stream[0], stream[1]))
    probes = channels(joints)
    length, run_in = round(BLOCK / robot.timing.bus_dt), round(RUN_IN / robot.timing.bus_dt)
    out: list[Blocks] = [[] for _ in swims]
    kept: list = []
    for k in range(count):
        rows = [s[k][1] for s in seen]
        now = Seen(
            target=np.moveaxis(np.array([r.target for r in rows]), 0, -1),
            joint=np.array([r.joint for r in rows]).T,
            pose=np.array([r.pose for r in rows]).T,
            power=np.array([r.power for r in rows]),
        )
        if k == 0:
            observer.begin(now)
            continue
        innovation = observer.step(now)
        if k <= run_in:
            continue
        kept.append(innovation)
        if len(kept) < length:
            continue
        for name in probes:
            e = np.array([i.error[name] for i in kept], np.float32)
            phi = np.array([[np.broadcast_to(p, e[0].shape) for p in i.probes[name]] for i in kept], np.float32)
            for b in range(len(swims)):
                if name == next(iter(probes)):
                    out[b].append((seen[b][k][0], {}))
                out[b][-1][1][name] = (e[:, b], phi[:, :, b])
        kept = []
    return out
