"""The boxes round the markers of every link: which part of the water they span, and how fast their corners move.

    x = p_l + R_l c                                 low and high corner of the upright box round all
    first = round((middle - o) / dx - n / 2)        first of the n cells from o on whose middle lies nearest to the box's
    speed = |u_l + w_l x R_l (c - r_l)|             of corner c, from the twist (u, w) at r_l

All of it is one call of a compiled function (`link_dynamics.py`).
"""

from collections.abc import Sequence

import numpy as np
import warp as wp

from fishmj.lbm_oracle.fluid.storage import matrix3, point3
from fishmj.lbm_oracle.immersed.link_dynamics import Recorded, shared
from fishmj.lbm_oracle.immersed.markers import Markers

wp.set_module_options({"enable_backward": False})


@wp.struct
class Boxes:
    """Of L links, all float64."""

    links: int
    at: wp.array(dtype=wp.float64)  # 24 L, c
    arm: wp.array(dtype=wp.float64)  # 3 L, r
    pose: wp.array(dtype=wp.float64)  # 12 L and more, (p, R)
    twist: wp.array(dtype=wp.float64)  # 6 L
    seen: wp.array(dtype=wp.float64)  # low, high, first, speed
    dx: wp.float64  # of the grid, m
    corner: wp.vec3d  # of the grid, m
    size: wp.vec3d  # n


@wp.kernel
def surround(b: Boxes):
    """One thread: a few hundred multiplications."""
    far, fast = wp.float64(wp.inf), wp.float64(0.0)
    low, high = wp.vec3d(far, far, far), wp.vec3d(-far, -far, -far)
    for l in range(b.links):
        place, turn, r = point3(b.pose, 12 * l), matrix3(b.pose, 12 * l + 3), point3(b.arm, 3 * l)
        u, w = point3(b.twist, 6 * l), point3(b.twist, 6 * l + 3)
        for k in range(8):
            c = point3(b.at, 24 * l + 3 * k)
            x = place + turn * c
            low, high = wp.min(low, x), wp.max(high, x)
            v = u + wp.cross(w, turn * (c - r))
            fast = wp.max(fast, wp.dot(v, v))
    for i in range(3):
        b.seen[i] = low[i]
        b.seen[3 + i] = high[i]
        middle = wp.float64(0.5) * (low[i] + high[i])
        b.seen[6 + i] = wp.rint((middle - b.corner[i]) / b.dx - wp.float64(0.5) * b.size[i])
    b.seen[9] = wp.sqrt(fast)


class Corners:
    """Eight for every link of one body.

    Args:
        at: (L, 8, 3) m, in the frames of the links. centre: (L, 3) m, the points whose twists are known, in the same frames.
    """

    def __init__(self, at: np.ndarray, centre: np.ndarray):
        self.at, self.centre = np.array(at, float), np.array(centre, float)
        self._seen = np.zeros(10)
        self._at: tuple = ()
        self._surround: Recorded | None
        self.set_grid(1.0, (0.0, 0.0, 0.0), (0, 0, 0))

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

    def set_grid(self, dx: float, corner: Sequence[float], size: Sequence[int]) -> None:
        """Cells of dx [m] from `corner` (3,) m on, and how many (3,) there are in the box round all."""
        self._grid, self._surround = (dx, wp.vec3d(*corner), wp.vec3d(*map(float, size))), None

    def look(self, pose: np.ndarray, twist: np.ndarray) -> np.ndarray:
        """Low and high corner [m] of the upright box round all, first cell of the box of cells, greatest speed [m/s], (10,).

        Args:
            pose: links' positions and rotations by rows, (12 L,) and more. twist: (L, 6). Their places in memory are remembered;
                the answer is always written to the same one.
        """
        if self._surround is None or self._at[0] is not pose or self._at[1] is not twist:
            boxes = Boxes()
            boxes.links, boxes.at, boxes.arm = len(self.at), shared(self.at), shared(self.centre)
            boxes.dx, boxes.corner, boxes.size = self._grid
            boxes.pose, boxes.twist, boxes.seen = shared(pose), shared(twist), shared(self._seen)
            self._at, self._surround = (pose, twist), Recorded(surround, boxes)
        self._surround.launch()
        return self._seen
