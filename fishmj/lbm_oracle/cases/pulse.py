"""A pressure pulse leaves the box: what comes back?

A Gaussian pulse starts in the middle of an open box with sponges; the same pulse runs in a box so large that nothing can have
come back. The difference of the two pressures, once the pulse is out, over the pulse's height where it met the face.
"""

import numpy as np

from fishmj.lbm_oracle.boundaries import PERIODIC, channel
from fishmj.lbm_oracle.cases import below, register
from fishmj.lbm_oracle.fluid import Fluid
from fishmj.lbm_oracle.lattice import CS
from fishmj.lbm_oracle.units import Lattice

SIZE, SPONGE, WIDTH = 80, 10, 4.0
LATTICE = Lattice(dx=1.0, dt=1.0, rho=1.0, nu=1e-3)


def pulse(shape, centre) -> np.ndarray:
    """Pressure (nx, ny, nz), height 1e-3, round in the horizontal plane."""
    x, y = np.meshgrid(*(np.arange(n) - c for n, c in zip(shape, centre, strict=False)), indexing="ij")
    p = 1e-3 * np.exp(-(x**2 + y**2) / (2 * WIDTH**2))
    return np.repeat(p[..., None], shape[2], 2)


def reflection(flow, device: str) -> float:
    """Greatest return inside the sponges over the height of the pulse at the face."""
    n, start = SIZE, (SIZE - 1) / 2
    steps = round(1.6 * (n / 2) / CS)  # there, and most of the way back
    big = n + 2 * round(steps * CS)
    small = Fluid(LATTICE, (n, n, 1), device, boundaries=channel(sponge=SPONGE), subgrid="none", flow=flow)
    free = Fluid(LATTICE, (big, big, 1), device, boundaries=PERIODIC, subgrid="none", flow=flow)
    for water in (small, free):
        middle = (water.shape[0] - 1) / 2
        u = np.broadcast_to(water.flow.mean, (*water.shape, 3))
        water.impose(u, pulse(water.shape, (middle, middle)))
    edge, inside = (big - n) // 2, slice(SPONGE, n - SPONGE)
    arrive = round((n / 2 - SPONGE) / CS)
    height, back = 0.0, 0.0
    for step in range(0, steps, 4):
        small.run(4), free.run(4)
        there = free.pressure()[edge : edge + n, edge : edge + n, 0]
        height = max(height, float(np.abs(there[SPONGE, int(start)]))) if step < 1.2 * arrive else height
        difference = small.pressure()[..., 0] - there
        back = max(back, float(np.abs(difference[inside, inside]).max()))
    return back / height


@register("pulse", rung=2.5, grid="80^2, sponge of 10 cells", source="a box that the sound cannot cross in the time of the run")
def pulse_leaves(device):
    """Reflection of a pressure pulse at the open faces."""
    from fishmj.flow import Flow

    yield below("reflection, still water", reflection(Flow(), device), 0.02)
    yield below("reflection, stream at 30 deg, Ma 0.1", reflection(Flow(speed=0.0577, direction=np.pi / 6), device), 0.02)
