"""The benchmark of `gap find --model`: drawn robots, generators, data sets, and scores of hand-made rows. All is *synthetic*."""

import json

import mujoco
import numpy as np
import pytest

from fishmj import effects
from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.gap.bench import bench_command, robot_bench, robot_cases, robot_thresholds
from fishmj.gap.bench.robot_score import figures, is_right, kind_of, leave_one_out, median_with_bounds, relative_errors
from fishmj.gap.laboratory.articulated import robot_stand as stands
from fishmj.gap.laboratory.articulated.bam_servo import friction_budget, servos
from fishmj.gap.laboratory.articulated.hidden_faults import with_hidden
from fishmj.gap.laboratory.articulated.mujoco_plant import BamPlant, MujocoPlant
from fishmj.gap.laboratory.articulated.plant_laws import JointLaws
from fishmj.gap.laboratory.articulated.robot_plan import FAMILIES, carried_inertia, draw_plan, held_torque, mjcf, within_tolerance
from fishmj.gap.laboratory.articulated.robot_session import draw_session
from fishmj.gap.models.robot_description import read_robot
from fishmj.gap.thresholds import thresholds


def plan_of(family: str, seed: int = 3):
    return draw_plan(family, np.random.default_rng(seed))


# ------------------------------------------------------------------------------------------------------------------------- robots
@pytest.mark.parametrize("family", FAMILIES)
def test_drawn_robot_is_one_that_the_search_takes(family, tmp_path):
    plan = plan_of(family)
    path = tmp_path / "robot.xml"
    path.write_text(mjcf(plan))
    robot = read_robot(path)
    assert robot.sites("joint") == tuple(f"j{k + 1}" for k in range(len(plan.limbs)))
    np.testing.assert_allclose(robot.model.dof_M0, carried_inertia(plan), rtol=1e-6)


def test_held_torque_is_gravity_at_a_horizontal_pendulum():
    plan = plan_of("pendulum")
    m = mujoco.MjModel.from_xml_string(mjcf(plan))
    d, seen = mujoco.MjData(m), []
    for q in np.linspace(0, 2 * np.pi, 721):
        d.qpos[:] = q
        mujoco.mj_forward(m, d)
        seen.append(abs(d.qfrc_bias[0]))
    np.testing.assert_allclose(held_torque(plan), max(seen), rtol=1e-4)


def test_tolerances_scatter_about_the_description():
    plan = plan_of("two_link")
    drawn = [within_tolerance(plan, np.random.default_rng(k)).limbs[1] for k in range(400)]
    ratio = np.log([b.mass / plan.limbs[1].mass for b in drawn])
    assert abs(np.mean(ratio)) < 0.006 and 0.026 < np.std(ratio) < 0.034
    own = np.log([b.inertia[0] / plan.limbs[1].inertia[0] * plan.limbs[1].mass / b.mass for b in drawn])
    assert 0.085 < np.std(own) < 0.115


def test_payload_is_a_point_mass_on_the_link():
    plan = plan_of("two_link")
    loaded = with_hidden(plan, {"payload@b2": {"mass": 0.2}})
    place = " ".join(f"{2 * x:.9g}" for x in plan.limbs[1].centre)
    load = f'<body pos="{place}"><inertial pos="0 0 0" mass="0.2" diaginertia="1e-9 1e-9 1e-9"/></body>'
    text = mjcf(plan)
    end = text.index("/>", text.rindex("<inertial")) + 2
    m = mujoco.MjModel.from_xml_string(text[:end] + load + text[end:])
    np.testing.assert_allclose(carried_inertia(loaded), m.dof_M0, rtol=2e-3)  # products of inertia are left out


# --------------------------------------------------------------------------------------------------------------------- generators
def test_pinocchio_accelerates_as_mujoco_does():
    pin = pytest.importorskip("pinocchio")
    from fishmj.gap.laboratory.articulated.pinocchio_plant import pinocchio_model

    plan = plan_of("arm")
    m = mujoco.MjModel.from_xml_string(mjcf(plan))
    d, rng = mujoco.MjData(m), np.random.default_rng(0)
    m.dof_frictionloss[:], m.dof_damping[:] = 0, 0
    d.qpos[:], d.qvel[:] = rng.standard_normal((2, m.nv))
    mujoco.mj_forward(m, d)
    other = pinocchio_model(pin, plan)
    other.armature = plan.column("armature")
    found = pin.aba(other, other.createData(), d.qpos, d.qvel, d.qfrc_actuator)
    np.testing.assert_allclose(found, d.qacc, rtol=1e-6)


