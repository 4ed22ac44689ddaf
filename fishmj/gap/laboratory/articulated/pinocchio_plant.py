"""Robot with Pinocchio's rigid-body dynamics, and friction laws and a time stepper of its own.

    (M(q) + h diag(d)) (v' - v) / h = tau - b(q, v)        d = slope of the friction over the rate, so that friction is implicit
    q' = q + h v'

    dry friction    (F + F(v, tau)) tanh(v / v_0)          v_0 = 5 mrad/s
    damping         D v + c |v| v

Pinocchio: Carpentier et al. 2019 (`pin` on PyPI, BSD-2). It does not use MuJoCo; the robot is built from its constants.
"""

from typing import Any

import numpy as np

from fishmj.gap.laboratory.articulated.hidden_faults import Hidden
from fishmj.gap.laboratory.articulated.plant_laws import JointLaws, JointMotors
from fishmj.gap.laboratory.articulated.robot_plan import RobotPlan

CREEP = 0.005  # rad/s, v_0


class PinocchioPlant:
    """Plant with the interface of `MujocoPlant`. Raises ImportError: no Pinocchio."""

    h = 0.0005
    spent = 0.0

    def __init__(self, plan: RobotPlan, hidden: Hidden):
        import pinocchio as pin

        self.pin, self.plan, self.hidden = pin, plan, hidden
        self.m = pinocchio_model(pin, plan)
        self.d = self.m.createData()
        self.motors = JointMotors(plan)
        self.armature = plan.column("armature")
        self.dry, self.damping, self.drag = plan.column("friction"), plan.column("damping"), plan.column("drag")
        self.spring, self.kv = plan.column("stiffness"), plan.column("kv")
        self.start(np.zeros(len(plan.limbs)), np.zeros(len(plan.limbs)))

    def start(self, q: np.ndarray, v: np.ndarray, t: float = 0.0) -> None:
        """Sets angles, rates and time."""
        self.q, self.v, self.t = np.array(q, float), np.array(v, float), t
        self.laws = JointLaws(self.plan, self.hidden)

    def step(self, u: np.ndarray, push: np.ndarray) -> None:
        """Advances by one step."""
        q, v, h = self.q, self.v, self.h
        motor = self.motors.torque(u, q, v)
        laws = self.laws
        added = laws.torques(q, v, motor, self.t, h) if laws.laws else 0.0
        size = self.dry + laws.friction(v, motor) if laws.friction_laws else self.dry
        direction = np.tanh(v / CREEP)
        friction = size * direction + self.damping * v + self.drag * np.abs(v) * v
        slope = size * (1.0 - direction**2) / CREEP + self.damping + 2.0 * self.drag * np.abs(v) + self.kv
        self.m.armature = self.armature + h * slope
        a = self.pin.aba(self.m, self.d, q, v, motor + added + push - friction - self.spring * q)
        self.v = v + h * a
        self.q = q + h * self.v
        self.t += h


def pinocchio_model(pin: Any, plan: RobotPlan) -> Any:
    """Pinocchio's model of a robot: hinges about its axes, and bodies."""
    m = pin.Model()
    m.gravity.linear = np.array(plan.gravity)
    numbers = []
    for k, b in enumerate(plan.limbs):
        place = pin.SE3(np.eye(3), np.array(b.place))
        hinge = pin.JointModelRevoluteUnaligned(np.array(b.axis))
        number = m.addJoint(numbers[b.parent] if b.parent >= 0 else 0, hinge, place, f"j{k + 1}")
        m.appendBodyToJoint(number, pin.Inertia(b.mass, np.array(b.centre), np.diag(b.inertia)), pin.SE3.Identity())
        numbers.append(number)
    return m
