"""The solid side: a MuJoCo model that yields the joint-space equation of one step, and takes the velocity found for it.

    (M + dt D + K) v+ = (M + dt D) v + dt (passive + actuators - bias) - b0 + I            K, b0: the water (kernels.py)
    I = sum_l J_l^T (h_l^n - h_l^n-1) - dt sum_l J_l^T m_l g,   h_l = (m_l u_l, I_l w_l)      the water inside the hull

D is joint damping (the servo's back-EMF), which MuJoCo's Euler integrator takes implicitly. h_l is the momentum that the
displaced water of link l has when it moves with the link across it, and along it as is measured (kernels.py), m_l its mass, u_l
the velocity of its centre: the immersed boundary accelerates that water too, which a real hull does not contain. Taken as a
difference in the world frame it holds the Coriolis part M_f a + c_f by itself, and its sum over the links telescopes, so that
momentum is conserved. I lags by one step, along the links by two: the implicit solve stays stable with it down to a density
ratio of 0.01 (docs/methods/oracle_coupling.md).

The velocity goes back as   qfrc_applied = (M + dt D) (v+ - v) / dt - (passive + actuators - bias),
so that MuJoCo's own step returns v+ exactly. Contacts and joint limits are off in fishmj's models.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from fishmj.errors import ConfigError, SimDiverged
from fishmj.lbm_oracle.immersed import link_dynamics
from fishmj.lbm_oracle.immersed.kernels import Points
from fishmj.lbm_oracle.immersed.link_dynamics import Corners
from fishmj.mjcf import build, geometry_of, load_robot, passive_slot

RUNAWAY = 1e3  # m/s or rad/s: no step of MuJoCo from there
EXACT = 1e-9  # MuJoCo's velocity against the one found, relative to 1 + |v|


@dataclass(frozen=True, kw_only=True)
class DisplacedWater:
    """Displaced water of L links, in their body frames."""

    mass: np.ndarray  # (L,) kg
    centre: np.ndarray  # (L, 3) m
    inertia: np.ndarray  # (L, 3, 3) about the centre, kg m2
    points: Points | None = None  # where it may slide along the links; None: it moves with them

    @classmethod
    def of(cls, robot) -> "DisplacedWater":
        """The sections of a fish, full of water: the geometry's inertia scaled to the displaced mass."""
        g = geometry_of(robot)
        share = g.displaced / g.mass
        zero = 0 * g.buoyancy
        return cls(
            mass=g.displaced,
            centre=np.stack([g.buoyancy, zero, zero], -1),
            inertia=np.stack([np.diag(i) for i in g.inertia * share[:, None]]),
            points=Points.of(g),
        )


