"""Water of one fish with a free root: a six-dimensional wrench on every link, in MuJoCo's coordinates.

Link frame: x to the nose, y left, z up, origin at the link's front hinge (head: reference point). nu = (v, omega) of the
origin relative to the water, in link axes; J(q) its Jacobian, A the added mass of the link about the origin.

    M_a = sum J^T A J                                                       joins the mass matrix
    F   = -A (J' qvel)_link - (s omega x p, omega x l + s v x p),  (p, l) = A nu      Kirchhoff 1870, Lamb 1932 art. 124;
          s of `strip_forces`: 1 on the head, the share of the leading edge's suction behind it
    Q   = sum J^T (F + the link's drag, trailing edge, ambient flow, fins, buoyancy and learnt residual)

In the plane, with nothing vertical, F, the drag and the residual are those of `planar_chain` (tests/test_inject.py). Beyond it:
    lateral     mu and Cn of the plane, at w = v_y + omega_z x; vertical the same with the width for the height
    residual    as learnt in the plane: F_t, F_n and the couple about z of each link, from u = v_x, w = v_y, Omega = omega_z of
                all links in link axes. It does not depend on heave, pitch and roll
    roll        added inertia rho pi/8 (a^2 - b^2)^2 of each section; drag -rho Cn h ds r^2 sqrt(w^2 + (r p)^2) p, r = h/4:
                the exact integral of the cross-flow drag over the height when w = 0
    fins        plates of chord c, span b: added mass rho pi/4 b^2 c, drag 1/2 rho Cn S |w_f| w_f (Cn of the tail plate),
                lift 1/2 rho S (pi b/2c) |u| w_f (Jones 1946), w_f the vertical velocity at the plate's centre
    weight      computed by MuJoCo. Buoyancy equals the nominal weight of each link and acts above its centre of mass on the long
                axis: each link is trimmed by itself (foam, lead), otherwise a bent fish would roll over

Not modelled: the free surface (depth has no effect), vertical trailing-edge flux, torsion of the tail, and a residual for heave
and pitch.
"""

from math import pi
from typing import Any, NamedTuple

import mujoco
import numpy as np

from fishmj.base.units import G
from fishmj.mjcf.description import Robot
from fishmj.mjcf.drawing import fin_plates
from fishmj.mjcf.geometry import geometry_of
from fishmj.water import planar_water, residual_hooks
from fishmj.water.dynamics import planar_chain, strip_forces
from fishmj.water.planar_water import Instant


