"""Tracks an AprilTag: OpenCV finds and reads it once, then its known cells are aligned with every frame.

    fix = AprilTagTracker(calibration, "36h11", size=0.06, number=0, mount=(0.06, 0, 0), height=0.03).locate(frame, t)

Reading a tag needs cells of some 3 px and four free corners. Alignment uses all visible cells: it works under glints
that cover a corner, and is finer than corners, because every edge of every cell counts.
"""

from dataclasses import dataclass, field

import numpy as np

from fishmj.base.errors import ConfigError, UnknownName
from fishmj.deploy.tracker.alignment import GRAIN, Aligned, Patch, Pattern, align
from fishmj.deploy.tracker.calibration import Calibration
from fishmj.deploy.tracker.fix import PosePredictor, placed, rigid
from fishmj.deploy.tracker.mark_tracker import MarkTracker
from fishmj.mjcf.from_above import opencv

FAMILIES = {"36h11": ("DICT_APRILTAG_36h11", 587), "16h5": ("DICT_APRILTAG_16h5", 30)}  # name in cv2.aruco, tags that there are
CELL = 8.0  # px that a cell gets before OpenCV reads it: at 3 px it misses or misreads cells
SPOT = 0.8  # px, standard deviation of what camera and pixel make of a point
WITHIN = 0.15  # relative error of the size at which a quadrilateral is not the tag
MATCH = {"36h11": 0.75, "16h5": 0.85}  # least correlation of a fix: of few cells, more fits by chance
SEEN = 0.3  # least share of seen cells of a fix
TURNS = (0.0, 0.15, -0.15, 0.3, -0.3)  # rad from the expected heading that are tried
FRESH = 0.85  # least correlation where a tag was read anew
ROUGHLY = 0.5  # relative error of the size at which an outline is not worth another look
AGAIN = 8  # squares of a frame that are read twice at most
CELLS = 19  # that are seen at least, of whatever family: fewer fit too many things
FINE = 6  # points along a grain of the pattern that are averaged
SATURATED = 250.0  # grey level of a glint
BRIGHTER = 1.1  # times the white of the tag over its black: a glint


def code_of(family: str, number: int) -> np.ndarray:
    """Cells (n, n) of a tag with its black border, True for white, as printed.

    Raises UnknownName: another family; ConfigError: a number outside the family.
    """
    if family not in FAMILIES:
        raise UnknownName("tag family", family, FAMILIES)
    if not 0 <= number < FAMILIES[family][1]:
        raise ConfigError(f"tag number {number}: {family} has 0 to {FAMILIES[family][1] - 1}")
    aruco = opencv("the tag tracker").aruco
    dictionary = aruco.getPredefinedDictionary(getattr(aruco, FAMILIES[family][0]))
    return aruco.generateImageMarker(dictionary, number, dictionary.markerSize + 2, borderBits=1) > 127


