"""A water that is corrected while MuJoCo swims in it. The better water is made up here: the same closed form, changed."""

import json
import time

import numpy as np
import pytest

from fishmj import control, engines, suite
from fishmj.base.errors import ConfigError, MissingExtra
from fishmj.engines.hybrid import HybridOptions, online_correction
from fishmj.engines.hybrid import tanks as tanks_of_the_solver
from fishmj.engines.hybrid.engine import HybridEngine
from fishmj.engines.hybrid.hybrid_segment import FreeSwim, Replay
from fishmj.evaluate import __main__ as evaluate
from fishmj.evaluate import protocol, run_trials
from fishmj.lbm_oracle.run.solver_water import PLAIN
from fishmj.log import read_dataset, read_trial, write_trial
from fishmj.mjcf import load_robot
from fishmj.sim import Sim
from fishmj.view.play.live_session import LiveSession
from fishmj.water import choice
from fishmj.water.dynamics import planar_chain
from fishmj.water.flow import Flow, stack

STRIPS = choice.in_water(load_robot("fish"), "structured")
STRIPS_WATER = planar_chain.nominal(STRIPS).water
GUSTY = Flow(speed=0.2, turbulence="default", intensity=0.05, seed=5)
RIGHT = online_correction.fresh()
FACTORS = np.array([1, 1, 3, 1, 1, 1, 0.5, 1, 1, 1.0])  # three times the friction, half the tail's cross-flow drag
STILL, MORE = np.zeros(2), np.array([0.05, 0.0])
QUICK = HybridOptions(first=0.6, every=3.0, lead=0.2, span=2.0, wait=True)


@pytest.fixture(scope="module")
def replay():
    return Replay(STRIPS)


class Better:
    """An oracle: the simulation's own water with other factors and another stream."""

    def __init__(self, replay, factors=RIGHT.factors, stream=STILL):
        self.replay, self.water, self.asked = replay, (factors[:, None], stream[:, None]), []

    def swim(self, segments):
        self.asked += [(s.fish, len(s.q), len(s.commands)) for s in segments]
        return [FreeSwim(*(a[0] for a in self.replay.swim(s, *self.water))) for s in segments]


def wave(k: int) -> np.ndarray:
    """(J,) rad: a beat of 1 Hz that comes up within a second."""
    return 0.4 * min(1.0, k * 0.02) * np.sin(2 * np.pi * 0.02 * k - 1.0 * np.arange(3))


def swum(engine, seconds=3.0, flows=(GUSTY,), commands=wave):
    """(B, T, 3) poses of fish that beat through a current, facing it."""
    state = engines.at_rest(STRIPS, np.tile([0.0, 0.0, np.pi], (len(flows), 1)))
    given = engines.nominal_params(STRIPS, len(flows)), stack(list(flows))
    rows = np.array([commands(k) for k in range(round(seconds / 0.02))])
    every = np.repeat(rows[None], len(flows), 0)
    _, trace = engine.advance(state, every, *given, np.zeros(len(flows), int))
    return np.asarray(trace.pose)


def corrected(replay, oracle, options=QUICK, **more):
    engine = HybridEngine(STRIPS, GUSTY, options, oracle=oracle, replay=replay)
    return engine.hybrid, swum(engine, **more)


@pytest.fixture(scope="module")
def plain():
    return swum(engines.make("batch", STRIPS))


def test_a_segment_is_what_mujoco_swam(replay):
    """Its replay from the state where the lead ends is MuJoCo's own swim, in a gusty current, under the very commands."""

    class Look(Better):
        def swim(self, segments):
            self.seen = segments
            return super().swim(segments)

    oracle = Look(replay)
    hybrid, poses = corrected(replay, oracle, flows=(GUSTY, GUSTY))
    one = oracle.seen[1]
    assert (one.fish, one.tick, one.span) == (1, 30, 40) and oracle.asked == [(0, 11, 100), (1, 11, 100)]
    np.testing.assert_allclose(one.q[1:, :3], poses[1, 30:40], atol=1e-12)
    again = replay.swim(one, RIGHT.factors[:, None], STILL[:, None])
    np.testing.assert_allclose(again.q[0, :, :3], poses[1, 40:140], atol=1e-6)


