"""A pressure pulse leaves the box: the part that is reflected.

A plane pulse, p = c_s rho u, runs at right angles into an open face; a round one meets faces and corners at every angle. The same
pulse in a box so large that no reflection can have returned is the reference. The round pulse is weak when it arrives, so its
reflection is judged relative to its initial height; relative to the arriving height it is reported.
"""

import numpy as np

from fishmj.lbm_oracle.cases import below, register, reported
from fishmj.lbm_oracle.fluid.domain_faces import Axis, Boundaries, channel
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.lattice import CS, Lattice
from fishmj.water.flow import Flow

SPONGE, HEIGHT = 10, 1e-3
LATTICE = Lattice(dx=1.0, dt=1.0, rho=1.0, nu=1e-3)


def plane(flow: Flow, device: str, n: int = 200, width: float = 8.0) -> float:
    """Greatest reflection of a plane pulse that ran towards +x, relative to its height."""
    faces = Boundaries(x=Axis("open", "open"), sponge=SPONGE)
    water = Fluid(LATTICE, (n, 1, 1), device, boundaries=faces, subgrid="none", flow=flow)
    p = HEIGHT * np.exp(-((np.arange(n) - (n - 1) / 2) ** 2) / (2 * width**2)).reshape(n, 1, 1)
    u = np.zeros((n, 1, 1, 3)) + flow.mean
    u[..., 0] += p / CS
    water.impose(u, p)
    water.run(round((n - 1) / (CS + flow.mean[0])))  # out, and back in the middle
    return float(np.abs(water.pressure()[SPONGE:-SPONGE]).max() / HEIGHT)


def round_pulse(device: str, n: int = 80, width: float = 4.0) -> tuple[float, float]:
    """Greatest reflection of a cylindrical pulse, relative to its first height, and to the height that arrives at the sponge."""
    steps = round(1.6 * (n / 2) / CS)
    big = n + 2 * round(steps * CS)
    small = Fluid(LATTICE, (n, n, 1), device, boundaries=channel(sponge=SPONGE), subgrid="none")
    free = Fluid(LATTICE, (big, big, 1), device, subgrid="none")
    for water in (small, free):
        r = np.arange(water.shape[0]) - (water.shape[0] - 1) / 2
        p = HEIGHT * np.exp(-(r[:, None] ** 2 + r[None] ** 2) / (2 * width**2))[..., None]
        water.impose(np.zeros((*water.shape, 3)), p)
    edge, arrived, back = (big - n) // 2, 0.0, 0.0
    for _ in range(0, steps, 4):
        for water in (small, free):
            water.run(4)
        there = free.pressure()[edge : edge + n, edge : edge + n, 0]
        arrived = max(arrived, float(there[SPONGE, n // 2]))
        difference = small.pressure()[..., 0] - there
        back = max(back, float(np.abs(difference[SPONGE:-SPONGE, SPONGE:-SPONGE]).max()))
    return back / HEIGHT, back / arrived


@register("pulse", rung=2.5, quick=True, grid="200 and 80^2, sponge of 10 cells", source="the same pulse in a wider box")
def pulse_leaves(device):
    """Reflection of pressure pulses at the open faces."""
    yield below("plane, still water", plane(Flow(), device), 0.02)
    yield below("plane, out with a stream of Ma 0.1", plane(Flow(speed=0.0577), device), 0.02)
    yield below("plane, out against it", plane(Flow(speed=0.0577, direction=np.pi), device), 0.02)
    started, arrived = round_pulse(device)
    yield below("round, over its first height", started, 0.02)
    yield reported("round, over the height that arrives", arrived)
