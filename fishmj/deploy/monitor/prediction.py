"""Prediction of the next bus tick: the planar fish in water of strips, corrected by earlier measurements.

    predict   q, v after one bus tick of the delayed commands (`fishmj.water.dynamics.planar_chain`, the robot's own physics step)
    compare   e = measured - predicted: joints now; pose at the model's place at the frame's exposure; power over the tick
    correct   q += alpha e,   v += (beta / dt) e          an alpha-beta observer with fixed gains

The observer follows the fish slowly on purpose: an acceleration a that the model lacks stays visible in e as a / omega^2, with
beta = (omega dt)^2. Each innovation e comes with its probes: the directions in which a known kind of fault would move it.
One definition serves one fish, of floats, beside the tank, and many logs at once, of arrays (B,).
"""

import math
from typing import Any, NamedTuple

from fishmj.mjcf.description import Robot
from fishmj.water.dynamics import planar_chain

BODY: dict[str, tuple[str, ...]] = {
    "surge": ("offset", "drag", "inertia", "stream_x", "stream_y"),
    "sway": ("offset", "drag", "inertia", "stream_x", "stream_y"),
    "yaw_rate": ("offset", "drag", "inertia", "munk"),
}
JOINT = ("offset", "rate", "torque", "friction")
POWER = ("offset", "load")
FOLLOW, DAMPED = 2.0, 0.8  # rad/s, 1: how fast the observer follows the pose
JOINT_FOLLOW = 12.0  # rad/s, and the joints
CREEP = 0.2  # rad/s, over which dry friction changes its sign


class Floats:
    """The model's array functions for plain floats: ten times as fast as NumPy on single numbers."""

    cos, sin, sqrt, exp, arctan2, tanh = math.cos, math.sin, math.sqrt, math.exp, math.atan2, math.tanh
    abs, minimum, maximum = abs, min, max

    @staticmethod
    def where(condition, a, b):
        """a if `condition` is true, else b."""
        return a if condition else b


class TickMeasurement(NamedTuple):
    """One bus tick of measurement; entries are floats or arrays (B,)."""

    target: Any  # [S][J] rad, the command at the servo in each physics step of the tick
    joint: Any  # [J] rad, at the end of the tick
    pose: Any = None  # [3] m, m, rad: the frame that is there at the end of the tick; None in air
    power: Any = None  # W, electrical, with idle; None without a meter


class Innovation(NamedTuple):
    """Prediction errors of a tick: channel -> e, and channel -> the value of each of its probes."""

    error: dict[str, Any]
    probes: dict[str, tuple]


def channels(joints: int, pose: bool = True, power: bool = True) -> dict[str, tuple[str, ...]]:
    """Channel -> names of its probes."""
    body = BODY if pose else {}
    return {**body, **{f"j{k + 1}": JOINT for k in range(joints)}, **({"power": POWER} if power else {})}


