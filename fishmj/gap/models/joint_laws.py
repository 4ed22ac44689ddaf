"""Joint laws that no field of MuJoCo holds, as machine code that MuJoCo calls at each step.

    mjcb_passive -> law of each effect at each joint (fishmj/effects, `RobotForm.law`)
                 -> qfrc_passive += torque;  efc_frictionloss += limit of dry friction

numba compiles the laws into a C function, so rollouts keep all their threads and cost no more. A callback in Python would need
the interpreter's lock. The friction limit changes after the constraints are made and before they are solved, so MuJoCo's own
implicit dry friction uses it. The solver must not copy the constraints, so islands are off.

The function reads its parameters from `jnt_user`, WIDTH numbers for each joint; its memory is in `userdata`. The layout of the C
structures mjModel and mjData depends on the version; `_offset` finds an array in them by its address.
"""

import ctypes
import inspect
import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from typing import Any

import mujoco
import numpy as np

from fishmj import effects
from fishmj.base.errors import ConfigError
from fishmj.effects.effect import LAW_MATH
from fishmj.engines import numba_build

LEAST_FRICTION = 1e-6  # N m: without friction MuJoCo makes no constraint, and there is no limit to change
MEMORY = 4  # numbers of each law at each joint
FIXED = (
    *("joints", "active", "dof", "place", "actuator", "row", "gain0", "gain1", "gain2", "bias0", "bias1", "bias2", "gear"),
    *("command_low", "command_high", "force_low", "force_high", "drive_low", "drive_high"),
    *("limit", "inertia", "armature", "damping", "step"),
)  # columns of jnt_user before the parameters of the laws
FOUND = ("qpos", "qvel", "ctrl", "userdata", "qfrc_passive", "efc_frictionloss")  # arrays of mjData

CALLBACK = """
{names} = range({count})
JOINTS, WORDS = 64, 1 << 20


@intrinsic
def pointer(typing, address):
    return types.voidptr(types.int64), lambda context, builder, signature, given: builder.inttoptr(given[0], cgutils.voidptr_t)


@cfunc(types.void(types.voidptr, types.voidptr), cache=CACHE, error_model="numpy")
def passive(model, data):
    table = carray(pointer(carray(model, WORDS, np.int64)[{jnt_user}]), (JOINTS, {width}), np.float64)
    words, time = carray(data, WORDS, np.int64), carray(data, WORDS, np.float64)[{time}]
    qpos, qvel = carray(pointer(words[{qpos}]), WORDS, np.float64), carray(pointer(words[{qvel}]), WORDS, np.float64)
    ctrl, kept = carray(pointer(words[{ctrl}]), WORDS, np.float64), carray(pointer(words[{userdata}]), WORDS, np.float64)
    force = carray(pointer(words[{qfrc_passive}]), WORDS, np.float64)
    friction = carray(pointer(words[{efc_frictionloss}]), WORDS, np.float64)
    for j in range(int(table[0, joints])):
        p = table[j]
        if p[active] == 0.0:
            continue
        q, w, drive = qpos[int(p[place])], qvel[int(p[dof])], 0.0
        if p[actuator] >= 0.0:
            u = min(max(ctrl[int(p[actuator])], p[command_low]), p[command_high])
            length, velocity = p[gear] * q, p[gear] * w
            drive = (p[gain0] + p[gain1] * length + p[gain2] * velocity) * u
            drive += p[bias0] + p[bias1] * length + p[bias2] * velocity
            drive = min(max(p[gear] * min(max(drive, p[force_low]), p[force_high]), p[drive_low]), p[drive_high])
        torque, most = act(p, q, w, drive, time, kept[{memory} * j : {memory} * (j + 1)])
        force[int(p[dof])] += torque
        friction[int(p[row])] += most
"""


@cache
def laws() -> dict[str, tuple[Any, int]]:
    """{effect: (its form, first column of its parameters in jnt_user)}."""
    found, column = {}, len(FIXED)
    for effect in effects.robot_catalogue().values():
        if effect.robot is not None and effect.robot.law is not None:
            found[effect.name] = effect.robot, column
            column += len(effect.robot.parameters)
    return found


def width() -> int:
    """Numbers of a row of jnt_user."""
    return len(FIXED) + sum(len(form.parameters) for form, _ in laws().values())


