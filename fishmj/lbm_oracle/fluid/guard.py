"""Checks of the user's input, limits of the scheme before a step, and a watch during the run.

    Ma = u / c_s < 0.3        the scheme is weakly compressible: errors grow with Ma^2
    tau >= 0.5005             without an eddy viscosity; below it the collision has no damping left
    spacing 0.5 to 1.4 dx     of the markers; measured to make no difference inside

Every class that a user can build calls these itself: `Fluid`, `Markers`, `ImmersedBody`, `FluidStructure`. An error names the
nearest set-up that would pass.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, inf, isnan, sqrt
from typing import Any

import numpy as np

from fishmj.base.calib import constant
from fishmj.base.errors import ConfigError, OracleUnstable
from fishmj.base.options import checked_kind, checked_name, shown_value
from fishmj.lbm_oracle.fluid.lattice import RATIO, Lattice
from fishmj.water.flow import TICK

MACH, MACH_WARN = constant("oracle", "mach"), constant("oracle", "mach_warn")
TAU = constant("oracle", "tau_least")
SUBGRID = ("wale", "none")
SPACING = constant("oracle", "spacing")  # of dx
EVERY = constant("oracle", "watch")  # steps between two looks
RHO = constant("oracle", "density_stop")
SPEED_LU = constant("oracle", "speed_stop")
MEAN_DRHO = constant("oracle", "mass_stop")


def numbers(what: str, value: Any, shape: Sequence[int | None] = (), *, low: float = -inf, high: float = inf) -> np.ndarray:
    """Returns `value` as float64 of `shape`, where None stands for any length.

    Args:
        what: name of the value in the message, as "markers: area".
        low, high: range of its entries, ends included.

    Raises ConfigError: not numbers, another shape, or an entry that is not finite or out of range.
    """
    array = _array(what, value, "iuf")
    _check_shape(what, array, shape)
    array = array.astype(float, copy=False)
    wrong = ~(np.isfinite(array) & (array >= low) & (array <= high))
    if wrong.any():
        at = np.unravel_index(int(np.argmax(wrong)), array.shape)
        raise ConfigError(f"{what}{_place(at)} = {array[at]:g}; expected a finite number{_range(low, high)}")
    return array


def whole_numbers(what: str, value: Any, shape: Sequence[int | None] = (), *, low: float = -inf, high: float = inf) -> np.ndarray:
    """Returns `value` as int64 of `shape`. Arguments and errors as for `numbers`; also raises ConfigError for fractions."""
    array = _array(what, value, "iuf")
    if array.dtype.kind == "f" and array.size:
        raise ConfigError(f"{what} has the type {array.dtype}; expected whole numbers")
    return numbers(what, array, shape, low=low, high=high).astype(np.int64)


def _array(what: str, value: Any, kinds: str) -> np.ndarray:
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different lengths
        raise ConfigError(f"{what} = {shown_value(value)}; expected numbers, all rows of one length") from None
    if array.dtype.kind not in kinds:
        raise ConfigError(f"{what} = {shown_value(value)}; expected numbers, got the type {array.dtype}")
    return array


def _check_shape(what: str, array: np.ndarray, shape: Sequence[int | None]) -> None:
    fits = array.ndim == len(shape) and all(want in (None, have) for want, have in zip(shape, array.shape, strict=True))
    if not fits:
        expected = ", ".join("any" if n is None else str(n) for n in shape)
        raise ConfigError(f"{what} has the shape {array.shape}; expected ({expected}{',' * (len(shape) == 1)})")


def _place(at: tuple[Any, ...]) -> str:
    return f"[{', '.join(map(str, at))}]" if at else ""


def _range(low: float, high: float) -> str:
    return (f" from {low:g}" if low > -inf else "") + (f" to {high:g}" if high < inf else " up" if low > -inf else "")


def check_speed(lattice: Lattice, speed: float, what: str) -> None:
    """Raises OracleUnstable for a speed in m/s beyond the Mach limit; `what` begins the message."""
    mach = lattice.mach(speed)
    if not mach <= MACH:
        dt = step_for(lattice, speed)
        raise OracleUnstable(
            f"{what}: Mach {mach:.2f} at {speed:g} m/s with dx = {lattice.dx:g} m, dt = {lattice.dt:g} s; at most {MACH}."
            f" dt = {dt:.4g} s would give {mach * dt / lattice.dt:.2f}",
            limit="mach",
        )


def check_tau(lattice: Lattice, subgrid: str, what: str) -> None:
    """Raises OracleUnstable for a relaxation time below the limit without an eddy viscosity.

    Raises UnknownName for a model that is not in SUBGRID.
    """
    if checked_name("subgrid model", subgrid, SUBGRID) == "none" and not lattice.tau >= TAU:
        dx = 3 * lattice.nu / ((TAU - 0.5) * lattice.velocity)
        raise OracleUnstable(
            f"{what}: tau = {lattice.tau:.5f} with dx = {lattice.dx:g} m, dt = {lattice.dt:g} s and no subgrid model; at least"
            f" {TAU}. Take subgrid = 'wale', or dx = {dx:.2g} m with dt = {dx / lattice.velocity:.2g} s",
            limit="tau",
        )


def check_spacing(lattice: Lattice, spacing: float, what: str) -> None:
    """Raises OracleUnstable for markers, `spacing` m apart, that leak or crowd on this grid."""
    if not SPACING[0] * lattice.dx <= spacing <= SPACING[1] * lattice.dx:
        raise OracleUnstable(
            f"{what}: markers {spacing:.3g} m apart, {spacing / lattice.dx:.2f} dx; expected {SPACING[0]} to {SPACING[1]} dx."
            f" Space them by {lattice.dx:g} m",
            limit="spacing",
        )


def check_density(rho: np.ndarray, what: str) -> None:
    """Raises OracleUnstable for densities, relative to still water, that the watch would stop."""
    low, high = float(rho.min()), float(rho.max())
    if not (RHO[0] < low and high < RHO[1]):
        raise OracleUnstable(
            f"{what}: density {low:.3f} to {high:.3f} of still water's; expected {RHO[0]} to {RHO[1]}", limit="density"
        )


def check_snapshot(state: Any, shape: tuple[int, ...], stored: type) -> None:
    """Raises ConfigError unless `state` is a snapshot of water whose populations have this shape and type."""
    wanted = {"f": shape, "u": (*shape[1:], 3), "origin": (3,), "steps": ()}
    if missing := [name for name in wanted if name not in checked_kind("fluid: a snapshot", state, dict, needed=True)]:
        raise ConfigError(f"fluid: a snapshot without {', '.join(missing)}; expected {', '.join(wanted)}")
    if state["f"].shape != shape:
        raise ConfigError(f"fluid: a snapshot of shape {state['f'].shape[1:]} does not fit a box of {shape[1:]}")
    if state["f"].dtype != stored:
        raise ConfigError(f"fluid: a snapshot of {state['f'].dtype} does not fit storage of {np.dtype(stored)}; use its dtype")
    for name, size in wanted.items():
        _check_shape(f"fluid: {name} of a snapshot", np.asarray(state[name]), size)
        if not np.isfinite(state[name]).all():
            raise ConfigError(f"fluid: {name} of a snapshot is not finite; take one from before the water blew up")


def step_for(lattice: Lattice, speed: float) -> float:
    """Longest time step [s] that keeps `speed` within the Mach limit. Below one bus tick it is a divisor of the tick."""
    longest = MACH * lattice.dx / (speed * sqrt(3))
    return longest if longest > TICK else TICK / ceil(TICK / longest)


@dataclass
class StabilityMonitor:
    """Checks a fluid every `every` steps of its coarsest level and stops it before it writes nonsense.

    `check` waits for the device. `begin` does not wait; `end` judges its survey once the device has finished it.

    Raises:
        ConfigError: `every` is not a whole number of 1 at least.
        OracleUnstable: from `check` and `end`, with `limit` one of lost, speed, density, mass.
    """

    every: int = EVERY
    fastest: float = 0.0  # greatest speed seen, m/s
    speed: float = 0.0  # greatest of the last survey, m/s
    looks: int = 0
    pending: tuple | None = None  # fluid and step of a look that was begun

    def __post_init__(self):
        whole_numbers("watch: every", self.every, low=1)

    def due(self, fluid, since: int = 1) -> bool:
        """Returns True if the present step, or one of the last `since` steps, is a step to check."""
        return fluid.steps % (self.every * RATIO ** (len(fluid.levels) - 1)) < since

    def after_step(self, fluid, since: int = 1) -> bool:
        """Checks the fluid if a check is due; call it after each step, or after `since` of them.

        Returns True if it checked and found no fault. Raises OracleUnstable.
        """
        if not self.due(fluid, since):
            return False
        self.check(fluid)
        return True

    def check(self, fluid):
        """Surveys the fluid and judges the survey. Raises OracleUnstable."""
        self.pending = None
        return self._judge(fluid, fluid.steps, fluid.survey())

    def begin(self, fluid) -> None:
        """Queues a survey that `end` judges."""
        fluid.begin_survey()
        self.pending = fluid, fluid.steps

    def end(self):
        """Judges the survey that was begun; the device must have finished it. Raises OracleUnstable.

        It also waits for a step of the same fluid that was begun later.
        """
        if self.pending is not None:
            (fluid, step), self.pending = self.pending, None
            return self._judge(fluid, step, fluid.surveyed())

    def _judge(self, fluid, step: int, found):
        self.looks += 1
        mean = found.mass / fluid.cells
        speed = self.speed = found.speed * fluid.lattice.velocity
        broken = {  # in this order
            "lost": found.lost or isnan(found.speed),
            "speed": found.speed > SPEED_LU,
            "density": not (found.rho_min > RHO[0] and found.rho_max < RHO[1]),
            "mass": abs(mean) > MEAN_DRHO,
        }
        if limit := next((name for name, found_so in broken.items() if found_so), ""):
            raise OracleUnstable(_limit_message(limit, fluid, step, found, speed, mean), limit=limit)
        self.fastest = max(self.fastest, speed)
        return found


def _limit_message(limit: str, fluid, step: int, found, speed: float, mean: float) -> str:
    lat = fluid.lattice
    slower = lat.dt / 2
    what = {
        "lost": f"{found.lost} of {fluid.cells} nodes are not finite",
        "speed": f"{speed:.2f} m/s is Mach {lat.mach(speed):.2f}; the hard stop is {SPEED_LU * lat.velocity:.2f} m/s",
        "density": f"density {found.rho_min:.3f} to {found.rho_max:.3f}; expected {RHO[0]} to {RHO[1]}",
        "mass": f"mean density is off by {mean:+.4f}; expected less than {MEAN_DRHO}",
    }[limit]
    return f"fluid: at step {step}, t = {step * lat.dt:.3f} s: {what}. dt = {slower:.4g} s would halve every Mach number"
