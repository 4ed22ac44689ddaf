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

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np

from fishmj.errors import ConfigError, SimDiverged
from fishmj.mjcf import build, geometry_of, load_robot

RUNAWAY = 1e3  # m/s or rad/s: no step of MuJoCo from there
CROSS = np.array([[0, 0, 0, 0, 0, 1, 0, -1, 0], [0, 0, -1, 0, 0, 0, 1, 0, 0], [0, 1, 0, -1, 0, 0, 0, 0, 0]], float)  # r S = w x r
EXACT = 1e-9  # MuJoCo's velocity against the one found, relative to 1 + |v|


class Motion(NamedTuple):
    """Points (L, K, 3) m of the links, centres (L, 3) m and twists (L, 6) of their inside water, world frame."""

    points: np.ndarray
    centre: np.ndarray
    twist: np.ndarray


def fastest(motions: Sequence[Motion]) -> float:
    """Greatest speed of the points, m/s: no marker inside the boxes that they span is faster."""
    points, centre, twist = (np.array(part) for part in zip(*motions, strict=True))
    spin = (twist[..., 3:] @ CROSS).reshape(*centre.shape, 3)
    speed = (points - centre[..., None, :]) @ spin
    speed += twist[..., None, :3]
    speed *= speed
    return float(np.add.reduce(speed, -1).max()) ** 0.5


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
        n, links = self.dofs, self.links
        self.system = np.zeros((n, n))
        self._diagonal = self.system.reshape(-1)[:: n + 1]
        self.set_step(dt)
        self.reach = np.array([[_moves(model, i + 1, d) for d in range(model.nv)] for i in range(self.links)], float)
        self.slides = np.array([_slides(model, d) for d in range(model.nv)], np.int32)
        self.applied = np.zeros(model.nv)  # a push from outside, generalised, N or N m
        hinge = np.array([_hinge_address(model, i + 1) for i in range(links)])
        self._bent = np.flatnonzero(hinge >= 0)
        self._hinge = hinge[self._bent]
        own = np.array_equal(model.dof_jntid, np.arange(model.njnt))
        self._joint = slice(None) if own else model.dof_jntid.copy()  # of every degree of freedom
        self._root = next((j for j in range(model.njnt) if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE), None)
        self.turn = self.data.xmat[1:].reshape(-1, 3, 3)  # a view
        self._jac = np.zeros((links, 6, n))
        self._rows = _rows(self._jac)
        self._flat = self._jac.reshape(-1, n)
        self._point = water.centre[:, :, None]
        self._mass = water.mass[:, None]
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
        """Everything that the next step's equation needs from qpos and qvel; `centre` and `twist` of the inside water."""
        d = self.data
        mujoco.mj_step1(self.model, d)
        self.centre, self.twist = self._motion(self._point, self._rows, self._jac)
        self._posed: np.ndarray | None = None
        self._bounds: tuple[np.ndarray, np.ndarray] | None = None

    def equation(self, interior: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """(M + dt D) and the right-hand side without b0, (n, n) and (n,), momentum units, at the present state."""
        d = self.data
        mujoco.mj_fwdActuation(self.model, d)  # ctrl may be newer than the state
        mujoco.mj_fullM(self.model, d, self.system)
        self._diagonal += self.dt * self.model.dof_damping
        self.smooth = d.qfrc_passive + d.qfrc_actuator - d.qfrc_bias
        inside = self.interior_impulse(1.0 if interior else 0.0)
        return self.system, self.system @ d.qvel + self.dt * (self.smooth + self.applied) + inside

    def interior_impulse(self, share: float = 1.0) -> np.ndarray:
        """I, (n,): what the displaced water gained in the last step (times `share`), and its buoyancy over this one."""
        now = self.water_momentum()
        self.gain = now - self.momentum  # (L, 6)
        self.momentum = now
        push = share * self.gain
        push[:, :3] -= self.dt * self._mass * self.model.opt.gravity
        return push.ravel() @ self._flat

    def water_momentum(self) -> np.ndarray:
        """Linear and angular momentum (about its own centre) of each link's displaced water, world axes, (L, 6)."""
        return self._momentum(self._mass, self.water.inertia, self.twist)

    def solid_momentum(self) -> np.ndarray:
        """The same of the links themselves, (L, 6) kg m/s and kg m2/s."""
        m = self.model
        axes = np.zeros((self.links, 9))
        for i in range(self.links):
            mujoco.mju_quat2Mat(axes[i], m.body_iquat[i + 1])
        axes = axes.reshape(-1, 3, 3)
        inertia = np.einsum("lab,lb,lcb->lac", axes, m.body_inertia[1:], axes)
        jac = np.zeros_like(self._jac)
        _, twist = self._motion(m.body_ipos[1:, :, None], _rows(jac), jac)
        return self._momentum(m.body_mass[1:, None], inertia, twist)

    def _motion(self, point: np.ndarray, rows: list, jac: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """World positions (L, 3) and twists (L, 6) of points (L, 3, 1) in the links' frames; fills `jac` (L, 6, n)."""
        d = self.data
        where = d.xpos[1:] + (self.turn @ point)[:, :, 0]
        for (link, shift, turn), at in zip(rows, where, strict=True):
            mujoco.mj_jac(self.model, d, shift, turn, at, link)
        return where, jac @ d.qvel

    def _momentum(self, mass, inertia, twist) -> np.ndarray:
        world = self.turn @ inertia @ self.turn.transpose(0, 2, 1)
        out = np.empty((self.links, 6))
        np.multiply(mass, twist[:, :3], out=out[:, :3])
        np.matmul(world, twist[:, 3:, None], out=out[:, 3:, None])
        return out

    def advance(self, velocity: np.ndarray) -> None:
        """MuJoCo's step to the velocity found, (n,); afterwards `forward` has been called on the new state.

        Raises:
            SimDiverged: the velocity is not finite or runs away (the state is then the last good one), or MuJoCo disagrees.
        """
        d = self.data
        found = velocity.tolist()  # plain numbers: a handful is judged faster than by NumPy
        if not all(-RUNAWAY < v < RUNAWAY for v in found):  # nan is not within
            at = int(np.nanargmax(np.abs(velocity))) if np.isfinite(velocity).any() else 0
            joint = self.model.joint(self.model.dof_jntid[at]).name
            message = f"oracle: velocity of joint {joint!r} is {velocity[at]:.3g} at t = {d.time:.4g} s (limit {RUNAWAY:g})"
            raise SimDiverged(message, time=float(d.time), term="coupling", link=joint)
        d.qfrc_applied[:] = self.system @ (velocity - d.qvel) / self.dt - self.smooth
        mujoco.mj_step2(self.model, d)
        limit = EXACT * (1 + max(map(abs, found)))
        if not all(abs(got - v) < limit for got, v in zip(d.qvel.tolist(), found, strict=True)):
            message = f"oracle: mj_step is {np.abs(d.qvel - velocity).max():.3g} off the velocity found at t = {d.time:.4g} s"
            raise SimDiverged(message, time=float(d.time), term="mj_step")
        self.forward()

    def posed(self, corners: np.ndarray) -> np.ndarray:
        """World positions (L, K, 3) m of points in the links' frames; kept until the body moves."""
        if self._posed is None:
            self._bounds = None
            self._posed = corners @ self.turn.transpose(0, 2, 1)
            self._posed += self.data.xpos[1:, None]
        return self._posed

    def bounds(self, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Low and high corner (3,) m of the upright box round `corners` (L, K, 3), points in the links' frames."""
        where = self.posed(corners)
        if self._bounds is None:
            where = where.reshape(-1, 3)
            self._bounds = np.minimum.reduce(where), np.maximum.reduce(where)
        return self._bounds

    def motion(self, corners: np.ndarray) -> Motion:
        """How those points move now; the arrays are never written again."""
        return Motion(self.posed(corners), self.centre, self.twist)

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

    def pack(self, view: dict[str, np.ndarray]) -> None:
        """Frames, hinge angles and motion axes into the host block (see immersed.Layout)."""
        m, d = self.model, self.data
        frame, axis, anchor = view["frame"], view["axis"], view["anchor"]
        frame[:, :3], frame[:, 3:] = d.xpos[1:], d.xmat[1:]
        view["angle"][self._bent] = d.qpos[self._hinge]
        axis[:], anchor[:] = d.xaxis[self._joint], d.xanchor[self._joint]
        if self._root is not None:
            first, turn = m.jnt_dofadr[self._root], d.xmat[m.jnt_bodyid[self._root]].reshape(3, 3)
            axis[first : first + 3], axis[first + 3 : first + 6] = np.eye(3), turn.T  # a free joint spins about its body's axes


def _rows(jac: np.ndarray) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """Body number and the two halves of its Jacobian, views that MuJoCo fills."""
    return [(i + 1, rows[:3], rows[3:]) for i, rows in enumerate(jac)]


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
