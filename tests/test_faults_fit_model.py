"""Faults of a fitted water: asked outside its range, or fitted to data that cannot tell."""

from dataclasses import replace

import numpy as np
import pytest

from fishmj import mjcf
from fishmj.hydro_fit import free_swims
from fishmj.hydro_fit.fit.identifiability import identify
from fishmj.hydro_fit.fit.linear_regression import bounded
from fishmj.water import residual_hooks, residual_network
from fishmj.water.dynamics import planar_chain
from fishmj.water.hydro_model import HydroModel, robot_hash
from fishmj.water.prior import Prior, flat

ROBOT = mjcf.load_robot("fish")
CHAIN, NOMINAL = planar_chain.chain_of(ROBOT), planar_chain.nominal(ROBOT)
N = CHAIN.n

BAND = dict.fromkeys(("speed", "yaw_rate", "power"), [0.01, 0.02, 1.0])


def learnt():
    """A residual that pushes, fitted for slow swimming ahead."""
    rng = np.random.default_rng(1)
    net = residual_network.blank(N)
    net = net._replace(outer=rng.normal(0, 0.3, net.outer.shape), outer_bias=rng.normal(0, 0.3, net.outer_bias.shape))
    k = swimming(rng, 4000)
    p = residual_network.panels(CHAIN)
    xi, speed = residual_hooks.near(np, p, k, residual_network.motion(np, p, k))
    return residual_hooks.Residual(net, residual_hooks.fitted(np.array(xi).transpose(2, 0, 1), np.array(speed).T, 2.0))


def swimming(rng, count, speed=0.2, side=0.05):
    """Links that move ahead at `speed` with some motion across."""
    u = speed * (1 + 0.1 * rng.normal(size=(N, count)))
    return planar_chain.Links([], [], list(rng.normal(0, 0.5, (N, count))), list(u), list(side * rng.normal(size=(N, count))), [])


def pushed(model, k, count):
    """(sum of |force|, steps counted as outside) for motions k."""
    hooks = residual_hooks.LearnedResidual(np, CHAIN, model, [np.zeros(count)] * len(residual_hooks.at_rest()))
    forces = hooks.advance(CHAIN.strips, NOMINAL.water, k, CHAIN.dt)
    return sum(np.abs(f[c]) for f in forces for c in range(3)), hooks.guarded


def test_fault_18_outside_its_range_the_base_swims_alone_and_it_is_counted():
    rng, model = np.random.default_rng(2), learnt()
    force, outside = pushed(model, swimming(rng, 500), 500)
    assert (force > 0).mean() > 0.95 and outside.mean() < 0.02
    for k in (swimming(rng, 500, speed=2.0), swimming(rng, 500, speed=-0.2), swimming(rng, 500, speed=0.02, side=0.6)):
        force, outside = pushed(model, k, 500)
        assert (force == 0).mean() > 0.9 and outside.mean() > 0.9
    far = planar_chain.Links([], [], *([np.full(3, s) for _ in range(N)] for s in (0.1, 3.0, 0.3)), [])
    assert (pushed(model, far, 3)[0] == 0).all()


def test_fault_18_in_the_physics_it_is_the_base_to_the_bit():
    q, v = [np.zeros(2) for _ in range(6)], [np.full(2, 3.0), np.full(2, 0.3), *(np.zeros(2) for _ in range(4))]
    still, given = [(0.0, 0.0)] * N, (np.full(2, 0.5), [0.1] * (N - 1))
    hooks = residual_hooks.LearnedResidual(np, CHAIN, learnt(), [np.zeros(2)] * len(residual_hooks.at_rest()))
    with_it = planar_chain.step(np, CHAIN, NOMINAL, q, v, *given, still, (0.0, 0.0), hooks)
    base = planar_chain.step(np, CHAIN, NOMINAL, q, v, *given, still, (0.0, 0.0))
    np.testing.assert_array_equal(np.array(with_it.v), np.array(base.v))
    assert (with_it.memory[-1] == 1).all()


