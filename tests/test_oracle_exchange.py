"""What crosses the faces of a box of finer cells, beside the formulas of exchange.py cell by cell; who leaves ghosts alone."""

import numpy as np
import pytest

wp = pytest.importorskip("warp")

from fishmj.lbm_oracle.fluid import fluid
from fishmj.lbm_oracle.fluid.fluid import Fluid
from fishmj.lbm_oracle.fluid.lattice import VELOCITIES, Lattice
from fishmj.lbm_oracle.fluid.pairs import stream_collide_pairs
from fishmj.lbm_oracle.fluid.rows import stream_collide_rows
from fishmj.lbm_oracle.fluid.step import stream_collide
from fishmj.lbm_oracle.refined.exchange import CELL_BITS
from fishmj.lbm_oracle.refined.refined_fluid import RefinedFluid, _memory

pytestmark = pytest.mark.oracle
THREADS = {stream_collide: lambda ny, nz: ny * nz, stream_collide_rows: lambda ny, nz: 1}  # a plane of x
THREADS[stream_collide_pairs] = lambda ny, nz: ny * nz // 2
BOXES = {  # water, where it begins, the box's place in it and its size
    "inside": ((11, 9, 10), (37, -25, 8), (3, 2, 4), (4, 3, 3)),
    "through": ((9, 8, 3), (-5, 6, 0), (3, 2, 0), (3, 4, 3)),  # it fills an axis
    "flat": ((8, 1, 9), (0, 0, 0), (2, 0, 3), (3, 1, 4)),
    "strip": ((9, 8, 1), (-5, 6, 0), (3, 2, 0), (3, 4, 1)),  # it stays one cell deep
}


def boxed(name: str, linear: bool = True) -> RefinedFluid:
    """A box in water with numbers by chance on both levels."""
    shape, first, at, size = BOXES[name]
    outer = Fluid(Lattice(dx=1.0, dt=1.0, rho=1.0, nu=0.02), shape, subgrid="none")
    outer._place(np.array(first))
    x, y, z = (a + b for a, b in zip(first, at, strict=True))
    box, rng = RefinedFluid(outer, (x, y, z), size, linear=linear), np.random.default_rng(7)
    for level in (box, outer):
        for field in (*level._f, *level._u):
            field.assign(rng.normal(0, 0.01, (*field.shape, 3)[: len(field.shape) + (field.dtype is wp.vec3)]))
    return box


class Plain:
    """The formulas of exchange.py, cell by cell."""

    def __init__(self, box: RefinedFluid):
        self.box, self.size, self.ends = box, 2 * box.size_lu, box._ghost > 0
        self.low = {1: box.low_lu, 2: box.first_lu}

    def inside(self, r, scale: int = 2) -> bool:
        """Is a cell in R? `scale`: 2 for a fine one, 1 for a coarse one."""
        return bool(np.all((r >= 0) & (2 * r < scale * self.size) | ~self.ends))

    def at(self, field: np.ndarray, r, scale: int = 2) -> tuple:
        """Index of a cell, counted from R's corner, in (nx, ny, nz, ...)."""
        return tuple((self.low[scale] + r) % field.shape[:3])

    def difference(self, field: np.ndarray, x, axis: int):
        step = np.eye(3, dtype=int)[axis]
        return (field[self.at(field, x + step, 1)] - field[self.at(field, x - step, 1)]) / 2

    def linear(self, field: np.ndarray, x, d):
        return field[self.at(field, x, 1)] + sum(d[a] * self.difference(field, x, a) for a in range(3))

    def exploded(self, f: np.ndarray, y, i: int, second: int) -> float:
        c = VELOCITIES[i]
        w = y - second * c
        x = w // 2
        if not self.box._linear:
            return f[(i, *self.at(f[i], x, 1))]
        k = 2 * second - 1
        if sum(bool(c[a] and self.ends[a] and not 0 <= 2 * x[a] < self.size[a]) for a in range(3)) == 2:
            k -= 0.5
        return self.linear(f[i], x, (w % 2) / 2 - 0.25 + k * c / 4)

    def coalesced(self, f: np.ndarray, first: np.ndarray, second: np.ndarray, x, i: int) -> float:
        c = VELOCITIES[i]
        now = f[(i, *self.at(f[i], x, 1))]
        if self.inside(x + c, 1):
            return now
        if not self.inside(x, 1):
            children = [r for r in 2 * x + CHILDREN if self.inside(r + c)]
            return now + sum(second[i][self.at(second[i], r + c)] - first[i][self.at(first[i], r)] for r in children) / 8
        pulled = [
            second[i][self.at(first[i], r + c)] if self.inside(r + c) else first[i][self.at(first[i], r)]
            for r in 2 * x + CHILDREN
        ]
        return sum(pulled) / 8


