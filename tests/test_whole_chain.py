"""The study of the whole chain compares like with like: the direct simulation senses as badly as the chain's own tracker."""

import numpy as np
import pytest

from fishmj.base.errors import ConfigError
from fishmj.deploy.camera.localiser import InStep
from fishmj.deploy.loopback.lockstep import FixNoise, LockstepClock, PoseTracker
from fishmj.deploy.loopback.loopback_settings import LoopbackSettings, make_robot
from fishmj.evaluate import protocol
from fishmj.mjcf.reading import load_robot
from fishmj.tasks import station_hold
from fishmj.tasks.sensing import estimate
from studies.tracker.error_statistics import LAGS, autocovariance
from studies.whole_chain import __main__ as study
from studies.whole_chain.chain import Compared, Remembering, figures
from studies.whole_chain.direct import AsSensed, in_second_robot, observation_noise
from studies.whole_loop import steps

ROBOT = load_robot("fish")


def white(position, yaw):
    lags = np.zeros((3, LAGS + 1))
    lags[:, 0] = position**2, position**2, yaw**2
    return lags


def test_white_errors_of_poses_become_those_of_the_line_fit():
    random, window = np.random.default_rng(0), ROBOT.timing.velocity_window
    errors = random.normal(0, [0.003, 0.003, 0.02], (20_000, window, 3))
    pose, velocity = estimate(np, errors, ROBOT.timing.bus_dt)
    sigma = observation_noise(white(0.003, 0.02), ROBOT)
    np.testing.assert_allclose(sigma[[0, 2, 4]], [pose[:, 0].std(), velocity[:, 0].std(), velocity[:, 2].std()], rtol=0.02)


def test_an_error_that_stays_makes_no_velocity():
    lags = np.full((3, LAGS + 1), 0.004**2)
    sigma = observation_noise(lags, ROBOT)
    assert sigma[0] == pytest.approx(0.004) and sigma[2] == pytest.approx(0.0, abs=1e-9) == sigma[4]


def test_the_direct_simulation_gets_the_noise_that_was_measured():
    trials = protocol.trials(speeds=(0.2,), repeats=1, seed=1, duration=30.0)
    sigma = observation_noise(white(0.001, 0.004), ROBOT)
    draws = AsSensed.of(trials, sigma).sensor_noise(ROBOT, 400) * station_hold.noise_scale(ROBOT)
    np.testing.assert_allclose(draws.std((0, 1)), sigma, rtol=0.06)
    plain = trials.sensor_noise(ROBOT, 400)
    np.testing.assert_allclose(np.sign(draws), np.sign(plain))  # the same draws: the comparison stays paired


def test_fixes_are_compared_with_the_pose_that_their_frame_shows():
    clock = LockstepClock(
        make_robot(LoopbackSettings(seed=4, flow=protocol.trials(speeds=(0.3,), seed=1, turbulence="gust").flows()[0]))
    )
    camera = Remembering(clock)
    compared = Compared(PoseTracker(FixNoise(0.004, 0.03, missed=0.1), seed=5), camera)
    eyes = InStep(camera, compared)
    eyes.open()
    for k in range(1, 800):
        clock.sleep_until(100.0 + 0.02 * k)
        eyes.fixes(clock.now())
    errors = np.array(compared.errors)
    assert np.ptp([shown[0] for shown in camera.shown.values()]) > 1.0, "the fish drifts away: a wrong frame would show"
    np.testing.assert_allclose(np.nanstd(errors, 0), (0.004, 0.004, 0.03), rtol=0.1)
    assert np.isnan(errors[:, 0]).mean() == pytest.approx(0.1, abs=0.03)
    lags = autocovariance(errors[:, 0])
    assert lags[0] == pytest.approx(0.004**2, rel=0.1) and np.abs(lags[1:]).max() < 0.15 * lags[0]


def test_the_second_robot_holds_station_without_its_chain():
    trials = protocol.trials(
        speeds=(0.2,), los_deg=(180,), repeats=1, seed=1, randomisation=0.0, duration=30.0, turbulence="gust"
    )
    found = in_second_robot(0, AsSensed.of(trials, observation_noise(white(1e-4, 2e-3), ROBOT)), "station")
    assert found["arrival"] < 20.0 and found["rmse"] < 0.1


def test_a_trial_that_does_not_arrive_counts_from_ten_seconds_on():
    t = 3.0 + np.arange(0, 30.02, 0.02)
    path = np.stack([t, np.where(t < 13.0 - 1e-9, 5.0, 0.4), 0 * t], 1)
    assert figures(path, 3.0, np.zeros(2)) == {"rmse": pytest.approx(0.4), "arrival": None}
    path[-51:, 1] = 0.05
    assert figures(path, 3.0, np.zeros(2)) == {"rmse": pytest.approx(0.05), "arrival": pytest.approx(29.0)}


def test_whole_chain_with_train_runs_experiment_calibrate_train_and_swim(monkeypatch, tmp_path):
    done, swum = [], []
    monkeypatch.setattr(steps.rig_experiment, "main", lambda argv, wire: done.append(["experiment", *argv]) or 0)
    monkeypatch.setattr(steps, "called", lambda loop, seed, *words, **_: done.append([str(word) for word in words]) or 0)
    row = {"rmse": 0.05, "arrival": 3.0, "complete": True, "ended": "", "share_of_fixes": 1.0, "covariance": white(1e-3, 1e-2)}
    monkeypatch.setattr(study, "_each", lambda work, count, *_: swum.append(work.args[2]) or [row] * count)
    monkeypatch.setattr(study, "_direct", lambda policy, body, trials, count, jobs: (np.full(count, 0.045), count))
    words = [
        "--body",
        "virtual",
        "--train",
        "--trials",
        "6",
        "--steps",
        "5e5",
        "--engine",
        "planar",
        "--out",
        str(tmp_path / "own"),
    ]
    assert study.main(words) == 0
    assert [words[0] for words in done] == ["experiment", "calibrate", "train"]
    train = dict(zip(done[2], done[2][1:], strict=False))
    assert train["--begin"] == "station" and train["--robot"] == str(tmp_path / "own/seed_00/fish.toml")
    assert train["--engine"] == "planar" and train["--preset"] == "paper" and train["--steps"] == "500000"
    assert swum == [train["--out"]]
    with pytest.raises(ConfigError, match="take --body virtual"):
        study.main(["--train", "--out", str(tmp_path / "other")])
