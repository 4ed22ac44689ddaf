"""Robot in MuJoCo with edited attributes, and one driven by the servo laws of BAM.

plant = MujocoPlant(plan, hidden)        h = 1 ms, implicit integrator: another step and integrator than the described model
plant.start(q, v); plant.step(u, push)   one step under delivered commands u (J,) and random torques (J,)
"""

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np

from fishmj.gap.laboratory.articulated.bam_servo import LAWS, friction_budget
from fishmj.gap.laboratory.articulated.hidden_faults import Hidden, placed
from fishmj.gap.laboratory.articulated.plant_laws import JointLaws, JointMotors
from fishmj.gap.laboratory.articulated.robot_plan import RobotPlan, mjcf


class MujocoState:
    """State of a plant in MuJoCo. m: MjModel."""

    def __init__(self, m: Any):
        self.m, self.d = m, mujoco.MjData(m)

    def start(self, q: np.ndarray, v: np.ndarray, t: float = 0.0) -> None:
        """Sets position, rates and time."""
        mujoco.mj_resetData(self.m, self.d)
        self.d.qpos[:], self.d.qvel[:], self.d.time = q, v, t

    @property
    def q(self) -> np.ndarray:
        """Angles (J,), or the pose (7,) of a free body."""
        return self.d.qpos

    @property
    def v(self) -> np.ndarray:
        """Rates (J,), or (6,)."""
        return self.d.qvel


class MujocoPlant(MujocoState):
    """Actuators, friction, armature, damping and medium of MuJoCo; other laws as applied torques."""

    h = 0.001
    spent = 0.0  # largest used share of a servo's voltage, set by `BamPlant` only

    def __init__(self, plan: RobotPlan, hidden: Hidden):
        self.plan, self.hidden = plan, hidden
        super().__init__(mujoco.MjModel.from_xml_string(mjcf(plan, self.h, "implicit")))
        self.dry = self.m.dof_frictionloss.copy()
        self.motors = JointMotors(plan)
        self.laws = JointLaws(plan, hidden)

    def start(self, q: np.ndarray, v: np.ndarray, t: float = 0.0) -> None:
        """Sets angles, rates and time."""
        super().start(q, v, t)
        self.laws = JointLaws(self.plan, self.hidden)

    def step(self, u: np.ndarray, push: np.ndarray) -> None:
        """Advances by one step."""
        m, d = self.m, self.d
        d.ctrl[:] = u
        d.qfrc_applied[:] = push
        if self.laws.laws:
            motor = self.motors.torque(u, d.qpos, d.qvel)
            d.qfrc_applied[:] += self.laws.torques(d.qpos, d.qvel, motor, d.time, self.h)
            m.dof_frictionloss[:] = self.dry + self.laws.friction(d.qvel, motor)
        mujoco.mj_step(m, d)


class BamPlant(MujocoPlant):
    """Servos by BAM: a proportional controller of the voltage, back EMF, and a friction budget that depends on load and speed.

    As in `bam.mujoco.MujocoController`, each step writes the budget into the joint's frictionloss and damping.

    servos: constants of the law (`bam_servo`) by number of the joint. spent: largest share so far of the supply voltage that a
    controller requested, or of the stall torque that a motor delivered; up to 1 the motor follows the described law.
    """

    h = 0.0005

    def __init__(self, plan: RobotPlan, hidden: Hidden, servos: Mapping[int, Mapping[str, float]]):
        self.plan, self.servos = plan, servos
        MujocoState.__init__(self, mujoco.MjModel.from_xml_string(mjcf(plan, self.h, "implicitfast", motors=True)))
        self.hidden = {name: values for name, values in hidden.items() if placed(name)[0] not in LAWS}
        self.laws = JointLaws(plan, self.hidden)
        self.kp, self.kv = plan.column("kp"), plan.column("kv")
        self.limit, self.offset = plan.column("limit"), plan.column("offset")
        self.dry, self.viscous = plan.column("friction"), plan.column("damping")

    def step(self, u: np.ndarray, push: np.ndarray) -> None:
        """Advances by one step."""
        m, d = self.m, self.d
        requested = self.kp * (u - d.qpos)
        driven = np.clip(requested, -self.limit, self.limit)  # limited by the supply voltage
        motor = driven - self.kv * d.qvel + self.offset
        self.spent = max(self.spent, float(np.max(np.maximum(np.abs(requested), np.abs(motor)) / self.limit)))
        d.ctrl[:] = motor
        d.qfrc_applied[:] = push + self.laws.torques(d.qpos, d.qvel, motor, d.time, self.h)
        external = -d.qfrc_bias + push
        budget = friction_budget(self.servos, d.qvel, motor, external) + self.laws.friction(d.qvel, motor)
        m.dof_frictionloss[:] = self.dry + budget
        mujoco.mj_step(m, d)
