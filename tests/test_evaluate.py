"""The judge: the decided trials, metrics with known answers, paired statistics, and golden runs of what drifts and what holds."""

from dataclasses import replace

import numpy as np
import pytest

from fishmj import engines, evaluate
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.control.gait_table import gait_of
from fishmj.evaluate import metrics
from fishmj.evaluate.metrics import Result
from fishmj.evaluate.trial_report import by_condition, trials_csv
from fishmj.mjcf.reading import load_robot
from fishmj.water.choice import in_water

ROBOT = in_water(load_robot("fish"), "structured")
CALM = {"turbulence": "none", "randomisation": 0.0, "noise": 0.0}


@pytest.fixture(scope="module")
def engine():
    return engines.make("compiled", ROBOT)


def hand_made(pose, *, power=2.0, **options) -> Result:
    """A result with given poses (n, T + 1, 3) about a target at the origin, in a calm stream along +x."""
    pose = np.asarray(pose, float)
    n, ticks = len(pose), pose.shape[1] - 1
    trials = evaluate.trials(
        speeds=[0.2], los_deg=[45 * i for i in range(n)], repeats=1, duration=ticks * 0.02, **CALM, **options
    )
    zeros = np.zeros((n, ticks + 1, 3))
    return Result(
        controller="hand",
        policy_sha256="",
        robot=ROBOT,
        trials=trials,
        engine="none",
        t=np.arange(ticks + 1) * 0.02,
        target=np.zeros((n, 2)),
        pose=pose,
        velocity=np.gradient(pose, 0.02, axis=1),
        joint=zeros,
        rate=zeros,
        power=np.full((n, ticks), power),
        command=zeros[:, 1:],
        obs=np.zeros((n, 1, 11)),
        action=None,
        distance=np.linalg.norm(pose[:, :, :2], axis=-1),
        left=np.full(n, ticks + 1),
    )


def still(x: float, ticks: int = 3000) -> np.ndarray:
    """One fish that stays at (x, 0), facing upstream."""
    return np.tile([x, 0.0, np.pi], (1, ticks + 1, 1))


def test_there_are_72_trials_as_decided():
    trials = evaluate.trials()
    start, target = trials.ends()
    assert len(trials) == 72 and len({t.seed for t in trials.items}) == 72
    assert np.linalg.norm(target - start[:, :2], axis=1) == pytest.approx(1.4)
    assert target + start[:, :2] == pytest.approx(0, abs=1e-12)
    ahead = trials.los == 0
    assert target[ahead] - start[ahead, :2] == pytest.approx(np.tile([-1.4, 0.0], (9, 1)), abs=1e-12)  # water moves to +x
    assert np.all(start[:, 2] == np.pi)


def test_target_at_90_degrees_lies_left_of_an_upstream_facing_fish():
    start, target = evaluate.trials(los_deg=[90], repeats=1).ends()
    heading = start[0, 2]
    left = np.array([-np.sin(heading), np.cos(heading)])
    assert (target[0] - start[0, :2]) @ left == pytest.approx(1.4)


def test_a_part_of_the_trials_is_the_very_same_trials():
    everything, some = evaluate.trials(), evaluate.trials(speeds=[0.2], los_deg=[135], repeats=2)
    index = [i for i, t in enumerate(everything.items) if t in some.items]
    assert len(index) == 2
    assert [everything.flows()[i] for i in index] == some.flows()
    for whole, part in zip(everything.fish(ROBOT)[0], some.fish(ROBOT)[0], strict=True):
        assert np.array_equal(whole[index], part)
    assert np.array_equal(everything.sensor_noise(ROBOT, 4)[index], some.sensor_noise(ROBOT, 4))


def test_judging_tuning_and_other_seeds_are_other_draws():
    seeds = [tuple(f.seed for f in evaluate.trials(seed=s, box=b).flows()) for s in (0, 1) for b in ("judge", "tune")]
    assert len({seed for group in seeds for seed in group}) == 4 * 72
    assert {f.box for f in evaluate.trials().flows()} == {2}


