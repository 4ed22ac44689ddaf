"""Fish, target and tank seen from above, drawn by OpenCV on the CPU: for films, stills and pictures of a running episode."""

from typing import Any

import numpy as np

from fishmj.base.calib import constant
from fishmj.base.errors import MissingExtra
from fishmj.mjcf.description import Robot
from fishmj.mjcf.skin import Skin, posed, skin

WATER, LINE, METRE = (150, 112, 36), (176, 140, 66), (206, 180, 122)  # BGR, as all colours here
INSIDE, OUTSIDE = (106, 212, 63), (29, 138, 240)  # the target's ring: reached or not
TILE = 0.25  # m
FINE = 3  # fish are drawn this many times larger, then averaged down
SUN = np.array([-0.35, 0.3, 0.89])


class FromAbove:
    """Draws on images (H, W, 3) uint8 BGR, north (+y) up. Raises MissingExtra without OpenCV.

    Args:
        size: W, H in pixels. middle: pixel (2,) of the world's `centre` (2,) [m]. scale: pixels a metre.
    """

    def __init__(self, size: tuple[int, int], centre, scale: float, middle):
        self.cv2, self.size, self.scale = opencv(), size, scale
        self.centre, self.middle = np.asarray(centre, float), np.asarray(middle, float)

    def pixel(self, xy) -> np.ndarray:
        """World (.., 2) m -> image (.., 2) px."""
        return self.middle + (np.asarray(xy, float) - self.centre) * [self.scale, -self.scale]

    def water(self) -> np.ndarray:
        """A picture of the empty tank, a line every tile and a bright one every metre."""
        image = np.full((self.size[1], self.size[0], 3), WATER, np.uint8)
        reach = max(self.size) / self.scale
        for k in range(int(-reach / TILE), int(reach / TILE) + 1):
            for axis in (0, 1):
                at = np.round(self.centre[axis] / TILE) * TILE + TILE * k
                ends = np.tile(self.centre, (2, 1)) + [[-reach, -reach], [reach, reach]]
                ends[:, axis] = at
                whole = abs(at - round(at)) < 1e-9
                self.line(image, ends, METRE if whole else LINE, 2 if whole else 1)
        return image

    def line(self, image, points, colour, thickness: int) -> None:
        """Draws a line through the world's points (n, 2), m."""
        whole = np.round(self.pixel(points) * 16).astype(np.int32).reshape(-1, 1, 2)
        self.cv2.polylines(image, [whole], False, colour, thickness, self.cv2.LINE_AA, 4)

    def swimmer(self, image, q, target, s: Skin, tint=None) -> None:
        """Draws the fish, and the target (2,) [m] (NaN: none) in a ring, which is green around a fish that has arrived."""
        if np.isfinite(target).all():
            radius = constant("protocol", "arrival_radius")
            self.target(image, target, radius, bool(np.hypot(*(target - q[:2])) <= radius))
        self.fish(image, q, s, tint)

    def target(self, image, target, radius: float, reached: bool) -> None:
        """Draws a ring of `radius` [m] around the target (2,), m."""
        at = tuple(int(v) for v in np.round(self.pixel(target) * 16))
        colour = INSIDE if reached else OUTSIDE
        self.cv2.circle(image, at, int(radius * self.scale * 16), colour, 3, self.cv2.LINE_AA, 4)
        self.cv2.circle(image, at, 4 * 16, colour, -1, self.cv2.LINE_AA, 4)

    def fish(self, image, q, s: Skin, tint=None) -> None:
        """Draws the skin at q (nv,): painter's algorithm over the upper triangles, on an enlarged patch of the picture."""
        p = posed(s, q)
        xy = self.pixel(p[:, :2])
        low = np.floor(xy.min(0) - 3).astype(int).clip(0, [self.size[0] - 1, self.size[1] - 1])
        high = np.ceil(xy.max(0) + 3).astype(int).clip(low + 1, [self.size[0], self.size[1]])
        patch = image[low[1] : high[1], low[0] : high[0]]
        large = self.cv2.resize(patch, None, fx=FINE, fy=FINE, interpolation=self.cv2.INTER_NEAREST)
        corners = p[s.faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.linalg.norm(normal, axis=1)
        up = np.flatnonzero(normal[:, 2] > 1e-3 * area)
        up = up[np.argsort(corners[up, :, 2].max(1), kind="stable")]
        light = 0.45 + 0.6 * np.clip(normal[up] @ SUN / area[up], 0, 1)
        colour = np.clip(255 * s.colour[s.faces[up]].mean(1) * light[:, None], 0, 255)[:, ::-1]
        if tint is not None:
            colour = 0.35 * colour + 0.65 * light[:, None] * tint
        polygons = np.round((xy[s.faces[up]] - low) * FINE * 16).astype(np.int32)
        for polygon, shade in zip(polygons, colour, strict=True):
            self.cv2.fillConvexPoly(large, polygon, tuple(float(c) for c in shade), self.cv2.LINE_8, 4)
        small = self.cv2.resize(large, (patch.shape[1], patch.shape[0]), interpolation=self.cv2.INTER_AREA)
        patch[:] = small if tint is None else self.cv2.addWeighted(small, 0.7, patch, 0.3, 0)


def coarse_skin(robot: Robot) -> Skin:
    """The skin that `FromAbove` draws, as coarse as its pictures allow."""
    return skin(robot, spacing=0.012, around=12, smooth=True)


def opencv(needed_for: str = "a picture from above") -> Any:
    """Imports and returns the module cv2. Raises MissingExtra."""
    try:
        import cv2
    except ImportError as error:
        raise MissingExtra("opencv-python-headless", "view", needed_for) from error
    return cv2
