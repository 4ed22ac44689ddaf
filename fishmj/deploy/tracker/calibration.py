"""Converts pixels of the overhead camera to metres of the tank, and back.

    pixel --(lens: k1 k2 p1 p2 k3)--> undistorted pixel --(homography)--> point on the water plane --(height, refraction)--> mark

Tank frame: x, y on the water plane, z up, origin by the marks. A line of sight meets the plane at p. The camera stands
at height H over its foot f. A mark at height h above the plane lies nearer to the foot; one at depth d below it lies farther:

    above    x = f + (p - f) (H - h) / H
    below    x = p + d tan(b) (p - f) / |p - f|,   sin b = sin(a) / n,   tan a = |p - f| / H     (Snell)

For small angles the second is a scale about the foot, 1 + d / (n H): the refraction scale.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fishmj.base.calib import read_toml, shown_path
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.base.store import write_text
from fishmj.log.toml import dumps
from fishmj.mjcf.from_above import opencv

SCHEMA = "fishmj.camera/1"
WATER = 1.333  # refractive index of water
KEYS = ("schema", "size", "matrix", "distortion", "homography", "camera", "refractive_index", "lag", "marks_rms", "notes")
NEEDED = ("size", "matrix", "distortion", "homography", "camera")
NARROW = 8.0  # px: marks that lie closer to one line tell nothing across it
POSED = 0.02  # least singular value of the marks' equations, of coordinates of size one: below it three of four lie in a line
APART = 2.0  # px between two marks; closer ones are the same
SQUARE = 0.1  # by which the tank's axes may differ in length, and the cosine between them, as this lens sees the marks
HIGH = (0.05, 100.0)  # m, a camera over a tank
TURNS = 20  # of the search for the undistorted point; a lens of a camera converges in five


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """One camera over one tank.

    Attributes:
        size: (W, H) px of the images. matrix: (3, 3) camera matrix, px. distortion: (5,) k1, k2, p1, p2, k3.
        homography: (3, 3), undistorted pixels to m on the water plane.
        camera: (3,) m, foot x, y and height H of the camera over the water plane.
        refractive_index: of the water. lag: s from the middle of an exposure to the time stamp of its frame.
        marks_rms: m, residual of the marks that the homography was fitted to; 0 if it was not measured.
    """

    size: tuple[int, int]
    matrix: np.ndarray
    distortion: np.ndarray
    homography: np.ndarray
    camera: np.ndarray
    refractive_index: float = WATER
    lag: float = 0.0
    marks_rms: float = 0.0
    notes: str = ""

    def __post_init__(self):
        for name, shape in (("matrix", (3, 3)), ("distortion", (5,)), ("homography", (3, 3)), ("camera", (3,))):
            object.__setattr__(self, name, _numbers(name, getattr(self, name), shape))
        for name in ("matrix", "homography"):
            if abs(np.linalg.det(getattr(self, name))) < 1e-15:
                raise ConfigError(f"calibration: {name} has no inverse; calibrate again")
        if len(self.size) != 2 or not all(isinstance(n, int) and 16 <= n <= 16384 for n in self.size):
            raise ConfigError(f"calibration: size = {self.size}, expected width and height in px, 16 to 16384")
        if not self.camera[2] > 0:
            raise ConfigError(f"calibration: camera = {self.camera.tolist()}, expected a height in m (the third number) above 0")
        for name, low, high in (("refractive_index", 1.0, 2.0), ("lag", 0.0, 5.0), ("marks_rms", 0.0, 10.0)):
            value = getattr(self, name)
            if not (isfinite(value) and low <= value <= high):
                raise ConfigError(f"calibration: {name} = {value}, expected {low:g} to {high:g}")
        if folded := folding(self.size, self.matrix, self.distortion):
            raise ConfigError(f"calibration: distortion = {self.distortion.tolist()}: {folded}")
        forward = np.linalg.inv(self.homography)
        object.__setattr__(self, "_forward", forward)

    def to_plane(self, pixels) -> np.ndarray:
        """Pixels (n, 2) -> points (n, 2) m at which their lines of sight meet the water plane."""
        cv2 = opencv("the camera tracker")
        points = np.asarray(pixels, float).reshape(-1, 1, 2)
        # the default five iterations leave 0.1 px in the corners of a wide lens
        stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, TURNS, 1e-9)
        plain = cv2.undistortPoints(points, self.matrix, self.distortion, None, None, self.matrix, stop).reshape(-1, 2)
        return _projected(self.homography, plain)

    def to_tank(self, pixels, height: float = 0.0) -> np.ndarray:
        """Pixels (n, 2) -> tank points (n, 2) m of marks at `height` m above the water plane, below it negative."""
        seen = self.to_plane(pixels)
        foot, high = self.camera[:2], self.camera[2]
        away = seen - foot
        if height >= 0:
            return foot + away * ((high - height) / high)
        return seen + away * self._deeper(np.hypot(*away.T), -height)[:, None]

    def to_pixel(self, points, height: float = 0.0) -> np.ndarray:
        """Tank points (n, 2) m of marks at `height` m -> pixels (n, 2): the inverse of `to_tank`."""
        points = np.asarray(points, float).reshape(-1, 2)
        foot, high = self.camera[:2], self.camera[2]
        away = points - foot
        if height >= 0:
            seen = foot + away * (high / (high - height))
        else:
            far = np.hypot(*away.T)
            near = far.copy()
            for _ in range(8):  # r + r d tan(b) / r = far, a contraction by d / (n H)
                near = far / (1.0 + self._deeper(near, -height))
            seen = foot + away * (near / np.maximum(far, 1e-12))[:, None]
        return self._distorted(_projected(self._forward, seen))  # type: ignore[attr-defined]

    def scale(self, pixel, height: float = 0.0) -> np.ndarray:
        """(2, 2) d(tank point) / d(pixel), m/px, at one pixel (2,)."""
        steps = np.array([[0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]])
        at = self.to_tank(np.asarray(pixel, float).reshape(2) + steps, height)
        return np.stack([at[0] - at[1], at[2] - at[3]], 1)

    def metres_per_pixel(self, height: float = 0.0) -> float:
        """m/px in the middle of the image, the geometric mean of both directions."""
        middle = (np.array(self.size) - 1) / 2
        return float(np.sqrt(abs(np.linalg.det(self.scale(middle, height)))))

    def _deeper(self, far: np.ndarray, depth: float) -> np.ndarray:
        """d tan(b) / r of a line of sight that meets the plane at r = `far` (n,) m from the foot."""
        sine = far / np.hypot(far, self.camera[2]) / self.refractive_index
        return depth * sine / np.sqrt(1 - sine * sine) / np.maximum(far, 1e-12)

    def _distorted(self, plain: np.ndarray) -> np.ndarray:
        """Undistorted pixels (n, 2) -> pixels of the image, (n, 2).

        r2 = x2 + y2;  x' = x (1 + k1 r2 + k2 r4 + k3 r6) + 2 p1 x y + p2 (r2 + 2 x2), y' alike
        """
        k1, k2, p1, p2, k3 = self.distortion
        rays = np.c_[plain, np.ones(len(plain))] @ np.linalg.inv(self.matrix).T
        x, y = rays[:, 0] / rays[:, 2], rays[:, 1] / rays[:, 2]
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        bent_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        bent_y = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        return _projected(self.matrix, np.stack([bent_x, bent_y], 1))

    def write(self, path: str | Path) -> Path:
        """Writes a TOML file. Raises StoreError."""
        table = {"schema": SCHEMA, "size": list(self.size)}
        table |= {name: getattr(self, name).tolist() for name in NEEDED[1:]}
        table |= {name: getattr(self, name) for name in ("refractive_index", "lag", "marks_rms", "notes")}
        return write_text(path, dumps(table))

    @classmethod
    def read(cls, path: str | Path) -> "Calibration":
        """Reads a TOML file of `write` or of a person.

        Raises ConfigError: not readable, incomplete or impossible; UnknownName: an unknown key.
        """
        table, where = read_toml(path), shown_path(path)
        if table.get("schema") != SCHEMA:
            raise ConfigError(f"{where}: schema = {table.get('schema')!r:.40}, expected {SCHEMA!r}")
        for key in table:
            if key not in KEYS:
                raise UnknownName(f"key of {where}", key[:40], KEYS)
        if missing := [key for key in NEEDED if key not in table]:
            raise ConfigError(f"{where}: lacks {', '.join(missing)}; calibrate again (docs/tank/tracker.md)")
        try:
            plain = {key: float(table[key]) for key in ("refractive_index", "lag", "marks_rms") if key in table}
            size = tuple(table["size"])
            rest = {key: table[key] for key in NEEDED[1:]}
        except (TypeError, ValueError) as error:
            raise ConfigError(f"{where}: {error}; expected numbers") from error
        try:
            return cls(size=size, **rest, **plain, notes=str(table.get("notes", "")))  # type: ignore[arg-type]
        except ConfigError as error:
            raise ConfigError(f"{where}: {error}") from error


def folding(size: tuple[int, int], matrix: np.ndarray, distortion: np.ndarray) -> str:
    """Reason that no lens has such a distortion, "" if one may: farther rays must map farther out, up to the picture's corner.

    Args:
        size: (W, H) px. matrix: (3, 3). distortion: (5,) k1, k2, p1, p2, k3.
    """
    corners = np.array([[x, y, 1.0] for x in (0, size[0] - 1) for y in (0, size[1] - 1)]) @ np.linalg.inv(matrix).T
    corner = float(np.hypot(*(corners[:, :2] / corners[:, 2:]).T).max())
    k1, k2, _, _, k3 = distortion
    r = np.linspace(0.0, 3.0 * corner, 3001)
    r2 = r * r
    rises = 1 + r2 * (3 * k1 + r2 * (5 * k2 + r2 * 7 * k3)) > 0
    last = len(r) - 1 if rises.all() else int(np.argmin(rises))
    seen = float(r[last] * (1 + r2[last] * (k1 + r2[last] * (k2 + r2[last] * k3))))
    if seen >= corner:
        return ""
    return (
        f"such a lens shows nothing beyond {100 * seen / corner:.0f} % of the way from the middle to the corner of the picture"
        " (rays farther out fold back); photograph the board in the corners too, flat and sharp, and calibrate again"
    )


PAIRS = ("pixel", "point")  # of a mark, two numbers each


class Mark(NamedTuple):
    """A mark of the tank, on the water plane."""

    name: str
    pixel: tuple[float, float]  # in the image as the camera gives it
    point: tuple[float, float]  # m, tank frame


class MarksFit(NamedTuple):
    """A homography and its residuals at the marks."""

    calibration: Calibration
    residual: np.ndarray  # (n,) m, distance of each mark from where the homography puts its pixel
    without: np.ndarray | None  # (n,) m, rms of the others without that mark: a wrong one leaves the least; needs six marks

    @property
    def rms(self) -> float:
        """Root mean square residual, m."""
        return float(np.sqrt(np.mean(self.residual**2)))


def homography_from_marks(
    marks: list[Mark] | tuple[Mark, ...],
    size: tuple[int, int],
    matrix,
    distortion=(0.0, 0.0, 0.0, 0.0, 0.0),
    *,
    camera=None,
    lag: float = 0.0,
    notes: str = "",
) -> MarksFit:
    """Calibrates the water plane from four marks or more, and finds the camera's position.

    Args:
        marks: in the tank frame, x and y as seen from above a right-handed pair. size, matrix, distortion: of the lens.
        camera: (3,) m, foot and height if measured by a ruler; None takes them from the homography.

    Raises ConfigError: fewer than four marks, three of four in a line, a mark twice or outside of the picture, marks that mirror
    the tank, that no camera with this lens can see like this, or in another unit than m.
    """
    cv2 = opencv("the camera tracker")
    if len(marks) < 4:
        raise ConfigError(f"homography: got {len(marks)} marks, expected 4 at least, spread over the tank")
    pixels, points = (_numbers(f"{name}s of marks", [getattr(m, name) for m in marks], (len(marks), 2)) for name in PAIRS)
    _distinct(marks, pixels, points, size)
    matrix, distortion = _numbers("matrix", matrix, (3, 3)), _numbers("distortion", distortion, (5,))
    lens = Calibration(size=size, matrix=matrix, distortion=distortion, homography=np.eye(3), camera=np.array([0, 0, 1]), lag=lag)
    plain = lens.to_plane(pixels)
    fitted = _homography(cv2, plain, points)
    at = _projected(fitted, plain)
    middle = plain.mean(0)
    step = _projected(fitted, middle + np.array([[0.0, 0], [1, 0], [0, 1]]))
    if np.linalg.det(step[1:] - step[0]) > 0:  # image y points down: a view from above turns the pair of axes over
        raise ConfigError("homography: the marks mirror the tank; check that x, y, up is right-handed and no mark is swapped")
    residual = np.hypot(*(at - points).T)
    rms = float(np.sqrt(np.mean(residual**2)))
    without = _without(cv2, plain, points) if len(marks) > 5 else None  # any homography meets four
    if wrong := _no_view(fitted, matrix):
        hint = "" if without is None else f"; the rest agrees best without {marks[int(without.argmin())].name}"
        raise ConfigError(f"homography: {wrong}; check each mark's pixel and point, and that the lens is this camera's{hint}")
    where = camera_of(fitted, matrix)
    if not HIGH[0] <= where[2] <= HIGH[1]:
        raise ConfigError(
            f"homography: the marks put the camera {where[2]:.3g} m over the water, expected {HIGH[0]:g} to {HIGH[1]:g} m;"
            " give the points of the marks in m"
        )
    where = where if camera is None else _numbers("camera", camera, (3,))
    found = Calibration(
        size=size, matrix=matrix, distortion=distortion, homography=fitted, camera=where, lag=lag, marks_rms=rms, notes=notes
    )
    return MarksFit(found, residual, without)


def _distinct(marks: Sequence[Mark], pixels: np.ndarray, points: np.ndarray, size: tuple[int, int]) -> None:
    """Raises ConfigError if a mark lies outside of the picture, or two of them in one place."""
    for k, mark in enumerate(marks):
        if not np.all((pixels[k] >= -0.5) & (pixels[k] <= np.array(size) - 0.5)):
            seen, (wide, high) = "{:g}, {:g}".format(*pixels[k]), size
            raise ConfigError(f"homography: mark {mark.name}: pixel {seen} lies outside of the picture, {wide} x {high} px")
        for j in range(k):
            if (near := np.hypot(*(pixels[k] - pixels[j])) < APART) or not np.any(points[k] - points[j]):
                what = "pixel" if near else "point"
                raise ConfigError(f"homography: marks {marks[j].name} and {mark.name} have one {what}; leave one of them out")


def _without(cv2, plain: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(n,) m, rms of the other marks without each; infinite if the others determine no plane."""
    left = np.full(len(plain), np.inf)
    for k in range(len(plain)):
        rest = np.arange(len(plain)) != k
        with suppress(ConfigError):
            error = _projected(_homography(cv2, plain[rest], points[rest]), plain[rest]) - points[rest]
            left[k] = np.sqrt(np.mean(np.sum(error**2, 1)))
    return left