def test_training_flows_are_never_judged_on():
    with pytest.raises(UnknownName, match="judge"):
        evaluate.trials(box="train")


@pytest.mark.parametrize(
    "wrong", [{"speeds": []}, {"speeds": [3.0]}, {"repeats": 0}, {"repeats": 10**7}, {"duration": 0.1}, {"seed": -1}]
)
def test_impossible_trials_are_refused(wrong):
    with pytest.raises(ConfigError, match="trials:"):
        evaluate.trials(**wrong)


def test_a_still_fish_has_the_rmse_of_its_distance():
    found = metrics.figures(hand_made(still(0.5)))
    for key in ("rmse_after_arrival", "rmse_last20", "rmse_total"):
        assert found[key] == pytest.approx(0.5)
    assert found["arrival"] == 0 and np.isnan(found["approach_time"])


def test_rmse_after_arrival_starts_at_the_first_entry():
    """1 m away for 10 s, then 0.05 m away."""
    pose = still(1.0)
    pose[:, 500:, 0] = 0.05
    found = metrics.figures(hand_made(pose))
    assert found["approach_time"] == 10.0 and found["arrival"] == 1
    assert found["rmse_after_arrival"] == pytest.approx(0.05)
    assert found["rmse_total"] == pytest.approx(np.sqrt((500 * 1.0 + 1001 * 0.05**2) / 1501))


def test_a_fish_that_comes_too_late_has_not_arrived():
    """0.05 m away from 35 s on: its last 20 s are good, its arrival is not."""
    pose = still(1.0)
    pose[:, 1750:, 0] = 0.05
    found = metrics.figures(hand_made(pose))
    assert found["arrival"] == 0
    assert found["rmse_after_arrival"] == pytest.approx(1.0) and found["rmse_last20"] == pytest.approx(0.05)


def test_holding_station_is_way_through_the_water():
    """0.2 m/s for 60 s at 2 W: 12 m of way, 10 J/m; weight 1.1 kg."""
    found = metrics.figures(hand_made(still(0.5)))
    assert found["power"] == pytest.approx(2.0)
    assert found["energy_per_metre"] == pytest.approx(10.0)
    assert found["cost_of_transport"] == pytest.approx(10.0 / (1.1 * 9.81))


def test_a_fish_that_is_carried_along_has_no_energy_a_metre():
    """With the stream of 0.2 m/s it makes no way through the water, and used 1e8 J/m."""
    pose = still(0.5)
    pose[:, :, :2] += (hand_made(pose).trials.flows()[0].mean[:2] * 0.02 * np.arange(pose.shape[1])[:, None])[None]
    found = metrics.figures(hand_made(pose))
    assert np.isnan(found["energy_per_metre"]) and np.isnan(found["cost_of_transport"])
    assert found["power"] == pytest.approx(2.0)


@pytest.mark.parametrize(("off", "cosine", "linear"), [(0, 1, 1), (60, 0.5, 1 / 3), (90, 0, 0), (180, -1, -1)])
def test_the_rheotactic_index_of_a_steady_heading(off, cosine, linear):
    pose = still(0.5)
    pose[..., 2] += np.radians(off)
    found = metrics.figures(hand_made(pose))
    assert found["rheotactic_index"] == pytest.approx(cosine, abs=1e-6)
    assert found["rheotactic_index_linear"] == pytest.approx(linear, abs=1e-6)


