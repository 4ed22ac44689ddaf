"""The code generator: its text is the physics, its elementary functions are accurate, its files are whole."""

import threading

import jax.numpy as jnp
import numpy as np
import pytest

numba = pytest.importorskip("numba", reason='the compiled engine needs pip install "fishmj[fast]"')

from fishmj import engines
from fishmj.base.errors import ConfigError
from fishmj.engines import codegen, fast_math, numba_build
from fishmj.mjcf.reading import load_robot
from fishmj.water.dynamics import planar_chain


@pytest.mark.parametrize("name", ["fish", "tendon_fish"])
def test_generated_text_is_chain_step_in_numpy(name):
    robot = load_robot(name)
    program, rows = numba_build.generate(robot, "physics")
    ch, sw = planar_chain.chain_of(robot), planar_chain.nominal(robot)
    n, rng = ch.n, np.random.default_rng(3)
    q, v, flow = rng.normal(size=(n + 2, 50)), rng.normal(size=(n + 2, 50)), rng.normal(size=(n, 2, 50))
    target, ambient, attached = rng.normal(size=(n - 1, 50)), rng.normal(size=(2, 50)), rng.uniform(size=50)
    expected = planar_chain.step(np, ch, sw, list(q), list(v), attached, list(target), list(flow), ambient)
    values = [*q, *v, attached, *target, *flow.reshape(2 * n, 50), *ambient]
    values += [*sw.mass, *sw.kp, *sw.kv, *sw.kb, *sw.zero, *engines.flat_water(sw.water), 0.0]
    scope = {key: getattr(np, key) for key in ("sqrt", "sin", "cos", "exp", "absolute", "maximum", "minimum", "where")}
    scope |= {"atan2": np.arctan2, "real": np.float64}
    order = [row for row in numba_build.flat(list(numba_build.names_of(n).values())) if row in program.inputs]
    scope |= dict(zip(order, values, strict=True))
    exec(program.numbers() + program.assignments(), scope)  # noqa: S102  the text under test
    got = np.array([np.broadcast_to(scope[name], 50) for name in program.outputs])
    np.testing.assert_allclose(got, np.array([*expected.q, *expected.v, expected.attached, expected.power]), rtol=0, atol=1e-10)
    assert len(rows) == len(program.outputs) == 2 * n + 6


def test_generator_drops_what_nobody_asks_for_and_what_is_zero():
    program = codegen.trace(lambda a: [a[0] * 2 + 0.0 * a[1], (a[0] * 2) * (2 * a[0]) + 1.0 * a[1]], ["x", "y"])
    assert program.lines == (("v0", "x * k0"), ("v1", "v0 * v0"), ("v2", "y + v1")) and program.constants == {"k0": 2.0}


def test_generator_names_an_operation_that_it_cannot_write():
    with pytest.raises(ConfigError, match="'tanh'.*supported: .*atan2"):
        codegen.trace(lambda a: [jnp.tanh(a[0])], ["x"])


@pytest.mark.parametrize("precision,bounds", [(fast_math.SINGLE, (2e-7, 4e-7, 4e-7)), (fast_math.DOUBLE, (4e-15, 4e-15, 4e-15))])
def test_elementary_functions_are_accurate_to_their_precision(precision, bounds):
    real = np.dtype(precision.name).type
    scope = {"np": np, "njit": numba.njit, "MATH": {"fastmath": {"contract", "nsz"}, "error_model": "numpy"}}
    scope |= {"real": real, "whole": np.dtype(precision.integer).type, "floor": np.floor, "absolute": np.absolute}
    exec(fast_math.source(precision), scope)  # noqa: S102  the text under test
    rng = np.random.default_rng(5)
    turns = np.concatenate([np.linspace(-10, 10, 2001), rng.uniform(-1e4, 1e4, 2000)]).astype(real)
    powers = np.linspace(-80, 80, 4001).astype(real)
    y, x = rng.normal(size=(2, 4001)).astype(real)
    y[:3], x[:3] = 0, [1, -1, 0]
    every = numba.njit(lambda f, a: np.array([f(b) for b in a]))
    angles = numba.njit(lambda f, a, c: np.array([f(a[i], c[i]) for i in range(len(a))]))
    wide = np.longdouble
    for name in ("sin", "cos"):
        assert np.abs(every(scope[name], turns) - getattr(np, name)(turns.astype(wide))).max() < bounds[0]
    assert np.abs(every(scope["exp"], powers) / np.exp(powers.astype(wide)) - 1).max() < bounds[1]
    assert np.abs(angles(scope["atan2"], y, x) - np.arctan2(y.astype(wide), x.astype(wide))).max() < bounds[2]


