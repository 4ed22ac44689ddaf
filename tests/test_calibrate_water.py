"""The water of a fish from its free swims: what the body feels comes back, swims left out are predicted, doubt is said."""

import json
from argparse import Namespace
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("numba")

from fishmj import engines
from fishmj.base import console
from fishmj.base.errors import ConfigError, LogError
from fishmj.gap.bench.water_families import SWIMS as GUIDE
from fishmj.gap.calibrate import __main__ as command
from fishmj.gap.calibrate import calibrated_model, commands, water_fit
from fishmj.gap.calibrate.calibration_logs import Logs
from fishmj.gap.calibrate.parameter_fit import FreeParameter, Minimum, ParameterEstimate, minimum
from fishmj.gap.calibrate.water_plant import PHYSICAL, SPEED, WaterPlant, carried_thrust, physical
from fishmj.gap.models.swimming_fish import ServoStand, SwimmingFish
from fishmj.log import SCHEMA, Trial, excitation, numbered, write_trial
from fishmj.mjcf.reading import load_robot
from fishmj.water import prior
from fishmj.water.choice import in_water, label
from fishmj.water.dynamics import planar_chain, strip_forces
from fishmj.water.flow import Flow, stack

ROBOT = load_robot("fish")
SWIMS = ("gait", "gait_slow", "gait_small", "turn_left", "turn_right", "tow_ahead", "tow_sideways")
NOISE = {"pose": (0.0015, 0.0015, 0.004), "joint": 0.002}  # m, m, rad; rad


@pytest.fixture(scope="module")
def plant():
    return WaterPlant(ROBOT)


def swum(robot, names, seed=0) -> dict[str, Trial]:
    """Trials of a robot in its water, by an engine of this package, seen with noise. Synthetic."""
    engine, rng, out = engines.make("compiled", robot), np.random.default_rng(seed), {}
    for name in names:
        run = excitation.get(name)
        start, c, s = engines.at_rest(robot, np.array([run.start])), np.cos(run.start[2]), np.sin(run.start[2])
        v, (u, w, r) = np.array(start.v, float), run.push
        v[0, :3] = c * u - s * w, s * u + c * w, r
        flow = stack([Flow()])
        _, trace = engine.advance(
            start._replace(v=v), run.commands[None], engines.nominal_params(robot, 1), flow, np.zeros(1, np.int32)
        )
        pose, joint = (np.asarray(a, float)[0] for a in (trace.pose, trace.joint))
        pose, joint = np.concatenate([[run.start], pose]), np.concatenate([np.zeros((1, 3)), joint])
        t = np.arange(len(pose)) * robot.timing.bus_dt
        pose, joint = pose + rng.normal(0, NOISE["pose"], pose.shape), joint + rng.normal(0, NOISE["joint"], joint.shape)
        seen = dict(zip(("t", "x", "y", "yaw"), (t + robot.timing.camera_latency, *pose.T), strict=True))
        cmd = {"t": run.t, "seq": np.arange(len(run.t)), **numbered("c#", run.commands)}
        meta = {"schema": SCHEMA, "origin": "synthetic", "source": "tests", "robot": robot.name, "medium": "water"}
        meta |= {"excitation": name, "start": list(run.start), "push": list(run.push)}
        out[name] = Trial(meta, {"cmd": cmd, "joint": {"t": t, **numbered("j#", joint)}, "pose": seen}, name=name)
    return out


def other_water():
    """The shipped fish with more added mass, a rougher hull and a weaker edge."""
    w = ROBOT.water
    water = w | {"k": [1.1, 1.0, 1.0, 0.9], "cn": [1.5, 1.5, 1.5, 2.4], "cf": 0.02, "ca_forward": 0.55, "ke": 0.62}
    return in_water(replace(ROBOT, water=water), "structured")


def logs_of(trials) -> Logs:
    return Logs(Path("made here"), trials)


