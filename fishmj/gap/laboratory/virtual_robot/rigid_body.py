"""Arrays of the fish for the compiled loop: masses, added masses, stations of cross-flow drag.

    added mass per length     a(s) = k(s) rho pi/4 h(s)^2,   k = k_mid - (k_mid - k_end) (e^(-s/l) + e^(-(L - s)/l))
    cross-flow drag           d(s) = 1/2 rho C(s) h(s) ds,   C = C_round + (C_flat - C_round) (1 - w/h)

Drag has 16 Gauss points per link, moments have 4 between adjacent sections. Link frame: x to the nose, origin at the front
hinge (head: the reference point).
"""

from functools import cache
from typing import NamedTuple

import numpy as np

from fishmj.gap.laboratory.virtual_robot.constant_groups import HullConstants
from fishmj.mjcf.description import Robot
from fishmj.mjcf.geometry import Geometry, geometry_of
from fishmj.mjcf.reading import load_robot

STATIONS = 16
PANEL = 4  # Gauss points between two sections
SHORT = 4  # links of the shipped fish; its own compiled loops are a third faster
SHIPPED = "fish"  # robot whose axial added masses are in the table


class RigidBody(NamedTuple):
    """N links, S stations; SI units."""

    links: tuple[int, ...] | np.ndarray  # (N,) 0 .. N - 1
    joints: tuple[int, ...] | np.ndarray  # (N - 1,) 0 .. N - 2
    hinge: np.ndarray  # (N,) x of the rear hinge, m
    mass: np.ndarray  # (N,) kg
    first: np.ndarray  # (N,) mass times x of its centre, kg m
    second: np.ndarray  # (N,) inertia about the link's origin, kg m2
    surge: np.ndarray  # (N,) added mass along x, kg
    sway: np.ndarray  # (N, 3) moments 0, 1, 2 of the added mass across, kg, kg m, kg m2
    spin: np.ndarray  # (N,) added inertia beyond the moments, kg m2
    displaced: np.ndarray  # (N,) kg
    buoyancy: np.ndarray  # (N,) m
    station: np.ndarray  # (N, S) m
    drag: np.ndarray  # (N, S) N s2/m2
    wetted: np.ndarray  # (N,) 1/2 rho S (nu/L)^0.2, the skin friction without its coefficient
    centre: np.ndarray  # (N,) x of the link's middle, m
    edge: float  # x of the trailing edge, m
    munk: float  # added mass across less along, straight fish, kg
    length: float  # m
    total: float  # kg


def body_of(robot: Robot, water: dict, hull: HullConstants) -> RigidBody:
    """Arrays of `robot` with the section coefficients in `water` (table of virtual_robot.toml) and the additions of `hull`."""
    geometry = geometry_of(robot)
    n, rho = geometry.n_links, robot.density_water
    fronts = np.concatenate([[0.0], np.cumsum([link.length for link in robot.links])])
    station, drag = np.zeros((n, STATIONS)), np.zeros((n, STATIONS))
    sway, wetted = np.zeros((n, 3)), np.zeros(n)
    thin = 0.5 * rho * (water["viscosity"] / round(robot.length, 6)) ** 0.2
    for i, link in enumerate(robot.links):
        lead = geometry.span[i, 1]
        s, weight = _gauss(0.0, link.length, STATIONS)
        h, w = _outline(link, s, geometry)
        flatness = np.clip(1 - w / h, 0.0, 1.0)
        station[i] = lead - s
        drag[i] = 0.5 * rho * (water["drag_round"] + (water["drag_flat"] - water["drag_round"]) * flatness) * h * weight
        cuts = [row[0] for row in link.sections]
        panels = [_gauss(a, b, PANEL) for a, b in zip(cuts[:-1], cuts[1:], strict=True) if b > a]
        s, weight = (np.concatenate(part) for part in zip(*panels, strict=True))
        h, w = _outline(link, s, geometry)
        along = _section_coefficient(fronts[i] + s, fronts[-1], water) * rho * np.pi / 4 * h**2 * weight
        sway[i] = [np.sum(along * (lead - s) ** m) for m in range(3)]
        wetted[i] = thin * np.sum(2 * np.sqrt(2.0) * np.hypot(h / 2, w / 2) * np.pi / 2 * weight)
    surge, spin = np.array(water["surge"], float) * (geometry.displaced / alike(shipped_volume(), n)), np.zeros(n)
    mass, first, second = _rigid(geometry, hull)
    surge[0] += hull.surge
    sway[0, 0] += hull.sway
    spin[0] += hull.yaw
    return RigidBody(
        links=counted(n, n == SHORT),
        joints=counted(n - 1, n == SHORT),
        hinge=np.append(geometry.joint, 0.0),
        mass=mass,
        first=first,
        second=second,
        surge=surge,
        sway=sway,
        spin=spin,
        displaced=geometry.displaced.copy(),
        buoyancy=geometry.buoyancy.copy(),
        station=station,
        drag=drag,
        wetted=wetted,
        centre=geometry.span.mean(1),
        edge=geometry.tail_x,
        munk=float(sway[:, 0].sum() - surge.sum()),
        length=robot.length,
        total=float(mass.sum()),
    )


def _rigid(geometry: Geometry, hull: HullConstants) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mass, first and second moment of each link about its origin; hull.com moves the head's centre of mass."""
    mass, x = geometry.mass.copy(), geometry.com[:, 0].copy()
    x[0] += hull.com
    first, second = mass * x, geometry.inertia[:, 2] + mass * x**2
    mass[0] += hull.mass
    second[0] += hull.inertia
    return mass, first, second


def counted(n: int, known: bool) -> tuple[int, ...] | np.ndarray:
    """Numbers 0 .. n - 1: as a tuple, whose length the compiler knows, or as an array, so that all chains share machine code."""
    return tuple(range(n)) if known else np.arange(n)


def alike(values, links: int) -> np.ndarray:
    """Values (N,) of a chain of `links`, from another chain's values (nose to tail) at the same relative positions."""
    places = np.round(np.arange(links) * ((len(values) - 1) / (links - 1))).astype(int)
    return np.asarray(values, float)[places]


@cache
def shipped_volume() -> tuple[float, ...]:
    """Displaced mass of each link of the shipped fish, kg."""
    return tuple(geometry_of(load_robot(SHIPPED)).displaced.tolist())


_legendre = cache(np.polynomial.legendre.leggauss)


def _gauss(a: float, b: float, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss points and weights on [a, b]."""
    x, weight = _legendre(n)
    return (a + b) / 2 + (b - a) / 2 * x, (b - a) / 2 * weight


def _outline(link, s: np.ndarray, geometry: Geometry) -> tuple[np.ndarray, np.ndarray]:
    """Height and width [m] at distances s [m] from the link's front end."""
    rows = np.array(link.sections)
    return np.interp(s, rows[:, 0], rows[:, 1]), np.interp(s, rows[:, 0], rows[:, 2]) * geometry.width_scale


def _section_coefficient(s: np.ndarray, length: float, water: dict) -> np.ndarray:
    """k(s) of the module's docstring; s: distance from the nose, m."""
    (middle, end), fall = water["sections"], water["end_length"] * (round(length, 6) / water["length"])
    return middle - (middle - end) * (np.exp(-s / fall) + np.exp(-(length - s) / fall))
