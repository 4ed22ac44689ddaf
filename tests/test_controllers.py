"""The classical controllers: smooth commands, a beat-free heading, a measured gait, an observer that finds the flow."""

import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from fishmj import control, engines, evaluate
from fishmj.base.errors import ConfigError, OwnCodeError, StoreError, UnknownName
from fishmj.control import gains_of, gait_table
from fishmj.control.adrc import ExtendedStateObserver, navigation
from fishmj.control.cpg import Cpg, Rates
from fishmj.control.estimator import StateEstimator, hermite, turned
from fishmj.control.policy import FOLDER, Policy
from fishmj.mjcf.reading import load_robot
from fishmj.tasks.episode import ControlLoop, Scenario
from fishmj.water.choice import in_water
from fishmj.water.flow import Flow, stack

ROBOT = load_robot("fish")
LAG = np.radians([0.0, 60.0, 120.0])
STEADY = Rates(frequency=4.0, amplitude=1.5, bias=4.0)


@pytest.fixture(scope="module")
def engine():
    return engines.make("compiled", ROBOT)


def noisy_observations(steps: int, n: int) -> np.ndarray:
    """Any 11 numbers of the right size: controllers must stay sane on them."""
    return np.random.default_rng(3).normal(0, 0.4, (steps, n, 11))


def answer(brain, obs):
    """The controller's commands; one that wants the flow is told a flow along its target."""
    if hasattr(brain, "set_flow"):
        brain.set_flow(0.3 * obs[:, :2])
    return brain(obs)


@pytest.mark.parametrize("name", control.NAMES)
def test_a_controller_answers_every_observation_with_finite_angles(name):
    brain = control.make(name, ROBOT)
    brain.reset(5)
    for obs in noisy_observations(40, 5):
        command = answer(brain, obs)
        assert command.shape == (5, 10, 3)
        assert np.isfinite(command).all() and np.abs(command).max() < np.pi


@pytest.mark.parametrize("name", control.NAMES)
def test_reset_forgets_everything(name):
    brain, observations = control.make(name, ROBOT), noisy_observations(20, 4)
    runs = []
    for _ in range(2):
        brain.reset(4)
        runs.append([answer(brain, obs) for obs in observations])
    assert np.array_equal(*runs)


@pytest.mark.parametrize("name", control.NAMES)
def test_fish_do_not_see_each_other(name):
    brain, observations = control.make(name, ROBOT), noisy_observations(20, 4)
    brain.reset(4)
    together = np.array([answer(brain, obs) for obs in observations])
    brain.reset(1)
    alone = np.array([answer(brain, obs[2:3]) for obs in observations])
    assert np.allclose(together[:, 2:3], alone, atol=1e-12)


def test_the_generator_is_continuous_even_when_its_goals_jump():
    cpg = Cpg(ROBOT, LAG, STEADY)
    cpg.reset(1)
    rng, rows = np.random.default_rng(0), []
    for _ in range(50):
        f, a, b = rng.uniform(0, [2.0, 0.5, 1.0])
        rows.append(cpg(np.full(1, f), np.full(1, a), np.full(1, b))[0])
    step = np.abs(np.diff(np.concatenate(rows), axis=0)).max()
    fastest = 0.5 * 2 * np.pi * 2.0 + STEADY.amplitude + STEADY.bias / 3  # rad/s
    assert step <= fastest * ROBOT.timing.bus_dt


def test_the_generator_beats_at_the_wanted_frequency_with_the_wanted_lag():
    cpg = Cpg(ROBOT, LAG, replace(STEADY, frequency=100.0, amplitude=100.0))
    cpg.reset(1)
    wave = np.concatenate([cpg(np.full(1, 1.0), np.full(1, 0.4), np.zeros(1))[0] for _ in range(25)])[100:]  # 3 s
    spectrum = np.fft.rfft(wave, axis=0)
    assert np.all(np.abs(spectrum).argmax(0) == 3)
    lag = np.angle(spectrum[3, :1] / spectrum[3])
    assert lag == pytest.approx(LAG, abs=1e-6)


def test_beat_above_half_the_control_rate_is_noted_on_hold(capsys):
    held = replace(ROBOT, name="held", timing=replace(ROBOT.timing, command_path="hold"))
    rates = replace(STEADY, frequency=100.0)
    for robot, beat, notes in ((replace(held, timing=ROBOT.timing), 4.0, 0), (held, 2.5, 0), (held, 4.0, 1), (held, 4.0, 0)):
        cpg = Cpg(robot, LAG, rates)
        cpg.reset(1)
        cpg(np.array([beat]), np.array([0.3]), np.zeros(1))
        said = capsys.readouterr().err
        assert said.count("a beat of 4 Hz on command_path 'hold' aliases to 1 Hz") == notes == said.count("\n")


