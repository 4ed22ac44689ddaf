"""The learnt residual in the compiled engine: the same force as in NumPy and JAX, one machine code for all fitted waters.

Tolerance: 1e-9 of the largest entry over 2 s of swimming in float64; a step differs by rounding only.
"""

from dataclasses import replace

import jax
import numpy as np
import pytest

numba = pytest.importorskip("numba", reason='the compiled engine needs pip install "fishmj[fast]"')

from fishmj import engines
from fishmj.effects import get
from fishmj.effects.effect_calibration import FittedEffect, Interval
from fishmj.engines import batch, compiled, fast_math, numba_build, planar, residual_lanes
from fishmj.engines.single import HookedWater, closed_form
from fishmj.mjcf import load_robot
from fishmj.water import residual_hooks, residual_network
from fishmj.water.dynamics import planar_chain
from fishmj.water.flow import Flow, sample, stack

ROBOT = engines.in_water(load_robot("fish"), "swift")
EFFECTS = ("command_gain_error", "coulomb_friction", "body_mass", "current_shear", "tether", "wake_memory")  # sites around it
TICKS, FISH = 100, 19


def with_effects():
    """The fish with an effect at every site that stands beside the residual."""
    typical = lambda name: {p.name: Interval(p.probe, p.probe, p.probe) for p in get(name).parameters}
    return replace(ROBOT, effects=tuple(FittedEffect(name, typical(name)) for name in EFFECTS))


@pytest.fixture(scope="module")
def double():
    """float64, two threads."""
    return compiled.CompiledEngine(ROBOT, threads=2, dtype="float64")


def school(robot, turbulence: str, fish: int = FISH):
    """State, commands, parameters, flow and tick of different fish that beat their tails."""
    rng = np.random.default_rng(4)
    state = engines.at_rest(robot, rng.normal(size=(fish, 3)))
    state = state._replace(v=0.1 * rng.normal(size=state.v.shape))
    params = engines.nominal_params(robot, fish)
    flows = [Flow(speed=0.2, direction=1.0, turbulence=turbulence, intensity=0.1, seed=i) for i in range(fish)]
    current = stack(flows)
    beat = np.sin(2 * np.pi * 1.2 * np.arange(TICKS)[:, None] / 50 - np.arange(3)) * rng.uniform(0.2, 0.6, (fish, 1, 1))
    params = params._replace(delay=params.delay.astype(np.int64))  # JAX divides int32 in float32
    return state, beat, params, current._replace(table=np.asarray(current.table, float)), np.zeros(fish, np.int64)


def far(one, two) -> float:
    """Largest difference of any leaf, over the largest entry of that leaf (1 at least)."""
    pairs = zip(jax.tree.leaves(one), jax.tree.leaves(two), strict=True)
    return max(np.abs(np.asarray(a) - np.asarray(b)).max() / max(1.0, np.abs(np.asarray(b)).max()) for a, b in pairs)


def swum_apart(engine, turbulence: str) -> float:
    """How far a swim of 2 s is from the closed form in JAX."""
    given = school(engine.robot, turbulence)
    with jax.enable_x64(True):
        expected = planar.PlanarEngine(engine.robot).advance(*given)
    assert np.abs(np.asarray(expected[0].memory)[:, -18:-2]).max() > 0.05  # a wake was left
    return far(engine.advance(*given), expected)


@pytest.mark.parametrize("turbulence", ["default", "gust"])
def test_two_seconds_equal_the_closed_form_in_jax(double, turbulence):
    assert swum_apart(double, turbulence) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("turbulence", ["default", "gust"])
def test_with_effects_at_every_site_beside_it_too(turbulence):
    assert swum_apart(compiled.CompiledEngine(with_effects(), dtype="float64"), turbulence) < 1e-9


@pytest.mark.parametrize("robot", [ROBOT, with_effects()], ids=["alone", "effects"])
def test_forces_are_those_of_numpy(robot):
    engine, rng = compiled.CompiledEngine(robot, threads=1), np.random.default_rng(2)
    state, _, params, _, _ = school(robot, "default")
    memory = state.memory.copy()
    memory[:, -18:] = rng.uniform(-0.5, 0.5, (FISH, 18))
    memory[:, -2] = 0.01  # J, the reservoir
    q, v = state.q + 0.2 * rng.normal(size=state.q.shape), 0.2 * rng.normal(size=state.v.shape)
    around = rng.normal(size=(FISH, 3)), 0.1 * rng.normal(size=(FISH, 4, 2)), rng.normal(size=(FISH, 2))
    got = engine.forces(q, v, state.attached, params, *around, memory)
    added = engines.Extensions.of(robot)
    for i in range(FISH):
        row = lambda a, i=i: a[i : i + 1]
        fish = HookedWater(robot, added, planar_chain.nominal(robot))
        fish.set_fish(type(params)(*map(row, params)))
        fish.attached, fish.memory = float(state.attached[i]), memory[i].tolist()
        target, *water = (part[i] for part in around)
        fish.set_flow(*water)
        want = fish.forces(q[i], v[i], target)
        want = want[0], fish.attached, want[1], fish.memory
        assert far([part[i] for part in got], [np.array(part) for part in want]) < 1e-9
    strips = compiled.CompiledEngine(engines.in_water(load_robot("fish"), "swift-base")) if not robot.effects else None
    if strips is not None:  # the residual is there: the strips alone do not make this force
        assert np.abs(strips.forces(q, v, state.attached, params, *around).force - got.force).max() > 1e-3