def test_friction_budget_of_bam_by_hand():
    v, motor, external = np.array([0.5, -1.0]), np.array([0.2, 0.1]), np.array([0.1, -0.3])
    m3 = servos()["xl330"].laws["M3"]
    np.testing.assert_allclose(friction_budget({0: m3}, v, motor, external), [0.121665 * 0.1, 0.0])
    p = servos()["mx64"].laws["M6"]
    c = np.exp(-((1.0 / p["speed"]) ** p["alpha"]))
    by_hand = c * p["stribeck"] + abs(-0.3 * p["external"] - 0.1 * p["motor"])
    by_hand += c * abs(-0.3 * p["external_stribeck"] - 0.1 * p["motor_stribeck"]) + c * p["motor_quad"] * 0.1**2
    np.testing.assert_allclose(friction_budget({1: p}, v, motor, external)[1], by_hand)


def test_servo_of_bam_without_load_law_moves_as_the_description_does():
    plan = plan_of("pendulum", 5)
    if plan.torques:
        plan = plan.changed(0, kp=20.0, kv=1.0)._replace(torques=False)
    plants = [MujocoPlant(plan, {}), BamPlant(plan, {}, {})]
    for plant in plants:
        plant.start(np.zeros(1), np.zeros(1))
        for _ in range(round(0.4 / plant.h)):
            plant.step(np.array([0.3]), np.zeros(1))
    assert plants[0].q[0] == pytest.approx(plants[1].q[0], abs=2e-3) and abs(plants[0].q[0]) > 0.05


def test_servo_of_bam_keeps_voltage_to_spare(monkeypatch):
    def largest_share(most: float) -> float:
        """Returns k_p |command - angle| over the stall torque, at its largest in the logs, for a bound of `most`."""
        monkeypatch.setattr(stands, "SPENT", most)
        told = draw_session("bam", "two_link", (), 5, 2, 2.0)
        kp, stall = told.plan.column("kp"), told.plan.column("limit")
        return max(np.max(kp * np.abs(log.commands - log.states[:, 0]) / stall) for log in told.logs)

    assert stands.SPENT < 1.0 and largest_share(0.6) < 0.6 < 0.8 < largest_share(np.inf)


def test_laws_at_known_states():
    plan = plan_of("two_link")
    law = lambda name, **values: JointLaws(plan, {name: values})
    q, v, motor = np.array([0.1, 0.4]), np.array([0.0, 2.0]), np.array([0.0, 3.0])
    pull = law("elastic_coupling@j2", stiffness=0.5).torques(q, v, motor, 0.0, 0.001)
    np.testing.assert_allclose(pull, [0.15, -0.15])
    shake = law("vibration@j1", torque=0.2, frequency=2.0, phase=0.0).torques(q, v, motor, 0.125, 0.001)
    np.testing.assert_allclose(shake, [0.2, 0.0])
    np.testing.assert_allclose(law("load_friction@j2", ratio=0.1).friction(v, motor), [0.0, 0.3])
    slow = law("speed_limit@j2", slowness=0.5).torques(q, v, motor, 0.0, 0.001)
    np.testing.assert_allclose(slow, [0.0, -3.0])  # no torque is left at the speed without load


def test_commands_are_late_held_and_lost():
    plan = plan_of("pendulum")
    late = stands.timing_of({"command_latency": {"delay": 0.02}}, 1)
    channel = stands.Channel(late, np.random.default_rng(0))
    for k in range(10):
        channel.send(0.01 * k, np.array([float(k)]))
    assert channel.delivered(0.09)[0] == 7.0 and channel.delivered(0.005)[0] == 0.0
    channel.timing = stands.timing_of({"command_hold": {"period": 0.04}, "command_latency": {"delay": 0.0}}, 1)
    assert channel.delivered(0.079)[0] == 2.0
    lossy = stands.Channel(stands.timing_of({"packet_loss": {"probability": 1.0}}, 1), np.random.default_rng(0))
    for k in range(3):
        lossy.send(0.01 * k, np.array([float(k)]))
    assert lossy.delivered(1.0)[0] == 0.0 and len(plan.limbs) == 1