def _axes(homography: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """(3, 3): [r1 r2 t] of the inverse of the homography K [r1 r2 t], up to a scale."""
    return np.linalg.inv(matrix) @ np.linalg.inv(homography)


def _no_view(homography: np.ndarray, matrix: np.ndarray) -> str:
    """Reason that no camera with this matrix has this view of the tank, r1 and r2 unequal or not at right angles; else ""."""
    first, second = _axes(homography, matrix)[:, :2].T
    ratio = np.linalg.norm(first) / np.linalg.norm(second)
    cosine = first @ second / (np.linalg.norm(first) * np.linalg.norm(second))
    if abs(np.log(ratio)) <= SQUARE and abs(cosine) <= SQUARE:
        return ""
    return (
        f"no camera with this lens sees the marks so: 1 m along x would be {ratio:.2f} times 1 m along y, and the angle between"
        f" them {np.degrees(np.arccos(cosine)):.0f} deg"
    )


def camera_of(homography: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """(3,) m, foot x, y and height of the camera.

    The inverse of the homography is K [r1 r2 t] up to a scale; the two axes have length one and r3 = r1 x r2; the camera is at
    -R' t.
    """
    axes = _axes(homography, matrix)
    axes = axes / np.sqrt(np.linalg.norm(axes[:, 0]) * np.linalg.norm(axes[:, 1]))
    if axes[2, 2] < 0:  # the tank lies in front of the camera
        axes = -axes
    whole = np.c_[axes[:, :2], np.cross(axes[:, 0], axes[:, 1])]
    left, _, right = np.linalg.svd(whole)
    centre = -(left @ right).T @ axes[:, 2]
    return np.array([centre[0], centre[1], abs(centre[2])])


def overhead(
    size: tuple[int, int],
    metres_per_pixel: float,
    height: float,
    *,
    distortion=(0.0,) * 5,
    tilt=(0.0, 0.0),
    turn: float = 0.0,
    lag: float = 0.0,
) -> Calibration:
    """The calibration of a drawn camera: over the tank's middle, looking down.

    Args:
        height: m over the water plane. tilt: (2,) rad about the image's x and y axes. turn: rad about the line of sight.
    """
    focal = height / metres_per_pixel
    matrix = np.array([[focal, 0, (size[0] - 1) / 2], [0, focal, (size[1] - 1) / 2], [0, 0, 1.0]])
    (cx, sx), (cy, sy), (cz, sz) = ((np.cos(a), np.sin(a)) for a in (*tilt, turn))
    about = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]]) @ np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    down = np.diag([1.0, -1.0, -1.0]) @ np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    turned = about @ down
    axes = np.c_[turned[:, 0], turned[:, 1], turned @ np.array([0, 0, -height])]
    homography = np.linalg.inv(matrix @ axes)
    return Calibration(
        size=size,
        matrix=matrix,
        distortion=distortion,
        homography=homography / homography[2, 2],
        camera=np.array([0.0, 0.0, height]),
        lag=lag,
    )


