"""Checked before step one, watched until the last: does this box resolve what it is asked to, and is it still sane?

    Ma = u / c_s < 0.3        the scheme is weakly compressible: errors grow with Ma^2
    tau >= 0.5005             without an eddy viscosity; below it the collision has no damping left
    spacing 0.5 to 1.4 dx     of the markers; measured to make no difference inside
    4 cells                   between the fish and the faces, at least

A refusal names the nearest set-up that would pass.
"""

from dataclasses import dataclass
from math import ceil, isnan, sqrt
from typing import NamedTuple

from fishmj.calib import constant
from fishmj.errors import ConfigError, OracleUnstable
from fishmj.flow import TICK
from fishmj.lbm_oracle.fluid.lattice import Lattice
from fishmj.lbm_oracle.refined.refined_fluid import RATIO
from fishmj.lbm_oracle.run.domain import PREVIEWS, Domain

MACH, MACH_WARN = constant("oracle", "mach"), constant("oracle", "mach_warn")
TAU = constant("oracle", "tau_least")
SPACING = constant("oracle", "spacing")  # of dx
CLEARANCE = constant("oracle", "clearance")  # cells
EVERY = constant("oracle", "watch")  # steps between two looks
RHO = constant("oracle", "density_stop")
SPEED_LU = constant("oracle", "speed_stop")
MEAN_DRHO = constant("oracle", "mass_stop")
QUICK, SLOW = 1.0, 0.3  # m/s, tail tip and stream, the speeds of the table


class Line(NamedTuple):
    """One line of the table."""

    what: str
    value: float | int | str
    unit: str
    note: str = ""


def memory(cells: int) -> float:
    """MB of two copies of populations and velocity, and the force."""
    from fishmj.lbm_oracle.fluid.fluid import BYTES_PER_CELL

    return cells * BYTES_PER_CELL / 2**20


def table(domain: Domain, *, subgrid: str = "wale", spacing: float | None = None) -> list[Line]:
    """The numbers of a box; `spacing` of the markers in m."""
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
        OracleUnstable: it would not run; the message has the numbers and the nearest set-up that would pass.
    """
    lat, mach = domain.lattice, domain.lattice.mach(speed)
    if not speed >= 0:
        raise ConfigError(f"guard: speed = {speed} m/s; expected a fastest speed of at least 0")

    def refused(limit: str, why: str) -> OracleUnstable:
        return OracleUnstable(f"{domain.name}: {why}", limit=limit, figures=table(domain, subgrid=subgrid, spacing=spacing))

    if mach > MACH:
        dt = step_for(lat, speed)
        why = f"Mach {mach:.2f} at {speed:g} m/s with dx = {lat.dx:g} m, dt = {lat.dt:g} s; at most {MACH}. "
        raise refused("mach", f"{why}dt = {dt:.4g} s would give {mach * dt / lat.dt:.2f}")
    if subgrid == "none" and lat.tau < TAU:
        dx = 3 * lat.nu / ((TAU - 0.5) * lat.velocity)
        why = f"tau = {lat.tau:.5f} with dx = {lat.dx:g} m, dt = {lat.dt:g} s and no subgrid model; at least {TAU}. "
        raise refused("tau", f"{why}Take subgrid = 'wale', or dx = {dx:.2g} m with dt = {dx / lat.velocity:.2g} s")
    if spacing is not None and not SPACING[0] * lat.dx <= spacing <= SPACING[1] * lat.dx:
        why = f"markers {spacing:.3g} m apart, {spacing / lat.dx:.2f} dx; expected {SPACING[0]} to {SPACING[1]} dx. "
        raise refused("spacing", f"{why}Space them by {lat.dx:g} m")
    if clearance is not None and clearance < CLEARANCE:
        need = (CLEARANCE - clearance) * lat.dx
        why = f"the fish is {clearance:.1f} cells from a face; at least {CLEARANCE:g}. "
        raise refused("clearance", f"{why}Start it {need:.3f} m further in, or make the box larger by that much")
    if mach > MACH_WARN:
        return [f"{domain.name}: Mach {mach:.2f} at {speed:g} m/s: compressibility errors of {100 * mach**2:.0f} %"]
    return []


def step_for(lattice: Lattice, speed: float) -> float:
    """The longest time step [s] that keeps `speed` within the Mach limit and divides a bus tick."""
    longest = MACH * lattice.dx / (speed * sqrt(3))
    return TICK / ceil(TICK / longest)


@dataclass
class Watch:
    """Looks at a fluid every `every` steps, of the coarsest of its levels, and stops it before nonsense is written.

    `look` waits for the device; `begin` does not, and `end` judges what it saw once the device has gone on.

    Raises:
        OracleUnstable: at `look` and `end`, with `limit` one of lost, speed, density, mass.
    """

    every: int = EVERY
    fastest: float = 0.0  # greatest speed seen, m/s
    looks: int = 0
    pending: tuple | None = None  # fluid and step of a look that was begun

    def due(self, fluid, since: int = 1) -> bool:
        """Whether this is a step to look after, or one of the last `since` was."""
        return fluid.steps % (self.every * RATIO ** (len(fluid.levels) - 1)) < since

    def after_step(self, fluid) -> bool:
        """To be called after each step; True when it looked and found all well: the moment to keep a checkpoint."""
        if not self.due(fluid):
            return False
        self.look(fluid)
        return True

    def look(self, fluid):
        """One survey, judged."""
        self.pending = None
        return self._judged(fluid, fluid.steps, fluid.survey())

    def begin(self, fluid) -> None:
        """Queue a survey, to be judged at `end`."""
        fluid.begin_survey()
        self.pending = fluid, fluid.steps

    def end(self):
        """The one that was begun, judged; a step of the same fluid that was begun later has been waited for."""
        if self.pending is not None:
            (fluid, step), self.pending = self.pending, None
            return self._judged(fluid, step, fluid.surveyed())

    def _judged(self, fluid, step: int, found):
        self.looks += 1
        mean = found.mass / fluid.cells
        speed = found.speed * fluid.lattice.velocity
        broken = {  # in this order
            "lost": found.lost or isnan(found.speed),
            "speed": found.speed > SPEED_LU,
            "density": not (found.rho_min > RHO[0] and found.rho_max < RHO[1]),
            "mass": abs(mean) > MEAN_DRHO,
        }
        if limit := next((name for name, found_so in broken.items() if found_so), ""):
            raise OracleUnstable(_said(limit, fluid, step, found, speed, mean), limit=limit, step=step, figures=found)
        self.fastest = max(self.fastest, speed)
        return found


def _said(limit: str, fluid, step: int, found, speed: float, mean: float) -> str:
    lat = fluid.lattice
    slower = lat.dt / 2
    what = {
        "lost": f"{found.lost} of {fluid.cells} nodes are not finite",
        "speed": f"{speed:.2f} m/s is Mach {lat.mach(speed):.2f}; the hard stop is {SPEED_LU * lat.velocity:.2f} m/s",
        "density": f"density {found.rho_min:.3f} to {found.rho_max:.3f}; expected {RHO[0]} to {RHO[1]}",
        "mass": f"mean density is off by {mean:+.4f}; expected less than {MEAN_DRHO}",
    }[limit]
    return f"fluid: at step {step}, t = {step * lat.dt:.3f} s: {what}. dt = {slower:.4g} s would halve every Mach number"
