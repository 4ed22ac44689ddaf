"""Observed order of convergence of a number of your own, and its uncertainty, from three grids.

    (f3 - f2) / (f2 - f1) = (r32^p - 1) / (r21^p - 1) r21^p,   r = dx ratios, f1 on the finest grid        solved for p
    f0 = f1 + (f1 - f2) / (r21^p - 1)                                                                      dx -> 0
    U = 1.25 |f1 - f0|                     a monotonic series with 0.5 <= p <= 2.5: grid convergence index of the finest grid
    U = 3 |f2 - f3| / (r32^2 - 1) / r21^2  p > 2.5 is not believed: what the coarse pair leaves by the scheme's order 2
    U = 3 (greatest - least)               a series that turns, or p < 0.5: no order, no limit
    none                                   p <= 0: the differences grow, an estimate from them would mean nothing

Sources: Celik et al. 2008, J. Fluids Eng. 130:078001 (index and its factor for three grids); Eca and Hoekstra 2014, J. Comput.
Phys. 262:104 (the range where no order fits, the factor 3, and that an order far
from the scheme's is not believed). Neither was read here.
"""

from collections.abc import Callable, Sequence
from math import log, nan
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.lbm_oracle.fluid.guard import numbers

SAFETY, RANGE = 1.25, 3.0
ORDERS, SCHEME = (0.5, 2.5), 2.0  # observed orders that are believed; order of the scheme
MOST = 20.0  # an order beyond it is called that
LEAST_RATIO = 1.1


class GridStudy(NamedTuple):
    """Three grids, the finest last; `uncertainty`: of the finest value, +-, by the grid alone.

    NaN stands for what the series does not tell; a `limit` is given for an order that is believed.
    """

    dx: tuple[float, ...]
    values: tuple[float, ...]
    order: float
    limit: float
    uncertainty: float

    def __str__(self) -> str:
        """The table and the verdict, in lines."""
        rows = [f"dx = {dx:<10.4g} {_digits(value, 5)}" for dx, value in zip(self.dx, self.values, strict=True)]
        found = f"order {self.order:.2f}, limit {_digits(self.limit, 4)}"
        if self.order != self.order:
            found = "the series turns, or its order is below 0.5: three times its range"
        elif self.limit != self.limit:
            found = f"order {self.order:.2f} is above {ORDERS[1]} and not believed: three times what order {SCHEME:g} leaves"
        if self.uncertainty != self.uncertainty:
            found = "the differences grow: not yet in the range where the error falls with the cell; take smaller ones"
            return "\n".join([*rows, f"{_digits(self.values[-1], 4)}, no uncertainty ({found})"])
        return "\n".join([*rows, f"{_digits(self.values[-1], 4)} +- {self.uncertainty:.2g} by the grid alone ({found})"])


def grid_study(function: Callable[[float], float], dx: Sequence[float]) -> GridStudy:
    """Calls `function(dx)` on three grids, coarse to fine; returns values, observed order, limit and uncertainty.

    The physical problem must be the same on all of them: the box, the time over which is averaged, Reynolds and Mach number.

    Raises ConfigError: not three cells that fall by a factor of 1.1 or more each; a value that is not finite.
    """
    sizes = numbers("grid study: dx", dx, (3,), low=1e-300)
    if (sizes[:-1] < LEAST_RATIO * sizes[1:]).any():
        raise ConfigError(f"grid study: dx = {sizes.tolist()}; expected three cells, each {LEAST_RATIO} times the next or more")
    values = []
    work = np.cumsum(1 / sizes**3)  # cells times steps of a flow in the plane
    with console.Progress(float(work[-1]), "grid study", unit="cells^3") as bar:
        for i, size in enumerate(sizes):
            bar.stage(f"dx = {size:g}, {i + 1} of 3")
            values.append(float(numbers(f"grid study: value at dx = {size:g}", function(float(size)))))
            bar.update(float(work[i]))
    return judged(tuple(sizes.tolist()), tuple(values))


def judged(dx: tuple[float, ...], values: tuple[float, ...]) -> GridStudy:
    """Order, limit and uncertainty of three values, the finest last."""
    (h3, h2, h1), (f3, f2, f1) = dx, values
    spread = RANGE * (max(values) - min(values))
    if (f3 - f2) * (f2 - f1) <= 0:  # it oscillates, or stands still
        return GridStudy(dx, values, nan, nan, spread)
    if log(h2 / h1) * abs(f3 - f2) <= log(h3 / h2) * abs(f2 - f1):  # no order above 0
        return GridStudy(dx, values, nan, nan, nan)
    fits = lambda p: log((f3 - f2) / (f2 - f1)) - log((h3**p - h2**p) / (h2**p - h1**p))
    low, high = ORDERS
    if fits(low) < 0:
        return GridStudy(dx, values, nan, nan, spread)
    order = float(brentq(fits, low, MOST)) if fits(MOST) < 0 else MOST
    if order > high:
        return GridStudy(dx, values, order, nan, RANGE * abs(f2 - f3) / ((h3 / h2) ** SCHEME - 1) / (h2 / h1) ** SCHEME)
    limit = f1 + (f1 - f2) / ((h2 / h1) ** order - 1)
    return GridStudy(dx, values, order, limit, SAFETY * abs(f1 - limit))


def _digits(value: float, count: int) -> str:
    """`value` to `count` digits, the last zeros among them."""
    return f"{value:#.{count}g}".rstrip(".")
