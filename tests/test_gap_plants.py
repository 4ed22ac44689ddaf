"""The averaged body and the servo on a bench: their laws, their effects, planted effects found again. All data are synthetic."""

import json
import re

import numpy as np
import pytest

from fishmj import effects
from fishmj.base.calib import calib_folder, constant, read_toml, resolve
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.base.store import write_text
from fishmj.effects.__main__ import enters
from fishmj.gap.commands import plant
from fishmj.gap.measured import planar_body as bodies
from fishmj.gap.measured import servo_model as servos
from fishmj.gap.measured.decoy_terms import RIVALS
from fishmj.gap.measured.planar_body import Hull, MeanGait, PlanarBody, covered
from fishmj.gap.measured.servo_model import OneServo, Pendulum, PendulumLog, ServoMotor
from fishmj.gap.measured.study import Fold, Scatter, Study, investigate
from fishmj.gap.measured.study_answer import answer
from fishmj.gap.models.swimming_fish import Constant, SwimmingFish
from fishmj.gap.records.records import ResidualLayout, Sensor
from fishmj.mjcf.reading import robot_from_dict

HULL = Hull(0.7, 2.7e-3, 0.0, 0.0, 0.0, thrust=0.1, torque=0.005, drag=0.3, sway_drag=0.0, yaw_drag=0.005)
HEAVY = HULL._replace(surge_added=0.2, sway_added=0.6, yaw_added=1e-3)
IN_WATER = ("surge_added_mass", "sway_added_mass", "yaw_added_mass", "body_lift", "munk_moment", "steady_current", "camera_scale")
ON_BENCH = ("coulomb_friction", "load_friction", "voltage_sag", "command_latency", "joint_sensor_delay", "servo_deadband")
MOTOR, RIG = ServoMotor(stall=0.7, back_emf=0.02, viscous=0.02, armature=0.002), Pendulum(0.49, 0.1, 7.4)
SCALE = np.array([0.02, 0.02, 0.15])
FREE = tuple(Constant(name, 0.3) for name in ("thrust", "torque", "drag", "yaw_drag"))


@pytest.fixture(scope="module")
def fish():
    return PlanarBody(HULL, FREE, [*map(effects.get, IN_WATER), *RIVALS])


@pytest.fixture(scope="module")
def bench():
    return OneServo(MOTOR, RIG, catalogue=map(effects.get, ON_BENCH))


def swim(starts, span=1.5, gait=(0.35, 0.5), name="a", values=None):
    starts = np.atleast_2d(np.asarray(starts, float))
    values = np.zeros((len(starts), 3)) if values is None else values
    pose = Sensor(span * np.arange(1, len(starts) + 1), values, SCALE)
    return MeanGait(name, name, 0.02, np.array([gait]), starts, span, pose)


def row(plant, **values):
    out = plant.null
    for key, value in values.items():
        out[plant.index(*key.split("__"))] = value
    return out


STARTS = np.array([[0.3, 0.2, 0.4, 0.1, 0.02, 0.3], [-0.1, 0.5, 2.0, 0.05, -0.02, -0.5]])


def test_added_mass_of_the_hull_is_the_effects_of_the_catalogue(fish):
    """Kirchhoff's terms enter the same way twice: by the hull's constants and by the effects."""
    heavy = PlanarBody(HEAVY, FREE, [])
    by_effects = row(fish, surge_added_mass__mass=0.2, sway_added_mass__mass=0.6, yaw_added_mass__inertia=1e-3)
    a = heavy.ends([swim(STARTS)], heavy.null)[0]
    b = fish.ends([swim(STARTS)], by_effects)[0]
    assert np.abs(a - b).max() < 1e-12
    assert np.abs(a - fish.ends([swim(STARTS)], fish.null)[0]).max() > 1e-3


def test_an_ideal_fluid_takes_no_energy():
    """Without drag and thrust, sum of mass times speed squared stays, however the body turns."""
    free = PlanarBody(HEAVY._replace(drag=0.0, yaw_drag=0.0), FREE, [], dt=0.002)
    track = free.tracks([swim(STARTS, span=2.0, gait=(0.0, 0.0))._replace(dt=0.002)], free.null)[0][0]
    u, w, r = track[..., 3], track[..., 4], track[..., 5]
    energy = 0.9 * u**2 + 1.3 * w**2 + 3.7e-3 * r**2
    assert np.abs(energy / energy[:, :1] - 1).max() < 5e-3
    assert np.ptp(w, axis=1).min() > 0.01  # it does tumble