def test_as_described_it_is_the_fish_of_the_search(plant):
    records = logs_of(swum(in_water(ROBOT, "structured"), ("gait", "tow_sideways"))).records(plant.dt)
    whole = SwimmingFish(ROBOT)
    for mine, theirs in zip(plant.predict(records, plant.null), whole.predict(records, whole.null), strict=True):
        np.testing.assert_allclose(mine["pose"], theirs["pose"], atol=1e-9)


def test_added_mass_and_drag_are_those_of_the_strips(plant):
    strips, water, said = plant.chain.strips, plant.nominal.water, physical(plant.chain, plant.nominal)
    assert said["sway_mass"] == pytest.approx(sum(k * mu[0] for k, mu in zip(water.k, strips.mu, strict=True)))
    origins = np.cumsum([0.0, *plant.chain.d])
    moments = [k * (m0 * x**2 + 2 * m1 * x + m2) for k, (m0, m1, m2), x in zip(water.k, strips.mu, origins, strict=True)]
    assert said["yaw_mass"] == pytest.approx(sum(moments))
    wetted = sum(sum(p) for p in strips.p)
    assert said["drag"] == pytest.approx(
        0.5 * 1000.0 * SPEED**2 * (water.cf * wetted + water.ca_forward * strips.frontal), rel=1e-3
    )
    still = water._replace(k=[0.0] * 4, cn=[0.0] * 4, cf=0.0, ca_forward=0.0, ca_backward=0.0, ke=0.0)
    assert carried_thrust(plant.chain, plant.nominal._replace(water=still), 0.0) == 0.0
    edge = carried_thrust(plant.chain, plant.nominal._replace(water=still._replace(ke=0.5, lift_a=0.0, lift_b=0.0)), 0.0)
    assert 0.0 < edge < attached_edge(plant.chain, 0.5)
    rows = water._replace(ke=np.array([0.5, 1.0]))
    both = physical(plant.chain, plant.nominal._replace(water=rows))
    assert both["thrust"].shape == (2,) and both["thrust"][0] == pytest.approx(said["thrust"])


def attached_edge(chain, ke) -> float:
    """N: what the trailing edge would pull, were the flow always attached; its velocity by differences of its place."""
    t = np.arange(1.0, 2.0, 1e-4)
    bends = np.radians(30) * np.sin(2 * np.pi * t[:, None] - np.radians(60) * np.arange(3))
    heading = np.concatenate([np.zeros((len(t), 1)), np.cumsum(bends, 1)], 1)
    along = np.exp(1j * heading) * [*chain.d, chain.strips.tail_x]  # each link's vector to its rear end
    rate = np.gradient(along.sum(1), t)
    across = np.imag(rate * np.exp(-1j * heading[:, -1]))
    mass = ke * 1000.0 * np.pi / 4 * chain.strips.tail_h**2
    return float(np.mean(0.5 * mass * across**2 * np.cos(heading[:, -1])))


@pytest.mark.slow
def test_another_water_of_the_same_form_comes_back(plant):
    robot = other_water()
    found = water_fit.calibrate(logs_of(swum(robot, SWIMS)), plant)
    truth = physical(plant.chain, WaterPlant(robot).nominal)
    for name in PHYSICAL:
        e, true = found.physical[name], float(truth[name])
        assert e.low <= true <= e.high and e.high - e.low < 0.6 * true, (name, true, e)
    begin = np.nanmean([swim.speed_error for swim in found.before])
    assert found.speed_error.value < 0.03 < 0.07 < begin
    assert water_fit.loose_servo(plant, found.records, found.theta) == ""
    assert {swim.trial for swim in found.after} == set(SWIMS)


@pytest.mark.slow
def test_fitted_water_corrects_swim_speed_although_its_form_is_wrong(plant):
    found = water_fit.calibrate(logs_of(swum(in_water(ROBOT, "swift"), GUIDE)), plant)
    begin = np.nanmean([swim.speed_error for swim in found.before])
    gaits = [swim.speed_error for swim in found.after if "gait" in swim.kind]
    assert begin > 0.25 and np.mean(gaits) < 0.05 and found.speed_error.value < 0.04