def remembered(joints: int) -> int:
    """Numbers of userdata for all laws at each of `joints` joints."""
    return joints * MEMORY * len(laws())


def text_of(name: str, function: Any) -> str:
    """Source text of the function of an effect, under the effect's name."""
    return inspect.getsource(function).replace(f"def {function.__name__}(", f"def {name}(", 1)


def drive_of(m: Any, actuator: int, joint: int) -> dict[str, float] | None:
    """Columns that define the torque of a joint's actuator; None if it is not affine in command, position and rate."""
    wide = (-np.inf, np.inf)
    out = dict(zip(("drive_low", "drive_high"), m.jnt_actfrcrange[joint] if m.jnt_actfrclimited[joint] else wide, strict=True))
    if actuator < 0:
        return out | {"actuator": -1.0}
    affine = int(mujoco.mjtGain.mjGAIN_AFFINE), int(mujoco.mjtBias.mjBIAS_AFFINE)
    if m.actuator_gaintype[actuator] > affine[0] or m.actuator_biastype[actuator] > affine[1]:
        return None
    gain, bias = np.array(m.actuator_gainprm[actuator, :3]), np.array(m.actuator_biasprm[actuator, :3])
    gain[1:] *= m.actuator_gaintype[actuator] == affine[0]
    bias *= m.actuator_biastype[actuator] == affine[1]
    commands = m.actuator_ctrlrange[actuator] if m.actuator_ctrllimited[actuator] else wide
    forces = m.actuator_forcerange[actuator] if m.actuator_forcelimited[actuator] else wide
    out |= {"actuator": float(actuator), "gear": float(m.actuator_gear[actuator, 0])}
    out |= {f"gain{i}": x for i, x in enumerate(gain)} | {f"bias{i}": x for i, x in enumerate(bias)}
    out |= dict(zip(("command_low", "command_high"), commands, strict=True))
    return out | dict(zip(("force_low", "force_high"), forces, strict=True))


def limit_of(m: Any, actuator: int, joint: int, otherwise: float) -> float:
    """Stall torque of a joint's actuator, N m, if the description states it; else `otherwise`."""
    stated = []
    if actuator >= 0:
        gear, bias = abs(m.actuator_gear[actuator, 0]), m.actuator_biasprm[actuator, 1:3]
        if m.actuator_forcelimited[actuator]:
            stated.append(gear * np.abs(m.actuator_forcerange[actuator]).max())
        if m.actuator_ctrllimited[actuator] and not bias.any():
            stated.append(gear * abs(m.actuator_gainprm[actuator, 0]) * np.abs(m.actuator_ctrlrange[actuator]).max())
    if m.jnt_actfrclimited[joint]:
        stated.append(np.abs(m.jnt_actfrcrange[joint]).max())
    return float(min(stated)) if stated else otherwise


def write(m: Any, joints: Sequence[Any], present: dict[str, dict[str, tuple[float, ...]]], rest: Sequence[float]) -> None:
    """Writes laws into a model.

    joints: RobotJoint of each. present: {joint: {effect: parameters}}. rest: N m, torque of each joint's actuator at rest where
    the description states none. A joint with a law gets a constraint of dry friction.
    """
    m.jnt_user[:] = 0.0
    for joint, torque in zip(joints, rest, strict=True):
        if joint.name in present:
            row = m.jnt_user[joint.joint]
            given = {"active": 1.0, "dof": joint.dof, "place": joint.place, "step": m.opt.timestep}
            given |= {"damping": m.dof_damping[joint.dof], "armature": m.dof_armature[joint.dof]}
            given |= {"limit": limit_of(m, joint.actuator, joint.joint, torque), "inertia": m.dof_M0[joint.dof]}
            for name, value in ((drive_of(m, joint.actuator, joint.joint) or {}) | given).items():
                row[FIXED.index(name)] = value
            for name, values in present[joint.name].items():
                first = laws()[name][1]
                row[first : first + len(values)] = values
    ready(m, [joint.dof for joint in joints if joint.name in present])
    for joint in joints:
        before = np.count_nonzero(m.dof_frictionloss[: joint.dof] > 0.0)  # one constraint each, in this order
        m.jnt_user[joint.joint, FIXED.index("row")] = before
    m.jnt_user[:, FIXED.index("joints")] = m.njnt  # the first row is read, that of a free base if there is one


