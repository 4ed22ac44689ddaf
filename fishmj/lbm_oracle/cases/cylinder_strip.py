"""A cylinder in a strip of water one cell deep: the two-dimensional body of the ladder.

The strip is periodic across its one cell, so that a kernel three cells deep lands on that cell three times. `Strip` folds what
the direct forcing spreads between its passes back onto it; the force into the water and what the markers read fold by themselves.
Forces are those of one cell of depth.
"""

from math import ceil, pi

import mujoco
import numpy as np
import warp as wp

from fishmj.flow import Flow
from fishmj.lbm_oracle.fluid.domain_faces import Boundaries
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.lattice_units import Lattice
from fishmj.lbm_oracle.immersed import kernels
from fishmj.lbm_oracle.immersed.body import DisplacedWater, ImmersedBody
from fishmj.lbm_oracle.immersed.boundary import Boundary
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.immersed.markers import Markers, offset_of

wp.set_module_options({"enable_backward": False})


@wp.kernel
def fold(scratch: wp.array4d(dtype=wp.vec3)):
    """Every cell of a column gets the sum of the column: they are one cell of water."""
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


def circle_markers(radius: float, dx: float, *, slip=0.0, width: int = 3, hydro_offset: float | None = None) -> Markers:
    """A circle of `radius` m in the plane z = 0, one cell deep, markers about dx apart."""
    r = radius - offset_of(width, slip, hydro_offset) * dx
    n = ceil(2 * pi * r / dx)
    turn = 2 * pi * np.arange(n) / n
    unit = np.stack([np.cos(turn), np.sin(turn), 0 * turn], -1)
    return Markers.rigid(r * unit, unit, 2 * pi * r / n * dx)


def rod(radius: float, lattice: Lattice, at=(0.0, 0.0)) -> ImmersedBody:
    """A cylinder of water's density and one cell of depth on slides along x and y, at `at` (2,) m."""
    mass = lattice.rho * pi * radius**2 * lattice.dx
    inertia = np.array([0.25, 0.25, 0.5]) * mass * radius**2
    spec = mujoco.MjSpec()
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    spec.option.gravity = [0, 0, 0]
    link = spec.worldbody.add_body(name="rod")
    link.mass, link.inertia, link.ipos, link.explicitinertial = mass, inertia, [0, 0, 0], True
    for name, axis in zip("xy", np.eye(3), strict=False):
        link.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
    water = DisplacedWater(mass=np.array([mass]), centre=np.zeros((1, 3)), inertia=np.diag(inertia)[None])
    body = ImmersedBody(spec.compile(), water, lattice.dt)
    body.place(at)
    return body


def cylinder(
    cells: int,
    speed: float,
    reynolds: float,
    box: tuple[float, float],
    at: tuple[float, float],
    device: str,
    *,
    faces: Boundaries,
    flow: Flow | None = None,
    passes: int = 2,
    **options,
) -> FluidStructure:
    """A cylinder of `cells` cells across without slip, in lattice units.

    Args:
        speed: that the Reynolds number is made with. box: length and breadth in diameters. at: centre as a share of the box;
            it is put off the nodes, as a fish is. passes: of the direct forcing. options: of the markers.
    """
    lattice = Lattice(dx=1.0, dt=1.0, rho=1.0, nu=speed * cells / reynolds)
    shape = (round(box[0] * cells), round(box[1] * cells), 1)
    water = Fluid(lattice, shape, device, subgrid="none", boundaries=faces, flow=flow)
    centre = np.array(shape[:2]) * at + [0.2, -0.3]
    markers, body = circle_markers(cells / 2, 1.0, **options), rod(cells / 2, lattice, centre)
    held = FluidStructure(water, body, markers, slip=0.0, passes=passes)
    held.boundary = Strip(markers, body, water, slip=0.0, passes=passes)
    return held