def test_a_right_water_is_left_alone_to_the_bit(replay, plain):
    hybrid, poses = corrected(replay, Better(replay))
    np.testing.assert_array_equal(poses, plain)
    np.testing.assert_array_equal(hybrid.states[0].unknowns, 0.0)
    row = hybrid.report()["segments"][0]
    assert row["before"] < 1e-3 and not row["moved"] and row["t"] == 0.6 and row["applied"] == pytest.approx(2.8)


def test_a_wrong_water_is_mended(replay):
    """Friction and the tail's drag: the swim after the segment is twice as near to that in the true water, and has no jump."""
    hybrid, poses = corrected(replay, Better(replay, FACTORS), seconds=6.0)
    true = engines.make("batch", STRIPS)
    water = online_correction.applied_to_rows(engines.nominal_params(STRIPS, 1).water, FACTORS[:, None])
    wrong = swum(true, 6.0)
    state, given = engines.at_rest(STRIPS, [[0.0, 0.0, np.pi]]), engines.nominal_params(STRIPS, 1)._replace(water=water)
    rows = np.array([[wave(k) for k in range(300)]])
    right = true.advance(state, rows, given, stack([GUSTY]), np.zeros(1, int))[1].pose
    speed = lambda p: np.linalg.norm(p[0, -1, :2] - p[0, 249, :2])  # of the last second
    assert abs(speed(poses) - speed(right)) < 0.5 * abs(speed(wrong) - speed(right)), (speed(poses), speed(right), speed(wrong))
    assert np.linalg.norm(np.diff(poses[0, :, :2], axis=0), axis=-1).max() < 0.02 * 1.0  # 1 m/s
    row = hybrid.report()["segments"][0]
    assert row["moved"] and row["after"] < 0.5 * row["before"] and min(row["factors_sd"]) > 0


def test_a_stream_is_told_from_a_wrong_hull(replay):
    """The water is 0.05 m/s faster than told: the stream is corrected, no factor moves, and MuJoCo's water gets it."""
    hybrid, _ = corrected(replay, Better(replay, stream=MORE), seconds=6.0)
    state = hybrid.states[0]
    np.testing.assert_allclose(state.stream, MORE, atol=0.01)
    np.testing.assert_array_equal(state.factors, 1.0)
    assert state.sd[10] < 0.5 * online_correction.STREAM
    told, given = stack([GUSTY]), engines.nominal_params(STRIPS, 1)
    fish = engines.at_rest(STRIPS, np.zeros((1, 3)))
    params, current = hybrid.tick(fish, given, told, hybrid._last + 1)
    np.testing.assert_allclose(current.mean - told.mean, [state.stream])
    np.testing.assert_array_equal(params.water, given.water)


def test_each_fish_has_its_own_correction(replay):
    class Two(Better):
        def swim(self, segments):
            return [(Better(replay, stream=MORE) if s.fish else Better(replay)).swim([s])[0] for s in segments]

    hybrid, _ = corrected(replay, Two(replay), flows=(GUSTY, GUSTY))
    assert not hybrid.states[0].unknowns.any() and hybrid.states[1].stream[0] > 0.04


@pytest.mark.parametrize("why", ["missing", "fails", "lost"])
def test_a_solver_that_is_missing_or_fails_leaves_the_swim_as_it_is(replay, plain, capsys, why):
    class Bad:
        def swim(self, segments):
            if why == "missing":
                raise MissingExtra("warp-lang", "oracle", "the flow solver")
            if why == "fails":
                raise RuntimeError("device is gone")
            return ["left_domain at t = 1 s" for _ in segments]

    hybrid, poses = corrected(replay, Bad(), seconds=3.0)
    np.testing.assert_array_equal(poses, plain)
    told = capsys.readouterr().err
    assert told.count("hybrid:") == 1 and {"missing": "warp-lang", "fails": "device is gone", "lost": "left_domain"}[why] in told
    assert bool(hybrid.off) is (why != "lost") and len(hybrid.rows[0]) == (why == "lost")


def test_what_was_learnt_stays_when_the_solver_fails_later(replay, capsys):
    class Once(Better):
        def swim(self, segments):
            if self.asked:
                raise RuntimeError("device is gone")
            return super().swim(segments)

    hybrid, _ = corrected(replay, Once(replay, stream=MORE), seconds=6.0)
    assert hybrid.off == "device is gone" and hybrid.states[0].stream[0] > 0.04
    assert capsys.readouterr().err.count("hybrid:") == 1


