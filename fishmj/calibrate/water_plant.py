"""The fish whose water a calibration turns: the swimming fish of the search, each coefficient of its strips a number of a row.

    row = [k and cn of head, body and tail as factors; the other coefficients as they are; the effects that the description lists]

What such a water does to a body, in SI units, which a lab can measure and another form of water has, too (`physical`):

    drag       N      of the straight fish, carried ahead at 0.2 m/s
    thrust     N      mean over a beat of the held fish, whose joints follow 1 Hz, 30 deg, 60 deg lag exactly
    sway mass  kg     lateral force over lateral acceleration, of the straight fish at rest
    yaw mass   kg m2  moment over angular acceleration about the reference point, the same
"""

from typing import NamedTuple

import numpy as np

from fishmj import effects
from fishmj.calibrate.least_squares import FreeParameter
from fishmj.dynamics import planar_chain, strip_forces
from fishmj.gap.models.swimming_fish import Constant, SwimmingFish
from fishmj.mjcf.description import Robot, load_robot
from fishmj.water import prior

WHERE = ("head", "body", "tail")
STEP = 0.02  # of a standard deviation of the prior, for slopes
LEAST = 0.05  # of the highest value allowed: what a coefficient that is described as zero may still be, one standard deviation
SPEED, FREQUENCY, SWING, LAG = 0.2, 1.0, np.radians(30.0), np.radians(60.0)


class Free(NamedTuple):
    """A number of the water that is turned: its coefficient, and of a list the place (head, body, tail)."""

    name: str
    coefficient: str
    where: str


def places(links: int) -> list[str]:
    """Where each link is: head, body or tail."""
    return ["head", *["body"] * (links - 2), "tail"]


def free_numbers(links: int) -> list[Free]:
    """All of them for a fish of so many links."""
    lists = [Free(f"{c}_{w}", c, w) for c in ("k", "cn") for w in WHERE if w in places(links)]
    return lists + [Free(c, c, "") for c in strip_forces.Coefficients._fields[2:] if c not in prior.FIXED]


class WaterPlant(SwimmingFish):
    """Args: robot: description, path or name. Its water is that of its own strips."""

    def __init__(self, robot: "Robot | str" = "fish"):
        robot = load_robot(robot)
        super().__init__(robot, [effects.get(fitted.name) for fitted in robot.effects])
        self.free = free_numbers(len(robot.links))
        self.constants = tuple(Constant(f.name, np.inf) for f in self.free)

    @property
    def nothing(self) -> np.ndarray:
        """(P,) the robot as it is described, without any effect."""
        described = [1.0 if f.where else float(getattr(self.nominal.water, f.coefficient)) for f in self.free]
        return np.array([*described, *self.active.null])

    def parameters(self) -> list[FreeParameter]:
        """What is turned: the coefficients, within their prior (data/calib/hydro_fit.toml)."""
        out = []
        for f, start in zip(self.free, self.nothing, strict=False):
            row, values = prior.table()[f.coefficient], np.atleast_1d(getattr(self.nominal.water, f.coefficient))
            low, high = row["low"], row["high"]
            if f.where:  # a factor on the coefficients of these links
                mine = [v for v, w in zip(values, places(self.chain.n), strict=True) if w == f.where]
                low, high = low / max(min(mine), 1e-9), high / max(max(mine), 1e-9)
            sigma = row["sd"] * max(start, LEAST * high)
            unit = "factor" if f.where else row["unit"]
            out.append(FreeParameter(f.name, unit, float(start), STEP * sigma, float(low), float(high), sigma))
        return out

    def rows(self, thetas: np.ndarray) -> np.ndarray:
        """(R, P) of parameters (R, K)."""
        rows = np.tile(self.null, (len(thetas), 1))
        rows[:, : len(self.free)] = thetas
        return rows

    def water(self, values) -> strip_forces.Coefficients:
        """Coefficients of the free numbers; entries may be arrays."""
        given, w = {f.name: value for f, value in zip(self.free, values, strict=False)}, self.nominal.water
        spread = lambda c: [v * given[f"{c}_{at}"] for v, at in zip(getattr(w, c), places(self.chain.n), strict=True)]
        single = {f.coefficient: given[f.name] for f in self.free if not f.where}
        return w._replace(k=spread("k"), cn=spread("cn"), **single)

    def _swimmer(self, row) -> planar_chain.Swimmer:
        return self.nominal._replace(water=self.water([row[i] for i in range(len(self.free))]))


PHYSICAL = {"drag": "N", "thrust": "N", "sway_mass": "kg", "yaw_mass": "kg m2"}


def physical(ch: planar_chain.Chain, sw: planar_chain.Swimmer) -> dict[str, np.ndarray]:
    """The quantities above, of coefficients that are scalars or (R,) arrays."""
    still, size = [(0.0, 0.0)] * ch.n, ch.n + 2
    rest = [0.0] * size
    k = planar_chain.kinematics(np, ch, rest, rest, still)
    added = planar_chain.mass_matrix(ch, sw, k, rigid=False)
    ahead = planar_chain.kinematics(np, ch, rest, [SPEED, *rest[1:]], still)
    drag = planar_chain.gather(ch, ahead, planar_chain.water_forces(np, ch, sw, ahead, 0.0, (0.0, 0.0), 1.0))[0]
    # all links turn with the head of a rigid fish: its yaw inertia is the sum over their rates
    yaw = sum(added[max(r, c)][min(r, c)] for r in range(2, size) for c in range(2, size))
    one = 0.0 * np.asarray(sw.water.ke)
    return {"drag": one - drag, "thrust": one + held_thrust(ch, sw), "sway_mass": one + added[1][1], "yaw_mass": one + yaw}


def held_thrust(ch: planar_chain.Chain, sw: planar_chain.Swimmer) -> np.ndarray:
    """Mean force ahead over the second beat of the held fish, N."""
    joints, omega = np.arange(ch.n - 1), 2 * np.pi * FREQUENCY
    still, steps = [(0.0, 0.0)] * ch.n, round(1.0 / FREQUENCY / ch.dt)
    attached, total = 0.5, np.zeros(())
    for i in range(2 * steps):
        phase = omega * i * ch.dt - LAG * joints
        q, v, a = SWING * np.sin(phase), SWING * omega * np.cos(phase), -SWING * omega**2 * np.sin(phase)
        k = planar_chain.kinematics(np, ch, [0.0, 0.0, 0.0, *q], [0.0, 0.0, 0.0, *v], still)
        if i >= steps:
            force = planar_chain.gather(ch, k, planar_chain.water_forces(np, ch, sw, k, 0.0, (0.0, 0.0), attached))[0]
            added, turning = planar_chain.mass_matrix(ch, sw, k, rigid=False), np.concatenate([[0.0, 0.0, 0.0], np.cumsum(a)])
            total = total + force - sum(added[2 + j][0] * turning[2 + j] for j in range(1, ch.n))
        last = ch.n - 1
        attached = strip_forces.attachment(np, ch.strips, sw.water, k.u[last], k.w[last], k.omega[last], attached, ch.dt)
    return total / steps
