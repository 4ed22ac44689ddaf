"""Effects in a swimming fish: each shows where it says, none has a side of its own, none blows up, none feeds energy."""

from types import SimpleNamespace

import numpy as np
import pytest
from effect_swim import CHAIN, JOINTS, SWIMMER, H, gait, sense, swim

from fishmj import effects
from fishmj.effects import EffectStack
from fishmj.effects.sites import BodyMotion, Gear, SensorReadings
from fishmj.effects.stack import delivered
from fishmj.effects.stages.actuator_joint import GIVE
from fishmj.water.dynamics import planar_chain
from fishmj.water.dynamics.hooks import Effects

LASTING = [e for e in effects.catalogue().values() if not e.stochastic]
ACTIVE = EffectStack(LASTING, JOINTS)
SIGNED = [e for e in LASTING if e.parameters[0].signed]
TIMES = {"typical": 1.0, "three": 3.0, "minus three": -3.0}
FLOOR = {"joint": 1e-3, "position": 2e-4, "heading": 5e-4, "power": 0.01}  # rad, m, rad, W: rms that counts as a change


def row(effect=None, times: float = 1.0) -> np.ndarray:
    """The null row but for one effect (None: every one), `times` as far from its null as its larger typical value."""
    out = np.array(ACTIVE.null)
    for i, (name, parameter) in enumerate(ACTIVE.names):
        if effect in (None, name):
            p = effects.get(name).parameter(parameter)
            out[i] = p.probe if p.shape else np.clip(p.null + times * (p.probe - p.null), p.low, p.high)
    return out


@pytest.fixture(scope="module")
def swims():
    """{(effect, times): (Seen over 10 s, q, v)} at 2 Hz and 30 deg, one batch."""
    keys = [("", ""), *((e.name, times) for times in TIMES for e in (SIGNED if TIMES[times] < 0 else LASTING))]
    rows = [row(name or "nothing", TIMES.get(times, 1.0)) for name, times in keys]
    q, v, power = swim(ACTIVE, rows, gait(10, 2.0, 30, 5), start=(1.0, 0.5, 2.5, 0, 0, 0), push=(-0.2, 0.1, 0, 0, 0, 0))
    seen = sense(ACTIVE, rows, q, power)
    one = lambda i: SensorReadings(seen.t, *(part[i] for part in seen[1:]))
    return {key: (one(i), q[i], v[i]) for i, key in enumerate(keys)}


@pytest.mark.parametrize("name", [e.name for e in LASTING])
def test_an_effect_of_typical_size_shows_in_the_channels_that_it_names(swims, name):
    first = round(4 / H)
    with_it, without = swims[name, "typical"][0], swims["", ""][0]

    def rms(*fields):
        return np.sqrt(sum(np.mean((getattr(with_it, f)[:first] - getattr(without, f)[:first]) ** 2) for f in fields))

    change = {"joint": rms("joint"), "position": rms("x", "y"), "heading": rms("yaw"), "power": rms("power")}
    effect = effects.get(name)
    for channel in effect.shows:
        assert change[channel] > FLOOR[channel], (channel, change)
    if not set(effect.sites) - {"measure"} and "command" not in effect.delays:  # it does not touch the fish
        assert not any(change[channel] for channel in change if channel not in effect.shows), change


@pytest.mark.parametrize("times", ["three", "minus three"])
def test_swimming_stays_bounded_at_three_times_the_typical_size(swims, times):
    for (name, size), (_, q, v) in swims.items():
        if size == times:
            speed, joint, rate = np.hypot(*v[:, :2].T).max(), np.abs(q[:, 3:]).max(), np.abs(v[:, 3:]).max()
            assert speed < 1.5 and joint < np.pi / 2 and rate < 30.0, (name, speed, joint, rate)


def test_velocity_filter_delays_nothing_but_velocities():
    only = EffectStack([effects.get("velocity_filter")], JOINTS)
    late = {clock: only.delay(np, [0.1], clock) for clock in effects.effect.CLOCKS}
    assert late == dict.fromkeys(late, 0.0) | {"velocity": 0.1}


