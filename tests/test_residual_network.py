"""The learnt force costs one branch of the mirror and is what both branches give, in every arithmetic."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_hydro_model import CHAIN, N, states, step, wild

from fishmj.water import residual_hooks, residual_kernel, residual_network, residual_step
from fishmj.water.dynamics.planar_chain import Links
from fishmj.water.hydro_model import HydroModel

SIGNS = np.array([*[1.0] * (N + 1), *[-1.0] * (2 * N)])
WAKE = np.array(residual_network.WAKE)
TURNED = np.array([1.0] * N + [-1.0] * (2 * N))  # what a mirror makes of F_t, F_n, couple


def two_branches(net, x, z):
    """Coefficients (E, 3, N, B) and wake target (G, B) by the definition: phi and N at the input and at its mirror image."""
    there = np.concatenate([x, z])
    back = np.concatenate([SIGNS, WAKE])[:, None] * there
    target = lambda s: np.tanh(net.wake @ s + net.wake_bias[:, None])
    hidden = lambda s: np.tanh(np.einsum("ehf,fb->ehb", net.inner, s) + net.inner_bias[..., None])
    given = [np.einsum("eoh,ehb->eob", net.outer, hidden(s)) + net.outer_bias[..., None] for s in (there, back)]
    pairs = [weights @ (x[i] * x[j]) for weights, (i, j) in zip((net.even, net.odd), residual_network.products(N), strict=True)]
    whole = 0.5 * (given[0] + TURNED[:, None] * given[1]) + np.concatenate(pairs)
    g = residual_network.BOUND * np.tanh(whole / residual_network.BOUND)
    return g.reshape(len(g), 3, N, -1), 0.5 * (target(there) + WAKE[:, None] * target(back))


def drawn(seed, count):
    """Motion and wake of `count` fish."""
    rng = np.random.default_rng(seed)
    omega, u, w = (list(a) for a in rng.normal(0, 0.5, (3, N, count)))
    m = residual_network.motion(np, residual_network.panels(CHAIN), Links([], [], omega, u, w, []))
    return m, list(rng.uniform(-1, 1, (residual_network.WAKES, count)))


NETS = {"shipped": lambda: HydroModel.load("swift").learnt.net, "wild": lambda: wild(3).net, "of one": lambda: wild(4, 1, 7).net}


@pytest.mark.parametrize("name", NETS)
@pytest.mark.parametrize("xp", [np, jnp])
def test_one_branch_gives_what_two_define(name, xp):
    net, (m, z) = NETS[name](), drawn(1, 300)
    expected, target = two_branches(net, np.array(m.x), np.array(z))
    with jax.enable_x64(True):
        g = np.asarray(residual_network.coefficients(xp, net, m, z))
        moved = np.asarray(residual_network.wake_step(xp, net, m, z, 0.004))
        both = residual_network.step(xp, net, m, z, 0.004)
    np.testing.assert_allclose(g, expected, rtol=0, atol=1e-12 * np.abs(expected).max())
    decay = np.exp(-0.004 * m.speed / np.exp(net.reach)[:, None])
    np.testing.assert_allclose(moved, target + (z - target) * decay, rtol=0, atol=1e-13)
    for one, other in zip(both, (g, moved), strict=True):
        np.testing.assert_allclose(np.asarray(one), other, rtol=0, atol=1e-13)


def test_a_mirrored_motion_mirrors_to_the_bit():
    """Not to round-off: sums of a mirrored input are the same sums, so no drift to one side grows out of it."""
    net, (m, z) = wild(5).net, drawn(2, 64)
    back = m._replace(x=[s * a for s, a in zip(SIGNS, m.x, strict=True)]), [s * a for s, a in zip(WAKE, z, strict=True)]
    (g, moved), (mirrored, turned) = (residual_network.step(np, net, *given, 0.004) for given in ((m, z), back))
    assert (mirrored == TURNED.reshape(1, 3, N, 1) * g).all()
    assert (np.array(turned) == WAKE[:, None] * np.array(moved)).all()


def test_single_precision_keeps_seven_digits():
    net, (m, z) = NETS["shipped"](), drawn(3, 300)
    single = lambda tree: jax.tree.map(lambda a: np.asarray(a, np.float32), tree)
    expected, _ = two_branches(net, np.array(m.x), np.array(z))
    g = jax.jit(lambda *a: residual_network.coefficients(jnp, *a))(*single((net, m, z)))
    assert g.dtype == jnp.float32
    np.testing.assert_allclose(np.asarray(g), expected, rtol=0, atol=2e-5)


def test_products_are_not_rounded_on_a_graphics_card():
    """JAX rounds float32 to ten bits there unless it is told otherwise."""
    net, (m, z) = wild(6).net, drawn(4, 8)
    text = str(jax.make_jaxpr(lambda *a: residual_network.step(jnp, *a, 0.004))(net, m, z))
    assert text.count("dot_general") == text.count("precision=(Precision.HIGHEST, Precision.HIGHEST)") == 6


@pytest.mark.slow
@pytest.mark.parametrize("speed", [0.0, 1e-3, 1.0, 30.0])
def test_gradients_are_finite_at_rest_and_far_out(speed):
    q, v, memory, flow = states(11, 4)
    v, flow = [speed * a for a in v], [(speed * a, speed * b) for a, b in flow]

    def moved(weights):
        learnt = residual_hooks.Residual(weights, residual_hooks.unlimited(N))
        return jnp.sum(step(jnp, learnt, q, v, memory, flow) ** 2)

    gradient = jax.grad(moved)(jax.tree.map(lambda a: jnp.asarray(a, jnp.float32), wild(7).net))
    assert all(np.isfinite(np.asarray(part)).all() for part in gradient)
    assert any(np.abs(np.asarray(part)).max() > 0 for part in gradient)
    # what turns has no bias left
    assert (np.asarray(gradient.outer_bias)[:, N:] == 0).all()


def test_weights_sorted_before_give_the_same():
    net, (m, z) = wild(8).net, drawn(5, 20)
    sorted_before = residual_network.halves(np, net)
    assert residual_network.halves(np, sorted_before) is sorted_before
    for one, other in zip(*(residual_network.step(np, given, m, z, 0.02) for given in (net, sorted_before)), strict=True):
        np.testing.assert_array_equal(one, other)
    changed = net._replace(outer=2.0 * net.outer)  # another net in between: nothing of the first one is left
    assert np.abs(residual_network.coefficients(np, changed, m, z) - residual_network.coefficients(np, net, m, z)).max() > 0.1


def small(seed):
    """A net of two members with three units each, and five fish: what the kernel does needs no more to show."""
    net = wild(seed, 2, 3).net
    m, z = drawn(seed, 5)
    single = lambda tree: jax.tree.map(lambda a: jnp.asarray(a, jnp.float32), tree)
    return net, *single((m._replace(push=[], square=[], middle=[]), z))


def test_the_kernel_gives_what_the_products_give(monkeypatch):
    """Five fish do not fill a block of eight; three units and two members are odd numbers for it."""
    monkeypatch.setattr(residual_kernel, "BLOCK", 8)
    net, m, z = small(9)
    got = residual_kernel.step(residual_network.halves(np, net), m, z, 0.02, interpret=True)
    expected = residual_network.mean_by_products(np, net, *jax.tree.map(lambda a: np.asarray(a, float), (m, z)), 0.02)
    for one, other, scale in zip(got, expected, (1.0, 10.0, 1.0), strict=True):
        np.testing.assert_allclose(np.array(one), np.array(other), rtol=0, atol=2e-6 * scale)
    assert np.asarray(got[0]).shape == (3, N, 5) and np.asarray(got[1]).shape == (5,) and len(got[2]) == residual_network.WAKES


def test_residual_kernel_needs_float32_on_a_gpu_and_matches_the_gradient(monkeypatch):
    net, m, z = small(10)
    assert "custom_vjp" not in str(jax.make_jaxpr(lambda *a: residual_step.mean_step(jnp, net, *a, 0.02))(m, z))
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    monkeypatch.setattr(residual_kernel, "usable", lambda: True)
    monkeypatch.setattr(residual_step, "FEWEST", len(m.speed))
    taken = lambda given: str(jax.make_jaxpr(lambda *a: residual_step.mean_step(jnp, net, *a, 0.02))(*given))
    assert "pallas_call" in taken((m, z)) and "pallas_call" not in taken(jax.tree.map(lambda a: a[0], (m, z)))
    with jax.enable_x64(True):
        assert "pallas_call" not in taken(jax.tree.map(lambda a: jnp.asarray(np.asarray(a, float)), (m, z)))
    monkeypatch.setattr(residual_step, "FEWEST", len(m.speed) + 1)
    assert "pallas_call" not in taken((m, z))

    def total(way):
        """Gradient of all that comes out, by the speed."""
        return jax.grad(lambda v: sum(jnp.sum(a) for a in jax.tree.leaves(way(net, m._replace(speed=v), z))))(m.speed)

    by_rule = total(lambda net, m, z: residual_kernel.mean_step(0.02, residual_network.halves(np, net), m, z))
    plain = total(lambda net, m, z: residual_network.mean_by_products(jnp, net, m, z, 0.02))
    np.testing.assert_allclose(np.asarray(by_rule), np.asarray(plain), rtol=1e-5)


def test_device_without_kernel_support_is_reported_once_and_uses_products(capsys):
    """This CPU is such a device; for an NVIDIA GPU the kernel that tries it is lowered, which needs none."""
    residual_kernel.usable.cache_clear()
    assert not residual_kernel.usable() and not residual_kernel.usable()
    said = capsys.readouterr().err
    assert said.count("Matrix products replace them") == 1 and "compute capability" in said
    residual_kernel.usable.cache_clear()
    table = jax.ShapeDtypeStruct((residual_kernel.BLOCK, 4), jnp.float32)
    lowered = residual_kernel.probe.trace(table, table).lower(lowering_platforms=("cuda",))
    assert lowered.as_text().count("xla.gpu.triton") == 1