def test_a_coasting_body_slows_as_quadratic_drag_says(fish):
    seconds = 3.0
    end = fish.ends([swim([0, 0, 0, 0.4, 0, 0], span=seconds, gait=(0.0, 0.0))], fish.null)[0][0, 0]
    rate = HULL.drag / HULL.mass
    assert end[3] == pytest.approx(0.4 / (1 + rate * 0.4 * seconds), rel=1e-3)
    assert end[0] == pytest.approx(np.log(1 + rate * 0.4 * seconds) / rate, rel=2e-3)


def test_a_body_that_drifts_with_the_current_goes_on_drifting(fish):
    given = row(fish, steady_current__x=0.05, steady_current__y=-0.03, body_lift__coefficient=20.0)
    heading = 0.7
    c, s = np.cos(heading), np.sin(heading)
    drift = [0, 0, heading, c * 0.05 - s * 0.03, -s * 0.05 - c * 0.03, 0]
    end = fish.ends([swim(drift, gait=(0.0, 0.0))], given)[0][0, 0]
    assert end[:3] == pytest.approx([0.075, -0.045, heading], abs=1e-9)


def test_a_camera_scale_shows_in_what_is_covered(fish):
    records = [swim(STARTS)]
    plain, scaled = (fish.predict(records, row(fish, camera_scale__scale=s))[0]["pose"][0] for s in (0.0, 0.1))
    assert scaled[:, :2] == pytest.approx(1.1 * plain[:, :2], rel=1e-12) and np.array_equal(scaled[:, 2], plain[:, 2])


def test_runs_of_different_length_end_where_they_should(fish):
    short, long = swim(STARTS, span=0.74), swim(STARTS, span=1.5, name="b")
    both = fish.ends([short, long], fish.null)
    alone = [fish.ends([r], fish.null)[0] for r in (short, long)]
    assert all(np.array_equal(a, b) for a, b in zip(both, alone, strict=True))


def test_what_is_covered_is_told_in_the_frame_of_the_start():
    before, after = np.array([1.0, 2.0, 0.5]), np.array([1.0, 3.0, 0.7])
    assert covered(before, after, np.pi / 2) == pytest.approx([1.0, 0.0, 0.2])


@pytest.mark.parametrize("acting", [bodies.acting, servos.acting])
def test_every_effect_that_is_offered_acts_at_a_site_of_the_plant(acting):
    names = [e.name for e in acting()]
    assert len(names) >= 15 and len(set(names)) == len(names)
    assert all(enters(e) for e in acting())


def tank(plant, planted, seed, conditions=8, runs=4, noise=0.05):
    """Runs under `conditions`, with noise of `noise` times the scale."""
    rng = np.random.default_rng(seed)
    records = []
    for k in range(conditions):
        gait = (0.26 + 0.09 * (k % 3), np.linspace(-0.9, 0.9, conditions)[k])
        starts = np.zeros((runs, 6))
        starts[:, 2] = rng.uniform(-3, 3, runs)
        starts[:, 3:] = rng.normal([0.08, 0.0, 0.0], [0.02, 0.01, 0.1], (runs, 3))
        record = swim(starts, gait=gait, name=f"c{k}")
        values = plant.predict([record], planted)[0]["pose"][0] + rng.normal(0, noise, (runs, 3)) * SCALE
        records.append(swim(starts, gait=gait, name=f"c{k}", values=values))
    return records


def question(plant, records, noise=0.05, aside=2, folds=3):
    learn = records[aside:]

    def error(rs, values):
        layout = ResidualLayout(list(rs))
        return float(np.mean((layout.residuals(plant.predict(list(rs), values))[0] / layout.noise()) ** 2))

    fold = np.arange(len(learn)) % folds
    return Study("synthetic", plant, learn, records[:aside], fold, error, noise**2, "the noise", ("synthetic",), ahead=5)


def test_a_planted_lift_is_named_with_its_size(fish):
    study = question(fish, tank(fish, row(fish, body_lift__coefficient=12.0), seed=1))
    found = investigate(study, most=2)
    verdict = answer(study, found)
    assert verdict.answer == "NAMED" and [e.name for e in verdict.effects] == ["body_lift"], verdict.text()
    assert verdict.effects[0].parameters["coefficient"].value == pytest.approx(12.0, rel=0.1)
    assert found.kept_aside[-1] < 2 * study.floor < 0.2 * found.kept_aside[0]


def test_where_nothing_is_planted_nothing_is_named(fish):
    study = question(fish, tank(fish, fish.null, seed=2))
    found = investigate(study, most=1)
    assert not found.rounds[0].accepted
    assert answer(study, found).answer == "NOT_REPEATABLE"  # no larger than what repeats differ by


def test_a_rival_outside_the_catalogue_is_not_taken_for_an_effect(fish):
    study = question(fish, tank(fish, row(fish, linear_yaw_damping__coefficient=0.006), seed=3))
    verdict = answer(study, investigate(study, most=1))
    assert verdict.effects[0].name == "linear_yaw_damping" and verdict.effects[0].name not in effects.catalogue()


