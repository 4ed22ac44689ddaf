"""Fish of the solver with hidden changes: masses, forces and added masses of effects, and servos by `Electronics`.

    f  = T^T (f_effect - f_null),   A = T^T (A_effect - A_null) T          W_k = psi' + j_1' + .. + j_k'  in T

A hydrodynamic effect adds its contribution in the second robot's water, at the same state: the force explicitly, the added mass
in the mass matrix. Masses, balance and inertia are set in the MuJoCo body.

    tau_j ~ a_j - D_j w_j      over one step of the water, a_j = P_j / dt + D_j w_j*

The solver couples fish and water implicitly and needs each joint's torque in that form. Firmware, bridge, gears and friction of
the second robot run ahead through the step, 1 ms at a time; the second robot's water predicts the joints' motion. P_j is their
impulse, friction included, w_j* their final rate, D_j the mean slope of back-EMF and viscous friction. If a joint moves
otherwise in the solver, the slope corrects the torque implicitly. A joint that friction holds during the whole step is fixed
(`held`): its row of the solve is w_j = 0.
"""

from math import exp
from typing import NamedTuple

import numpy as np

from fishmj.gap.laboratory.virtual_robot.chain import assemble, factor, push_joint, solve
from fishmj.gap.laboratory.virtual_robot.constant_groups import HullConstants, UncataloguedEffects
from fishmj.gap.laboratory.virtual_robot.loop import H, blow, rub, write
from fishmj.gap.laboratory.virtual_robot.loop_compiler import entry
from fishmj.gap.laboratory.virtual_robot.rigid_body import body_of
from fishmj.gap.laboratory.virtual_robot.robot_constants import RobotConstants, nominal
from fishmj.gap.laboratory.virtual_robot.servo import battery, firmware, friction_bound, motor_torque, spring_torque
from fishmj.gap.laboratory.virtual_robot.simulate import STILL, ChainState, StateRecording, columns, workspace
from fishmj.gap.laboratory.virtual_robot.water import friction_speed
from fishmj.lbm_oracle.immersed.body import DisplacedWater
from fishmj.lbm_oracle.immersed.driven_body import DrivenBody
from fishmj.mjcf import build

IMPULSE, SLOPE, END, FASTEST, TORQUE = range(5)  # columns of `law`
HELD = 1e-8  # rad/s, below which friction holds a joint
REAL = ("flow_x", "flow_y", "current_x", "current_y")  # fields of the tank that the solver's water has itself


@entry
def ahead(body, water, motor, tank, odd, zero, gust, arrivals, commands, s, record, work, law):
    """Runs the servos len(record) milliseconds ahead; advances `s`, whose positions and rates are a prediction.

    Args:
        as in `virtual_robot.loop.advance`. The rotor inertia is part of the prediction and of the solver's mass matrix.
        law: (J, 5) written: impulse N m s, slope summed over time N m s^2/rad, rate at the end, greatest rate rad/s, scratch.
    """
    A, f, mobility, columns, bound, w, stream, sprung = work
    fresh = 1.0 - exp(-H / motor.inductive_time)
    nxt = 0
    law[:, :] = 0.0
    for step in range(record.shape[0]):
        time = s.clock[0]
        while nxt < arrivals.shape[0] and arrivals[nxt] <= time + 1e-9:
            for j in range(len(body.joints)):
                s.goal[j] = commands[nxt, j]
            nxt += 1
        blow(gust, tank, time, stream)
        if time >= s.clock[1] - 1e-9:
            firmware(body, motor, odd, zero, s)
            friction_speed(body, s, stream)
            s.clock[1] += motor.period
        assemble(body, water, tank, odd, s, stream, A, f, H)
        for j in range(len(body.joints)):
            angle, rate = s.z[3 + j] - s.z[2 + j], s.rate[3 + j] - s.rate[2 + j]
            torque, damping = motor_torque(motor, s, j, rate, fresh, H)
            bound[j] = H * friction_bound(motor, rate, torque)
            slow = motor.viscous + motor.damping
            sprung[j] = spring_torque(motor, odd, water, zero, s, j, angle, rate, H)
            push_joint(A, f, j, torque + sprung[j] - slow * rate, motor.armature + H * (damping + slow))
            law[j, TORQUE] = torque + sprung[j] - slow * rate
            law[j, END] = H * (damping + slow)
        battery(body, motor, s, H)
        write(body, record, step, s)
        factor(body, A)
        for a in range(len(body.links) + 2):
            f[a] *= H
        solve(body, A, f)
        rub(body, A, f, s, mobility, columns, bound, w)
        for j in range(len(body.joints)):
            change = f[3 + j] - f[2 + j]
            law[j, IMPULSE] += H * law[j, TORQUE] - law[j, END] * change + s.stuck[j]
            law[j, SLOPE] += law[j, END]
            law[j, FASTEST] = max(law[j, FASTEST], abs(s.rate[3 + j] - s.rate[2 + j] + change))
        for a in range(len(body.links) + 2):
            s.rate[a] += f[a]
            s.z[a] += H * s.rate[a]
        s.clock[0] = time + H
    for j in range(len(body.joints)):
        law[j, END] = s.rate[3 + j] - s.rate[2 + j]