def test_compiled_swim_is_identical_for_any_batch_threads_and_jit(double):
    given = school(ROBOT, "default", 300)
    given = (given[0], given[1][:, :20], *given[2:])
    whole = double.advance(*given)
    single = compiled.CompiledEngine(ROBOT, threads=1, dtype="float64")
    assert far(single.advance(*given), whole) == 0.0
    few = jax.tree.map(lambda a: a[201:204] if np.ndim(a) and len(a) == 300 else a, given)
    few = (
        *few[:3],
        given[3]._replace(**{k: getattr(given[3], k)[201:204] for k in ("mean", "rms", "row", "offset", "turn")}),
        few[4],
    )
    assert far(double.advance(*few), jax.tree.map(lambda a: a[201:204], whole)) == 0.0
    with jax.enable_x64(True):
        assert far(jax.jit(double.advance)(*few), jax.tree.map(lambda a: a[201:204], whole)) == 0.0


def test_one_machine_code_serves_every_member_and_gives_its_own_force(double):
    learnt = double.added.learnt
    one = replace(double.added, nets=(residual_hooks.member(learnt, 2),))
    own = compiled.CompiledEngine(ROBOT, threads=1, dtype="float64")
    own.added = one
    shape = residual_lanes.Shape.of(learnt)
    assert shape == residual_lanes.Shape.of(one.learnt) and own._advance is double._advance
    given = school(ROBOT, "default", 3)
    expected = planar.PlanarEngine(ROBOT)
    expected.added = one
    with jax.enable_x64(True):
        want = expected.advance(*given)
    got = own.advance(*given)
    assert far(got, want) < 1e-9 and far(got, double.advance(*given)) > 1e-5
    with jax.enable_x64(True):  # programs of one process that differ by their weights alone
        assert [far(jax.jit(e.advance)(*given), e.advance(*given)) for e in (double, own)] == [0.0, 0.0]
    text = numba_build.write(ROBOT, "advance", fast_math.DOUBLE)
    assert all(repr(float(weight)) not in text for weight in np.ravel(learnt.net.inner)[:20])


@pytest.mark.parametrize(("links", "members", "hidden"), [(3, 1, 4), (4, 3, 7), (5, 2, 6)])
def test_the_network_is_that_of_numpy_for_any_shape(links, members, hidden):
    """Odd counts of outputs, units that fill up a block, one member: compiled by itself."""
    rng = np.random.default_rng(links)
    net = residual_network.blank(links, members, hidden, seed=1)
    net = residual_network.Net(net.reach, *(0.3 * rng.normal(size=np.shape(a)) for a in net[1:]))
    learnt, dt = residual_hooks.Residual(net, residual_hooks.unlimited(links)), 0.004
    shape = residual_lanes.Shape.of(learnt)
    names = {**shape.rows(), "memory": [f"memory{i}" for i in range(residual_network.WAKES)]}
    rows = {name: i for i, name in enumerate(numba_build.flat(list(names.values())))}
    head = numba_build.HEADER.format(real="float64", whole="int64") + f"LANES = {numba_build.LANES}\n"
    text = head + fast_math.source(fast_math.DOUBLE) + residual_lanes.network(shape, rows, rows["memory0"])
    work = np.zeros((len(rows), numba_build.LANES))
    x, z = rng.normal(size=(3 * links + 1, numba_build.LANES)), rng.uniform(-1, 1, (residual_network.WAKES, numba_build.LANES))
    speed = rng.uniform(0.05, 1.0, numba_build.LANES)
    work[rows["feature0"] : rows["feature0"] + len(x)], work[rows["memory0"] : rows["memory0"] + len(z)] = x, z
    work[rows["pace"]] = speed
    numba_build.compiled(text).network(work.reshape(-1), residual_lanes.flat_weights(learnt, dt, np.dtype(float)))
    m = residual_network.MotionFeatures(list(x), speed, [], [], [])
    hooks = residual_hooks.LearnedResidual(np, planar_chain.chain_of(ROBOT), learnt, residual_hooks.at_rest())
    mean, spread, wake = hooks.network(learnt, m, list(z), dt)
    take = lambda name, count: work[rows[name] : rows[name] + count]
    np.testing.assert_allclose(take("coefficient0", 3 * links), np.reshape(mean, (3 * links, -1)), rtol=0, atol=1e-12)
    np.testing.assert_allclose(take("next0", len(z)), np.array(wake), rtol=0, atol=1e-12)
    np.testing.assert_allclose(work[rows["spread"]], np.broadcast_to(spread, numba_build.LANES), rtol=0, atol=1e-12)


@pytest.mark.parametrize("turbulence", ["default", "gust", "none"])
def test_the_flow_at_the_links_is_that_of_numpy(turbulence):
    engine, (state, _, _, current, tick) = compiled.CompiledEngine(ROBOT, threads=1), school(ROBOT, turbulence)
    q = state.q + np.random.default_rng(1).normal(size=state.q.shape)
    centres = planar.link_centres(np, planar_chain.chain_of(ROBOT), q)
    for got, want in zip(engine.look(q, current, tick + 7), sample(np, current, centres, tick + 7), strict=True):
        np.testing.assert_allclose(got, want, rtol=0, atol=1e-12)


def test_mujocos_engines_take_the_compiled_evaluator(double):
    given = school(ROBOT, "default", 2)
    given = (given[0], given[1][:, :10], *given[2:])
    alike = [batch.BatchEngine(ROBOT, threads=1, evaluator=name).advance(*given) for name in (None, "jax")]
    assert far(*alike) < 1e-9
    evaluate, _ = batch.evaluator_of(ROBOT, planar_chain.chain_of(ROBOT), None)
    assert evaluate.__self__.__class__ is compiled.CompiledEngine
    assert closed_form(ROBOT).engine.__class__ is compiled.CompiledEngine
