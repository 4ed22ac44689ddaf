"""Experiments for a robot in MJCF: commands within its limits, and the largest of them that keep it safe in simulation.

    start      where the robot rests: torques off, or servos at its first key frame, else at qpos0 moved into the middle half of
               each joint's range
    command    u0 + size * span * signal(t), faded in and out; span: to the nearest limit of ctrl, joint or force
    safe       each joint stays within its range less MARGIN (without a range: half a turn from the start) and below `speed`, and
               no new contact occurs, both with the described model and with half its friction

families: `multisine` five harmonics a joint with random phases; `chirp` 0.1 to 3 Hz; `steps` random levels of 0.4 to 1.2 s;
`holds` slow ramps between levels that are held; `in_turn` a multisine of one joint after another.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np
from mujoco import rollout

from fishmj.base.errors import ConfigError
from fishmj.gap.models.robot_description import RobotDescription, neighbours
from fishmj.gap.progress import Bars, silent_bar

FAMILIES = ("multisine", "chirp", "steps", "holds", "in_turn")
MARGIN, MIDDLE = 0.1, 0.25  # share of a joint's range excluded at either end for motion, and for the start
TURN = np.pi  # rad or m from the start, without a range
PERIOD = 0.01  # s between two commands
LOOK = 0.02  # s between two checks for contacts
FADE = 0.5  # s of fade-in and fade-out of the commands
LOWEST, HIGHEST = 0.1, 2.0  # Hz of multisines
FASTEST = 3.0  # Hz of a chirp's end
SHARES = tuple(np.geomspace(1.0, 0.01, 14).round(3).tolist())  # tried sizes, as shares of the span
SETTLE = 6.0  # s in which a robot comes to rest, with more damping
GENTLE = 0.4  # of the largest safe size: friction shows in slow motion
RESTING = 0.01  # rad/s or m/s, largest rate of a robot at rest
LOOSE = 0.5  # factor on friction and damping in the second safety check


class RobotExperiment(NamedTuple):
    """Commands (T, A) at stamps t (T,) s, the described model's motion, and the largest safe size.

    q, v: (T, J) angles and rates. share: of the span.
    """

    family: str
    share: float
    t: np.ndarray
    commands: np.ndarray
    q: np.ndarray
    v: np.ndarray


class RobotRest(NamedTuple):
    """Start of a robot. command: (A,) that holds it; span: (A,) largest change of each command on either side."""

    qpos: np.ndarray
    command: np.ndarray
    span: np.ndarray


def rest_of(robot: RobotDescription, speed: float) -> RobotRest:
    """The start of an experiment. speed: largest of a joint, rad/s or m/s. Raises ConfigError if it does not come to rest."""
    m = _free(robot)
    d = mujoco.MjData(m)
    if m.nkey:
        mujoco.mj_resetDataKeyframe(m, d, 0)
    for j in robot.joints:
        if m.jnt_limited[j.joint] and not m.nkey:
            d.qpos[j.place] = np.clip(d.qpos[j.place], *_inside(m, j.joint, MIDDLE))
    servo = m.actuator_biasprm[:, 1] != 0.0
    command = np.zeros(m.nu)
    for j in robot.joints:
        if j.actuator >= 0 and servo[j.actuator]:
            command[j.actuator] = -m.actuator_biasprm[j.actuator, 1] / m.actuator_gainprm[j.actuator, 0] * d.qpos[j.place]
            command[j.actuator] *= m.actuator_gear[j.actuator, 0]
    limited = m.actuator_ctrllimited.astype(bool)
    low, high = np.where(limited, m.actuator_ctrlrange.T, [[-np.inf], [np.inf]])
    command = np.clip(command, low, high)
    damping = m.dof_damping.copy()
    m.dof_damping[:] += 2.0 * np.sqrt(np.maximum(m.dof_M0 * 9.81, 1e-9))
    d.ctrl[:] = command
    for _ in range(round(SETTLE / m.opt.timestep)):
        mujoco.mj_step(m, d)
    if not np.all(np.isfinite(d.qpos)) or np.abs(d.qvel).max(initial=0.0) > max(0.1 * speed, RESTING):
        raise ConfigError(f"{robot.path}: does not come to rest, motors off or servos at key frame 1; add a key frame at rest")
    m.dof_damping[:] = damping
    return RobotRest(d.qpos.copy(), command, _spans(robot, m, d, command, low, high, speed))


def _spans(robot: RobotDescription, m: Any, d: Any, command: np.ndarray, low, high, speed: float) -> np.ndarray:
    """(A,) distance to the nearest limit: of the command; of the joint, for a servo; of force and motion, for a motor."""
    span = np.minimum(high - command, command - low)
    for j in robot.joints:
        a = j.actuator
        if a < 0:
            continue
        gear = abs(m.actuator_gear[a, 0]) or 1.0
        edges = np.abs(d.qpos[j.place] - _inside(m, j.joint)).min() if m.jnt_limited[j.joint] else TURN
        reach = min(float(edges), TURN / 2.0)
        stiffness = -m.actuator_biasprm[a, 1]
        if stiffness > 0.0:
            span[a] = min(span[a], reach * gear * stiffness / abs(m.actuator_gainprm[a, 0]))
            continue
        if m.actuator_biasprm[a, 2] < 0.0:  # of a rate
            span[a] = min(span[a], speed * gear)
            continue
        force = m.actuator_forcerange[a, 1] if m.actuator_forcelimited[a] else np.inf
        swing = m.dof_M0[j.dof] * speed * 2.0 * np.pi * HIGHEST + _gravity(robot, m, j.dof)
        span[a] = min(span[a], min(force, swing / gear) / abs(m.actuator_gainprm[a, 0]))
    return span


def _gravity(robot: RobotDescription, m: Any, dof: int) -> float:
    """Largest static load of a joint over some poses, N m."""
    d, rng, most = mujoco.MjData(m), np.random.default_rng(0), 0.0
    for _ in range(32):
        for j in robot.joints:
            low, high = m.jnt_range[j.joint] if m.jnt_limited[j.joint] else (-TURN, TURN)
            d.qpos[j.place] = rng.uniform(low, high)
        mujoco.mj_forward(m, d)
        most = max(most, abs(float(d.qfrc_bias[dof])))
    return most


def _free(robot: RobotDescription) -> Any:
    """MjModel without contacts, as in the search, with the delays of its actuators; contacts are checked separately."""
    m = robot.spec.copy().compile()
    m.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    return m


def _inside(m: Any, joint: int, margin: float = MARGIN) -> np.ndarray:
    """Range of a joint less a share of it on either side."""
    return m.jnt_range[joint] + margin * np.ptp(m.jnt_range[joint]) * np.array([1.0, -1.0])


def signal(family: str, joints: int, t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(T, joints) of one family, -1 to 1, faded in and out."""
    out = np.stack([_one(family, j, joints, t, rng) for j in range(joints)], 1)
    return out * np.clip(np.minimum(t, t[-1] - t) / FADE, 0.0, 1.0)[:, None]