def _homography(cv2, plain: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(3, 3) least-squares homography. Raises ConfigError."""
    found, _ = cv2.findHomography(plain, points, 0)
    spread = np.linalg.svd(plain - plain.mean(0), compute_uv=False)[-1] / np.sqrt(len(plain))  # px, across their longest line
    if found is None or not np.isfinite(found).all() or spread < NARROW or abs(np.linalg.det(found)) < 1e-15:
        raise ConfigError("homography: the marks lie in one line or in one place; spread them over the tank")
    if _posed(plain, points) < POSED:
        raise ConfigError("homography: all marks but one lie in one line; spread them over the tank, four of them as a square")
    return found


def _posed(plain: np.ndarray, points: np.ndarray) -> float:
    """The eighth singular value of the equations of a homography, of coordinates about their mean and of mean square 2."""
    p, q = ((a - a.mean(0)) / max(float(np.sqrt(np.mean(np.sum((a - a.mean(0)) ** 2, 1)) / 2)), 1e-12) for a in (plain, points))
    one, none = np.c_[p, np.ones(len(p))], np.zeros((len(p), 3))
    rows = np.r_[np.c_[one, none, -q[:, :1] * one], np.c_[none, one, -q[:, 1:] * one]]
    return float(np.linalg.svd(rows, compute_uv=False)[7] / np.sqrt(len(p)))


def _projected(homography: np.ndarray, points: np.ndarray) -> np.ndarray:
    """A projective map of points (n, 2)."""
    mapped = np.c_[points, np.ones(len(points))] @ homography.T
    return mapped[:, :2] / mapped[:, 2:]


def _numbers(name: str, value, shape: tuple[int, ...]) -> np.ndarray:
    """`value` as finite float64 of a shape. Raises ConfigError."""
    try:
        array = np.array(value, float)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"calibration: {name}: got {value!r:.60}, expected numbers of shape {shape}") from error
    if array.shape != shape or not np.isfinite(array).all():
        raise ConfigError(f"calibration: {name}: got shape {array.shape}, expected {shape}, finite numbers")
    array.setflags(write=False)
    return array
