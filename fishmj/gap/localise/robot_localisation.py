"""Place of the gap of a robot in MJCF: shares of the residual by joint, by the joint's motion, and by time within a log.

share = sum max(0, (r / floor)^2 - 1) of a part / the same of all        r: measured minus predicted by the model as it is
"""

from typing import NamedTuple

import numpy as np

from fishmj.gap.records.records import ResidualLayout
from fishmj.gap.wording import percent, title

MOTIONS = ("standing", "slow", "moving", "fast")
EDGES = (0.05, 0.3, 1.0)  # of the joint's usual rate, between them
THIRDS = ("first third", "second third", "last third")


class RobotLocalisation(NamedTuple):
    """Shares that sum to 1, before anything is added. joints: by joint; motions: (joint, motion); thirds: of each log."""

    joints: dict[str, float]
    motions: dict[str, dict[str, float]]
    thirds: dict[str, float]

    @property
    def text(self) -> str:
        """The shares in a line."""
        if not any(self.joints.values()):
            return "no residual is above the floor"
        parts = []
        for joint, share in sorted(self.joints.items(), key=lambda pair: -pair[1]):
            most = max(self.motions[joint], key=lambda motion: self.motions[joint][motion])
            parts.append(f"{title(joint)} {percent(share)} (most while {most}: {percent(self.motions[joint][most])})")
        times = ", ".join(f"{name} {percent(share)}" for name, share in self.thirds.items())
        return f"where the residual is: {', '.join(parts)}; {times}"


def localise_robot(layout: ResidualLayout, residual: np.ndarray, scale: np.ndarray, rates: dict[str, float]) -> RobotLocalisation:
    """Shares of a residual (m,). scale: (m,) floor. rates: usual rate of each joint."""
    excess = np.maximum((residual / scale) ** 2 - 1.0, 0.0)
    measured = layout.measured
    whole = max(float(excess.sum()), 1e-300)
    joints = dict.fromkeys(rates, 0.0)
    motions = {joint: dict.fromkeys(MOTIONS, 0.0) for joint in rates}
    thirds = dict.fromkeys(THIRDS, 0.0)
    for b in layout.blocks:
        mine = excess[b.where] / whole
        record = layout.records[b.record]
        segment = np.searchsorted(record.starts, b.t, side="right")
        rate = np.zeros(len(b.t))
        for s in np.unique(segment):
            rows = segment == s
            if rows.sum() > 1:
                rate[rows] = np.gradient(measured[b.where][rows], b.t[rows])
        kind = np.searchsorted(EDGES, np.abs(rate) / max(rates[b.channel], 1e-12))
        third = np.minimum((3 * b.t / max(float(b.t[-1]), 1e-9)).astype(int), 2)
        joints[b.channel] += float(mine.sum())
        for k, motion in enumerate(MOTIONS):
            motions[b.channel][motion] += float(mine[kind == k].sum())
        for k, name in enumerate(THIRDS):
            thirds[name] += float(mine[third == k].sum())
    return RobotLocalisation(joints, motions, thirds)
