"""D3Q19: nineteen velocities c_i, weights w_i, speed of sound c_s = 1/sqrt 3.

    sum_i w_i = 1,   sum_i w_i c_ia c_ib = c_s^2 delta_ab,   opposite of i: c_j = -c_i

Source: Qian, d'Humieres, Lallemand 1992, Europhys. Lett. 17:479. The order is by opposite pairs, so that the opposite of
an odd i is i + 1 and of an even i > 0 is i - 1.

`Lattice` converts between SI and lattice units, in which the density of still water, a cell and a step are 1:

    x_lu = (x - corner) / dx      u_lu = u dt / dx      nu_lu = nu dt / dx^2      a_lu = a dt^2 / dx
    F = F_lu rho dx^4 / dt^2      torque = T_lu rho dx^5 / dt^2      p = p_lu rho dx^2 / dt^2      m = m_lu rho dx^3
"""

from dataclasses import dataclass

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.base.options import checked, checked_array
from fishmj.base.units import WATER_DENSITY, WATER_VISCOSITY

Q = 19
RATIO = 2  # fine cells in a coarse one, and fine steps in a coarse one, from one level of water to the next
_HALF = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, -1, 0), (1, 0, 1), (1, 0, -1), (0, 1, 1), (0, 1, -1)]
C = ((0, 0, 0), *(tuple(sign * a for a in c) for c in _HALF for sign in (1, -1)))
W = (1 / 3, *(1 / 18,) * 6, *(1 / 36,) * 12)
CS2 = 1 / 3  # c_s^2
CS = CS2**0.5

VELOCITIES = np.array(C)  # (19, 3)
WEIGHTS = np.array(W)  # (19,)


def index_of(c) -> int:
    """Index of the lattice velocity c (3,)."""
    return C.index(tuple(int(a) for a in c))


def opposite(i: int) -> int:
    """Index of the velocity -c_i."""
    return index_of(-VELOCITIES[i])


def mirrored(i: int, *axes: int) -> int:
    """Index of the velocity into which a specular reflection on the planes normal to `axes` turns c_i."""
    c = VELOCITIES[i].copy()
    c[list(axes)] *= -1
    return index_of(c)


@dataclass(frozen=True, kw_only=True)
class Lattice:
    """Grid and fluid: dx m, dt s, rho kg/m3, nu m2/s (kinematic), corner (3,) m, the position of node (0, 0, 0).

    Raises ConfigError: a size that is not positive and finite, or a corner that is not three finite numbers.
    """

    dx: float
    dt: float
    rho: float = WATER_DENSITY
    nu: float = WATER_VISCOSITY
    corner: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self):
        for name in ("dx", "dt", "rho", "nu"):
            if not checked(f"lattice: {name}", value := getattr(self, name)) > 0:
                raise ConfigError(f"lattice: {name} = {value}; expected a positive number in SI units")
        checked_array("lattice: corner", self.corner, (3,))

    @property
    def velocity(self) -> float:
        """One lattice unit of velocity, m/s."""
        return self.dx / self.dt

    @property
    def acceleration(self) -> float:
        """One lattice unit of acceleration, m/s2."""
        return self.dx / self.dt**2

    @property
    def mass(self) -> float:
        """One lattice unit of mass, kg."""
        return self.rho * self.dx**3

    @property
    def force(self) -> float:
        """One lattice unit of force, N."""
        return self.rho * self.dx**4 / self.dt**2

    @property
    def torque(self) -> float:
        """One lattice unit of torque, N m."""
        return self.force * self.dx

    @property
    def pressure(self) -> float:
        """One lattice unit of pressure, Pa."""
        return self.rho * self.velocity**2

    @property
    def sound(self) -> float:
        """Speed of sound of the lattice, m/s: far below water's, which an explicit scheme cannot afford."""
        return CS * self.velocity

    @property
    def nu_lu(self) -> float:
        """Kinematic viscosity in lattice units, nu dt / dx^2."""
        return self.nu * self.dt / self.dx**2

    @property
    def tau(self) -> float:
        """Relaxation time in steps, without eddy viscosity."""
        return 0.5 + 3 * self.nu_lu

    def mach(self, speed: float) -> float:
        """Mach number of a speed in m/s."""
        return speed / self.sound

    def to_lu(self, x) -> np.ndarray:
        """Converts positions (..., 3) m to node coordinates."""
        return (np.asarray(x, float) - self.corner) / self.dx

    def to_si(self, x_lu) -> np.ndarray:
        """Converts node coordinates (..., 3) to positions in m."""
        return np.asarray(x_lu, float) * self.dx + self.corner
