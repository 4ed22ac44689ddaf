"""The physics of a tick in one kernel: what XLA makes of the same steps, and code that a graphics card's compiler takes."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fishmj import engines
from fishmj.effects import randomise
from fishmj.engines import planar, planar_kernel
from fishmj.engines.extensions import with_effects
from fishmj.mjcf import load_robot
from fishmj.water import residual_hooks, residual_kernel, residual_network, residual_step
from fishmj.water.flow import Flow, stack

FISH = 5  # neither a block nor half of one


def swimming(name: str) -> planar.PlanarEngine:
    """An engine in the fitted water of this robot."""
    return engines.make("planar", engines.in_water(load_robot(name), "fitted"))


def engine_of(name: str, seed: int = 0, effects=()) -> planar.PlanarEngine:
    """An engine whose residual has random weights: two members with six units each, and a range that some fish leave."""
    engine, rng = engines.make("planar", with_effects(swimming(name).robot, effects)), np.random.default_rng(seed)
    net = residual_network.blank(engine.chain.n, 2, 6, seed=seed)
    net = net._replace(**{part: rng.normal(0, 0.5, getattr(net, part).shape) for part in ("wake_bias", "outer", "even", "odd")})
    reach = residual_hooks.unlimited(engine.chain.n)._replace(speed=np.full(engine.chain.n, 1.2), spread=np.array(1.0))
    learnt = residual_hooks.Residual(net, reach)
    engine.added = replace(engine.added, nets=(learnt,))
    return engine


def given_to(engine: planar.PlanarEngine, count: int = FISH, seed: int = 1):
    """What `PlanarEngine.physics` is given: `count` fish that swim, all different."""
    rng, joints = np.random.default_rng(seed), engine.robot.n_joints
    state = engines.at_rest(engine.robot, rng.uniform(-2, 2, (count, 3)))
    wakes = [rng.uniform(-1, 1, (count, residual_network.WAKES)), rng.uniform(0, 0.2, (count, 2))]
    memory = np.concatenate([state.memory[:, : -residual_network.WAKES - 2], *wakes], 1)  # of the effects, then of the residual
    state = state._replace(v=rng.normal(0, 0.6, state.v.shape), buffer=(), memory=memory)
    params = engines.nominal_params(engine.robot, count)
    if (active := engine.added.active) is not None:
        params = params._replace(effects=randomise.draw(active, count, rng))
    params = params._replace(
        **{part: getattr(params, part) * rng.uniform(0.9, 1.1, (count, 1)) for part in ("mass", "kp", "water")}
    )
    targets, flow = rng.uniform(-0.5, 0.5, (engine.steps, count, joints)), rng.normal(0, 0.2, (count, engine.chain.n, 2))
    single = lambda a: jnp.asarray(a, jnp.float32 if a.dtype == float else None)
    return jax.tree.map(single, (state, params, targets, flow, rng.normal(0, 0.1, (count, 2))))


EFFECTS = ("gear_backlash", "voltage_sag", "quadratic_drag", "wake_memory", "swirl")  # servo, gear, body, water and flow


@pytest.mark.parametrize(
    "name, effects", [pytest.param("fish", (), marks=pytest.mark.slow), ("tendon_fish", ()), ("tendon_fish", EFFECTS)]
)
def test_the_kernel_swims_as_the_steps_in_xla_do(name, effects, monkeypatch):
    """Three ticks; the chains of both fitted waters, four links and three. Of six hidden units a round holds two."""
    monkeypatch.setattr(planar_kernel, "BLOCK", 4)
    engine = engine_of(name, effects=effects)
    state, *others = given_to(engine)
    quickly = {"xla_backend_optimization_level": 0}  # made: each is run three times
    made = lambda way: jax.jit(way).lower(state, *others).compile(compiler_options=quickly)
    ways = made(engine.physics), made(partial(planar_kernel.physics, engine, interpret=True))
    ends = [state, state]
    for _ in range(3):
        (plain, work), (ours, watts) = pair = [way(end, *others) for way, end in zip(ways, ends, strict=True)]
        ends = [end for end, _ in pair]
        for one, other in zip(jax.tree.leaves((plain, work)), jax.tree.leaves((ours, watts)), strict=True):
            np.testing.assert_allclose(np.asarray(other), np.asarray(one), rtol=1e-5, atol=1e-5 * np.abs(one).max())
    outside = np.asarray(ends[0].memory)[:, -1] - np.asarray(state.memory)[:, -1]
    assert 0 < outside.max() and outside.min() < 3 * engine.steps  # both ways through the range were taken


def test_the_kernel_gives_each_fish_its_own_residual(monkeypatch):
    """Blocks of four fish: in one, two of three residuals act; in the other, one."""
    monkeypatch.setattr(planar_kernel, "BLOCK", 4)
    engine, nets = swimming("tendon_fish"), [engine_of("tendon_fish", seed).added.learnt for seed in (0, 3, 4)]
    engine.added = replace(engine.added, nets=tuple(nets))
    state, params, *others = given_to(engine, 8)
    params = params._replace(net=jnp.array([1, 0, 1, 1, 2, 2, 2, 2], jnp.int32))
    quickly = {"xla_backend_optimization_level": 0}
    ends = [
        jax.jit(way).lower(state, params, *others).compile(compiler_options=quickly)(state, params, *others)
        for way in (engine.physics, partial(planar_kernel.physics, engine, interpret=True))
    ]
    for one, other in zip(*map(jax.tree.leaves, ends), strict=True):
        np.testing.assert_allclose(np.asarray(other), np.asarray(one), rtol=1e-5, atol=1e-5 * np.abs(one).max())
    monkeypatch.undo()
    given = given_to(engine, planar_kernel.BLOCK)
    traced = jax.jit(partial(planar_kernel.physics, engine)).trace(*given)
    assert traced.lower(lowering_platforms=("cuda",)).as_text().count("xla.gpu.triton") == 1


@pytest.fixture
def graphics_card(monkeypatch):
    """A machine with a GPU that takes kernels, and a handful of fish is many."""
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    monkeypatch.setattr(residual_kernel, "usable", lambda: True)
    monkeypatch.setattr(residual_step, "FEWEST", FISH)


def taken(engine: planar.PlanarEngine, *given) -> bool:
    """Whether the engine takes the kernel for these."""
    return engine._physics_of(*given) != engine.physics


def test_tick_kernel_needs_many_fish_float32_learnt_water_and_a_gpu(graphics_card, monkeypatch):
    engine = swimming("fish")
    given = given_to(engine)
    assert taken(engine, *given)
    assert not taken(engine, *given, np.zeros(3))  # something in double precision
    with jax.enable_x64(True):
        assert not taken(engine, *jax.tree.map(lambda a: jnp.asarray(a, float), given))
    whole = engine.added
    engine.added = replace(whole, nets=())  # strips alone
    assert not taken(engine, *given)
    engine.added = whole
    for room, name, value in (
        (planar, "kernel", False),
        (residual_step, "kernel", False),
        (residual_step, "FEWEST", FISH + 1),
        (residual_kernel, "usable", lambda: False),
        (jax, "default_backend", lambda: "cpu"),
    ):
        with monkeypatch.context() as other:
            other.setattr(room, name, value)
            assert not taken(engine, *given)


def advanced(engine: planar.PlanarEngine) -> tuple:
    """What `PlanarEngine.advance` is given for two ticks in still water."""
    state, params, *_ = given_to(engine)
    state = state._replace(buffer=jnp.zeros((FISH, engines.rows_of(engine.robot), engine.robot.n_joints)))
    current = jax.tree.map(lambda a: jnp.asarray(np.repeat(a, FISH, 0)) if np.shape(a)[:1] == (1,) else a, stack([Flow()]))
    current = current._replace(table=stack([Flow()]).table)
    return state, jnp.zeros((FISH, 2, engine.robot.n_joints)), params, current, jnp.zeros(FISH, int)


@pytest.mark.parametrize("effects", [(), EFFECTS])
def test_triton_takes_the_kernel(effects, graphics_card):
    """The whole engine is lowered for an NVIDIA GPU, which needs none; on a CPU the same engine has no kernel in it."""
    engine = engine_of("fish", effects=effects)
    traced = jax.jit(engine.advance).trace(*advanced(engine))
    assert traced.lower(lowering_platforms=("cuda",)).as_text().count("xla.gpu.triton") == 1
    assert "triton" not in traced.lower(lowering_platforms=("cpu",)).as_text()


def test_a_gradient_through_the_engine_needs_no_kernel(graphics_card):
    engine = engine_of("tendon_fish")
    end = lambda state, *given: engine.advance(state, *given)[0].q.sum()
    there = lambda way: "pallas_call" in str(jax.make_jaxpr(way)(*advanced(engine)))
    assert there(end) and not there(jax.grad(end))


def test_a_gradient_is_that_of_the_steps_in_xla():
    """The kernel has none: the rule takes `physics` of the engine, forwards and backwards."""

    class Engine:
        physics = staticmethod(lambda a, b: jnp.sin(a) * b)

    here = 0.3, 2.0
    for of in 0, 1:
        assert jax.grad(partial(planar_kernel.tick, Engine()), of)(*here) == jax.grad(Engine.physics, of)(*here)
