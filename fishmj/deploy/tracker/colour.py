"""Tracks a red head and a yellow neck.

    fix = ColourTracker(calibration, PAPER_FISH, height=-0.005).locate(frame, t)

    redness = (R - max(G, B)) / (R + G + B + DARK),   yellowness = (min(R, G) - B) / (R + G + B + DARK)

The ratios do not change with the light. Added white light lowers them and never makes water red. Each colour's blobs have
sub-pixel centroids, weighted by its score. A head and a neck are a pair if their distance and their sizes are those of the
paint; a red object without a yellow one at the right distance is none. The pair is then aligned with the paint as a whole, so
that an area under a glint or a leaf does not pull the pose. Two possible pairs give no fix.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.deploy.tracker.alignment import GRAIN, Aligned, Patch, Pattern, align
from fishmj.deploy.tracker.calibration import Calibration
from fishmj.deploy.tracker.fix import PosePredictor, placed, wrapped
from fishmj.deploy.tracker.mark_tracker import MarkTracker
from fishmj.mjcf.from_above import opencv

DARK = 24.0  # grey levels: keeps the noise of dark pixels from counting as colour
SPOT = 0.9  # px
MARGIN = 0.012  # m round the paint that must show neither colour
COARSE = 0.008  # m/px at which a whole frame is searched
DISTANCE = 0.3  # relative error of the distance of a pair's centroids
AREAS = (0.2, 1.8)  # of the painted area that a blob may show: covered in part; smeared
MATCH, SEEN = 0.75, 0.4  # least correlation with the paint and share of it that counts
TWIN = 0.9  # share of the best match from which a second pair elsewhere makes both doubtful
PAIRS = 4  # that are aligned, the likeliest first
SMALLEST = 12  # px of a band
FINE = 4  # points along a grain of the pattern that are averaged
SATURATED = 235  # of the darkest channel: a glint


Bands = tuple[tuple[float, float], ...]  # stations x and widths, m


class Paint(NamedTuple):
    """Painted bands of the head link, measured by a ruler: two or more stations (x, width), m, from the rear to the front."""

    head: Bands
    neck: Bands

    def polygon(self, band: str) -> np.ndarray:
        """(n, 2) m outline of "head" or "neck" in the body frame."""
        rows = np.array(getattr(self, band), float)
        return np.concatenate([rows * [1, 0.5], rows[::-1] * [1, -0.5]])


PAPER_FISH = Paint(  # as a ruler finds it on the shipped fish, to the millimetre; its sides are straight between the stations
    head=((0.050, 0.062), (0.100, 0.060), (0.135, 0.052), (0.160, 0.034), (0.175, 0.014)), neck=((-0.030, 0.048), (0.012, 0.058))
)


class Blob(NamedTuple):
    """Connected pixels of one colour."""

    at: np.ndarray  # (2,) m, tank
    area: float  # m2


@dataclass
class ColourTracker(MarkTracker):
    """Finds one red head with its yellow neck.

    Attributes:
        paint: place of the colours. height: m of the paint over the water plane, below it negative.
        red, yellow: scores of the full colours in a frame of the tank; half of each is the threshold.
        unseen: m and rad, standard deviations of errors that one frame does not show, added to the covariance: waves, and the
            ruler's error of the paint's edges. The default is for a ruler's millimetre and no waves.

    Raises (on construction):
        ConfigError: impossible paint or scores.
    """

    calibration: Calibration
    paint: Paint
    height: float = 0.0
    red: float = 0.5
    yellow: float = 0.3
    unseen: tuple[float, float] = (0.0003, 0.004)
    motion: PosePredictor = field(default_factory=PosePredictor, repr=False)

    def __post_init__(self):
        for band in ("head", "neck"):
            rows = np.array(getattr(self.paint, band), float)
            sound = rows.ndim == 2 and rows.shape[1] == 2 and len(rows) > 1
            if not sound or (rows[:, 1] <= 0).any() or (np.diff(rows[:, 0]) <= 0).any():
                got = getattr(self.paint, band)
                raise ConfigError(f"paint of the {band}: got {got}, expected two or more (x, width) in m, x rising")
        if self.paint.head[0][0] < self.paint.neck[-1][0]:
            raise ConfigError("paint: the head begins behind the end of the neck; expected the red before the yellow")
        for name in ("red", "yellow"):
            if not 0.05 <= getattr(self, name) <= 1:
                raise ConfigError(f"{name} = {getattr(self, name):g}, expected 0.05 to 1, the score of the full colour")
        self.scale = self.calibration.metres_per_pixel(self.height)  # m/px
        self.outline = np.concatenate([self.paint.polygon("neck"), self.paint.polygon("head")])
        self.half = np.ptp(self.outline[:, 0]) / 2 + MARGIN
        self.head, self.head_area = _centroid(self.paint.polygon("head"))
        self.neck, self.neck_area = _centroid(self.paint.polygon("neck"))
        self.distance = float(np.hypot(*(self.head - self.neck)))
        least = min(self.head_area, self.neck_area)
        if least < SMALLEST * self.scale**2:
            raise ConfigError(
                f"paint: {1e4 * least:.1f} cm2 are fewer than {SMALLEST} px at {1e3 * self.scale:.1f} mm/px; paint more, or hang"
                " the camera lower"
            )
        self.pattern = self._pattern()

    def _near(self, image: np.ndarray, pose: np.ndarray, window: tuple[int, int, int, int]) -> Aligned | None:
        return self._aligned(image, pose) or self._searched(image, window, 1)

    def _anywhere(self, image: np.ndarray) -> Aligned | None:
        return self._searched(image, (0, 0, *self.calibration.size), max(1, round(COARSE / self.scale)))

    def _searched(self, image: np.ndarray, window: tuple[int, int, int, int], shrink: int) -> Aligned | None:
        """Aligns the likeliest pairs of blobs in part of the frame; None if there is no fit, or more than one."""
        left, top, right, bottom = window
        if right - left < 8 * shrink or bottom - top < 8 * shrink:
            return None
        cv2 = opencv("the colour tracker")
        part = image[top:bottom, left:right]
        if shrink > 1:
            part = cv2.resize(part, None, fx=1 / shrink, fy=1 / shrink, interpolation=cv2.INTER_AREA)
        red, yellow = _scores(cv2, part)
        heads = self._blobs(cv2, red, self.red, window, shrink, self.head_area)
        necks = self._blobs(cv2, yellow, self.yellow, window, shrink, self.neck_area)
        pairs = []
        for head in heads:
            for neck in necks:
                apart = head.at - neck.at
                error = abs(np.hypot(*apart) / self.distance - 1)
                if error < DISTANCE:
                    sizes = abs(np.log(head.area / self.head_area)) + abs(np.log(neck.area / self.neck_area))
                    yaw = np.arctan2(apart[1], apart[0]) - np.arctan2(*(self.head - self.neck)[::-1])
                    pose = np.array([0.0, 0.0, yaw])
                    pose[:2] = 0.5 * (head.at + neck.at) - placed(0.5 * (self.head + self.neck)[None], pose)[0]
                    pairs.append((error / DISTANCE + 0.5 * sizes, pose))
        pairs.sort(key=lambda pair: pair[0])
        found = [a for _, pose in pairs[:PAIRS] if (a := self._aligned(image, pose)) is not None]
        if not found:
            return None
        best = max(found, key=lambda a: a.match * a.seen)
        for other in found:
            elsewhere = np.hypot(*(other.pose - best.pose)[:2]) > 0.02 or abs(wrapped(other.pose[2] - best.pose[2])) > 0.3
            if elsewhere and other.match * other.seen > TWIN * best.match * best.seen:
                return None  # two could be the fish
        return best

    def _blobs(self, cv2, score: np.ndarray, full: float, window, shrink: int, area: float) -> list[Blob]:
        """Blobs of a score with a possible size of the paint, with their weighted centroids."""
        mask = (score > 0.5 * full).astype(np.uint8)
        # glints may cut a blob in two
        mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
        count, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
        pixel = (self.scale * shrink) ** 2  # m2
        blobs = []
        for k in range(1, count):
            x, y, w, h, size = stats[k]
            if not AREAS[0] * area <= size * pixel <= AREAS[1] * area:
                continue
            low, high = (max(x - 1, 0), max(y - 1, 0)), (x + w + 1, y + h + 1)
            inside = cv2.dilate((labels[low[1] : high[1], low[0] : high[0]] == k).astype(np.uint8), np.ones((3, 3), np.uint8))
            weight = np.clip(score[low[1] : high[1], low[0] : high[0]], 0, full) * inside
            total = float(weight.sum())
            rows, columns = weight.sum(1), weight.sum(0)
            at = np.array([columns @ np.arange(len(columns)), rows @ np.arange(len(rows))]) / total + low
            pixels = (at + 0.5) * shrink - 0.5 + window[:2]
            blobs.append(Blob(self.calibration.to_tank(pixels[None], self.height)[0], size * pixel))
        return blobs

    def _aligned(self, image: np.ndarray, pose: np.ndarray) -> Aligned | None:
        """The paint near a pose, or None if it does not match."""
        cv2 = opencv("the colour tracker")
        corners = self.calibration.to_pixel(placed(self.pattern.corners, pose), self.height)
        limit = np.array(image.shape[1::-1])
        low = (np.floor(corners.min(0)).astype(int) - 3).clip(0, limit)
        high = (np.ceil(corners.max(0)).astype(int) + 4).clip(0, limit)
        if (high - low < 8).any():
            return None
        part = image[low[1] : high[1], low[0] : high[0]]
        red, yellow = _scores(cv2, part)
        signed = np.clip(red / self.red, 0, 1.5) - np.clip(yellow / self.yellow, 0, 1.5)
        glint = cv2.dilate((part.min(2) > SATURATED).astype(np.uint8), np.ones((3, 3), np.uint8))
        patch = Patch(signed.astype(np.float32), 1.0 - glint.astype(np.float32), low)
        found = align(patch, self.pattern, pose, self.calibration, coarse=False)
        if found is None or found.match < MATCH or found.seen < SEEN:
            return None
        return found if self._both(patch, found.pose) else None

    def _both(self, patch: Patch, pose: np.ndarray) -> bool:
        """Returns True if each colour shows at its paint's place: one of them alone is another object."""
        high, wide = patch.values.shape
        for band, sign in (("head", 1.0), ("neck", -1.0)):
            mask = np.zeros((high, wide), np.uint8)
            pixels = self.calibration.to_pixel(placed(self.paint.polygon(band), pose), self.height) - patch.low
            cv2 = opencv("the colour tracker")
            cv2.fillPoly(mask, [np.round(pixels * 16).astype(np.int32)], 1, cv2.LINE_8, 4)
            inside = mask > 0
            if not inside.any() or np.mean(sign * patch.values[inside] * patch.weights[inside] > 0.4) < AREAS[0]:
                return False
        return True

    def _pattern(self) -> Pattern:
        """Pattern of the paint: red +1, yellow -1, else 0."""
        cv2 = opencv("the colour tracker")
        low = np.floor((self.outline.min(0) - MARGIN) / GRAIN) * GRAIN
        columns, rows = (int(n) for n in np.ceil((self.outline.max(0) + MARGIN - low) / GRAIN) + 1)
        fine = (np.arange(FINE * max(columns, rows)) + 0.5) / FINE - 0.5  # edges of the paint fall between the grains
        x, y = low[0] + GRAIN * fine[: FINE * columns], low[1] + GRAIN * fine[: FINE * rows, None]
        image = np.zeros((FINE * rows, FINE * columns), np.float32)
        for band, value in (("head", 1.0), ("neck", -1.0)):
            at, width = np.array(getattr(self.paint, band), float).T
            image[np.abs(y) <= 0.5 * np.interp(x, at, width, left=-1.0, right=-1.0)] = value
        image = cv2.resize(image, (columns, rows), interpolation=cv2.INTER_AREA)
        near = cv2.dilate((image != 0).astype(np.uint8), np.ones((2 * int(MARGIN / GRAIN) + 1,) * 2, np.uint8))
        return Pattern(image, near, low, self.outline, self.height, SPOT * self.scale)


def _scores(cv2, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Redness and yellowness of a BGR image, (h, w) float32 each."""
    blue, green, red = cv2.split(image.astype(np.float32))
    total = blue + green + red + np.float32(DARK)
    return (red - cv2.max(green, blue)) / total, (cv2.min(red, green) - blue) / total


def _centroid(polygon: np.ndarray) -> tuple[np.ndarray, float]:
    """Centroid (2,) and area of a polygon (n, 2), by the shoelace formula."""
    x, y = polygon.T
    nx, ny = np.roll(x, -1), np.roll(y, -1)
    cross = x * ny - nx * y
    area = 0.5 * cross.sum()
    return np.array([((x + nx) * cross).sum(), ((y + ny) * cross).sum()]) / (6 * area), abs(float(area))
