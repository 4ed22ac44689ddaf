"""Compiled rollouts of a robot of hinges and slides: the steps of `mujoco.rollout`, ten times as fast.

MuJoCo's step is made for large scenes; for two joints it mostly checks what need not be computed. robot_loops.py has the
computations for a tree on a fixed base: bias forces, inertia, springs, damping, actuators, laws of the joints
(joint_laws.py), the box drag of a medium, dry friction as MuJoCo's constraint, and the integrators Euler and implicitfast.

    numbers of each model -> rows of a table (R models share one tree) -> `roll` -> states, and which rollouts it cannot do

`mujoco.rollout` is the reference (tests/test_gap_robot_kernel.py). It also runs every robot that `can_roll` refuses, and every
rollout that reaches a joint limit or diverges.
"""

from collections.abc import Sequence
from functools import cache
from typing import Any

import mujoco
import numpy as np

from fishmj.engines import fast_math, numba_build
from fishmj.gap.models import joint_laws
from fishmj.gap.models.kernel import HEADER, loops_text, roll_blocks

LANES = 8  # rollouts a vector loop: one 512-bit register of float64
# rows of a block of the workspace; the first 24 but two are given by the model
ROWS = dict(PLACE=0, TURN=3, MASS=12, ANGLE=22, RATE=23, TURNED=24, APART=33, SPIN=36, FLOW=39, TWIST=42, PULL=45)
ROWS |= dict(FORCE=48, WHOLE=54, SHARE=64, BLOCK=70)
# columns of a model's table: gravity, wind, step; then of each joint, then of each actuator
GROUND = dict(STEP=6, GROUND=7)
OF_JOINT = dict(ZERO=22, ARMATURE=23, DAMPING=24, STIFF=27, RUB=29, LOW=32, HIGH=33, JOINT=34)
DRIVE = 13
WILD = 1e9  # rad/s or m/s, above which MuJoCo itself does the rollout
TAKEN = ("CONTACT", "ISLAND", "SENSOR", "WARMSTART", "FILTERPARENT", "MIDPHASE", "NATIVECCD", "MULTICCD", "AUTORESET")
NONE = ("body_gravcomp", "jnt_actgravcomp", "jnt_stiffnesspoly", "actuator_damping", "actuator_dampingpoly", "actuator_armature")
IMPEDANCE = 1e-4, 0.9999  # mjMINIMP, mjMAXIMP
TINY = 1e-15  # mjMINVAL


def can_roll(m: Any) -> bool:
    """Returns True if the compiled steps support a robot, with any of its effects."""
    known = [int(mujoco.mjtIntegrator.mjINT_EULER), int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)]
    flags = sum(int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}")) for name in TAKEN)
    scene = m.ntendon + m.neq + m.na + m.nplugin + m.nflex + m.nmocap + m.opt.enableflags + m.opt.noslip_iterations
    fluid = m.geom_fluid.any() if m.ngeom else False
    drives = (
        m.actuator_gaintype.max(initial=0) > 1 or m.actuator_biastype.max(initial=0) > 1 or m.actuator_trntype.max(initial=0) > 1
    )
    hinged = m.nv == m.njnt == m.nq and bool(np.all(m.jnt_type >= int(mujoco.mjtJoint.mjJNT_SLIDE)))
    euler_poly = m.opt.integrator == known[0] and m.dof_dampingpoly.any()
    fields = any(np.any(getattr(m, name)) for name in NONE)
    refused = scene or fluid or drives or euler_poly or fields or m.opt.disableactuator or (int(m.opt.disableflags) & ~flags)
    return bool(hinged and not refused and m.opt.integrator in known and _has_numba())


@cache
def _has_numba() -> bool:
    try:
        numba_build.require_numba()
    except ImportError:
        return False
    return True


