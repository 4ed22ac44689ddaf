"""The three kernels of a step: a cell, a row or a pair of cells a thread compute the same numbers to the bit."""

from itertools import product

import numpy as np
import pytest

wp = pytest.importorskip("warp")

from fishmj.lbm_oracle.fluid import fluid
from fishmj.lbm_oracle.fluid.domain_faces import Axis, Boundaries, channel
from fishmj.lbm_oracle.fluid.fluid import Fluid, kernel_for
from fishmj.lbm_oracle.fluid.lattice import Lattice
from fishmj.lbm_oracle.fluid.pairs import split_by, stream_collide_pairs
from fishmj.lbm_oracle.fluid.rows import stream_collide_rows
from fishmj.lbm_oracle.fluid.step import stream_collide
from fishmj.lbm_oracle.fluid.storage import UNIT, decoded, encoded, peek3, peek3_pair, poke3, poke3_pair
from fishmj.water.flow import Flow

pytestmark = pytest.mark.oracle
GUARD, MARK = 64, 3  # cells on either side of an array, and what they hold
SHAPE = (12, 11, 34)  # two blocks of rows, of which the second is not full
TURBULENT = Flow(speed=0.2, direction=0.5, turbulence="default", seed=3)
OPEN = {"boundaries": channel(sponge=3), "flow": TURBULENT}
HALF = {"subgrid": "none", "dtype": "float16", "keep_velocity": False}
SIDES = {"x": Axis("open", "wall"), "y": Axis("slip", "moving"), "z": Axis("wall", "slip")}
WALLS = {"boundaries": Boundaries(**SIDES, sponge=3, wall_velocity_lu=(0.02, 0.0, 0.01)), "subgrid": "none"}
THREADS = {stream_collide: lambda shape: shape[1] * shape[2], stream_collide_rows: lambda shape: 1}  # a plane of x
THREADS[stream_collide_pairs] = lambda shape: shape[1] * shape[2] // 2


def water(make, monkeypatch, options, size=SHAPE) -> Fluid:
    """Stirred and pushed for some steps, before and after its window moved."""
    monkeypatch.setattr(fluid, "kernel_for", lambda shape, device: (make, THREADS[make](shape)))
    nu = 1e-3 if options.get("subgrid") == "none" else 1e-6  # without an eddy viscosity water itself is refused
    found = Fluid(Lattice(dx=0.02, dt=0.004, nu=nu), size, "cpu", threads=1, **options)
    rng = np.random.default_rng(1)
    found.impose(0.05 * rng.standard_normal((*size, 3)))
    found.force.assign(rng.uniform(-0.01, 0.01, (*size, 3)).astype(np.float32))
    for _ in range(3):
        found.step(((3, 3, 2), (10, 9, 7)))
    found.shift((2, -2, 3))  # both faces of y then lie inside a block of rows
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


@pytest.mark.parametrize("size", [(8, 40, 17), (11, 18, 8), (7, 8, 290)], ids=["runs on", "flat", "longer than a block"])
def test_rows_of_any_length_do_what_cells_do(size, monkeypatch):
    assert_same(water(stream_collide, monkeypatch, OPEN, size), water(stream_collide_rows, monkeypatch, OPEN, size))


def guarded(make, monkeypatch, options, shape, ghosts: int) -> Fluid:
    """Water between guard cells, stepped from the last plane to the first: a store outside its own plane is seen.

    `ghosts` cells at each end of an axis of more than two are not stepped, as those of a refined box.
    """
    monkeypatch.setattr(fluid, "kernel_for", lambda shape, device: (make, THREADS[make](shape)))
    found = Fluid(Lattice(dx=0.02, dt=0.004, nu=1e-3), shape, "cpu", threads=1, **options)
    rooms = []
    for arrays in (found._f, found._u):
        for k, kept in enumerate(arrays):
            room = wp.full(kept.size + 2 * GUARD, MARK, dtype=kept.dtype, device="cpu")
            arrays[k] = room[GUARD:-GUARD].reshape(kept.shape)
            rooms.append(room)
    rng, ends = np.random.default_rng(1), [ghosts if n > 2 else 0 for n in shape]
    found.params.low, found.params.high = wp.vec3i(*ends), wp.vec3i(*(n - end for n, end in zip(shape, ends, strict=True)))
    found.impose(0.05 * rng.standard_normal((*shape, 3)))
    if ghosts:
        found._f[1].assign(found._f[0]), found._u[1].assign(found._u[0])
    found.force.assign(rng.uniform(-0.01, 0.01, (*shape, 3)).astype(np.float32))
    for shift in ((0, 0, 0), (2, -2, 3)):
        found.shift(tuple(int(np.sign(by)) * min(abs(by), n - 1) for by, n in zip(shift, shape, strict=True)))
        found.set_box(((0, 1, 0), (2, 9, 7)))
        for _ in range(2):
            for x in reversed(range(shape[0])):
                found.planes(x, 1).launch()
            found.skip(1)
    for room in rooms:
        ends = room.numpy()[[*range(GUARD), *range(-GUARD, 0)]]
        assert (ends == ends[0]).all() and (ends[0] == MARK).all(), f"a store outside the array of {shape}"
    return found


