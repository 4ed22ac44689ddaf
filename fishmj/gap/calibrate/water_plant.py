"""The fish with adjustable water for a calibration (gap/models/strip_water.py), and the forces of its water.

Body-level quantities of such a water, in SI units, which a lab can measure and other forms of water have, too (`physical`):

    drag       N      of the straight fish, carried ahead at 0.2 m/s
    side drag  N      the same to its left;  yaw drag, N m: turned about its reference point at 1 rad/s
    thrust     N      mean force ahead over a beat of the fish whose head is carried straight at 0.2 m/s and whose joints follow
                      1 Hz, 30 deg, 60 deg lag exactly: the tail's thrust less the body's drag
    sway mass  kg     lateral force over lateral acceleration, of the straight fish at rest
    yaw mass   kg m2  moment over angular acceleration about the reference point, the same
"""

import numpy as np

from fishmj.gap.calibrate.parameter_fit import FreeParameter, calibration_table
from fishmj.gap.models.strip_water import StripWaterFish
from fishmj.water.dynamics import planar_chain, strip_forces

STEP = 0.02  # of a standard deviation of the prior, for slopes
SPEED, RATE, FREQUENCY, SWING, LAG = 0.2, 1.0, 1.0, np.radians(30.0), np.radians(60.0)


class WaterPlant(StripWaterFish):
    """Plant of a water calibration. Args: robot: description, path or name. Its water is that of its own strips."""

    def parameters(self) -> list[FreeParameter]:
        """Fitted coefficients, within multiples of their prior (data/calib/hydro_fit.toml), and the strips' shape."""
        wider, out = calibration_table()["water"]["wider"], []
        for constant, r in zip(self.constants, self.ranges(), strict=True):
            sigma = r.sigma if constant.name in strip_forces.SHAPE else wider * r.sigma
            out.append(FreeParameter(constant.name, r.unit, r.start, STEP * r.sigma, r.low, r.high, sigma))
        return out

    def starts(self) -> np.ndarray:
        """(S, K) start points of a fit: as described, and with a wing-like tail, which may lead to another local minimum."""
        first = np.array([p.start for p in self.parameters()])
        names, other = [p.name for p in self.parameters()], first.copy()
        for name, value in calibration_table()["water"]["wing"].items():
            other[names.index(name)] = value
        return np.stack([first, other])

    def table(self, theta: np.ndarray) -> dict:
        """The `[water]` table of a description with this water."""
        c = self.water([float(value) for value in theta])
        angles = {f"{key}_deg": float(np.degrees(getattr(c, key))) for key in ("stall_angle", "stall_width")}
        made = {key: value for key, value in c._asdict().items() if f"{key}_deg" not in angles} | angles
        return made | {name: float(theta[len(self.free) + i]) for i, name in enumerate(strip_forces.SHAPE)}

    def physical(self, thetas: np.ndarray) -> dict[str, np.ndarray]:
        """The quantities above, (R,) of parameters (R, K)."""
        columns = list(np.asarray(thetas, float).T)
        return physical(self._chain(columns), self.nominal._replace(water=self.water(columns)))


PHYSICAL = {"drag": "N", "side_drag": "N", "yaw_drag": "N m", "thrust": "N", "sway_mass": "kg", "yaw_mass": "kg m2"}


def physical(ch: planar_chain.Chain, sw: planar_chain.Swimmer) -> dict[str, np.ndarray]:
    """The quantities above, from coefficients that are scalars or (R,) arrays."""
    still, size = [(0.0, 0.0)] * ch.n, ch.n + 2
    rest = [0.0] * size

    def braked(freedom: int, rate: float):
        """Force or moment against one steady motion; head axes, (x, y, moments of each link about its hinge)."""
        k = planar_chain.kinematics(np, ch, rest, [rate if i == freedom else 0.0 for i in range(size)], still)
        # flow along a straight tail is attached, flow from the side is not: alpha is 90 deg
        held = 1.0 if freedom == 0 else 0.0
        force = planar_chain.gather(ch, k, planar_chain.water_forces(np, ch, sw, k, 0.0, (0.0, 0.0), held))
        return -sum(force[2:]) if freedom == 2 else -force[freedom]

    k = planar_chain.kinematics(np, ch, rest, rest, still)
    added = planar_chain.mass_matrix(ch, sw, k, rigid=False)
    # all links of a rigid fish turn with the head: its yaw inertia is the sum over their rates
    yaw = sum(added[max(r, c)][min(r, c)] for r in range(2, size) for c in range(2, size))
    made = {"drag": braked(0, SPEED), "side_drag": braked(1, SPEED), "yaw_drag": braked(2, RATE)}
    made |= {"thrust": carried_thrust(ch, sw), "sway_mass": added[1][1], "yaw_mass": yaw}
    return {name: 0.0 * np.asarray(sw.water.ke, float) + value for name, value in made.items()}


def carried_thrust(ch: planar_chain.Chain, sw: planar_chain.Swimmer, speed: float = SPEED) -> np.ndarray:
    """Mean force ahead over the second beat of the fish whose head is carried straight at `speed` [m/s], N."""
    joints, omega = np.arange(ch.n - 1), 2 * np.pi * FREQUENCY
    still, steps = [(0.0, 0.0)] * ch.n, round(1.0 / FREQUENCY / ch.dt)
    attached, total = 0.5, np.zeros(())
    for i in range(2 * steps):
        phase = omega * i * ch.dt - LAG * joints
        q, v, a = SWING * np.sin(phase), SWING * omega * np.cos(phase), -SWING * omega**2 * np.sin(phase)
        k = planar_chain.kinematics(np, ch, [0.0, 0.0, 0.0, *q], [speed, 0.0, 0.0, *v], still)
        if i >= steps:
            force = planar_chain.gather(ch, k, planar_chain.water_forces(np, ch, sw, k, 0.0, (0.0, 0.0), attached))[0]
            added, turning = planar_chain.mass_matrix(ch, sw, k, rigid=False), np.concatenate([[0.0, 0.0, 0.0], np.cumsum(a)])
            total = total + force - sum(added[2 + j][0] * turning[2 + j] for j in range(1, ch.n))
        last = ch.n - 1
        attached = strip_forces.attachment(np, ch.strips, sw.water, k.u[last], k.w[last], k.omega[last], attached, ch.dt)
    return total / steps