def test_under_hold_a_chunk_is_one_sample():
    held = replace(ROBOT, timing=replace(ROBOT.timing, command_path="hold"))
    smooth, stepped = (Cpg(robot, LAG, STEADY) for robot in (ROBOT, held))
    goals = (np.full(2, 1.0), np.full(2, 0.5), np.full(2, 0.2))
    for cpg in (smooth, stepped):
        cpg.reset(2)
    for _ in range(5):
        a, b = smooth(*goals), stepped(*goals)
        assert np.ptp(b, axis=1).max() == 0 and np.array_equal(b[:, 0], a[:, 4])


def test_cubic_interpolation_is_exact_for_a_cubic():
    p = np.poly1d([0.7, -1.1, 0.4, 2.0])
    value, rate = hermite(p(0), p.deriv()(0), p(0.2), p.deriv()(0.2), 0.2, 0.425)
    assert (value, rate) == pytest.approx((p(0.085), p.deriv()(0.085)))


def test_the_beat_does_not_show_in_the_heading():
    """A fish swimming straight yaws its head by tens of degrees; the navigator's heading hardly moves."""
    navigator, n = StateEstimator(ROBOT, gait_table.gait_of(ROBOT)["wobble"], gait_table.gait_of(ROBOT)["sway"]), 3
    pose, joint, _ = gait_table.swim(
        ROBOT, LAG, np.full(n, 1.0), np.radians([15.0, 20.0, 25.0]), np.zeros(n), seconds=12.0, engine="compiled"
    )
    dt = ROBOT.timing.bus_dt
    yaw_rate, joint_rate = np.gradient(pose[:, :, 2], dt, axis=1), np.gradient(joint, dt, axis=1)
    late = round(navigator.rate_age / dt)
    navigator.reset(n)
    heading = []
    for k in range(20, pose.shape[1], 10):
        zero = np.zeros((n, 2))
        obs = np.concatenate([zero, zero, yaw_rate[:, [k - late]], joint[:, k], joint_rate[:, k]], 1)
        heading.append(navigator(obs).heading)
    settled = np.array(heading)[25:]
    assert np.all(settled.std(0) < 0.2 * pose[:, 250:, 2].std(1))


def test_a_positive_bias_turns_to_the_right():
    pose, _, _ = gait_table.swim(ROBOT, LAG, np.ones(2), np.full(2, 0.35), np.array([0.5, -0.5]), seconds=6.0, engine="compiled")
    assert pose[0, -1, 2] < -0.7 and pose[1, -1, 2] > 0.7
    assert gait_table.gait_of(ROBOT)["turn"] < 0


def test_the_gait_map_is_what_the_water_gives():
    """Two points of the map, swum again."""
    known = gait_table.gait_of(ROBOT)
    for i, j in ((1, 2), (5, 4)):
        f, a = known["frequency"][i], np.radians(known["amplitude_deg"][j])
        pose, _, _ = gait_table.swim(ROBOT, LAG, np.array([f]), np.array([a]), np.zeros(1), engine="compiled")
        speed = np.linalg.norm(pose[0, -1, :2] - pose[0, 500, :2]) / ((pose.shape[1] - 501) * 0.02)
        assert speed == pytest.approx(known["speed"][i][j], rel=0.02)


def test_the_throttle_gives_the_speed_that_was_asked():
    k = gains_of("dob")
    low, high = ((f, np.radians(a)) for f, a in zip(k["frequency"], k["amplitude_deg"], strict=True))
    throttle = gait_table.SpeedToGait(gait_table.gait_of(ROBOT), low, high)
    wanted = np.linspace(throttle.speeds[0], 0.98 * throttle.top, 20)
    assert throttle.speed(*throttle(wanted)) == pytest.approx(wanted, abs=0.004)


def test_the_observer_of_adrc_finds_a_constant_disturbance():
    """psi'' = f + b u with f = 0.7, u = 0.3: z must become (psi, psi', f)."""
    dt, gain = 0.2, -2.0
    observer = ExtendedStateObserver(3, 8.0, gain, dt)
    observer.start(np.zeros(1))
    a = 0.7 + gain * 0.3
    for k in range(1, 40):
        z = observer(np.array([0.5 * a * (k * dt) ** 2]), np.array([0.3]))
    assert z[0] == pytest.approx([0.5 * a * (k * dt) ** 2, a * k * dt, 0.7], rel=1e-4)