@entry
def forces(body, water, tank, odd, gust, s, stream, A, f, h):
    """Mass matrix A (n, n), lower half, and forces f (n,), n = N + 2, of the second robot and its water, without its joints."""
    blow(gust, tank, s.clock[0], stream)
    assemble(body, water, tank, odd, s, stream, A, f, h)


class HiddenBody(DrivenBody):
    """`DrivenBody` with a virtual robot's masses, whose joints follow tau = a - D w."""

    def __init__(self, made: RobotConstants, dt: float, heavier: float = 1.0):
        super().__init__(build(made.robot, "planar", bare=True), DisplacedWater.of(made.robot), dt)
        self.model.dof_armature[-self.joints :] = made.motor.armature
        rigid = made.body
        middle = rigid.first / rigid.mass
        self.set_masses(heavier * rigid.mass, middle, heavier * (rigid.second - rigid.mass * middle**2))

    def set_torque(self, a: np.ndarray, slope: np.ndarray) -> None:
        """Sets tau = a - slope w on the joints (J,) for the next step, N m and N m s/rad."""
        self.drive(np.concatenate([self.applied[:3], a]), slope)


class HiddenDifference:
    """Change of the second robot's water by the planted effects; zero for actuators, clocks and sensors."""

    def __init__(self, made: RobotConstants, gust: np.ndarray):
        rigid = HullConstants(mass=made.hull.mass, com=made.hull.com, inertia=made.hull.inertia)
        plain = nominal(made.robot)
        tank = made.tank._replace(**{key: value for key, value in plain.tank._asdict().items() if key not in REAL})
        drawn = [key for key in made.water._fields if key not in made.water._field_defaults]  # fields of every robot, not effects
        nuisance = {key: getattr(made.water, key) for key in drawn}
        self.pair = (
            (made.body, made.water, made.tank, made.odd, gust),
            (body_of(made.robot, made.sections, rigid), plain.water._replace(**nuisance), tank, UncataloguedEffects(), STILL),
        )
        self.wakes = [np.zeros(6), np.zeros(6)]
        self.absolute = absolute(made.robot.n_joints)
        self.acts = made.hull != rigid or self.pair[0][1:4] != self.pair[1][1:4] or bool(np.any(gust))
        n = len(self.absolute)
        self._work = [(np.zeros(4), np.zeros((n, n)), np.zeros(n)) for _ in self.pair]

    def __call__(self, state: ChainState, h: float) -> tuple[np.ndarray, np.ndarray]:
        """Force (n,) and added mass (n, n) over (x, y, psi, j1..jJ) at `state`; advances the wakes by h."""
        found = []
        for groups, wake, (stream, A, f) in zip(self.pair, self.wakes, self._work, strict=True):
            *groups_, gust = groups
            forces(*groups_, gust, state._replace(wake=wake), stream, A, f, h)
            found.append((f, A + np.tril(A, -1).T))
        (f, A), (f0, A0) = found
        turn = self.absolute
        return turn.T @ (f - f0), turn.T @ (A - A0) @ turn


def absolute(joints: int) -> np.ndarray:
    """T (3 + J, 3 + J): rates of (x, y, psi, j1 .. jJ) -> (x, y, W1 .. WN)."""
    out = np.eye(3 + joints)
    out[3:, 2] = 1.0
    out[3:, 3:] = np.tril(np.ones((joints, joints)))
    return out