class FreeWater(planar_water.PlanarWater):
    """Strip water, and a learnt residual if it has one, around one fish with a free root; as `PlanarWater`."""

    root = "free"
    unnamed = "vertical, roll or fins"

    def __init__(
        self, robot: Robot, swimmer: planar_chain.Swimmer | None = None, learnt: "residual_hooks.Residual | None" = None
    ):
        super().__init__(robot, swimmer, learnt)
        self.geometry = g = geometry_of(robot)
        rho = robot.density_water
        self.plates = [
            (i, np.array([x, y, 0.0]), chord, span, rho * pi / 4 * span**2 * chord)
            for fin in robot.fins
            for i in [[link.name for link in robot.links].index(fin.link)]
            for x, y, chord, span in fin_plates(robot, self.geometry, fin)
        ]
        self._section = np.array([self._section_mass(i, rho) for i in range(self.chain.n)])
        self._fins = np.zeros_like(self._section)
        for link, point, _, _, mass in self.plates:
            lever = np.array([0.0, 0.0, 1.0, point[1], -point[0], 0.0])  # vertical velocity at the plate = lever . nu
            self._fins[link] += mass * np.outer(lever, lever)
        self._ds = ((g.span[:, 1] - g.span[:, 0]) / g.strip_x.shape[1])[:, None]
        # the strips of all links side by side: link 0 of this table is an array over the links
        own = self.chain.strips
        columns: dict[str, Any] = {
            name: [np.array(getattr(own, name)).T] for name in ("mu", "x", "h", "p", "displaced", "buoyancy")
        }
        linear = own.linear if own.linear is None else [np.array(own.linear)]
        self._abreast = own._replace(**columns, linear=linear)

    def forces(self, model, data) -> tuple[np.ndarray, np.ndarray]:
        """Added mass (nv, nv) and the explicit generalised force (nv,); pure."""
        now = self.instant(model, data)
        jac = now.frame.jac
        turned = jac.transpose(0, 2, 1)
        return (turned @ now.added @ jac).sum(0), (turned @ now.explicit[:, :, None]).sum(0)[:, 0]

    def wrenches(self, model, data, qacc) -> np.ndarray:
        """Force and moment of the water on every link about its centre of mass, world axes, (N, 6) N, N m.

        As `PlanarWater.wrenches`.
        """
        now, n = self.instant(model, data), self.chain.n
        wrench = now.explicit - (now.added @ (now.frame.jac @ qacc)[:, :, None])[:, :, 0]
        wrench[:, 3:] -= _cross(model.body_ipos[1 : n + 1], wrench[:, :3])
        both = now.frame.turns[:, None] @ wrench.reshape(n, 2, 3, 1)
        return both.reshape(n, 6)

    def following(self, model, data) -> tuple[float, list]:
        """Attachment and memory one step later; updates the link poses first."""
        mujoco.mj_kinematics(model, data)
        return super().following(model, data)

    def _state(self, data) -> tuple:
        n = self.chain.n
        return data.xpos[1 : n + 1], data.xmat[1 : n + 1], data.qvel

    def _constants(self) -> tuple:
        return (self.swimmer, self.learnt, self.geometry, self.plates)

    def _evaluated(self, data, dt: float) -> Instant:
        n = self.chain.n
        frame = jacobians(data, n)
        turned = frame.turns.transpose(0, 2, 1)
        nu = frame.jac @ data.qvel
        nu[:, :3] -= (turned @ self.flow[:, :, None])[:, :, 0]
        drift = frame.drift.copy()
        drift[:, :3] -= _cross(nu[:, 3:], nu[:, :3])  # d/dt of components in a turning frame
        added = self._added()
        momentum, carried = (added @ np.stack([nu, drift], -1)).transpose(2, 0, 1)
        share = np.array([1.0] + [self.swimmer.water.suction] * (n - 1))[:, None]
        u, w, omega = nu[:, [0, 1, 5]].T.tolist()
        k = planar_chain.Links([], [], omega, u, w, [])
        attached = self._attachment(k, dt)
        residual, memory = self._learnt(k, dt)
        wrench = self._wrenches(nu, turned) - carried
        wrench[:, :3] -= share * _cross(nu[:, 3:], momentum[:, :3])
        wrench[:, 3:] -= _cross(nu[:, 3:], momentum[:, 3:]) + share * _cross(nu[:, :3], momentum[:, :3])
        if residual:
            wrench[:, [0, 1, 5]] += residual
        return Instant(k, wrench, residual, added, frame, attached, memory)

    def _added(self) -> np.ndarray:
        """Added mass (N, 6, 6) of every link about its origin, link axes."""
        return np.asarray(self.swimmer.water.k)[:, None, None] * self._section + self._fins

    def _section_mass(self, i: int, rho: float) -> np.ndarray:
        """Added mass (6, 6) of link i without fins, for k = 1."""
        g = self.geometry
        a = np.zeros((6, 6))
        m0, m1, m2 = g.mu[i]
        a[1, 1], a[1, 5], a[5, 1], a[5, 5] = m0, m1, m1, m2
        m0, m1, m2 = g.mu_vertical[i]
        a[2, 2], a[2, 4], a[4, 2], a[4, 4] = m0, -m1, -m1, m2
        ds = (g.span[i, 1] - g.span[i, 0]) / g.strip_x.shape[1]
        half_h, half_w = g.strip_h[i] / ds / 2, g.strip_w[i] / ds / 2
        a[3, 3] = rho * pi / 8 * np.sum((half_h**2 - half_w**2) ** 2) * ds
        return a

    def _wrenches(self, nu, turned) -> np.ndarray:
        """Drag, trailing edge, ambient flow, fins and buoyancy: (N, 6) force and moment about the origin, link axes.

        Args:
            nu: (N, 6) velocities through the water. turned: (N, 3, 3) world to link.
        """
        ch, g = self.chain, self.geometry
        s, last = ch.strips, ch.n - 1
        c = strip_forces.with_held_tail(s, self.swimmer.water, self.attached)
        u, v, w, roll, pitch, yaw = nu.T
        out = np.zeros((ch.n, 6))
        plane = out[:, [0, 1, 5]]
        du = turned @ self.ambient
        abreast = self._abreast, c._replace(k=[np.asarray(c.k)], cn=[np.asarray(c.cn)]), 0
        plane += np.stack(strip_forces.resistive(np, *abreast, u, v, yaw), -1)
        plane += np.stack(strip_forces.ambient(*abreast, du[:, 0], du[:, 1]), -1)
        plane[0, 0] += strip_forces.head_form(np, s, c, u[0])
        plane[last] += strip_forces.trailing_edge(np, s, c, u[last], v[last], yaw[last], self.attached)
        out[:, [0, 1, 5]] = plane
        side, down = v[:, None] + yaw[:, None] * g.strip_x, w[:, None] - pitch[:, None] * g.strip_x
        cn = np.asarray(c.cn)[:, None]
        vertical = -0.5 * s.rho * cn * g.strip_w * np.abs(down) * down
        r = g.strip_h / self._ds / 4
        rolling = -s.rho * cn * g.strip_h * r**2 * np.sqrt(side**2 + (r * roll[:, None]) ** 2) * roll[:, None]
        out[:, 2] += vertical.sum(1)
        out[:, 3] += rolling.sum(1)
        out[:, 4] -= (g.strip_x * vertical).sum(1)
        for i, point, chord, span, _ in self.plates:
            speed = w[i] + roll[i] * point[1] - pitch[i] * point[0]
            area = chord * span
            lift = -0.5 * s.rho * area * (c.cn[-1] * abs(speed) + pi / 2 * span / chord * abs(u[i])) * speed
            out[i, 2:5] += lift * np.array([1.0, point[1], -point[0]])
        up = turned[:, :, 2] * (g.mass * G)[:, None]
        out[:, :3] += up
        # buoyancy acts above the centre of mass, on the long axis
        out[:, 4] -= g.com[:, 0] * up[:, 2]
        out[:, 5] += g.com[:, 0] * up[:, 1]
        return out