@pytest.mark.parametrize("share,passes", [(0.04, True), (0.06, False)])
def test_fault_18_more_than_5_percent_outside_fails_the_check(monkeypatch, share, passes):
    """The judgement itself, on swims whose only fault is the share of steps outside."""
    import hidden_water as hidden

    records = [hidden_record(hidden, kind) for kind in ("gait", "chirp")]
    members = np.tile(flat(NOMINAL.water), (5, 1))
    model = HydroModel(
        name="swift", robot=ROBOT.name, robot_sha256=robot_hash(ROBOT), dt=CHAIN.dt, slip=1.0, base=NOMINAL.water,
        members=members, alone=np.tile(members[:1], (6, 1)), band=BAND,
    )  # fmt: skip

    def perfect(self, fleet, water, learnt=None, attached=None, memory=None):
        return free_swims.recorded(fleet)._replace(outside=np.full(len(fleet.q), share))

    monkeypatch.setattr(free_swims.SwimWindow, "run", perfect)
    found = free_swims.judge(model, ROBOT, records)
    assert found["figures"]["guard_rate"] == share and found["tolerances"]["guard_rate"] == 0.05
    assert found["passed"]["guard_rate"] is passes
    assert found["figures"]["speed_error_mean"] == 0.0


def hidden_record(hidden, kind):
    """A made-up record of 8 s: straight ahead at 0.2 m/s, or held."""
    t = np.arange(1, 401)[:, None] * hidden.TICK
    free = kind == "gait"
    q, v = np.zeros((400, 6)), np.zeros((400, 6))
    if free:
        q[:, :1], v[:, 0] = 0.2 * t, 0.2
    meta = {
        "id": kind,
        "episode": kind,
        "block": kind,
        "tick": hidden.TICK,
        "grid": {"slip": 1.0},
        "segment": {"drive": {"bias": 0.0}},
    }
    meta |= {"start": {"q": [0.0] * 6, "v": v[0].tolist()}, "prescribed": {"joints": not free, "root": not free}}
    zero = np.zeros((400, N, 3))
    return hidden.record.SegmentRecord(meta, q, v, np.zeros((400, 3)), zero, zero, np.zeros((400, N, 2)), np.full(400, 1.6))


def prior(names):
    size = len(names)
    return Prior(tuple(names), np.ones(size), np.full(size, 0.5), np.zeros(size), np.full(size, 3.0))


def test_fault_19_what_trades_is_not_identified_and_its_partner_is_named():
    """Two columns that are nearly the same: their sum is known, neither is."""
    rng = np.random.default_rng(3)
    a, c = rng.normal(size=(2, 500))
    columns = np.stack([a, a + 1e-3 * rng.normal(size=500), c], 1)
    p = prior(("lift_a", "lift_b", "cn1"))
    normal, right = columns.T @ columns, columns.T @ (columns @ [1.6, 0.4, 1.2])
    value = bounded(p, normal, right)
    found = identify(p, value, normal)
    a, b, c = found.parameters
    assert c.status == "identified" and found.condition > 1e4
    assert (a.name, a.partner, b.name, b.partner) == ("lift_a", "lift_b", "lift_b", "lift_a")
    assert a.status == b.status == "not identified" and a.correlation < -0.99
    assert value[0] + value[1] == pytest.approx(2.0, abs=0.01)


def test_fault_19_parameter_on_its_bound_is_flagged_and_not_calibrated(tmp_path):
    rng = np.random.default_rng(4)
    columns = rng.normal(size=(500, 2))
    p = prior(("cf", "cn1"))
    normal, right = columns.T @ columns, columns.T @ (columns @ [-0.7, 1.2])
    value = bounded(p, normal, right)
    found = identify(p, value, normal)
    assert value[0] == 0.0 and [p.status for p in found.parameters] == ["on bound", "identified"]
    members = np.tile(flat(NOMINAL.water), (5, 1))
    model = HydroModel(
        name="swift", robot=ROBOT.name, robot_sha256=robot_hash(ROBOT), dt=CHAIN.dt, slip=1.0, base=NOMINAL.water,
        members=members, alone=np.tile(members[:1], (6, 1)), found={"linear": found.table()},
    )  # fmt: skip
    back = HydroModel.load(replace(model, notes="made").save(tmp_path))
    assert set(back.calibrated) == {"cn1"} and "on bound" in (tmp_path / "swift.toml").read_text(encoding="utf-8")


def test_a_range_grows_with_what_is_seen_beyond_it_and_keeps_what_it_had():
    rng, p = np.random.default_rng(6), residual_network.panels(CHAIN)
    told = lambda k: residual_hooks.near(np, p, k, residual_network.motion(np, p, k))
    before = learnt().reach
    for k, wider in ((swimming(rng, 800, speed=0.15), False), (swimming(rng, 800, speed=0.5), True)):
        xi, speed = told(k)
        after = residual_hooks.widened(before, np.array(xi).transpose(2, 0, 1), np.array(speed).T)
        assert (after.limit >= before.limit).all() and (after.speed >= before.speed).all()
        assert (after.speed > 1.5 * before.speed).all() == wider
        np.testing.assert_array_equal(after.centre, before.centre)
