"""A robot described in MJCF or URDF: its joints, actuators and moving bodies, and the checks that the search supports it.

    robot = read_robot(Path("robot.xml"))       robot.model: MjModel without contacts and without the delays of actuators
    robot.site(model, "joint", "elbow")         place of an effect
    robot.channels                              what a log holds: coordinates of a free base (records/attitude.py), then joints

A URDF has no actuators: each joint with a limit of effort gets a motor of that torque, under the joint's name.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from fishmj.base.errors import ConfigError, LogError, MissingExtra
from fishmj.gap.models import joint_laws
from fishmj.gap.records.attitude import COORDINATES, quaternion_rate, turned

MOST_JOINTS = 12
CONTACTS = 0.05  # share of the logged states in which bodies may touch
CENTRED = 0.02  # m
MENAGERIE = "menagerie:"  # before the name of a robot of the package mujoco-menagerie
SUFFIXES = (".xml", ".mjcf", ".urdf")
FREE = int(mujoco.mjtJoint.mjJNT_FREE)


class RobotJoint(NamedTuple):
    """One hinge or slide. actuator: its number, -1 without one."""

    name: str
    joint: int
    dof: int
    place: int  # in qpos
    body: int
    actuator: int


class RobotSite(NamedTuple):
    """Place of an effect: numbers into the arrays of a model, -1 where there is no such part."""

    m: Any  # mujoco.MjModel
    joint: int = -1
    dof: int = -1
    actuator: int = -1
    body: int = -1
    gear: float = 1.0  # force of a thruster, or torque at a joint, for a unit of the actuator's
    thrusters: tuple[int, ...] = ()  # all actuators on sites


class FreeBase(NamedTuple):
    """A root body that floats: its number, and the first of its numbers in qvel and in qpos."""

    body: int
    dof: int
    place: int


@dataclass(frozen=True, eq=False)
class RobotDescription:
    """A robot. delays: (nu,) s of its actuators, which the search applies to the commands itself. notes: what was assumed.

    joints: hinges and slides. base: None if it is fixed. thrusters: name -> number of each actuator on a site.
    """

    path: Path
    spec: Any  # mujoco.MjSpec, as read
    model: Any  # mujoco.MjModel
    joints: tuple[RobotJoint, ...]
    actuators: tuple[str, ...]
    delays: np.ndarray
    notes: tuple[str, ...] = ()
    base: FreeBase | None = None
    thrusters: Mapping[str, int] = field(default_factory=dict)

    @property
    def dt(self) -> float:
        """Time step of the model, s."""
        return float(self.model.opt.timestep)

    @property
    def bodies(self) -> dict[str, int]:
        """Name -> number of each moving body with a mass."""
        m = self.model
        moving = [b for b in range(1, m.nbody) if m.body_weldid[b] != 0 and m.body_mass[b] > 0]
        return {name_of(m, "body", b): b for b in moving}

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the coordinates in a log: of a free base, then of the joints."""
        return (*(COORDINATES if self.base else ()), *self.sites("joint"))

    def force_unit(self, channel: str) -> str:
        """Unit of the force along a channel."""
        slides = [j.name for j in self.joints if self.model.jnt_type[j.joint] == mujoco.mjtJoint.mjJNT_SLIDE]
        return "N" if channel in (*(COORDINATES[:3] if self.base else ()), *slides) else "N m"

    @property
    def dofs(self) -> list[int]:
        """Place of each channel in qvel."""
        own = [j.dof for j in self.joints]
        return [*range(self.base.dof, self.base.dof + 6), *own] if self.base else own

    def qpos(self, angles: np.ndarray, turns: np.ndarray) -> np.ndarray:
        """(.., nq) state of angles (.., C) by channel. turns: (.., 4) attitude of a free base, from which its angles count."""
        out = np.zeros((*angles.shape[:-1], self.model.nq))
        if self.base is None:
            out[..., [j.place for j in self.joints]] = angles
            return out
        first = self.base.place
        out[..., first : first + 3] = angles[..., :3]
        out[..., first + 3 : first + 7] = turned(turns, angles[..., 3:6])
        out[..., [j.place for j in self.joints]] = angles[..., 6:]
        return out

    def motion(self, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coordinates of MuJoCo's states (.., S) and their rates: of a free base its place and quaternion, then of the joints."""
        m, base = self.model, self.base
        q, v = state[..., [1 + j.place for j in self.joints]], state[..., [1 + m.nq + j.dof for j in self.joints]]
        if base is None:
            return q, v
        pose, move = state[..., 1 + base.place :][..., :7], state[..., 1 + m.nq + base.dof :][..., :6]
        rate = np.concatenate([move[..., :3], quaternion_rate(pose[..., 3:], move[..., 3:])], -1)
        return np.concatenate([pose, q], -1), np.concatenate([rate, v], -1)

    def check_contact(self, records: Sequence[Any]) -> None:
        """Raises LogError if bodies touch at more than a few starts of the segments of records: contacts are left out."""
        m = self.spec.copy().compile()
        d = mujoco.MjData(m)
        touching = []
        for qpos in np.concatenate([self.qpos(record.angles, record.start_turns) for record in records]):
            d.qpos[:] = qpos
            mujoco.mj_fwdPosition(m, d)
            touching.append(any(c.dist < 0.0 and not neighbours(m, *c.geom) for c in d.contact))
        if np.mean(touching) > CONTACTS:
            often = f"bodies of {self.path.name} touch in {100 * np.mean(touching):.0f} % of the logged states"
            raise LogError(f"{often}, but the search ignores contacts; record free motion, or correct the geoms")

    def takes_laws(self, joint: str) -> bool:
        """Returns True if the torque of a joint's actuator is affine, so that a law can know it."""
        return any(j.name == joint and joint_laws.drive_of(self.model, j.actuator, j.joint) is not None for j in self.joints)

    def is_centred(self, body: str) -> bool:
        """Returns True for a free base whose centre of mass is at its frame."""
        at = self.bodies.get(body, -1)
        near = float(np.linalg.norm(self.model.body_ipos[at])) < CENTRED
        return self.base is not None and at == self.base.body and near

    def site_of(self, actuator: int) -> str:
        """Name of an actuator's site."""
        return next((j.name for j in self.joints if j.actuator == actuator), self.actuators[actuator])

    def sites(self, kind: str) -> tuple[str, ...]:
        """Names of the sites of a kind: joint, actuator (under its joint's name, or as a thruster its own), body, or the others.

        The base is no site where it floats; thrusters are one site where there are any.
        """
        if kind == "joint":
            return tuple(j.name for j in self.joints)
        if kind == "actuator":
            return (*(j.name for j in self.joints if j.actuator >= 0), *self.thrusters)
        absent = (kind == "base" and self.base is not None) or (kind == "thrusters" and not self.thrusters)
        return tuple(self.bodies) if kind == "body" else () if absent else ("",)

    def site(self, model: Any, kind: str, name: str) -> RobotSite:
        """One site in a copy of the model."""
        if kind == "actuator" and name in self.thrusters:
            a = self.thrusters[name]
            return RobotSite(model, actuator=a, gear=thrust_of(model, a))
        if kind in ("joint", "actuator"):
            j = next(j for j in self.joints if j.name == name)
            gear = float(model.actuator_gear[j.actuator, 0]) if j.actuator >= 0 else 1.0
            return RobotSite(model, j.joint, j.dof, j.actuator, j.body, gear)
        body = self.bodies[name] if kind == "body" else -1
        return RobotSite(model, body=body, thrusters=tuple(self.thrusters.values()))


def thrust_of(m: Any, actuator: int) -> float:
    """Force of an actuator on a site for a unit of its own, N; torque [N m] of one that only turns."""
    force, torque = np.split(m.actuator_gear[actuator], 2)
    return float(np.linalg.norm(force) or np.linalg.norm(torque))


def neighbours(m: Any, one: int, other: int) -> bool:
    """Returns True for geoms of a body and its parent, which MuJoCo itself leaves out unless the parent is fixed to the world."""
    a, b = (int(m.geom_bodyid[geom]) for geom in (one, other))
    above = lambda body: int(m.body_parentid[m.body_weldid[body]])
    return a == b or above(a) == b != 0 or above(b) == a != 0


def is_robot(model: object) -> bool:
    """Returns True if a model is a file in MJCF or URDF by its name, or `menagerie:NAME`."""
    return str(model).startswith(MENAGERIE) or Path(str(model)).suffix.lower() in SUFFIXES


def robot_file(model: object) -> Path:
    """The file of a robot: a path, or `menagerie:NAME`, which is downloaded at its first use.

    Raises MissingExtra: the package mujoco-menagerie is absent; ConfigError: no such robot or file, or no download.
    """
    name = str(model)
    if not name.startswith(MENAGERIE):
        if not Path(name).is_file():
            raise ConfigError(f"{name}: no such file; expected a robot in MJCF or URDF, or {MENAGERIE}NAME")
        return Path(name)
    try:
        import mujoco_menagerie as menagerie
    except ImportError as error:
        raise MissingExtra("mujoco-menagerie", "menagerie", name) from error
    try:
        robot = menagerie.get(name.removeprefix(MENAGERIE))
        return Path(robot.path()) / robot.entry(robot.default_model).file
    except (menagerie.MenagerieError, OSError) as error:
        why = " ".join(str(error).split()).rstrip(".")
        raise ConfigError(f"{name}: {why}; `mujoco-menagerie names` lists the robots") from error


def name_of(m, kind: str, number: int) -> str:
    """Name of a joint, actuator or body, or its kind and number without one."""
    obj = {"joint": mujoco.mjtObj.mjOBJ_JOINT, "actuator": mujoco.mjtObj.mjOBJ_ACTUATOR, "body": mujoco.mjtObj.mjOBJ_BODY}[kind]
    return (mujoco.mj_id2name(m, obj, number) or f"{kind}{number + 1}").replace("+", "_").replace("@", "_")


def read_robot(path: Path) -> RobotDescription:
    """Reads a description.

    Raises ConfigError: not a model, or one that the search does not support; the message says what would work.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        raw = spec.copy().compile()
    except (ValueError, OSError, mujoco.FatalError) as error:
        raise ConfigError(f"{path}: MuJoCo cannot compile it as MJCF or URDF: {' '.join(str(error).split())[:200]}") from error
    notes = []
    working = spec.copy()
    if raw.nu == 0 and path.suffix.lower() == ".urdf":
        notes.append(f"{path.name} has no actuators: each joint gets a motor, in N m")
        for made in (spec, working):
            for joint in made.joints:
                motor = made.add_actuator(name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
                motor.set_to_motor()
        raw = spec.copy().compile()
    _searchable(raw, path)
    delays = np.array(raw.actuator_delay, float)
    for actuator in working.actuators:
        actuator.delay, actuator.nsample = 0.0, 0
    for joint in working.joints:
        joint.userdata = []
    for body in working.bodies[1:]:
        body.simple = 0  # a body with its centre at its frame may get another
    working.nuser_jnt, working.nuserdata = joint_laws.width(), joint_laws.remembered(len(working.joints))
    m = working.compile()
    m.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT) | int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
    on_site = [m.actuator_trntype[a] == int(mujoco.mjtTrn.mjTRN_SITE) for a in range(m.nu)]
    of_joint = {int(m.actuator_trnid[a, 0]): a for a in range(m.nu) if not on_site[a]}
    dofs, places, bodies = m.jnt_dofadr.tolist(), m.jnt_qposadr.tolist(), m.jnt_bodyid.tolist()
    joints = tuple(
        RobotJoint(name_of(m, "joint", j), j, dofs[j], places[j], bodies[j], of_joint.get(j, -1))
        for j in range(m.njnt)
        if m.jnt_type[j] != FREE
    )
    names = tuple(name_of(m, "actuator", a) for a in range(m.nu))
    base = next((FreeBase(bodies[j], dofs[j], places[j]) for j in range(m.njnt) if m.jnt_type[j] == FREE), None)
    thrusters = {names[a]: a for a in range(m.nu) if on_site[a]}
    if base:
        notes.append(f"the base of {path.name} floats: its tilt, contacts and the free joint's friction are not searched")
    if twice := {j.name for j in joints} & {*thrusters, *(COORDINATES if base else ())}:
        what = "used for a joint and for a thruster or a base coordinate; rename the joint"
        raise ConfigError(f"{path}: the name {min(twice)}: {what}")
    return RobotDescription(path, spec, m, joints, names, delays, tuple(notes), base, thrusters)


def _searchable(m, path: Path) -> None:
    """Raises ConfigError for a model that the search does not support."""
    hinged = [int(kind) for kind in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)]
    joint_driven = [int(kind) for kind in (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)]
    count = len(m.actuator_trntype)  # nu counts inputs: a <pid> may have two
    on_site = [a for a in range(count) if m.actuator_trntype[a] == int(mujoco.mjtTrn.mjTRN_SITE)]
    driven = [int(m.actuator_trnid[a, 0]) for a in range(count) if m.actuator_trntype[a] in joint_driven]
    pulled = [a for a in range(count) if m.actuator_trntype[a] == int(mujoco.mjtTrn.mjTRN_TENDON)]
    free = [j for j in range(m.njnt) if m.jnt_type[j] == FREE]
    others = [j for j in range(m.njnt) if m.jnt_type[j] not in (*hinged, FREE)]
    moving = m.njnt - len(free)
    faults = {
        "no joint moves": m.njnt == 0 and "a robot of one to twelve hinges or slides, or a free base, would work",
        f"{moving} joints": moving > MOST_JOINTS and f"at most {MOST_JOINTS} would work: weld the others at their logged angle",
        "a ball joint": bool(others) and "three hinges would work",
        f"{len(free)} free joints": len(free) > 1 and "one would work: leave the other bodies out",
        "tendons that an actuator drives": bool(pulled) and "actuators that drive joints would work",
        "passive tendons": m.ntendon > 0 and not pulled and "stiffness and damping of the joints in their place would work",
        "equality constraints": m.neq > 0 and "an open chain would work: cut the loop, or weld what does not move",
        "no actuator": m.nu == 0 and "a motor or position actuator for each commanded joint would work",
        "an actuator with two inputs": count != m.nu and "one whose only input is the logged command would work",
        "an actuator on the free joint": bool(set(driven) & set(free)) and "an actuator on a site of the base would work",
        "an actuator that drives no joint": len(driven) + len(on_site) != count and "actuators on joints or sites would work",
        "an actuator between two sites": any(m.actuator_trnid[a, 1] >= 0 for a in on_site) and "one without refsite would work",
        "several actuators on one joint": len(set(driven)) != len(driven) and "one a joint would work",
        "an actuator with a state of its own": m.na > 0 and "motor, position, velocity or affine general actuators would work",
    }
    found = [f"{what}; {instead}" for what, instead in faults.items() if instead]
    if found:
        raise ConfigError(f"{path}: the search does not support this robot: {found[0]}")