def test_scatter_within_and_between_groups_is_recovered():
    rng = np.random.default_rng(0)
    records = [swim(np.zeros((30, 6)), name=f"g{k}") for k in range(40)]
    layout = ResidualLayout(records)
    groups = [r.group for r in records]
    residual = rng.normal(0, 2.0, layout.size)
    for b in layout.blocks:
        residual[b.where] += rng.normal(0, 5.0)
    scatter = Scatter(layout, groups, residual)
    assert all(v == pytest.approx(2.0, rel=0.1) for v in scatter.within.values())
    assert all(v == pytest.approx(5.0, rel=0.35) for v in scatter.between.values())
    z = scatter.whiten(layout, groups)(residual)
    assert np.mean(z**2) == pytest.approx(1.0, rel=0.1)
    level = [abs(z[b.where].mean()) for b in layout.blocks]
    assert np.mean(level) < 0.3  # a condition that is off as a whole counts about once, not thirty times


def test_a_fold_is_fitted_to_its_own_records_alone(fish):
    records = tank(fish, row(fish, body_lift__coefficient=12.0), seed=4)
    study = question(fish, records)
    other = [r._replace(pose=r.pose._replace(values=r.pose.values + 1.0)) for r in records[6:]]
    one = Fold(study, records[2:6]).base.row
    spoiled = Study(**{**vars(study), "learn": [*records[2:6], *other]})
    assert np.array_equal(one, Fold(spoiled, records[2:6]).base.row)


def log(plant, goal, given=None, on=1.0, volts=None, start=(0.0, 0.0), gain=0.5, name="a", seed=0, noise=0.0, delay=None):
    """A log of three seconds at irregular stamps, made by the plant itself."""
    steps = 1501
    t = np.arange(steps) * plant.dt
    volts = np.full(steps, RIG.voltage) if volts is None else volts(t)
    commands = np.stack([goal(t), np.full(steps, on), volts, np.full(steps, gain), np.full(steps, 0.885)], 1)
    rng = np.random.default_rng(seed)
    stamps = np.cumsum(rng.uniform(0.003, 0.006, 600))
    made = PendulumLog(name, name, plant.dt, commands, Sensor(stamps, np.zeros((600, 1)), np.full(1, 1e-3)), start, 0.0)
    values = plant.predict([made], plant.null if given is None else given)[0]["joint"][0]
    return made._replace(joint=made.joint._replace(values=values + rng.normal(0, noise, values.shape)))


def test_a_free_pendulum_swings_at_its_own_frequency():
    still = OneServo(ServoMotor(0.7, 0.0, 0.0, 0.002), RIG, catalogue=[])
    made = log(still, lambda t: 0 * t, on=0.0, start=(0.1, 0.0))
    inertia = 0.49 * 0.1**2 + 0.002
    expected = np.sqrt(0.49 * 9.81 * 0.1 / inertia)
    assert made.joint.values[:, 0] == pytest.approx(0.1 * np.cos(expected * made.joint.t), abs=5e-3)


def test_a_held_pendulum_droops_as_far_as_its_gain_lets_it(bench):
    held = log(bench, lambda t: 1.0 + 0 * t)
    angle = held.joint.values[-1, 0]
    assert 0.5 * (1.0 - angle) * 0.7 == pytest.approx(0.49 * 9.80665 * 0.1 * np.sin(angle), rel=1e-3)


def test_the_rail_that_was_measured_weakens_the_servo_in_proportion(bench):
    """With a sag of one ohm the torque follows the voltage of the log: half of it holds what half the gain holds."""
    halved = log(bench, lambda t: 1.0 + 0 * t, row(bench, voltage_sag__resistance=1.0), volts=lambda t: 3.7 + 0 * t)
    weak = log(bench, lambda t: 1.0 + 0 * t, gain=0.25)
    same = log(bench, lambda t: 1.0 + 0 * t, volts=lambda t: 3.7 + 0 * t)
    assert halved.joint.values[-1, 0] == pytest.approx(weak.joint.values[-1, 0], abs=1e-4)
    assert abs(same.joint.values[-1, 0] - halved.joint.values[-1, 0]) > 0.1  # at its null the rail plays no part


def test_late_sensor_and_late_command_shift_what_they_should(bench):
    goal = lambda t: 0.8 * np.sin(5 * t)
    plain = log(bench, goal)
    late = log(bench, goal, row(bench, joint_sensor_delay__delay=0.02))
    moved = np.interp(late.joint.t - 0.02, plain.joint.t, plain.joint.values[:, 0])
    inside = late.joint.t > 0.1
    assert np.abs(late.joint.values[inside, 0] - moved[inside]).max() < 1e-3
    command = log(bench, goal, row(bench, command_latency__delay=0.02))
    assert np.abs(command.joint.values - plain.joint.values).max() > 0.01


