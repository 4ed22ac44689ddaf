"""A run whose fish is in a box of finer cells: its checkpoints, and ticks done again with finer steps, are of both levels.

The fine level's part is `time_refinement`'s; here the coarse level follows it.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import warp as wp

from fishmj.errors import ConfigError, OracleUnstable
from fishmj.lbm_oracle.refined.refined_fluid import RATIO, RefinedFluid
from fishmj.lbm_oracle.refined.refined_structure import RefinedStructure
from fishmj.lbm_oracle.run.run import CAUTION, Run
from fishmj.lbm_oracle.run.time_refinement import Refinement, TickState


class OuterState(NamedTuple):
    """The coarse water at the start of a tick, on its device."""

    f: wp.array
    u: wp.array
    origin_lu: np.ndarray
    steps: int


class RefinedRefinement(Refinement):
    """`Refinement` for both levels: a tick is done again from `kept`, set at its start, with finer steps on each."""

    structure = RefinedStructure
    coupled: RefinedStructure
    kept: OuterState | None = None

    def keep(self) -> None:
        """Copy the coarse water."""
        outer = self.coupled.fluid.outer
        with self.coupled.scope():
            self.kept = OuterState(wp.clone(outer.f), wp.clone(outer.u), outer.origin_lu.copy(), outer.steps)

    def restore(self, kept: TickState) -> None:
        super().restore(kept)
        outer, water = self.coupled.fluid.outer, self.kept
        if water is None:
            raise OracleUnstable("refined: no checkpoint of the coarse water; take half the dt", limit="mach")
        with self.coupled.scope():
            wp.copy(outer.f, water.f)
            wp.copy(outer.u, water.u)
            outer._place(water.origin_lu.copy())
            outer.steps = water.steps
            outer.clock.fill_(water.steps)

    def hand_over(self, giver, taker) -> None:
        """Fish and both levels of water."""
        super().hand_over(giver, taker)
        with taker.scope():
            taker.fluid.take_outer(giver.fluid)
        if giver.fluid.device.is_cuda:
            wp.synchronize_device(giver.fluid.device)  # each has its own stream
        taker.steps = taker.fluid.steps  # an attempt that was given up ended anywhere: looks shall fall between two coarse steps

    def finer_water(self, factor: int) -> RefinedFluid:
        return self.coupled.fluid.finer_levels(factor)


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
