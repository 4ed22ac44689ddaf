"""Writes effects that no field of MJCF holds into a readable Python module beside the description, which runs without fishmj."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import mujoco

from fishmj.effects.effect import LAW_MATH
from fishmj.effects.sites import JointMotion
from fishmj.gap.models import joint_laws

MODULE = '''"""Effects of {xml} that no field of MuJoCo holds: {names}. Written for MuJoCo {version} by fishmj gap apply.

    import mujoco, {stem}
    model = mujoco.MjModel.from_xml_path("{xml}")
    {stem}.install()                      # MuJoCo calls `passive` at each step from now on; time starts at 0
    t, c = {stem}.delivered(t, c, "{first}")   # commands of a joint's actuator as they arrive, from those sent

The mean of what is random is taken: late and lost commands.
"""

from math import {math}
from types import SimpleNamespace
from typing import NamedTuple

import mujoco
import numpy as np

MEMORY = {memory}  # numbers of a law at a joint, in userdata


{joint_motion}

{functions}

# joint: its number, torque of its actuator at rest [N m], inertia [kg m2], its laws: (place of its memory, law, parameters)
LAWS = {{
{laws}}}
# joint ("" = all) -> what happens to commands on their way: (function, parameters)
COMMANDS = [
{commands}]


def passive(m, d):
    """Adds the laws of all joints to a step: a torque, and to the limit of dry friction."""
    mujoco.mj_fwdActuation(m, d)
    for joint, limit, inertia, laws in LAWS.values():
        dof, place = m.jnt_dofadr[joint], m.jnt_qposadr[joint]
        row = np.count_nonzero(m.dof_frictionloss[:dof] > 0.0)  # MuJoCo's constraint of dry friction at this joint
        state = d.qpos[place], d.qvel[dof], d.qfrc_actuator[dof]
        motion = JointMotion(*state, limit, inertia, m.dof_armature[dof], m.dof_damping[dof], d.time, m.opt.timestep)
        for first, law, values in laws:
            torque, friction = law(motion, d.userdata[first : first + MEMORY], *values)
            d.qfrc_passive[dof] += torque
            d.efc_frictionloss[row] += friction


def install():
    """MuJoCo calls `passive` at each step of every model of this process; mujoco.set_mjcb_passive(None) ends it."""
    mujoco.set_mjcb_passive(passive)


def delivered(t, c, joint):
    """Stamps (T,) and commands (T,) of a joint's actuator as they arrive, from those sent."""
    for name, function, values in COMMANDS:
        if name in ("", joint):
            t, c = function(SimpleNamespace(**values), np.asarray(t, float), np.asarray(c, float))
    return t, c
'''


class BeyondFields(NamedTuple):
    """Effects that no field holds. laws: {joint: {effect: parameters}}; commands: (joint or "", effect, parameters)."""

    laws: dict[str, dict[str, tuple[float, ...]]]
    commands: list[tuple[str, Any, dict[str, float]]]

    @property
    def names(self) -> list[str]:
        """Names of the effects, each once."""
        return list(
            dict.fromkeys([*(name for mine in self.laws.values() for name in mine), *(e.name for _, e, _ in self.commands)])
        )


def module_text(xml: str, robot: Any, m: Any, beyond: BeyondFields, rest: Mapping[str, float]) -> str:
    """Text of the module. xml, m: name and model of the patched description. rest: usual torques, `joint_laws.limit_of`."""
    known = list(joint_laws.laws())
    texts = {name: joint_laws.text_of(name, joint_laws.laws()[name][0].law) for mine in beyond.laws.values() for name in mine}
    delivers = {effect.name: effect.robot.simulated or effect.robot.command for _, effect, _ in beyond.commands}
    texts |= {name: joint_laws.text_of(name, function) for name, function in delivers.items()}
    rows = []
    for j in robot.joints:
        if j.name in beyond.laws:
            limit = joint_laws.limit_of(m, j.actuator, j.joint, rest.get(j.name, 0.0))
            first = joint_laws.MEMORY * len(known) * j.joint
            mine = [f"({first + joint_laws.MEMORY * known.index(n)}, {n}, {v!r})" for n, v in beyond.laws[j.name].items()]
            rows.append(f"    {j.name!r}: ({j.joint}, {limit!r}, {float(m.dof_M0[j.dof])!r}, [{', '.join(mine)}]),\n")
    commands = [f"    ({site!r}, {effect.name}, {values!r}),\n" for site, effect, values in beyond.commands]
    fields = "\n".join(f"    {name}: float" for name in JointMotion._fields)
    return MODULE.format(
        xml=xml,
        stem=stem_of(xml),
        names=", ".join(beyond.names),
        version=mujoco.__version__,
        math=", ".join(LAW_MATH),
        memory=joint_laws.MEMORY,
        first=robot.site_of(0),
        joint_motion=f'class JointMotion(NamedTuple):\n    """{(JointMotion.__doc__ or "").strip()}"""\n\n{fields}\n',
        functions="\n\n".join(texts.values()),
        laws="".join(rows),
        commands="".join(commands),
    )


def stem_of(xml: str) -> str:
    """Name of the module of a description: arm.v2.xml -> arm_v2_effects."""
    words = "".join(c if c.isalnum() and c.isascii() else "_" for c in xml.rsplit(".", 1)[0])
    return f"{'_' if words[:1].isdigit() else ''}{words}_effects"