def test_still_water_has_no_rheotactic_index_and_no_part_in_its_mean():
    turned = np.concatenate([still(0.5), still(0.5)])
    turned[0, :, 2] += np.radians(60)
    result = hand_made(turned)
    speeds = replace(
        result.trials, items=tuple(t._replace(speed=u) for t, u in zip(result.trials.items, (0.0, 0.2), strict=True))
    )
    found = metrics.summary(mixed := result._replace(trials=speeds))
    for key in ("rheotactic_index", "rheotactic_index_linear"):
        assert (found["overall"][key]["value"], found["overall"][key]["n"]) == (pytest.approx(1.0), 1)
        assert np.isnan(found["by_speed"]["0"][key]["value"]) and found["by_speed"]["0.2"][key]["n"] == 1
    assert [row["RI cos"] for row in by_condition(found, "by_speed")] == ["-", "1.000"]
    assert trials_csv([mixed]).splitlines()[1].endswith(",,")
    assert metrics.rheotaxis(mixed)[0] == pytest.approx([0.5, 1.0])  # of the paper's experiment, which has a point there


def test_the_beat_does_not_count_as_turning_away():
    pose = still(0.5)
    pose[..., 2] += 0.6 * np.sin(2 * np.pi * np.arange(3001) * 0.02)
    assert metrics.figures(hand_made(pose))["rheotactic_index"] == pytest.approx(1, abs=1e-3)


def test_a_short_run_has_no_late_figures():
    found = metrics.figures(hand_made(still(0.5, 1500)))
    assert found["rmse_total"] == pytest.approx(0.5)
    assert np.isnan(found["rmse_last20"]) and np.isnan(found["rheotactic_index"])


def test_drift_goes_with_the_flow_and_arrives_only_straight_downstream(engine):
    """The speed through the water falls as U / (1 + U t / l), l the glide length."""
    r = evaluate.run("drift", ROBOT, evaluate.trials(repeats=1, **CALM), engine)
    found = metrics.figures(r)
    assert np.array_equal(found["arrival"] == 1, np.isclose(r.trials.los, np.pi))
    speed, t = r.trials.speed, r.t[1000]
    carried = speed - speed / (1 + speed * t / gait_of(ROBOT)["glide"])
    assert r.velocity[:, 1000, 0] == pytest.approx(carried, rel=0.05)
    assert found["power"] == pytest.approx(ROBOT.servo.idle_power, abs=0.02)


def test_leaving_the_tank_freezes_the_distance(engine):
    r = evaluate.run("drift", ROBOT, evaluate.trials(speeds=[0.3], los_deg=[0], repeats=1, **CALM), engine)
    tick = r.left[0]
    assert 0 < tick < len(r.t) and abs(r.pose[0, tick, 0]) > 2 >= abs(r.pose[0, tick - 1, 0])
    assert np.all(r.distance[0, tick:] == r.distance[0, tick])
    assert metrics.figures(r)["arrival"] == 0


def test_the_same_seed_gives_the_same_bits(engine):
    trials = evaluate.trials(speeds=[0.2], repeats=1, duration=6, turbulence="gust", intensity=0.1)
    one, two = (evaluate.run("dob", ROBOT, trials, engine) for _ in range(2))
    assert np.array_equal(one.pose, two.pose) and np.array_equal(one.obs, two.obs)
    other = evaluate.run("dob", ROBOT, evaluate.trials(speeds=[0.2], repeats=1, duration=6, turbulence="gust", seed=1), engine)
    assert not np.array_equal(one.pose, other.pose)


def test_turning_the_world_changes_nothing_that_is_judged():
    """Randomised fish, noise on, water to the north-west instead of the east; in float64, so that round-off stays small."""
    base = {"speeds": [0.2], "repeats": 1, "duration": 30, "turbulence": "none"}
    east, north_west = (evaluate.run("dob", ROBOT, evaluate.trials(**base, direction=d), "batch") for d in (0.0, 2.3))
    assert np.abs(east.obs - north_west.obs).max() < 1e-6
    a, b = metrics.figures(east), metrics.figures(north_west)
    for key in a:
        assert a[key] == pytest.approx(b[key], abs=1e-6, nan_ok=True), key


def test_the_judge_and_the_fast_engine_agree(engine):
    trials = evaluate.trials(speeds=[0.2], los_deg=[0, 90], repeats=1, duration=8, **CALM)
    fast, judge = evaluate.run("dob", ROBOT, trials, engine), evaluate.run("dob", ROBOT, trials, "batch")
    assert judge.engine == "batch"
    assert np.abs(fast.pose - judge.pose).max() < 0.01


