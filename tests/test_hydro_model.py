"""The learnt residual keeps its promises whatever its weights, and its files are whole or refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fishmj.base.errors import ConfigError, StoreError, UnknownName
from fishmj.effects import EffectStack
from fishmj.mjcf import load_robot
from fishmj.water import residual_hooks, residual_network
from fishmj.water.dynamics import hooks, planar_chain
from fishmj.water.hydro_model import HydroModel, robot_hash
from fishmj.water.prior import flat

ROBOT = load_robot("fish")
CHAIN, NOMINAL = planar_chain.chain_of(ROBOT), planar_chain.nominal(ROBOT)
N = CHAIN.n
SIZE = len(residual_hooks.at_rest())


DRAWN = ("wake_bias", "inner_bias", "outer", "outer_bias", "even", "odd")


def wild(seed=0, members=5, hidden=16):
    """Random weights, large enough that every bound is felt."""
    rng = np.random.default_rng(seed)
    net = residual_network.blank(N, members, hidden, seed=seed)
    net = net._replace(**{k: rng.normal(0, 1, getattr(net, k).shape) for k in DRAWN})
    return residual_hooks.Residual(net, residual_hooks.unlimited(N)._replace(spread=np.array(1.0)))


def states(seed, count):
    """Random component lists: q, v, memory, flow."""
    rng = np.random.default_rng(seed)
    q = [*rng.uniform(-2, 2, (2, count)), rng.uniform(-np.pi, np.pi, count), *rng.uniform(-1, 1, (N - 1, count))]
    v = [*rng.normal(0, 0.4, (2, count)), rng.normal(0, 2, count), *rng.normal(0, 4, (N - 1, count))]
    memory = [*rng.uniform(-1, 1, (residual_network.WAKES, count)), rng.uniform(0, 0.2, count), np.zeros(count)]
    return q, v, memory, [tuple(rng.normal(0, 0.3, (2, count))) for _ in range(N)]


def step(xp, learnt, q, v, memory, flow, **options):
    """One physics step: (q, v, memory) stacked."""
    made = residual_hooks.LearnedResidual(xp, CHAIN, learnt, memory, **options)
    s = planar_chain.step(xp, CHAIN, NOMINAL, q, v, 0.5 + 0.0 * q[0], [0.0 * a for a in q[3:]], flow, (0.0, 0.0), made)
    return xp.stack([value + 0.0 * q[0] for value in (*s.q, *s.v, *s.memory)])


def test_a_mirrored_fish_mirrors_its_force():
    q, v, memory, flow = states(1, 200)
    flip = lambda a: [-x if i in (1, 2) or i > 2 else x for i, x in enumerate(a)]
    sign = np.array([*residual_network.WAKE, 1.0, 1.0])
    there = step(np, wild(), q, v, memory, flow)
    mirrored = step(np, wild(), flip(q), flip(v), [s * m for s, m in zip(sign, memory, strict=True)], [(a, -b) for a, b in flow])
    signs = np.array([*[1, -1, -1, *[-1] * (N - 1)] * 2, *sign])[:, None]
    np.testing.assert_allclose(mirrored, signs * there, rtol=0, atol=1e-12)


def test_a_moving_frame_and_a_turned_tank_change_nothing():
    q, v, memory, flow = states(2, 100)
    plain = step(np, wild(), q, v, memory, flow)
    c, s = np.cos(0.7), np.sin(0.7)
    turn = lambda x, y: (c * x - s * y, s * x + c * y)
    wind = (0.3, -0.2)
    vx, vy = turn(v[0] + wind[0], v[1] + wind[1])
    q2, v2 = [*turn(q[0], q[1]), q[2] + 0.7, *q[3:]], [vx, vy, *v[2:]]
    moved = step(np, wild(), q2, v2, memory, [turn(a + wind[0], b + wind[1]) for a, b in flow])
    new = np.array([*turn(*(plain[6:8] + np.array(wind)[:, None])), *plain[8:]])
    np.testing.assert_allclose(moved[6:], new, rtol=0, atol=1e-11)


def test_at_rest_nothing_is_added_and_nothing_moves():
    still = [np.zeros(3) for _ in range(6)]
    out = step(np, wild(), still, still, [0.3 + np.zeros(3) for _ in range(SIZE - 2)] + [np.zeros(3)] * 2, [(0.0, 0.0)] * N)
    assert (out[6:12] == 0).all()


def test_forces_grow_with_speed_squared_and_are_bounded():
    rng, p = np.random.default_rng(3), residual_network.panels(CHAIN)
    u, w, omega = rng.normal(0, 3, (3, N, 400))
    for scale in (1.0, 10.0):
        k = planar_chain.Links([], [], list(scale * omega), list(scale * u), list(scale * w), [])
        made = residual_hooks.LearnedResidual(np, CHAIN, wild(4), [np.zeros(400)] * SIZE)
        forces = made.advance(CHAIN.strips, NOMINAL.water, k, CHAIN.dt)
        m = residual_network.motion(np, p, k)
        for i in range(N):
            limit = residual_network.BOUND * 500.0 * p.area[i] * m.push[i]
            assert (np.abs(forces[i][0]) <= limit * (1 + 1e-12)).all() and (np.abs(forces[i][1]) <= limit * (1 + 1e-12)).all()


def test_the_residual_only_gives_back_what_drag_took():
    """Work done by the residual up to any time is at most the share of the dissipation that may be kept."""
    rng = np.random.default_rng(5)
    memory, count = [np.zeros(64)] * SIZE, 64
    given, taken, phase = np.zeros(count), np.zeros(count), rng.uniform(0, 6, (3, N, count))
    for k in range(300):
        u, w, omega = np.array([0.3, 0.4, 3.0])[:, None, None] * np.sin(
            7 * k * CHAIN.dt * (1 + np.arange(3))[:, None, None] + phase
        )
        links = planar_chain.Links([], [], list(omega), list(u), list(w), [])
        made = residual_hooks.LearnedResidual(np, CHAIN, wild(6), memory)
        forces = made.advance(CHAIN.strips, NOMINAL.water, links, CHAIN.dt)
        given += CHAIN.dt * sum(f[0] * u[i] + f[1] * w[i] + f[2] * omega[i] for i, f in enumerate(forces))
        taken += CHAIN.dt * residual_network.dissipated(np, CHAIN.strips, NOMINAL.water, links)
        memory = list(made.end(CHAIN, None, None, None))
        assert (memory[-2] >= 0).all() and (given <= residual_hooks.ETA * taken + 1e-5).all()
    assert (given != 0).all()


def test_numpy_jax_and_single_fish_agree():
    q, v, memory, flow = states(7, 6)
    expected = step(np, wild(), q, v, memory, flow)
    with jax.enable_x64(True):
        traced = jax.jit(lambda *a: step(jnp, wild(), *a))(q, v, memory, flow)
    np.testing.assert_allclose(np.asarray(traced), expected, rtol=0, atol=1e-11)
    alone = step(np, wild(), *([a[2] for a in part] for part in (q, v, memory)), [(a[2], b[2]) for a, b in flow])
    np.testing.assert_allclose(alone, expected[:, 2], rtol=0, atol=1e-12)


def test_wake_step_without_self_input_equals_two_half_steps():
    rng = np.random.default_rng(8)
    k = planar_chain.Links([], [], *(list(rng.normal(0, 1, (N, 20))) for _ in range(3)), [])
    m, net = residual_network.motion(np, residual_network.panels(CHAIN), k), wild(2).net
    net.wake[:, 3 * N + 1 :] = 0.0
    z = list(rng.uniform(-1, 1, (residual_network.WAKES, 20)))
    once = residual_network.wake_step(np, net, m, z, 0.02)
    twice = residual_network.wake_step(np, net, m, residual_network.wake_step(np, net, m, z, 0.01), 0.01)
    np.testing.assert_allclose(twice, once, rtol=0, atol=1e-12)
    assert np.abs(np.array(once) - z).max() > 1e-3


def test_products_mirror_as_the_force_that_they_make():
    """Of every pair of features exactly one kind, so that the bilinear part needs no second branch."""
    even, odd = residual_network.products(N)
    assert len(even[0]) + len(odd[0]) == (3 * N + 1) * (3 * N + 2) // 2
    sign = np.array([*[1] * (N + 1), *[-1] * (2 * N)])
    assert (sign[even[0]] * sign[even[1]] == 1).all() and (sign[odd[0]] * sign[odd[1]] == -1).all()


def test_it_acts_together_with_effects():
    q, v, memory, flow = states(9, 5)
    active = EffectStack([], N - 1)
    nothing = hooks.Effects(np, active, [], list(active.memory))
    both = step(np, wild(), q, v, [*active.memory, *memory], flow, inner=nothing)
    plain = step(np, wild(), q, v, memory, flow)
    np.testing.assert_allclose(np.delete(both, [12, 13], 0), plain, rtol=0, atol=1e-13)  # the effects' own memory comes first


def made(learnt=None, **changes):
    members = np.tile(flat(NOMINAL.water), (5, 1))
    given = dict(name="swift", robot=ROBOT.name, robot_sha256=robot_hash(ROBOT), dt=CHAIN.dt, slip=1.0, base=NOMINAL.water)
    return HydroModel(**given | dict(members=members, alone=np.tile(members[:1], (6, 1)), learnt=learnt, notes="made") | changes)


def test_a_model_comes_back_as_it_was_saved(tmp_path):
    model = made(wild(), band={"speed": [0.01, 0.03, 1.5]}, found={"linear": {"condition": 3.0, "parameters": {}}})
    back = HydroModel.load(model.save(tmp_path))
    q, v, memory, flow = states(10, 4)
    kept = residual_hooks.Residual(
        *(type(part)(*(np.asarray(a, np.float32).astype(float) for a in part)) for part in model.learnt)
    )
    np.testing.assert_array_equal(step(np, back.learnt, q, v, memory, flow), step(np, kept, q, v, memory, flow))
    assert back.base == model.base and back.band == model.band and back.found == model.found and back.slip == 1.0
    assert back.base_only.learnt is None
    assert back.swimmer(ROBOT).water == NOMINAL.water


def test_a_model_of_another_fish_or_step_is_refused():
    with pytest.raises(ConfigError, match="fitted for robot 'swift'.*fishmj hydro_fit"):
        made().swimmer(load_robot("tendon_fish"))
    with pytest.raises(ConfigError, match=r"fitted at dt = 0.002 s, the robot steps 0.004 s"):
        made(dt=0.002).swimmer(ROBOT)
    with pytest.raises(UnknownName, match="fitted water 'nobody'"):
        HydroModel.load("nobody")


def test_damaged_or_swapped_weights_are_refused(tmp_path):
    path = made(wild()).save(tmp_path)
    weights = path.with_suffix(".safetensors")
    whole = weights.read_bytes()
    weights.write_bytes(whole[:-3] + b"abc")
    with pytest.raises(StoreError, match="swift.safetensors: expected sha256"):
        HydroModel.load(path)
    made(wild(1)).save(tmp_path / "other")
    weights.write_bytes((tmp_path / "other" / "swift.safetensors").read_bytes())
    with pytest.raises(StoreError, match="expected sha256"):
        HydroModel.load(path)
