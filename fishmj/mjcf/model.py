"""MuJoCo model of a robot description.

The head's body frame is the robot's reference point: x towards the nose, y left, z up. Every other link's frame sits at
its front hinge, axis z. Inertias are stated and shapes are only drawn: nothing collides, and MuJoCo's own fluid stays off.

    root = "planar"   slides x, y and hinge yaw:  q = (x, y, psi, j1 ..),  the same as the closed-form chain's
    root = "free"     a free joint in gravity; buoyancy comes with the water

Servo in MuJoCo's own terms:  torque = clip(kp (command - q) - kv w, +-T) - kb w.  The clipped part is a position actuator, kb w
is joint damping, integrated implicitly by the Euler integrator: the torque-speed line of a DC motor
(docs/decisions/decisions.md).
"""

import mujoco
import numpy as np

from fishmj.base.errors import ConfigError, UnknownName
from fishmj.base.units import WATER_DENSITY, WATER_VISCOSITY, G
from fishmj.mjcf import passive_slot
from fishmj.mjcf.description import Robot
from fishmj.mjcf.drawing import colour_of, fin_plates, loft
from fishmj.mjcf.geometry import Geometry, geometry_of
from fishmj.mjcf.reading import load_robot

ROOTS = ("planar", "free")
DYNAMIC_VISCOSITY = WATER_DENSITY * WATER_VISCOSITY  # Pa s
FIN_THICKNESS = 0.001  # m, drawn half-thickness
HIDDEN = 4  # MuJoCo geom group that viewers leave out
PLANAR_JOINTS = (
    ("x", mujoco.mjtJoint.mjJNT_SLIDE, (1, 0, 0)),
    ("y", mujoco.mjtJoint.mjJNT_SLIDE, (0, 1, 0)),
    ("yaw", mujoco.mjtJoint.mjJNT_HINGE, (0, 0, 1)),
)


def build(robot: "Robot | str" = "fish", root: str = "planar", *, bare: bool = False, ellipsoid: bool = False) -> mujoco.MjModel:
    """Compiles the MuJoCo model of `robot`.

    Args:
        robot: a description, a TOML path or a shipped name.
        root: "planar" (x, y, yaw) or "free".
        bare: leave out geoms and sites, which batched engines do not use.
        ellipsoid: give the links MuJoCo's own ellipsoid fluid instead of leaving the water to `fishmj.hydro_fit`.

    Raises:
        ConfigError: the description cannot be built.
        InjectionError: called inside this thread's `inject` block, where MuJoCo cannot compile. Another thread's block is
            awaited.
    """
    spec = build_spec(robot, root, bare=bare, ellipsoid=ellipsoid)
    try:
        return passive_slot.compiled(spec)
    except ValueError as error:  # what the checks of the description should have found; MuJoCo's words have several lines
        raise ConfigError(f"{spec.modelname}: MuJoCo cannot build this robot: {' '.join(str(error).split())[:200]}") from error


def mjcf_xml(robot: "Robot | str" = "fish", root: str = "planar") -> str:
    """MJCF text of the model of `build`."""
    return passive_slot.xml_of(build_spec(robot, root))


def build_spec(
    robot: "Robot | str" = "fish", root: str = "planar", *, bare: bool = False, ellipsoid: bool = False
) -> mujoco.MjSpec:
    """The editable `mujoco.MjSpec` behind `build`; same arguments and errors."""
    if root not in ROOTS:
        raise UnknownName("root", root, ROOTS)
    robot = load_robot(robot)
    geometry = geometry_of(robot)
    spec = mujoco.MjSpec()
    spec.modelname = robot.name
    _options(spec, robot, root, ellipsoid)
    parent = spec.worldbody
    for i, link in enumerate(robot.links):
        body = parent.add_body(name=link.name, pos=[geometry.joint[i - 1] if i else 0.0, 0, 0])
        body.mass, body.ipos, body.inertia = geometry.mass[i], geometry.com[i], geometry.inertia[i]
        body.explicitinertial = True
        if i == 0:
            _add_root(body, root)
        else:
            _add_servo(spec, body, robot, f"j{i}")
        if ellipsoid:
            _add_ellipsoid(body, geometry, i)
            body.gravcomp = 1.0  # buoyancy, which MuJoCo's fluid leaves out; no righting moment
        if not bare:
            _add_link(spec, body, robot, geometry, i)
        parent = body
    return spec


def _options(spec, robot: Robot, root: str, ellipsoid: bool) -> None:
    spec.option.timestep = robot.timing.physics_dt
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER  # implicit in joint damping, explicit in the rest
    spec.option.gravity = [0, 0, -G if root == "free" else 0.0]
    spec.option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT) | int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    if ellipsoid:
        spec.option.density, spec.option.viscosity = robot.density_water, DYNAMIC_VISCOSITY


