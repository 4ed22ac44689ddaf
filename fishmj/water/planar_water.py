"""The strip water of one fish in MuJoCo's planar coordinates (x, y, psi, j1 ..): added mass M_a and explicit force.

    a_head = B(psi) qacc     head axes and absolute link rates from MuJoCo's coordinates
    M_a(MuJoCo) = B^T M_a(head) B

Only sums over the definitions in `planar_chain` and `strip_forces`; nothing about water is stated here a second time.
"""

import numpy as np

from fishmj.dynamics import planar_chain, strip_forces
from fishmj.errors import SimDiverged
from fishmj.mjcf.description import Robot


class PlanarWater:
    """Structured water around one fish with a planar root.

    Attributes:
        attached: attachment state of the tail, 0..1; advances once a step, never inside `forces`.
        flow: water velocity at each link (N, 3) [m/s] and `ambient` its uniform acceleration (3,) [m/s2], world frame;
            the caller sets them (`set_flow`) as often as the flow changes.
    """

    root = "planar"
    unnamed = "ambient"  # what is to blame where no term with a name is

    def __init__(self, robot: Robot, swimmer: planar_chain.Swimmer | None = None, attached: float = 0.5):
        self.robot = robot
        self.chain = planar_chain.chain_of(robot)
        self.swimmer = planar_chain.nominal(robot) if swimmer is None else swimmer
        self.attached = attached
        self.flow, self.ambient = np.zeros((self.chain.n, 3)), np.zeros(3)

    def set_flow(self, flow, ambient=(0.0, 0.0, 0.0)) -> None:
        """Water velocity at the links, (N, 2 or 3) m/s, and DU/Dt, (2 or 3,) m/s2."""
        for mine, value in ((self.flow, np.asarray(flow)), (self.ambient, np.asarray(ambient))):
            mine[...] = 0.0
            mine[..., : value.shape[-1]] = value

    def forces(self, model, data) -> tuple[np.ndarray, np.ndarray]:
        """Added mass (nv, nv) and the explicit generalised force (nv,); pure."""
        k, heading = planar_chain.kinematics(np, self.chain, data.qpos, data.qvel, self.flow), data.qpos[2]
        # `attached` is read, never written: MuJoCo may call the callback more often than once a step (mj_forward)
        hydro = planar_chain.water_forces(np, self.chain, self.swimmer, k, heading, self.ambient, self.attached)
        force = planar_chain.generalised(np, self.chain, heading, planar_chain.gather(self.chain, k, hydro))
        # the force without M_a a: MuJoCo adds the matrix to its own M and finds the acceleration with both
        lower = planar_chain.mass_matrix(self.chain, self.swimmer, k, rigid=False)
        return world_matrix(self.chain, heading, lower), np.array(force)

    def motions(self, data) -> list[tuple[float, float, float]]:
        """(u, w, Omega) of every link relative to its water."""
        k = planar_chain.kinematics(np, self.chain, data.qpos, data.qvel, self.flow)
        return list(zip(k.u, k.w, k.omega, strict=True))

    def next_attached(self, model, data, dt: float) -> float:
        """Attachment state one step later; forces of this step still use the present one."""
        tail = self.motions(data)[-1]
        return float(strip_forces.attachment(np, self.chain.strips, self.swimmer.water, *tail, self.attached, dt))

    def blame(self, model, data) -> SimDiverged:
        """The error that names the first term and link whose force is not finite."""
        motions = self.motions(data)
        for i, link in enumerate(self.robot.links):
            for term, value in named_terms(self.chain.strips, self.swimmer.water, i, *motions[i], self.attached).items():
                if not np.all(np.isfinite(value)):
                    return diverged(data, term, link.name, *motions[i])
        return diverged(data, self.unnamed, self.robot.links[0].name, *motions[0])


def named_terms(s: strip_forces.Strips, c: strip_forces.Coefficients, i: int, u, w, omega, attached) -> dict:
    """Force of every term on link i by its name: (F_t, F_n, moment) [N, N, N m]."""
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
    """A `SimDiverged` with the time and the last inputs."""
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
    # MuJoCo counts joint angles, the chain absolute link rates: Omega_i is the sum of the rates before it
    b[2:, 2:] = np.tri(ch.n)
    return b.T @ m @ b