@pytest.mark.parametrize("precision,bound", [(fast_math.SINGLE, 5e-7), (fast_math.DOUBLE, 1e-13)])
def test_hyperbolic_tangents_are_accurate_bounded_and_mirror(precision, bound):
    real = np.dtype(precision.name).type
    scope = {"np": np, "njit": numba.njit, "MATH": {"fastmath": {"contract", "nsz"}, "error_model": "numpy"}}
    scope |= {"real": real, "whole": np.dtype(precision.integer).type, "floor": np.floor, "absolute": np.absolute}
    exec(fast_math.source(precision), scope)  # noqa: S102  the text under test
    rng, wide = np.random.default_rng(6), np.longdouble
    x, y = np.concatenate([rng.normal(0, 2, (2, 4000)), [[0, 0, 50, -1e30, 1e30], [0, 3, -50, 1e30, 1e-9]]], 1).astype(real)
    one = numba.njit(lambda f, a, b: [f(a[i], b[i]) for i in range(len(a))])
    each = lambda name, a, b: np.array(one(scope[name], a, b))
    half = np.log(wide(2)) / 2
    two = np.tanh(half * np.array([x, y], wide))
    assert np.abs(each("tanh_two", x, y).T - two).max() < bound
    plus, minus = np.tanh(half * (x.astype(wide) + y)), np.tanh(half * (x.astype(wide) - y))
    pair = each("tanh_pair", x, y)
    assert np.abs(pair.T - 0.5 * np.array([plus + minus, plus - minus])).max() < bound and np.abs(pair).max() <= 1 + bound
    assert (each("tanh_pair", x, -y) == pair * [1, -1]).all()
    assert np.isnan(each("tanh_pair", np.array([np.nan], real), np.ones(1, real))).all()


LOOPS = """
@{decorator}
def {name}(w, c, row):
    wide()
    k = c[row, 1]
    for i in range(LANES):
        x = w[0 * LANES + i]
        y = w[1 * LANES + i] * k
        m, d = tanh_pair(x, y)
        m += exp2(-y) / (absolute(x) + real(1.5))
        inside = (x > y) & (y <= real(0.3))
        w[2 * LANES + i] = where(inside, m, d - floor(x))
        w[3 * LANES + i] = atan2(y, x) + sin(x) * cos(y) + exp(x) - sqrt(maximum(x, real(0.0)))
"""


@pytest.mark.parametrize("precision,bound", [(fast_math.SINGLE, 2e-6), (fast_math.DOUBLE, 4e-15)])
def test_lanes_are_what_numba_makes_of_the_same_text(precision, bound):
    head = (
        numba_build.HEADER.format(real=precision.name, whole=precision.integer) + "LANES = 16\n\n\n@njit\ndef wide():\n    pass\n"
    )
    text = head + fast_math.source(precision)
    text += LOOPS.format(decorator="njit(**MATH)", name="plain") + LOOPS.format(decorator="lanes", name="written")
    text += "\n\n@njit(**MATH)\ndef call(w, c, row):\n    written(w, c, row)\n"
    made, real = numba_build.compiled(text), np.dtype(precision.name).type
    one = np.random.default_rng(3).normal(size=4 * 16).astype(real)
    one[:3], other = [np.nan, 0.0, -0.0], np.array([[1.0, 2.0], [0.5, 0.7]], real)
    two = one.copy()
    made.plain(one, other, 1)
    made.call(two, other, 1)
    found = one.reshape(4, 16)[2:]
    assert np.isnan(found[:, 0]).all() and np.isfinite(found[:, 1:]).all() and len(set(found[:, 1:].flat)) == 30
    np.testing.assert_allclose(two, one, rtol=bound, atol=bound)
    bad = "\n\n@lanes\ndef bad(w):\n    for i in range(LANES):\n        w[i] = [i]\n\n\n@njit\ndef call(w):\n    bad(w)\n"
    with pytest.raises(TypeError, match=r"lanes: cannot write \[i\]"):
        numba_build.compiled(head + bad).call(two)


def test_racing_writers_leave_a_whole_file(tmp_path):
    text, path = "x = 1\n" * 20_000, tmp_path / "new" / "module.py"
    seen = []

    def write():
        numba_build.keep(path, text)
        seen.append(path.read_text() == text)

    racers = [threading.Thread(target=write) for _ in range(16)]
    for racer in racers:
        racer.start()
    for racer in racers:
        racer.join()
    assert seen == [True] * 16 and [p.name for p in path.parent.iterdir()] == ["module.py"]
