"""An immersed body with forces from outside MuJoCo's own servos, in the implicit form that a coupled step needs.

    (M + A + dt D + K) v+ = (M + A + dt D) v + dt (a - D w - bias) - b0 + I         a: forces, A: added mass, w: joint rates

One solve gives the velocities of fish and water, so terms that depend on the new velocity must stand in the matrix: a damping D
of each joint, and an added mass A. Everything else is explicit. The terms are those of `body.py`.
"""

import mujoco
import numpy as np

from fishmj.lbm_oracle.fluid.guard import numbers
from fishmj.lbm_oracle.immersed.body import DisplacedWater, ImmersedBody


class DrivenBody(ImmersedBody):
    """An `ImmersedBody` without MuJoCo's servos: `drive` sets the forces of each step."""

    def __init__(self, model: mujoco.MjModel, water: DisplacedWater, dt: float):
        super().__init__(model, water, dt)
        self.joints = model.nu
        self.added_mass = np.zeros((self.dofs, self.dofs))  # A, generalised, kg, kg m, kg m2
        model.actuator_gainprm[:], model.actuator_biasprm[:] = 0.0, 0.0

    def set_masses(self, mass, centre, inertia) -> None:
        """Sets mass kg, centre of mass along the link m, and vertical moment of inertia about it kg m2 of each link, (L,).

        Raises ConfigError: another shape, below zero, or not finite.
        """
        m, size = self.model, (self.links,)
        mass, inertia = (numbers(f"driven body: {name}", v, size, low=0.0) for name, v in (("mass", mass), ("inertia", inertia)))
        centre = numbers("driven body: centre", centre, size)
        m.body_mass[1:], m.body_ipos[1:, 0], m.body_inertia[1:, 2] = mass, centre, inertia
        mujoco.mj_setConst(m, mujoco.MjData(m))  # of its own: it goes to the reference pose
        self.place(self.data.qpos.copy(), self.data.qvel.copy())

    def drive(self, applied: np.ndarray, damping: np.ndarray) -> None:
        """Sets the next step's generalised forces (n,), N and N m, and the damping D of each joint (J,), N m s/rad."""
        self.applied[:] = numbers("driven body: applied", applied, (self.dofs,))
        self.model.dof_damping[-self.joints :] = numbers("driven body: damping", damping, (self.joints,), low=0.0)

    def equation(self, interior: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """Equation of `ImmersedBody` with the added mass A, (n, n) and (n,), at the present damping."""
        mujoco.mj_passive(self.model, self.data)  # the damping is newer than the state
        system, right = super().equation(interior)
        return system + self.added_mass, right + self.added_mass @ self.data.qvel
