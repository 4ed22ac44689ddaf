"""The far water that goes ahead: near and far parts are all of it, and together one step."""

import numpy as np
import pytest

from fishmj.lbm_oracle.ahead import BLOCK, parts
from fishmj.lbm_oracle.cases.coupled_fish import beat, pond


@pytest.mark.parametrize("first", range(-30, 90, 7))
@pytest.mark.parametrize("count", [1, 20, 43, 60, 80])
def test_near_and_far_planes_are_all_of_them_once_and_the_near_ones_hold_the_force(first, count):
    near, far = parts(first, count, 64)
    planes = np.concatenate([np.arange(low, high) for low, high in near + far])
    assert sorted(planes) == list(range(64))
    inside = np.concatenate([np.arange(low, high) for low, high in near])
    assert set(np.arange(first, first + count) % 64) <= set(inside)
    assert len(inside) <= count + 2 * BLOCK


def test_far_planes_first_and_near_ones_after_the_force_make_the_same_step_to_the_bit():
    ends = []
    for split in (False, True):
        coupled = pond("cpu")
        beat(coupled, 0.1, every=1000)
        fluid, edge = coupled.fluid, coupled.boundary
        if split:
            edge.place(coupled.body)
            near, far = parts(int(edge.view["box"][0]), edge.box_shape[0], fluid.shape[0])
            assert far
            ahead, behind = ([fluid.record(*span) for span in spans] for spans in (far, near))

            def advance(ahead=ahead, behind=behind, fluid=fluid):
                for launch in behind:
                    launch.launch()
                fluid.parity, fluid.steps = 1 - fluid.parity, fluid.steps + 1

            fluid.advance = advance
            for launch in ahead:
                launch.launch()
        coupled.step()
        ends.append((fluid.f.numpy(), fluid.u.numpy(), fluid.clock.numpy(), coupled.body.data.qvel.copy()))
    for one, two in zip(*ends, strict=True):
        np.testing.assert_array_equal(one, two)
