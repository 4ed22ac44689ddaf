"""Robot in MuJoCo: bodies, joints, friction, actuators and time steps are MuJoCo's own; the forces of the water are added.

A step calls the parts of MuJoCo's `mj_step` (Euler, implicit in joint damping). The water's added mass J^T A J is added to the
mass matrix before its factorisation, so that it is implicit and acts in the friction constraints; other forces of the water are
added to `qfrc_applied`. `frictionloss`, `damping`, `armature`, `stiffness`, gains and force ranges are fields of the model, which
effects edit.

    supply     P = P_idle + sum max(V i, 0),  V = R F / K,  i = (F - k_b w) / K,  F the actuator's force   DC motor on a bridge
"""

from typing import NamedTuple

import mujoco
import numpy as np

from fishmj.base.errors import ConfigError, SimDiverged
from fishmj.gap.laboratory.generators.link_chain import LinkChain, work_of
from fishmj.gap.laboratory.generators.robot_parameters import RobotParameters
from fishmj.mjcf import passive_slot
from fishmj.mjcf.geometry import geometry_of
from fishmj.mjcf.model import build_spec

STEP = 0.002  # s
LOOSE, SLOSH = "loose", "slosh"  # joints that faults add


class TrueMotion(NamedTuple):
    """True motion, one row per physics step. q, rate (T, nv): x, y, yaw, joints; volts, amps (T,) of the battery."""

    t: np.ndarray
    q: np.ndarray
    rate: np.ndarray
    volts: np.ndarray
    amps: np.ndarray

    def at(self, t: np.ndarray, column: int) -> np.ndarray:
        """A column of q at other times, linear between rows."""
        return np.interp(t, self.t, self.q[:, column])


def compiled(fish: RobotParameters, step: float) -> mujoco.MjModel:
    """MuJoCo's model of the robot, with the friction constraints on.

    Raises ConfigError: the hidden effect leaves an impossible body.
    """
    spec = build_spec(fish.robot, bare=True)
    spec.option.timestep = step
    spec.option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_CONTACT) | int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
    bodies = [spec.body(link.name) for link in fish.robot.links]
    for body, more in zip(bodies, fish.mass, strict=True):
        grown = 1.0 + more / body.mass
        body.mass, body.inertia = body.mass * grown, np.asarray(body.inertia) * grown
    head = bodies[0]
    head.ipos = np.asarray(head.ipos) + np.array([fish.com, 0.0, 0.0])
    # pitch inertia has no effect in the plane, but the three inertias must be those of a real body, so it changes too
    head.inertia = np.asarray(head.inertia) + np.array([0.0, 1.0, 1.0]) * fish.inertia
    for i in range(fish.joints):
        joint, actuator = spec.joint(f"j{i + 1}"), spec.actuator(f"j{i + 1}")
        joint.damping, joint.frictionloss, joint.armature = [fish.kb[i], 0, 0], fish.friction[i], fish.armature[i]
        joint.stiffness, joint.springref = [fish.spring[i], 0, 0], 0.0
        actuator.set_to_position(kp=fish.kp[i], kv=fish.kv[i])
        actuator.biasprm[0] = fish.kp[i] * fish.zero[i]
        actuator.forcerange = [-fish.torque[i], fish.torque[i]]
    for edit in fish.specs:
        edit(spec)
    try:
        return passive_slot.compiled(spec)
    except ValueError as error:
        raise ConfigError(f"generator {fish.family.name}: impossible body, {error}; hide less") from error


class RobotSimulation:
    """Simulation of one robot. Faults that act over time read and write its `model`, `data`, `share` and `push`."""

    def __init__(self, fish: RobotParameters, step: float = STEP):
        self.fish, self.step = fish, step
        self.model = model = compiled(fish, step)
        self.data = mujoco.MjData(model)
        geometry, water, n = geometry_of(fish.robot), fish.water(), len(fish.robot.links)
        first = np.zeros(model.nv, np.int64)
        names = [model.joint(k).name for k in range(model.njnt)]
        self.hinges = np.array([names.index(f"j{i + 1}") for i in range(fish.joints)], int)
        for k, name in enumerate(names):
            first[k] = {LOOSE: n - 1, SLOSH: n}.get(name, int(name[1:]) if name[1:].isdigit() else 0)
        rows = np.repeat(np.arange(model.nv), model.M_rownnz)
        rigid = (geometry.displaced.astype(float), geometry.buoyancy.astype(float))
        hinge, centre = np.append(geometry.joint, 0.0), geometry.span.mean(1)
        self.chain = LinkChain(hinge, first, centre, water.added, *rigid, rows.astype(np.int64), model.M_colind.astype(np.int64))
        self.law, self.memory, self.work = water.law, np.zeros(max(water.memory, 1)), work_of(n, model.nv)
        self.flow, self.push = fish.flow.copy(), np.zeros(model.nv)
        self.share = np.ones(fish.joints)  # remaining share of gains and torque
        self.amps, self.own = 0.0, {}  # own: states of faults
        servo = fish.robot.servo
        self.idle, self.supply = servo.idle_power / servo.voltage, servo.voltage

    def place(self, start, push, joints) -> None:
        """Puts the fish at start (x, y, yaw), joints at `joints` (J,), moving with push (u, v, r) in its own axes."""
        data, (c, s) = self.data, (np.cos(start[2]), np.sin(start[2]))
        data.qpos[:3] = start
        data.qpos[self.hinges] = joints
        data.qvel[:3] = c * push[0] - s * push[1], s * push[0] + c * push[1], push[2]

    def forward(self) -> None:
        """Computes accelerations at the present state: MuJoCo's own forward dynamics with the water in it."""
        m, d, w = self.model, self.data, self.work
        mujoco.mj_kinematics(m, d)
        mujoco.mj_comPos(m, d)
        mujoco.mj_makeM(m, d)
        water = self.fish.family.step
        tether, drag = self.fish.tether, self.fish.drag
        water(self.chain, self.law, d.qpos, d.qvel, self.flow, drag, tether, self.memory, self.step, d.qfrc_applied, d.M, w)
        d.qfrc_applied += self.push
        mujoco.mj_factorM(m, d)
        mujoco.mj_makeConstraint(m, d)
        mujoco.mj_transmission(m, d)
        mujoco.mj_projectConstraint(m, d)
        mujoco.mj_fwdVelocity(m, d)
        mujoco.mj_fwdActuation(m, d)
        mujoco.mj_fwdAcceleration(m, d)
        mujoco.mj_fwdConstraint(m, d)

    def weaken(self, t: float) -> None:
        """Applies voltage sag and thermal derating to MuJoCo's gains and force ranges."""
        fish, m = self.fish, self.model
        left = self.share * np.exp(-fish.derating * t) * max(1.0 - fish.resistance * self.amps / self.supply, 0.3)
        m.actuator_gainprm[:, 0] = left * fish.kp
        m.actuator_biasprm[:, 0], m.actuator_biasprm[:, 1] = left * fish.kp * fish.zero, -left * fish.kp
        m.actuator_biasprm[:, 2] = -left * fish.kv
        m.actuator_forcerange[:, 0], m.actuator_forcerange[:, 1] = -left * fish.torque, left * fish.torque

    def current(self) -> float:
        """Current of motors and boards from the battery, A."""
        servo, force, rate = self.fish.robot.servo, self.data.actuator_force, self.data.qvel[self.hinges]
        constant = servo.voltage / servo.speed_no_load
        resistance = constant * servo.voltage / servo.torque
        amps = (force - self.fish.kb * rate) / constant
        return self.idle + float(np.sum(np.maximum(resistance * force / constant * amps, 0.0))) / self.supply


