"""The strip water obeys the symmetries and the signs of the physics, whatever its coefficients."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fishmj import mjcf
from fishmj.base.errors import ConfigError
from fishmj.water.dynamics import planar_chain, strip_forces

ROBOT = mjcf.load_robot("fish")
CHAIN = planar_chain.chain_of(ROBOT)
NOMINAL = planar_chain.nominal(ROBOT)
N = CHAIN.n
SEEDS = st.integers(0, 2**32 - 1)


def states(seed, count):
    """Random poses and velocities of `count` fish as component lists, attachment, flow and DU/Dt."""
    rng = np.random.default_rng(seed)
    q = [*rng.uniform(-2, 2, (2, count)), rng.uniform(-np.pi, np.pi, count), *rng.uniform(-1.05, 1.05, (N - 1, count))]
    v = [*rng.normal(0, 0.4, (2, count)), rng.normal(0, 2, count), *rng.normal(0, 4, (N - 1, count))]
    flow = [tuple(rng.normal(0, 0.3, (2, count))) for _ in range(N)]
    return q, v, rng.random(count), flow, tuple(rng.normal(0, 1, (2, count)))


def draw_coefficients(rng):
    """Passive coefficients far from the nominal ones."""
    w = NOMINAL.water
    a = rng.uniform(0, 1)
    return w._replace(
        k=list(rng.uniform(0.3, 1.5, N)),
        cn=list(rng.uniform(0.2, 4, N)),
        cf=rng.uniform(0, 0.05),
        ca_forward=rng.uniform(0, 1),
        ca_backward=rng.uniform(0, 1),
        ke=rng.uniform(0, 1),
        lift_a=a,
        lift_b=max(0.0, 0.5 - a) + rng.uniform(0, 1),
    )


def generalised_water(water, q, v, attached, flow, ambient, parts=None):
    """Generalised explicit water force over (x, y, psi, j), component list; `parts` picks some of the terms."""
    k = planar_chain.kinematics(np, CHAIN, q, v, flow)
    sw = NOMINAL._replace(water=water)
    if parts is None:
        forces = planar_chain.water_forces(np, CHAIN, sw, k, q[2], ambient, attached)
    else:
        forces = [parts(i, k.u[i], k.w[i], k.omega[i], attached) for i in range(N)]
    return planar_chain.generalised(np, CHAIN, q[2], planar_chain.gather(CHAIN, k, forces))


def dissipative(water):
    """Drag, head form and trailing edge of each link."""

    def parts(i, u, w, omega, attached):
        out = [strip_forces.resistive(np, CHAIN.strips, water, i, u, w, omega)]
        if i == 0:
            out.append((strip_forces.head_form(np, CHAIN.strips, water, u), 0.0, 0.0))
        if i == N - 1:
            out.append(strip_forces.trailing_edge(np, CHAIN.strips, water, u, w, omega, attached))
        return tuple(sum(c) for c in zip(*out, strict=True))

    return parts


def test_drag_and_trailing_edge_never_feed_energy():
    """20 000 random states, each with its own passive coefficients: power relative to the water <= 0."""
    worst = -np.inf
    for seed in range(200):
        water = draw_coefficients(np.random.default_rng(seed))
        q, v, attached, _, _ = states(seed, 100)
        still = [(0.0, 0.0)] * N
        force = generalised_water(water, q, v, attached, still, (0.0, 0.0), dissipative(water))
        worst = max(worst, np.max(sum(f * r for f, r in zip(force, v, strict=True))))
    assert worst <= 0


@given(SEEDS)
def test_reactive_part_does_no_net_work(seed):
    """d/dt (v M_a v / 2) equals the power of the inertial reaction: forces of added mass store energy, never make it.

    With Q = -M_a a + Q_r: power Q_r v + d/dt(v M_a v)/2 - v M_a a = v dM_a/dt v / 2 + Q_r v must vanish.
    """
    q, v, _, _, _ = states(seed, 20)
    k = planar_chain.kinematics(np, CHAIN, q, v, [(0.0, 0.0)] * N)
    parts = lambda i, u, w, omega, x: tuple(
        a + b for a, b in zip(strip_forces.reactive(CHAIN.strips, NOMINAL.water, i, u, w, omega), bias[i], strict=True)
    )
    bias = planar_chain.bias_forces(CHAIN, NOMINAL, k, rigid=False)
    force = generalised_water(NOMINAL.water, q, v, None, [(0.0, 0.0)] * N, None, parts)
    power = sum(f * r for f, r in zip(force, v, strict=True))

    def energy(q):
        k = planar_chain.kinematics(np, CHAIN, q, v, [(0.0, 0.0)] * N)
        m = planar_chain.mass_matrix(CHAIN, NOMINAL, k, rigid=False)
        c, s = np.cos(q[2]), np.sin(q[2])
        head = [c * v[0] + s * v[1], c * v[1] - s * v[0], *np.cumsum(np.stack(v[2:]), 0)]
        return sum(m[max(r, j)][min(r, j)] * head[r] * head[j] for r in range(N + 2) for j in range(N + 2)) / 2

    eps = 1e-6
    shift = lambda sign: [a + sign * eps * b for a, b in zip(q, v, strict=True)]
    rate = (energy(shift(1)) - energy(shift(-1))) / (2 * eps)  # v dM_a/dt v / 2
    np.testing.assert_allclose(power + rate, 0, atol=1e-6 * (1 + np.abs(rate).max()))


def step(q, v, attached, target, flow, ambient, xp=np, dt=None):
    ch = CHAIN if dt is None else CHAIN._replace(dt=dt)
    return planar_chain.step(xp, ch, NOMINAL, q, v, attached, target, flow, ambient)


def targets(seed, count):
    return list(np.random.default_rng([seed, 1]).uniform(-1, 1, (N - 1, count)))


@given(SEEDS)
def test_galilean_invariance(seed):
    """A fish swimming in a uniform stream is the fish in still water seen from a boat, to 1e-12."""
    q, v, attached, flow, ambient = states(seed, 8)
    t, boat = targets(seed, 8), np.random.default_rng([seed, 2]).normal(size=2)
    one = step(q, v, attached, t, flow, ambient)
    moved = step(q, [v[0] + boat[0], v[1] + boat[1], *v[2:]], attached, t, [(a + boat[0], b + boat[1]) for a, b in flow], ambient)
    np.testing.assert_allclose(np.subtract(moved.v[:2], one.v[:2]), np.outer(boat, np.ones(8)), rtol=0, atol=1e-11)
    np.testing.assert_allclose(moved.v[2:], one.v[2:], rtol=0, atol=1e-10)
    np.testing.assert_allclose(moved.power, one.power, rtol=1e-12, atol=1e-12)


@given(SEEDS)
def test_rotation_invariance(seed):
    """Turning tank, flow and fish together turns the result."""
    q, v, attached, flow, ambient = states(seed, 8)
    t, angle = targets(seed, 8), np.random.default_rng([seed, 3]).uniform(-np.pi, np.pi)
    turn = lambda a: (np.cos(angle) * a[0] - np.sin(angle) * a[1], np.sin(angle) * a[0] + np.cos(angle) * a[1])
    one = step(q, v, attached, t, flow, ambient)
    two = step([*turn(q), q[2] + angle, *q[3:]], [*turn(v), *v[2:]], attached, t, [turn(f) for f in flow], turn(ambient))
    np.testing.assert_allclose(two.v, [*turn(one.v), *one.v[2:]], rtol=0, atol=1e-10)
    np.testing.assert_allclose(two.applied, [*turn(one.applied), *one.applied[2:]], rtol=1e-10, atol=1e-9)
    np.testing.assert_allclose(two.attached, one.attached, rtol=0, atol=1e-12)


@given(SEEDS)
def test_mirrored_fish_mirrors_its_force(seed):
    q, v, attached, flow, ambient = states(seed, 8)
    t = targets(seed, 8)
    flip = lambda a: [a[0], -a[1], *(-x for x in a[2:])]
    one = step(q, v, attached, t, flow, ambient)
    two = step(flip(q), flip(v), attached, [-x for x in t], [flip(f) for f in flow], flip(ambient))
    for name in ("q", "v", "applied"):
        np.testing.assert_allclose(getattr(two, name), flip(getattr(one, name)), rtol=0, atol=1e-12)
    np.testing.assert_array_equal(two.power, one.power)


def test_still_water_is_still():
    """At rest in still water, with joints where they are commanded, nothing moves at all."""
    bend = [0.3, -0.2, 0.5]
    s = step([0.4, -0.1, 1.0, *bend], [0.0] * 6, 0.5, bend, [(0.0, 0.0)] * N, (0.0, 0.0))
    assert not np.any(s.v) and not np.any(s.applied) and s.power == 0


def test_riding_along_with_the_stream_is_rest():
    s = step([0.0] * 6, [0.2, -0.1, 0, 0, 0, 0], 0.5, [0.0] * 3, [(0.2, -0.1)] * N, (0.0, 0.0))
    np.testing.assert_allclose(s.applied, 0, atol=1e-15)


@given(SEEDS)
def test_numpy_equals_jax(seed):
    """One definition, two array libraries: 1e-12 of each other in float64."""
    q, v, attached, flow, ambient = states(seed, 8)
    t = targets(seed, 8)
    mine = step(q, v, attached, t, flow, ambient)
    with jax.enable_x64(True):
        other = step(*jax.tree.map(jnp.asarray, (q, v, attached, t, flow, ambient)), xp=jnp)
        for name in mine._fields:
            a, b = np.asarray(getattr(mine, name)), np.asarray(getattr(other, name))
            np.testing.assert_allclose(b, a, rtol=1e-12, atol=1e-12 * max(1.0, np.abs(a).max(initial=0.0)), err_msg=name)


def test_gradients_are_finite_at_rest():
    """Square roots and angles are smoothed, so that a fish at rest has a gradient."""

    def speed(target):
        q, v, x = [0.0] * 6, [0.0] * 6, 0.5
        for _ in range(3):
            s = step(q, v, x, list(target), [(0.0, 0.0)] * N, (0.0, 0.0), xp=jnp)
            q, v, x = s.q, s.v, s.attached
        return v[2]

    assert np.isfinite(jax.grad(speed)(jnp.zeros(3))).all()


def swim(dt, seconds=2.0):
    """Path of the gait at step dt: end point and heading (3,)."""
    q, v, x = [0.0] * 6, [0.0] * 6, 0.5
    for i in range(round(seconds / dt)):
        t = np.radians(30) * np.sin(2 * np.pi * i * dt - np.radians(60) * np.arange(3))
        s = step(q, v, x, list(t), [(0.0, 0.0)] * N, (0.0, 0.0), dt=dt)
        q, v, x = s.q, s.v, s.attached
    return np.array(q[:3])


def test_time_stepping_is_first_order():
    """Successive differences halve with the step: order 1 +- 0.2; the 4 ms default errs by centimetres over 2 s."""
    ends = [swim(dt) for dt in (0.004, 0.002, 0.001, 0.0005)]
    gaps = [np.linalg.norm(a - b) for a, b in zip(ends, ends[1:], strict=False)]
    orders = np.log2(np.divide(gaps[:-1], gaps[1:]))
    np.testing.assert_allclose(orders, 1, atol=0.2)
    assert gaps[0] < 0.05


@pytest.mark.slow
@given(SEEDS)
def test_energy_never_grows_without_servos(seed):
    """A limp fish thrown into still water only slows down (0.25 ms steps: explicit terms err by O(dt))."""
    q, v, attached, _, _ = states(seed, 1)
    q, v = [a[0] for a in q], [0.3 * a[0] for a in v]
    limp = NOMINAL._replace(kp=[0.0] * 3, kv=[0.0] * 3, kb=[1e-12] * 3)
    ch, x, last = CHAIN._replace(dt=2.5e-4), attached[0], np.inf
    for i in range(200):
        if i % 20 == 0:
            k = planar_chain.kinematics(np, ch, q, v, [(0.0, 0.0)] * N)
            m = planar_chain.mass_matrix(ch, limp, k)
            c, s = np.cos(q[2]), np.sin(q[2])
            head = [c * v[0] + s * v[1], c * v[1] - s * v[0], *np.cumsum(v[2:])]
            energy = sum(m[max(r, j)][min(r, j)] * head[r] * head[j] for r in range(N + 2) for j in range(N + 2)) / 2
            assert energy < last * (1 + 1e-3)
            last = energy
        s = planar_chain.step(np, ch, limp, q, v, x, [0.0] * 3, [(0.0, 0.0)] * N, (0.0, 0.0))
        q, v, x = s.q, s.v, s.attached


@given(SEEDS)
def test_attachment_stays_between_stalled_and_attached(seed):
    q, v, attached, flow, _ = states(seed, 50)
    k = planar_chain.kinematics(np, CHAIN, q, v, flow)
    for dt in (0.004, 1.0):
        x = strip_forces.attachment(np, CHAIN.strips, NOMINAL.water, k.u[-1], k.w[-1], k.omega[-1], attached, dt)
        assert (x >= 0).all() and (x <= 1).all()


def test_coefficients_that_feed_energy_are_refused():
    with pytest.raises(ConfigError, match="can add energy"):
        strip_forces.coefficients(dict(ROBOT.water, lift_a=0.1, lift_b=0.2), N)
    with pytest.raises(ConfigError, match="one value for each of"):
        strip_forces.coefficients(dict(ROBOT.water, k=[0.9]), N)


def test_an_edge_at_its_bound_reads_as_it_was_rounded():
    strip_forces.coefficients(dict(ROBOT.water, lift_a=0.123456789, lift_b=0.37654321), N)
    with pytest.raises(ConfigError, match="can add energy"):
        strip_forces.coefficients(dict(ROBOT.water, lift_a=0.1, lift_b=0.39999), N)
