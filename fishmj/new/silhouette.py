"""What a silhouette says: which end is the head, what of the outline is a fin, and the few sections that keep its shape.

edges     upper and lower edge of the fish over its axis, one value a pixel, a median over a half of a hundredth of the fish
fin       what stands out of an edge in front of the tail fin and is shorter than a quarter of the fish: grey opening of the edge
          with that length (Serra 1982), where it stands out of the line that goes on from both sides by 0.08 of the height
head      the end without a tail fin; where neither or both flare, the end that the middle of the area lies nearer to
sections  Douglas and Peucker (1973) on the heights: they keep every extremum, to a pixel where 48 sections suffice
"""

from typing import Any, NamedTuple

import numpy as np

from fishmj.new.shape import root_of_fin

LONGEST_FIN = 0.25  # of the fish's length: what is longer is a back
STANDS_OUT = 0.08  # of the fish's height
FOOT = 0.02  # of the length, around a fin, that its edge takes to come down to the body
SLOPE = 0.05  # of the length, over which the body's slope beside a fin is measured
END = 0.02  # of the length: a slanted or torn end is filled from what stands just before it
FIRST = (0.007, 0.025)  # shares of the length with a section each: the nose is round
SECTIONS = 48  # at most
LEANS = 0.01  # of the length, between the middle of the area and that of the fish, below which an end is not told from the other


class Edges(NamedTuple):
    """The fish over its axis, n stations a pixel apart, first the end that is called nose. Pixels."""

    x: np.ndarray  # (n,) from the nose
    top: np.ndarray  # (n,) across the axis, upwards
    bottom: np.ndarray  # (n,)

    @property
    def height(self) -> np.ndarray:
        """(n,), with both rims."""
        return self.top - self.bottom + 1

    def turned(self) -> "Edges":
        """With the other end as the nose."""
        return Edges(self.x, self.top[::-1], self.bottom[::-1])


class FinSeen(NamedTuple):
    """An appendage in front of the tail fin, left out of the hull. Pixels."""

    above: bool
    start: float  # from the nose
    end: float
    reach: float  # over the hull


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
    """Whether the nose is where these edges begin, and what says so; None where both ends look alike."""
    height = edges.height
    behind, before = flares(edges.x, height), flares(edges.x, height[::-1])
    if behind != before:
        return behind, "the tail fin is at the other end"
    lean = float(edges.x @ height / height.sum() / edges.x[-1]) - 0.5
    if abs(lean) < LEANS:
        return None, "both ends look alike"
    return lean < 0, "more of the fish lies in that half"


def flares(x: np.ndarray, height: np.ndarray) -> bool:
    """Whether a tail fin stands at the end of heights (n,) over x."""
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
    """An edge (N,) that counts outwards without what stands out of its first n values by `least`, and (start, end, reach)."""
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
    """Values at a..b of the cubic that leaves the edge at both ends with the slope that it has outside."""
    from scipy.interpolate import CubicHermiteSpline

    before, after = slice(max(0, a - over), a + 1), slice(b, min(len(edge), b + over + 1))
    ends = [np.polyfit(np.arange(len(edge))[part] - at, edge[part], 1) for part, at in ((before, a), (after, b))]
    return CubicHermiteSpline([a, b], [edge[a], edge[b]], [slope for slope, _ in ends])(np.arange(a, b + 1))


def sections_of(cv2: Any, edges: Edges) -> np.ndarray:
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
