"""The joint-space solve of a coupled step, for any number of degrees of freedom."""

import random
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from types import FunctionType, SimpleNamespace

import numpy as np
import pytest
import warp as wp

from fishmj.lbm_oracle.immersed import boundary, fsi_solve

wp.config.quiet = True


def an_equation(n: int, held: int, seed: int = 3) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """K (n, n), b0 (n,) and what the host sends: a mass matrix with links of very different masses, `held` rows prescribed."""
    rng = np.random.default_rng(seed)
    scale = np.exp(rng.uniform(-3, 1, n))
    half = rng.normal(size=(n, n)) * scale[:, None]
    sent = {"system": half @ half.T, "momentum": rng.normal(size=n) * scale, "before": rng.normal(size=n)}
    sent |= {"fixed": np.zeros(n), "value": rng.normal(size=n)}
    sent["fixed"][rng.permutation(n)[:held]] = 1.0
    response = rng.normal(size=(n, n)) * scale[:, None] * scale  # not symmetric, as with slip
    return response, rng.normal(size=n) * scale, sent


def solved(response, at_rest, sent, device: str = "cpu", implicit: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """v+ and the velocity that pushes the water, each (n,)."""
    n = len(at_rest)
    layout = boundary._layout(1, n)
    block = np.zeros(layout.size)
    for name, value in boundary._views(block, 1, n).items():
        value[...] = sent.get(name, 0.0)
    make = lambda values, dtype: wp.array(values, dtype=dtype, device=device)
    water = make(np.concatenate([at_rest[:, None], response], 1), wp.float64)
    work = [make(np.full(n * (n + 1), np.nan), wp.float64), make(np.full(n, -1), wp.int32), make(np.full(n, -1), wp.int32)]
    found = [make(np.zeros(n), wp.float64) for _ in range(2)]
    threads = 1 if device == "cpu" else fsi_solve.BLOCK
    inputs = [make(block, wp.float64), layout, water, int(implicit)]
    wp.launch(fsi_solve.solve, dim=threads, inputs=inputs, outputs=[*work, *found], device=device)
    return found[0].numpy(), found[1].numpy()


def whole(response, at_rest, sent) -> tuple[np.ndarray, np.ndarray]:
    """The matrix and the right-hand side with the prescribed rows in them."""
    matrix, right, held = sent["system"] + response, sent["momentum"] - at_rest, sent["fixed"] > 0.5
    matrix[held], right[held] = np.eye(len(right))[held], sent["value"][held]
    return matrix, right


@pytest.mark.parametrize(("n", "held"), [(1, 0), (6, 0), (6, 3), (18, 3), (24, 0), (40, 5)])
def test_one_kernel_solves_for_any_number_of_degrees_of_freedom(n, held):
    """Unrolled for its n, a kernel of forty would not be compiled within the hour."""
    given = an_equation(n, held)
    v, target = solved(*given)
    matrix, right = whole(*given)
    np.testing.assert_allclose(matrix @ v, right, atol=1e-10 * np.abs(matrix).max() * np.abs(v).max())
    np.testing.assert_array_equal(target, v)
    fixed = given[2]["fixed"] > 0.5
    np.testing.assert_allclose(v[fixed], given[2]["value"][fixed], rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize(("n", "held"), [(6, 0), (6, 3), (13, 2), (18, 0)])
def test_the_order_of_the_arithmetic_is_that_of_elimination_by_hand(n, held):
    """To the bit: published figures of the shipped fish depend on it."""
    given = an_equation(n, held, seed=n)
    matrix, right = whole(*given)
    a = np.concatenate([matrix, right[:, None]], 1)
    for p in range(n):
        top = p + int(np.argmax(np.abs(a[p:, p])))
        a[[p, top]] = a[[top, p]]
        for i in range(p + 1, n):
            a[i, p:] -= a[i, p] / a[p, p] * a[p, p:]
    x = np.zeros(n)
    for i in reversed(range(n)):
        rest = a[i, n]
        for j in range(i + 1, n):
            rest -= a[i, j] * x[j]
        x[i] = rest / a[i, i]
    np.testing.assert_array_equal(solved(*given)[0], x)


def test_the_explicit_scheme_shows_the_water_the_old_velocity():
    response, at_rest, sent = an_equation(7, 2)
    v, target = solved(response, at_rest, sent, implicit=False)
    matrix, right = whole(np.zeros((7, 7)), at_rest + response @ sent["before"], sent)
    np.testing.assert_allclose(v, np.linalg.solve(matrix, right), rtol=1e-8)
    np.testing.assert_array_equal(target, np.where(sent["fixed"] > 0.5, v, sent["before"]))


def test_a_singular_equation_gives_no_finite_velocity():
    """The host then stops the run with the joint's name; a plausible number would swim on."""
    response, at_rest, sent = an_equation(5, 0)
    sent["system"][2], response[2] = 0.0, 0.0
    assert not np.isfinite(solved(response, at_rest, sent)[0]).all()


@pytest.mark.parametrize(("n", "threads", "across"), [(6, 16, 4), (9, 12, 4), (13, 24, 8)])
def test_threads_of_a_block_that_run_in_any_order_find_the_same(n, threads, across):
    """Its waits suffice: the kernel's own source, on Python's threads that pause at random."""
    given, me, block = an_equation(n, 2), threading.local(), threading.Barrier(threads, timeout=600)
    layout = boundary._layout(1, n)
    sent = np.zeros(layout.size)
    for name, value in boundary._views(sent, 1, n).items():
        value[...] = given[2].get(name, 0.0)

    def read(values, i):
        if random.random() < 0.02:
            time.sleep(1e-4 * random.random())
        return values[i]

    stand_in = {"tid": lambda: me.number, "block_dim": lambda: threads, "static": lambda _: across, "min": min, "abs": abs}
    stand_in |= {"float64": float, "int32": int, "where": lambda which, yes, no: yes if which else no}
    scope = {"wp": SimpleNamespace(**stand_in), "WARP": across, "read": read, "write": np.ndarray.__setitem__}
    scope["wait_for_block"] = block.wait
    for kernel in (fsi_solve.assemble_system, fsi_solve.pivot_row, fsi_solve.solve_block, fsi_solve.solve):
        scope[kernel.func.__name__] = FunctionType(kernel.func.__code__, scope)
    water = np.concatenate([given[1][:, None], given[0]], 1)
    v, target = np.zeros(n), np.zeros(n)
    arrays = np.full(n * (n + 1), np.nan), np.full(n, -1), np.full(n, -1), v, target

    def run(number):
        me.number = number
        scope["solve"](sent, layout, water, 1, *arrays)

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(run, range(threads)))  # as many as there are: each waits for all others
    np.testing.assert_array_equal(v, solved(*given)[0])


@pytest.mark.gpu
@pytest.mark.parametrize(("n", "held"), [(1, 0), (6, 0), (6, 3), (9, 2), (18, 3), (24, 0), (40, 5), (70, 0)])
def test_a_block_of_threads_solves_as_one_does(n, held):
    given = an_equation(n, held)
    for implicit in (True, False):
        one, block = (np.array(solved(*given, device=device, implicit=implicit)) for device in ("cpu", "cuda"))
        np.testing.assert_allclose(block, one, rtol=1e-7, atol=1e-10 * np.abs(one).max())
