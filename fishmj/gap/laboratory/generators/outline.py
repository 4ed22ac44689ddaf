"""Outline at Gauss points along each link, and its plates and strips: the geometry of every water model."""

from typing import NamedTuple

import numpy as np

from fishmj.mjcf.description import Robot
from fishmj.mjcf.geometry import Geometry, geometry_of

PIECES = 3  # Gauss points between two sections
THIN = 0.2  # width over height, below which a section is a plate


class Stations(NamedTuple):
    """Points along one link, from front to rear. x from the link's origin, towards the nose; all (K,), m."""

    x: np.ndarray
    ds: np.ndarray
    height: np.ndarray
    width: np.ndarray
    narrowing: np.ndarray  # fall of height^2 per length, towards the tail, m; not negative

    @property
    def flatness(self) -> np.ndarray:
        """Flatness of the section: 0 for round, 1 for a plate."""
        return np.clip(1.0 - self.width / self.height, 0.0, 1.0)

    @property
    def girth(self) -> np.ndarray:
        """Perimeter of the ellipse, Ramanujan's second formula, m."""
        a, b = self.height / 2, self.width / 2
        h = ((a - b) / (a + b)) ** 2
        return np.pi * (a + b) * (1.0 + 3.0 * h / (10.0 + np.sqrt(4.0 - 3.0 * h)))


class FinPlate(NamedTuple):
    """The plate at the end of the last link."""

    front: float  # x of its leading edge in the last link's frame, m
    rear: float  # of its trailing edge
    area: float  # m2
    span: float  # largest height, m
    edge: float  # height of the trailing edge, m

    @property
    def chord(self) -> float:
        """Mean chord, m."""
        return self.area / self.span

    @property
    def aspect(self) -> float:
        """Span squared over area."""
        return self.span**2 / self.area


def stations_of(robot: Robot, geometry: Geometry | None = None) -> list[Stations]:
    """Gauss points of every link. Sections are linear in between, so that areas and moments are exact."""
    g = geometry_of(robot) if geometry is None else geometry
    node, weight = np.polynomial.legendre.leggauss(PIECES)
    out = []
    for i, link in enumerate(robot.links):
        rows = np.array(link.sections, float)
        cuts = [(a, b) for a, b in zip(rows[:-1], rows[1:], strict=True) if b[0] > a[0]]
        back = np.concatenate([(a[0] + b[0]) / 2 + (b[0] - a[0]) / 2 * node for a, b in cuts])
        ds = np.concatenate([(b[0] - a[0]) / 2 * weight for a, b in cuts])
        height = np.interp(back, rows[:, 0], rows[:, 1])
        slope = np.concatenate([np.full(PIECES, (b[1] - a[1]) / (b[0] - a[0])) for a, b in cuts])
        width = np.interp(back, rows[:, 0], rows[:, 2]) * g.width_scale
        fall = np.maximum(-2.0 * height * slope, 0.0)
        out.append(Stations(g.span[i, 1] - back, ds, height, width, fall))
    return out


def fin_of(robot: Robot, stations: list[Stations]) -> FinPlate:
    """Plate part of the last link: behind its `fin_from`, else its thin part, else its rear half."""
    last, s, front = robot.links[-1], stations[-1], float(geometry_of(robot).span[-1, 1])
    thin = front - s.x[s.width < THIN * s.height]
    begin = last.fin_from if last.fin_from is not None else float(thin[0]) if len(thin) else last.length / 2
    behind = s.x <= front - begin
    if not behind.any():
        begin, behind = last.length / 2, s.x <= front - last.length / 2
    area, edge = float(np.sum(s.height[behind] * s.ds[behind])), float(last.sections[-1][1])
    span = float(max(s.height[behind].max(), edge))
    return FinPlate(float(front - begin), float(front - last.length), area, span, edge)


def is_fin(stations: list[Stations], fin: FinPlate, link: int) -> np.ndarray:
    """Mask (K,) of a link's stations on the fin."""
    on_last = link == len(stations) - 1
    return (stations[link].x <= fin.front) & on_last


def ragged(parts: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Concatenates the links' values (total,); returns also the index of each link's first (N + 1,)."""
    return np.concatenate(parts).astype(float), np.concatenate([[0], np.cumsum([len(p) for p in parts])]).astype(np.int64)


def swaying(stations: list[Stations], per_length: list[np.ndarray]) -> np.ndarray:
    """Added mass (N, 3, 3) of links, across their axis only, from the values (K,) [kg/m] at their stations."""
    added = np.zeros((len(stations), 3, 3))
    for a, s, mass in zip(added, stations, per_length, strict=True):
        moments = [np.sum(mass * s.ds * s.x**k) for k in range(3)]
        a[1, 1], a[1, 2], a[2, 1], a[2, 2] = moments[0], moments[1], moments[1], moments[2]
    return added
