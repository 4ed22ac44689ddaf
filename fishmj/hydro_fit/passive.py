"""The water's part of the equations of motion, in MuJoCo's coordinates (x, y, psi, j1 ..): M_a and the explicit force.

    a_head = B(psi) qacc     head axes and absolute link rates from MuJoCo's coordinates
    M_a(MuJoCo) = B^T M_a(head) B

Only sums over the definitions in `chain` and `terms`; nothing about water is stated here a second time.
"""

import numpy as np

from fishmj.hydro_fit import chain


def to_head(heading: float, n: int) -> np.ndarray:
    """B (n + 2, n + 2): accelerations (x, y, psi, j) in the world -> (ax, ay, alpha_i) in head axes."""
    b = np.zeros((n + 2, n + 2))
    c, s = np.cos(heading), np.sin(heading)
    b[:2, :2] = [[c, s], [-s, c]]
    b[2:, 2:] = np.tri(n)
    return b


def world_matrix(ch: chain.Chain, heading: float, lower) -> np.ndarray:
    """Symmetric matrix (n + 2, n + 2) in MuJoCo's coordinates from a lower triangle (rows) in head axes."""
    size = ch.n + 2
    m = np.array([[lower[max(r, c)][min(r, c)] for c in range(size)] for r in range(size)])
    b = to_head(heading, ch.n)
    return b.T @ m @ b


def planar_water(ch: chain.Chain, sw: chain.Swimmer, q, v, attached, flow, ambient) -> tuple[np.ndarray, np.ndarray]:
    """Added mass (n + 2, n + 2) and the water's explicit generalised force (n + 2,), SI, MuJoCo's coordinates."""
    k = chain.kinematics(np, ch, q, v, flow)
    hydro = chain.water_forces(np, ch, sw, k, q[2], ambient, attached)
    force = np.array(chain.generalised(np, ch, q[2], chain.gather(ch, k, hydro)))
    return world_matrix(ch, q[2], chain.mass_matrix(ch, sw, k, rigid=False)), force