def test_mirrored_fish_and_water_with_every_effect_swim_the_mirror_image():
    flip = np.array([1.0, -1, -1, -1, -1, -1])
    sent, given = gait(1.0, 1.5, 25, 6) + 1e-5, row(None, 0.7)  # off the ties of rounding
    for i, (name, _) in enumerate(ACTIVE.names):
        given[i] = ACTIVE.null[i] if effects.get(name).one_sided else given[i]
    other = given * [-1.0 if parameter in effects.get(name).handed else 1.0 for name, parameter in ACTIVE.names]
    start, push, flow = np.array([0.9, 0.4, 2.0, 0.1, -0.2, 0.1]), np.array([-0.2, 0.1, 0.5, 1, -1, 0.5]), np.array([0.05, 0.08])
    one = swim(ACTIVE, [given], sent, start, push, flow)
    two = swim(ACTIVE, [other], -sent, flip * start, flip * push, flow * (1, -1))
    np.testing.assert_allclose(two[0], flip * one[0], rtol=0, atol=1e-9)
    np.testing.assert_allclose(two[2], one[2], rtol=0, atol=1e-6)
    left, right = sense(ACTIVE, [given], one[0], one[2]), sense(ACTIVE, [other], two[0], two[2])
    for name, sign in (("x", 1), ("y", -1), ("yaw", -1), ("joint", -1), ("power", 1)):
        np.testing.assert_allclose(getattr(right, name), sign * getattr(left, name), rtol=0, atol=1e-6, err_msg=name)
    # and each was there: a mirror proves nothing of an effect that this swim does not reach
    rows = [np.array(ACTIVE.null), *(row(e.name, 0.7) for e in LASTING)]
    q, _, power = swim(ACTIVE, rows, sent, start, push, flow)
    seen = np.concatenate([np.reshape(part, (len(rows), -1)) for part in sense(ACTIVE, rows, q, power)[1:]], 1)
    moved = np.abs(seen[1:] - seen[0]).max(1)
    assert [e.name for e, most in zip(LASTING, moved, strict=True) if most < 1e-6 and e.shows] == []


DRY = SWIMMER.water._replace(k=[0.0] * 4, cn=[0.0] * 4, cf=0.0, ca_forward=0.0, ca_backward=0.0, ke=0.0)
FREE = SWIMMER._replace(water=DRY, kp=[0.0] * 3, kv=[0.0] * 3, kb=[1e-12] * 3)  # nothing but its own inertia


def kinetic(q, v):
    """Kinetic energy of the fish in a void, J; q, v (6, ...)."""
    k = planar_chain.kinematics(np, CHAIN, list(q), list(v), [(0.0, 0.0)] * CHAIN.n)
    m = planar_chain.mass_matrix(CHAIN, FREE, k)
    rates = [np.cos(q[2]) * v[0] + np.sin(q[2]) * v[1], np.cos(q[2]) * v[1] - np.sin(q[2]) * v[0], *k.omega]
    return sum(m[max(i, j)][min(i, j)] * rates[i] * rates[j] for i in range(6) for j in range(6)) / 2


@pytest.mark.parametrize("name", ["coulomb_friction", "viscous_friction", "stribeck", "joint_hydro_damping"])
def test_friction_takes_energy_in_every_step_at_any_speed(name):
    rng, active = np.random.default_rng(1), EffectStack([effects.get(name)], JOINTS)
    speeds = np.array([0.3, 0.3, 3, 10, 10, 10])[:, None] * 10 ** rng.uniform(-3, 0, 400)
    q, v = rng.normal(size=(6, 400)), rng.normal(size=(6, 400)) * speeds
    first = effects.get(name).parameters[0]
    after = []
    for size in (0.0, first.probe):
        hooks = Effects(np, active, active.flat({name: {first.name: size}}), active.memory)
        s = planar_chain.step(
            np, CHAIN, FREE, list(q), list(v), np.full(400, 0.5), [0.0] * 3, [(0.0, 0.0)] * 4, (0.0, 0.0), hooks
        )
        after.append(kinetic(q, np.array(s.v)))
    lost = after[0] - after[1]
    bent = (
        np.clip(CHAIN.dt * v[3:], -GIVE, GIVE) if effects.get(name).memory else np.zeros((3, 400))
    )  # teeth give way, and spring back
    stored = first.probe * np.sum(bent**2, 0) / (2 * GIVE)
    assert (lost > -1e-12 * after[0] - stored).all() and (lost > 0).mean() > 0.8