def test_planted_friction_is_named_across_gains(bench):
    goals = [lambda t, a=a, f=f: a * np.sin(f * t) for a, f in ((0.9, 2.0), (0.6, 6.0), (1.2, 1.0))]
    given = row(bench, load_friction__ratio=0.25)
    logs = [
        log(bench, goal, given, gain=gain, name=f"kp{i}", seed=10 * i + j, noise=1e-3)
        for i, gain in enumerate((0.25, 0.35, 0.5, 0.7, 1.0))
        for j, goal in enumerate(goals)
    ]
    learn, aside = [r for i, r in enumerate(logs) if i % 3 < 2], logs[2::3]

    def error(rs, values):
        seen = bench.predict(list(rs), values)
        return float(np.mean([np.mean((p["joint"][0] - r.joint.values) ** 2) for p, r in zip(seen, rs, strict=True)]))

    fold = np.repeat(np.arange(5), 2)
    study = Study("synthetic", bench, learn, aside, fold, error, 1e-6, "the noise", ("synthetic",), "mrad", 1e3)
    verdict = answer(study, investigate(study, most=1))
    assert verdict.answer == "NAMED" and verdict.effects[0].name == "load_friction", verdict.text()
    assert verdict.effects[0].parameters["ratio"].value == pytest.approx(0.25, rel=0.1)


def test_a_fish_of_two_joints_has_no_zero_of_a_third():
    model = SwimmingFish("tendon_fish", [effects.get("joint_zero_offset")])
    assert model.active.names == [("joint_zero_offset", f"offset{k}") for k in (1, 2)]
    with pytest.raises(UnknownName, match=r"of a robot with 2 joints 'offset3'.*Known: offset1, offset2\."):
        model.index("joint_zero_offset", "offset3")
    assert SwimmingFish("fish", [effects.get("joint_zero_offset")]).index("joint_zero_offset", "offset3") == len(model.nothing)
    table = read_toml(resolve("tendon_fish"))
    table["effect"] = [{"name": "joint_zero_offset", "parameters": {"offset3": {"value": 0.05}}}]
    with pytest.raises(ConfigError, match="offset3.*Known: offset1, offset2"):
        robot_from_dict(table, "mine.toml")


def test_no_zero_of_a_joint_that_is_not_there_is_planted():
    values = {"joint_zero_offset": {f"offset{k}": 0.05 for k in (1, 2, 3)}, "servo_gain": {"gain": 0.9}}
    assert list(plant.on_joints(values, ["random"], 2)["joint_zero_offset"]) == ["offset1", "offset2"]
    assert plant.on_joints(values, ["random"], 3) == values
    with pytest.raises(ConfigError, match="offset3 is of joint 3, the robot has 2; leave it out"):
        plant.on_joints(values, ["joint_zero_offset:offset1=0.05,offset3=0.05"], 2)


@pytest.mark.parametrize("generator", ["independent", "morison"])
def test_planted_values_have_the_size_of_the_robot(tmp_path, capsys, generator):
    """A weak servo with a limit above its own torque would hide nothing; what is drawn is drawn in proportion."""
    text = re.sub(r"\ntorque = [\d.]+", "\ntorque = 0.52", (calib_folder() / "fish.toml").read_text(encoding="utf-8"))
    weak = write_text(tmp_path / "weak.toml", text)

    def limit(model, *effect):
        out = tmp_path / f"{model.stem}{len(effect[0])}"
        options = ["--logs", "1", "--seed", "3", "--generator", generator, "--model", str(model), "--out", str(out)]
        assert plant.main([*effect, *options]) == 0
        truth = json.loads(out.with_name(f"{out.name}.truth.json").read_text(encoding="utf-8"))
        return truth["effects"]["torque_saturation"]["limit"]

    assert plant.main(["--list", "--model", str(weak)]) == 0
    row = next(line for line in capsys.readouterr().out.splitlines() if "torque_saturation" in line)
    assert [float(cell) for cell in row.split("|")[4:7]] == pytest.approx([0.52, 0.3119, 0.1248], rel=1e-3)
    usual = constant("servo", "torque")
    drawn = [limit(model, "torque_saturation") for model in (weak, calib_folder() / "fish.toml")]
    assert drawn[0] == pytest.approx(drawn[1] * 0.52 / usual) and 0.1 < drawn[0] < 0.4
    assert limit(weak, "torque_saturation=0.3") == 0.3
    with pytest.raises(ConfigError, match=r"gap plant torque_saturation: limit = 0.85; expected 0.0062\d* to 0.52 N m"):
        limit(weak, "torque_saturation=0.85")