def test_the_flow_observer_finds_the_flow(engine):
    """Its axes are those of the start, which faces upstream: the flow is (-U, 0)."""
    brain = control.make("dob", ROBOT)
    calm = evaluate.trials(
        speeds=[0.2, 0.3], los_deg=[0, 90, 270], repeats=1, turbulence="none", randomisation=0, noise=0, duration=30
    )
    evaluate.run(brain, ROBOT, calm, engine)
    truth = np.stack([-calm.speed, 0 * calm.speed], -1)
    assert np.abs(brain.flow - truth).max() < 0.06


def test_the_flow_observer_holds_station_to_centimetres_in_a_calm_stream(engine):
    calm = evaluate.trials(speeds=[0.2], repeats=1, box="tune", turbulence="none", randomisation=0, noise=0)
    found = evaluate.figures(evaluate.run("dob", ROBOT, calm, engine))
    assert found["arrival"].all()
    assert found["rmse_last20"].mean() < 0.02


def a_policy(path, n_obs=11, n_act=3):
    rng = np.random.default_rng(0)
    weights = [(rng.normal(0, 0.5, (8, n_obs)), np.zeros(8)), (rng.normal(0, 0.5, (n_act, 8)), np.zeros(n_act))]
    return Policy(weights, {"activation": "relu", "scale": [1.0] * n_obs}).save(path)


def test_a_policy_file_is_a_controller_on_the_robots_command_path(tmp_path):
    path, obs = a_policy(tmp_path / "mine.safetensors"), noisy_observations(3, 4)
    smooth = control.make(path, ROBOT)
    held = control.make(path, replace(ROBOT, timing=replace(ROBOT.timing, command_path="hold")))
    for brain in (smooth, held):
        brain.reset(4)
    for o in obs:
        a, b = smooth(o), held(o)
    goal = ROBOT.servo.range * Policy.load(path)(obs[-1])
    assert smooth.name == "mine" and len(smooth.sha256) == 64
    assert a[:, -1] == pytest.approx(goal) and b == pytest.approx(np.repeat(goal[:, None], 10, 1))
    assert np.diff(a, 2, axis=1) == pytest.approx(0, abs=1e-9)  # a straight line


def test_a_policy_for_another_robot_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="has 7 observations"):
        control.make(a_policy(tmp_path / "short.safetensors", n_obs=7), ROBOT)


def test_vectors_turn_counter_clockwise():
    assert turned(np.array([[1.0, 0.0]]), np.array([np.pi / 2])) == pytest.approx(np.array([[0.0, 1.0]]))


def test_wrong_names_say_the_nearest_right_one():
    with pytest.raises(UnknownName, match="Did you mean 'dob'"):
        control.make("dop", ROBOT)
    with pytest.raises(UnknownName, match="Did you mean 'observer_time'"):
        control.make("dob", ROBOT, observer_tim=1.0)
    with pytest.raises(ConfigError, match="no gains"):
        control.make("drift", ROBOT, position=1.0)


@pytest.mark.parametrize("name", control.NAMES)
def test_every_controller_steers_a_fish_of_two_joints(name):
    robot = load_robot("tendon_fish")
    brain = control.make(name, robot)
    brain.reset(2)
    for obs in np.random.default_rng(1).normal(0, 0.4, (10, 2, 9)):
        command = answer(brain, obs)
        assert command.shape == (2, 10, 2) and np.isfinite(command).all()


def test_the_measured_gaits_are_of_the_robots_own_water():
    fitted, strips = (gait_table.gait_of(in_water(ROBOT, water)) for water in ("fitted", "structured"))
    solved = gait_table.gait_of(in_water(ROBOT, "lbm", can=("lbm",)))
    assert fitted["speed"][3][3] > 1.5 * strips["speed"][3][3], "the fitted water is twice as fast"
    assert np.array_equal(solved["speed"], fitted["speed"]), "a controller does not measure in the solver"


def test_a_fish_that_does_not_swim_has_no_gaits():
    with pytest.raises(ConfigError, match="no classical controller can steer it"):
        control.make("pi", in_water(ROBOT, "none"))


def test_proportional_navigation_turns_three_times_as_fast_as_the_sight():
    """Crossing: a target 2 m ahead drifts to the left at 0.3 m/s: the sight turns at 0.15 rad/s."""
    k = {"navigation": 3.0, "pursuit": 0.0, "navigation_max": 9.0, "hover_radius": 0.1}
    sight = np.arctan2([0.0, 0.3 * 0.2], [2.0, 2.0])
    turn = navigation(k, sight[1:], sight[:1], np.zeros(1), np.full(1, 2.0), 0.2)
    assert turn == pytest.approx(3 * 0.15, rel=1e-3)
    assert navigation({**k, "pursuit": 1.0}, sight[1:], sight[1:], np.full(1, -0.5), np.full(1, 2.0), 0.2) == pytest.approx(
        0.53, rel=1e-3
    )


