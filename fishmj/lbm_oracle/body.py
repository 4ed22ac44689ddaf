"""The solid side: a MuJoCo model that yields the joint-space equation of one step, and takes the velocity found for it.

    (M + dt D + K) v+ = (M + dt D) v + dt (passive + actuators - bias) - b0 + I            K, b0: the water (immersed.py)
    I = sum_l J_l^T (h_l^n - h_l^n-1) - dt sum_l J_l^T m_l g,   h_l = (m_l u_l, I_l w_l)      the water inside the hull

D is joint damping (the servo's back-EMF), which MuJoCo's Euler integrator takes implicitly. h_l is the momentum that the
displaced water of link l has when it moves with the link, m_l its mass, u_l the velocity of its centre: the immersed
boundary accelerates that water too, which a real hull does not contain. Taken as a difference in the world frame it holds
the Coriolis part M_f a + c_f by itself, and its sum over the links telescopes, so that momentum is conserved.
I lags by one step: the implicit solve stays stable with it down to a density ratio of 0.01 (docs/oracle_coupling.md).

The velocity goes back as   qfrc_applied = (M + dt D) (v+ - v) / dt - (passive + actuators - bias),
so that MuJoCo's own step returns v+ exactly. Contacts and joint limits are off in fishmj's models.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from fishmj.errors import ConfigError, SimDiverged
from fishmj.mjcf import build, geometry_of, load_robot

RUNAWAY = 1e3  # m/s or rad/s: no step of MuJoCo from there
EXACT = 1e-9  # MuJoCo's velocity against the one found, relative to 1 + |v|


@dataclass(frozen=True, kw_only=True)
class Water:
    """Displaced water of L links, in their body frames."""

    mass: np.ndarray  # (L,) kg
    centre: np.ndarray  # (L, 3) m
    inertia: np.ndarray  # (L, 3, 3) about the centre, kg m2

    @classmethod
    def of(cls, robot) -> "Water":
        """The sections of a fish, full of water: the geometry's inertia scaled to the displaced mass."""
        g = geometry_of(robot)
        share = g.displaced / g.mass
        zero = 0 * g.buoyancy
        return cls(
            mass=g.displaced,
            centre=np.stack([g.buoyancy, zero, zero], -1),
            inertia=np.stack([np.diag(i) for i in g.inertia * share[:, None]]),
        )