def test_repeats_of_a_kind_are_left_out_together():
    names = ("a", "b", "c")
    records = logs_of(swum(in_water(ROBOT, "structured"), ("gait_fast",))).records(0.004) * 3
    records = [r._replace(name=f"{kind}{i}", excitation=kind) for kind in names for i, r in enumerate(records[:2])]
    folds = water_fit.folded(records)
    assert sorted(sum(folds, [])) == list(range(6)) and all(len({records[i].excitation for i in f}) == 1 for f in folds)


def test_trials_in_memory_give_the_robot_and_what_is_said_of_it(plant, monkeypatch):
    monkeypatch.setattr(water_fit, "ROUNDS", 1)
    monkeypatch.setattr(water_fit, "AGAIN", 1)
    trials = list(swum(other_water(), SWIMS[:5]).values())
    robot, found = water_fit.calibrate_trials(trials, ROBOT)
    assert label(robot) == "structured" and robot.links == ROBOT.links
    table = {key: value for key, value in robot.water.items() if key not in ("model", "stations")}
    assert table == found.water and set(found.physical) == set(PHYSICAL)
    again = WaterPlant(robot)
    swims = water_fit.predicted(again, found.records, again.starts()[0])
    for mine, theirs in zip(swims, water_fit.predicted(plant, found.records, found.theta), strict=True):
        assert mine.speed == theirs.speed and mine.simulated == pytest.approx(theirs.simulated, rel=1e-9)


def test_fit_worse_than_the_description_is_refused(plant, monkeypatch):
    monkeypatch.setattr(water_fit, "fitted", lambda plant, records, begin, *_: lost(plant))
    trials = list(swum(in_water(ROBOT, "structured"), SWIMS[:5]).values())
    with pytest.raises(LogError, match="water: the error on held-out swims is .* times the error of the described"):
        water_fit.calibrate_trials(trials, ROBOT)


def lost(plant) -> Minimum:
    """A fit that ended far from the described coefficients."""
    theta = plant.starts()[0] * 1.5
    return Minimum(theta, 0.0, np.zeros(30), np.eye(30, len(theta)), np.zeros(len(theta), bool), 1)


def test_a_fit_ends_at_the_least_and_at_a_bound():
    slopes = np.array([[2.0, 1.0], [0.0, 3.0], [1.0, -1.0]])
    residual = lambda thetas: thetas @ slopes.T - np.array([4.0, 3.0, 1.0])
    free = [FreeParameter(name, "1", 0.0, 1e-3) for name in "ab"]
    found = minimum(free, residual, np.ones(3), np.array([5.0, -5.0]), 20, 1e-9)
    assert found.theta == pytest.approx(np.linalg.lstsq(slopes, [4.0, 3.0, 1.0], rcond=None)[0], abs=1e-5)
    bound = [free[0]._replace(high=0.5), free[1]]
    found = minimum(bound, residual, np.ones(3), np.array([0.0, -5.0]), 20, 1e-9)
    rest = np.linalg.lstsq(slopes[:, 1:], np.array([4.0, 3.0, 1.0]) - 0.5 * slopes[:, 0], rcond=None)[0]
    assert found.theta == pytest.approx([0.5, rest[0]], abs=1e-5) and list(found.held) == [True, False]


def test_intervals_grow_with_what_folds_disagree_by(plant):
    theta = plant.starts()[0]
    whole = Minimum(theta, 0.0, np.zeros(30), np.eye(30, len(theta)), np.zeros(len(theta), bool), 1)
    near, far = (theta * (1 + size * np.array([-1.0, -0.5, 0.0, 0.5, 1.0])[:, None]) for size in (0.01, 0.1))
    _, small = water_fit.intervals(plant, whole, near)
    _, large = water_fit.intervals(plant, whole, far)
    for name in ("sway_mass", "drag"):
        e, values = large[name], plant.physical(far)[name]
        apart = 2.1318 * np.sqrt(4 / 5 * np.sum((values - values.mean()) ** 2))  # Student's t, four degrees of freedom, 95 %
        assert (e.high - e.low) / 2 >= apart > (small[name].high - small[name].low) / 2 > 0
        assert e.widest == "kinds of swim" and e.value == small[name].value


