"""A run whose fish is in a box of finer cells: its checkpoints, and ticks done again with finer steps, are of both levels.

The fine level's part is `time_refinement`'s; here the coarse level follows it.
"""

from collections.abc import Generator, Iterator
from typing import NamedTuple, cast

import numpy as np
import warp as wp

from fishmj.errors import ConfigError, OracleUnstable, SimDiverged
from fishmj.lbm_oracle.refined.refined_fluid import RATIO
from fishmj.lbm_oracle.refined.refined_structure import RefinedStructure
from fishmj.lbm_oracle.run.run import CAUTION, Run
from fishmj.lbm_oracle.run.time_refinement import FACTORS, Refinement, Steps, Tick, TickState, hand_over, restore


class OuterState(NamedTuple):
    """The coarse water at the start of a tick, on its device."""

    f: wp.array
    u: wp.array
    origin_lu: np.ndarray
    steps: int


class RefinedRefinement(Refinement):
    """`Refinement` for both levels: a tick is done again from `kept`, set at its start, with finer steps on each."""

    coupled: RefinedStructure
    kept: OuterState | None = None

    def keep(self) -> None:
        """Copy the coarse water."""
        outer = self.coupled.fluid.outer
        with self.coupled.scope():
            self.kept = OuterState(wp.clone(outer.f), wp.clone(outer.u), outer.origin_lu.copy(), outer.steps)

    def redo(self, kept: TickState, factors: tuple[int, ...], steps: Steps) -> Generator[None, None, Tick | None]:
        """As `Refinement.redo`.

        Raises:
            SimDiverged, OracleUnstable: what the finest steps raised.
        """
        for factor in factors:
            restore(self.coupled, kept)
            self._restore_outer()
            fine = self._fine(factor)
            hand_over_both(self.coupled, fine)
            fine.take_wrench(1.0)  # what an attempt that was given up had summed
            try:
                done = yield from steps(fine, factor)
            except (SimDiverged, OracleUnstable):
                if factor == FACTORS[-1]:
                    raise
                continue
            if done is not None:
                hand_over_both(fine, self.coupled)
                return done
        return None

    def _restore_outer(self) -> None:
        outer, kept = self.coupled.fluid.outer, self.kept
        if kept is None:
            raise OracleUnstable("refined: no checkpoint of the coarse water; take half the dt", limit="mach")
        with self.coupled.scope():
            wp.copy(outer.f, kept.f)
            wp.copy(outer.u, kept.u)
            outer._place(kept.origin_lu.copy())
            outer.steps = kept.steps
            outer.clock.fill_(kept.steps)

    def _fine(self, factor: int) -> RefinedStructure:
        if factor not in self._finer:
            old = self.coupled
            water = old.fluid.finer_levels(factor)
            old.body.set_step(water.lattice.dt)
            same = {"slip": old.slip, "width": old.boundary.width, "passes": old.boundary.passes}
            same |= {"scheme": old.scheme, "interior": old.interior}
            self._finer[factor] = RefinedStructure(water, old.body, old.boundary.markers, **same)
        return cast(RefinedStructure, self._finer[factor])


def hand_over_both(giver: RefinedStructure, taker: RefinedStructure) -> None:
    """Move fish and both levels of water from one time step to the other."""
    hand_over(giver, taker)
    with taker.scope():
        taker.fluid.take_outer(giver.fluid)
    if giver.fluid.device.is_cuda:
        wp.synchronize_device(giver.fluid.device)  # each has its own stream
    taker.steps = taker.fluid.steps  # an attempt that was given up ended anywhere: looks shall fall between two coarse steps


class RefinedRun(Run):
    """A `Run` in refined water; arguments as there.

    Raises:
        ConfigError: a bus tick is no whole number of coarse steps.
    """

    def __init__(self, coupled: RefinedStructure, *args, **options):
        super().__init__(coupled, *args, **options)
        if self.steps % RATIO:
            dt, tick = coupled.fluid.outer.lattice.dt, self.robot.timing.bus_dt
            raise ConfigError(f"run: the bus tick of {tick} s is no multiple of the coarse dt = {dt:g} s; take {tick / 5:g} s")
        self._refinement: RefinedRefinement = RefinedRefinement(coupled)

    def ticking(self, command=None) -> Iterator[None]:
        if self.fastest > CAUTION * self.limit or self.ticks < self.alert:
            self._refinement.keep()
        yield from super().ticking(command)
