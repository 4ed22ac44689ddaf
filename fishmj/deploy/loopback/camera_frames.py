"""Frames of an overhead camera, drawn by OpenCV: test pictures for the tracker without a tank.

    look = FishLook.of("fish", marks="colour")
    frame = FrameArtist(calibration, look, FrameOptions(glare=1.0, ripple=1.0)).draw((x, y, yaw), joint, t)

The fish is drawn `FINE` times larger in the patch that it covers and averaged down: its centre of area is right within 0.05 px.
Without glare, ripple, light and JPEG only that patch is drawn; the rest is the picture of the empty tank and noise. The same
arguments give the same frame.

The tracker (`fishmj.deploy.tracker`) shares one thing with this file: the calibration's map from tank points to pixels. It knows
nothing of the lens's blur, vignetting, shading of the hull, noise, exposure, glints, waves and compression.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fishmj.base.errors import ConfigError, UnknownName
from fishmj.base.options import number, setting
from fishmj.deploy.tracker.calibration import Calibration
from fishmj.mjcf import Robot, geometry_of, load_robot
from fishmj.mjcf.from_above import opencv

FINE = 4  # times that the fish is drawn larger
RED, YELLOW, HULL, TAIL = (38, 34, 205), (40, 205, 225), (74, 66, 60), (120, 92, 52)  # BGR, as all colours here
WATER, LINE, LEAF, PLATE = (138, 112, 62), (158, 136, 92), (52, 88, 92), (236, 238, 238)
SHADES = ((1.0, 0.62), (0.8, 0.84), (0.5, 1.0))  # share of the hull's width, brightness: it is round
TILE = 0.25  # m, lines on the tank's floor
MURK = 0.12  # share of the water's colour over a hull just below the surface
GLINT_LIFE = 0.24  # s
DICTIONARIES = {"36h11": "DICT_APRILTAG_36h11", "16h5": "DICT_APRILTAG_16h5"}


Vector = Sequence[float] | np.ndarray


@dataclass(frozen=True, kw_only=True)
class TagPlate:
    """A printed tag on a white plate, on a post over the water."""

    family: str = "36h11"
    number: int = 0
    size: float = 0.06  # m, outer side of the black border
    mount: tuple[float, float, float] = (0.06, 0.0, 0.0)  # m, m, rad: its middle in the body frame, its x axis to the nose
    height: float = 0.03  # m above the water


@dataclass(frozen=True, kw_only=True)
class FishLook:
    """A fish as the camera sees it from above, body frame: x to the nose, y left, origin at the reference point, m.

    Attributes:
        outlines: one (n, 2) polygon a link, from its own front hinge; the head's from the reference point.
        hinges: (J,) x of the hinges along the straight body. head, neck: (n, 2) painted polygons of the head link, or None.
        plate: the tag, or None. height: m of the hull's top over the water plane.
    """

    outlines: tuple[np.ndarray, ...]
    hinges: np.ndarray
    head: np.ndarray | None = None
    neck: np.ndarray | None = None
    plate: TagPlate | None = None
    height: float = -0.005

    @classmethod
    def of(
        cls,
        robot: "str | Robot" = "fish",
        marks: str = "colour",
        *,
        plate: TagPlate | None = None,
        red: tuple[float, float] = (0.05, 0.175),
        yellow: tuple[float, float] = (-0.03, 0.012),
    ) -> "FishLook":
        """The look of a described robot.

        Args:
            marks: "colour" (red head, yellow neck) or "tag". red, yellow: from and to x of the painted bands, m, as wide as the
                hull; the bands of the description's rig go before them.

        Raises UnknownName: other marks; ConfigError: a band that is not on the head.
        """
        if marks not in ("colour", "tag"):
            raise UnknownName("marks of a drawn fish", marks, ("colour", "tag"))
        robot = load_robot(robot)
        hinges = np.asarray(geometry_of(robot).origin[1:], float)
        nose = robot.links[0].length + hinges[0]
        fronts = [nose, *np.zeros(robot.n_joints)]
        halves = lambda front, link: np.array([(front - s, 0.5 * w) for s, _, w in link.sections])
        shapes = [halves(front, link) for front, link in zip(fronts, robot.links, strict=True)]
        outlines = tuple(np.concatenate([half, half[::-1] * [1, -1]]) for half in shapes)
        if marks == "tag":
            return cls(outlines=outlines, hinges=hinges, plate=plate or TagPlate())
        bands = []
        for name, (low, high), painted in (("red", red, robot.rig.red), ("yellow", yellow, robot.rig.yellow)):
            x = np.linspace(low, high, 12)
            half = np.c_[x, np.interp(x, shapes[0][::-1, 0], shapes[0][::-1, 1])]
            if painted:
                half = np.array(painted) * [1.0, 0.5]
            if not hinges[0] <= half[0, 0] < half[-1, 0] <= nose:
                got, ends = f"{half[0, 0]:g} to {half[-1, 0]:g} m", f"{hinges[0]:.3f} to {nose:.3f} m"
                raise ConfigError(
                    f"{robot.name}: {name} paint from {got}, expected a band of the head link, {ends} ([rig] {name})"
                )
            bands.append(np.concatenate([half, half[::-1] * [1, -1]]))
        return cls(outlines=outlines, hinges=hinges, head=bands[0], neck=bands[1], height=robot.rig.paint_height)


@dataclass(frozen=True, kw_only=True)
class FrameOptions:
    """Disturbances between the fish and the file. The defaults are a good camera over a calm tank.

    Attributes:
        noise: standard deviation of every pixel, grey levels. blur: standard deviation of the lens's spot, px.
        vignetting: share of the light that the corners lack. exposure: s; needs the velocity in `draw`.
        glare: 0 none, 1 glints over some percent of the tank, half of them round the fish, saturated.
        ripple: root mean square displacement of the image by the waves, px, with waves of brightness.
        occlusion: share of the head link's length behind an opaque object, from one side beyond the middle.
        decoy: a second red object of the head's size, with another tag on it if the fish has one.
        light: relative amplitude of slow changes of the light and of its colour. jpeg: quality of the compression, or None.
    """

    noise: float = 2.5
    blur: float = 0.6
    vignetting: float = 0.3
    exposure: float = 0.0
    glare: float = setting(0.0, number(0, 3), "0 none, 1 glints over some percent of the tank")
    ripple: float = setting(0.0, number(0, 20), "px, by which waves shift the image")
    occlusion: float = setting(0.0, number(0, 1), "share of the head that something covers")
    decoy: bool = setting(False, None, "a second red object")
    light: float = 0.0
    jpeg: int | None = None
    seed: int = 0


class Drawn(NamedTuple):
    """One layer of the picture: a polygon (n, 2) in the tank, its height over the water, m, and its colour."""

    points: np.ndarray
    height: float
    colour: tuple[float, ...]


class FrameArtist:
    """Draws frames (H, W, 3) uint8 BGR of one camera. Raises MissingExtra without OpenCV."""

    def __init__(self, calibration: Calibration, look: FishLook, options: FrameOptions | None = None):
        self.cv2, self.calibration, self.look = opencv("drawn camera frames"), calibration, look
        self.options = options or FrameOptions()
        self.random = np.random.default_rng(self.options.seed)
        width, height = calibration.size
        x, y = (np.arange(n) / (n - 1) * 2 - 1 for n in (width, height))
        self.shade = (1 - self.options.vignetting * (x**2 + y[:, None] ** 2) / 2).astype(np.float32)
        empty = self._floor().astype(np.float32) * self.shade[..., None]
        self.empty = self._soft(np.clip(empty, 0, 255).astype(np.uint8))
        grain = self.random.normal(0, self.options.noise, (height + 64, width + 64, 3))
        self.grain = np.round(grain).astype(np.int16)
        self.waves = _waves(self.random, calibration.metres_per_pixel())

    def draw(self, pose: Vector, joint: Vector, t: float, velocity: Vector | None = None) -> np.ndarray:
        """The frame whose exposure is centred at t.

        Args:
            pose: x, y, yaw of the reference point, m, rad. joint: (J,) rad, from the head to the tail.
            velocity: (3,) m/s, rad/s in the tank frame, for the blur of the exposure.
        """
        o, image, place = self.options, self.empty.copy(), np.asarray(pose, float)
        chance = np.random.default_rng([o.seed, abs(hash(round(t * 1e6))) % 2**32])
        if o.decoy:
            self._paste(image, self._decoy(place, t), [np.zeros(3)])
        shifts = [np.zeros(3)]
        if o.exposure > 0 and velocity is not None:
            shifts = [np.asarray(velocity, float) * o.exposure * share for share in (-1 / 3, 0.0, 1 / 3)]
        self._paste(image, self._fish(place, np.asarray(joint, float), t), shifts, place)
        if o.ripple > 0:
            image = self._rippled(image, t)
        if o.light > 0:
            swing = np.sin(t * np.array([0.9, 0.7, 0.55]) + [0.3, 1.1, 2.0] + o.seed)
            gain = 1 + o.light * (0.7 * np.sin(0.8 * t + o.seed) + 0.3 * swing)
            table = np.clip(np.arange(256)[:, None] * gain, 0, 255).astype(np.uint8)[None]
            image = self.cv2.LUT(image, table)
        if o.glare > 0:
            image = self._glinting(image, place, t)
        if o.noise > 0:
            row, column = chance.integers(0, 64, 2)
            height, width = image.shape[:2]
            image = self.cv2.add(image, self.grain[row : row + height, column : column + width], dtype=self.cv2.CV_8U)
        if o.jpeg is not None:
            packed = self.cv2.imencode(".jpg", image, [self.cv2.IMWRITE_JPEG_QUALITY, o.jpeg])[1]
            image = self.cv2.imdecode(packed, self.cv2.IMREAD_COLOR)
        return image

    def _floor(self) -> np.ndarray:
        """The empty tank: water with uneven light, lines of tiles."""
        cv2, (width, height) = self.cv2, self.calibration.size
        coarse = self.random.normal(0, 1, (height // 40 + 2, width // 40 + 2)).astype(np.float32)
        uneven = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
        image = (np.array(WATER) + 5.0 * uneven[..., None]).clip(0, 255).astype(np.uint8)
        ends = np.linspace(-4.0, 4.0, 161)
        for at in np.arange(-4.0, 4.0 + 1e-9, TILE):
            for line in (np.c_[np.full_like(ends, at), ends], np.c_[ends, np.full_like(ends, at)]):
                pixels = np.round(self.calibration.to_pixel(line, -0.5) * 16)  # on the floor
                near = (np.abs(pixels) < 16 * 4000).all(1)
                cv2.polylines(image, [pixels[near].astype(np.int32).reshape(-1, 1, 2)], False, LINE, 1, cv2.LINE_AA, 4)
        return image

    def _soft(self, image: np.ndarray) -> np.ndarray:
        return self.cv2.GaussianBlur(image, (0, 0), self.options.blur) if self.options.blur > 0 else image

    def _fish(self, pose: np.ndarray, joint: np.ndarray, t: float) -> list[Drawn]:
        """The layers of the fish, the lowest first."""
        look, layers = self.look, []
        frames = [(pose[:2], pose[2])]
        at, angle, before = pose[:2], pose[2], 0.0
        for hinge, turn in zip(look.hinges, joint, strict=True):
            at = at + (hinge - before) * np.array([np.cos(angle), np.sin(angle)])
            angle, before = angle + turn, hinge
            frames.append((at, angle))
        for k in range(len(frames) - 1, 0, -1):
            layers += _rounded(look.outlines[k], frames[k], look.height, TAIL if k == len(frames) - 1 else HULL)
        layers += _rounded(look.outlines[0], frames[0], look.height, HULL)
        for patch, colour in ((look.head, RED), (look.neck, YELLOW)):
            if patch is not None:
                layers += _rounded(patch, frames[0], look.height, colour)
        if look.plate is not None:
            layers += _tag_layers(self.cv2, look.plate, frames[0], look.plate.number)
        if self.options.occlusion > 0:
            nose = look.outlines[0][:, 0].max()
            long = nose - look.hinges[0]
            middle = look.hinges[0] + long * (0.5 + 0.5 * np.sin(1.3 * t + self.options.seed))
            half, side = 0.5 * self.options.occlusion * long, 1 if np.sin(0.37 * t + self.options.seed) > 0 else -1
            leaf = np.array([(-half, -0.012), (half, -0.005), (0.8 * half, 0.06), (-0.9 * half, 0.055)]) * [1, side] + [middle, 0]
            layers.append(Drawn(_moved(leaf, frames[0]), 0.0, LEAF))
        return layers

    def _decoy(self, pose: np.ndarray, t: float) -> list[Drawn]:
        """A red object on its own path, always far enough from the reference point not to touch the hull."""
        wide, high = np.array(self.calibration.size) * self.calibration.metres_per_pixel() * 0.4
        phase = self.options.seed * 0.7
        loop = np.array([wide * np.sin(0.31 * t + phase), high * np.sin(0.43 * t + 2 * phase)])
        follow = 0.5 + 0.5 * np.sin(0.21 * t + phase)  # half of the time it is near the fish
        turn = 0.8 * t + phase
        place = (1 - follow) * loop + follow * (pose[:2] + 0.2 * np.array([np.cos(turn), np.sin(turn)]))
        axis = np.array([np.cos(pose[2]), np.sin(pose[2])])
        along = np.clip((place - pose[:2]) @ axis, -0.35, 0.18)
        away = place - (pose[:2] + along * axis)
        far = float(np.hypot(*away))
        if far < 0.11:
            away = away / far if far > 1e-9 else np.array([-axis[1], axis[0]])
            place = pose[:2] + along * axis + 0.11 * away
        angle = 0.5 * t + phase
        ring = np.linspace(0, 2 * np.pi, 24, endpoint=False)
        body = np.c_[0.066 * np.cos(ring), 0.031 * np.sin(ring)]
        layers = _rounded(body, (place, angle), self.look.height, RED)
        plate = self.look.plate
        if plate is not None:
            layers += _tag_layers(self.cv2, plate, (place, angle), plate.number + 1)
        return layers

    def _paste(self, image: np.ndarray, layers: list[Drawn], shifts: list[np.ndarray], centre=None) -> None:
        """Draws layers into `image`, averaged over the shifts (3,) m, m, rad about `centre`."""
        cv2, total = self.cv2, None
        counts = np.cumsum([0, *(len(layer.points) for layer in layers)])
        heights = sorted({layer.height for layer in layers})
        views = []
        for shift in shifts:
            world = np.concatenate([layer.points for layer in layers])
            if centre is not None and shift.any():
                world = _moved(world - centre[:2], (centre[:2] + shift[:2], shift[2]))
            pixels = np.empty_like(world)
            for height in heights:
                rows = np.concatenate([np.full(len(layer.points), layer.height == height) for layer in layers])
                pixels[rows] = self.calibration.to_pixel(world[rows], height)
            views.append(pixels)
        every = np.concatenate(views)
        limit = np.array(self.calibration.size)
        if not ((every.max(0) >= 0).all() and (every.min(0) <= limit).all()):
            return  # out of sight; so is what has no place
        low = np.floor(every.min(0).clip(0, limit) - 4).astype(int).clip(0, limit - 1)
        high = np.ceil(every.max(0).clip(0, limit) + 5).astype(int).clip(low + 1, limit)
        (width, height_px), where = high - low, (slice(low[1], high[1]), slice(low[0], high[0]))
        under = image[where]
        for pixels in views:
            fine = np.zeros((height_px * FINE, width * FINE, 3), np.uint8)
            cover = np.zeros((height_px * FINE, width * FINE), np.uint8)
            corners = np.round((((pixels - low) + 0.5) * FINE - 0.5) * 16).astype(np.int32)
            for layer, first, last in zip(layers, counts, counts[1:], strict=False):
                cv2.fillPoly(fine, [corners[first:last]], layer.colour, cv2.LINE_8, 4)
                cv2.fillPoly(cover, [corners[first:last]], 255, cv2.LINE_8, 4)
            size = (int(width), int(height_px))
            part = np.dstack(
                [cv2.resize(fine, size, interpolation=cv2.INTER_AREA), cv2.resize(cover, size, interpolation=cv2.INTER_AREA)]
            )
            total = part.astype(np.float32) if total is None else total + part
        total = self._soft(total / len(views)) if total is not None else np.zeros((1, 1, 4), np.float32)
        mixed = total[..., :3] * self.shade[where][..., None] + under * (1 - total[..., 3:] / 255)
        image[where] = np.clip(mixed + 0.5, 0, 255).astype(np.uint8)

    def _rippled(self, image: np.ndarray, t: float) -> np.ndarray:
        """The image displaced by the slopes of travelling waves, brighter on one side of them."""
        cv2, (width, height) = self.cv2, self.calibration.size
        step = 8
        x, y = np.meshgrid(np.arange(0, width + step, step), np.arange(0, height + step, step))
        slope = np.zeros((2, *x.shape))
        for kx, ky, speed, phase in self.waves:
            wave = np.cos(kx * x + ky * y - speed * t + phase)
            slope += np.array([kx, ky])[:, None, None] / np.hypot(kx, ky) * wave
        slope *= self.options.ripple / np.sqrt(0.25 * len(self.waves))
        size = (x.shape[1] * step, x.shape[0] * step)
        half = 0.5 * step - 0.5  # a coarse value stands in the middle of its block after cv2.resize
        across = cv2.resize((x + slope[0]).astype(np.float32), size)[:height, :width] + np.float32(half)
        down = cv2.resize((y + slope[1]).astype(np.float32), size)[:height, :width] + np.float32(half)
        whole, part = cv2.convertMaps(across, down, cv2.CV_16SC2)  # to a 32nd of a pixel, and twice as fast
        bent = cv2.remap(image, whole, part, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        light = cv2.resize((10 * self.options.ripple * slope[0] / max(self.options.ripple, 1e-9)).astype(np.float32), size)
        light = np.round(light[:height, :width]).astype(np.int16)
        return cv2.add(bent, cv2.merge([light, light, light]), dtype=cv2.CV_8U)

    def _glinting(self, image: np.ndarray, pose: np.ndarray, t: float) -> np.ndarray:
        """Glints and streaks of the sky: white, saturated, each for a quarter of a second; half of them near the fish."""
        cv2, (width, height), o = self.cv2, self.calibration.size, self.options
        fish = self.calibration.to_pixel(pose[:2])[0]
        px = self.calibration.metres_per_pixel()
        light = np.zeros((height // 2, width // 2), np.uint8)
        for k in range(round(44 * o.glare)):
            epoch, share = divmod(t / GLINT_LIFE + k * 0.618, 1.0)
            random = np.random.default_rng([o.seed, k, int(epoch) % 2**32])
            near = k % 2 == 0
            at = fish + random.normal(0, 0.16 / px, 2) if near else random.uniform(0, [width, height])
            at = at + random.normal(0, 0.15 / px, 2) * (share - 0.5) * GLINT_LIFE
            if not (np.abs(at / (width, height) - 0.5) < 1.0).all():
                continue  # out of sight, as those round a fish that is
            streak = random.random() < 0.4
            long = random.uniform(0.02, 0.12) if streak else random.uniform(0.006, 0.022)
            wide = random.uniform(0.0025, 0.006) if streak else long * random.uniform(0.4, 1.0)
            axes = tuple(int(8 * v / px * np.sin(np.pi * share) ** 0.5) + 4 for v in (long, wide))
            centre = tuple(int(v) for v in np.round(at * 8))
            _ellipse(cv2, light, centre, axes, random.uniform(0, 180))
        light = cv2.resize(cv2.GaussianBlur(light, (0, 0), 0.9), (width, height), interpolation=cv2.INTER_LINEAR)
        return cv2.add(image, cv2.merge([light, light, light]))


def _ellipse(cv2, image: np.ndarray, centre, axes, angle: float) -> None:
    """A filled ellipse; centre and axes in 16ths of a pixel."""
    ring = cv2.ellipse2Poly((0, 0), (1000, 1000), 0, 0, 360, 15) / 1000.0
    turn = np.radians(angle)
    points = ring * axes @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]) + centre
    cv2.fillPoly(image, [np.round(points).astype(np.int32)], 255, cv2.LINE_AA, 4)


def _waves(random: np.random.Generator, metres_per_pixel: float) -> list[tuple[float, float, float, float]]:
    """Six deep-water waves: wave numbers, rad/px, angular speed sqrt(g k), rad/s, and phase."""
    waves = []
    for length in (0.25, 0.3, 0.38, 0.47, 0.6, 0.8):  # m
        k, way = 2 * np.pi / length, random.uniform(0, 2 * np.pi)
        kx, ky = k * metres_per_pixel * np.cos(way), k * metres_per_pixel * np.sin(way)
        waves.append((kx, ky, float(np.sqrt(9.81 * k)), random.uniform(0, 2 * np.pi)))
    return waves


def _moved(points: np.ndarray, frame) -> np.ndarray:
    """Points (n, 2) of a frame (origin (2,), angle) in the tank."""
    (x, y), angle = frame
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, s], [-s, c]]) + [x, y]


def _rounded(outline: np.ndarray, frame, height: float, colour: tuple[int, int, int]) -> list[Drawn]:
    """A hull's outline with a brighter back, under a little water."""
    layers = []
    for share, light in SHADES:
        tone = tuple((1 - MURK) * light * c + MURK * w for c, w in zip(colour, WATER, strict=True))
        layers.append(Drawn(_moved(outline * [1, share], frame), height, tone))
    return layers


def _tag_layers(cv2, plate: TagPlate, frame, number: int) -> list[Drawn]:
    """The plate, its black square and its white cells."""
    if plate.family not in DICTIONARIES:
        raise UnknownName("tag family", plate.family, DICTIONARIES)
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, DICTIONARIES[plate.family]))
    cells = dictionary.markerSize + 2
    image = cv2.aruco.generateImageMarker(dictionary, number, cells, borderBits=1)
    side = plate.size / cells
    (x, y, yaw), layers = plate.mount, []
    square = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])

    def add(corners: np.ndarray, colour) -> None:
        layers.append(Drawn(_moved(_moved(corners, ((x, y), yaw)), frame), plate.height, colour))

    add(square * (plate.size + 2 * side), PLATE)
    add(square * plate.size, (24, 24, 24))
    for row, column in zip(*np.nonzero(image > 127), strict=True):
        middle = np.array([column + 0.5 - cells / 2, cells / 2 - row - 0.5]) * side
        add(square * side + middle, PLATE)
    return layers
