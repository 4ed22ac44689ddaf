"""Fits the pose of a known pattern to the pixels: robust least squares over all pixels of the pattern.

    I(p) = a + b T(u) + noise,   u = R(-yaw) (X(p) - (x, y))

X(p) is the tank point of pixel p (`Calibration`), u the same in the body frame, T the pattern there, a and b the light.
Gauss-Newton steps over (x, y, yaw, a, b). Pixels that the pattern does not explain (glints, leaves) lose their weight by Tukey's
function of their residual over its robust scale s. With J the derivatives of I by the pose, a and b, and W the weights,

    covariance = CORRELATED s2 (J' W J)^-1,   s2 = sum(W r2) / (sum(W) - 5)
"""

from typing import NamedTuple

import numpy as np

from fishmj.deploy.tracker.calibration import Calibration
from fishmj.mjcf.from_above import opencv

GRAIN = 0.001  # m, of a pattern's own pixels
ROUNDS = 12
STILL = 0.01  # px; smaller steps end the search
TUKEY = 4.685  # robust scales beyond which a pixel counts nothing
LEAST = 0.06  # of the contrast
CORRELATED = 6.0  # pixels that one independent pixel stands for: the lens blurs and the pattern is never quite as painted


class Pattern:
    """The pattern to find, in the body frame.

    Attributes:
        low: (2,) m, body point of the first pixel. shape: (rows, columns), rows along y.
        outline: (n, 2) m, for overlays. height: m over the water plane.
    """

    def __init__(self, image: np.ndarray, inside: np.ndarray, low, outline: np.ndarray, height: float, blur: float):
        """Blurs the pattern for both passes of the alignment.

        Args:
            image: (rows, columns) values. inside: the same shape, 1 where the pattern is known, else 0.
            blur: standard deviation of the spot that camera and pixel make of a point, m.
        """
        cv2 = opencv("the camera tracker")
        self.low, self.outline, self.height = np.asarray(low, float), outline, height
        self.layers = []
        for spot in (2.5 * blur, blur):  # the first finds the place, the second its fraction of a pixel
            soft = cv2.GaussianBlur(image.astype(np.float32), (0, 0), spot / GRAIN)
            slope_y, slope_x = np.gradient(soft, GRAIN)
            self.layers.append(
                cv2.merge([soft, slope_x.astype(np.float32), slope_y.astype(np.float32), inside.astype(np.float32)])
            )
        self.area = float(inside.sum()) * GRAIN**2  # m2

    @property
    def corners(self) -> np.ndarray:
        """(4, 2) m, of the pattern's rectangle in the body frame."""
        rows, columns = self.layers[0].shape[:2]
        far = self.low + np.array([columns - 1, rows - 1]) * GRAIN
        return np.array([self.low, (far[0], self.low[1]), far, (self.low[0], far[1])])


class Aligned(NamedTuple):
    """Result of an alignment."""

    pose: np.ndarray  # (3,) m, m, rad
    covariance: np.ndarray  # (3, 3)
    match: float  # weighted correlation of pixels and pattern, -1..1
    seen: float  # share of the pattern's pixels that count, 0..1
    light: tuple[float, float]  # a and b, in the image's own unit


class Patch(NamedTuple):
    """Part of a frame: values and weights of its pixels, and the place of the first."""

    values: np.ndarray  # (h, w) float32
    weights: np.ndarray  # (h, w) float32
    low: np.ndarray  # (2,) px, x and y


