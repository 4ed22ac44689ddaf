"""Checks before the first step that a box resolves the requested swim.

    Ma, tau                   limits of the scheme (`fluid.guard`), which `Fluid` itself checks, too
    spacing 0.5 to 1.4 dx     of the markers; measured to make no difference inside
    4 cells                   between the fish and the faces, at least

An error names the nearest set-up that would pass.
"""

from functools import cache
from math import inf

from fishmj.base import console
from fishmj.base.calib import constant
from fishmj.base.errors import OracleUnstable
from fishmj.lbm_oracle.fluid.guard import MACH_WARN, check_spacing, check_speed, check_tau, numbers
from fishmj.lbm_oracle.run.domain import Domain

CLEARANCE = constant("oracle", "clearance")  # cells
SLOW = 0.3  # m/s, a box is checked for this speed at least


def check(
    domain: Domain, *, speed: float, subgrid: str = "wale", spacing: float | None = None, clearance: float | None = None
) -> None:
    """Checks a set-up; warns, once for each box and speed, of the errors of compressibility from Mach 0.15 on.

    Args:
        speed: the fastest expected, m/s. spacing: of the markers, m. clearance: of the fish from the faces, cells.

    Raises:
        ConfigError, UnknownName: an invalid number or subgrid model.
        OracleUnstable: it would not run; the message has the numbers and the nearest set-up that would pass.
    """
    for name, value in (("speed", speed), ("spacing", spacing), ("clearance", clearance)):
        if value is not None:
            numbers(f"guard: {name}", value, low=-inf if name == "clearance" else 0.0)
    lat, mach = domain.lattice, domain.lattice.mach(speed)
    check_speed(lat, speed, domain.name)
    check_tau(lat, subgrid, domain.name)
    if spacing is not None:
        check_spacing(lat, spacing, domain.name)
    if clearance is not None and clearance < CLEARANCE:
        need = (CLEARANCE - clearance) * lat.dx
        why = f"the fish is {clearance:.1f} cells from a face; at least {CLEARANCE:g}. "
        why = f"{domain.name}: {why}Start it {need:.3f} m further in, or make the box larger by that much"
        raise OracleUnstable(why, limit="clearance")
    if mach > MACH_WARN:
        _warn_once(f"{domain.name}: Mach {mach:.2f} at {speed:g} m/s: compressibility errors of {100 * mach**2:.0f} %")


@cache
def _warn_once(message: str) -> None:
    """Warns; many tanks of a study have the same set-up."""
    console.warn(message)