CHILDREN = np.indices((2, 2, 2)).reshape(3, -1).T


def around_box(size, ghost) -> np.ndarray:
    """Cells of a box and of `ghost` layers round it, (n, 3)."""
    return np.indices(tuple(size + 2 * ghost)).reshape(3, -1).T - ghost


@pytest.mark.parametrize(
    ("name", "linear"), [("inside", True), ("through", True), ("flat", True), ("strip", True), ("inside", False)]
)
def test_what_enters_a_box_is_what_the_formula_says(name, linear):
    """In the copies that the two fine steps read; all else stays."""
    box = boxed(name, linear)
    plain, f, u = Plain(box), box.outer.f.numpy(), box.outer.u.numpy()
    copies = [box.parity, 1 - box.parity]
    wanted, wanted_u = ([values[k].numpy().copy() for k in copies] for values in (box._f, box._u))
    for y in around_box(2 * box.size_lu, box._ghost):
        if plain.inside(y):
            continue
        at = plain.at(wanted_u[0], y)
        for second in range(2):
            wanted_u[second][at] = plain.linear(u, y // 2, (y % 2) / 2 - 0.25)
            for i, c in enumerate(VELOCITIES):
                if plain.inside(y + c):
                    wanted[second][(i, *at)] = plain.exploded(f, y, i, second)
    box._explode()
    np.testing.assert_allclose([box._f[k].numpy() for k in copies], wanted, rtol=0, atol=1e-8)
    np.testing.assert_allclose([box._u[k].numpy() for k in copies], wanted_u, rtol=0, atol=1e-8)


@pytest.mark.parametrize(
    ("make", "name"), [(make, name) for make in THREADS for name in BOXES if (make, name) != (stream_collide_pairs, "strip")]
)
def test_a_step_leaves_ghosts_alone(name, make, monkeypatch):
    """In each kernel; and a survey does not see them. Pairs need an even number of cells along z."""
    monkeypatch.setattr(fluid, "kernel_for", lambda shape, device: (make, THREADS[make](*shape[1:])))
    box = boxed(name)
    ghosts = np.ones(box.shape, bool)
    ghosts[_memory(box, box.first_lu, 2 * box.size_lu)] = False
    for k in range(2):
        f, u = box._f[k].numpy().copy(), box._u[k].numpy().copy()
        f[:, ghosts], u[ghosts] = 7.0, 7.0
        box._f[k].assign(f)
        box._u[k].assign(u)
    before = box._f[1 - box.parity].numpy().copy()
    assert box.survey().rho_max < 2 and box.survey().speed < 1
    Fluid.stream_collide(box)
    assert (box.f.numpy()[:, ghosts] == 7.0).all() and (box.u.numpy()[ghosts] == 7.0).all()
    assert (box.f.numpy() != before)[:, ~ghosts].any(0).all()


@pytest.mark.parametrize("name", BOXES)
def test_what_leaves_a_box_is_what_the_formula_says(name):
    box = boxed(name)
    plain, f, first, second = Plain(box), box.outer.f.numpy().copy(), box._f[1].numpy(), box._f[0].numpy()
    wanted = f.copy()
    for x in around_box(box.size_lu, box._ghost):
        for i in range(len(VELOCITIES)):
            wanted[(i, *plain.at(f[i], x, 1))] = plain.coalesced(f, first, second, x, i)
    box._coalesce()
    np.testing.assert_allclose(box.outer.f.numpy(), wanted, rtol=0, atol=1e-8)


@pytest.mark.parametrize("name", BOXES)
def test_restriction_keeps_mass_momentum_and_mean_velocity(name):
    box = boxed(name)
    plain, fine, u = Plain(box), box.f.numpy(), box.u.numpy()
    before, before_u = box.outer.f.numpy().copy(), box.outer.u.numpy().copy()
    box.restrict()
    f, mean = box.outer.f.numpy(), box.outer.u.numpy()
    for x in around_box(box.size_lu, box._ghost):
        at = plain.at(mean, x, 1)
        if not plain.inside(x, 1):
            assert (f[(slice(None), *at)] == before[(slice(None), *at)]).all() and (mean[at] == before_u[at]).all()
            continue
        children = [plain.at(u, r) for r in 2 * x + CHILDREN]
        populations = np.mean([fine[(slice(None), *child)] for child in children], 0)
        assert f[(slice(None), *at)].sum() == pytest.approx(populations.sum(), abs=1e-7)
        assert VELOCITIES.T @ f[(slice(None), *at)] == pytest.approx(VELOCITIES.T @ populations, abs=1e-7)
        assert mean[at] == pytest.approx(np.mean([u[child] for child in children], 0), abs=1e-7)


@pytest.mark.parametrize("name", BOXES)
def test_the_lists_of_the_exchange_hold_each_path_once(name):
    """Every population that crosses is there, and no other."""
    box = boxed(name)
    plain, bits = Plain(box), (1 << CELL_BITS) - 1

    def read(words):
        words = words.numpy().view(np.uint32)
        cells = np.stack(np.unravel_index(words & bits, tuple((box.size_lu + 2 * box._ghost).tolist())), -1) - box._ghost
        return [(int(i), *map(int, cell)) for i, cell in zip(words >> CELL_BITS, cells, strict=True)]

    ghosts = [y for y in around_box(2 * box.size_lu, box._ghost) if not plain.inside(y)]
    steps = [(i, second) for i in range(1, len(VELOCITIES)) for second in (0, 1)]
    enters = {(i, second, *map(int, y)) for y in ghosts for i, second in steps if plain.inside(y + VELOCITIES[i])}
    enters |= {(0, 0, *map(int, y)) for y in ghosts}
    found, paths = read(box._entering), []
    assert found == sorted(found)
    for (i, *x), children in zip(found, box._children.numpy().tolist(), strict=True):
        for bit in (bit for bit in range(16) if children >> bit & 1):
            y = 2 * np.array(x) + CHILDREN[bit % 8] + bit // 8 * VELOCITIES[i]
            y = np.where(box._ghost > 0, y, y % (2 * box.size_lu))
            paths.append((i, bit // 8, *map(int, y)))
    assert set(paths) == enters and len(paths) == len(enters)
    crosses = {}
    for x in around_box(box.size_lu, box._ghost):
        for i, c in enumerate(VELOCITIES):
            later = sum(plain.inside(r + c) << n for n, r in enumerate(2 * x + CHILDREN))
            if not plain.inside(x + c, 1) and (plain.inside(x, 1) or later):
                crosses[i, *map(int, x)] = later
    found = read(box._leaving)
    assert dict(zip(found, box._later.numpy().tolist(), strict=True)) == crosses and found == sorted(found)
    everything = {(0, *map(int, x)) for x in around_box(box.size_lu, box._ghost) if plain.inside(x, 1)}
    seen = {
        (0, *x)
        for _, *x in everything
        if not all(plain.inside(np.array(x) + step, 1) for step in (*np.eye(3, dtype=int), *-np.eye(3, dtype=int)))
    }
    assert set(read(box._all)) == everything and set(read(box._rim)) == seen
    assert len(box._all) == len(everything) and len(box._rim) == len(seen)