def align(
    patch: Patch,
    pattern: Pattern,
    pose: np.ndarray,
    calibration: Calibration,
    *,
    coarse: bool = True,
    light: tuple[float, float] | None = None,
) -> Aligned | None:
    """Aligns a pattern from a first guess (3,); None if it slides away or too little of it is in the patch.

    Args:
        coarse: find the place with a softened pattern first, for a guess that may be off by a cell. light: a and b of the frame
            before, if known: glints over a third of the pattern then no longer count as its light.
    """
    cv2 = opencv("the camera tracker")
    height, width = patch.values.shape
    middle = patch.low + [(width - 1) / 2, (height - 1) / 2]
    to_metres = calibration.scale(middle, pattern.height)
    centre = calibration.to_tank(middle[None], pattern.height)[0]
    step = float(np.sqrt(abs(np.linalg.det(to_metres))))  # m/px
    px, py = np.meshgrid(np.arange(width) - (width - 1) / 2, np.arange(height) - (height - 1) / 2)
    tank_x = centre[0] + to_metres[0, 0] * px + to_metres[0, 1] * py
    tank_y = centre[1] + to_metres[1, 0] * px + to_metres[1, 1] * py
    whole = pattern.area / step**2  # px
    start, pose = pose, pose.astype(float)
    long = float(np.abs(pattern.corners).max())
    for layer in pattern.layers[0 if coarse else 1 :]:
        for _ in range(ROUNDS):
            c, s = np.cos(pose[2]), np.sin(pose[2])
            dx, dy = tank_x - pose[0], tank_y - pose[1]
            ux, uy = c * dx + s * dy, c * dy - s * dx
            column, row = ((v - o) / GRAIN for v, o in zip((ux, uy), pattern.low, strict=True))
            looked = cv2.remap(layer, column.astype(np.float32), row.astype(np.float32), cv2.INTER_LINEAR, borderValue=0)
            known = (looked[..., 3] > 0.5) & (patch.weights > 0)
            if known.sum() < 0.3 * whole or known.sum() < 30:
                return None
            t, tx, ty = (looked[..., k][known].astype(float) for k in range(3))
            value, base = patch.values[known].astype(float), patch.weights[known].astype(float)
            uxk, uyk = ux[known], uy[known]
            if light is None:  # the first time: every pixel counts, then those that this line explains
                light = _line(t, value, base)
            if light is None or light[1] <= 0:
                return None
            weight = base * _tukey(value - light[0] - light[1] * t, light[1])
            light = _line(t, value, weight)
            if light is None or light[1] <= 0:
                return None
            a, b = light
            left = value - a - b * t
            slopes = np.stack([-b * (c * tx - s * ty), -b * (s * tx + c * ty), b * (tx * uyk - ty * uxk), np.ones_like(t), t], 1)
            heavy = slopes * weight[:, None]
            normal = heavy.T @ slopes
            try:
                move = np.linalg.solve(normal, heavy.T @ left)
            except np.linalg.LinAlgError:
                return None
            # a step is at most about a pixel: beyond it the slopes are meaningless
            far = max(float(np.hypot(*move[:2])), abs(move[2]) * long) / step
            pose = pose + move[:3] * min(1.0, 1.5 / max(far, 1e-9))
            light = (a + move[3], b + move[4])
            if far < STILL:
                break
        if np.hypot(*(pose[:2] - start[:2])) > 0.06 or abs(pose[2] - start[2]) > 0.6:
            return None
    spread = np.sum(weight * left * left) / max(np.sum(weight) - 5, 1)
    covariance = CORRELATED * spread * np.linalg.inv(normal)[:3, :3]
    return Aligned(pose, covariance, _correlation(t, value, weight), float(np.sum(weight > 0.1) / whole), (a, b))


def _tukey(left: np.ndarray, contrast: float) -> np.ndarray:
    """Weights (1 - (r / (c s))^2)^2 within c robust scales s, 0 beyond.

    The scale is at least a share of the contrast. The edges determine the place, and there a pattern slightly softer or wider
    than painted leaves more than noise.
    """
    scale = max(1.4826 * float(_median(np.abs(left))), LEAST * abs(contrast)) + 1e-9
    inside = 1 - (left / (TUKEY * scale)) ** 2
    return np.where(inside > 0, inside, 0.0) ** 2


def _median(values: np.ndarray) -> float:
    return float(np.partition(values, len(values) // 2)[len(values) // 2])


def _line(t: np.ndarray, value: np.ndarray, weight: np.ndarray) -> tuple[float, float] | None:
    """a and b of value = a + b t, by weighted least squares."""
    total = weight.sum()
    if total < 10:
        return None
    mean_t, mean_v = weight @ t / total, weight @ value / total
    spread = weight @ (t - mean_t) ** 2
    if spread < 1e-9:
        return None
    b = float(weight @ ((t - mean_t) * (value - mean_v)) / spread)
    return float(mean_v - b * mean_t), b


def _correlation(t: np.ndarray, value: np.ndarray, weight: np.ndarray) -> float:
    total = weight.sum()
    t, value = t - weight @ t / total, value - weight @ value / total
    return float(weight @ (t * value) / max(np.sqrt((weight @ (t * t)) * (weight @ (value * value))), 1e-12))