class ServoProcessors:
    """Processors of the servos: turn arriving commands into target angles of MuJoCo's actuators."""

    def __init__(self, run: RobotSimulation, first: np.ndarray):
        self.run, self.settings = run, run.fish.firmware
        self.goal, self.since = first.copy(), 0.0
        self.aim, self.ramp_start, self.target = (self.shaped(first) for _ in range(3))

    def shaped(self, command: np.ndarray) -> np.ndarray:
        """Command after gain, quantisation and clamp."""
        f = self.settings
        c = command * (1.0 + f.gain)
        if f.coarse > 0.0:
            c = np.floor(c / f.coarse + 0.5) * f.coarse
        c = np.clip(c, -f.range, f.range)
        return np.round(c / f.step) * f.step if f.step > 0.0 else c

    def tick(self, t: float) -> None:
        """Writes MuJoCo's ctrl; called once per firmware period."""
        f = self.settings
        wanted = self.shaped(self.goal)
        if f.move_time > 0.0:
            if np.any(wanted != self.target):
                self.ramp_start, self.target, self.since = self.aim.copy(), wanted, t
            wanted = self.ramp_start + min((t + f.period - self.since) / f.move_time, 1.0) * (self.target - self.ramp_start)
        if f.slowness > 0.0:
            most = f.period / f.slowness
            wanted = self.aim + np.clip(wanted - self.aim, -most, most)
        self.aim = wanted
        ctrl = self.run.data.ctrl
        ctrl[:] = wanted
        if f.deadband > 0.0:
            angle = self.run.data.qpos[self.run.hinges] - self.run.fish.zero
            ctrl[:] = np.where(np.abs(wanted - angle) < f.deadband, angle, wanted)


def swim(
    fish: RobotParameters, arrivals, commands, seconds: float, start, push, joints, gust=None, step: float = STEP
) -> TrueMotion:
    """Swims with commands (K, J) [rad] that reach the servos at arrivals (K,) [s].

    Raises SimDiverged: the state left the finite numbers; gives the time.
    """
    run = RobotSimulation(fish, step)
    run.place(start, push, np.asarray(joints, float) + fish.zero)
    servos = ServoProcessors(run, np.asarray(joints, float))
    n, k = round(seconds / step), 0
    every = max(round(fish.firmware.period / step), 1)
    data, nv, hinges = run.data, run.model.nv, [0, 1, 2, *run.hinges]
    q, rate, volts, amps = np.empty((n, nv)), np.empty((n, nv)), np.empty(n), np.empty(n)
    weak = fish.resistance > 0.0 or fish.derating != 0.0 or bool(fish.each_step)
    for i in range(n):
        t = i * step
        while k < len(arrivals) and arrivals[k] <= t + 1e-9:
            servos.goal = commands[k]
            k += 1
        for act in fish.each_step:
            act(run, t)
        if weak:
            run.weaken(t)
        if i % every == 0:
            servos.tick(t)
        if gust is not None:
            run.flow[:] = fish.flow
            run.flow[[0, 1, 6, 7]] += gust[i]
        run.forward()
        q[i], rate[i] = data.qpos, data.qvel
        run.amps = amps[i] = run.current()
        volts[i] = run.supply - fish.resistance * run.amps
        mujoco.mj_Euler(run.model, data)
    bad = np.flatnonzero(~np.isfinite(q).all(1))
    if len(bad):
        raise SimDiverged(f"generator {fish.family.name} left the finite numbers at t = {bad[0] * step:.3f} s; hide less")
    return TrueMotion(np.arange(n) * step, q[:, hinges], rate[:, hinges], volts, amps)
