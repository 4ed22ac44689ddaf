"""The strip water of one fish with a free root: a six-dimensional wrench on every link, in MuJoCo's coordinates.

Link frame: x to the nose, y left, z up, origin at the link's front hinge (head: reference point). nu = (v, omega) of the
origin relative to the water, in link axes; J(q) its Jacobian, A the added mass of the link about the origin.

    M_a = sum J^T A J                                                       joins the mass matrix
    F   = -A (J' qvel)_link - (s omega x p, omega x l + s v x p),  (p, l) = A nu      Kirchhoff 1870, Lamb 1932 art. 124;
          s of `strip_forces`: 1 on the head, the share of the leading edge's suction behind it
    Q   = sum J^T (F + the link's drag, trailing edge, ambient flow, fins and buoyancy)

In the plane, with nothing vertical, F and the drag are those of `strip_forces` (tests/test_inject.py). Beyond the plane:
    lateral     mu and Cn of the plane, at w = v_y + omega_z x; vertical the same with the width for the height
    roll        added inertia rho pi/8 (a^2 - b^2)^2 of each section; drag -rho Cn h ds r^2 sqrt(w^2 + (r p)^2) p, r = h/4:
                the exact integral of the cross-flow drag over the height when w = 0
    fins        plates of chord c, span b: added mass rho pi/4 b^2 c, drag 1/2 rho Cn S |w_f| w_f (Cn of the tail plate),
                lift 1/2 rho S (pi b/2c) |u| w_f (Jones 1946), w_f the vertical velocity at the plate's centre
    weight      carried by MuJoCo; buoyancy equals the nominal weight of each link, above its centre of mass on the long axis:
                every link is trimmed by itself (foam, lead), as the default fish is described; else a bent fish rolls over

Left out: the surface (depth is indifferent), vertical trailing-edge flux, torsion of the tail.
"""

from math import pi

import mujoco
import numpy as np

from fishmj.dynamics import planar_chain, strip_forces
from fishmj.mjcf.description import Robot
from fishmj.mjcf.drawing import fin_plates
from fishmj.mjcf.geometry import geometry_of
from fishmj.units import G
from fishmj.water import planar_water


