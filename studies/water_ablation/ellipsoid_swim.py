"""Free swims in MuJoCo's fluid, a batch in JAX: the closed-form fish with the ellipsoids' force in the place of the strips'.

`inertia` False: as in MuJoCo, the added mass acts through velocities alone. True: its whole force is in the mass matrix, which
MuJoCo leaves out (it passes no acceleration to its added-mass term).
"""

import jax.numpy as jnp
import numpy as np

from fishmj.hydro_fit.fit import rollout
from fishmj.water.dynamics import planar_chain
from studies.water_ablation import force


class Hooks:
    """Sites of `chain.step` that replace the strips' water by the ellipsoids'.

    Args:
        flat: 12 coefficients, see `force.names_of`; scalars or arrays of one batch shape.
    """

    def __init__(self, xp, e: force.Ellipsoids, flat, inertia: bool):
        self.xp, self.e, self.flat, self.inertia = xp, e, flat, inertia

    def fish(self, ch: planar_chain.Chain, sw: planar_chain.Swimmer):
        """Chain and swimmer without the strips' added mass."""
        return ch, sw._replace(water=sw.water._replace(k=[0.0] * ch.n))

    def flow(self, ch, q, flow):
        """Water velocity at each link, unchanged."""
        return flow

    def servos(self, ch, sw, q, v, target):
        """Drive torque (N m) of each joint, without additional damping."""
        return planar_chain.servo_drive(self.xp, ch, sw, q, v, target), [0.0] * (ch.n - 1)

    def water(self, ch, sw, q, k: planar_chain.Links, hydro):
        """Forces of the ellipsoids on each link (N, N, N m)."""
        return [force.link_force(self.xp, self.e, i, k.u[i], k.w[i], k.omega[i], self.flat) for i in range(ch.n)]

    def body(self, ch: planar_chain.Chain, sw, q, k: planar_chain.Links, rhs, m) -> None:
        """Adds M_a and its centripetal forces, from the rates of u and w: u' = a_t + Omega w, w' = a_n - Omega u."""
        if not self.inertia:
            return
        for i, centre in enumerate(self.e.centre):
            factor = force.coefficients_of(self.flat, i == ch.n - 1)["added"]
            along, across, turning = (factor * value for value in self.e.added[i])
            u, w, omega = k.u[i], k.w[i] + centre * k.omega[i], k.omega[i]
            bias = [k.bias[i][0] * x + k.bias[i][1] * y for x, y in (k.t[i], k.n[i])]
            given = (bias[0] - centre * omega * omega + omega * w, bias[1] - omega * u, 0.0)
            for mass, row, rate in zip((along, across, turning), rows(ch, k, i, centre), given, strict=True):
                for r, left in row.items():
                    rhs[r] = rhs[r] - mass * left * rate
                    for c in range(r + 1):
                        if c in row:
                            m[r][c] = m[r][c] + mass * left * row[c]

    def end(self, ch, sw, v, drive):
        """Memory for the next step: none."""
        return ()


def rows(ch: planar_chain.Chain, k: planar_chain.Links, i: int, centre: float) -> tuple[dict, dict, dict]:
    """Acceleration of link i's centre along t and n, and its angular one, for a unit of each of (ax, ay, alpha_0 ..)."""
    (tx, ty), (nx, ny) = k.t[i], k.n[i]
    along, across = {0: tx, 1: ty}, {0: nx, 1: ny}
    for j in range(i):
        x, y = (ch.d[j] * value for value in k.n[j])
        along[2 + j], across[2 + j] = x * tx + y * ty, x * nx + y * ny
    across[2 + i] = centre
    return along, across, {2 + i: 1.0}


class EllipsoidSwim(rollout.SwimWindow):
    """`rollout.SwimWindow` in this water: `run` takes the 12 coefficients for its `water`."""

    def __init__(self, ch: planar_chain.Chain, swimmer: planar_chain.Swimmer, e: force.Ellipsoids, inertia: bool):
        super().__init__(ch, swimmer)
        self.e, self.inertia = e, inertia
        self._key = repr((ch, swimmer[:5], e, inertia))

    def trace(self, q, v, target, flow, ambient, water, attached, memory, learnt):
        """Swim as JAX code, as in `rollout.SwimWindow`; a stream's own acceleration has no effect here, as in MuJoCo."""
        return super().trace(q, v, target, flow, 0.0 * ambient, water, attached, memory, learnt)

    def in_water(self, water: tuple, learnt) -> tuple:
        """(swimmer, function to the hooks of a step), as in `rollout.SwimWindow`."""
        hooks = Hooks(jnp, self.e, water, self.inertia)
        return self.swimmer, lambda memory: hooks


class Bound(EllipsoidSwim):
    """Swims with its own coefficients, for any given water."""

    def __init__(self, swim: EllipsoidSwim, water: np.ndarray):
        super().__init__(swim.chain, swim.swimmer, swim.e, swim.inertia)
        self.own = np.asarray(water, float)

    def run(self, fleet, water, learnt=None, attached=None, memory=None) -> rollout.SwimTrack:
        """Swims every piece with its own coefficients; `water` is ignored."""
        return super().run(fleet, self.own)
