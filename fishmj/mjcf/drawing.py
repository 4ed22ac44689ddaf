"""How links are drawn: the colour of one that a description leaves without, and a nose that is round.

Nothing but pictures changes: water, mass and inertia keep the sections as they are described.
"""

import numpy as np

from fishmj.mjcf.description import Robot

PALETTE = (  # warm and dark ones, which stand out on blue water; neighbours differ in hue and in brightness
    (0.89, 0.35, 0.25),  # coral
    (0.96, 0.70, 0.22),  # amber
    (0.93, 0.88, 0.76),  # cream
    (0.56, 0.71, 0.35),  # sage
    (0.45, 0.27, 0.53),  # plum
    (0.14, 0.22, 0.42),  # navy
    (0.90, 0.52, 0.60),  # rose
    (0.27, 0.30, 0.34),  # slate
)
BLUNT = 0.25  # height of the first section over the head's, from which a nose is a wall
NOSE = np.linspace(0.15, np.pi / 2, 7)  # rad, where a nose has its rings; the first is small, not a point: it has a normal


def colour_of(robot: Robot, i: int) -> tuple[float, float, float]:
    """RGB (0..1) of link i: its own, or the palette's by its place in the fish."""
    own = robot.links[i].colour
    return PALETTE[i % len(PALETTE)] if own is None else own


def drawn_sections(robot: Robot, i: int) -> np.ndarray:
    """The rows (S, 3) of link i's sections [m] as pictures show them: the head's front end is rounded off.

    A first section is a flat wall, h0 high. One that is higher than a quarter of the head becomes half an ellipsoid inside the
    described length, as deep as r = h0 / 2 (at most a quarter of the link), as high and wide as the link is at r: its rings
    stand at r (1 - cos a) and have sin a of that.
    """
    link = robot.links[i]
    rows = np.array(link.sections, float)
    depth = min(rows[0, 1:].max() / 2, link.length / 4)
    if i or depth <= 0 or rows[0, 1] < BLUNT * rows[:, 1].max():
        return rows
    behind = rows[rows[:, 0] > depth * (1 + 1e-9)]
    full = np.array([np.interp(depth, rows[:, 0], rows[:, k]) for k in (1, 2)])
    stations = np.r_[0.0, depth * (1 - np.cos(NOSE[1:]))]
    return np.concatenate([np.column_stack([stations, np.sin(NOSE)[:, None] * full]), behind])
