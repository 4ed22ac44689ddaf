"""Pictures of a running episode: MuJoCo's renderer where the machine has OpenGL, else a drawn top view. (480, 480, 3) uint8."""

import os
import sys
from typing import Any

import numpy as np

from fishmj.calib import constant
from fishmj.mjcf.description import Robot

SIDE = 480  # pixels
BACKENDS = ("egl", "osmesa")


class Picture:
    """Draws one fish. `kind` is "mujoco" or "drawn"."""

    def __init__(self, robot: Robot):
        self._renderer: Any = None
        self.kind = "mujoco" if can_render() else "drawn"
        if self.kind == "mujoco":
            import mujoco

            from fishmj.tasks.mjcf_scene import build_scene

            self.model = build_scene(robot).compile()
            self.data = mujoco.MjData(self.model)
            self._renderer = mujoco.Renderer(self.model, SIDE, SIDE)
        else:
            from fishmj.mjcf.from_above import FromAbove
            from fishmj.mjcf.skin import skin

            bound = constant("task", "bound")
            self.view = FromAbove((SIDE, SIDE), (0.0, 0.0), SIDE / (2 * bound), (SIDE / 2, SIDE / 2))
            self.skin, self.still = skin(robot, spacing=0.012, around=12, smooth=True), self.view.water()

    def draw(self, q, target) -> np.ndarray:
        """The fish at q (nv,) and its target (2,), seen from above."""
        return self._rendered(q, target) if self._renderer else self._drawn(q, target)

    def close(self) -> None:
        """Free the OpenGL context."""
        if self._renderer:
            self._renderer.close()
            self._renderer = None

    def _rendered(self, q, target) -> np.ndarray:
        import mujoco

        self.data.qpos[:], self.data.mocap_pos[0, :2] = q, target
        mujoco.mj_forward(self.model, self.data)
        self._renderer.update_scene(self.data, camera="top")
        return self._renderer.render().copy()

    def _drawn(self, q, target) -> np.ndarray:
        image, radius = self.still.copy(), constant("protocol", "arrival_radius")
        self.view.target(image, target, radius, float(np.hypot(*(np.asarray(q)[:2] - target))) <= radius)
        self.view.fish(image, np.asarray(q, float), self.skin)
        return np.ascontiguousarray(image[:, :, ::-1])


def can_render() -> bool:
    """Whether MuJoCo can open an OpenGL context here: MUJOCO_GL names a headless one, or there is a screen."""
    return os.environ.get("MUJOCO_GL", "").lower() in BACKENDS or "DISPLAY" in os.environ or sys.platform == "darwin"