def _one(family: str, j: int, joints: int, t: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    end = float(t[-1])
    if family == "chirp":
        rate = np.log(FASTEST / LOWEST) / end
        return np.sin(2.0 * np.pi * LOWEST * np.expm1(rate * t) / rate + rng.uniform(0.0, 2.0 * np.pi))
    if family in ("steps", "holds"):
        pause = (0.4, 1.2) if family == "steps" else (0.8, 1.6)
        ramp = 0.04 if family == "steps" else 0.8
        stamps, levels, now = [0.0], [0.0], 0.3
        while now < end:
            level = rng.uniform(-1.0, 1.0)
            stamps += [now, now + ramp]
            levels += [levels[-1], level]
            now += ramp + rng.uniform(*pause)
        return np.interp(t, stamps, levels)
    rates = np.geomspace(max(LOWEST, 1.0 / end), HIGHEST, 5) * rng.uniform(0.9, 1.1, 5)
    waves = np.sin(2.0 * np.pi * rates[:, None] * t + rng.uniform(0.0, 2.0 * np.pi, 5)[:, None]).sum(0)
    waves = waves / np.abs(waves).max()
    if family == "in_turn":
        first, last = end * j / joints, end * (j + 1) / joints
        waves = waves * np.clip(np.minimum(t - first, last - t) / FADE, 0.0, 1.0)
    return waves


def safe_experiments(
    robot: RobotDescription,
    rest: RobotRest,
    families: Sequence[str],
    seconds: float,
    speed: float,
    seed: int,
    others: Sequence[Any] = (),
    bars: Bars = silent_bar,
) -> list[RobotExperiment]:
    """Each family at its largest safe size and at GENTLE times that. A family that is never safe is left out.

    others: further MjModels, such as with the effects in question, in which they must be safe too.
    """
    t, out = np.arange(0.0, seconds, PERIOD), []
    with bars(len(families), "experiments", "families") as bar:
        for k, family in enumerate(families):
            shape = signal(family, len(rest.command), t, np.random.default_rng([seed, FAMILIES.index(family)]))
            at = lambda share, family=family, shape=shape: experiment_at(robot, rest, family, share, t, shape, speed, others)
            largest = next((found for share in SHARES if (found := at(share)) is not None), None)
            gentle = at(GENTLE * largest.share) if largest else None
            out += [one for one in (largest, gentle) if one is not None]
            bar.update(k + 1)
    return out


def experiment_at(
    robot: RobotDescription, rest: RobotRest, family: str, share: float, t: np.ndarray, shape: np.ndarray, speed: float, others=()
) -> RobotExperiment | None:
    """The experiment at a share of the span; None if it is not safe."""
    asked = rest.command + share * rest.span * shape
    loose = _free(robot)
    loose.dof_damping[:] *= LOOSE
    loose.dof_frictionloss[:] *= LOOSE
    first = None
    for m in (_free(robot), loose, *others):
        q, v, whole = _simulated(m, rest, t, asked)
        if not _is_safe(robot, m, rest, q, v, whole, speed):
            return None
        first = (q, v) if first is None else first
    q, v = (part[:: max(1, round(PERIOD / robot.dt))][: len(t)] for part in first or ())
    places, dofs = [j.place for j in robot.joints], [j.dof for j in robot.joints]
    return RobotExperiment(family, share, t[: len(q)], asked[: len(q)], q[:, places], v[:, dofs])


def _simulated(m: Any, rest: RobotRest, t: np.ndarray, asked: np.ndarray) -> tuple[np.ndarray, np.ndarray, bool]:
    """qpos (N, nq) and qvel (N, nv) at each step, and whether all are numbers."""
    steps = round((t[-1] + PERIOD) / m.opt.timestep)
    place = np.minimum((np.arange(steps) * m.opt.timestep / PERIOD + 1e-9).astype(int), len(t) - 1)
    begin = np.concatenate([[0.0], rest.qpos, np.zeros(m.nv + m.na)])
    if (more := mujoco.mj_stateSize(m, mujoco.mjtState.mjSTATE_FULLPHYSICS) - len(begin)) > 0:
        begin = np.concatenate([begin, np.zeros(more)])
    state, _ = rollout.rollout(m, mujoco.MjData(m), begin[None], asked[place][None])
    state = np.concatenate([begin[None], state[0]])
    q, v = state[:, 1 : 1 + m.nq], state[:, 1 + m.nq : 1 + m.nq + m.nv]
    return q, v, bool(np.all(np.isfinite(state)))


def _is_safe(robot: RobotDescription, m: Any, rest: RobotRest, q: np.ndarray, v: np.ndarray, whole: bool, speed: float) -> bool:
    if not whole or np.abs(v).max() > speed:
        return False
    for j in robot.joints:
        way = q[:, j.place]
        if m.jnt_limited[j.joint]:
            low, high = _inside(m, j.joint)
        else:
            low, high = rest.qpos[j.place] - TURN, rest.qpos[j.place] + TURN
        low, high = min(low, rest.qpos[j.place]), max(high, rest.qpos[j.place])
        if way.min() < low - 1e-6 or way.max() > high + 1e-6:
            return False
    bodies = robot.spec.copy().compile()
    d = mujoco.MjData(bodies)
    touching: set | None = None
    for qpos in q[:: max(1, round(LOOK / m.opt.timestep))]:
        d.qpos[:] = qpos
        mujoco.mj_fwdPosition(bodies, d)
        pairs = {tuple(sorted(c.geom.tolist())) for c in d.contact if c.dist < 0.0 and not neighbours(bodies, *c.geom)}
        touching = pairs if touching is None else touching
        if pairs - touching:
            return False
    return True