class SwimPredictor:
    """The model of one robot, or of B of them at once.

    Args:
        xp: `Floats` or numpy.
        flow: velocity of the ordered stream (x, y), m/s, tank frame; floats or arrays (B,).
        camera: s from a frame to its stamp in the table; by default the description's.
    """

    def __init__(self, robot: Robot, xp: Any = Floats, flow: tuple[Any, Any] = (0.0, 0.0), camera: float | None = None):
        self.robot, self.xp = robot, xp
        self.chain, self.swimmer = planar_chain.chain_of(robot), planar_chain.nominal(robot)
        self.dt, self.joints = robot.timing.bus_dt, robot.n_joints
        self.idle = robot.servo.idle_power
        self.late = (robot.timing.camera_latency if camera is None else camera) / robot.timing.bus_dt
        self.flow = [tuple(flow)] * self.chain.n
        self.body = _gains(FOLLOW, self.dt)
        self.servo = _gains(JOINT_FOLLOW, self.dt)
        self._poses: list[list] = []
        self._filters: dict[tuple[str, str], list] = {}

    def begin(self, seen: TickMeasurement) -> None:
        """Starts at rest at the measured pose."""
        pose = [0.0 * seen.joint[0]] * 3 if seen.pose is None else list(seen.pose)
        self.q, self.v = [*pose, *seen.joint], [0.0 * seen.joint[0]] * (3 + self.joints)
        self.attached = 0.0 * seen.joint[0] + 1.0
        self._poses = [list(pose)] * (int(self.late) + 2)
        self._filters = {}

    def step(self, seen: TickMeasurement) -> Innovation:
        """Predicts, compares and corrects one bus tick."""
        xp = self.xp
        power, accel = self._moved(seen.target)
        drive = planar_chain.servo_drive(xp, self.chain, self.swimmer, self.q, self.v, seen.target[-1])
        error: dict[str, Any] = {}
        probes: dict[str, tuple] = {}
        one = 0.0 * self.q[2] + 1.0
        for k in range(self.joints):
            e = seen.joint[k] - self.q[3 + k]
            rate = self.v[3 + k]
            self._correct(3 + k, e, self.servo)
            error[f"j{k + 1}"] = e
            probes[f"j{k + 1}"] = self._filtered(f"j{k + 1}", (one, rate, drive[k], xp.tanh(rate / CREEP)), self.servo)
        if seen.pose is not None:
            self._body(seen, accel, error, probes, one)
        if seen.power is not None:
            error["power"] = seen.power - power - self.idle
            probes["power"] = (one, power)
        return Innovation(error, probes)

    def _moved(self, targets: Any) -> tuple[Any, Any]:
        """Advances by the physics steps of a tick, a target each. Returns mean power, W, and the last step's acceleration."""
        power: Any = 0.0
        for target in targets:
            made = planar_chain.step(
                self.xp, self.chain, self.swimmer, self.q, self.v, self.attached, target, self.flow, (0.0, 0.0)
            )
            self.q, self.v, self.attached = list(made.q), list(made.v), made.attached
            power = power + made.power
        return power / len(targets), made.accel

    def _body(self, seen: TickMeasurement, accel, error: dict, probes: dict, one) -> None:
        """Compares with the model's pose at the frame's exposure; corrects the present pose."""
        xp = self.xp
        self._poses = [*self._poses[1:], self.q[:3]]
        whole = int(self.late)
        share = self.late - whole
        new, old = self._poses[-1 - whole], self._poses[-2 - whole]
        then = [(1.0 - share) * n + share * o for n, o in zip(new, old, strict=True)]
        ex, ey, turn = (m - p for m, p in zip(seen.pose, then, strict=True))
        turn = xp.arctan2(xp.sin(turn), xp.cos(turn))
        c, s = xp.cos(then[2]), xp.sin(then[2])
        error |= {"surge": c * ex + s * ey, "sway": c * ey - s * ex, "yaw_rate": turn}
        vx, vy, r = self.v[0] - self.flow[0][0], self.v[1] - self.flow[0][1], self.v[2]
        u, w = c * vx + s * vy, c * vy - s * vx
        kinds = {
            "surge": (one, u * xp.abs(u), accel[0], c, s),
            "sway": (one, w * xp.abs(w), accel[1], -s, c),
            "yaw_rate": (one, r * xp.abs(r), accel[2], u * w),
        }
        for name, values in kinds.items():
            probes[name] = self._filtered(name, values, self.body)
        for a, e in enumerate((ex, ey, turn)):
            self._correct(a, e, self.body)
            for past in self._poses:
                past[a] = past[a] + self.body[0] * e

    def _correct(self, a: int, e, gains: tuple[float, float]) -> None:
        self.q[a] = self.q[a] + gains[0] * e
        self.v[a] = self.v[a] + gains[1] / self.dt * e

    def _filtered(self, channel: str, values: tuple, gains: tuple[float, float]) -> tuple:
        """Response of e, times omega^2, to an acceleration in proportion to each value: the observer's own error dynamics."""
        alpha, beta = gains
        out = []
        for i, value in enumerate(values):
            x, v = self._filters.get((channel, str(i)), (0.0 * value, 0.0 * value))
            v = v + beta * value  # in units of dt^2 / beta: a constant 1 ends at 1
            x = x + v
            out.append(x)
            self._filters[channel, str(i)] = [x - alpha * x, v - beta * x]
        return tuple(out)


def _gains(omega: float, dt: float) -> tuple[float, float]:
    """(alpha, beta) of an observer of bandwidth omega, rad/s."""
    return 2.0 * DAMPED * omega * dt, (omega * dt) ** 2
