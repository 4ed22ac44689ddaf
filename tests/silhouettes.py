"""Side views of fish of known sizes, rendered as a camera would see them; `python tests/silhouettes.py` measures the errors.

A fish is its upper and lower edge over shares of its length, a notch in the tail fin, and fins as polygons beside the hull.
"""

import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fishmj.mjcf.new.photo import read_photo
from fishmj.mjcf.new.shape import typical, typical_width

LENGTH, WIDTH = 0.6, 0.07  # m
METRES = 0.001  # of a pixel
SIZE = (860, 480)  # px
FINE = 6  # fish are drawn this many times larger, then averaged down: OpenCV fills a polygon with its rim


class Shape(NamedTuple):
    """A fish of length 1."""

    x: tuple[float, ...]
    height: tuple[float, ...]
    notch: float = 0.0  # depth of the tail fin's notch
    fins: tuple[tuple[tuple[float, float], ...], ...] = ()  # corners, y upwards from the axis

    def tall(self, x) -> np.ndarray:
        """Height at shares x of the length, tip to tip."""
        return np.interp(x, self.x, self.height)

    @property
    def root(self) -> float | None:
        """Where the tail fin begins."""
        x, h = np.array(self.x), np.array(self.height)
        rear = np.flatnonzero((x > 0.5) & (x < 1))
        i = int(rear[np.argmin(h[rear])])
        return float(x[i]) if h[i:].max() > 7 / 6 * h[i] else None


def _body(rear, high=0.18, deepest=0.25, tail=0.05):
    """An elliptical nose and a cosine to the tail's root at `rear`."""
    nose = deepest * (1 - np.cos(np.linspace(0, np.pi / 2, 25)))
    back = np.linspace(deepest, rear, 25)[1:]
    height = np.concatenate(
        [
            high * np.sin(np.linspace(0, np.pi / 2, 25)),
            tail + (high - tail) * 0.5 * (1 + np.cos(np.pi * (back - deepest) / (rear - deepest))),
        ]
    )
    return np.concatenate([nose, back]), height


def _shape(body, tail, **more) -> Shape:
    x, h = body
    return Shape(tuple(x) + tuple(a for a, _ in tail), tuple(h) + tuple(b for _, b in tail), **more)


def _typical() -> Shape:
    rows = typical(1.0, 0.183, 0.117, 0.233).rows
    return Shape(tuple(rows[:, 0]), tuple(rows[:, 1]))


DORSAL = ((0.33, 0.06), (0.44, 0.17), (0.47, 0.165), (0.5, 0.06))
SECOND = ((0.6, 0.02), (0.66, 0.1), (0.69, 0.02))
ANAL = ((0.56, -0.03), (0.63, -0.12), (0.66, -0.02))
PECTORAL = ((0.24, -0.05), (0.3, -0.15), (0.34, -0.05))
_THUNNIFORM = (_body(0.86, 0.2, 0.35, 0.03), [(0.9, 0.06), (0.95, 0.2), (0.98, 0.26), (1.0, 0.28)])
SHAPES = {
    "default": _typical(),
    "flare in the last 3 %": _shape(_body(0.97, tail=0.06), [(1.0, 0.2)]),
    "forked": _shape(_body(0.8), [(0.9, 0.14), (1.0, 0.22)], notch=0.1),
    "lunate": _shape(*_THUNNIFORM, notch=0.08),
    "eel": Shape((0, 0.01, 0.04, 0.1, 0.6, 0.9, 1.0), (0.006, 0.03, 0.055, 0.065, 0.06, 0.035, 0.006)),
    "boxfish": Shape((0, 0.02, 0.12, 0.55, 0.68, 0.74, 0.8, 0.9, 1.0), (0.12, 0.2, 0.38, 0.4, 0.28, 0.1, 0.08, 0.2, 0.22)),
    "five fins": _shape(_body(0.8), [(0.9, 0.14), (1.0, 0.2)], notch=0.06, fins=(DORSAL, SECOND, ANAL, PECTORAL)),
    "lunate, fins": _shape(*_THUNNIFORM, notch=0.08, fins=(DORSAL, ANAL)),
}
VIEWS = {
    "plain": {},
    "noise": {"noise": 14.0},
    "blur": {"blur": 3.0},
    "5 deg": {"tilt": 5.0},
    "-4 deg, nose right": {"tilt": -4.0, "nose": "right"},
    "uneven light": {"uneven": 60.0},
    "all": {"noise": 10.0, "blur": 2.0, "tilt": 3.0, "uneven": 40.0},
}