class FreeWater(planar_water.PlanarWater):
    """Structured water around one fish with a free root; attributes as `PlanarWater`."""

    root = "free"
    unnamed = "vertical, roll or fins"

    def __init__(self, robot: Robot, swimmer: planar_chain.Swimmer | None = None, attached: float = 0.5):
        super().__init__(robot, swimmer, attached)
        self.geometry = geometry_of(robot)
        rho = robot.density_water
        self.plates = [
            (i, np.array([x, y, 0.0]), chord, span, rho * pi / 4 * span**2 * chord)
            for fin in robot.fins
            for i in [[link.name for link in robot.links].index(fin.link)]
            for x, y, chord, span in fin_plates(robot, self.geometry, fin)
        ]
        self.added = [self._added_mass(i, rho) for i in range(self.chain.n)]

    def forces(self, model, data) -> tuple[np.ndarray, np.ndarray]:
        """Added mass (nv, nv) and the explicit generalised force (nv,); pure."""
        total, force = np.zeros((model.nv, model.nv)), np.zeros(model.nv)
        for i, (turn, jac, drift) in enumerate(jacobians(data, self.chain.n)):
            nu = jac @ data.qvel
            nu[:3] -= turn.T @ self.flow[i]
            drift[:3] -= np.cross(nu[3:], nu[:3])  # d/dt of components in a turning frame
            a = self.added[i]
            momentum = a @ nu
            wrench = self._wrench(i, nu, turn) - a @ drift
            share = self.swimmer.water.suction if i else 1.0
            wrench[:3] -= share * np.cross(nu[3:], momentum[:3])
            wrench[3:] -= np.cross(nu[3:], momentum[3:]) + share * np.cross(nu[:3], momentum[:3])
            total += jac.T @ a @ jac
            force += jac.T @ wrench
        return total, force

    def next_attached(self, model, data, dt: float) -> float:
        """Attachment state one step later; brings the link poses up to date first."""
        mujoco.mj_kinematics(model, data)
        return super().next_attached(model, data, dt)

    def motions(self, data) -> list[tuple[float, float, float]]:
        """(u, w, Omega) of every link relative to its water."""
        out = []
        for i, (turn, jac, _) in enumerate(jacobians(data, self.chain.n)):
            nu = jac @ data.qvel
            nu[:3] -= turn.T @ self.flow[i]
            out.append((nu[0], nu[1], nu[5]))
        return out

    def _added_mass(self, i: int, rho: float) -> np.ndarray:
        """A (6, 6) of link i about its origin, link axes."""
        g, k = self.geometry, self.swimmer.water.k[i]
        a = np.zeros((6, 6))
        m0, m1, m2 = k * g.mu[i]
        a[1, 1], a[1, 5], a[5, 1], a[5, 5] = m0, m1, m1, m2
        m0, m1, m2 = k * g.mu_vertical[i]
        a[2, 2], a[2, 4], a[4, 2], a[4, 4] = m0, -m1, -m1, m2
        ds = (g.span[i, 1] - g.span[i, 0]) / g.strip_x.shape[1]
        half_h, half_w = g.strip_h[i] / ds / 2, g.strip_w[i] / ds / 2
        a[3, 3] = k * rho * pi / 8 * np.sum((half_h**2 - half_w**2) ** 2) * ds
        for link, point, _, _, mass in self.plates:
            if link == i:
                lever = np.array([0.0, 0.0, 1.0, point[1], -point[0], 0.0])  # vertical velocity at the plate = lever . nu
                a += mass * np.outer(lever, lever)
        return a

    def _wrench(self, i: int, nu, turn) -> np.ndarray:
        """Drag, trailing edge, ambient flow, fins and buoyancy on link i: (force, moment about the origin), link axes."""
        ch, c, g = self.chain, self.swimmer.water, self.geometry
        s = ch.strips
        u, v, w = nu[:3]
        roll, pitch, yaw = nu[3:]
        out = np.zeros(6)
        du = turn.T @ self.ambient
        parts = [strip_forces.resistive(np, s, c, i, u, v, yaw), strip_forces.ambient(s, c, i, du[0], du[1])]
        if i == 0:
            parts.append((strip_forces.head_form(np, s, c, u), 0.0, 0.0))
        if i == ch.n - 1:
            parts.append(strip_forces.trailing_edge(np, s, c, u, v, yaw, self.attached))
        for ft, fn, moment in parts:
            out += [ft, fn, 0.0, 0.0, 0.0, moment]
        side, down = v + yaw * g.strip_x[i], w - pitch * g.strip_x[i]
        vertical = -0.5 * s.rho * c.cn[i] * g.strip_w[i] * np.abs(down) * down
        ds = (g.span[i, 1] - g.span[i, 0]) / g.strip_x.shape[1]
        r = g.strip_h[i] / ds / 4
        rolling = -s.rho * c.cn[i] * g.strip_h[i] * r**2 * np.sqrt(side**2 + (r * roll) ** 2) * roll
        out += [0.0, 0.0, vertical.sum(), rolling.sum(), -(g.strip_x[i] @ vertical), 0.0]
        for link, point, chord, span, _ in self.plates:
            if link == i:
                speed = w + roll * point[1] - pitch * point[0]
                area = chord * span
                lift = -0.5 * s.rho * area * (c.cn[-1] * abs(speed) + pi / 2 * span / chord * abs(u)) * speed
                out += lift * np.array([0.0, 0.0, 1.0, point[1], -point[0], 0.0])
        up = turn.T @ np.array([0.0, 0.0, g.mass[i] * G])
        out[:3] += up
        out[3:] += np.cross([g.com[i, 0], 0.0, 0.0], up)
        return out


def jacobians(data, n: int) -> list:
    """Kinematics of n links on a free root, in link axes at each link's origin.

    Returns:
        A list of (world <- link rotation (3, 3), J (6, nv) of velocity and angular velocity, J' qvel (6,)).

    Written out instead of calling mj_jac, because a water must not call MuJoCo from inside its callback.
    """
    nv = 5 + n
    turns, points = data.xmat[1 : n + 1].reshape(n, 3, 3), data.xpos[1 : n + 1]
    linear, angular = np.zeros((3, nv)), np.zeros((3, nv))
    linear[:, :3], angular[:, 3:6] = np.eye(3), turns[0]
    acceleration, spin = np.zeros(3), np.zeros(3)  # of the origin and of the link, without qacc
    out = []
    for i in range(n):
        if i > 0:
            lever, omega = points[i] - points[i - 1], angular @ data.qvel
            linear = linear + np.cross(angular.T, lever).T
            acceleration = acceleration + np.cross(spin, lever) + np.cross(omega, np.cross(omega, lever))
            axis = turns[i][:, 2]
            angular = angular.copy()
            angular[:, 5 + i] = axis
            spin = spin + np.cross(omega, axis) * data.qvel[5 + i]
        turn = turns[i].T
        jac, drift = np.concatenate([turn @ linear, turn @ angular]), np.concatenate([turn @ acceleration, turn @ spin])
        out.append((turns[i], jac, drift))
    return out