def test_where_the_edge_is_met_and_how_the_tail_is_held_change_its_force():
    wing = replace(ROBOT, water=ROBOT.water | {"edge_place": 0.5, "tail_held": 0.8, "linear_drag": 0.3})
    plain, made = (planar_chain.chain_of(robot).strips for robot in (ROBOT, wing))
    water = WaterPlant(ROBOT).nominal.water
    assert made.edge_x == pytest.approx(0.5 * plain.tail_x) and sum(made.linear) == pytest.approx(0.3)
    force = lambda strips, *motion: strip_forces.link_forces(np, strips, water, 3, *motion, 0.0, 0.0, 1.0)
    turn = force(plain, 0.3, 0.0, 2.0)[0] - force(plain._replace(edge_x=made.edge_x), 0.3, 0.0, 2.0)[0]
    flux = 0.5 * water.ke * 1000.0 * np.pi / 4 * plain.tail_h**2 * 4.0
    assert turn == pytest.approx(flux * (plain.tail_x**2 - made.edge_x**2))
    across = force(plain, 0.0, 0.2, 0.0)[1] - force(plain._replace(held=0.8), 0.0, 0.2, 0.0)[1]
    assert across == pytest.approx(-0.8 * 0.5 * 1000.0 * water.cn[3] * sum(plain.h[3]) * 0.04)
    rest = force(plain, 0.3, 0.0, 0.0)[0] - force(plain._replace(linear=made.linear), 0.3, 0.0, 0.0)[0]
    assert rest == pytest.approx(0.3 * made.linear[3])


def test_every_engine_swims_in_the_same_wing_water():
    water = ROBOT.water | {"edge_place": 0.5, "tail_held": 0.8, "linear_drag": 0.3}
    robot = in_water(replace(ROBOT, water=water), "structured")
    assert {key: robot.water[key] for key in ("edge_place", "tail_held", "linear_drag")} == {
        key: water[key] for key in ("edge_place", "tail_held", "linear_drag")
    }
    commands, ends = excitation.get("gait").commands[None, :60], []
    for name, swimmer in (("batch", robot), ("compiled", robot), ("compiled", in_water(ROBOT, "structured"))):
        engine = engines.make(name, swimmer)
        start, flow = engines.at_rest(robot, np.zeros((1, 3))), stack([Flow()])
        _, trace = engine.advance(start, commands, engines.nominal_params(robot, 1), flow, np.zeros(1, np.int32))
        ends.append(np.asarray(trace.pose, float)[0, -1])
    assert np.abs(ends[0] - ends[1]).max() < 1e-6 < 1e-3 < np.abs(ends[2] - ends[1]).max()


def test_in_air_no_linear_drag_acts():
    stand = ServoStand(replace(ROBOT, water=ROBOT.water | {"linear_drag": 0.3}))
    for wet in (0.0, 1.0):
        row = stand.null.copy()
        row[stand.place("wet")] = wet
        assert sum(stand._chain(row).strips.linear) == pytest.approx(0.3 * wet)
    assert ServoStand(ROBOT)._chain(stand.null).strips.linear is None


def test_a_solver_fit_refuses_what_it_does_not_know():
    with pytest.raises(ConfigError, match="edge_place, tail_held, linear_drag: .*leave them out"):
        prior.prior_of(replace(ROBOT, water=ROBOT.water | {"linear_drag": 0.1}))


