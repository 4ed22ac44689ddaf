"""The three kernels of a step: a cell, a row or a pair of cells a thread compute the same numbers to the bit."""

import numpy as np
import pytest

wp = pytest.importorskip("warp")

from fishmj.flow import Flow
from fishmj.lbm_oracle.fluid import fluid
from fishmj.lbm_oracle.fluid.domain_faces import Axis, Boundaries, channel
from fishmj.lbm_oracle.fluid.fluid import Fluid, kernel_for
from fishmj.lbm_oracle.fluid.lattice import Lattice
from fishmj.lbm_oracle.fluid.pairs import split_by, stream_collide_pairs
from fishmj.lbm_oracle.fluid.rows import stream_collide_rows
from fishmj.lbm_oracle.fluid.step import stream_collide

pytestmark = pytest.mark.oracle
SHAPE = (12, 11, 34)  # a row of more cells than are collided at once
TURBULENT = Flow(speed=0.2, direction=0.5, turbulence="default", seed=3)
OPEN = {"boundaries": channel(sponge=3), "flow": TURBULENT}
HALF = {"subgrid": "none", "dtype": "float16", "keep_velocity": False}
SIDES = {"x": Axis("open", "wall"), "y": Axis("slip", "moving"), "z": Axis("wall", "slip")}
WALLS = {"boundaries": Boundaries(**SIDES, sponge=3, wall_velocity_lu=(0.02, 0.0, 0.01)), "subgrid": "none"}
THREADS = {stream_collide: 11 * 34, stream_collide_rows: 11, stream_collide_pairs: 11 * 17}  # a plane of x


def water(make, monkeypatch, options) -> Fluid:
    """Stirred and pushed for some steps, before and after its window moved."""
    monkeypatch.setattr(fluid, "kernel_for", lambda shape, device: (make, THREADS[make]))
    found = Fluid(Lattice(dx=0.02, dt=0.004), SHAPE, "cpu", threads=1, **options)
    rng = np.random.default_rng(1)
    found.impose(0.05 * rng.standard_normal((*SHAPE, 3)))
    found.force.assign(rng.uniform(-0.01, 0.01, (*SHAPE, 3)).astype(np.float32))
    for _ in range(3):
        found.step(((3, 3, 2), (10, 9, 7)))
    found.shift((2, -1, 3))
    for _ in range(4):
        found.step(((4, 3, 5), (11, 8, 31)))
    return found


def assert_same(one: Fluid, other: Fluid) -> None:
    assert np.isfinite(one.f.numpy()).all() and np.abs(one.velocity()).max() > 0.01
    assert np.array_equal(one.f.numpy(), other.f.numpy())
    assert np.array_equal(one.u.numpy(), other.u.numpy())
    assert one.clock.numpy() == other.clock.numpy() == 7


@pytest.mark.parametrize("make", [stream_collide_rows, stream_collide_pairs])
def test_rows_and_pairs_do_what_cells_do_in_a_turbulent_stream(make, monkeypatch):
    assert_same(water(stream_collide, monkeypatch, OPEN), water(make, monkeypatch, OPEN))


@pytest.mark.slow
@pytest.mark.parametrize("options", [HALF, WALLS], ids=["half precision", "walls"])
@pytest.mark.parametrize("make", [stream_collide_rows, stream_collide_pairs])
def test_rows_and_pairs_do_what_cells_do_behind_other_faces(make, options, monkeypatch):
    assert_same(water(stream_collide, monkeypatch, options), water(make, monkeypatch, options))


@pytest.mark.parametrize("divisor", [1, 2, 3, 7, 50, 64, 1000, 2**20 + 1, 2**30 + 5, 2**31 - 1])
def test_a_product_and_a_shift_divide_exactly(divisor):
    magic, shift = split_by(divisor)
    assert -(2**31) <= magic < 2**31
    tried = np.random.default_rng(divisor).integers(0, 2**31, 2000).tolist()
    tried += [at for k in (0, 1, (2**31 - 1) // divisor) for at in (k * divisor - 1, k * divisor) if 0 <= at < 2**31]
    assert all(n // divisor == n * (magic % 2**32) >> shift for n in (*tried, 2**31 - 1))


def test_a_large_box_on_a_cpu_goes_by_rows_and_an_accelerator_by_pairs_where_it_can():
    class Device:
        def __init__(self, is_cuda: bool):
            self.is_cuda = is_cuda

    assert kernel_for((80, 56, 30), Device(False)) == (stream_collide_rows, 56)
    assert kernel_for((8, 8, 8), Device(False)) == (stream_collide, 64)
    assert kernel_for((200, 200, 50), Device(True)) == (stream_collide_pairs, 200 * 25)
    assert kernel_for((20, 20, 5), Device(True)) == (stream_collide, 100)