def test_session_shows_what_is_hidden_and_repeats():
    one, again = (draw_session("mujoco", "pendulum", ("rotor_inertia",), 7, 2, 1.5) for _ in range(2))
    np.testing.assert_array_equal(one.logs[1].readings, again.logs[1].readings)
    assert one.visible["rotor_inertia@j1"] > 5.0
    nothing = draw_session("mujoco", "pendulum", (), 7, 2, 1.5)
    assert nothing.hidden == {} and not np.array_equal(nothing.logs[1].readings, one.logs[1].readings)


def test_servo_session_states_the_law_of_its_servo():
    told = draw_session("bam", "pendulum", ("load_friction",), 3, 2, 1.0)
    name, law = told.servo.split()
    told_law = servos()[name].laws[law]
    shares = [2.0 * told_law["load"]] if law == "M3" else [told_law[k] for k in ("motor", "external")]
    shares += [told_law.get(f"{k}_stribeck", 0.0) for k in ("motor", "external")]
    assert law in ("M3", "M5", "M6") and told.hidden["load_friction@j1"]["ratio"] == pytest.approx(sum(shares))
    bare = draw_session("bam", "pendulum", ("coulomb_friction",), 3, 2, 1.0)
    assert bare.plan.limbs[0].friction == 0.0 < bare.hidden["coulomb_friction@j1"]["torque"]


# -------------------------------------------------------------------------------------------------------------------------- cases
def test_cases_are_the_seed_s_in_their_shares():
    asked = (200, 5, robot_bench.selected(["robots"]), tuple(robot_cases.FAMILIES))
    cases = robot_cases.draw_cases(*asked)
    assert cases == robot_cases.draw_cases(*asked) != robot_cases.draw_cases(200, 6, *asked[2:])
    assert sum(c.kind == "single" for c in cases) == 104 and sum(c.kind == "none" for c in cases) == 58
    assert {c.family for c in cases if c.generator == "bam"} == {"pendulum", "two_link"}
    per = [sum(c.generator == name for c in cases) for name in asked[2]]
    assert max(per) - min(per) <= 1
    assert all(len(c.effects) == {"single": 1, "pair": 2, "none": 0, "off": 1}[c.kind] for c in cases)


def test_two_cases_are_made_judged_and_kept(tmp_path, monkeypatch, capsys):
    """The search itself is another test's: here it finds nothing."""
    monkeypatch.setattr(robot_cases, "SECONDS", 0.8)
    monkeypatch.setattr(robot_cases, "LOGS", 2)
    asked = []

    def search(place):
        asked.append(place.name)
        files = sorted((place / "logs").glob("*.npz"))
        assert len(files) == 2 and (place / "robot.xml").is_file()
        return {"answer": "AGREES", "said": [], "rivals": [], "by_effect": {}}

    monkeypatch.setattr(robot_bench, "answer_of", search)
    line = ["--generator", "mujoco", "--robots", "pendulum", "--kinds", "none", "--cases", "2", "--seed", "4", "--json"]
    assert bench_command.main([*line, "--out", str(tmp_path)]) == 0
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert told["pooled"]["agrees"]["hits"] == 2 and asked == ["4-0000", "4-0001"]
    before = (tmp_path / "sets" / "4-0000" / "logs" / "log1.npz").read_bytes()
    assert bench_command.main([*line, "--out", str(tmp_path)]) == 0 and len(asked) == 2
    assert (tmp_path / "sets" / "4-0000" / "logs" / "log1.npz").read_bytes() == before
    assert bench_command.main(["--score", str(tmp_path)]) == 0
    with pytest.raises(ConfigError, match="another benchmark"):
        bench_command.main([*line[:4], "--kinds", "single", *line[6:], "--out", str(tmp_path)])


@pytest.mark.slow
def test_real_search_answers_a_drawn_pendulum(tmp_path, monkeypatch):
    monkeypatch.setattr(robot_cases, "SECONDS", 2.0)
    monkeypatch.setattr(robot_cases, "LOGS", 2)
    monkeypatch.setitem(robot_bench.AS_SHIPPED, "null_runs", 16)
    told = robot_cases.make_set(tmp_path, robot_cases.RobotCase("a", "none", "mujoco", "pendulum", (), 12))
    answered = robot_bench.judge_set(tmp_path, robot_bench.DataSet(console.plain(told)))
    assert answered["answer"] in ("AGREES", "NAMED", "CLASS", "UNEXPLAINED"), answered
    assert answered["gates"]["adequacy"] > 0 and len(answered["torque_tolerance"]) == 1 and not answered["broken"]
    again = robot_thresholds.replayed(console.plain(answered), robot_thresholds.SHIPPED._replace(gain=1e9))
    assert again["answer"] in ("AGREES", "UNEXPLAINED") and again["cpu_seconds"] > 0


