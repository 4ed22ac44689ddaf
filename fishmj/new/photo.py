"""An outline from a side view in a photo: the fish stands out from its background, and the ruler gives the scale.

    background   a quadratic in x and y through the picture's margin, in each colour channel (CIE Lab): light falls off evenly
    fish         the largest piece of what differs from it by more than Otsu's threshold (Otsu 1979), holes filled
    axis         the principal axis of its pixels; heights are top to bottom across it

A picture in which this is not clear is refused: an outline that is half right would be a fish that swims wrongly.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fishmj.errors import ConfigError, MissingExtra
from fishmj.names import nearest
from fishmj.new.shape import Outline, root_of_fin, typical_width

BYTES = 50_000_000  # of the file
PIXELS = 50_000_000  # of the picture; looked up before it is decoded
WORK = 1200  # px, the longer side of the picture that is worked on
STATIONS = 28  # sections along the fish
MARGIN = 0.04  # of the shorter side, where only background is expected
AREA = (0.01, 0.75)  # of the picture, that a fish covers
CONTRAST = 4.0  # of the fish against its background, in deviations of the background
VISIBLE = 6.0  # the same, in units of CIE Lab
SLENDER = 1.6  # length over height, at least
OTHERS = 0.35  # of the fish's area, that the next piece may have
NARROW = 0.02  # of the fish's length at either end, inside which the ends' heights are taken


class Seen(NamedTuple):
    """What was found in a photo."""

    outline: Outline
    overlay: bytes  # a PNG to check by eye
    metres_per_pixel: float


def read_photo(
    path: Path, *, length: float | None = None, scale: float | None = None, nose: str = "left", width: float | None = None,
    width_ratio: float = 0.66,
) -> Seen:  # fmt: skip
    """The outline of a fish in a side view.

    Args:
        length: of the fish, m; or `scale`, m per pixel of the file. Both must agree to 5 %.
        nose: "left" or "right".
        width: the greatest, m; by default `width_ratio` times the greatest height. Widths along the fish are typical ones.

    Raises:
        ConfigError: no picture, too large a one, a truncated one, no clear outline, or no scale.
    """
    cv2 = _cv2()
    picture = _decoded(cv2, path)
    factor = min(1.0, WORK / max(picture.shape[:2]))
    small = cv2.resize(picture, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA) if factor < 1 else picture
    mask = _fish(cv2, small, path)
    along, across, axis, middle = _axis(mask, nose)
    pixels = float(np.ptp(along)) + 1
    found = None if scale is None else scale * pixels / factor
    total = length if length is not None else found
    if total is None:
        raise ConfigError(f"new: {path}: no scale; give --length, the fish's in m, or --scale, m per pixel of the file")
    if found is not None and length is not None and abs(found / length - 1) > 0.05:
        raise ConfigError(
            f"new: {path}: --scale {scale:g} makes the fish {found:.3g} m long, --length says {length:g} m; mend one of them"
        )
    unit = total / pixels  # m per pixel of the small picture
    x, height = _profile(along, across, pixels)
    rows = _sections(x * (total / x[-1]), height * unit)
    greatest = width if width is not None else width_ratio * rows[:, 1].max()
    rows[:, 2] = greatest * np.maximum(typical_width(rows[:, 0] / rows[-1, 0]), 0.01)
    outline = Outline(rows, root_of_fin(rows[:, 0], rows[:, 1]), f"photo {nearest(path.name)}")
    overlay = _overlay(cv2, small, mask, rows / unit, axis, middle, float(along.min()))
    return Seen(outline, overlay, unit * factor)


def size_of(data: bytes) -> tuple[int, int] | None:
    """Width and height in pixels from the header of a PNG or JPEG, or None; decodes nothing."""
    if data[:8] == b"\x89PNG\r\n\x1a\n" and data[12:16] == b"IHDR" and len(data) >= 24:
        return int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")
    if data[:2] != b"\xff\xd8":
        return None
    at = 2
    while at + 9 <= len(data):
        if data[at] != 0xFF:
            return None
        kind = data[at + 1]
        if 0xC0 <= kind <= 0xCF and kind not in (0xC4, 0xC8, 0xCC):  # a start of frame
            return int.from_bytes(data[at + 7 : at + 9], "big"), int.from_bytes(data[at + 5 : at + 7], "big")
        if kind == 0xFF or 0xD0 <= kind <= 0xD8 or kind == 0x01:  # fill bytes and markers without a length
            at += 1 if kind == 0xFF else 2
            continue
        at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return None


def _decoded(cv2, path: Path) -> np.ndarray:
    """The picture (H, W, 3) BGR, after its header was found harmless."""
    try:
        if not path.is_file():
            raise ConfigError(f"{path}: no such file; expected a side view as PNG or JPG")
        if path.stat().st_size > BYTES:
            raise ConfigError(f"{path}: {path.stat().st_size / 1e6:.0f} MB; a photo may have {BYTES / 1e6:.0f} MB")
        data = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from error
    size = size_of(data)
    if size is None:
        raise ConfigError(f"{path}: not a PNG or JPG picture")
    wide, high = size
    if not (wide >= 64 and high >= 32 and wide * high <= PIXELS):
        raise ConfigError(f"{path}: {wide} x {high} pixels; expected 64 x 32 to {PIXELS / 1e6:.0f} million in all")
    end, last = (b"IEND", b"IDAT") if data[:1] == b"\x89" else (b"\xff\xd9", b"\xff\xda")
    if data.rfind(end) <= data.rfind(last):
        raise ConfigError(f"{path}: the picture is truncated: its end is missing; copy it again")
    try:
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    except cv2.error as error:
        raise ConfigError(f"{path}: OpenCV cannot decode it: {str(error).splitlines()[0][:120]}") from error
    if picture is None:
        raise ConfigError(f"{path}: damaged: OpenCV cannot decode it; copy it again or save it as PNG")
    return picture


def _fish(cv2, picture: np.ndarray, path: Path) -> np.ndarray:
    """Mask (H, W) bool of the fish. Raises ConfigError where it is not clear which pixels are fish."""
    high, wide = picture.shape[:2]
    lab = cv2.cvtColor(cv2.GaussianBlur(picture, (0, 0), max(1.0, wide / 600)), cv2.COLOR_BGR2LAB).astype(np.float32)
    edge = np.ones((high, wide), bool)
    rim = max(2, int(MARGIN * min(high, wide)))
    edge[rim:-rim, rim:-rim] = False
    v, u = np.mgrid[-1 : 1 : high * 1j, -1 : 1 : wide * 1j].astype(np.float32)
    terms = np.stack([np.ones_like(u), u, v, u * v, u * u, v * v], -1)
    fit, *_ = np.linalg.lstsq(terms[edge], lab[edge], rcond=None)
    away = np.linalg.norm(lab - terms @ fit, axis=-1)
    rest = away[edge]
    level = np.clip(away * (255 / max(float(away.max()), 1e-6)), 0, 255).astype(np.uint8)
    threshold, above = cv2.threshold(level, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    size = max(3, wide // 200) | 1
    above = cv2.morphologyEx(above, cv2.MORPH_OPEN, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)))
    n, labels, stats, _ = cv2.connectedComponentsWithStats(above, connectivity=4)
    unclear = f"{path}: no clear outline of a fish: "
    advice = "; take the side view on a plain background with free water or wall all around it"
    if n < 2:
        raise ConfigError(f"{unclear}nothing stands out from the background{advice}")
    areas = stats[1:, cv2.CC_STAT_AREA]
    order = np.argsort(-areas)
    best = 1 + int(order[0])
    mask = labels == best
    contrast = float(np.median(away[mask]) - np.median(rest)), float(rest.std() + 1e-6)
    if contrast[0] < max(CONTRAST * contrast[1], VISIBLE):
        raise ConfigError(
            f"{unclear}the largest thing differs from the background by {contrast[0]:.3g}, which itself varies"
            f" by {contrast[1]:.3g}{advice}"
        )
    share = areas[order[0]] / mask.size
    if not AREA[0] <= share <= AREA[1]:
        raise ConfigError(
            f"{unclear}the largest thing covers {100 * share:.2g} % of the picture, expected {100 * AREA[0]:g} to"
            f" {100 * AREA[1]:g}{advice}"
        )
    if len(order) > 1 and areas[order[1]] > OTHERS * areas[order[0]]:
        raise ConfigError(f"{unclear}there are two things of like size, {areas[order[0]]} and {areas[order[1]]} pixels{advice}")
    if mask[[0, -1]].any() or mask[:, [0, -1]].any():
        raise ConfigError(f"{unclear}the largest thing touches the edge of the picture; the whole fish must be inside")
    outer, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    filled = np.zeros(mask.shape, np.uint8)
    cv2.drawContours(filled, [max(outer, key=cv2.contourArea)], -1, 1, cv2.FILLED)
    values = np.linalg.eigvalsh(np.cov(np.stack(np.nonzero(filled))))
    if values[1] < SLENDER**2 * values[0]:
        raise ConfigError(
            f"{unclear}the largest thing is {np.sqrt(values[1] / values[0]):.2g} times as long as high, expected {SLENDER:g}"
            f" or more{advice}"
        )
    return filled.astype(bool)


def _axis(mask: np.ndarray, nose: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Pixels of the fish along its axis from nose to tail and across it (P,), the axis (2,) and the middle (2,), in (x, y)."""
    points = np.stack(np.nonzero(mask)[::-1], -1).astype(float)
    middle = points.mean(0)
    axis = np.linalg.eigh(np.cov((points - middle).T))[1][:, -1]
    axis = axis * (1 if axis[0] >= 0 else -1) * (1 if nose == "left" else -1)  # from nose to tail
    away = points - middle
    return away @ axis, away @ np.array([-axis[1], axis[0]]), axis, middle


