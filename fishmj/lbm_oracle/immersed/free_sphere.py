"""A sphere on three slides: the smallest body, and the one that theory knows. Drag, added mass and stability are read off it."""

from math import pi

import mujoco
import numpy as np

from fishmj.lbm_oracle.fluid.lattice_units import Lattice
from fishmj.lbm_oracle.immersed.body import DisplacedWater, ImmersedBody


def ball(radius: float, lattice: Lattice, *, density: float = 1.0, at=(0.0, 0.0, 0.0)) -> ImmersedBody:
    """A free, non-rotating sphere of `radius` m and `density` times the water's, at `at` m; no gravity."""
    mass = lattice.rho * 4 / 3 * pi * radius**3
    spec = mujoco.MjSpec()
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    spec.option.gravity = [0, 0, 0]
    link = spec.worldbody.add_body(name="ball")
    link.mass, link.inertia = density * mass, [0.4 * density * mass * radius**2] * 3
    link.ipos, link.explicitinertial = [0, 0, 0], True
    for name, axis in zip("xyz", np.eye(3), strict=True):
        link.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
    inertia = 0.4 * mass * radius**2 * np.eye(3)
    body = ImmersedBody(
        spec.compile(), DisplacedWater(mass=np.array([mass]), centre=np.zeros((1, 3)), inertia=inertia[None]), lattice.dt
    )
    body.place(at)
    return body
