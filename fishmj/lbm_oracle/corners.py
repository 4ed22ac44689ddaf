"""The boxes round the markers of every link: which part of the water they span, and how fast their corners move.

    ends   = max over links and corners of (-x, x),   x = p_l + R_l c        low and high corner of the upright box round all
    speed  = |R_l^T u_l + (R_l^T w_l) x (c - r_l)|                           of corner c, from the twist (u, w) at r_l

Both are linear in the numbers of a pose or a twist, so that each is one product with a matrix made once.
"""

import numpy as np

from fishmj.lbm_oracle.markers import Markers

CROSS = np.zeros((3, 3, 3))  # w x r = sum_ai w_a r_i CROSS[a, i]
CROSS[[0, 1, 2], [1, 2, 0], [2, 0, 1]], CROSS[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = 1.0, -1.0


class Corners:
    """Eight for every link.

    Args:
        at: (L, 8, 3) m, in the frames of the links. centre: (L, 3) m, the points whose twists are known, in the same frames.

    Attributes:
        reach: (6 L, 24 L) velocities of the corners from the twists, both in the axes of the links.
    """

    def __init__(self, at: np.ndarray, centre: np.ndarray):
        self.at, links = at, len(at)
        self.reach = np.zeros((6 * links, 24 * links))
        ends = np.zeros((links, 8, 6, links, 12))  # (-x, x) from the frames (L, 12): position, rotation by rows
        reach, arm = self.reach.reshape(links, 6, links, 8, 3), at - centre[:, None]
        for i in range(links):
            reach[i, :3, i], reach[i, 3:, i] = np.eye(3)[:, None], np.einsum("aij,ki->akj", CROSS, arm[i])
            for axis in range(3):
                ends[i, :, 3 + axis, i, axis], ends[i, :, 3 + axis, i, 3 + 3 * axis : 6 + 3 * axis] = 1.0, at[i]
        ends[:, :, :3] = -ends[:, :, 3:]
        self._ends = ends.reshape(-1, 12 * links)

    @classmethod
    def of(cls, markers: Markers, centre: np.ndarray) -> "Corners":
        """Round the markers of every link of which `centre` (L, 3) has a row; a link without markers has its origin."""
        at = np.zeros((len(centre), 8, 3))
        for i in range(len(centre)):
            mine = markers.rest[(markers.before == i)]
            if len(mine):
                ends = np.stack([mine.min(0), mine.max(0)])
                at[i] = [[ends[a, 0], ends[b, 1], ends[c, 2]] for a in (0, 1) for b in (0, 1) for c in (0, 1)]
        return cls(at, centre)

    def bounds(self, frames: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Low and high corner (3,) m of the upright box round all of them, links at `frames` (12 L,)."""
        ends = np.maximum.reduce(self._ends.dot(frames).reshape(-1, 6))
        return -ends[:3], ends[3:]
