"""Run of a fish in a box of finer cells: checkpoints, and ticks repeated with finer steps, include all levels.

`time_refinement` handles the finest level; the coarser levels follow it here. `in_levels` makes such a run of any `Run`.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
import warp as wp

from fishmj.base.errors import ConfigError, OracleUnstable
from fishmj.lbm_oracle.immersed.coupling import FluidStructure
from fishmj.lbm_oracle.refined.refined_fluid import RATIO, RefinedFluid
from fishmj.lbm_oracle.refined.refined_structure import RefinedStructure
from fishmj.lbm_oracle.run.run import CAUTION, Run
from fishmj.lbm_oracle.run.time_refinement import Refinement, TickState

R = TypeVar("R", bound=Run)


class OuterState(NamedTuple):
    """State of a coarser level at the start of a tick, on its device."""

    f: wp.array
    u: wp.array
    origin_lu: np.ndarray
    steps: int


def outer_states(coupled: FluidStructure) -> tuple[OuterState, ...]:
    """Copies of the coarser levels, the finer first; empty for water on one level."""
    if not isinstance(coupled, RefinedStructure):
        return ()
    with coupled.scope():
        return tuple(
            OuterState(wp.clone(level.f), wp.clone(level.u), level.origin_lu.copy(), level.steps)
            for level in coupled.fluid.levels[1:]
        )


def restore_outer(coupled: FluidStructure, kept: tuple[OuterState, ...]) -> None:
    """Restores the coarser levels from `outer_states`."""
    if not isinstance(coupled, RefinedStructure):
        return
    with coupled.scope():
        for level, water in zip(coupled.fluid.levels[1:], kept, strict=True):
            wp.copy(level.f, water.f)
            wp.copy(level.u, water.u)
            level._place(water.origin_lu.copy())
            level.steps = water.steps
            level.clock.fill_(water.steps)


class RefinedRefinement(Refinement):
    """`Refinement` for all levels: a tick is repeated from `kept`, set at its start, with finer steps on each level."""

    structure = RefinedStructure
    coupled: RefinedStructure
    kept: tuple[OuterState, ...] = ()

    def keep(self) -> None:
        """Copies the coarser water."""
        self.kept = outer_states(self.coupled)

    def restore(self, kept: TickState) -> None:
        """Restores all levels to the start of the tick. Raises OracleUnstable if the coarse water was not copied."""
        super().restore(kept)
        if not self.kept:
            raise OracleUnstable("refined: no checkpoint of the coarse water; take half the dt", limit="mach")
        restore_outer(self.coupled, self.kept)

    def hand_over(self, giver, taker) -> None:
        """Moves the fish and all levels of water from one time step to the other."""
        super().hand_over(giver, taker)
        with taker.scope():
            taker.fluid.take_outer(giver.fluid)
        giver.come_behind(taker)
        taker.steps = taker.fluid.steps  # an attempt that was given up ended anywhere: looks shall fall between two coarse steps

    def finer_water(self, factor: int) -> RefinedFluid:
        """Water on all levels with steps shorter by `factor`."""
        return self.coupled.fluid.finer_levels(factor)


class OfLevels(Run):
    """Mixin for runs in refined water; a base class before the kind of run (`in_levels`).

    Raises:
        ConfigError: a bus tick is not a whole number of steps of the coarsest water.
    """

    _refinement: RefinedRefinement

    def __init__(self, *args, **options):
        super().__init__(*args, **options)
        coupled = cast(RefinedStructure, self.coupled)
        if self.steps % RATIO ** (len(coupled.fluid.levels) - 1):
            dt, tick = coupled.fluid.levels[-1].lattice.dt, self.robot.timing.bus_dt
            raise ConfigError(f"run: the bus tick of {tick} s is no multiple of the coarse dt = {dt:g} s; take {tick / 5:g} s")
        self._refinement = RefinedRefinement(coupled)

    def ticking(self, command=None) -> Iterator[None]:
        """Advances one bus tick as `Run.ticking`; copies the coarser water first if the fish is fast."""
        if self.fastest > CAUTION * self.limit or self.ticks < self.alert:
            self._refinement.keep()
        yield from super().ticking(command)


class RefinedRun(OfLevels, Run):
    """A `Run` in refined water; same arguments."""


_KINDS: dict[type, Any] = {Run: RefinedRun}


def in_levels(kind: Callable[..., R]) -> Callable[..., R]:
    """Class of that kind of run with ticks on all levels: `in_levels(Run)(coupled, robot)` for a fish in a box of finer cells."""
    named = cast(type, kind)
    if named not in _KINDS:
        _KINDS[named] = type(f"Refined{named.__name__}", (OfLevels, named), {})
    return _KINDS[named]


def run_of(coupled: FluidStructure, kind: Callable[..., R]) -> Callable[..., R]:
    """Class of a run of this fish: `kind`, or `in_levels(kind)` if its water has several levels."""
    return in_levels(kind) if isinstance(coupled, RefinedStructure) else kind