def test_the_privileged_controller_is_told_the_flow_in_body_axes():
    """A stream along +x, met by fish that head to +y and to -x."""
    loop = ControlLoop(ROBOT, "compiled")
    stream = stack([Flow(speed=0.2, direction=0.0, turbulence="none")] * 2)
    loop.start(
        np.array([[0.0, 0.0, np.pi / 2], [0.0, 0.0, np.pi]]), Scenario(engines.nominal_params(ROBOT, 2), np.full(2, 3), stream)
    )
    heard = SimpleNamespace(set_flow=lambda flow: setattr(heard, "flow", flow))
    loop.inform(heard)
    assert heard.flow == pytest.approx(np.array([[0.0, -0.2], [-0.2, 0.0]]), abs=1e-9)


def test_the_privileged_controller_steers_only_where_the_flow_is_known():
    brain = control.make("privileged", ROBOT)
    brain.reset(1)
    with pytest.raises(ConfigError, match="needs `set_flow` before every step"):
        brain(np.zeros((1, 11)))


@pytest.mark.parametrize("name", [n for n in control.NAMES if n != "drift"])
def test_a_turned_world_does_not_change_a_controller(name, engine):
    """Stream, starts and targets are turned together by 130 deg: the fish swims the same way."""
    swum = []
    for direction in (0.0, np.radians(130)):
        calm = evaluate.trials(
            speeds=[0.2], los_deg=[45], repeats=1, direction=direction, turbulence="none", randomisation=0, noise=0, duration=3
        )
        swum.append(evaluate.run(control.make(name, ROBOT), ROBOT, calm, engine).distance)
    assert swum[0] == pytest.approx(swum[1], abs=1e-3)  # rounding grows as a fish swims


def test_every_gain_has_unit_and_source():
    from fishmj.base.calib import calib_folder, read_toml

    for name, table in read_toml(calib_folder() / "controllers.toml").items():
        if not isinstance(table, dict):
            continue
        for key, entry in table.items():
            assert set(entry) == {"value", "unit", "source"}, f"{name}.{key}"
            assert entry["source"].partition(": ")[0] in ("default", "derived", "tuned"), f"{name}.{key}"


def test_the_folder_of_a_training_is_its_best_policy(tmp_path):
    run = tmp_path / "quick-ppo-0"
    run.mkdir()
    with pytest.raises(StoreError, match="quick-ppo-0: a folder without best.safetensors or last.safetensors; expected a policy"):
        control.chosen(run)
    shutil.copy(FOLDER / "station.safetensors", run / "last.safetensors")
    assert "last.safetensors" in control.chosen(run).notes[0]
    shutil.copy(FOLDER / "paper.safetensors", run / "best.safetensors")
    for brain in (control.chosen(run), control.make(str(run))):
        assert brain.sha256 == control.make("paper").sha256 and brain.name == "quick-ppo-0"
        assert brain.notes[0] == f"policy quick-ppo-0: taken from {run / 'best.safetensors'}"
    with pytest.raises(StoreError, match=f"there is one in {run}"):
        control.chosen(tmp_path)


def test_a_folder_does_not_hide_a_shipped_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("paper", "dob"):
        (tmp_path / name).mkdir()
        assert control.chosen(name).name == control.make(name).name == name


@pytest.mark.parametrize("name", ["f", "g", "h"])
def test_a_bare_function_of_observations_is_told_to_be_a_class(tmp_path, name):
    """The class of the hint, pasted into the file, is a controller."""
    text = "import numpy as np\ndef f(obs): return np.zeros((len(obs), 10, 3))\ng = lambda obs: f(obs)\nh = 3\n"
    (tmp_path / "bare.py").write_text(text)
    with pytest.raises(OwnCodeError, match=f"{name} must take the robot and return the controller") as told:
        control.chosen(f"{tmp_path / 'bare.py'}:{name}", ROBOT)
    line = str(told.value).partition("wrap it in a class and name that: ")[2]
    assert f"{name}(obs)" in line
    (tmp_path / "mended.py").write_text(f"{text}{line}\n")
    brain = control.chosen(f"{tmp_path / 'mended.py'}:Mine", ROBOT)
    brain.reset(2)
    assert name == "h" or brain(np.zeros((2, 11))).shape == (2, 10, 3)