class Frames(NamedTuple):
    """Kinematics of N links on a free root, in link axes at each link's origin."""

    turns: np.ndarray  # (N, 3, 3) link to world
    jac: np.ndarray  # (N, 6, nv) of velocity and angular velocity
    drift: np.ndarray  # (N, 6) J' qvel


def _cross(a, b) -> np.ndarray:
    """Cross product a x b of vectors along the last axis; np.cross takes ten times as long for so few."""
    a0, a1, a2, b0, b1, b2 = a[..., 0], a[..., 1], a[..., 2], b[..., 0], b[..., 1], b[..., 2]
    x = a1 * b2 - a2 * b1
    out = np.empty((*x.shape, 3))
    out[..., 0], out[..., 1], out[..., 2] = x, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
    return out


def jacobians(data, n: int) -> Frames:
    """Kinematics of n links.

    Implemented here instead of mj_jac, because the callback must not call MuJoCo.
    """
    nv = 5 + n
    turns, points = data.xmat[1 : n + 1].reshape(n, 3, 3), data.xpos[1 : n + 1]
    # rotational columns: three axes of the head about its origin, then one hinge per link; each moves the links behind it
    axes = np.concatenate([turns[0].T, turns[1:, :, 2]])
    origins = np.concatenate([points[[0, 0, 0]], points[1:]])
    moved = np.concatenate([np.ones((n, 3)), np.tri(n, n - 1, -1)], 1)[:, :, None]
    linear, angular = np.zeros((n, 3, nv)), np.zeros((n, 3, nv))
    linear[:, :, :3] = np.eye(3)
    linear[:, :, 3:] = (moved * _cross(axes[None], points[:, None] - origins[None])).transpose(0, 2, 1)
    angular[:, :, 3:] = (moved * axes[None]).transpose(0, 2, 1)
    omega, lever, hinges = angular @ data.qvel, np.diff(points, axis=0), turns[1:, :, 2] * data.qvel[6:, None]
    acceleration, spin = np.zeros((n, 3)), np.zeros((n, 3))  # of the origin and of the link, without qacc
    spin[1:] = np.cumsum(_cross(omega[:-1], hinges), 0)
    acceleration[1:] = np.cumsum(_cross(spin[:-1], lever) + _cross(omega[:-1], _cross(omega[:-1], lever)), 0)
    turned = turns.transpose(0, 2, 1)
    both = turned[:, None] @ np.stack([acceleration, spin], 1)[..., None]
    return Frames(turns, np.concatenate([turned @ linear, turned @ angular], 1), both.reshape(n, 6))