def test_options_of_fish_do_not_go_with_robots():
    with pytest.raises(ConfigError, match="--power"):
        bench_command.main(["--generator", "robots", "--power", "--out", "x"])
    with pytest.raises(ConfigError, match="needs --out"):
        bench_command.main(["--generator", "mujoco", "--cases", "2"])


# ------------------------------------------------------------------------------------------------------------------------- scores
def row(number: int, kind: str, answer: str, truth=None, said=None, generator: str = "mujoco", **more) -> dict:
    """A row by hand. truth: {name: {parameter: value}}; said: {name: {parameter: [value, low, high]}}."""
    truth, said = truth or {}, said or {}
    out = {"id": str(number), "kind": kind, "answer": answer, "truth": truth, "generator": generator, "family": "pendulum"}
    out |= {"torques": True, "joints": 1, "visible": dict.fromkeys(truth, 9.0), "rivals": [], "warnings": [], "cpu_seconds": 1.0}
    return out | {"said": [{"name": n, "p_best": 1.0, "values": v} for n, v in said.items()]} | more


FRICTION = {"coulomb_friction@j1": {"torque": 0.1}}
SAID = {"coulomb_friction@j1": {"torque": [0.11, 0.09, 0.12]}}


def test_figures_of_rows_by_hand():
    rows = [
        row(1, "single", "NAMED", FRICTION, SAID),
        row(2, "single", "NAMED", FRICTION, {"coulomb_friction@j2": {"torque": [0.1, 0.0, 0.2]}}),
        row(3, "single", "CLASS", FRICTION, {"viscous_friction@j1": {}}, rivals=["coulomb_friction@j1"]),
        row(4, "single", "NAMED", FRICTION, SAID, visible={"coulomb_friction@j1": 2.0}),
        row(5, "none", "AGREES"),
        row(6, "none", "NAMED", {}, SAID),
        row(7, "off", "NAMED", {"vibration@j1": {"torque": 1.0}}, SAID),
        row(8, "off", "UNEXPLAINED", {"vibration@j1": {"torque": 1.0}}),
        row(9, "single", "NOT_SEARCHED", FRICTION),
    ]
    found = figures(rows)
    hits = lambda key: (found[key]["hits"], found[key]["n"])
    assert hits("precision") == (1, 2) and hits("precision_of_kind") == (2, 2) and hits("coverage") == (1, 3)
    assert hits("listed") == (2, 3) and hits("nulls_named") == (1, 2) and hits("agrees") == (1, 2)
    assert hits("misnamed_outside") == (1, 2) and hits("intervals_hold") == (1, 1) and found["not_searched"] == 1
    assert found["value_error_median"]["value"] == pytest.approx(0.1)


def test_an_effect_that_is_the_same_on_a_robot_stands_for_the_hidden_one():
    late = row(1, "single", "NAMED", {"command_latency": {"delay": 0.02}}, {"joint_sensor_delay": {}})
    assert not is_right(late)
    late["said"][0]["same"] = {"command_latency": {"delay": 0.021}}
    assert is_right(late) and not is_right(late | {"truth": {"command_hold": {"period": 0.03}}})
    assert not is_right(late | {"truth": FRICTION | late["truth"]})
    found = figures([late, row(2, "single", "NAMED", FRICTION, SAID), row(3, "pair", "NAMED", late["truth"] | FRICTION, SAID)])
    assert [found[key]["hits"] for key in ("precision", "coverage", "coverage_alone", "pairs_both_found")] == [2, 2, 1, 0]
    both = row(3, "pair", "NAMED", late["truth"] | FRICTION, SAID)
    both["said"].append(late["said"][0])
    assert figures([both])["pairs_both_found"]["hits"] == 1 and figures([both])["pairs_phantom"]["hits"] == 0


def test_errors_of_a_vector_and_of_a_rate():
    truth = {"com_offset@b1": {"x": 0.03, "y": 0.0, "z": 0.04}}
    said = {"com_offset@b1": {"x": [0.03, 0, 1], "y": [0.0, 0, 1], "z": [0.05, 0, 1]}}
    assert relative_errors(row(1, "single", "NAMED", truth, said)) == [pytest.approx(0.2)]
    drift = row(1, "single", "NAMED", {"clock_drift": {"rate": 1.002}}, {"clock_drift": {"rate": [1.0021, 1, 2]}})
    assert relative_errors(drift) == [pytest.approx(0.05)]