class RobotKernel:
    """Compiled rollouts of one robot. plain: its MjModel, whose tree all other models share."""

    def __init__(self, plain: Any):
        m = plain
        self.joints, self.actuators = m.njnt, m.nu
        self.frames = _Frames(m)
        moving = self.frames.owner >= 0
        self.bodies = np.flatnonzero(moving & (np.arange(m.nbody) > 0))
        tree = np.full((3, max(m.njnt, len(self.bodies))), -1, np.int64)
        tree[0, : m.njnt], tree[1, : m.njnt] = self.frames.parent, m.jnt_type == int(mujoco.mjtJoint.mjJNT_SLIDE)
        tree[2, : len(self.bodies)] = self.frames.owner[self.bodies]
        self.tree = tree
        self.driven = np.array([m.actuator_trnid[a, 0] for a in range(m.nu)], np.int64)
        self.euler = m.opt.integrator == int(mujoco.mjtIntegrator.mjINT_EULER)

    def __call__(self, models: Sequence[Any], which, begins, inputs, pushed=None) -> tuple[np.ndarray, np.ndarray]:
        """Rolls out.

        Args: models (M): MjModels of this robot. which (R,): model of each rollout. begins (R, 1 + 2 J): time, angles, rates.
        inputs (R, T, A): commands at each step. pushed (R, T, J): torques on the joints, or None.

        Returns (R, T, 1 + 2 J) states after each step, and (R,) False where MuJoCo itself has to roll.
        """
        table, bodies, medium, laws = self._numbers(models)
        out = np.empty((*inputs.shape[:2], begins.shape[1]))
        ok = np.array([not (self.euler and m.dof_dampingpoly.any()) for m in models])[which]
        pushed = np.zeros((len(begins), 0, self.joints)) if pushed is None else pushed
        tidy = np.ascontiguousarray
        numbers = tidy(which, np.int64), table, bodies, medium, laws, self.tree, self.driven
        given = *numbers, tidy(begins), tidy(inputs), tidy(pushed), self.euler, out, ok
        roll_blocks(_compiled(), len(begins), LANES, given)
        return out, ok

    def _numbers(self, models: Sequence[Any]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Tables of the models: numbers (M, ..), bodies (M, B, 15), medium (M, 2), laws (M, J, width)."""
        n, count, b = self.joints, len(models), self.bodies
        every = lambda name: np.array([getattr(m, name) for m in models], float).reshape(count, *getattr(models[0], name).shape)
        option = lambda name: np.array([getattr(m.opt, name) for m in models], float)
        mass, place, own = every("body_mass")[:, b], every("body_ipos")[:, b], every("body_inertia")[:, b]
        turn, shift = self.frames.turn[b], self.frames.shift[b]
        centre = shift + np.einsum("bij,mbj->mbi", turn, place)
        axes = np.einsum("bij,mbjk->mbik", turn, rotation(every("body_iquat")[:, b]))
        square = np.sum(centre**2, -1)[..., None, None] * np.eye(3) - centre[..., :, None] * centre[..., None, :]
        inertia = np.einsum("mbij,mbj,mbkj->mbik", axes, own, axes) + mass[..., None, None] * square
        table = np.zeros((count, GROUND["GROUND"] + n * OF_JOINT["JOINT"] + self.actuators * DRIVE))
        table[:, 0:3], table[:, 3:6], table[:, GROUND["STEP"]] = option("gravity"), option("wind"), option("timestep")
        owners = self.frames.owner[b]
        joint = table[:, GROUND["GROUND"] : GROUND["GROUND"] + n * OF_JOINT["JOINT"]].reshape(count, n, -1)
        joint[:, :, 0:3], joint[:, :, 3:12] = self.frames.place, self.frames.between.reshape(n, 9)
        six = inertia[..., [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        weighed = np.concatenate([mass[..., None], mass[..., None] * centre, six], -1)
        for k in range(n):
            joint[:, k, 12:22] = weighed[:, owners == k].sum(1)
        at = OF_JOINT
        joint[:, :, at["ZERO"]] = every("qpos0")
        joint[:, :, at["ARMATURE"]], joint[:, :, at["DAMPING"]] = every("dof_armature"), every("dof_damping")
        joint[:, :, at["DAMPING"] + 1 : at["DAMPING"] + 3] = every("dof_dampingpoly")
        joint[:, :, at["STIFF"]], joint[:, :, at["STIFF"] + 1] = every("jnt_stiffness"), every("qpos_spring")
        reference, impedance, weight = (every(f"dof_{name}") for name in ("solref", "solimp", "invweight0"))
        soft, back = _friction_constraint(reference, impedance, weight, option("timestep")[:, None])
        joint[:, :, at["RUB"]], joint[:, :, at["RUB"] + 1], joint[:, :, at["RUB"] + 2] = every("dof_frictionloss"), soft, back
        limited, ranges, margin = every("jnt_limited") > 0, every("jnt_range"), every("jnt_margin")
        joint[:, :, at["LOW"]] = np.where(limited, ranges[..., 0] + margin, -np.inf)
        joint[:, :, at["HIGH"]] = np.where(limited, ranges[..., 1] - margin, np.inf)
        if self.actuators:
            drive = table[:, GROUND["GROUND"] + n * at["JOINT"] :].reshape(count, self.actuators, DRIVE)
            affine = every("actuator_gaintype") == 1, every("actuator_biastype") == 1
            gain, bias = every("actuator_gainprm")[..., :3], every("actuator_biasprm")[..., :3] * affine[1][..., None]
            gain[..., 1:] *= affine[0][..., None]
            drive[..., 0], drive[..., 1:4], drive[..., 4:7] = every("actuator_gear")[..., 0], gain, bias
            for first, name in ((7, "ctrl"), (9, "force")):
                drive[..., first : first + 2] = _ranges(every(f"actuator_{name}range"), every(f"actuator_{name}limited"))
            most = _ranges(every("jnt_actfrcrange"), every("jnt_actfrclimited"))
            drive[..., 11:13] = most[:, self.driven]
        box = np.sqrt(np.maximum(TINY, own[..., [1, 0, 0]] + own[..., [2, 2, 1]] - own) / np.maximum(mass, TINY)[..., None] * 6.0)
        bodies = np.concatenate([box, centre, axes.reshape(count, len(b), 9)], -1)
        bodies[..., 0:3] *= (mass >= TINY)[..., None]
        return table, np.ascontiguousarray(bodies), np.stack([option("density"), option("viscosity")], 1), every("jnt_user")


class _Frames:
    """Frames of the links in a model's tree, at rest: origin on the joint, z along it.

    owner (nbody,): link of each body, -1 fixed. turn (nbody, 3, 3), shift (nbody, 3): its axes and origin in the link's frame.
    parent (J,), place (J, 3), between (J, 3, 3): of a link's frame in that of the link before.
    """

    def __init__(self, m: Any):
        self.owner = np.full(m.nbody, -1)
        self.turn, self.shift = np.tile(np.eye(3), (m.nbody, 1, 1)), np.zeros((m.nbody, 3))
        self.parent, self.place, self.between = np.full(m.njnt, -1), np.zeros((m.njnt, 3)), np.zeros((m.njnt, 3, 3))
        for b in range(1, m.nbody):
            above = m.body_parentid[b]
            link, turn = int(self.owner[above]), self.turn[above] @ rotation(m.body_quat[b])
            shift = self.shift[above] + self.turn[above] @ m.body_pos[b]
            for j in range(m.body_jntadr[b], m.body_jntadr[b] + m.body_jntnum[b]):
                own = _along(m.jnt_axis[j])  # axes of the link in the body's frame
                self.parent[j], self.between[j], self.place[j] = link, turn @ own, shift + turn @ m.jnt_pos[j]
                link, turn, shift = j, own.T, -own.T @ m.jnt_pos[j]
            self.owner[b], self.turn[b], self.shift[b] = link, turn, shift


def _along(axis: np.ndarray) -> np.ndarray:
    """(3, 3) axes, as columns, of a frame whose z is `axis`."""
    z = axis / np.linalg.norm(axis)
    x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], 1)


def rotation(quaternion: np.ndarray) -> np.ndarray:
    """(..., 3, 3) matrices of unit quaternions (..., 4)."""
    w, x, y, z = np.moveaxis(np.asarray(quaternion, float), -1, 0)
    rows = (
        (w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z),
    )
    return np.stack([np.stack(row, -1) for row in rows], -2)


def _ranges(ranges: np.ndarray, limited: np.ndarray) -> np.ndarray:
    """Ranges (.., 2), infinite where nothing is limited."""
    return np.where(limited[..., None] > 0, ranges, (-np.inf, np.inf))


def _friction_constraint(solref, solimp, weight, step) -> tuple[np.ndarray, np.ndarray]:
    """(M, J) R and the factor of the rate in the reference acceleration, of MuJoCo's constraints of dry friction."""
    least, most = (np.clip(solimp[..., k], *IMPEDANCE) for k in (0, 1))
    flat = (least == most) | (solimp[..., 2] <= TINY)
    impedance = np.where(flat, 0.5 * (least + most), least)
    back = 2.0 / np.maximum(TINY, most * np.maximum(solref[..., 0], 2.0 * step))
    back = np.where(solref[..., 0] > 0, back, -solref[..., 1] / np.maximum(TINY, most))
    return np.maximum(TINY, (1.0 - impedance) * weight / impedance), back


@cache
def _compiled() -> Any:
    """The function `roll` of robot_loops.py."""
    fields = joint_laws.FIXED
    numbers = ROWS | GROUND | OF_JOINT | dict(DRIVE=DRIVE, LANES=LANES, MEMORY=joint_laws.MEMORY * len(joint_laws.laws()))
    numbers |= dict(ACTIVE=fields.index("active"))
    head = HEADER[: HEADER.index("\ndef given")]
    parts = [joint_laws.acting_text(), head, *(f"{key} = {value}\n" for key, value in numbers.items()), f"WILD = {WILD}\n"]
    return numba_build.compiled("".join([*parts, fast_math.source(fast_math.DOUBLE), loops_text("robot_loops.py")])).roll
