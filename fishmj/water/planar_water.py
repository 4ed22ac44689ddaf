"""Water of one fish in MuJoCo's planar coordinates (x, y, psi, j1 ..): added mass M_a, and explicit forces on every link.

    a_head = B(psi) qacc     head axes and absolute link rates from MuJoCo's coordinates
    M_a(MuJoCo) = B^T M_a(head) B
    explicit    = strips + learnt residual if there is one, (F_t, F_n, moment) a link

This module sums the terms of `planar_chain`, `strip_forces` and `residual_hooks`. They are computed once for each state
(`Instant`) and used for forces, wrenches and the next memory.
"""

from typing import Any, NamedTuple

import numpy as np

from fishmj.base.errors import SimDiverged
from fishmj.mjcf.description import Robot
from fishmj.water import residual_hooks
from fishmj.water.dynamics import planar_chain, strip_forces

RESIDUAL = "learnt residual"  # its name in errors


class Instant(NamedTuple):
    """Forces and added mass of a water on N links at one state."""

    motion: planar_chain.Links  # u, w, omega of every link through its water
    explicit: Any  # force on every link, without the part proportional to its acceleration
    residual: list  # N of (F_t, F_n, moment), the learnt part of it; empty without a residual
    added: Any  # added mass
    frame: Any  # transformation of both to MuJoCo's coordinates
    attached: float  # attachment one step later
    memory: list  # memory one step later


class PlanarWater:
    """Strip water, and a learnt residual if it has one, around one fish with a planar root.

    Args:
        learnt: `HydroModel.learnt`, the residual of a fitted water whose coefficients `swimmer.water` holds; None: strips alone.

    Attributes:
        swimmer: this fish's constants; `swimmer.water` may be replaced between steps.
        attached: attachment state of the tail, 0..1.
        memory: memory of the residual, flat list of floats. `forces` only reads memory and attachment; the caller advances them
            once for each step.
        flow, ambient: water velocity at each link (N, 3) [m/s], and its uniform acceleration (3,) [m/s2], world frame; set by
            `set_flow`.
    """

    root = "planar"
    unnamed = "ambient"  # term named by `blame` if all others are finite

    def __init__(
        self, robot: Robot, swimmer: planar_chain.Swimmer | None = None, learnt: "residual_hooks.Residual | None" = None
    ):
        self.robot, self.learnt = robot, learnt
        self.chain = planar_chain.chain_of(robot)
        self.swimmer = planar_chain.nominal(robot) if swimmer is None else swimmer
        self.attached = 0.5
        self.memory: list = self.at_rest()
        self.flow, self.ambient = np.zeros((self.chain.n, 3)), np.zeros(3)
        self._known: tuple[Any, Any, Any] = ((), (), None)  # cache: inputs, constants and result

    def at_rest(self) -> list:
        """Memory of a fish at rest in still water."""
        return [] if self.learnt is None else residual_hooks.at_rest()

    def set_flow(self, flow, ambient=(0.0, 0.0, 0.0)) -> None:
        """Sets the water velocity at the links, (N, 2 or 3) m/s, and DU/Dt, (2 or 3,) m/s2."""
        for mine, value in ((self.flow, np.asarray(flow)), (self.ambient, np.asarray(ambient))):
            mine[...] = 0.0
            mine[..., : value.shape[-1]] = value

    def forces(self, model, data) -> tuple[np.ndarray, np.ndarray]:
        """Added mass (nv, nv) and the explicit generalised force (nv,); pure."""
        now = self.instant(model, data)
        force = planar_chain.generalised(np, self.chain, now.frame, planar_chain.gather(self.chain, now.motion, now.explicit))
        # without M_a a, because MuJoCo solves with M + M_a
        return world_matrix(self.chain, now.frame, now.added), np.array(force)

    def wrenches(self, model, data, qacc) -> np.ndarray:
        """Force and moment of the water on every link about its centre of mass, world axes, (N, 6) N, N m; pure.

        Args:
            qacc: (nv,) present acceleration, for the added mass.
        """
        now, ch, c = self.instant(model, data), self.chain, self.swimmer.water
        cp, sp = np.cos(now.frame), np.sin(now.frame)
        ax, ay = cp * qacc[0] + sp * qacc[1], cp * qacc[1] - sp * qacc[0]
        alpha, out = np.cumsum(qacc[2:]), np.zeros((ch.n, 6))
        for i, (ft, fn, moment) in enumerate(now.explicit):
            (tx, ty), (nx, ny) = now.motion.t[i], now.motion.n[i]
            m0, m1, m2 = (c.k[i] * m for m in ch.strips.mu[i])
            across = ax * nx + ay * ny
            fn, moment = fn - m0 * across - m1 * alpha[i], moment - m1 * across - m2 * alpha[i]
            fx, fy = ft * tx + fn * nx, ft * ty + fn * ny
            x, y, _ = model.body_ipos[1 + i]
            out[i, [0, 1, 5]] = cp * fx - sp * fy, sp * fx + cp * fy, moment - x * fn + y * ft
            if i < ch.n - 1:  # acceleration of the next link's origin, without its velocity-dependent part
                ax, ay = ax + ch.d[i] * alpha[i] * nx, ay + ch.d[i] * alpha[i] * ny
        return out

    def following(self, model, data) -> tuple[float, list]:
        """Attachment and memory one step later; forces of this step use the present ones."""
        now = self.instant(model, data)
        return now.attached, now.memory

    def instant(self, model, data) -> Instant:
        """Present forces and added mass; pure, and cached for the same state, flow, memory and constants."""
        arrays = (*self._state(data), self.flow, self.ambient)
        inputs = (*(a.tobytes() for a in arrays), self.attached, *self.memory, model.opt.timestep)
        constants = self._constants()
        known, same, now = self._known
        if known != inputs or any(a is not b for a, b in zip(same, constants, strict=True)):
            now = self._evaluated(data, model.opt.timestep)
            self._known = inputs, constants, now
        return now

    def _state(self, data) -> tuple:
        """All arrays of MuJoCo's state that the water reads."""
        return data.qpos, data.qvel

    def _constants(self) -> tuple:
        """Objects that are replaced, never modified, when the water changes."""
        return (self.swimmer, self.learnt)

    def _evaluated(self, data, dt: float) -> Instant:
        ch, sw, heading = self.chain, self.swimmer, float(data.qpos[2])
        k = planar_chain.kinematics(np, ch, data.qpos.tolist(), data.qvel.tolist(), self.flow[:, :2].tolist())
        # must not modify `attached`, because MuJoCo may call the callback several times in a step (mj_forward)
        hydro = planar_chain.water_forces(np, ch, sw, k, heading, self.ambient.tolist(), self.attached)
        residual, memory = self._learnt(k, dt)
        if residual:
            hydro = [tuple(a + b for a, b in zip(f, g, strict=True)) for f, g in zip(hydro, residual, strict=True)]
        added = planar_chain.mass_matrix(ch, sw, k, rigid=False)
        return Instant(k, hydro, residual, added, heading, self._attachment(k, dt), memory)

    def _learnt(self, k: planar_chain.Links, dt: float) -> tuple[list, list]:
        """Forces of the residual at the present memory, and the memory dt later."""
        if self.learnt is None:
            return [], self.memory
        hooks = residual_hooks.LearnedResidual(np, self.chain, self.learnt, self.memory)
        forces = hooks.advance(self.chain.strips, self.swimmer.water, k, dt)
        return forces, [float(value) for value in hooks.end(self.chain, self.swimmer, (), ())]

    def _attachment(self, k: planar_chain.Links, dt: float) -> float:
        s, water, tail = self.chain.strips, self.swimmer.water, (k.u[-1], k.w[-1], k.omega[-1])
        return float(strip_forces.attachment(np, s, water, *tail, self.attached, dt))

    def blame(self, model, data) -> SimDiverged:
        """Error that names the first term and link with a non-finite force."""
        now = self.instant(model, data)
        motions = list(zip(now.motion.u, now.motion.w, now.motion.omega, strict=True))
        strips = lambda i: named_terms(self.chain.strips, self.swimmer.water, i, *motions[i], self.attached)
        # the residual comes last, because its bound depends on the strips' drag and inherits their errors
        for terms in (strips, lambda i: {RESIDUAL: now.residual[i]} if now.residual else {}):
            for i, link in enumerate(self.robot.links):
                for term, value in terms(i).items():
                    if not np.all(np.isfinite(value)):
                        return diverged(data, term, link.name, *motions[i])
        return diverged(data, self.unnamed, self.robot.links[0].name, *motions[0])