def assert_same_as_cells(make, options, least, monkeypatch) -> None:
    """Compares all boxes of one to three cells a side, and others beside the lengths of a vector and a block, from `least` on."""
    shapes = [*product((1, 2, 3), repeat=3), (3, 18, 1), (2, 300, 1), (1, 40, 2), (4, 7, 5), (2, 3, 7), (1, 33, 15), (3, 1, 30)]
    shapes += [(3, 2, 16), (2, 16, 17), (3, 2, 255), (2, 3, 257), (1, 2, 513), (9, 9, 9), (5, 4, 40)]
    for shape, ghosts in product(shapes, (0, 1)):
        shape = tuple(max(n, low) for n, low in zip(shape, least, strict=True))
        if make is stream_collide_pairs and (shape[2] % 2 or ghosts):  # a pair is stepped as a whole
            continue
        cells, other = (guarded(one, monkeypatch, options, shape, ghosts) for one in (stream_collide, make))
        assert np.isfinite(cells.f.numpy()).all(), shape
        assert np.array_equal(cells.f.numpy(), other.f.numpy()) and np.array_equal(cells.u.numpy(), other.u.numpy()), shape


@pytest.mark.parametrize("make", [stream_collide_rows, stream_collide_pairs])
def test_rows_and_pairs_stay_in_their_plane_of_a_box_of_any_shape(make, monkeypatch):
    assert_same_as_cells(make, OPEN, (7, 7, 1), monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize("make", [stream_collide_rows, stream_collide_pairs])
@pytest.mark.parametrize(
    "options, least", [({}, (1, 1, 1)), (HALF, (1, 1, 1)), (WALLS, (4, 1, 1))], ids=["WALE", "half", "faces"]
)
def test_rows_and_pairs_stay_in_their_plane_of_a_closed_box(make, options, least, monkeypatch):
    assert_same_as_cells(make, options, least, monkeypatch)


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


def test_kernel_choice_is_rows_on_a_large_cpu_box_and_pairs_on_a_gpu():
    class Device:
        def __init__(self, is_cuda: bool):
            self.is_cuda = is_cuda

    assert kernel_for((80, 56, 30), Device(False)) == (stream_collide_rows, 1)
    assert kernel_for((8, 8, 8), Device(False)) == (stream_collide, 64)
    assert kernel_for((240, 200, 1), Device(False)) == (stream_collide, 200)
    assert kernel_for((200, 200, 50), Device(True)) == (stream_collide_pairs, 200 * 25)
    assert kernel_for((20, 20, 5), Device(True)) == (stream_collide, 100)


@wp.kernel
def keep(u: wp.array(dtype=wp.vec3), one: wp.array(dtype=wp.vec3s), two: wp.array(dtype=wp.vec3s), back: wp.array(dtype=wp.vec3)):
    i = 2 * wp.tid()
    for k in range(2):
        poke3(one, i + k, u[i + k])
    poke3_pair(two, i, u[i], u[i + 1])
    pair = peek3_pair(two, i)
    back[i] = pair[0]
    back[i + 1] = 2.0 * pair[1] - peek3(one, i + 1)


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=pytest.mark.gpu)])
def test_16_bit_velocity_is_rounded_to_nearest_and_clipped_at_half_a_cell(device):
    u = np.random.default_rng(0).uniform(-0.6, 0.6, (64, 3)).astype(np.float32)
    u[:4] = UNIT * np.array([[0.5, 1.5, 2.5], [-0.5, -1.5, -2.5], [0.49, 0.51, -0.51], [9e4, -9e4, 0.0]])  # ties, signs, ends
    one, two = (wp.zeros(64, dtype=wp.vec3s, device=device) for _ in range(2))
    back = wp.zeros(64, dtype=wp.vec3, device=device)
    wp.launch(keep, dim=32, inputs=[wp.array(u, dtype=wp.vec3, device=device), one, two, back], device=device)
    expected = encoded(u, wp.vec3s)
    assert expected[:4].tolist() == [[0, 2, 2], [0, -2, -2], [0, 1, -1], [32767, -32767, 0]]
    for kept in (one, two):
        np.testing.assert_array_equal(kept.numpy(), expected)
    np.testing.assert_array_equal(back.numpy(), decoded(expected))
    slow = np.abs(u) < 32767 * UNIT
    assert np.abs(decoded(expected) - u)[slow].max() <= 0.5 * UNIT


def test_force_free_velocity_is_read_from_populations_at_full_precision():
    still, pushed = (Fluid(Lattice(dx=0.02, dt=0.004), (8, 6, 6), "cpu") for _ in range(2))
    u = 0.03 * np.random.default_rng(0).standard_normal((8, 6, 6, 3))
    still.impose(u)
    np.testing.assert_allclose(still.velocity(), u, atol=1e-6)
    assert np.abs(decoded(still.u.numpy()) * 5.0 - u).max() > 2e-5  # 5 m/s: a cell a step
    pushed.force.fill_(wp.vec3(1e-3, 0.0, 0.0))
    pushed.step(((0, 0, 0), (8, 6, 6)))  # from rest: G / 2 is what is kept, the populations have G
    np.testing.assert_allclose(pushed.velocity(), [[[[2.5e-3, 0.0, 0.0]]]] * np.ones((8, 6, 6, 1)), atol=0.51 * UNIT * 5.0)
