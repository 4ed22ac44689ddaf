"""Free body with rotors: in MuJoCo with edited attributes, and as Pinocchio's free flyer.

    plant.start(q, v, t); plant.step(u, push)  u (A,) commanded thrusts; push (6,), disturbance: N in the world, N m in the body
    q    (7,) position in the world m, quaternion w x y z      v    (6,) m/s in the world, rad/s in the body, as in MuJoCo

A rotor's thrust follows its command with a first-order lag. `start` does not reset the lag, since the commands continue.
"""

from typing import Any

import mujoco
import numpy as np

from fishmj.gap.laboratory.articulated.hidden_faults import Hidden
from fishmj.gap.laboratory.articulated.mujoco_plant import MujocoState
from fishmj.gap.laboratory.articulated.plant_laws import FreeBodyLaws
from fishmj.gap.laboratory.articulated.robot_plan import RobotPlan, mjcf


class RotorLag:
    """First-order lag of the commands. Call `at(u)` once per step of h s; the lag starts settled at the first command."""

    def __init__(self, plan: RobotPlan, h: float):
        lag = plan.of_rotors("lag")
        self.decay = np.where(lag > 0.0, np.exp(-h / np.where(lag > 0.0, lag, 1.0)), 0.0)
        self.now: np.ndarray | None = None

    def at(self, u: np.ndarray) -> np.ndarray:
        """(A,) lagged commands."""
        self.now = u if self.now is None else u + (self.now - u) * self.decay
        return self.now


class FlownMujoco(MujocoState):
    """Free joint, sites and medium of MuJoCo, with another step and integrator than the described model."""

    h = 0.001

    def __init__(self, plan: RobotPlan, hidden: Hidden):
        super().__init__(mujoco.MjModel.from_xml_string(mjcf(plan, self.h, "implicit")))
        self.lag, self.laws = RotorLag(plan, self.h), FreeBodyLaws(hidden)

    def step(self, u: np.ndarray, push: np.ndarray) -> None:
        """Advances by one step."""
        self.d.ctrl[:] = self.lag.at(u)
        self.d.qfrc_applied[:] = push + self.laws.wrench(self.d.qpos, self.d.time)
        mujoco.mj_step(self.m, self.d)


def box_drag(plan: RobotPlan, v: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Quadratic drag [N] and its moment [N m] on a body's inertia box. v, w (3,): velocity in the medium, m/s, and rate, rad/s.

    F_i = -rho/2 b_j b_k |v_i| v_i,  M_i = -rho/64 b_i (b_j^4 + b_k^4) |w_i| w_i, about the centre of mass     (MuJoCo's manual)
    """
    b = plan.limbs[0]
    own = np.array(b.inertia)
    side = np.sqrt(6.0 * np.maximum(own.sum() - 2.0 * own, 1e-12) / b.mass)
    v = v + np.cross(w, b.centre)
    one, other = np.roll(side, -1), np.roll(side, -2)
    force = -0.5 * plan.density * one * other * np.abs(v) * v
    return force, -plan.density / 64.0 * side * (one**4 + other**4) * np.abs(w) * w


class FlownPinocchio:
    """`FlownMujoco`'s interface on Pinocchio's articulated body algorithm, semi-implicit. Raises ImportError: no Pinocchio."""

    h = 0.0005

    def __init__(self, plan: RobotPlan, hidden: Hidden):
        import pinocchio as pin

        self.pin, self.plan = pin, plan
        self.m: Any = pin.Model()
        self.m.gravity.linear = np.array(plan.gravity)
        b = plan.limbs[0]
        number = self.m.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
        self.m.appendBodyToJoint(number, pin.Inertia(b.mass, np.array(b.centre), np.diag(b.inertia)), pin.SE3.Identity())
        self.d = self.m.createData()
        self.lag, self.laws = RotorLag(plan, self.h), FreeBodyLaws(hidden)
        self.gain, self.limit, self.offset = (plan.of_rotors(field) for field in ("gain", "limit", "offset"))
        place, turn = plan.of_rotors("place"), plan.of_rotors("turn")
        up = np.array([0.0, 0.0, 1.0])
        self.lever = np.stack([np.cross(p, up) + c * up for p, c in zip(place, turn, strict=True)], 1)  # N m over N
        self.start(np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), np.zeros(6))

    def start(self, q: np.ndarray, v: np.ndarray, t: float = 0.0) -> None:
        """Sets pose, rates and time."""
        self.q, self.v, self.t = np.array(q, float), np.array(v, float), t

    def step(self, u: np.ndarray, push: np.ndarray) -> None:
        """Advances by one step."""
        h, turn = self.h, self.pin.Quaternion(*self.q[3:]).matrix()  # of the body in the world
        thrust = np.clip(self.gain * self.lag.at(u) + self.offset, 0.0, self.limit)
        wrench = push + self.laws.wrench(self.q, self.t)
        force = turn.T @ wrench[:3] + [0.0, 0.0, thrust.sum()]
        torque = wrench[3:] + self.lever @ thrust
        if self.plan.density:
            drag = box_drag(self.plan, turn.T @ (self.v[:3] - self.plan.wind), self.v[3:])
            force, torque = force + drag[0], torque + np.cross(self.plan.limbs[0].centre, drag[0]) + drag[1]
        q = self.q[[0, 1, 2, 4, 5, 6, 3]]
        v = np.concatenate([turn.T @ self.v[:3], self.v[3:]])  # of the body, in the body
        v += h * self.pin.aba(self.m, self.d, q, v, np.concatenate([force, torque]))
        after = self.pin.integrate(self.m, q, h * v)
        self.q = after[[0, 1, 2, 6, 3, 4, 5]]
        self.v = np.concatenate([self.pin.Quaternion(*self.q[3:]).matrix() @ v[:3], v[3:]])
        self.t += h