def named_terms(s: strip_forces.Strips, c: strip_forces.Coefficients, i: int, u, w, omega, attached) -> dict:
    """Force of every term on link i by its name: (F_t, F_n, moment) [N, N, N m]."""
    if i == len(s.mu) - 1:
        c = strip_forces.with_held_tail(s, c, attached)
    out = {
        "added mass": tuple(c.k[i] * m for m in s.mu[i]),
        "reactive": strip_forces.reactive(s, c, i, u, w, omega),
        "resistive": strip_forces.resistive(np, s, c, i, u, w, omega),
    }
    if i == 0:
        out["head_form"] = (strip_forces.head_form(np, s, c, u), 0.0, 0.0)
    if i == len(s.mu) - 1:
        out["trailing_edge"] = strip_forces.trailing_edge(np, s, c, u, w, omega, attached)
    return out


def diverged(data, term: str, link: str, u, w, omega) -> SimDiverged:
    """`SimDiverged` with the time and the last inputs."""
    return SimDiverged(
        f"water: term {term!r} on link {link!r} is not finite at t = {data.time:.3f} s"
        f" (u = {u:.4g} m/s, w = {w:.4g} m/s, yaw rate = {omega:.4g} rad/s); check the flow, the coefficients and the time step",
        time=data.time,
        term=term,
        link=link,
    )


def world_matrix(ch: planar_chain.Chain, heading: float, lower) -> np.ndarray:
    """Symmetric matrix (n + 2, n + 2) in MuJoCo's coordinates from a lower triangle (rows) in head axes."""
    size = ch.n + 2
    m = np.array([[lower[max(r, c)][min(r, c)] for c in range(size)] for r in range(size)])
    b = np.zeros((size, size))
    c, s = np.cos(heading), np.sin(heading)
    b[:2, :2] = [[c, s], [-s, c]]
    # MuJoCo uses joint rates, the chain absolute link rates Omega_i, the sum of the rates up to link i
    b[2:, 2:] = np.tri(ch.n)
    return b.T @ m @ b