def test_a_controller_that_answers_nonsense_is_named(engine):
    class Broken:
        name = "broken"

        def reset(self, n):
            self.n = n

        def __call__(self, obs):
            return np.full((self.n, 10, 3), np.nan)

    with pytest.raises(ConfigError, match="controller broken.*not finite"):
        evaluate.run(Broken(), ROBOT, evaluate.trials(speeds=[0.2], los_deg=[0], repeats=1), engine)


def test_an_interval_holds_the_mean_and_shrinks_with_trials():
    rng = np.random.default_rng(1)
    few, many = (metrics.estimate("power", rng.normal(5, 1, n)) for n in (20, 500))
    assert few.low < few.value < few.high and many.high - many.low < 0.5 * (few.high - few.low)
    assert many.high - many.low == pytest.approx(2 * 1.96 / np.sqrt(500), rel=0.15)


def test_missing_figures_are_left_out_and_counted():
    e = metrics.estimate("approach_time", [np.nan, 4.0, 6.0, 20.0])
    assert e.n == 3 and e.value == 6.0  # a median
    assert metrics.estimate("power", [np.nan]).n == 0


def test_pairing_sees_a_shift_that_the_spread_would_hide():
    rng = np.random.default_rng(2)
    a = rng.normal(0, 1, 72)
    d = metrics.difference("power", a, a + 0.1)
    assert (d.value, d.low, d.high) == pytest.approx((0.1, 0.1, 0.1)) and d.welch_p > 0.3


def test_welch_follows_its_formula():
    a, b = np.array([1.0, 2.0, 4.0, 4.5, 3.0]), np.array([3.0, 5.0, 5.0, 9.0, 2.0])
    d = metrics.difference("power", a, b)
    t = (b.mean() - a.mean()) / np.sqrt(a.var(ddof=1) / 5 + b.var(ddof=1) / 5)
    assert d.welch_t == pytest.approx(t)


@pytest.mark.parametrize("n", [0, 1, 2, 4])
def test_too_few_trials_have_neither_interval_nor_test(n):
    a = np.arange(n) + 1.0
    e, d = metrics.estimate("power", [*a, np.nan]), metrics.difference("power", a, a * 2)
    assert e.n == d.n == n and e.why == d.why == f"too few trials for an interval: {n} of 5"
    assert np.isnan([e.low, e.high, d.low, d.high, d.welch_t, d.welch_p]).all() and not d.apart
    assert n == 0 or (e.value, d.value) == pytest.approx((a.mean(), a.mean()))


def test_five_pairs_have_an_interval_and_six_can_be_told_apart():
    five, six = (metrics.difference("power", np.zeros(n), np.ones(n) + 0.1 * np.arange(n)) for n in (5, 6))
    assert five.low > 0 and not five.why and not five.apart and six.apart


def test_results_of_other_trials_cannot_be_compared():
    with pytest.raises(ConfigError, match="different trials"):
        metrics.compare(hand_made(still(0.5)), hand_made(still(0.5), seed=1))


@pytest.mark.parametrize(
    "wrong",
    [
        {"duration": -5.0}, {"repeats": 0}, {"repeats": 1.5}, {"speeds": [np.nan]}, {"los_deg": [np.nan]}, {"intensity": -0.1},
        {"noise": np.nan}, {"randomisation": -1}, {"randomisation": 1.1}, {"direction": np.nan}, {"seed": 1.5},
    ],
    ids=str,
)  # fmt: skip
def test_trials_refuse_numbers_out_of_range(wrong):
    (name,) = wrong
    with pytest.raises(ConfigError, match=f"trials: {name} = .*; expected a"):
        evaluate.trials(**wrong)
    if hasattr(some := evaluate.trials(repeats=1), name) and name != "speeds":
        with pytest.raises(ConfigError, match=f"trials: {name} = "):
            replace(some, **wrong)
