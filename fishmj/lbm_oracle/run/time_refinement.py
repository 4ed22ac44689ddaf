"""Repeats a tick that is too fast for the grid's time step from its start with a finer step; the trial continues.

    dt' = r dt, r = 1/2 or 1/4:   rho' - 1 = r^2 (rho - 1),   u' = r u,   P' = r P

Pressure rho c_s^2 dx^2 / dt^2 and velocity u dx / dt stay unchanged. The non-equilibrium stress P is a rate of strain and scales
like u if the collision relaxes fully (tau near 1/2, as in water). Mach numbers fall by r. The finer water has the same cells, and
its memory is allocated at the first use. In refined water all levels are copied, repeated and handed over.

Flow near Mach 0 stays the same, sound does not: its speed c = c_s dx / dt is 1 / r times as large, its potential energy
P^2 / (2 rho c^2) is r^2 times as large, its kinetic energy the same. A wave has as much of one as of the other: it loses 3/8 of
its energy with r = 1/2 and gains 3/2 with r = 2, there and back a factor of 1.56 in the mean over phases. So finer steps stay
for a while (`STAY`).
"""

from collections.abc import Callable, Generator
from functools import cache
from typing import NamedTuple

import numpy as np
import warp as wp

from fishmj.base.errors import OracleUnstable, SimDiverged
from fishmj.lbm_oracle.fluid.collide import density, momentum, non_equilibrium_stress, reconstruct
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.in_kernels import vec19
from fishmj.lbm_oracle.fluid.lattice import Q
from fishmj.lbm_oracle.fluid.storage import peek, peek3, poke, poke3
from fishmj.lbm_oracle.immersed.coupling import FluidStructure

FACTORS = (2, 4)  # finer steps in one
STAY = 1.0  # s of finer steps after the last tick that needed them

Tick = tuple[float, np.ndarray, np.ndarray]  # servo power W, link wrenches raw and whole
Steps = Callable[[FluidStructure, int], Generator[None, None, Tick | None]]


@cache
def _rescale(dtype: type, velocity: type) -> wp.Kernel:
    """Kernel for populations and velocities that are stored in these types."""

    @wp.kernel(module="unique", module_options={"max_unroll": 32, "enable_backward": False})
    def rescale(
        f: wp.array(dtype=dtype),
        u: wp.array(dtype=velocity),
        r: float,
        f_out: wp.array(dtype=dtype),
        u_out: wp.array(dtype=velocity),
    ):
        """Converts the moments of every cell to another time step."""
        cell = wp.tid()
        cells = u.shape[0]
        q = vec19()
        for i in range(wp.static(Q)):
            q[i] = peek(f, i * cells + cell)
        drho = density(q)
        v = momentum(q) / (1.0 + drho)
        q = reconstruct(r * r * drho, r * v, r * v, r * non_equilibrium_stress(q, drho, v))
        for i in range(wp.static(Q)):
            poke(f_out, i * cells + cell, q[i])
        poke3(u_out, cell, r * peek3(u, cell))

    return rescale


class LevelState(NamedTuple):
    """Water of one level at the start of a tick, still on its device."""

    f: wp.array
    u: wp.array
    origin_lu: np.ndarray
    steps: int


class TickState(NamedTuple):
    """State of a coupled fish at the start of a tick, the water still on its device."""

    levels: tuple[LevelState, ...]  # the finest first
    body: tuple  # qpos, qvel, ctrl, time, momentum, interior speed, momentum of the layers
    gain: np.ndarray
    wrench: wp.array
    done: int


def checkpoint(coupled: FluidStructure) -> TickState:
    """Copies everything on which the next step depends, on all levels of the water."""
    body, data = coupled.body, coupled.body.data
    solid = data.qpos.copy(), data.qvel.copy(), data.ctrl.copy(), data.time
    solid += body.momentum.copy(), body.interior_speed.copy(), body.layer_momentum.copy()
    with coupled.scope():
        water = tuple(LevelState(wp.clone(x.f), wp.clone(x.u), x.origin_lu.copy(), x.steps) for x in coupled.fluid.levels)
        return TickState(water, solid, coupled.gain.copy(), wp.clone(coupled.boundary.wrench), coupled.steps)


def restore(coupled: FluidStructure, kept: TickState) -> None:
    """Goes back to a checkpoint, and to the coupled fish's own time step."""
    fluid, body, data = coupled.fluid, coupled.body, coupled.body.data
    body.set_step(fluid.lattice.dt)
    with coupled.scope():
        wp.copy(coupled.boundary.wrench, kept.wrench)
        for level, water in zip(fluid.levels, kept.levels, strict=True):
            wp.copy(level.f, water.f)
            wp.copy(level.u, water.u)
            _set_place(level, water.origin_lu, water.steps)
    qpos, qvel, data.ctrl[:], data.time, momentum_before, interior_speed, layers_before = kept.body
    body.place(qpos, qvel, interior_speed)
    body.layer_momentum[:] = layers_before
    body.momentum[:], coupled.gain, coupled.steps = momentum_before, kept.gain.copy(), kept.done


