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
from operator import sub
from typing import NamedTuple

import mujoco
import numpy as np

from fishmj.errors import ConfigError, SimDiverged
from fishmj.lbm_oracle.corners import Corners
from fishmj.mjcf import build, geometry_of, load_robot

RUNAWAY = 1e3  # m/s or rad/s: no step of MuJoCo from there
EXACT = 1e-9  # MuJoCo's velocity against the one found, relative to 1 + |v|


class Motion(NamedTuple):
    """Rotations (L, 3, 3) of the links, twists (L, 6) of their inside water in the world, `reach` of the corners."""

    turn: np.ndarray
    twist: np.ndarray
    reach: np.ndarray


def fastest(motions: Sequence[Motion]) -> float:
    """Greatest speed of the corners, m/s: no marker inside the boxes that they span is faster."""
    turn, twist = np.array([motion.turn for motion in motions]), np.array([motion.twist for motion in motions])
    within = twist.reshape(*turn.shape[:2], 2, 3) @ turn  # R^T u and R^T w
    speed = within.reshape(len(motions), -1).dot(motions[0].reach).reshape(-1, 3)
    speed *= speed
    return float(np.maximum.reduce(np.add.reduce(speed, -1))) ** 0.5


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
        self.reach = np.array([[_moves(model, i + 1, d) for d in range(n)] for i in range(links)], float)
        self.slides = np.array([_slides(model, d) for d in range(n)], np.int32)
        self.applied = np.zeros(n)  # a push from outside, generalised, N or N m
        hinge = np.array([_hinge_address(model, i + 1) for i in range(links)])
        bent = np.flatnonzero(hinge >= 0)
        self._bent, self._hinge = _span(bent), _span(hinge[bent])
        own = np.array_equal(model.dof_jntid, np.arange(model.njnt))
        self._joint = slice(None) if own else model.dof_jntid.copy()  # of every degree of freedom
        self._root = next((j for j in range(model.njnt) if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE), None)
        self.frames = np.zeros((links, 12))  # position, rotation by rows
        self.turn = self.data.xmat[1:].reshape(-1, 3, 3)  # a view
        self._turned = np.eye(6 * links)  # T: 1 and R of every link, its inertia's axes to the world's
        self._blocks = _blocks(self._turned, links)[:, 3:, 3:]
        self._inertia = _inertia(water.mass, water.inertia)
        self._arm = np.concatenate([0 * water.centre, water.centre], 1).ravel()
        self._jac = np.zeros((6 * links, n))
        self.centre = np.zeros((links, 3))
        self._rows = _rows(self._jac, self.centre)
        self.set_step(dt)
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
        self._dt = np.full(self.dofs, self.dt)  # a product with an array is cheaper than one with a number
        self._weigh()

    def place(self, qpos, qvel=None) -> None:
        """Put the body into a state; its water moves with it, so that nothing is accelerated at once."""
        self.data.qpos[:] = qpos
        self.data.qvel[:] = 0.0 if qvel is None else qvel
        self._weigh()
        self.forward()
        self.momentum = self.water_momentum()

    def _weigh(self) -> None:
        """Impulse (L, 6) of the displaced water's weight over a step."""
        self._weight = np.zeros((self.links, 6))
        self._weight[:, :3] = self.dt * self.water.mass[:, None] * self.model.opt.gravity

    def forward(self) -> None:
        """Everything that the next step's equation needs from qpos and qvel; `centre` and `twist` of the inside water."""
        d = self.data
        mujoco.mj_step1(self.model, d)
        self.frames[:, :3], self.frames[:, 3:], self._blocks[:] = d.xpos[1:], d.xmat[1:], self.turn
        self.twist = self._motion(self._arm, self._rows, self._jac, self.centre)
        self._bounds: tuple[np.ndarray, np.ndarray] | None = None

    def equation(self, interior: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """(M + dt D) and the right-hand side without b0, (n, n) and (n,), momentum units, at the present state."""
        d, dt = self.data, self._dt
        mujoco.mj_fwdActuation(self.model, d)  # ctrl may be newer than the state
        mujoco.mj_fullM(self.model, d, self.system)
        self._diagonal += dt * self.model.dof_damping
        self.smooth = d.qfrc_passive + d.qfrc_actuator - d.qfrc_bias
        inside = self.interior_impulse(interior)
        return self.system, self.system.dot(d.qvel) + dt * (self.smooth + self.applied) + inside

    def interior_impulse(self, interior: bool = True) -> np.ndarray:
        """I, (n,): what the displaced water gained in the last step (if `interior`), and its buoyancy over this one."""
        now = self.water_momentum()
        self.gain = now - self.momentum  # (L, 6)
        self.momentum = now
        push = self.gain - self._weight if interior else -self._weight
        return push.ravel().dot(self._jac)

    def water_momentum(self) -> np.ndarray:
        """Linear and angular momentum (about its own centre) of each link's displaced water, world axes, (L, 6)."""
        return self._momentum(self._inertia, self.twist)

    def solid_momentum(self) -> np.ndarray:
        """The same of the links themselves, (L, 6) kg m/s and kg m2/s."""
        m = self.model
        axes = np.zeros((self.links, 9))
        for i in range(self.links):
            mujoco.mju_quat2Mat(axes[i], m.body_iquat[i + 1])
        axes = axes.reshape(-1, 3, 3)
        inertia = np.einsum("lab,lb,lcb->lac", axes, m.body_inertia[1:], axes)
        jac, at = np.zeros_like(self._jac), np.zeros_like(self.centre)
        arm = np.concatenate([0 * m.body_ipos[1:], m.body_ipos[1:]], 1).ravel()
        return self._momentum(_inertia(m.body_mass[1:], inertia), self._motion(arm, _rows(jac, at), jac, at))

    def _motion(self, arm: np.ndarray, rows: list, jac: np.ndarray, at: np.ndarray) -> np.ndarray:
        """Twists (L, 6) of points (0, r) in the links' frames, (6 L,); fills `jac` (6 L, n) and their world positions (L, 3)."""
        m, d = self.model, self.data
        np.add(d.xpos[1:], self._turned.dot(arm).reshape(-1, 6)[:, 3:], out=at)
        for shift, turn, point, link in rows:
            mujoco.mj_jac(m, d, shift, turn, point, link)
        return jac.dot(d.qvel).reshape(-1, 6)

    def _momentum(self, inertia: np.ndarray, twist: np.ndarray) -> np.ndarray:
        """T I T^T xi, (L, 6), of inertias (6 L, 6 L) in the links' axes and twists (L, 6) in the world's."""
        turned = self._turned
        return turned.dot(inertia).dot(turned.T).dot(twist.ravel()).reshape(-1, 6)

    def advance(self, velocity: np.ndarray) -> None:
        """MuJoCo's step to the velocity found, (n,); afterwards `forward` has been called on the new state.

        Raises:
            SimDiverged: the velocity is not finite or runs away (the state is then the last good one), or MuJoCo disagrees.
        """
        d = self.data
        found = velocity.tolist()  # plain numbers: a handful is judged faster than by NumPy
        if not sum(map(abs, found)) < RUNAWAY and not all(-RUNAWAY < v < RUNAWAY for v in found):  # nan is never less
            at = int(np.nanargmax(np.abs(velocity))) if np.isfinite(velocity).any() else 0
            joint = self.model.joint(self.model.dof_jntid[at]).name
            message = f"oracle: velocity of joint {joint!r} is {velocity[at]:.3g} at t = {d.time:.4g} s (limit {RUNAWAY:g})"
            raise SimDiverged(message, time=float(d.time), term="coupling", link=joint)
        d.qfrc_applied[:] = self.system.dot(velocity - d.qvel) / self._dt - self.smooth
        mujoco.mj_step2(self.model, d)
        off = max(map(abs, map(sub, d.qvel.tolist(), found)))
        if not off < EXACT * (1 + max(map(abs, found))):
            message = f"oracle: mj_step is {off:.3g} off the velocity found at t = {d.time:.4g} s"
            raise SimDiverged(message, time=float(d.time), term="mj_step")
        self.forward()

    def bounds(self, corners: Corners) -> tuple[np.ndarray, np.ndarray]:
        """Low and high corner (3,) m of the upright box round `corners`; kept until the body moves."""
        if self._bounds is None:
            self._bounds = corners.bounds(self.frames.ravel())
        return self._bounds

    def motion(self, corners: Corners) -> Motion:
        """How those points move now; the arrays are never written again."""
        return Motion(self.turn.copy(), self.twist, corners.reach)

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

    def pack(self, view: dict[str, np.ndarray]) -> None:
        """Frames, hinge angles and motion axes into the host block (see immersed.Layout)."""
        m, d = self.model, self.data
        axis, anchor = view["axis"], view["anchor"]
        view["frame"][:] = self.frames
        view["angle"][self._bent] = d.qpos[self._hinge]
        axis[:], anchor[:] = d.xaxis[self._joint], d.xanchor[self._joint]
        if self._root is not None:
            first, turn = m.jnt_dofadr[self._root], d.xmat[m.jnt_bodyid[self._root]].reshape(3, 3)
            axis[first : first + 3], axis[first + 3 : first + 6] = np.eye(3), turn.T  # a free joint spins about its body's axes


def _blocks(matrix: np.ndarray, links: int) -> np.ndarray:
    """The blocks (L, 6, 6) on the diagonal of a matrix (6 L, 6 L), a view."""
    return np.einsum("iaib->iab", matrix.reshape(links, 6, links, 6))


def _inertia(mass: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """(6 L, 6 L) from masses (L,) and inertias (L, 3, 3) in the links' axes."""
    whole = np.zeros((6 * len(mass), 6 * len(mass)))
    blocks = _blocks(whole, len(mass))
    blocks[:, :3, :3], blocks[:, 3:, 3:] = mass[:, None, None] * np.eye(3), inertia
    return whole


def _rows(jac: np.ndarray, at: np.ndarray) -> list[tuple]:
    """What `mj_jac` is told of every link: the two halves of its rows of `jac` (6 L, n), its row of `at` (L, 3), its number."""
    return [(rows[:3], rows[3:], at[i], i + 1) for i, rows in enumerate(jac.reshape(len(at), 6, -1))]


def _span(numbers: np.ndarray) -> np.ndarray | slice:
    """The same indices as a slice where they follow on one another."""
    follow = len(numbers) > 0 and np.array_equal(numbers, numbers[0] + np.arange(len(numbers)))
    return slice(int(numbers[0]), int(numbers[-1]) + 1) if follow else numbers


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