@dataclass
class AprilTagTracker(MarkTracker):
    """Finds one tag.

    Attributes:
        family: "36h11" (36 bits, any two tags differ in 11) or "16h5". number: of the tag.
        size: m, outer side of the black border.
        mount: m, m, rad: the tag's middle in the body frame and the turn of its x axis (the printed tag's to the right) from the
            nose. height: m of the tag over the water plane.
        unseen: m and rad, standard deviations of errors that one frame does not show (waves that shift the whole image, a hull
            that rolls); added to the covariance. `camera_noise.toml` of the study has them for drawn waves.

    Raises (on construction):
        UnknownName: another family. ConfigError: a number outside the family, or an impossible size.
    """

    calibration: Calibration
    family: str = "36h11"
    size: float = 0.06
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    number: int = 0
    height: float = 0.0
    unseen: tuple[float, float] = (0.0, 0.0)
    motion: PosePredictor = field(default_factory=PosePredictor, repr=False)
    light: tuple[float, float] | None = field(default=None, repr=False)  # grey of black, and of white less that of black

    def __post_init__(self):
        self.code = code_of(self.family, self.number)
        self.cells = len(self.code)
        if not 0.005 <= self.size <= 1.0:
            raise ConfigError(f"tag size {self.size:g} m, expected 0.005 to 1 m, the outer side of the black border")
        if not -1.0 <= self.height < self.calibration.camera[2]:
            raise ConfigError(f"tag height {self.height:g} m, expected -1 to {self.calibration.camera[2]:g} m, below the camera")
        cv2 = opencv("the tag tracker")
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, FAMILIES[self.family][0]))
        self.least = max(SEEN, CELLS / self.cells**2)
        self.scale = self.calibration.metres_per_pixel(self.height)  # m/px
        self.cell = self.size / self.cells / self.scale  # px
        settings = cv2.aruco.DetectorParameters()
        settings.adaptiveThreshWinSizeMin = settings.adaptiveThreshWinSizeMax = int(2 * CELL) | 1
        settings.minMarkerPerimeterRate, settings.maxMarkerPerimeterRate = 0.01, 8.0  # the size is checked in metres
        settings.minOtsuStdDev = 10.0
        self.reader = cv2.aruco.ArucoDetector(dictionary, settings)
        half, self.half = 0.5 * self.size, 0.9 * self.size
        self.outline = self._on_body(np.array([(-half, half), (half, half), (half, -half), (-half, -half)]))  # OpenCV's order
        self.pattern = self._pattern(cv2)

    def reset(self) -> None:
        """Forgets the last pose of the tag, and its light."""
        super().reset()
        self.light = None

    def _near(self, image: np.ndarray, pose: np.ndarray, window: tuple[int, int, int, int]) -> Aligned | None:
        return self._lit(self._followed(image, pose) or self._read(image, window))

    def _anywhere(self, image: np.ndarray) -> Aligned | None:
        return self._lit(self._read(image, (0, 0, *self.calibration.size), whole=True))

    def _lit(self, found: Aligned | None) -> Aligned | None:
        """The tag as found; its light is kept for the next frame."""
        self.light = self.light if found is None else found.light
        return found

    def reads_mirrored(self, image: np.ndarray) -> bool:
        """Returns True if the tag shows in the mirror image of a frame (H, W, 3): a mirrored tag is no member of its family."""
        cv2 = opencv("the tag tracker")
        flipped = cv2.flip(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), 1)
        zoom = float(np.clip(CELL / self.cell, 1.0, 2.0))
        flipped = cv2.resize(flipped, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_CUBIC) if zoom > 1 else flipped
        numbers = self.reader.detectMarkers(flipped)[1]
        return numbers is not None and self.number in numbers.ravel()

    def _followed(self, image: np.ndarray, pose: np.ndarray) -> Aligned | None:
        """The tag near its expected pose, also if it has turned by more than its cells can resolve."""
        found = self._aligned(image, pose, MATCH[self.family], coarse=False, light=self.light)
        for turn in TURNS:
            found = found or self._aligned(image, pose + [0.0, 0.0, turn], MATCH[self.family], light=self.light)
        return found or self._aligned(image, pose, MATCH[self.family])

    def _read(self, image: np.ndarray, window: tuple[int, int, int, int], *, whole: bool = False) -> Aligned | None:
        """Reads tags in part of the frame and aligns the one with our number.

        The whole frame is enlarged less: squares of the tag's size that could not be read there are read again, enlarged.
        """
        cv2 = opencv("the tag tracker")
        left, top, right, bottom = window
        if right - left < 12 or bottom - top < 12:
            return None
        part = cv2.cvtColor(image[top:bottom, left:right], cv2.COLOR_BGR2GRAY)
        zoom = float(np.clip(CELL / self.cell, 1.0, 2.0 if whole else 6.0))
        if zoom > 1:
            part = cv2.resize(part, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_CUBIC)
        # noise of single pixels would make OpenCV try thousands of outlines
        part = cv2.GaussianBlur(part, (0, 0), max(0.35 * zoom, 0.15 * self.cell * zoom))
        quads, numbers, unread = self.reader.detectMarkers(part)
        known = () if numbers is None else numbers.ravel()
        back = lambda quad: (np.asarray(quad, float).reshape(4, 2) + 0.5) / zoom - 0.5 + [left, top]
        read = [back(quad) for quad, n in zip(quads, known, strict=True) if n == self.number]
        poses = [pose for quad in read if (pose := self._fits(quad)) is not None]
        if any(np.hypot(*(p - poses[0])[:2]) > 0.5 * self.size for p in poses):
            return None  # two tags of one number: it could be either
        if poses:
            return self._aligned(image, poses[0], FRESH) or self._aligned(image, poses[0], FRESH, coarse=False)
        if whole:
            squares = [pose for quad in unread if (pose := self._fits(back(quad), ROUGHLY)) is not None]
            again = [a for pose in squares[:AGAIN] if (a := self._read(image, self._window(pose, 0.0))) is not None]
            if again and all(np.hypot(*(a.pose - again[0].pose)[:2]) < 0.5 * self.size for a in again):
                return again[0]
        return None

    def _fits(self, quad: np.ndarray, within: float = WITHIN) -> np.ndarray | None:
        """The pose (3,) of corners (4, 2) px in OpenCV's order; None if they are not a square of the tag's size."""
        pose, ratio, left = rigid(self.outline, self.calibration.to_tank(quad, self.height))
        return pose if abs(ratio - 1) < within and left < within * self.size else None

    def _aligned(
        self, image: np.ndarray, pose: np.ndarray, least: float, *, coarse: bool = True, light: tuple[float, float] | None = None
    ) -> Aligned | None:
        """The tag near a pose, or None if its cells do not match."""
        corners = self.calibration.to_pixel(placed(self.pattern.corners, pose), self.height)
        white = 255.0 if light is None else light[0] + BRIGHTER * light[1]
        patch = _patch(image, corners, 3, min(white, SATURATED))
        if patch is None:
            return None
        found = align(patch, self.pattern, pose, self.calibration, coarse=coarse, light=light)
        return found if found is not None and found.match >= least and found.seen >= self.least else None

    def _on_body(self, points: np.ndarray) -> np.ndarray:
        """Points (n, 2) of the printed tag, x right and y up, in the body frame."""
        return placed(points, np.asarray(self.mount, float))

    def _pattern(self, cv2) -> Pattern:
        """The tag with half a cell of its white rim."""
        side = self.size / self.cells
        rim = self._on_body(0.5 * (self.size + side) * np.array([(-1, 1), (1, 1), (1, -1), (-1, -1)]))
        low = np.floor((rim.min(0) - 0.004) / GRAIN) * GRAIN
        columns, rows = np.ceil((rim.max(0) + 0.004 - low) / GRAIN).astype(int) + 1
        fine = (np.arange(FINE * max(columns, rows)) + 0.5) / FINE - 0.5  # edges of cells fall between the grains
        x, y = np.meshgrid(low[0] + GRAIN * fine[: FINE * columns], low[1] + GRAIN * fine[: FINE * rows])
        c, s = np.cos(self.mount[2]), np.sin(self.mount[2])
        dx, dy = x - self.mount[0], y - self.mount[1]
        across, up = c * dx + s * dy, c * dy - s * dx
        cell_x, cell_y = np.floor(across / side + self.cells / 2).astype(int), np.floor(self.cells / 2 - up / side).astype(int)
        on = (cell_x >= 0) & (cell_x < self.cells) & (cell_y >= 0) & (cell_y < self.cells)
        values = np.ones(x.shape)
        values[on] = self.code[cell_y[on], cell_x[on]]
        inside = (np.abs(across) <= 0.5 * (self.size + side)) & (np.abs(up) <= 0.5 * (self.size + side))
        values = cv2.resize(values, (int(columns), int(rows)), interpolation=cv2.INTER_AREA)
        inside = inside[FINE // 2 :: FINE, FINE // 2 :: FINE]
        return Pattern(values, inside, low, self.outline, self.height, SPOT * self.scale)


def _patch(image: np.ndarray, corners: np.ndarray, margin: int, white: float) -> Patch | None:
    """The grey patch round corners (n, 2) px; pixels brighter than the tag's `white`, and their neighbours, have zero weight."""
    cv2 = opencv("the tag tracker")
    limit = np.array(image.shape[1::-1])
    low = (np.floor(corners.min(0)).astype(int) - margin).clip(0, limit)
    high = (np.ceil(corners.max(0)).astype(int) + 1 + margin).clip(0, limit)
    if (high - low < 8).any():
        return None
    grey = cv2.cvtColor(image[low[1] : high[1], low[0] : high[0]], cv2.COLOR_BGR2GRAY)
    glint = cv2.dilate((grey > white).astype(np.uint8), np.ones((3, 3), np.uint8))
    return Patch(grey.astype(np.float32), 1.0 - glint.astype(np.float32), low)
