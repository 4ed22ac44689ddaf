"""The null belongs to the model that is questioned: chains of 2 to 8 links, and the sensors that the logs state."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("numba")

from describing import new, sized

from fishmj import effects
from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.gap import __main__ as gap
from fishmj.gap.bench.run_case import sizes, true_gap
from fishmj.gap.commands.plant import with_lost_rows
from fishmj.gap.laboratory.virtual_robot import generate
from fishmj.gap.laboratory.virtual_robot.robot_constants import buildable
from fishmj.gap.laboratory.virtual_robot.simulate import columns
from fishmj.gap.models.swimming_fish import SwimmingFish
from fishmj.gap.null.null_runs import SimulatedNull, as_excitation
from fishmj.gap.null.second_robot import log_sensors
from fishmj.gap.records.records import record_of
from fishmj.gap.workflow import investigate
from fishmj.log import Trial, excitation
from fishmj.log.dataset import read_dataset
from fishmj.mjcf.reading import load_robot
from studies.gap_benchmark import robots

SOME = ("command_latency", "servo_gain", "viscous_friction", "joint_zero_offset", "camera_scale")


@pytest.fixture(scope="module")
def fish_of(tmp_path_factory):
    """A description of as many links, on disk."""
    folder = tmp_path_factory.mktemp("fish")

    def described(links: int):
        path = folder / f"pike{links}.toml"
        if not path.exists():
            assert new(f"pike{links}", *sized(links=str(links)), "--out", str(path)) == console.OK
        return path

    return described


@pytest.mark.parametrize("links", [2, 3, 5, 8])
def test_a_chain_of_any_length_swims_ahead_and_its_trial_has_its_joints(links, fish_of):
    (trial,) = generate({}, ["gait"], 3, robot=fish_of(links))
    record = record_of(trial, 0.004)
    assert record.joint.values.shape[1] == record.commands.shape[1] == links - 1
    assert set(trial.value("sigma")) >= {f"j{j + 1}" for j in range(links - 1)}
    assert 0.3 < record.pose.values[-1, 0] - record.pose.values[0, 0] < 6.0 and np.abs(record.joint.values).max() < 1.0


def test_the_shipped_tendon_fish_swims():
    (trial,) = generate({}, ["gait"], 3, robot="tendon_fish")
    assert np.ptp(record_of(trial, 0.004).pose.values[:, 0]) > 0.3


def test_an_experiment_laid_on_another_chain_bends_it_as_far():
    together = np.full((4, 3), 0.3)
    for joints in (4, 5, 7):
        assert excitation.bent(together, joints).sum(1) == pytest.approx(0.9)
    gait = excitation.get("gait").commands
    assert np.array_equal(excitation.get("gait", 2).commands, gait[:, :2])
    five = excitation.get("gait", 5).commands
    assert five[:, [0, 2, 4]] == pytest.approx(0.6 * gait)
    with pytest.raises(ConfigError, match="commands 3 joints, tendon_fish has 2"):
        generate({}, [excitation.get("gait")], 0, robot="tendon_fish")


def test_second_robot_refuses_unsupported_chains_and_stiff_servos(fish_of):
    robot = load_robot(fish_of(8))
    with pytest.raises(ConfigError, match="has 9 links; it is a chain of 2 to 8"):
        buildable(replace(robot, links=(*robot.links, robot.links[-1])))
    with pytest.raises(ConfigError, match="has 1 links"):
        buildable(replace(robot, links=robot.links[:1]))
    with pytest.raises(ConfigError, match="does not hold kp = 800 N m/rad .* kp up to"):
        buildable(replace(robot, servo=replace(robot.servo, kp=800.0)))
    for known in ("fish", "tendon_fish"):
        buildable(load_robot(known))


def test_a_column_of_the_recording_has_one_name():
    assert list(columns(3)) == "x y yaw vx vy wz j1 j2 j3 k1 k2 k3 V I e1 e2 e3 d1 d2 d3".split()
    assert len(columns(7)) == 36


# Sensors that the logs state.


@pytest.fixture(scope="module")
def idle():
    return generate({}, ["idle"], 0)[0]


def restated(trial: Trial, factor: float) -> Trial:
    """The trial with its noises stated so many times as large."""
    return Trial(trial.meta | {"sigma": {k: factor * v for k, v in trial.value("sigma").items()}}, trial.tables, name=trial.name)


@pytest.mark.parametrize("noise", [0.5, 1.0, 3.0])
def test_logs_of_the_usual_sensors_leave_the_null_as_it_is(noise):
    record = record_of(generate({}, ["idle"], 0, noise)[0], 0.004)
    assert log_sensors(record, load_robot("fish"), noise).key == []


def test_stated_noise_is_what_null_fish_are_measured_with(idle):
    record = record_of(restated(idle, 2.0), 0.004)
    sensors = log_sensors(record, load_robot("fish"), 1.0)
    assert sensors.fields["camera.position_noise"] == pytest.approx(0.004) and not sensors.stamps
    usual, louder = (
        SimulatedNull(runs=12)._run(load_robot("fish"), as_excitation(r), r) for r in (record_of(idle, 0.004), record)
    )
    for sensor, columns_ in (("pose", (0, 1, 2)), ("joint", (0, 1, 2))):
        for column in columns_:
            one, two = (np.mean([np.std(getattr(r, sensor).values[:, column]) for r in runs]) for runs in (usual, louder))
            assert two / one == pytest.approx(2.0, abs=0.2), (sensor, column)
            assert getattr(louder[0], sensor).sigma[column] == pytest.approx(getattr(record, sensor).sigma[column])


def test_null_fish_are_read_when_the_log_was(idle):
    lost = with_lost_rows(idle, 0.2, np.random.default_rng(0))
    slow = generate({}, ["idle"], 0, sensors={"network.period": 0.04, "camera.period": 1 / 30})[0]
    for trial, read in ((lost, {"joint", "pose", "power"}), (slow, {"joint", "pose"})):
        record = record_of(trial, 0.004)
        run = SimulatedNull(runs=1)._run(load_robot("fish"), as_excitation(record), record)[0]
        for sensor in ("joint", "pose", "power"):
            same = np.array_equal(getattr(run, sensor).t, getattr(record, sensor).t)
            assert same or sensor not in read, sensor


def test_the_key_of_null_runs_has_what_the_logs_state_of_their_sensors(idle):
    model = SwimmingFish("fish", [effects.get("command_latency")])
    noisy, lost = restated(idle, 2.0), with_lost_rows(idle, 0.2, np.random.default_rng(0))
    other = with_lost_rows(idle, 0.2, np.random.default_rng(1))
    again = generate({}, ["idle"], 0, 0.9)[0]
    again = Trial(again.meta | {"sigma": idle.value("sigma")}, again.tables, name=again.name)  # other stamps, the same rate

    def key(trial):
        record = record_of(trial, 0.004)._replace(place=np.zeros(3))
        return SimulatedNull()._key(model, record, as_excitation(record))

    assert key(idle) == key(again)
    assert len({key(idle), key(noisy), key(lost), key(other)}) == 4


def test_what_no_log_states_is_the_robots_own(idle):
    bare = Trial({k: v for k, v in idle.meta.items() if k != "sigma"}, idle.tables, name="a")
    assert log_sensors(record_of(bare, 0.004), load_robot("fish"), 1.0).key == []
    perfect = restated(idle, 0.0)
    fields = log_sensors(record_of(perfect, 0.004), load_robot("fish"), 1.0).fields
    assert fields["camera.heading_noise"] == 0.0 and fields["network.angle_noise"] == 0.0 < fields["network.angle_step"]


# The verbs.


def test_plant_takes_a_model_and_the_rates_of_sensors(tmp_path, fish_of):
    words = [
        "plant",
        "none",
        "--model",
        fish_of(5),
        "--logs",
        "1",
        "--joint-rate",
        "25",
        "--drop",
        "0.2",
        "--out",
        tmp_path / "a",
    ]
    assert console.run(gap.main, [str(w) for w in words]) == console.OK
    data = read_dataset(tmp_path / "a")
    t = data[data.names[0]].tables["joint"]["t"]
    assert "j4" in data[data.names[0]].tables["joint"] and np.median(np.diff(t)) == pytest.approx(0.04, abs=1e-3)
    assert 0.7 < (len(t) - 1) * 0.04 / (t[-1] - t[0]) < 0.9


def test_the_rates_are_of_the_second_robot_alone(tmp_path, capsys):
    words = ["plant", "none", "--generator", "lbm", "--pose-rate", "30", "--out", tmp_path / "b"]
    assert console.run(gap.main, [str(w) for w in words]) == console.BAD_INPUT
    assert "are not for --generator lbm" in capsys.readouterr().err


def test_the_benchmark_sizes_effects_on_the_robot_of_the_model(fish_of):
    """How large an effect is hangs on the robot: the small tendon tail turns with a servo that is hardly late."""
    from fishmj.gap.bench.cases import BenchCase

    hidden = {"command_latency": {"delay": 0.05}}
    case = BenchCase("a", "single", hidden, 1.0, ("gait",), 3)
    found = [sizes(true_gap, SwimmingFish(model, [effects.get("command_latency")]), case)[0] for model in ("fish", fish_of(2))]
    assert min(found) > 5.0 and abs(found[0] / found[1] - 1.0) > 0.05


def test_the_search_asks_for_a_torque_limit_below_the_robots_own():
    """A servo of 0.52 N m does not notice the default fish's limits of 0.8 to 1.2 N m, so no search found a weak one."""
    fish = load_robot("fish")
    model = SwimmingFish(replace(fish, servo=replace(fish.servo, torque=0.52)), [effects.get("torque_saturation")])
    limit = model.active.effect("torque_saturation").parameter("limit")
    assert model.nothing[-1] == limit.null == limit.high == 0.52 and limit.low < limit.typical[0] < limit.typical[1] < 0.4
    usual = SwimmingFish(fish, [effects.get("torque_saturation")])
    assert usual.active.effects == (effects.get("torque_saturation"),)


