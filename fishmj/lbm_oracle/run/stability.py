"""Checks before the first step that a box resolves the requested swim.

    Ma, tau                   limits of the scheme (`fluid.guard`), which `Fluid` itself checks, too
    spacing 0.5 to 1.4 dx     of the markers; measured to make no difference inside
    4 cells                   between the fish and the faces, at least

An error names the nearest set-up that would pass.
"""

from math import inf
from typing import NamedTuple

from fishmj.base.calib import constant
from fishmj.base.errors import OracleUnstable
from fishmj.lbm_oracle.fluid.guard import MACH, MACH_WARN, check_spacing, check_speed, check_tau, numbers
from fishmj.lbm_oracle.run.domain import PREVIEWS, Domain

CLEARANCE = constant("oracle", "clearance")  # cells
QUICK, SLOW = 1.0, 0.3  # m/s, tail tip and stream, the speeds of the table


class Line(NamedTuple):
    """One line of the table."""

    what: str
    value: float | int | str
    unit: str
    note: str = ""


def memory(cells: int) -> float:
    """Memory of two copies of populations and velocity, and of the force, MB."""
    from fishmj.lbm_oracle.fluid.fluid import BYTES_PER_CELL

    return cells * BYTES_PER_CELL / 2**20


def table(domain: Domain, *, subgrid: str = "wale", spacing: float | None = None) -> list[Line]:
    """Numbers of a box, one line each; `spacing` of the markers in m."""
    lat, cells = domain.lattice, domain.shape[0] * domain.shape[1] * domain.shape[2]
    lines = [
        Line("cells", cells, "1", " x ".join(map(str, domain.shape))),
        Line("dx", lat.dx, "m"),
        Line("dt", lat.dt, "s", f"{1 / lat.dt:.0f} steps a second"),
        Line("unit of velocity", lat.velocity, "m/s"),
        Line("speed of sound", lat.sound, "m/s", f"crosses the box in {domain.size[0] / lat.sound:.2f} s"),
        Line(f"Mach at {SLOW} m/s", lat.mach(SLOW), "1", _judged(lat.mach(SLOW))),
        Line(f"Mach at {QUICK} m/s", lat.mach(QUICK), "1", _judged(lat.mach(QUICK))),
        Line("nu", lat.nu_lu, "lu"),
        Line("tau", f"{lat.tau:.5f}", "steps", "eddy viscosity on top" if subgrid != "none" else ""),
        Line("memory", memory(cells), "MB"),
    ]
    if spacing is not None:
        lines.append(Line("marker spacing", spacing / lat.dx, "dx"))
    if domain.name in PREVIEWS:
        lines.append(Line("use", "preview", "", "too coarse for a judgement"))
    return lines


def _judged(mach: float) -> str:
    return "too fast" if mach > MACH else "warm" if mach > MACH_WARN else ""


def check(
    domain: Domain, *, speed: float, subgrid: str = "wale", spacing: float | None = None, clearance: float | None = None
) -> list[str]:
    """Warnings for a set-up that may run; `speed` is the fastest expected [m/s], `clearance` of the fish from the faces [cells].

    Raises:
        ConfigError, UnknownName: an invalid number or subgrid model.
        OracleUnstable: it would not run; the message has the numbers and the nearest set-up that would pass.
    """
    for name, value in (("speed", speed), ("spacing", spacing), ("clearance", clearance)):
        if value is not None:
            numbers(f"guard: {name}", value, low=-inf if name == "clearance" else 0.0)
    lat, mach = domain.lattice, domain.lattice.mach(speed)
    try:
        check_speed(lat, speed, domain.name)
        check_tau(lat, subgrid, domain.name)
        if spacing is not None:
            check_spacing(lat, spacing, domain.name)
    except OracleUnstable as error:
        error.figures = table(domain, subgrid=subgrid, spacing=spacing)
        raise
    if clearance is not None and clearance < CLEARANCE:
        need = (CLEARANCE - clearance) * lat.dx
        why = f"the fish is {clearance:.1f} cells from a face; at least {CLEARANCE:g}. "
        why = f"{domain.name}: {why}Start it {need:.3f} m further in, or make the box larger by that much"
        raise OracleUnstable(why, limit="clearance", figures=table(domain, subgrid=subgrid, spacing=spacing))
    if mach > MACH_WARN:
        return [f"{domain.name}: Mach {mach:.2f} at {speed:g} m/s: compressibility errors of {100 * mach**2:.0f} %"]
    return []
