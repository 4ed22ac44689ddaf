"""Angles and physical constants. SI and radians everywhere else."""

from math import pi

G = 9.81  # m/s2
WATER_DENSITY = 1000.0  # kg/m3
WATER_VISCOSITY = 1.0e-6  # m2/s, kinematic, 20 C


def wrap(xp, angle):
    """Angle folded into [-pi, pi)."""
    return angle - 2 * pi * xp.floor((angle + pi) / (2 * pi))