def test_the_study_hides_and_restates_what_its_table_says():
    (trial, *_) = robots.trials_of(robots.TrialSettings("fish", "twice the noise", 3))
    assert trial.value("sigma.x") == pytest.approx(0.004) and trial.value("sigma.start") == pytest.approx(0.002)
    rows = [
        {"model": "fish", "condition": "50 ms of latency", "answer": "NAMED", "gap_before": 9.0,
         "said": [{"name": "command_latency", "values": {"delay": [0.051, low, 0.055]}}]}
        for low in (0.04, 0.0505)
    ]  # fmt: skip
    line = robots.summary("fish", "50 ms of latency", rows)
    assert (line["right"], line["of"], line["ms"], line["interval holds"]) == (2, 2, "51.0, 51.0", "1")


@pytest.mark.slow
@pytest.mark.parametrize("links", [2, 5])
def test_a_healthy_fish_of_other_links_agrees_and_a_late_one_is_named(links, fish_of):
    model = SwimmingFish(str(fish_of(links)), [effects.get(name) for name in SOME])
    runs, null = ("gait_fast", "steps", "chirp"), SimulatedNull(runs=48)
    assert investigate(model, generate({}, runs, 11, robot=fish_of(links)), null=null).verdict.answer == "AGREES"
    late = generate({"command_latency": {"delay": 0.05}}, runs, 11, robot=fish_of(links))
    verdict = investigate(model, late, null=null).verdict
    assert verdict.answer == "NAMED" and [e.name for e in verdict.effects] == ["command_latency"], verdict.text()
    assert verdict.effects[0].parameters["delay"].low < 0.05 < verdict.effects[0].parameters["delay"].high