class Body:
    """One articulated body: every moving MuJoCo body is a link, numbered as in the model.

    Args:
        model: constraints off, Euler integrator, one hinge about z per link behind the first (for markers that bend).
        water: displaced water of each link.
        dt: step of the fluid, s; becomes the model's own.
    """

    def __init__(self, model: mujoco.MjModel, water: Water, dt: float):
        self.model, self.data, self.water = model, mujoco.MjData(model), water
        self.links, self.dofs = model.nbody - 1, model.nv
        if len(water.mass) != self.links:
            raise ConfigError(f"body: {self.links} moving bodies in the model, displaced water for {len(water.mass)}")
        self.set_step(dt)
        self.reach = np.array([[_moves(model, i + 1, d) for d in range(model.nv)] for i in range(self.links)], float)
        self.slides = np.array([_slides(model, d) for d in range(model.nv)], np.int32)
        self.hinge = [_hinge_address(model, i + 1) for i in range(self.links)]
        self.applied = np.zeros(model.nv)  # a push from outside, generalised, N or N m
        self._jac = np.zeros((self.links, 6, model.nv))
        self.forward()
        self.momentum = self.water_momentum()  # (L, 6) at the end of the last step

    @classmethod
    def of(cls, robot="fish", root: str = "planar", dt: float = 0.004) -> "Body":
        """The fish of a description, at rest and straight at the origin."""
        robot = load_robot(robot)
        return cls(build(robot, root, bare=True), Water.of(robot), dt)

    def set_step(self, dt: float) -> None:
        """Change the time step, s."""
        self.dt = self.model.opt.timestep = float(dt)

    def place(self, qpos, qvel=None) -> None:
        """Put the body into a state; its water moves with it, so that nothing is accelerated at once."""
        self.data.qpos[:] = qpos
        self.data.qvel[:] = 0.0 if qvel is None else qvel
        self.forward()
        self.momentum = self.water_momentum()

    def forward(self) -> None:
        """Everything that the next step's equation needs from qpos and qvel."""
        mujoco.mj_step1(self.model, self.data)

    def equation(self, interior: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """(M + dt D) and the right-hand side without b0, (n, n) and (n,), momentum units, at the present state."""
        d = self.data
        mujoco.mj_fwdActuation(self.model, d)  # ctrl may be newer than the state
        self.system = np.zeros((self.dofs, self.dofs))
        mujoco.mj_fullM(self.model, d, self.system)
        self.system[np.diag_indices(self.dofs)] += self.dt * self.model.dof_damping
        self.smooth = d.qfrc_passive + d.qfrc_actuator - d.qfrc_bias
        inside = self.interior_impulse(1.0 if interior else 0.0)
        return self.system, self.system @ d.qvel + self.dt * (self.smooth + self.applied) + inside

    def interior_impulse(self, share: float = 1.0) -> np.ndarray:
        """I, (n,): what the displaced water gained in the last step (times `share`), and its buoyancy over this one."""
        now = self.water_momentum()
        self.gain = now - self.momentum  # (L, 6)
        self.momentum = now
        push = share * self.gain
        push[:, :3] -= self.dt * self.water.mass[:, None] * self.model.opt.gravity
        return np.einsum("lan,la->n", self._jac, push)

    def water_momentum(self) -> np.ndarray:
        """Linear and angular momentum (about its own centre) of each link's displaced water, world axes, (L, 6)."""
        return self._momentum(self.water.mass, self.water.centre, self.water.inertia)

    def solid_momentum(self) -> np.ndarray:
        """The same of the links themselves, (L, 6) kg m/s and kg m2/s."""
        m = self.model
        turn = np.zeros((self.links, 9))
        for i in range(self.links):
            mujoco.mju_quat2Mat(turn[i], m.body_iquat[i + 1])
        axes = turn.reshape(-1, 3, 3)
        inertia = np.einsum("lab,lb,lcb->lac", axes, m.body_inertia[1:], axes)
        keep = self._jac.copy()
        out = self._momentum(m.body_mass[1:], m.body_ipos[1:], inertia)
        self._jac = keep
        return out

    def _momentum(self, mass, centre, inertia) -> np.ndarray:
        d = self.data
        turn = d.xmat[1:].reshape(-1, 3, 3)
        self.centre = d.xpos[1:] + np.einsum("lab,lb->la", turn, centre)
        for i in range(self.links):
            mujoco.mj_jac(self.model, d, self._jac[i, :3], self._jac[i, 3:], self.centre[i], i + 1)
        twist = self._jac @ d.qvel
        spin = np.einsum("lba,lb->la", turn, twist[:, 3:])
        spin = np.einsum("lab,lb->la", turn, np.einsum("lab,lb->la", inertia, spin))
        return np.concatenate([mass[:, None] * twist[:, :3], spin], -1)

    def advance(self, velocity: np.ndarray) -> None:
        """MuJoCo's step to the velocity found, (n,); afterwards `forward` has been called on the new state.

        Raises:
            SimDiverged: the velocity is not finite or runs away (the state is then the last good one), or MuJoCo disagrees.
        """
        d = self.data
        if not np.abs(velocity).max() < RUNAWAY:
            at = int(np.nanargmax(np.abs(velocity))) if np.isfinite(velocity).any() else 0
            joint = self.model.joint(self.model.dof_jntid[at]).name
            message = f"oracle: velocity of joint {joint!r} is {velocity[at]:.3g} at t = {d.time:.4g} s (limit {RUNAWAY:g})"
            raise SimDiverged(message, time=float(d.time), term="coupling", link=joint)
        d.qfrc_applied[:] = self.system @ (velocity - d.qvel) / self.dt - self.smooth
        mujoco.mj_step2(self.model, d)
        off = np.abs(d.qvel - velocity).max()
        if not off < EXACT * (1 + np.abs(velocity).max()):
            message = f"oracle: mj_step is {off:.3g} off the velocity found at t = {d.time:.4g} s"
            raise SimDiverged(message, time=float(d.time), term="mj_step")
        self.forward()

    def bounds(self, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Low and high corner (3,) m of the upright box round `corners` (L, K, 3), points in the links' frames."""
        d = self.data
        where = d.xpos[1:, None] + np.einsum("lab,lkb->lka", d.xmat[1:].reshape(-1, 3, 3), corners)
        return where.min((0, 1)), where.max((0, 1))

    def fastest(self, corners: np.ndarray) -> float:
        """Greatest speed of those points, m/s: no marker inside the boxes that they span is faster."""
        d = self.data
        arm = d.xpos[1:, None] + np.einsum("lab,lkb->lka", d.xmat[1:].reshape(-1, 3, 3), corners) - self.centre[:, None]
        twist = self._jac @ d.qvel
        return float(np.linalg.norm(twist[:, None, :3] + np.cross(twist[:, None, 3:], arm), axis=-1).max())

    def largest_extent(self, corners: np.ndarray) -> np.ndarray:
        """Size (3,) m that such a box cannot exceed, whatever the pose: the stretched chain from end to end."""
        far = np.linalg.norm(corners, axis=-1).max(-1)  # (L,) from each link's origin
        chain = np.zeros(self.links)  # distance from the first link's origin along the chain
        for i in range(1, self.links):
            parent = self.model.body_parentid[i + 1] - 1
            chain[i] = (chain[parent] if parent >= 0 else 0.0) + np.linalg.norm(self.model.body_pos[i + 1])
        length = far[0] + (chain + far).max() if self.links > 1 else 2 * far[0]
        upright = all(self.data.xaxis[j][2] in (0.0, 1.0) for j in range(self.model.njnt)) and self.model.nq == self.model.nv
        height = np.abs(corners[..., 2]).max() * 2 if upright else length
        return np.array([length, length, height])

    def pack(self, out: np.ndarray, at) -> None:
        """Frames, hinge angles and motion axes into the host block (see immersed.Layout)."""
        m, d = self.model, self.data
        frames = np.concatenate([d.xpos[1:], d.xmat[1:]], axis=1)
        out[at.frame : at.frame + frames.size] = frames.ravel()
        for i, address in enumerate(self.hinge):
            out[at.angle + i] = d.qpos[address] if address >= 0 else 0.0
        axis, anchor = np.zeros((self.dofs, 3)), np.zeros((self.dofs, 3))
        for j in range(m.njnt):
            first = m.jnt_dofadr[j]
            if m.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE:
                body = m.jnt_bodyid[j]
                axis[first : first + 3] = np.eye(3)
                axis[first + 3 : first + 6] = d.xmat[body].reshape(3, 3).T  # a free joint spins about its body's axes
                anchor[first + 3 : first + 6] = d.xpos[body]
            else:
                axis[first], anchor[first] = d.xaxis[j], d.xanchor[j]
        out[at.axis : at.axis + axis.size] = axis.ravel()
        out[at.anchor : at.anchor + anchor.size] = anchor.ravel()


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