def test_pace_of_a_circle():
    t = np.arange(0, 8, 0.02)
    pose = np.stack([np.cos(0.3 * t), np.sin(0.3 * t), 0.3 * t + np.pi / 2], 1)
    speed, turn = water_fit.mean_speed_and_yaw_rate(t, pose)
    assert speed == pytest.approx(0.3, rel=0.005) and turn == pytest.approx(0.3, rel=1e-6)


def test_too_few_swims_are_refused_with_what_to_record():
    trials = swum(in_water(ROBOT, "structured"), ("gait", "gait_slow", "tow_ahead"))
    with pytest.raises(LogError, match=r"got 3 swims of 3 kinds .*gait.*expected 4 or more of 3 kinds.*turns to both sides"):
        water_fit.swims(logs_of(trials))
    dry = {name: replace_meta(trial, medium="air") for name, trial in trials.items()}
    with pytest.raises(LogError, match=r"got 0 swims of 0 kinds \(none\)"):
        water_fit.swims(logs_of(dry))


def replace_meta(trial: Trial, **more) -> Trial:
    return Trial({**trial.meta, **more}, trial.tables, name=trial.name)


def test_lines_of_a_table_are_replaced_or_added():
    text = "[water]\nk = [1.0, 1.0]  # note\n\n[servo]\nkp = 3\n"
    made = calibrated_model.put(text, "water", {"k": [0.5, 0.25], "suction": 0.5, "model": "structured"}, new=True)
    assert made == '[water]\nk = [0.5, 0.25]  # note\nsuction = 0.5\nmodel = "structured"\n\n[servo]\nkp = 3\n'
    assert calibrated_model.put("a = 1\n", "water", {"cf": 0.1}, new=True) == "a = 1\n\n[water]\ncf = 0.1\n"


def test_swims_without_a_stated_current_are_said_to_be_taken_for_still_water(tmp_path, capsys):
    trials = swum(in_water(ROBOT, "structured"), ("gait", "tow_ahead"))
    trials["tow_ahead"] = replace_meta(trials["tow_ahead"], flow={"speed": 0.0, "direction": 0.0, "known": True})
    for name, trial in trials.items():
        write_trial(tmp_path / "swims" / name, trial)
    logs = commands.open_logs(Namespace(data=tmp_path / "swims", model="fish", same_robot=False), ROBOT)
    line = "1 of 2 swims state no current (flow in meta.toml, or log import --flow); still water is assumed"
    assert line in logs.notes and line in capsys.readouterr().err


def test_a_fitted_edge_at_its_bound_is_read_back_and_less_is_refused_in_full(tmp_path):
    whole = calibrated_model.start(tmp_path / "none.toml", "fish")
    rounded = calibrated_model.put(whole, "water", {"lift_a": 0.12345678945, "lift_b": 0.5 - 0.12345678945}, new=True)
    (tmp_path / "mine.toml").write_text(rounded.replace("lift_a = 0.123456789", "lift_a = 0.123456788"), encoding="utf-8")
    water = load_robot(tmp_path / "mine.toml").water
    assert 0.5 - 1e-6 < water["lift_a"] + water["lift_b"] < 0.5
    less = calibrated_model.put(whole, "water", {"lift_a": 0.1, "lift_b": 0.399998}, new=True)
    (tmp_path / "mine.toml").write_text(less, encoding="utf-8")
    with pytest.raises(ConfigError, match=r"lift_a \+ lift_b = 0\.499998, expected at least 0\.5"):
        load_robot(tmp_path / "mine.toml")