def probes(effect) -> SimpleNamespace:
    return SimpleNamespace(**{p.name: p.probe for p in effect.parameters}, joint=0, robot=effects.RobotScales())


def test_brakes_of_gears_and_water_never_push():
    rng = np.random.default_rng(2)
    for effect in (e for e in LASTING if e.gear is not None and not e.memory and not e.stores):
        g, _ = effect.gear(np, probes(effect), Gear(*rng.normal(size=(3, 500)), 0.0, 0.0, 1.0, 0.3, 1.667), (), H)
        assert np.all(g.resist * g.rate**2 - g.torque * g.rate > -1e-12), effect.name
    for name in ("linear_surge_drag", "quadratic_drag", "yaw_drag", "body_lift", "free_surface"):
        still = dict.fromkeys(BodyMotion._fields, 0.0) | {"wet": 1.0}
        moving = still | dict(zip("uwr", rng.normal(size=(3, 500)), strict=True))
        b, _ = effects.get(name).body(np, probes(effects.get(name)), BodyMotion(**moving), (), H)
        power = b.fx * b.u + b.fy * b.w + b.n * b.r
        assert np.all(power <= 0.0) and power.min() < 0.0, name


def test_added_mass_keeps_energy_and_impulse():
    names, h = ("surge_added_mass", "sway_added_mass", "yaw_added_mass"), 2e-4
    active, added = EffectStack([effects.get(name) for name in names], JOINTS), np.diag([0.4, 2.0, 0.05])
    q = [np.full(3, x) for x in (0.0, 0.0, 0.3, 0.2, -0.1, 0.3)]
    v = [np.full(3, x) for x in (0.4, 0.3, 2.0, 1.0, -2.0, 1.5)]
    ch, still = CHAIN._replace(dt=h), [(0.0, 0.0)] * 4

    def kept(q, v):
        """Energy, and impulse along x and y of the world, (3, rows)."""
        k = planar_chain.kinematics(np, CHAIN, q, v, still)
        m = planar_chain.mass_matrix(CHAIN, FREE, k)
        along = [k.u[0], k.w[0], *k.omega]
        px, py = (sum(m[max(i, j)][min(i, j)] * along[j] for j in range(6)) + added[i] * along[i] for i in (0, 1))
        c, s = np.cos(q[2]), np.sin(q[2])
        return np.array([kinetic(q, v) + (added * np.square(along[:3])).sum(0) / 2, c * px - s * py, s * px + c * py])

    begin, memory = kept(q, v), active.memory
    for _ in range(1000):
        s = planar_chain.step(np, ch, FREE, q, v, 0.5, [0.0] * 3, still, (0.0, 0.0), Effects(np, active, list(added), memory))
        q, v, memory = s.q, s.v, s.memory
    np.testing.assert_allclose(kept(q, v), begin, rtol=1e-2)
    assert np.all(np.abs(q[2] - 0.3) > 0.1)  # and it did turn


def test_commands_of_a_batch_are_those_of_its_rows():
    rows, sent = np.stack([row(None, times) for times in (0.0, 0.5, 1.0)]), gait(0.6, 2.0, 30)
    together = delivered(np, ACTIVE, rows, sent, H)
    assert together.shape == (3, *sent.shape)
    for one, many in zip(rows, together, strict=True):
        np.testing.assert_array_equal(delivered(np, ACTIVE, one, sent, H), many)
    np.testing.assert_array_equal(together[0], sent)
