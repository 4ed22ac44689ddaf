"""The solver's fish with a hidden difference: other masses, forces and added masses of an effect, servos by `Electronics`.

    f  = T^T (f_effect - f_null),   A = T^T (A_effect - A_null) T          W_k = psi' + j_1' + .. + j_k'  in T

What a hydrodynamic effect adds in the second robot's own water, at the same state, is added to the solver's: force explicitly,
added mass in the mass matrix. Masses, balance and inertia are the MuJoCo body's own.
"""

import mujoco
import numpy as np

from fishmj.campaign.hidden_lbm.implicit_servo import forces
from fishmj.lbm_oracle.immersed.body import DisplacedWater, ImmersedBody
from fishmj.mjcf import build
from fishmj.virtual_robot.constants import HullConstants, Uncatalogued
from fishmj.virtual_robot.rigid_body import body_of
from fishmj.virtual_robot.robot_constants import RobotConstants, nominal
from fishmj.virtual_robot.simulate import STILL, State

ABSOLUTE = np.eye(6)  # T: rates of (x, y, psi, j1, j2, j3) -> (x, y, W1 .. W4)
ABSOLUTE[3:, 2] = 1.0
ABSOLUTE[3:, 3:] = np.tril(np.ones((3, 3)))
REAL = ("flow_x", "flow_y", "current_x", "current_y")  # of the tank: the solver's water moves so by itself


class HiddenBody(ImmersedBody):
    """An `ImmersedBody` whose joints follow a law tau = a - D w, with a virtual robot's masses and an effect's own forces."""

    def __init__(self, made: RobotConstants, dt: float, heavier: float = 1.0):
        robot = made.robot
        super().__init__(build(robot, "planar", bare=True), DisplacedWater.of(robot), dt)
        m = self.model
        m.actuator_gainprm[:], m.actuator_biasprm[:] = 0.0, 0.0
        m.dof_armature[-3:] = made.motor.armature
        rigid = made.body
        m.body_mass[1:] = heavier * rigid.mass
        middle = rigid.first / rigid.mass
        m.body_ipos[1:, 0] = middle
        m.body_inertia[1:, 2] = heavier * (rigid.second - rigid.mass * middle**2)
        mujoco.mj_setConst(m, self.data)
        self.added_mass = np.zeros((6, 6))  # added mass of the effect, (x, y, psi, j1..j3)
        self.place(self.data.qpos.copy())

    def equation(self, interior: bool = True) -> tuple[np.ndarray, np.ndarray]:
        mujoco.mj_passive(self.model, self.data)  # the law's slope is newer than the state
        system, right = super().equation(interior)
        return system + self.added_mass, right + self.added_mass @ self.data.qvel

    def set_torque(self, a: np.ndarray, slope: np.ndarray) -> None:
        """tau = a - slope w on the three joints in the next step, N m and N m s/rad."""
        self.applied[-3:] = a
        self.model.dof_damping[-3:] = slope


class HiddenDifference:
    """What the planted effects change in the second robot's water; None of it for actuators, clocks and sensors."""

    def __init__(self, made: RobotConstants, gust: np.ndarray):
        rigid = HullConstants(mass=made.hull.mass, com=made.hull.com, inertia=made.hull.inertia)
        plain = nominal(made.robot)
        tank = made.tank._replace(**{key: value for key, value in plain.tank._asdict().items() if key not in REAL})
        kept = {key: getattr(made.water, key) for key in _drawn(made.water)}
        self.pair = (
            (made.body, made.water, made.tank, made.odd, gust),
            (body_of(made.robot, made.sections, rigid), plain.water._replace(**kept), tank, Uncatalogued(), STILL),
        )
        self.wakes = [np.zeros(6), np.zeros(6)]
        self.acts = made.hull != rigid or self.pair[0][1:4] != self.pair[1][1:4] or bool(np.any(gust))
        self._work = [(np.zeros(4), np.zeros((6, 6)), np.zeros(6)) for _ in self.pair]

    def __call__(self, state: State, h: float) -> tuple[np.ndarray, np.ndarray]:
        """Force (6,) and added mass (6, 6) over (x, y, psi, j1..j3) at `state`; moves the wakes on by h."""
        found = []
        for groups, wake, (stream, A, f) in zip(self.pair, self.wakes, self._work, strict=True):
            *groups_, gust = groups
            forces(*groups_, gust, state._replace(wake=wake), stream, A, f, h)
            found.append((f, A + np.tril(A, -1).T))
        (f, A), (f0, A0) = found
        return ABSOLUTE.T @ (f - f0), ABSOLUTE.T @ (A - A0) @ ABSOLUTE


def _drawn(water) -> list[str]:
    """Fields of the water that every robot has, drawn or not: not the effects."""
    return [key for key in water._fields if key not in water._field_defaults]