def test_a_poor_water_is_written_with_its_faults_and_fails(tmp_path, capsys, monkeypatch):
    """The fit takes one round; errors and bounds are set, so that this is a test of what is said of them."""
    monkeypatch.setattr(water_fit, "ROUNDS", 1)
    monkeypatch.setattr(water_fit, "AGAIN", 1)
    calibrate = water_fit.calibrate

    def off(logs, plant, share, **_):
        found = calibrate(logs, plant)
        coefficients, thrust = dict(found.coefficients), found.physical["thrust"]
        coefficients |= {"ke": coefficients["ke"]._replace(bound="upper"), "cf": coefficients["cf"]._replace(bound="")}
        wide = found.physical | {"thrust": thrust._replace(low=thrust.value - 1, high=thrust.value + 1)}
        after = [swim._replace(speed=0.2, simulated=0.2 * (1 + share)) for swim in found.after]
        return found._replace(coefficients=coefficients, physical=wide, after=after, misfit=(1.0, 2.0))

    for name, trial in swum(other_water(), SWIMS[:5]).items():
        write_trial(tmp_path / "swims" / name, replace_meta(trial, excitation="" if name == "gait" else name))
    argv = [
        "water",
        "--data",
        str(tmp_path / "swims"),
        "--report",
        str(tmp_path / "report"),
        "--out",
        str(tmp_path / "mine.toml"),
    ]
    for share, code in ((0.3, console.FAILED_CHECK), (0.05, console.OK)):
        monkeypatch.setattr(water_fit, "calibrate", partial(off, share=share))
        assert console.run(command.main, [*argv, "--json"]) == code
        said = capsys.readouterr()
        poor = "too poor to search with: 30.0 % mean speed error on unseen swims, above 10 %" if code else ""
        assert f"written: {tmp_path / 'mine.toml'}{', but ' * bool(poor)}{poor}\n" in said.out
        assert "parameters at a bound: " in said.out and "ke (upper)" in said.out
        assert "not identified by these swims (90 % interval wider than the value): " in said.out and "thrust (" in said.out
        start = "fish" if code else tmp_path / "mine.toml"  # which is there the second time, and gone on with
        assert f"relied on servo, command_latency, camera_latency as described: no calibration block of {start}" in said.out
        assert "excitation not stated by 1 of 5 swims: each such trial counts as its own kind" in said.err
        assert "name them: log import --excitation TRIAL=NAME" in said.out
        assert json.loads(said.out.splitlines()[-1])["poor"] == poor


def test_numbers_that_a_water_relied_on_are_those_that_no_calibration_states(tmp_path):
    mine, whole = tmp_path / "mine.toml", calibrated_model.start(tmp_path / "none.toml", "fish")
    estimate = ParameterEstimate("", "s", 0.1, 0.09, 0.11, 0.01, "trials")
    calibrated_model.write(mine, whole, "servo", {"kp": estimate, "command_latency": estimate}, {}, tmp_path)
    (line,) = water_fit.unmeasured(str(mine))
    assert line.startswith("relied on camera_latency as described")
    (line,) = water_fit.unmeasured("fish", mine)
    assert line.endswith(f"but {mine} does: fit again with --model {mine}")
    text = mine.read_text(encoding="utf-8")
    calibrated_model.write(mine, text, "latency", {"camera_latency": estimate}, {}, tmp_path)
    assert water_fit.unmeasured(str(mine)) == []


@pytest.mark.slow
def test_the_command_writes_a_fish_in_its_calibrated_water(tmp_path, capsys):
    for name, trial in swum(other_water(), SWIMS[:5]).items():
        write_trial(tmp_path / "swims" / name, trial)
    out, argv = tmp_path / "mine.toml", ["water", "--data", str(tmp_path / "swims"), "--report", str(tmp_path / "report")]
    assert console.run(command.main, [*argv, "--out", str(out), "--json"]) == console.OK
    answer = json.loads(capsys.readouterr().out.splitlines()[-1])
    made = load_robot(out)
    assert label(made) == "structured" and label(in_water(made)) == "structured"  # not the water fitted to the shipped fish
    assert made.water["ke"] == pytest.approx(answer["coefficients"]["ke"]["value"], rel=1e-5)
    assert "[calibration.water]" in out.read_text(encoding="utf-8") and answer["speed_error"]["value"] < 0.05
    assert (tmp_path / "report" / "water.png").is_file() and "speed error on held-out swims" in answer["words"]
