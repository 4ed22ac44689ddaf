"""Joint torques for which simulators have no parameter, from their formulas.

    speed limit          |tau| <= limit (1 - slowness |v|) where the motor drives          line between stall and no load
    torque ripple        tau = a sin(2 pi q / P) + b cos(2 pi q / P)                       cogging
    elastic coupling     tau = -K (q_j - q_i) at j, + at the joint i before it             a belt, a biarticular spring
    cable torque         tau = -s A (max(0, s (q - q_0)) / 0.3)^2                          a hose that tightens
    vibration            tau = A sin(2 pi f t + phi)                                       an imbalance, a fan
    hysteresis           tau = -A z,  dz/dt = v / d (1 - sign(v) z)                        Dahl (1968), presliding

Friction that depends on speed and load is given as a magnitude, which each generator applies in its own way:

    F(v, tau) = F_s exp(-(v / v_s)^2) + mu |tau|          Stribeck (Armstrong-Helouvry 1994), load (Duclusaud 2024)
"""

import numpy as np

from fishmj.gap.laboratory.articulated.hidden_faults import Hidden, placed
from fishmj.gap.laboratory.articulated.robot_plan import RobotPlan

TIGHT = 0.3  # rad over which a cable's torque reaches its size
LARGEST = 9.0  # largest (angle / TIGHT)^2 of the cable


class JointMotors:
    """The actuators of a robot. `torque(u, q, v)` -> (J,) N m for delivered commands u, angles and rates."""

    def __init__(self, plan: RobotPlan):
        self.torques, self.gear = plan.torques, plan.column("gear")
        self.kp, self.kv = plan.column("kp"), plan.column("kv")
        self.limit, self.offset = plan.column("limit"), plan.column("offset")

    def torque(self, u: np.ndarray, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Torque within the motors' limits."""
        requested = self.gear * u if self.torques else self.kp * (u - q) - self.kv * v
        return np.minimum(np.maximum(requested + self.offset, -self.limit), self.limit)


class JointLaws:
    """Hidden laws of one robot. Call `torques` and `friction` once per step, in order of time."""

    def __init__(self, plan: RobotPlan, hidden: Hidden):
        self.plan = plan
        self.parents = [b.parent for b in plan.limbs]
        self.laws = [(effect, k, values) for name, values in hidden.items() for effect, k in (placed(name),)]
        self.friction_laws = [law for law in self.laws if law[0] in ("stribeck", "load_friction")]
        self.hysteresis = np.zeros(len(plan.limbs))

    def torques(self, q: np.ndarray, v: np.ndarray, motor: np.ndarray, t: float, h: float) -> np.ndarray:
        """Torques (J,) [N m] added to the motors' at time t, for a step h [s]."""
        out = np.zeros(len(q))
        for effect, k, p in self.laws:
            if effect == "speed_limit":
                most = self.plan.limbs[k].limit * max(0.0, 1.0 - p["slowness"] * abs(v[k]))
                if motor[k] * v[k] > 0 and abs(motor[k]) > most:
                    out[k] += np.sign(motor[k]) * most - motor[k]
            elif effect == "torque_ripple":
                turn = 2.0 * np.pi * q[k] / p["period"]
                out[k] += p["sine"] * np.sin(turn) + p["cosine"] * np.cos(turn)
            elif effect == "elastic_coupling":
                pull = p["stiffness"] * (q[k] - q[self.parents[k]])
                out[k] -= pull
                out[self.parents[k]] += pull
            elif effect == "cable_torque":
                beyond = max(0.0, p["side"] * (q[k] - self.plan.limbs[k].swing[0] - p["from"])) / TIGHT
                out[k] -= p["side"] * p["torque"] * min(beyond**2, LARGEST)
            elif effect == "vibration":
                out[k] += p["torque"] * np.sin(2.0 * np.pi * p["frequency"] * t + p["phase"])
            elif effect == "hysteresis":
                rate = abs(v[k]) * h / p["angle"]
                self.hysteresis[k] = np.sign(v[k]) + (self.hysteresis[k] - np.sign(v[k])) * np.exp(-rate)
                out[k] -= p["torque"] * self.hysteresis[k]
        return out

    def friction(self, v: np.ndarray, motor: np.ndarray) -> np.ndarray:
        """Magnitude (J,) [N m] of the dry friction beyond the plan's."""
        out = np.zeros(len(v))
        for effect, k, p in self.friction_laws:
            if effect == "stribeck":
                out[k] += p["torque"] * np.exp(-((v[k] / p["speed"]) ** 2))
            else:
                out[k] += p["ratio"] * abs(motor[k])
        return out


class FreeBodyLaws:
    """Hidden forces on a free body for which simulators have no parameter.

    tether            F = -K (x - x_0) (1 - L / |x - x_0|) beyond the slack length L        a cable to the ground
    body vibration    torque A sin(2 pi f t + phi) about the body's x                      a bent propeller
    """

    def __init__(self, hidden: Hidden):
        named = {placed(name)[0]: values for name, values in hidden.items()}
        self.tether, self.vibration = named.get("tether"), named.get("body_vibration")

    def wrench(self, q: np.ndarray, t: float) -> np.ndarray:
        """(6,) N in the world, N m in the body."""
        out = np.zeros(6)
        if self.tether:
            offset = q[:3] - [self.tether[n] for n in ("x", "y", "z")]
            distance = float(np.linalg.norm(offset))
            out[:3] = -self.tether["stiffness"] * offset * max(0.0, 1.0 - self.tether["slack"] / max(distance, 1e-9))
        if self.vibration:
            p = self.vibration
            out[3] = p["torque"] * np.sin(2.0 * np.pi * p["frequency"] * t + p["phase"])
        return out
