"""How every link of the planar chain moves: its axes, and its velocity relative to the water."""

from typing import Any, NamedTuple


class Links(NamedTuple):
    """Kinematics of every link in head axes, one list entry a link."""

    t: list  # (tx, ty)
    n: list  # (nx, ny)
    omega: list  # yaw rate, relative to the water where that turns along the link
    u: list  # t.(V_i - U_i)
    w: list  # n.(V_i - U_i), U_i at the link's origin where the water turns, elsewhere at its centre
    bias: list  # A_i for zero generalised acceleration, (x, y)
    rates: Any = ()  # yaw rate in the world where omega is not that

    @property
    def own(self) -> list:
        """Yaw rate in the world."""
        return self.rates or self.omega
