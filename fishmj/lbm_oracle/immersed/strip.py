"""The immersed boundary in a strip of water one cell deep: two-dimensional flow.

The strip is periodic across its one cell, so a kernel three cells deep hits that cell three times. `Strip` folds the spread force
back onto the cell between the passes of the direct forcing. The force into the water and the reading of the markers fold by
themselves. Forces are those of one cell of depth.
"""

from math import ceil, pi

import numpy as np
import warp as wp

from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.immersed import kernels
from fishmj.lbm_oracle.immersed.body import ImmersedBody
from fishmj.lbm_oracle.immersed.boundary import Boundary
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.immersed.markers import Markers, offset_of

wp.set_module_options({"enable_backward": False})


@wp.kernel
def fold(scratch: wp.array4d(dtype=wp.vec3)):
    """Gives every cell of a column the sum of the column: they are one cell of water."""
    i, j, r = wp.tid()
    total = wp.vec3()
    for k in range(scratch.shape[2]):
        total += scratch[i, j, k, r]
    for k in range(scratch.shape[2]):
        scratch[i, j, k, r] = total


class Strip(Boundary):
    """The immersed boundary of a body in a strip one cell deep."""

    def _launch(self, kernel, dim, inputs, outputs) -> None:
        super()._launch(kernel, dim, inputs, outputs)
        if kernel is kernels.spread:
            super()._launch(fold, (*self.box_shape[:2], self.rhs), [], [self.scratch])


def coupled_in(water: Fluid, body: ImmersedBody, markers: Markers, coupling: type[FluidStructure]) -> FluidStructure:
    """Couples a no-slip body with its water, which may be a strip, by `coupling`, which may raise ConfigError."""
    coupled = coupling(water, body, markers, slip=0.0)
    if water.shape[2] == 1:
        coupled.boundary = Strip(markers, body, water, slip=0.0)
    return coupled


def circle_markers(radius: float, dx: float, *, hydro_offset: float | None = None) -> Markers:
    """A circle of `radius` m in the plane z = 0, one cell deep, markers about dx apart."""
    r = radius - offset_of(3, 0.0, hydro_offset) * dx
    n = ceil(2 * pi * r / dx)
    turn = 2 * pi * np.arange(n) / n
    unit = np.stack([np.cos(turn), np.sin(turn), 0 * turn], -1)
    return Markers.rigid(r * unit, unit, 2 * pi * r / n * dx)