def ready(m: Any, dofs: Sequence[int]) -> None:
    """Prepares MuJoCo for laws: a constraint of dry friction at their joints, solved in place."""
    off = mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS
    m.opt.disableflags = m.opt.disableflags & ~int(off) | int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
    for dof in dofs:
        m.dof_frictionloss[dof] = max(m.dof_frictionloss[dof], LEAST_FRICTION)


@contextmanager
def acting(wanted: bool) -> Iterator[None]:
    """Context in which MuJoCo calls the laws, for models with this module's jnt_user. No other thread may step another model."""
    if not wanted:
        yield
        return
    before = mujoco.get_mjcb_passive()
    mujoco.set_mjcb_passive(_compiled().ctypes)
    try:
        yield
    finally:
        mujoco.set_mjcb_passive(before)


@contextmanager
def no_warnings() -> Iterator[None]:
    """Context without MuJoCo's warnings and MUJOCO_LOG.TXT about diverged rollouts, which the caller detects itself."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda text: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


def acting_text() -> str:
    """Source of the laws as numba functions, and of `act`, which sums their torques and dry friction limits at a joint.

    act(p, q, w, drive, time, memory): p: the joint's row of jnt_user; drive: torque of its actuator, N m.
    """
    at = FIXED.index
    parts = [
        f"from math import {', '.join(LAW_MATH)}\n\nfrom numba import njit\n\nfrom fishmj.effects.sites import JointMotion\n\n"
    ]
    given = ", ".join(f"p[{at(name)}]" for name in ("limit", "inertia", "armature", "damping"))
    act = ["@njit(error_model='numpy')", "def act(p, q, w, drive, time, memory):"]
    act += [f"    joint, added, friction = JointMotion(q, w, drive, {given}, time, p[{at('step')}]), 0.0, 0.0"]
    for i, (name, (form, first)) in enumerate(laws().items()):
        parts.append("@njit(error_model='numpy')\n" + text_of(name, form.law))
        causes = " or ".join(f"p[{first + k}] != 0.0" for k, p in enumerate(form.parameters) if not p.shape)
        values = ", ".join(f"p[{first + k}]" for k in range(len(form.parameters)))
        act += [f"    if {causes}:", f"        torque, most = {name}(joint, memory[{MEMORY * i} : {MEMORY * (i + 1)}], {values})"]
        act += ["        added, friction = added + torque, friction + most"]
    return "\n\n".join(parts) + "\n\n" + "\n".join([*act, "    return added, friction"]) + "\n\n"


@cache
def _compiled() -> Any:
    """The C function."""
    header = ["import numpy as np", "from numba import carray, cfunc, types"]
    header += ["from numba.core import cgutils", "from numba.extending import intrinsic", "", ""]
    places = {name: at // 8 for name, at in _offsets().items()}
    memory = MEMORY * len(laws())
    body = CALLBACK.format(names=", ".join(FIXED), count=len(FIXED), width=width(), memory=memory, **places)
    return numba_build.compiled("\n".join(header) + acting_text() + body).passive


@cache
def _offsets() -> dict[str, int]:
    """Bytes from the start of mjModel or mjData to the address of an array, and to the time."""
    spec = mujoco.MjSpec()
    spec.nuserdata, spec.nuser_jnt = 1, 1
    body = spec.worldbody.add_body(mass=1.0, inertia=[1.0, 1.0, 1.0])
    joint = body.add_joint(name="j", type=mujoco.mjtJoint.mjJNT_HINGE, frictionloss=1.0)
    spec.add_actuator(name="a", target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    m = spec.compile()
    d = mujoco.MjData(m)
    mujoco.mj_forward(m, d)
    d.time = 1.234567890123e-7
    out = {name: _offset(d, getattr(d, name).ctypes.data) for name in FOUND}
    out["time"] = _offset(d, struct.unpack("q", struct.pack("d", d.time))[0])
    return out | {"jnt_user": _offset(m, m.jnt_user.ctypes.data)}


def _offset(owner: Any, word: int) -> int:
    """Place of a word in the C structure behind an object of MuJoCo, bytes."""
    for at in range(0, 1 << 18, 8):
        if ctypes.c_int64.from_address(owner._address + at).value == word:
            return at
    raise ConfigError(
        f"MuJoCo {mujoco.__version__}: array not found in {type(owner).__name__}; install the MuJoCo version of pyproject.toml"
    )