class ImmersedBody:
    """One articulated body: every moving MuJoCo body is a link, numbered as in the model.

    Args:
        model: constraints off, Euler integrator, one hinge about z per link behind the first (for markers that bend).
        water: displaced water of each link.
        dt: step of the fluid, s; becomes the model's own.
    """

    def __init__(self, model: mujoco.MjModel, water: DisplacedWater, dt: float):
        self.model, self.data, self.water = model, mujoco.MjData(model), water
        self.links, self.dofs = model.nbody - 1, model.nv
        if len(water.mass) != self.links:
            raise ConfigError(f"body: {self.links} moving bodies in the model, displaced water for {len(water.mass)}")
        n, count = self.dofs, self.links
        self.reach = np.array([[_moves(model, i + 1, d) for d in range(n)] for i in range(count)], float)
        self.slides = np.array([_slides(model, d) for d in range(n)], np.int32)
        self.applied = np.zeros(n)  # a push from outside, generalised, N or N m
        self.pose = np.zeros(13 * count + 6 * n)  # frames, hinge angles, axes and anchors: what the markers follow
        self.turn = self.data.xmat[1:].reshape(-1, 3, 3)  # a view
        self.centre, self.twist = np.zeros((count, 3)), np.zeros((count, 6))  # of the interior water, in the world
        self.system, self._right = np.zeros((n, n)), np.zeros(n)
        self.smooth, self.gain = np.zeros(n), np.zeros((count, 6))
        self.interior_speed = np.full(count, np.nan)  # m/s, of the interior water along each link; nan: it moves with the link
        self._now, self._weight = np.zeros((count, 6)), np.zeros((count, 6))
        self.momentum = np.zeros((count, 6))  # of the interior water at the end of the step before; written in place
        self.impulse, self._target, self._dt, self._check = np.zeros(n), np.zeros(n), np.zeros(1), np.zeros(2)
        self._moving, self._move = self._follow(water, centre=self.centre, twist=self.twist, now=self._now)
        plain, whole = self._equations(0), self._equations(1)  # without and with the water's gain
        self._balance = [link_dynamics.Recorded(link_dynamics.assemble, e) for e in (plain, whole)]
        self._inverse_force, self._compare = (
            link_dynamics.Recorded(kernel, whole) for kernel in (link_dynamics.inverse_force, link_dynamics.compare)
        )
        self._boxes: tuple | None = None
        self.set_step(dt)
        self.forward()
        self.momentum[:] = self._now

    @classmethod
    def of(cls, robot="fish", root: str = "planar", dt: float = 0.004) -> "ImmersedBody":
        """The fish of a description, at rest and straight at the origin."""
        robot = load_robot(robot)
        return cls(build(robot, root, bare=True), DisplacedWater.of(robot), dt)

    @classmethod
    def on_slides(cls, axes: str, mass: float, inertia, displaced: float, inertia_displaced, dt: float) -> "ImmersedBody":
        """The smallest body: one link on slides along some of `xyz`, no gravity. Masses kg, moments of inertia (3,) kg m2."""
        spec = mujoco.MjSpec()
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
        spec.option.gravity = [0, 0, 0]
        link = spec.worldbody.add_body(name="body")
        link.mass, link.inertia, link.ipos, link.explicitinertial = mass, inertia, [0, 0, 0], True
        for name in axes:
            link.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_SLIDE, axis=np.eye(3)["xyz".index(name)])
        inside = np.diag(inertia_displaced)[None]
        water = DisplacedWater(mass=np.array([displaced]), centre=np.zeros((1, 3)), inertia=inside)
        return cls(passive_slot.compiled(spec), water, dt)

    def set_step(self, dt: float) -> None:
        """Change the time step, s."""
        self.dt = self.model.opt.timestep = self._dt[0] = float(dt)
        self._weigh()

    def place(self, qpos, qvel=None, interior_speed=np.nan) -> None:
        """Put the body into a state; its water moves with it, along the links at `interior_speed` (L,) m/s, and gains nothing."""
        self.data.qpos[:] = qpos
        self.data.qvel[:] = 0.0 if qvel is None else qvel
        self.interior_speed[:] = interior_speed
        self._weigh()
        self.forward()
        self.momentum[:] = self._now

    def set_interior_speed(self, speed: np.ndarray) -> None:
        """How fast the interior water moves along the links, (L,) m/s; from the second time on its gain counts."""
        if np.isnan(self.interior_speed[0]):
            # the first figure is a state, not a change: without this the water would seem to have sped up within one step
            axis = self.turn[:, :, 0]
            self.momentum[:, :3] += (self.water.mass * speed - np.sum(axis * self.momentum[:, :3], 1))[:, None] * axis
        self.interior_speed[:] = speed

    def _weigh(self) -> None:
        """Impulse (L, 6) of the displaced water's weight over a step."""
        self._weight[:, :3] = self.dt * self.water.mass[:, None] * self.model.opt.gravity

    def forward(self) -> None:
        """Everything that the next step's equation needs from qpos and qvel; `centre` and `twist` of the interior water."""
        mujoco.mj_step1(self.model, self.data)
        self._move.launch()
        self._boxes = None

    def equation(self, interior: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """(M + dt D) and the right-hand side without b0, (n, n) and (n,), momentum units, at the present state."""
        mujoco.mj_fwdActuation(self.model, self.data)  # ctrl may be newer than the state
        mujoco.mj_fullM(self.model, self.data, self.system)
        self._balance[interior].launch()
        return self.system, self._right

    def water_momentum(self) -> np.ndarray:
        """Linear and angular momentum (about its own centre) of each link's displaced water, world axes, (L, 6)."""
        return self._now.copy()

    def solid_momentum(self) -> np.ndarray:
        """The same of the links themselves, (L, 6) kg m/s and kg m2/s."""
        m = self.model
        axes = np.zeros((self.links, 9))
        for i in range(self.links):
            mujoco.mju_quat2Mat(axes[i], m.body_iquat[i + 1])
        axes = axes.reshape(-1, 3, 3)
        inertia = np.einsum("lab,lb,lcb->lac", axes, m.body_inertia[1:], axes)
        found = np.zeros((self.links, 6))
        solid = DisplacedWater(mass=m.body_mass[1:], centre=m.body_ipos[1:], inertia=inertia)
        self._follow(solid, centre=np.zeros((self.links, 3)), twist=np.zeros((self.links, 6)), now=found)[1].launch()
        return found

    def _follow(self, mass: DisplacedWater, **found: np.ndarray) -> tuple[link_dynamics.LinkArrays, link_dynamics.Recorded]:
        """What says how masses that sit in the links move: the arrays, and the launch that fills those in `found`."""
        m, d, n = self.model, self.data, self.dofs
        s, share = link_dynamics.LinkArrays(), link_dynamics.shared
        s.links, s.dofs = self.links, n
        s.place, s.turn = share(d.xpos[1:]), share(d.xmat[1:])
        s.mujoco_axis, s.mujoco_anchor, s.qpos, s.qvel = (share(a) for a in (d.xaxis, d.xanchor, d.qpos, d.qvel))
        root = next((j for j in range(m.njnt) if m.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE), None)
        s.root = 0 if root is None else int(m.jnt_bodyid[root]) - 1
        kind = np.full(n, link_dynamics.HINGE, np.int32)
        if root is not None:
            first = m.jnt_dofadr[root]
            kind[first : first + 6] = *(link_dynamics.FIXED - np.arange(3)), 0, 1, 2  # a free joint spins about its body's axes
        s.joint, s.kind = share(m.dof_jntid.astype(np.int32), int), share(kind, int)
        s.slides, s.reach = share(self.slides, int), share(self.reach)
        s.hinge = share(np.array([_hinge_address(m, i + 1) for i in range(self.links)], np.int32), int)
        s.arm, s.mass, s.inertia = (share(np.array(a, float)) for a in (mass.centre, mass.mass, mass.inertia))
        s.pose, s.jacobian = share(self.pose), share(np.zeros((6 * self.links, n)))
        s.interior_speed = share(self.interior_speed if mass is self.water else np.full(self.links, np.nan))
        s.centre, s.twist, s.now = (share(found[name]) for name in ("centre", "twist", "now"))
        return s, link_dynamics.Recorded(link_dynamics.move, s)

    def _equations(self, interior: int) -> link_dynamics.LinkDynamics:
        """The arrays of the step's equation."""
        d, e, share = self.data, link_dynamics.LinkDynamics(), link_dynamics.shared
        e.body, e.interior = self._moving, interior
        e.dt, e.damping, e.applied = share(self._dt), share(self.model.dof_damping), share(self.applied)
        e.passive, e.actuator, e.bias = share(d.qfrc_passive), share(d.qfrc_actuator), share(d.qfrc_bias)
        e.weight, e.last, e.gain, e.impulse = (share(a) for a in (self._weight, self.momentum, self.gain, self.impulse))
        e.smooth, e.system, e.right = share(self.smooth), share(self.system), share(self._right)
        e.target, e.applied_force, e.check = share(self._target), share(d.qfrc_applied), share(self._check)
        return e

    def advance(self, velocity: np.ndarray) -> None:
        """MuJoCo's step to the velocity found, (n,); afterwards `forward` has been called on the new state.

        Raises:
            SimDiverged: the velocity is not finite or runs away (the state is then the last good one), or MuJoCo disagrees.
        """
        d, check = self.data, self._check
        self._target[:] = velocity
        self._inverse_force.launch()
        if not check[0] < RUNAWAY:  # nan is never less
            at = int(np.argmax(np.nan_to_num(np.abs(velocity), nan=np.inf)))
            joint = self.model.joint(self.model.dof_jntid[at]).name
            message = f"oracle: velocity of joint {joint!r} is {velocity[at]:.3g} at t = {d.time:.4g} s (limit {RUNAWAY:g})"
            raise SimDiverged(message, time=float(d.time), term="coupling", link=joint)
        mujoco.mj_step2(self.model, d)
        self._compare.launch()
        if not check[1] < EXACT:
            off = check[1] * (1 + check[0])
            message = f"oracle: mj_step is {off:.3g} off the velocity found at t = {d.time:.4g} s"
            raise SimDiverged(message, time=float(d.time), term="mj_step")
        self.forward()

    def bounds(self, corners: Corners) -> tuple[np.ndarray, np.ndarray]:
        """Low and high corner (3,) m of the upright box round `corners`."""
        low_high = self.corner_box(corners)
        return low_high[:3].copy(), low_high[3:6].copy()

    def fastest(self, corners: Corners) -> float:
        """Greatest speed of the corners, m/s: no marker inside the boxes that they span is faster."""
        return float(self.corner_box(corners)[9])

    def first_cell(self, corners: Corners) -> np.ndarray:
        """(3,) of the box of cells round them (`Corners.set_grid`); to be read before the body moves."""
        return self.corner_box(corners)[6:9]

    def corner_box(self, corners: Corners) -> np.ndarray:
        """All that `Corners.look` finds, (10,); kept until the body moves."""
        if self._boxes is None or self._boxes[0] is not corners:
            self._boxes = corners, corners.look(self.pose, self.twist)
        return self._boxes[1]

    def largest_extent(self, corners: Corners) -> np.ndarray:
        """Size (3,) m that such a box cannot exceed, whatever the pose: the stretched chain from end to end."""
        far = np.linalg.norm(corners.at, axis=-1).max(-1)  # (L,) from each link's origin
        chain = np.zeros(self.links)  # distance from the first link's origin along the chain
        for i in range(1, self.links):
            parent = self.model.body_parentid[i + 1] - 1
            chain[i] = (chain[parent] if parent >= 0 else 0.0) + np.linalg.norm(self.model.body_pos[i + 1])
        length = far[0] + (chain + far).max() if self.links > 1 else 2 * far[0]
        upright = all(self.data.xaxis[j][2] in (0.0, 1.0) for j in range(self.model.njnt)) and self.model.nq == self.model.nv
        height = np.abs(corners.at[..., 2]).max() * 2 if upright else length
        return np.array([length, length, height])


def _moves(model, body: int, dof: int) -> bool:
    """Whether a degree of freedom moves a body: it belongs to the body or to one of its ancestors."""
    while body:
        if model.dof_bodyid[dof] == body:
            return True
        body = model.body_parentid[body]
    return False


def _slides(model, dof: int) -> bool:
    joint = model.dof_jntid[dof]
    kind = model.jnt_type[joint]
    return kind == mujoco.mjtJoint.mjJNT_SLIDE or (kind == mujoco.mjtJoint.mjJNT_FREE and dof - model.jnt_dofadr[joint] < 3)


def _hinge_address(model, body: int) -> int:
    """Address in qpos of the one hinge that hangs a body on another moving body; -1 when there is none."""
    if model.body_parentid[body] == 0 or model.body_jntnum[body] != 1:
        return -1
    joint = model.body_jntadr[body]
    return int(model.jnt_qposadr[joint]) if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE else -1