class Queue(NamedTuple):
    """Commands (K, J) rad that reach the servos at times (K,) s, rising."""

    times: np.ndarray
    commands: np.ndarray


class Electronics:
    """Electronics of one robot on the joints of the solver's fish: receives commands, drives the servos, records all.

    In each step of the water, `actuate` runs the servos ahead and sets their law; `follow` takes the solver's state.

    Args:
        made: the robot. state: at t = 0. queue: arriving commands with times. gust: weather of the second robot's water (G, 2).
    """

    def __init__(self, made: RobotConstants, state: ChainState, queue: Queue, gust: np.ndarray):
        self.made, self.state, self.queue, self.gust = made, state, queue, gust
        self.difference = HiddenDifference(made, gust)
        self.joints = made.robot.n_joints
        self.law, self.held = np.zeros((self.joints, 5)), np.zeros(self.joints, bool)
        self.rows: list[np.ndarray] = []  # one array (n, 8 + 4 J) a step
        self._work, self._tick, self._next = workspace(self.joints), -1, 0.0
        self._tick_start: tuple[list[np.ndarray], int, float] = ([], 0, 0.0)

    def begin_tick(self, tick: int) -> None:
        """Prepares an attempt at a tick: a second attempt starts from the same state as the first."""
        arrays = (*self.state, *self.difference.wakes)
        if tick != self._tick:
            self._tick, self._tick_start = tick, ([a.copy() for a in arrays], len(self.rows), self._next)
            return
        saved, rows, self._next = self._tick_start
        for array, old in zip(arrays, saved, strict=True):
            array[:] = old
        del self.rows[rows:]

    def actuate(self, body: HiddenBody, time: float) -> None:
        """Sets the joints' law, and the effects' contributions, for the step of the water that begins at `time` s."""
        extra = np.zeros(self.joints)
        if self.difference.acts:
            force, mass = self.difference(self.state, body.dt)
            body.applied[:3], body.added_mass = force[:3], mass
            extra = force[3:]
        if time >= self._next - 1e-9:  # water steps finer than the servos' share a law
            self._run_ahead(max(1, round(body.dt / H)))
        seconds = max(body.dt, H)
        slope = self.law[:, SLOPE] / seconds
        body.set_torque(self.law[:, IMPULSE] / seconds + slope * self.law[:, END] + extra, slope)

    def _run_ahead(self, steps: int) -> None:
        made, q = self.made, self.queue
        record = np.empty((steps, len(columns(self.joints))))
        first = int(np.searchsorted(q.times, self.state.clock[0] - H))
        groups = (made.body, made.water, made.motor, made.tank, made.odd, made.zero, self.gust)
        ahead(*groups, q.times[first:], q.commands[first:], self.state, record, self._work, self.law)
        self.held = self.law[:, FASTEST] < HELD
        self._next = float(self.state.clock[0])
        self.rows.append(record)

    def follow(self, body: HiddenBody) -> None:
        """Replaces the prediction by the solver's state; between its steps the recording is linear."""
        self.place(body)
        record = self.rows[-1]
        if len(record) > 1:
            now = places(self.state)
            share = (np.arange(len(record)) / len(record))[:, None]
            record[:, : len(now)] = record[0, : len(now)] + share * (now - record[0, : len(now)])

    def place(self, body: HiddenBody) -> None:
        """Copies positions and rates of the body, as absolute angles of the links."""
        q, v = body.data.qpos, body.data.qvel
        self.state.z[:2], self.state.rate[:2] = q[:2], v[:2]
        self.state.z[2:], self.state.rate[2:] = np.cumsum(q[2:]), np.cumsum(v[2:])

    def recording(self) -> StateRecording:
        """Recording so far, one row per millisecond."""
        data = np.concatenate(self.rows)
        return StateRecording(np.arange(len(data)) * H, data)


def places(state: ChainState) -> np.ndarray:
    """Pose, its rates, joints, their rates (6 + 2 J,): the first columns of a recording."""
    z, rate = state.z, state.rate
    return np.concatenate([z[:3], rate[:3], np.diff(z[2:]), np.diff(rate[2:])])
