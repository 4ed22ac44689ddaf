"""The one door between SI and lattice units.

    x_lu = (x - corner) / dx      u_lu = u dt / dx      nu_lu = nu dt / dx^2      a_lu = a dt^2 / dx
    F = F_lu rho dx^4 / dt^2      torque = T_lu rho dx^5 / dt^2      p = p_lu rho dx^2 / dt^2      m = m_lu rho dx^3

`corner` is the position of node (0, 0, 0). In the lattice the density of still water is 1 and a cell and a step are 1.
"""

from dataclasses import dataclass
from math import isfinite

import numpy as np

from fishmj.errors import ConfigError
from fishmj.lbm_oracle.fluid.lattice import CS
from fishmj.units import WATER_DENSITY, WATER_VISCOSITY


@dataclass(frozen=True, kw_only=True)
class Lattice:
    """dx m, dt s, rho kg/m3, nu m2/s (kinematic), corner (3,) m.

    Raises:
        ConfigError: a size that is not positive and finite.
    """

    dx: float
    dt: float
    rho: float = WATER_DENSITY
    nu: float = WATER_VISCOSITY
    corner: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self):
        for name in ("dx", "dt", "rho", "nu"):
            value = getattr(self, name)
            if not (isfinite(value) and value > 0):
                raise ConfigError(f"lattice: {name} = {value}; expected a positive number in SI units")

    @property
    def velocity(self) -> float:
        """One lattice unit of velocity, m/s."""
        return self.dx / self.dt

    @property
    def acceleration(self) -> float:
        """m/s2."""
        return self.dx / self.dt**2

    @property
    def mass(self) -> float:
        """kg."""
        return self.rho * self.dx**3

    @property
    def force(self) -> float:
        """N."""
        return self.rho * self.dx**4 / self.dt**2

    @property
    def torque(self) -> float:
        """N m."""
        return self.force * self.dx

    @property
    def pressure(self) -> float:
        """Pa."""
        return self.rho * self.velocity**2

    @property
    def power(self) -> float:
        """W."""
        return self.force * self.velocity

    @property
    def sound(self) -> float:
        """Speed of sound, m/s: far below water's, the price of an explicit scheme."""
        return CS * self.velocity

    @property
    def nu_lu(self) -> float:
        return self.nu * self.dt / self.dx**2

    @property
    def tau(self) -> float:
        """Relaxation time in steps, without eddy viscosity."""
        return 0.5 + 3 * self.nu_lu

    def mach(self, speed: float) -> float:
        """Mach number of a speed in m/s."""
        return speed / self.sound

    def to_lu(self, x) -> np.ndarray:
        """Positions (..., 3) m -> node coordinates."""
        return (np.asarray(x, float) - self.corner) / self.dx

    def to_si(self, x_lu) -> np.ndarray:
        """Node coordinates (..., 3) -> m."""
        return np.asarray(x_lu, float) * self.dx + self.corner