def _profile(along: np.ndarray, across: np.ndarray, pixels: float) -> tuple[np.ndarray, np.ndarray]:
    """Stations (n,) from the nose and the fish's height there, px, one a pixel; smoothed over a hundredth of the fish."""
    from scipy.ndimage import median_filter

    bins = (along - along.min() + 0.5).astype(int)
    n = bins.max() + 1
    top, bottom = np.full(n, -np.inf), np.full(n, np.inf)
    np.maximum.at(top, bins, across)
    np.minimum.at(bottom, bins, across)
    there = np.isfinite(top)
    height = np.interp(np.arange(n), np.flatnonzero(there), (top - bottom + 1)[there])
    return np.arange(n) * (pixels / n), median_filter(height, size=max(3, int(pixels / 100)) | 1, mode="nearest")


def _sections(x: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Rows (S, 3) of a profile, dense at the nose; the width is still zero. The end is what stands just before it."""
    total = x[-1]
    share = np.linspace(0, 1, STATIONS)
    stations = total * np.unique(np.concatenate([[0, 0.007, 0.025, 0.05], 0.08 + 0.92 * share]))
    at = np.clip(stations, NARROW / 8 * total, (1 - NARROW) * total)
    return np.stack([stations, np.interp(at, x, height), np.zeros(len(stations))], -1)


def _overlay(cv2, picture, mask, rows, axis, middle, start: float) -> bytes:
    """The picture with outline, axis and sections drawn on it, as PNG."""
    drawn = (0.65 * picture + 0.35 * np.where(mask[..., None], np.array([80.0, 200.0, 255.0]), picture)).astype(np.uint8)
    outer, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(drawn, outer, -1, (0, 90, 255), 2, cv2.LINE_AA)
    normal = np.array([-axis[1], axis[0]])
    point = lambda p: tuple(int(round(v)) for v in p)  # noqa: E731
    tip, tail = middle + start * axis, middle + (start + rows[-1, 0]) * axis
    cv2.line(drawn, point(tip), point(tail), (255, 255, 255), 1, cv2.LINE_AA)
    for x, height, _ in rows:
        at = tip + x * axis
        cv2.line(drawn, point(at - height / 2 * normal), point(at + height / 2 * normal), (255, 160, 0), 1, cv2.LINE_AA)
    cv2.putText(drawn, "nose", point(tip + [-20, -12]), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (0, 0, 255), 2, cv2.LINE_AA)
    done, data = cv2.imencode(".png", drawn)
    if not done:
        raise ConfigError("new: OpenCV could not encode the picture of the outline")
    return data.tobytes()


def _cv2() -> Any:
    try:
        import cv2
    except ImportError as error:
        raise MissingExtra("opencv-python-headless", "all", "an outline from a photo") from error
    return cv2


__all__ = ["Seen", "read_photo", "size_of"]