def test_effect_that_no_catalogue_lists_is_outside_it(monkeypatch):
    from fishmj import effects

    case = row(1, "single", "NAMED", FRICTION, SAID)
    assert kind_of(case) == "single"
    monkeypatch.setattr(effects, "robot_catalogue", dict)
    assert kind_of(case) == "off"


def test_median_has_bounds_of_order_statistics():
    found = median_with_bounds([float(k) for k in range(1, 101)])
    assert found == {"value": 50.5, "low": 40.0, "high": 61.0, "n": 100}


GATES = {
    "adequacy": 5.0,
    "gain": 900.0,
    "closure": 0.8,
    "rest": 1.0,
    "transfer": 1.0,
    "strain": 0.0,
    "size": 0.1,
    "pinned": False,
}
GATES |= {"torques": {"j1": [1.0, 0.4]}, "floors": 1.2}
SEARCHED = {
    "gates": GATES,
    "steps": [{"gain": 300.0, "accepted": True}],
    "torque_tolerance": [0.1],
    "standing": [],
    "tentative": [],
}


def test_a_servos_own_friction_lies_within_the_catalogue():
    """A speed beyond its bound is Coulomb friction to the search: the law of every hobby servo was named as that."""
    speed = next(p for p in effects.robot_catalogue()["stribeck"].robot.parameters if p.name == "speed")
    known = [law["speed"] for servo in servos().values() for law in servo.laws.values() if "speed" in law]
    assert len(known) > 12 and all(speed.low < value < speed.high for value in known)
    usual = thresholds().fit.prior_sd * max(abs(t - speed.null) for t in speed.typical)
    assert np.median(known) < speed.null + usual < speed.high


def test_answers_are_replayed_under_other_thresholds():
    shipped, again = robot_thresholds.SHIPPED, robot_thresholds.replayed
    named = row(1, "single", "NAMED", FRICTION, SAID, **SEARCHED)
    assert again(named, shipped)["answer"] == "NAMED"
    assert again(named, shipped._replace(gain=400.0))["answer"] == "UNEXPLAINED"
    quiet = row(1, "none", "NAMED", {}, SAID, **SEARCHED) | {"gates": GATES | {"adequacy": 1.1, "torques": {"j1": [0.2, 0.1]}}}
    assert again(quiet, shipped._replace(gain=400.0))["answer"] == "AGREES"
    assert again(named, shipped._replace(closure=0.9))["answer"] == "NAMED"  # hardly any rest is left
    assert again(named, shipped._replace(share=0.1))["answer"] == "UNEXPLAINED"
    assert again(named, shipped._replace(floors=1.0))["answer"] == "UNEXPLAINED"
    strained = named | {"gates": GATES | {"strain": 50.0}, "answer": "UNEXPLAINED"}
    assert again(strained, shipped._replace(excess=100.0))["answer"] == "NAMED"
    other = named | {"answer": "UNEXPLAINED"}  # by a gate that is not replayed
    assert again(other, shipped._replace(excess=100.0))["answer"] == "UNEXPLAINED"
    torn = named | {"said": [{"name": "coulomb_friction@j1", "p_best": 0.85, "values": {}}], "answer": "CLASS"}
    assert again(torn, shipped._replace(p_best=0.8))["answer"] == "NAMED"


def test_thresholds_never_see_the_generator_that_they_score():
    """The others' strained rows are right, so their threshold opens; the ones left out are wrong, and pay for it."""
    strained = SEARCHED | {"gates": GATES | {"strain": 50.0}}
    right = [row(k, "single", "UNEXPLAINED", FRICTION, SAID, "bam", **strained) for k in range(4)]
    wrong = [row(k, "single", "UNEXPLAINED", {"servo_gain@j1": {"gain": 0.1}}, SAID, "mujoco", **strained) for k in range(4, 8)]
    apart, left = leave_one_out([*right, *wrong])
    assert apart["mujoco"]["thresholds"]["excess"] > 50.0 and apart["bam"]["thresholds"]["excess"] <= 50.0
    assert figures(left)["precision"]["hits"] == 0 and figures(left)["precision"]["n"] == 4