def test_mujoco_does_not_wait(replay, plain, capsys):
    """The answer takes longer than MuJoCo needs for the rest: the segment that is due meanwhile is left out, said once."""

    class Slow(Better):
        def swim(self, segments):
            while not go:
                time.sleep(0.005)
            return super().swim(segments)

    go: list = []
    options = HybridOptions(first=0.2, every=2.4, lead=0.2, span=2.0, own=0.5)
    engine = HybridEngine(STRIPS, GUSTY, options, oracle=Slow(replay, stream=MORE), replay=replay)
    np.testing.assert_array_equal(swum(engine), plain)
    hybrid = engine.hybrid
    go.append(1)
    hybrid.close()
    assert len(hybrid.rows[0]) == 1 and hybrid.rows[0][0]["applied"] == pytest.approx(2.98)
    assert capsys.readouterr().err.count("still works") == 1 and hybrid.states[0].stream[0] > 0.02


def test_an_answer_that_comes_too_late_is_dropped(replay, capsys):
    options = HybridOptions(first=0.2, every=5.0, lead=0.2, span=2.0, patience=0.0)
    engine = HybridEngine(STRIPS, GUSTY, options, oracle=Better(replay, stream=MORE), replay=replay)
    swum(engine)
    engine.hybrid.close()
    assert not engine.hybrid.rows[0] and not engine.hybrid.states[0].unknowns.any()
    assert "dropped" in capsys.readouterr().err


@pytest.mark.parametrize("times", [{"every": 1.0}, {"lead": 0.0}, {"first": -1.0}])
def test_times_that_cannot_be_are_refused(times):
    with pytest.raises(ConfigError, match="expected first"):
        HybridOptions(**times)


def test_the_tank_has_mujocos_eddies_on_its_own_mean():
    """At the begin of the segment the two flows differ by the means alone, wherever one looks; later the eddies ride on."""
    tanks = tanks_of_the_solver.Tanks(STRIPS, PLAIN._replace(domain="laptop"), device="cpu", stream=Flow(speed=0.25))
    segment = _segment_at(tick=400)
    flow, points, t = tanks.flow(segment), np.random.default_rng(1).normal(size=(40, 3)), 8.0
    np.testing.assert_allclose(flow.at(points, t) - GUSTY.at(points, t), np.tile([0.05, 0, 0], (40, 1)), atol=1e-9)
    assert flow.rms == GUSTY.rms and flow.speed == pytest.approx(0.25)
    assert np.ptp(flow.at(points, t + 1) - GUSTY.at(points, t + 1), axis=0)[0] > 1e-3


def _segment_at(tick: int):
    from fishmj.engines.hybrid.hybrid_segment import HybridSegment

    still = np.zeros((6, 6))
    start, params = engines.at_rest(STRIPS, np.zeros((1, 3))), engines.nominal_params(STRIPS, 1)
    return HybridSegment(0, tick, still, still, start, np.zeros((5, 3)), params, GUSTY.current(), GUSTY)


# ---- where users meet it ----


@pytest.fixture
def made_up(monkeypatch):
    """The flow solver is replaced by the simulation's own water in a stream that is 0.05 m/s faster."""
    options: list = []

    class Made(Better):
        def __init__(self, robot, water, **given):
            options.append({"water": water, **given})
            super().__init__(Replay(robot), stream=MORE)

    monkeypatch.setattr(tanks_of_the_solver, "Tanks", Made)
    return options


@pytest.mark.slow
def test_sim_swims_corrected_and_logs_it(made_up, tmp_path):
    """The fitted water with its residual, in a gusty current; twice the same, to the bit."""
    options = HybridOptions(first=1.0, every=4.0, lead=0.2, span=2.0, own=0.5, wait=True, slip=0.98)
    sims = [Sim("fish", water="hybrid", hybrid=options, flow=GUSTY, pose=(0, 0, np.pi)) for _ in range(2)]
    trials = [sim.run(lambda t: wave(round(t / 0.02)), 4.0) for sim in sims]
    np.testing.assert_array_equal(*(trial.tables["truth"]["x"] for trial in trials))
    told = read_trial(write_trial(tmp_path / "trial", trials[0])).meta
    assert told["water"] == "hybrid" and told["hybrid"]["segments"][0]["moved"] and made_up[0]["water"].slip == 0.98
    np.testing.assert_allclose(told["hybrid"]["stream"], MORE, atol=0.015)
    alone = Sim("fish", flow=GUSTY, pose=(0, 0, np.pi)).run(lambda t: wave(round(t / 0.02)), 4.0)
    x, y = (t.tables["truth"]["x"] for t in (trials[0], alone))
    np.testing.assert_array_equal(x[:159], y[:159])
    assert x[-1] - y[-1] > 0.005


