"""Pictures of a running episode, drawn as a film of its replay is; works without a screen. (480, 480, 3) uint8."""

import numpy as np

from fishmj.calib import constant
from fishmj.mjcf.description import Robot
from fishmj.mjcf.from_above import FromAbove, coarse_skin

SIDE = 480  # pixels


class Picture:
    """Draws one fish in the task's tank. Raises MissingExtra without OpenCV."""

    def __init__(self, robot: Robot):
        self.view = FromAbove((SIDE, SIDE), (0.0, 0.0), SIDE / (2 * constant("task", "bound")), (SIDE / 2, SIDE / 2))
        self.skin, self.still = coarse_skin(robot), self.view.water()

    def draw(self, q, target) -> np.ndarray:
        """The fish at q (nv,) and its target (2,), seen from above."""
        image = self.still.copy()
        self.view.swimmer(image, np.asarray(q, float), np.asarray(target, float), self.skin)
        return np.ascontiguousarray(image[:, :, ::-1])
