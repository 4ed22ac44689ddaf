"""A step of the water in parts: far from the body early, near it when the force is known; the same numbers to the bit."""

from threading import Lock
from time import sleep

import numpy as np
import pytest
import warp as wp

from fishmj.base.errors import ConfigError
from fishmj.lbm_oracle.fluid.domain_faces import channel
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.lattice import Lattice
from fishmj.lbm_oracle.fluid.slabs import split_wrapped
from fishmj.lbm_oracle.immersed.early_water import EarlyWater
from fishmj.lbm_oracle.run.domain import Domain
from fishmj.lbm_oracle.run.setup import SwimSetup

wp.config.quiet = True


def stirred(threads: int) -> Fluid:
    """A window that has moved, with open faces and a sponge."""
    fluid = Fluid(Lattice(dx=0.02, dt=0.004), (40, 20, 10), "cpu", boundaries=channel(sponge=4), threads=threads)
    fluid.impose(0.1 * np.random.default_rng(1).standard_normal((40, 20, 10, 3)))
    fluid.shift((13, 0, 0))
    return fluid


def test_planes_in_any_order_are_a_step():
    one, other = stirred(1), stirred(1)
    for step in range(3):
        one.stream_collide()
        for first, count in ((25, 15), (0, 7), (7, 18))[:: 1 - 2 * (step % 2)]:
            other.planes(first, count).launch()
        other.skip(1)
    np.testing.assert_array_equal(other.f.numpy(), one.f.numpy())
    np.testing.assert_array_equal(other.u.numpy(), one.u.numpy())
    assert (other.steps, other.parity, other.clock.numpy()[0]) == (3, 1, 3)


@pytest.mark.parametrize("near", [(9, 12), (35, 12), (0, 40), (-3, 46)])
def test_early_and_late_parts_on_two_cores_are_all_the_water(near):
    one, other = stirred(1), stirred(2)
    early = EarlyWater(other)
    for _ in range(4):
        one.stream_collide()
        early.begin(*near)
        early.finish()
    np.testing.assert_array_equal(other.f.numpy(), one.f.numpy())
    assert other.account == one.account


def test_no_more_threads_than_cores_are_at_work():
    """Those of the early part may still be busy when the late one begins."""
    early, lock, busy, most, done = EarlyWater(stirred(2)), Lock(), [0], [0], []

    class Slow:
        def __init__(self, place):
            self.place = place

        def launch(self):
            with lock:
                busy[0] += 1
                most[0] = max(most[0], busy[0])
            sleep(0.002)
            with lock:
                busy[0] -= 1
                done.append(self.place)

    early._parts = lambda first, count, small=0: [Slow(first + k) for k in range(count)]
    for near in ((9, 12), (0, 40)):
        done.clear()
        early.begin(*near)
        sleep(0.003)
        early.finish()
        assert sorted(done) == sorted(set(done)) and len(done) == 40
    assert most[0] <= 2


def test_launches_are_recorded_once():
    domain = Domain(name="small", shape=(60, 40, 20), dx=0.02, dt=0.004, follows=True, sponge=4)
    coupled = SwimSetup(domain=domain, slip=0.99).coupled()
    known = coupled.boundary._recorded
    coupled.step(), coupled.step()
    first = len(known)
    for _ in range(6):
        coupled.step()
    assert len(known) == first > 0


def test_a_fish_swims_the_same_to_the_bit_whether_its_water_is_early():
    ends = []
    for threads in (1, 2):
        domain = Domain(name="small", shape=(60, 40, 20), dx=0.02, dt=0.004, follows=True, sponge=4)
        coupled = SwimSetup(domain=domain, slip=0.99).coupled()
        coupled.early = EarlyWater(coupled.fluid) if threads > 1 else None
        coupled.fluid.threads = threads
        coupled.body.data.ctrl[:] = (0.4, -0.2, 0.3)
        for _ in range(8):
            coupled.step()
        ends.append((coupled.body.data.qpos.copy(), coupled.fluid.f.numpy()))
    for mine, theirs in zip(*ends, strict=True):
        np.testing.assert_array_equal(mine, theirs)


def test_runs_of_an_array_that_wraps():
    assert split_wrapped(-3, 5, 10) == [(7, 3), (0, 2)]
    assert split_wrapped(23, 5, 10) == [(3, 5)]
    assert split_wrapped(5, 5, 10) == [(5, 5)] and split_wrapped(5, 0, 10) == []


def test_planes_outside_the_box_are_refused():
    with pytest.raises(ConfigError, match="planes 30 to 41 of 40"):
        stirred(1).planes(30, 11)