def _add_root(body, root: str) -> None:
    if root == "free":
        body.add_freejoint(name="root")
        return
    for name, kind, axis in PLANAR_JOINTS:
        body.add_joint(name=name, type=kind, axis=axis)


def _add_servo(spec, body, robot: Robot, name: str) -> None:
    s = robot.servo
    joint = body.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1], damping=[s.kb, 0, 0])
    joint.limited = mujoco.mjtLimited.mjLIMITED_FALSE  # the command is clamped, as on the robot; see docs/decisions/decisions.md
    actuator = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    actuator.set_to_position(kp=s.kp, kv=s.kv)
    actuator.forcelimited = actuator.ctrllimited = mujoco.mjtLimited.mjLIMITED_TRUE
    actuator.forcerange = [-s.torque, s.torque]
    actuator.ctrlrange = [-s.range, s.range]


def _add_link(spec, body, robot: Robot, geometry: Geometry, i: int) -> None:
    """Adds the visible parts of link i to `body`: a lofted hull, side fins, named sites. Massless, without collisions."""
    link = robot.links[i]
    rear, front = geometry.span[i]
    vertices, faces = loft(robot, geometry, i)
    shell = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    spec.add_mesh(name=f"{link.name}_hull", uservert=vertices.ravel(), userface=faces.ravel(), inertia=shell)
    shape = {"contype": 0, "conaffinity": 0, "mass": 0.0, "rgba": [*colour_of(robot, i), 1.0]}
    body.add_geom(name=link.name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"{link.name}_hull", **shape)
    for fin in robot.fins:
        if fin.link == link.name:
            for (x, y, chord, span), side in zip(fin_plates(robot, geometry, fin), ("left", "right"), strict=False):
                size = [chord / 2, span / 2, FIN_THICKNESS]
                body.add_geom(name=f"{fin.name}_{side}", type=mujoco.mjtGeom.mjGEOM_BOX, pos=[x, y, 0], size=size, **shape)
    body.add_site(name=f"{link.name}_centre", pos=[(rear + front) / 2, 0, 0], size=[0.004] * 3)
    if i == 0:
        body.add_site(name="reference", pos=[0, 0, 0], size=[0.004] * 3)
        body.add_site(name="nose", pos=[front, 0, 0], size=[0.004] * 3)
    if i == geometry.n_links - 1:
        body.add_site(name="tail_tip", pos=[rear, 0, 0], size=[0.004] * 3)


def _add_ellipsoid(body, geometry: Geometry, i: int) -> None:
    """A hidden ellipsoid of the link's length, mean height and mean width that MuJoCo's own fluid model acts on."""
    rear, front = geometry.span[i]
    length = front - rear
    semi = [length / 2, geometry.strip_w[i].sum() / length / 2, geometry.strip_h[i].sum() / length / 2]
    unseen = {"contype": 0, "conaffinity": 0, "mass": 0.0, "group": HIDDEN, "rgba": [0, 0, 0, 0]}
    kind, middle = mujoco.mjtGeom.mjGEOM_ELLIPSOID, [(rear + front) / 2, 0, 0]
    body.add_geom(name=f"{body.name}_fluid", type=kind, pos=middle, size=semi, fluid_ellipsoid=1, **unseen)


def personalise(model: mujoco.MjModel, *, mass, kp, kv, kb, zero) -> None:
    """Writes one fish's own constants into its model.

    Args:
        mass: factor on mass and inertia of every link (N,).
        kp, kv, kb: servo gains (J,), N m/rad and N m s/rad.
        zero: hinge angle at which each encoder reads zero (J,), rad.
    """
    model.body_mass[1:] *= mass
    model.body_inertia[1:] *= np.asarray(mass, float)[:, None]
    model.actuator_gainprm[:, 0] = kp
    model.actuator_biasprm[:, :3] = np.stack([np.multiply(kp, zero), np.negative(kp), np.negative(kv)], -1)
    model.dof_damping[-model.nu :] = kb
    mujoco.mj_setConst(model, mujoco.MjData(model))


def reference_qpos(model: mujoco.MjModel, pose, joints) -> np.ndarray:
    """qpos (nq,) of a level fish at pose (x, y, yaw) [m, rad] with the given joint angles (J,) [rad], for either root."""
    x, y, yaw = pose
    if model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE:
        return np.array([x, y, 0.0, np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2), *joints])
    return np.array([x, y, yaw, *joints], float)


def reference_pose(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """(x, y, yaw, x', y', yaw') of the reference point in the tank frame [m, rad, m/s, rad/s], for either root."""
    if model.jnt_type[0] != mujoco.mjtJoint.mjJNT_FREE:
        return np.concatenate([data.qpos[:3], data.qvel[:3]])
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, data.qpos[3:7])
    yaw = np.arctan2(turn[3], turn[0])
    return np.array([data.qpos[0], data.qpos[1], yaw, data.qvel[0], data.qvel[1], turn[6:] @ data.qvel[3:6]])
