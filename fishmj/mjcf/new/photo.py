"""An outline from a side view in a photo: the fish stands out from its background, and the ruler gives the scale.

    background   a quadratic in x and y through the picture's margin, in each colour channel (CIE Lab): light falls off evenly
    fish         the largest piece that differs from it by more than Otsu's threshold (Otsu 1979), holes filled
    axis         the principal axis of its pixels without its fins; heights are top to bottom across it
    edges        upper and lower edge of the fish over its axis, one value a pixel, a median over a half of a hundredth of it
    fins         bumps of an edge in front of the tail fin, shorter than a quarter of the fish: grey opening of the edge with that
                 length (Serra 1982), if they rise from the line on both sides by 0.08 of the height
    head         the end without a tail fin; if neither or both flare, the end nearer to the centroid of the area
    sections     Douglas and Peucker (1973) on the heights: they keep every extremum, to a pixel where 48 sections suffice

An unclear picture is refused: a half-right outline would make a fish that swims wrongly.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.base.names import nearest
from fishmj.base.plain_file import why_unreadable
from fishmj.mjcf.from_above import opencv
from fishmj.mjcf.new.shape import Outline, root_of_fin, typical_width

BYTES = 50_000_000  # of the file
PIXELS = 50_000_000  # of the picture; looked up before it is decoded
WORK = 1200  # px, the longer side of the picture that is worked on
MARGIN = 0.04  # of the shorter side, where only background is expected
AREA = (0.01, 0.75)  # of the picture, that a fish covers
SHARP = 0.7  # px, of the blur in which the rim is placed
CONTRAST = 4.0  # of the fish against its background, in deviations of the background
VISIBLE = 6.0  # the same, in units of CIE Lab
SLENDER = 1.6  # length over height, at least
OTHERS = 0.35  # of the fish's area, that the next piece may have
UPRIGHT = 45.0  # deg of tilt, from which left and right do not tell the ends apart
LONGEST_FIN = 0.25  # of the fish's length: what is longer is a back
STANDS_OUT = 0.08  # of the fish's height
FOOT = 0.02  # of the length, around a fin, that its edge takes to come down to the body
SLOPE = 0.05  # of the length, over which the body's slope beside a fin is measured
END = 0.02  # of the length: a slanted or torn end is filled from what stands just before it
FIRST = (0.007, 0.025)  # shares of the length with a section each: the nose is round
SECTIONS = 48  # at most
LEANS = 0.01  # of the length, between the middle of the area and that of the fish, below which an end is not told from the other


class Edges(NamedTuple):
    """Upper and lower edge of the fish over its axis, n stations a pixel apart, from the end called nose. Pixels."""

    x: np.ndarray  # (n,) from the nose
    top: np.ndarray  # (n,) across the axis, upwards
    bottom: np.ndarray  # (n,)

    @property
    def height(self) -> np.ndarray:
        """Heights (n,) in pixels, both rims included."""
        return self.top - self.bottom + 1

    def turned(self) -> "Edges":
        """Copy with the other end as the nose."""
        return Edges(self.x, self.top[::-1], self.bottom[::-1])


class FinSeen(NamedTuple):
    """An appendage in front of the tail fin, left out of the hull. Pixels."""

    above: bool
    start: float  # from the nose
    end: float
    reach: float  # over the hull


class PhotoReading(NamedTuple):
    """Result of reading a photo."""

    outline: Outline
    overlay: bytes  # a PNG to check by eye
    notes: tuple[str, ...]  # what was guessed or left out, a line each, with the option that changes it


class View(NamedTuple):
    """The fish in a picture. Pixels, (x, y) with y down."""

    hull: Edges
    fins: list[FinSeen]
    nose: str  # left or right
    why: str  # that end
    tip: np.ndarray  # (2,) the nose
    axis: np.ndarray  # (2,) from nose to tail
    up: np.ndarray  # (2,) across it


def read_photo(
    path: Path, *, length: float | None = None, scale: float | None = None, nose: str | None = None, width: float | None = None,
    width_ratio: float = 0.66,
) -> PhotoReading:  # fmt: skip
    """The outline of a fish in a side view.

    Args:
        length: of the fish, m; or `scale`, m per pixel of the file. Both must agree to 5 %.
        nose: "left" or "right"; by default the end that looks like a head.
        width: the greatest, m; by default `width_ratio` times the greatest height. Widths along the fish are typical ones.

    Raises ConfigError: no picture, too large a one, a truncated one, no clear outline, ends that look alike, or no scale.
    """
    cv2 = opencv("an outline from a photo")
    picture = _decoded(cv2, path)
    factor = min(1.0, WORK / max(picture.shape[:2]))
    small = cv2.resize(picture, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA) if factor < 1 else picture
    mask = _fish(cv2, small, path)
    view = _view(mask, nose, path)
    pixels = float(view.hull.x[-1] + view.hull.x[1])
    found = None if scale is None else scale * pixels / factor
    total = length if length is not None else found
    if total is None:
        raise ConfigError(f"new: {path}: no scale; give --length, the fish's in m, or --scale, m per pixel of the file")
    if found is not None and length is not None and abs(found / length - 1) > 0.05:
        raise ConfigError(
            f"new: {path}: --scale {scale:g} makes the fish {found:.3g} m long, --length says {length:g} m; mend one of them"
        )
    unit = total / pixels  # m per pixel of the small picture
    sections = sections_of(cv2, view.hull)
    x, height = sections[:, 0] * (total / sections[-1, 0]), sections[:, 1] * unit
    root = root_of_fin(view.hull.x, view.hull.height)
    fin_at = None if root is None else root * (total / sections[-1, 0])
    greatest = width if width is not None else width_ratio * float(height[x <= (total if fin_at is None else fin_at)].max())
    rows = np.stack([x, height, greatest * np.maximum(typical_width(x / total), 0.01)], -1)
    guessed = "times --width"
    if width is None:
        guessed = f"and {greatest:.3g} m at most, {width_ratio:g} of the body's height, is a guess: measure it, --width"
    notes = _notes(view, unit, nose) + [
        f"width: a side view does not show it; along the fish it is the default fish's, {guessed}; --sections takes a table of"
        " widths"
    ]
    outline = Outline(rows, fin_at, f"photo {nearest(path.name)}")
    return PhotoReading(outline, _overlay(cv2, small, mask, view, sections), tuple(notes))


def _notes(view: View, unit: float, asked: str | None) -> list[str]:
    """Notes on the detected head and fins."""
    other = "right" if view.nose == "left" else "left"
    if asked is None:
        lines = [f"nose: {view.nose}, because {view.why}; --nose {other} turns it"]
    else:
        lines = [f"nose: {view.nose}, as --nose says" + (f", although {view.why}: look at the picture" if view.why else "")]
    place = lambda fin: f"{'above' if fin.above else 'below'} at {unit * fin.start:.3f} to {unit * fin.end:.3f} m"
    if view.fins:
        which = ", ".join(f"{place(fin)} ({unit * fin.reach:.2g} m high)" for fin in view.fins)
        lines.append(f"fins left out of the hull, from the nose: {which}; --sections takes a hull with them")
    return lines


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
        if wrong := why_unreadable(path, ""):
            raise ConfigError(f"{path}: {wrong}; expected a side view as PNG or JPG")
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
    """Mask (H, W) bool of the fish. Raises ConfigError if its pixels are not clear."""
    high, wide = picture.shape[:2]
    fine = cv2.cvtColor(picture, cv2.COLOR_BGR2LAB).astype(np.float32)
    lab = cv2.GaussianBlur(fine, (0, 0), max(1.0, wide / 600))
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
    sharp = np.linalg.norm(cv2.GaussianBlur(fine, (0, 0), SHARP) - terms @ fit, axis=-1)
    outer, _ = cv2.findContours(_at_half(cv2, mask.astype(np.uint8), sharp, size + 4), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    filled = np.zeros(mask.shape, np.uint8)
    cv2.drawContours(filled, [max(outer, key=cv2.contourArea)], -1, 1, cv2.FILLED)
    values = np.linalg.eigvalsh(np.cov(np.stack(np.nonzero(filled))))
    if values[1] < SLENDER**2 * values[0]:
        raise ConfigError(
            f"{unclear}the largest thing is {np.sqrt(values[1] / values[0]):.2g} times as long as high, expected {SLENDER:g}"
            f" or more{advice}"
        )
    return filled.astype(bool)


def _at_half(cv2, mask: np.ndarray, away: np.ndarray, size: int) -> np.ndarray:
    """Mask with its rim, `size` px wide, moved to half of the contrast beside it; restores fine tips."""
    around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    beside = cv2.dilate(cv2.blur(away, (3, 3)), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * size + 1, 2 * size + 1)))
    rim = cv2.dilate(mask, around) & (away > 0.5 * beside)
    return rim | cv2.erode(mask, around)


def _view(mask: np.ndarray, nose: str | None, path: Path) -> View:
    """View of the fish in a mask. Raises ConfigError if it stands upright, or if its ends look alike and `nose` is not given."""
    points = np.stack(np.nonzero(mask)[::-1], -1).astype(float)
    body = np.ones(len(points), bool)
    for _ in range(2):  # the second time without the fins, which tilt the axis
        axis = np.linalg.eigh(np.cov(points[body].T))[1][:, -1]
        axis = axis * (1 if axis[0] >= 0 else -1)  # from left to right
        if abs(np.degrees(np.arctan2(axis[1], axis[0]))) > UPRIGHT:
            raise ConfigError(f"new: {path}: the fish stands upright; turn the photo until it lies level, nose left or right")
        up = np.array([axis[1], -axis[0]])
        along, across = points @ axis, points @ up
        edges = edges_of(along, across)
        left, why = head(edges)
        if nose is None and left is None:
            raise ConfigError(f"new: {path}: no clear head: {why}; say which end it is, --nose left or --nose right")
        first = nose == "left" if nose is not None else bool(left)
        hull, fins = hull_of(edges if first else edges.turned())
        at = (along - along.min() + 0.5).astype(int)
        seen = hull if first else hull.turned()
        body = (across <= seen.top[at] + 0.5) & (across >= seen.bottom[at] - 0.5)
    doubt = "" if nose is not None and left in (None, first) else why
    start = float(along.min() if first else along.max())
    ahead = axis if first else -axis
    return View(hull, fins, "left" if first else "right", doubt, start * axis, ahead, up)


def _overlay(cv2, picture, mask, view: View, sections) -> bytes:
    """PNG of the picture with the hull, its sections, the omitted fins and both ends drawn on it."""
    point = lambda x, y: tuple(int(round(v)) for v in view.tip + x * view.axis + y * view.up)
    hull, orange, violet = view.hull, np.array([80.0, 200.0, 255.0]), np.array([220.0, 60.0, 200.0])
    top, bottom = ([point(*pair) for pair in zip(hull.x, edge, strict=True)] for edge in (hull.top, hull.bottom))
    inside = np.zeros(mask.shape, np.uint8)
    cv2.fillPoly(inside, [np.array(top + bottom[::-1])], 1)
    fins = mask & (cv2.dilate(inside, np.ones((3, 3), np.uint8)) == 0) if view.fins else np.zeros_like(mask)
    drawn = picture.astype(float)
    drawn[mask] = 0.65 * drawn[mask] + 0.35 * orange
    drawn[fins] = 0.3 * picture[fins] + 0.7 * violet
    drawn = drawn.astype(np.uint8)
    outer, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(drawn, outer, -1, (0, 90, 255), 1, cv2.LINE_AA)
    middle = float(hull.top[0] + hull.bottom[0]) / 2
    cv2.line(drawn, point(0, middle), point(hull.x[-1], middle), (255, 255, 255), 1, cv2.LINE_AA)
    for x, _ in sections:
        high, low = (float(np.interp(x, hull.x, edge)) for edge in (hull.top, hull.bottom))
        cv2.line(drawn, point(x, high), point(x, low), (255, 160, 0), 1, cv2.LINE_AA)
    words = [("nose", 0.0, (0, 0, 255)), ("tail", float(hull.x[-1]), (0, 0, 255))]
    words += [("fin, left out", (fin.start + fin.end) / 2, (200, 0, 170)) for fin in view.fins]
    levels = [hull.height.max() * 0.75] * 2 + [(0.75 if fin.above else -0.75) * hull.height.max() for fin in view.fins]
    for (text, x, colour), level in zip(words, levels, strict=True):
        (wide, high), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.6, 2)
        u, v = point(x, middle + level)
        at = int(np.clip(u - wide / 2, 2, drawn.shape[1] - wide - 2)), int(np.clip(v, high + 2, drawn.shape[0] - 4))
        cv2.putText(drawn, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.6, colour, 2, cv2.LINE_AA)
    done, data = cv2.imencode(".png", drawn)
    if not done:
        raise ConfigError("new: OpenCV could not encode the picture of the outline")
    return data.tobytes()


# the silhouette: its head end, its fins, and the few sections that keep its shape


def edges_of(along: np.ndarray, across: np.ndarray) -> Edges:
    """Edges of the pixels (P,) of a fish, along its axis and across it."""
    from scipy.ndimage import median_filter

    bins = (along - along.min() + 0.5).astype(int)
    n = bins.max() + 1
    top, bottom = np.full(n, -np.inf), np.full(n, np.inf)
    np.maximum.at(top, bins, across)
    np.minimum.at(bottom, bins, across)
    there = np.flatnonzero(np.isfinite(top))
    size = max(3, n // 200) | 1
    whole = (np.interp(np.arange(n), there, edge[there]) for edge in (top, bottom))
    return Edges(np.arange(n) * ((np.ptp(along) + 1) / n), *(median_filter(edge, size=size, mode="nearest") for edge in whole))


def head(edges: Edges) -> tuple[bool | None, str]:
    """Returns (True if the nose is at the start of these edges, the reason); None in place of True if both ends look alike."""
    height = edges.height
    behind, before = flares(edges.x, height), flares(edges.x, height[::-1])
    if behind != before:
        return behind, "the tail fin is at the other end"
    lean = float(edges.x @ height / height.sum() / edges.x[-1]) - 0.5
    if abs(lean) < LEANS:
        return None, "both ends look alike"
    return lean < 0, "more of the fish lies in that half"


def flares(x: np.ndarray, height: np.ndarray) -> bool:
    """Returns True if a tail fin stands at the end of heights (n,) over x."""
    root = root_of_fin(x, height)
    return root is not None and float(height[x <= root].max()) > 1.5 * float(np.interp(root, x, height))


def hull_of(edges: Edges) -> tuple[Edges, list[FinSeen]]:
    """The edges without the fins in front of the tail fin, and those fins."""
    root = root_of_fin(edges.x, edges.height)
    n = len(edges.x) if root is None else int(np.searchsorted(edges.x, root))
    least = STANDS_OUT * float(edges.height[:n].max())
    top, above = _without_fins(edges.top, n, least)
    bottom, below = _without_fins(-edges.bottom, n, least)
    step = float(edges.x[1])
    fins = [FinSeen(up, a * step, b * step, reach) for up, found in ((True, above), (False, below)) for a, b, reach in found]
    return Edges(edges.x, top, -bottom), sorted(fins, key=lambda fin: fin.start)


def _without_fins(edge: np.ndarray, n: int, least: float) -> tuple[np.ndarray, list[tuple[int, int, float]]]:
    """An edge (N,), counted outwards, without bumps of `least` or more in its first n values, and (start, end, reach) of each."""
    from scipy.ndimage import grey_opening, label

    made, found, total = edge.copy(), [], len(edge)
    opened = grey_opening(edge[:n], size=max(3, int(LONGEST_FIN * total)), mode="nearest")
    runs, many = label(edge[:n] - opened > 0.25 * least)
    foot = max(2, int(FOOT * total))
    for k in range(1, many + 1):
        inside = np.flatnonzero(runs == k)
        a, b = int(inside[0]) - foot, int(inside[-1]) + foot
        if a < foot or (edge[:n] - opened)[inside].max() < least:
            continue
        line = _continued(edge, a, min(b, n - 1), max(3, int(SLOPE * total)))
        over = edge[a : a + len(line)] - line
        if over.max() >= least:
            made[a : a + len(line)] -= np.maximum(over, 0)
            stands = a + np.flatnonzero(over > 0.25 * least)
            found.append((int(stands[0]), int(stands[-1]), float(over.max())))
    return made, found


def _continued(edge: np.ndarray, a: int, b: int, over: int) -> np.ndarray:
    """Values at a..b of the cubic that continues the edge at both ends with its outside slope."""
    from scipy.interpolate import CubicHermiteSpline

    before, after = slice(max(0, a - over), a + 1), slice(b, min(len(edge), b + over + 1))
    ends = [np.polyfit(np.arange(len(edge))[part] - at, edge[part], 1) for part, at in ((before, a), (after, b))]
    return CubicHermiteSpline([a, b], [edge[a], edge[b]], [slope for slope, _ in ends])(np.arange(a, b + 1))


def sections_of(cv2, edges: Edges) -> np.ndarray:
    """(S, 2) stations and heights, px: the fewest that keep the heights to a pixel, at most 48."""
    x, height = edges.x, edges.height.copy()
    last = len(x) - max(2, int(END * len(x)))
    last += int(np.argmax(height[last:]))
    height[last:] = height[last]  # the tips of a tilted tail fin reach the end one by one
    height[0] = height[min(len(x) - 1, max(1, int(FIRST[0] * len(x) / 2)))]  # a small first section, not a point
    line, within = np.stack([x, height], -1).astype(np.float32), 1.0
    while len(kept := cv2.approxPolyDP(line[:, None], within, False)[:, 0]) > SECTIONS - len(FIRST):
        within *= 1.2
    stations = np.union1d(kept[:, 0].astype(float), np.array(FIRST) * x[-1])
    stations = stations[np.diff(stations, prepend=-np.inf) > 1e-3 * x[-1]]
    stations[-1] = x[-1]
    return np.stack([stations, np.interp(stations, x, height)], -1)