@pytest.mark.slow
def test_a_suite_swims_corrected(made_up):
    options = HybridOptions(first=0.6, every=4.0, lead=0.2, span=2.0, own=0.2, wait=True)
    setting = {"water": "hybrid", "hybrid": options, "random": 1, "flow_speed": 0.2}
    env = suite.load("fish", "station_hold", task_kwargs=setting)
    env.reset()
    for k in range(15):
        env.step(wave(10 * k) / np.radians(60))
    assert env.physics.hybrid.report()["segments"][0]["moved"]
    env.reset()
    assert not env.physics.hybrid.report()["segments"]


@pytest.mark.slow
def test_evaluate_swims_corrected_and_says_what_was(made_up, tmp_path, capsys):
    asked = "pilot --water hybrid --speeds 0.2 --los 0,90 --repeats 1 --duration 14 --every 10 --tanks 2 --log --out".split()
    assert evaluate.main([*asked, str(tmp_path)]) == 0
    told = json.loads((tmp_path / "results.json").read_text())
    rows = told["hybrid"]["pilot"]
    assert "water hybrid" in told["condition"] and [len(row["segments"]) for row in rows] == [1, 1]
    assert sum(row["segments"][0]["moved"] for row in rows) and made_up[0]["side_by_side"] == 2
    assert "stream [m/s]" in capsys.readouterr().out and "pilot: the water" in (tmp_path / "report.html").read_text()
    assert all(trial.meta["hybrid"] == row for trial, row in zip(read_dataset(tmp_path / "logs"), rows, strict=True))


@pytest.mark.slow
def test_play_swims_corrected(made_up):
    robot = choice.in_water(load_robot("fish"))
    engine = HybridEngine(robot, GUSTY, HybridOptions(first=1.0, lead=0.2, span=2.0, wait=True))
    session = LiveSession("drift", robot, GUSTY, engine)
    for _ in range(20):
        session.step()
    meta = session.trial().meta
    assert (
        meta["water"] == "hybrid" and meta["engine"].startswith("hybrid, window_coarse") and len(meta["hybrid"]["segments"]) == 1
    )


@pytest.mark.slow
@pytest.mark.oracle
def test_the_flow_solver_agrees_with_the_water_that_was_fitted_to_it():
    """One short segment of the real solver in a gusty stream, beside MuJoCo; its fish swims within reach of MuJoCo's."""
    options = HybridOptions(first=0.6, every=4.0, lead=0.2, span=0.6, domain="laptop", device="cpu", patience=1e4)
    sim = Sim("fish", water="hybrid", hybrid=options, flow=GUSTY, pose=(0, 0, np.pi))
    sim.run(lambda t: wave(round(t / 0.02)), 1.6)
    sim.hybrid.close()
    told = sim.hybrid.report()
    assert not told["off"] and len(told["segments"]) == 1 and told["domain"] == "laptop"
    assert 0 < told["segments"][0]["before"] < 3.0 and sim.hybrid._thread is not None


def test_a_free_root_is_refused():
    with pytest.raises(ConfigError, match="planar root"):
        Sim("fish", water="hybrid", root="free")


def test_a_policy_holds_station_for_more_than_a_minute_in_turbulence(replay):
    """The judge's own loop, a learned policy, a stream 0.05 m/s faster than told: it is found and kept."""
    options = HybridOptions(wait=True)
    trials = protocol.trials(speeds=(0.2,), los_deg=(120,), repeats=1, turbulence="default", duration=70)
    engine = HybridEngine(STRIPS, trials.flows()[0], options, oracle=Better(replay, stream=MORE), replay=replay)
    result = run_trials.run(control.chosen("pilot", STRIPS), STRIPS, trials, engine)
    assert result.engine.startswith("hybrid") and result.water == "hybrid" and np.isfinite(result.distance).all()
    told = engine.hybrid.report()
    assert [row["t"] for row in told["segments"]] == [10.0, 60.0] and told["solver_share"] == pytest.approx(0.1, rel=0.01)
    np.testing.assert_allclose(told["stream"], MORE, atol=0.015)


