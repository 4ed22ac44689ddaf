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

            from fishmj.tasks.scene import build_scene

            self.model = build_scene(robot).compile()
            self.data = mujoco.MjData(self.model)
            self._renderer = mujoco.Renderer(self.model, SIDE, SIDE)
        else:
            from fishmj.mjcf.skin import skin

            self.skin = skin(robot, spacing=0.02, around=12)

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
        import cv2

        from fishmj.mjcf.skin import posed

        bound = constant("task", "bound")
        pixel = lambda p: np.round(  # noqa: E731
            np.stack([p[..., 0] + bound, bound - p[..., 1]], -1) * SIDE / (2 * bound)
        ).astype(np.int32)
        image = np.full((SIDE, SIDE, 3), (200, 178, 140), np.uint8)
        radius = round(constant("protocol", "arrival_radius") * SIDE / (2 * bound))
        cv2.circle(image, pixel(np.asarray(target)).tolist(), radius, (60, 60, 220), -1, cv2.LINE_AA)
        points = posed(self.skin, np.asarray(q, float))
        order = np.argsort(points[self.skin.faces, 2].mean(-1))  # from below upwards
        corners = pixel(points[:, :2])
        colours = np.round(255 * self.skin.colour[self.skin.faces].mean(1)[:, ::-1])
        for face in order:
            cv2.fillConvexPoly(image, corners[self.skin.faces[face]], colours[face].tolist(), cv2.LINE_AA)
        return np.ascontiguousarray(image[:, :, ::-1])


def can_render() -> bool:
    """Whether MuJoCo can open an OpenGL context here: MUJOCO_GL names a headless one, or there is a screen."""
    return os.environ.get("MUJOCO_GL", "").lower() in BACKENDS or "DISPLAY" in os.environ or sys.platform == "darwin"