def render(path: Path, shape: Shape, *, tilt=0.0, noise=3.0, blur=1.0, uneven=12.0, nose="left", seed=0) -> Path:
    """A PNG of the fish, LENGTH long at METRES a pixel."""
    import cv2

    wide, high = SIZE
    v, u = np.mgrid[-1 : 1 : high * 1j, -1 : 1 : wide * 1j]
    light = uneven * (0.6 * u - 0.4 * v - 0.5 * u * u - 0.3 * v * v * v)
    image = np.stack([165 + light, 155 + 0.8 * light, 125 + 0.5 * light], -1)
    x = np.linspace(0, 1, 1201)
    half = shape.tall(x) / 2
    outline = np.r_[np.c_[x, half], np.c_[x[::-1], -half[::-1]]]
    if shape.notch:
        outline = np.r_[outline[:1201], [[1 - shape.notch, 0.0]], outline[1201:]]
    mirror = 1 if nose == "left" else -1
    c, s = np.cos(np.radians(tilt)), np.sin(np.radians(tilt))
    inside = np.zeros((FINE * high, FINE * wide), np.uint8)
    for polygon in (outline, *shape.fins):
        at = (np.array(polygon) - [0.5, 0.0]) * (LENGTH / METRES) * [mirror, -1]
        at = at @ [[c, s], [-s, c]] + [wide / 2, high / 2]
        cv2.fillPoly(inside, [np.round((at * FINE - 0.5) * 256).astype(np.int32)], 255, cv2.LINE_8, 8)
    cover = cv2.resize(inside, SIZE, interpolation=cv2.INTER_AREA)[..., None] / 255
    image = (1 - cover) * image + cover * np.array([60, 80, 200])
    image = cv2.GaussianBlur(image, (0, 0), blur) + np.random.default_rng(seed).normal(0, noise, image.shape)
    cv2.imwrite(str(path), np.clip(image, 0, 255).astype(np.uint8))
    return path


def sizes(x, height, root) -> dict[str, float]:
    """Length, side area, height of the tail fin (at its largest behind the root) and volume, m, with the typical widths."""
    share = x / x[-1]
    width = WIDTH * np.maximum(typical_width(share), 0.01)
    tail = height[x >= root].max() if root is not None else height[-1]
    return {
        "length": float(x[-1]),
        "area": float(np.trapezoid(height, x)),
        "tail": float(tail),
        "volume": float(np.trapezoid(np.pi / 4 * height * width, x)),
    }


def errors(shape: Shape, view: dict, folder: Path) -> tuple[dict[str, float], tuple[str, ...]]:
    """Relative errors of `sizes`, the greatest of the height over the greatest height, and what was said."""
    seen = read_photo(render(folder / "fish.png", shape, **view), scale=METRES, width=WIDTH)
    x = np.linspace(0, 1, 2001)
    truth = sizes(x * LENGTH, shape.tall(x) * LENGTH, None if shape.root is None else shape.root * LENGTH)
    rows, long = seen.outline.rows, seen.outline.length
    dense = x * long
    height = np.interp(dense, rows[:, 0], rows[:, 1])
    found = sizes(dense, height, seen.outline.fin_at)
    off = {key: found[key] / truth[key] - 1 for key in truth}
    if shape.root is None:
        off["tail"] = np.nan
    within = (x > 0.03) & (x < 0.97)
    off["height"] = float(np.abs(height - shape.tall(x) * LENGTH)[within].max() / (max(shape.height) * LENGTH))
    return off, seen.notes


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        print("| shape | length | area | tail fin's height | volume | height anywhere | fins left out |")
        print("|---|--:|--:|--:|--:|--:|--:|")
        for name, shape in SHAPES.items():
            found = [errors(shape, view, Path(folder)) for view in VIEWS.values()]
            row = []
            for key in ("length", "area", "tail", "volume", "height"):
                worst = max((off[key] for off, _ in found), key=abs)
                row.append("-" if np.isnan(worst) else f"{100 * worst:+.1f} %".lstrip("+" if key == "height" else ""))
            fins = {sum(note.count("m high") for note in notes) for _, notes in found}
            print(f"| {name} | {' | '.join(row)} | {', '.join(map(str, sorted(fins)))} of {len(shape.fins)} |")


if __name__ == "__main__":
    main()