# ---- the estimator ----


def linear(slopes, at):
    """Misses (R, B) that are linear in the logarithms of the free factors and in the stream, none at `at`."""
    at, free = np.asarray(at, float), online_correction.BELIEFS[2]
    return lambda factors, stream: (slopes @ (np.concatenate([np.log(factors), stream])[free] - at[:, None])).reshape(4, 3, -1)


@pytest.mark.parametrize(("size", "moves"), [(0.99, False), (1.01, True)])
def test_what_nine_of_ten_right_ones_stay_below_refutes_nothing(size, moves):
    """Twelve misses in the pattern of one factor, just within and just beyond those of a right surrogate."""
    slopes = np.zeros((12, 9))
    slopes[:, 2] = 2.0
    found = online_correction.matched(RIGHT, linear(slopes, size / 2.0 * np.eye(9)[2]))
    assert bool(found.unknowns.any()) is moves
    assert np.array_equal(found.information, RIGHT.information) is not moves


@pytest.mark.parametrize(("gain", "moves"), [(0.9, False), (1.1, True)])
@pytest.mark.parametrize(("unknown", "width"), [(1, online_correction.WRONG[1]), (7, online_correction.STREAM)])
def test_unknowns_move_where_they_gain_more_than_by_chance(gain, moves, unknown, width):
    """Large misses, all but one of which nothing mends: that one against ln det(1 + J P J^T) of its unknown."""
    slope, column = 1.5 / width, online_correction.BELIEFS[2][unknown]
    spread = 1 + (slope * width) ** 2
    at = np.sqrt(gain * np.log(spread) * spread / (spread - 1)) / slope  # a^2 d^2 / (1 + d^2) = gain x ln(1 + d^2)
    mended = lambda factors, stream: slope * (np.concatenate([np.log(factors), stream])[[column]] - at)
    misses = lambda *x: np.concatenate([mended(*x), np.full((11, x[0].shape[1]), 2.0)]).reshape(4, 3, -1)
    found = online_correction.matched(RIGHT, misses).unknowns[online_correction.BELIEFS[2]]
    expected = np.eye(9)[unknown] * (at * (spread - 1) / spread if moves else 0.0)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


def test_correction_adds_friction_to_frictionless_water_never_below_zero():
    """`swift` was fitted to a hull along which water slides: nothing times a factor would stay nothing."""
    slides = STRIPS_WATER._replace(cf=0.0)
    rough, smooth = (np.where(np.arange(10) == 2, f, 1.0) for f in (15.0, 0.001))
    assert online_correction.applied(slides, rough).cf == pytest.approx(14 * online_correction.PLATE)
    assert online_correction.applied(slides, smooth).cf == 0.0
    assert online_correction.applied(STRIPS_WATER, RIGHT.factors) == STRIPS_WATER


def test_what_is_known_grows_by_every_segment_that_moves_and_is_forgotten():
    """Two refuting segments of a linear surrogate against recursive least squares; a third that refutes nothing forgets."""
    rng, everything = np.random.default_rng(3), online_correction.BELIEFS[2]
    free = np.ix_(everything, everything)
    state, mean, prior = RIGHT, np.zeros(9), RIGHT.information[free]
    known = prior
    for idle in (0.0, 12.0):
        slopes, at = rng.normal(size=(12, 9)) * 10, rng.normal(size=9) * 0.2
        slopes[:, 7:] *= 20  # a stream is a few hundredths
        at[7:] *= 0.2
        known = prior + np.exp(-idle / online_correction.MEMORY) * (known - prior)
        cost = known @ mean + slopes.T @ slopes @ at
        known = known + slopes.T @ slopes
        mean = np.linalg.solve(known, cost)
        state = online_correction.matched(state, linear(slopes, at), idle=idle)
        np.testing.assert_allclose(state.unknowns[everything], mean, rtol=1e-6)
        np.testing.assert_allclose(state.information[free], known, rtol=1e-6)
    last = online_correction.matched(state, linear(slopes, mean), idle=online_correction.MEMORY)
    np.testing.assert_array_equal(last.unknowns, state.unknowns)
    np.testing.assert_allclose(last.information, RIGHT.information + (state.information - RIGHT.information) / np.e, rtol=1e-12)
