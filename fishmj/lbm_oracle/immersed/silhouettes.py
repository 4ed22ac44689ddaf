"""Silhouettes of bodies, as unions: the area that a stream along x sees, and closed lines round what is seen from above.

    A = sum_i |union of the intervals that line i cuts out of all triangles| dz      lines of equal distance across the silhouette

A body behind or inside another adds nothing. An edge (F, 2) in place of a triangle belongs to a section in the plane: its area is
the length of the union, for one metre of span.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

LINES = 1000  # across a silhouette: the area of a circle to 1e-4
ANGLES = 90  # directions in which a width is measured
PIXELS = 400  # along the longer side of a body seen from above

Surface = tuple[np.ndarray, np.ndarray]  # vertices (V, 3) m; triangles (F, 3) or, of a section in the plane, edges (F, 2)


def frontal_area(surfaces: Sequence[Surface]) -> float:
    """Area of the union of the silhouettes along x, m2; of sections in the plane per metre of span."""
    corners = [vertices[:, 1:][faces] for vertices, faces in surfaces]
    if not corners:
        return 0.0
    points = np.concatenate(corners)
    if points.shape[1] == 2:
        return _union(points[..., 0].min(1), points[..., 0].max(1))
    low, high = points.min((0, 1)), points.max((0, 1))
    if not (high > low).all():
        return 0.0
    line, left, right = _cuts(points, low[1], (high[1] - low[1]) / LINES)
    apart = 2 * (high[0] - low[0]) * line  # one axis for all lines
    return _union(left + apart, right + apart) * (high[1] - low[1]) / LINES


def thinnest(points: np.ndarray) -> float:
    """Least distance, m, of two parallel lines in the plane of y and z between which all points (V, 3) lie."""
    turns = np.pi * np.arange(ANGLES) / ANGLES
    return min(float(np.ptp(points[:, 1:] @ [np.cos(turn), np.sin(turn)])) for turn in turns)


def outlines(surface: Surface) -> list[np.ndarray]:
    """Closed lines (P, 2) m round a body seen from above; a hole hangs on its line by a seam without width."""
    vertices, faces = surface
    if faces.shape[1] == 2:
        return [vertices[:, :2]]
    from contourpy import FillType, contour_generator  # of Matplotlib

    points = vertices[:, :2][faces]
    low, high = points.min((0, 1)), points.max((0, 1))
    step = float((high - low).max()) / PIXELS
    if not step:
        return []
    count = np.maximum(np.ceil((high - low) / step).astype(int), 1)
    line, left, right = _cuts(points, low[1], step)
    edges = np.zeros((count[1] + 2, count[0] + 3), int)  # a pixel's margin on all sides
    first, past = (np.ceil((side - low[0]) / step - 0.5).astype(int) + 1 for side in (left, right))
    inside = (line >= 0) & (line < count[1])
    np.add.at(edges, (line[inside] + 1, first[inside]), 1)
    np.add.at(edges, (line[inside] + 1, past[inside]), -1)
    mask = (np.cumsum(edges, 1)[:, :-1] > 0).astype(float)
    x, y = (low[a] + step * (np.arange(mask.shape[1 - a]) - 0.5) for a in range(2))
    if not mask.any():  # edge-on: thinner than a pixel
        ends = points.reshape(-1, 2)
        along = ends @ (high - low)
        return [ends[[int(np.argmin(along)), int(np.argmax(along))]]]
    rings: Any = contour_generator(x, y, mask, fill_type=FillType.OuterOffset).filled(0.5, 2.0)[0]
    return [np.concatenate([ring, ring[:1]]) for ring in rings]


def _cuts(points: np.ndarray, low: float, step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lines at low + (i + 1/2) step along the second axis of triangles (T, 3, 2): i, left and right end of every cut (N,)."""
    height = (points[..., 1] - low) / step - 0.5
    first = np.ceil(height.min(1)).astype(int)
    count = np.maximum(np.floor(height.max(1)).astype(int) - first + 1, 0)
    owner = np.repeat(np.arange(len(points)), count)
    line = first[owner] + np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
    left, right = np.full(len(owner), np.inf), np.full(len(owner), -np.inf)
    for one in range(3):
        a, b = points[owner, one], points[owner, (one + 1) % 3]
        low_side, high_side = height[owner, one], height[owner, (one + 1) % 3]
        crossed = (low_side <= line) != (high_side <= line)
        share = (line - low_side) / np.where(crossed, high_side - low_side, 1.0)
        at = a[:, 0] + share * (b[:, 0] - a[:, 0])
        left, right = np.where(crossed, np.minimum(left, at), left), np.where(crossed, np.maximum(right, at), right)
    found = right >= left
    return line[found], left[found], right[found]


def _union(low: np.ndarray, high: np.ndarray) -> float:
    """Length of the union of intervals."""
    order = np.argsort(low)
    low, high = low[order], high[order]
    reached = np.concatenate([low[:1], np.maximum.accumulate(high)[:-1]])
    return float(np.maximum(high - np.maximum(low, reached), 0.0).sum())
