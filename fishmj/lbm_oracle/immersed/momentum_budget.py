"""Where the momentum is: in the water, in the links, and in the water that a hull does not contain.

    grid + solid - displaced = constant            in a periodic box, nothing else pushing

grid = sum rho u over all cells, the inside of the hull too; solid = sum m_l u_l of the links; displaced = sum of the h_l of the
interior water (`immersed/__init__.py`): the grid has it inside the hull, a real fish does not. A coupling that loses I, its
Coriolis part or a sign drifts by the whole momentum of the fish within a few beats (docs/methods/oracle_coupling.md).
"""

from typing import NamedTuple

import numpy as np
import warp as wp

from fishmj.lbm_oracle.fluid.lattice import VELOCITIES
from fishmj.lbm_oracle.immersed import kernels
from fishmj.lbm_oracle.immersed.coupling import FluidStructure


class Momentum(NamedTuple):
    """Linear momentum, (3,) kg m/s each."""

    grid: np.ndarray
    solid: np.ndarray
    displaced: np.ndarray

    @property
    def total(self) -> np.ndarray:
        return self.grid + self.solid - self.displaced


def momentum(coupled: FluidStructure) -> Momentum:
    """Now."""
    lattice, body = coupled.fluid.lattice, coupled.body
    f = coupled.fluid.f.numpy().reshape(len(VELOCITIES), -1).sum(1, dtype=float)
    grid = f @ VELOCITIES * lattice.mass * lattice.velocity
    return Momentum(grid, body.solid_momentum()[:, :3].sum(0), body.water_momentum()[:, :3].sum(0))


def drift(history: list[Momentum]) -> float:
    """Largest change of the total over a run, over the largest momentum of the links."""
    total = np.array([m.total for m in history])
    largest = max(np.linalg.norm(m.solid) for m in history)
    return float(np.linalg.norm(total - total[0], axis=1).max() / largest)


def exchange(coupled: FluidStructure) -> tuple[np.ndarray, np.ndarray]:
    """(sum rho G over the cells, sum V F over the markers) of the last step, (3,) each in lattice units: equal to round-off."""
    edge = coupled.boundary
    field = wp.zeros(edge.shape, dtype=wp.vec3, device=edge.device)
    inputs = [edge.cell, edge.store, edge.volume, edge.final, edge.width, wp.vec3i(*edge.shape), edge.box_rho]
    wp.launch(kernels.spread_force, dim=(edge.count, edge.width), inputs=inputs, outputs=[field], device=edge.device)
    low = edge.view["box"].astype(int)
    nodes = np.ix_(*((low[a] + np.arange(edge.box_shape[a])) % edge.shape[a] for a in range(3)))
    pushed = field.numpy().astype(float)[nodes]
    given = edge.volume.numpy().astype(float) @ edge.final.numpy().astype(float)
    return np.einsum("xyz,xyza->a", edge.box_rho.numpy().astype(float), pushed), given
