"""The figures of the check for a water of MuJoCo's kind: the same swims, windows and free runs as `check.judge`."""

from collections.abc import Sequence
from typing import NamedTuple

from fishmj.hydro_fit import free_swims
from fishmj.hydro_fit.fit.gauss_newton import flaps
from fishmj.hydro_fit.fit.rollout import fish_batch_of, is_free, recorded
from fishmj.hydro_fit.free_swims import _from as late_means
from fishmj.hydro_fit.mujoco_ellipsoid.ellipsoid_fit import Fitted, forces
from fishmj.hydro_fit.mujoco_ellipsoid.ellipsoid_swim import Bound
from fishmj.hydro_fit.record import SegmentRecord
from fishmj.mjcf.description import Robot
from fishmj.water.dynamics import planar_chain, strip_forces


class FreeRunStart(NamedTuple):
    """Attributes of a model that `free_swims.FreeSwims` needs to start a free run.

    The ellipsoids have no memory and ignore them.
    """

    base: strip_forces.Coefficients
    learnt: None = None


class EllipsoidFreeSwims(free_swims.FreeSwims):
    """All free swims of some records, whole and settled, and the free runs."""

    def __init__(self, water: Fitted, robot: Robot, records: Sequence[SegmentRecord]):
        self.records = [r for r in records if is_free(r)]
        ch, settled = planar_chain.chain_of(robot), round(free_swims.SETTLED / records[0].tick)
        swim = Bound(water.swim(robot), water.flat)
        self.fleet = fish_batch_of(ch, robot, self.records, seconds=1e6)
        self.track = swim.run(self.fleet, water.flat)
        self.late, self.seen = (late_means(self.fleet, track, settled) for track in (self.track, recorded(self.fleet)))
        self.cruise, self.cruise_track = self._freerun(ch, robot, swim, FreeRunStart(planar_chain.nominal(robot).water))


def judge(water: Fitted, robot: Robot, records: Sequence[SegmentRecord]) -> dict:
    """{"figures", "n", "freerun_s"} as from `check.judge`, without error bar and guard, which this water does not have."""
    swims = EllipsoidFreeSwims(water, robot, records)
    got, n = free_swims.errors(swims, swims.late)
    held = [r for r in records if flaps(r)]
    force_of = lambda ch, rows, tick: forces(water.ellipsoids, rows, water.flat, water.inertia, tick)
    got["thrust_error"], n["thrust_error"] = free_swims.thrust_error(force_of, robot, held), len(held)
    got["freerun_position_error"], n["freerun_position_error"] = swims.freerun_error()
    return {"figures": got, "n": n, "freerun_s": float(swims.cruise.mask.sum(1).min() * records[0].tick)}
