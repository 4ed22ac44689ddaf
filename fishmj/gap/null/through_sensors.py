"""Null runs through the sensors of a candidate: a turned camera shows what a fish swam too far ahead as too far to the side.

    r_i' = g(p + r_i) - g(p)      g: what the measurement effects of a parameter row make of a pose, p: the pose predicted

The other effects leave the null runs as they are: what they change in them is a matter of the constants (likelihood.py).
"""

import numpy as np

from fishmj.effects.sites import Measured

SENSORS = ("pose", "placed")


def as_sensed(model, layout, row: np.ndarray, shown: np.ndarray, residuals: np.ndarray) -> np.ndarray:
    """(n, m) residuals of null runs as the sensors of a parameter row show them. shown: (m,) what the row predicts."""
    values = row[len(model.constants) :]
    out = residuals.copy()
    for i in range(len(layout.records)):
        for sensor in SENSORS:
            where = [b.where for b in layout.blocks if b.record == i and b.sensor == sensor]
            if where:
                pose = np.stack([shown[w] for w in where])
                run = pose[:, None] + np.stack([residuals[:, w] for w in where])
                moved = camera_view(model.active, values, run) - camera_view(model.active, values, pose[:, None])
                for w, change in zip(where, moved, strict=True):
                    out[:, w] = change
    return out


def changes_sensing(model, row: np.ndarray) -> bool:
    """Whether a parameter row has an effect on what the sensors make of the fish."""
    measuring = [x for x in model.active.effects if x.measure]
    return any(row[model.index(x.name, p.name)] != p.null for x in measuring for p in x.parameters if not p.shape)


def camera_view(active, values, pose: np.ndarray) -> np.ndarray:
    """(3, n, k) what a camera makes of poses (3, n, k)."""
    none = np.zeros((1, 1))
    seen = Measured(t=none, x=pose[0], y=pose[1], yaw=pose[2], joint=np.zeros((1, 1, active.joints)), power=none)
    seen = active.measure(np, [np.full((1, 1), v) for v in values], seen)
    return np.stack([np.broadcast_to(a, pose[0].shape) for a in (seen.x, seen.y, seen.yaw)])
