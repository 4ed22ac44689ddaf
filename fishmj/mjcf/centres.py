"""Where the middles of the links are."""

import numpy as np

from fishmj.mjcf.description import Robot
from fishmj.mjcf.geometry import geometry_of


def link_centres(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Link centres (T, N, 2) m of planar states q (T, 3 + J) m, rad."""
    geometry = geometry_of(robot)
    x, y, heading = q[:, 0], q[:, 1], q[:, 2]
    centres = []
    for i in range(geometry.n_links):
        if i:
            back = geometry.joint[i - 1]
            x, y = x + back * np.cos(heading), y + back * np.sin(heading)
            heading = heading + q[:, 2 + i]
        mid = geometry.span[i].mean()
        centres.append(np.stack([x + mid * np.cos(heading), y + mid * np.sin(heading)], -1))
    return np.stack(centres, 1)