class Refinement:
    """Repeats ticks of one coupled fish in waters with finer steps, and says how many ticks after those have finer steps too.

    Args:
        coupled: fish and water. stay: ticks for which a factor stays after the last one that needed it.

    Attributes:
        least: factor that the next ticks have at least. until: number of the tick from which half of it does; of a factor of 1,
            that until which checkpoints are kept.
    """

    def __init__(self, coupled: FluidStructure, stay: int):
        self.coupled, self.stay = coupled, stay
        self._finer: dict[int, FluidStructure] = {}
        self.begin()

    def begin(self) -> None:
        """Starts with the grid's own steps."""
        self.least, self.until = 1, 0

    def least_at(self, tick: int) -> int:
        """Least factor of tick number `tick`, the next one."""
        if self.least > 1 and tick >= self.until:
            self.least, self.until = self.least // FACTORS[0], tick + self.stay
        return self.least

    def note(self, tick: int, factor: int, speed: float) -> None:
        """Notes that a tick was done with `factor`; marker or water were at `speed` times the limit of the grid's own steps."""
        if factor > self.least or speed > self.least / FACTORS[0]:
            self.least, self.until = factor, tick + self.stay

    def redo(self, kept: TickState, factors: tuple[int, ...], steps: Steps) -> Generator[None, None, Tick | None]:
        """Repeats the tick from its checkpoint with the first of `factors` that is fine enough.

        None: a marker is too fast for all. Raises SimDiverged, OracleUnstable: the error of the finest steps. Without a result
        fish and water stand at the start of the tick again.
        """
        done = None
        try:
            for factor in factors:
                restore(self.coupled, kept)
                fine = self.finer(factor)
                hand_over(self.coupled, fine)
                fine.take_wrench(1.0)  # the sum of an attempt that was given up
                try:
                    done = yield from steps(fine, factor)
                except (SimDiverged, OracleUnstable):
                    if factor == FACTORS[-1]:
                        raise
                    continue
                if done is not None:
                    hand_over(fine, self.coupled)
                    break
        finally:
            if done is None:
                restore(self.coupled, kept)
        return done

    def finer(self, factor: int) -> FluidStructure:
        """The same body in water with steps shorter by `factor`; its state is not set, its background flow is the present one.

        It is made once, because its arrays are as large as the first ones.
        """
        if factor not in self._finer:
            old = self.coupled
            water = old.fluid.finer(factor)
            old.body.set_step(water.lattice.dt)
            same = {"slip": old.slip, "width": old.boundary.width, "passes": old.boundary.passes}
            same |= {"scheme": old.scheme, "interior": old.interior}
            self._finer[factor] = type(old)(water, old.body, old.boundary.markers, **same)
        if (fine := self._finer[factor]).fluid.flow is not self.coupled.fluid.flow:
            with fine.scope():
                fine.fluid.set_flow(self.coupled.fluid.flow)
        return fine


def hand_over(giver: FluidStructure, taker: FluidStructure) -> None:
    """Moves fish and water from one time step to the other; wrenches stay with the fish that summed them."""
    r = taker.fluid.lattice.dt / giver.fluid.lattice.dt
    taker.wait_for_stream_of(giver)
    with taker.scope():
        for a, b in zip(giver.fluid.levels, taker.fluid.levels, strict=True):
            inputs = [a.f.flatten(), a.u.flatten(), r, b.f.flatten(), b.u.flatten()]
            wp.launch(_rescale(a.f.dtype, a.u.dtype), dim=a.cells, inputs=inputs, device=a.device)
            _set_place(b, a.origin_lu, round(a.steps / r))
        if len(taker.fluid.levels) > 1:  # an attempt may be given up after any step: looks shall fall between two coarse steps
            taker.steps = taker.fluid.steps
    giver.wait_for_stream_of(taker)
    body = taker.body
    now = body.water_momentum()
    body.momentum[:] = now - r * (now - body.momentum)  # the interior water's gain is one of the new, other step
    body.layer_momentum[:] = body.sheet_momentum - r * (body.sheet_momentum - body.layer_momentum)
    body.set_step(taker.fluid.lattice.dt)


def _set_place(level: Fluid, origin_lu: np.ndarray, steps: int) -> None:
    level._place(origin_lu.copy())  # a finer box also keeps, on the device, where it lies in the coarser water
    level.steps = int(steps)
    level.clock.fill_(level.steps)
