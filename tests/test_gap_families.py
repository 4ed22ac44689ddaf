"""The benchmark over families: what is drawn, how machines share it, how it is scored, and that a case is the same twice."""

import json
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fishmj import effects
from fishmj.base import console
from fishmj.base.errors import ConfigError, SimDiverged, UsageError
from fishmj.gap.bench import (
    bench_command,
    calibrated,
    drawn_robots,
    families,
    family_command,
    family_rows,
    family_score,
    robot_bench,
)
from fishmj.gap.bench.bench_rows import keep
from fishmj.gap.bench.cases import KINDS, BenchCase
from fishmj.gap.bench.drawn_robots import BenchRobot, robots
from fishmj.gap.laboratory.generators import detectability
from fishmj.gap.laboratory.virtual_robot.robot_constants import buildable
from fishmj.log import excitation
from fishmj.mjcf.reading import load_robot

ALL = families.NAMES


# ------------------------------------------------------------ what is drawn
def test_a_seed_is_one_benchmark_and_more_cases_keep_the_earlier():
    few, many = robots(60, 3, ALL, KINDS), robots(240, 3, ALL, KINDS)
    assert robots(60, 3, ALL, KINDS) == few
    assert sum(len(robot.cases) for robot in few) == 60
    assert many[: len(few) - 1] == few[:-1] and many[len(few) - 1].cases[: len(few[-1].cases)] == few[-1].cases
    assert robots(60, 4, ALL, KINDS)[0].cases[1].effects != few[0].cases[1].effects


def test_robots_carry_cases_of_all_kinds_in_their_shares():
    dealt = robots(1140, 0, ALL, KINDS)
    kinds = [case.kind for robot in dealt for case in robot.cases]
    assert [kinds.count(kind) for kind in ("none", "single", "pair", "off")] == [200, 600, 200, 140]
    for family in ALL:
        mine = [robot for robot in dealt if robot.family == family]
        assert len(mine) == 50 and sum(robot.drawn for robot in mine) == 25
    assert len({robot.seed for robot in dealt}) == len(dealt)
    ids = [case.id for robot in dealt for case in robot.cases]
    assert len(set(ids)) == len(ids) == 1140


def test_what_is_hidden_is_of_the_family_and_of_its_kind():
    for robot in robots(400, 1, ALL, KINDS):
        pool = families.pool(robot.family)
        for case in robot.cases:
            source = pool.off if case.kind == "off" else pool.catalogued
            assert len(case.effects) == {"none": 0, "single": 1, "pair": 2, "off": 1}[case.kind]
            assert set(case.effects) <= set(source)
            assert len(case.logs) == len(set(case.logs)) == drawn_robots.LOGS and set(case.logs) <= set(excitation.DESIGNED)
            assert case.logs == robot.cases[0].logs  # null runs are made once a robot


def test_every_effect_comes_up_before_one_comes_up_twice():
    dealt = [next(iter(c.effects)) for r in robots(900, 5, ("foil",), {"single": 1.0}) for c in r.cases]
    many = len(families.pool("foil").catalogued)
    assert len(set(dealt[:many])) == many and len(dealt) > many


def test_what_cannot_be_seen_is_searched_in_one_of_three():
    dealt = [case for robot in robots(600, 5, ALL, KINDS) for case in robot.cases]
    weak = [drawn_robots.is_searched(case, dict.fromkeys(case.effects, 4.9)) for case in dealt if case.kind in ("single", "pair")]
    assert 0.26 < np.mean(weak) < 0.41
    assert all(drawn_robots.is_searched(case, dict.fromkeys(case.effects, 5.1)) for case in dealt)
    assert all(drawn_robots.is_searched(case, dict.fromkeys(case.effects, 0.0)) for case in dealt if case.kind in ("none", "off"))
    pair = next(case for case in dealt if case.kind == "pair" and not drawn_robots.is_searched(case, {"a": 0.0, "b": 0.0}))
    assert not drawn_robots.is_searched(pair, {"a": 50.0, "b": 1.0})


def test_only_effects_that_change_the_mean_are_named_for():
    for family in ALL:
        assert not any(effects.get(name).stochastic for name in families.pool(family).catalogued)
        assert not set(families.pool(family).off) & set(effects.catalogue())


def test_shards_are_disjoint_and_complete_and_keep_a_robot_together():
    asked = {"cases": 240, "seed": 2, "kinds": KINDS, "logs": None, "small": False, "effects": None, "power": False}
    parts = [family_command.draw_cases(SimpleNamespace(**asked, shard=(i, 4)), ALL) for i in range(4)]
    whole = family_command.draw_cases(SimpleNamespace(**asked, shard=(0, 1)), ALL)
    ids = [case.id for part in parts for robot in part for case in robot.cases]
    assert len(set(ids)) == len(ids) == 240 and set(ids) == {case.id for robot in whole for case in robot.cases}
    assert sum(map(len, parts)) == len(whole) and all(robot in whole for part in parts for robot in part)  # none is cut in two
    assert all(len({robot.family for robot in part}) > 1 for part in parts)  # no machine has one water only


def test_a_drawn_chain_is_a_fish_that_the_search_takes_and_that_swims():
    found = [drawn_robots.chain(np.random.default_rng(k), f"chain{k}") for k in range(30)]
    assert {len(robot.links) for robot in found} == {2, 3, 4, 5, 6}
    for robot in found:
        buildable(load_robot(robot))
        assert 0.4 < robot.length < 0.76 and robot.servo.torque <= 3.5
    assert len({robot.servo.torque for robot in found}) == len(found)


def test_a_chain_that_hardly_swims_is_drawn_again_and_counted(monkeypatch):
    speeds = iter([0.01, SimDiverged("it left the finite numbers"), 0.049, 0.3])

    def swum(family, seed, robot):
        speed = next(speeds)
        if isinstance(speed, Exception):
            raise speed
        return speed

    monkeypatch.setattr(families, "lengths_a_second", swum)
    one = BenchRobot("foil-0-0001", "foil", True, 5, ())
    found = drawn_robots.describe_robot(one)
    assert (found.redraws, found.speed) == (3, 0.3)
    rng = np.random.default_rng([5, 15])
    assert [drawn_robots.chain(rng, one.id) for _ in range(4)][-1] == found.robot
    monkeypatch.setattr(families, "lengths_a_second", lambda *given: 0.0)
    assert drawn_robots.describe_robot(one._replace(drawn=False)).redraws == 0  # the shipped fish is what it is
    with pytest.raises(ConfigError, match="foil-0-0001.*swims 0.05"):
        drawn_robots.describe_robot(one)


def test_calibration_swims_none_of_the_experiments_that_are_searched():
    robot = load_robot("fish")
    calibrating = families.runs_of(calibrated.SWIMS, robot)
    for name in excitation.DESIGNED:
        for run in calibrating:
            searched = excitation.get(name)
            rows = min(len(run.commands), len(searched.commands))
            moved = (
                np.abs(run.commands[:rows] - searched.commands[:rows]).max() + np.abs(np.subtract(run.push, searched.push)).max()
            )
            assert run.id != name and moved > 0.02, (run.id, name)


def test_trials_of_one_robot_differ_in_noise_by_their_number():
    robot, seen = load_robot("fish"), {}
    for family in ("morison", families.SECOND):
        for first in (0, 7):
            seen[family, first] = families.trials(family, {}, ["idle"], 3, robot, first=first)[0].table("pose")["x"]
        again = families.trials(family, {}, ["idle"], 3, robot)[0].table("pose")["x"]
        assert np.array_equal(seen[family, 0], again) and not np.array_equal(seen[family, 0], seen[family, 7])


# ------------------------------------------------------------ how much shows
def test_detectable_of_the_second_robot_is_the_generators_measure():
    short = excitation.Excitation(id="short", commands=excitation.gait(1.0, 0.4, 1.0, seconds=2.0), about="a short gait")
    robot, runs = load_robot("fish"), [short]
    late = {"command_latency": {"delay": 0.05}}
    found = families.detectable(families.SECOND, late, runs, 4, robot)
    assert found["all"] > detectability.BOUND and found["noise_only"] > found["all"] == found["each"]["command_latency"]
    weak = families.detectable(families.SECOND, {"command_latency": {"delay": 0.005}}, runs, 4, robot)
    assert weak["all"] < 0.1 * found["all"]
    assert families.detectable(families.SECOND, {}, runs, 4, robot)["all"] == 0.0
    assert set(found) == set(families.detectable("morison", late, runs, 4, robot))
    longer = next(one for one in (drawn_robots.chain(np.random.default_rng(k), "longer") for k in range(20)) if one.n_joints > 3)
    assert families.detectable(families.SECOND, late, runs, 4, longer)["all"] > detectability.BOUND


# ------------------------------------------------------------ the score
def row(kind, answer, truth=(), said=(), family="foil", detectable=9.0, **more):
    hidden = {name: {"delay": 0.05} for name in truth}
    told = [{"name": name, "p_best": 1.0, "values": {"delay": [0.05, 0.04, 0.06]}} for name in said]
    each = dict.fromkeys(hidden, detectable)
    number = next(NUMBERS)
    made = {
        "id": f"{family}-{number}",
        "robot": f"{family}-{number}",
        "family": family,
        "seed": 1,
        "kind": kind,
        "answer": answer,
    }
    made |= {"truth": hidden, "said": told, "rivals": [], "detectable": detectable, "noise_only": detectable, "experiments": []}
    made["model"] = "fish"
    return made | {"each_detectable": each, "calibrated": None, "redraws": 0, "seconds": 1.0} | more


NUMBERS = iter(range(10_000))
LATE, SLOW = "command_latency", "camera_latency"


def test_a_phantom_beside_the_right_name_is_wrong():
    rows = [row("single", "NAMED", [LATE], [LATE]), row("single", "NAMED", [LATE], [LATE, SLOW])]
    rows += [row("single", "AGREES", [LATE]), row("single", "NAMED", [LATE], [SLOW], detectable=0.5)]
    found = family_score.figures(rows)
    assert (found["precision"]["hits"], found["precision"]["n"]) == (1, 2)
    assert (found["coverage"]["hits"], found["coverage"]["n"]) == (1, 3)  # what cannot be seen is not asked for
    assert (found["phantoms"]["hits"], found["phantoms"]["n"]) == (2, 3)  # but a phantom in it is one
    assert found["agrees_though_detectable"]["hits"] == 1
    assert (found["intervals_hold"]["hits"], found["value_error_median"]) == (1, 0.0)


def test_the_old_definition_stands_beside():
    rows = [row("single", "NAMED", [LATE], [LATE]), row("single", "AGREES", [LATE], detectable=1.0, noise_only=30.0)]
    found = family_score.figures(rows)
    assert found["coverage"]["n"] == 1 and found["coverage_old_definition"] == family_score.share(1, 2)


def test_false_alarms_are_names_and_classes():
    rows = [row("none", answer) for answer in ("AGREES", "AGREES", "UNEXPLAINED", "CLASS", "NAMED", "REFUSED")]
    found = family_score.figures(rows)
    assert found["false_alarms"]["hits"] == 2 and found["agrees"]["hits"] == 2 and found["agrees"]["n"] == 6
    assert found["refused"] == 1


def test_pairs_count_where_either_alone_could_be_seen():
    rows = [row("pair", "NAMED", [LATE, SLOW], [SLOW, LATE]), row("pair", "NAMED", [LATE, SLOW], [LATE])]
    rows += [row("pair", "NAMED", [LATE, SLOW], [LATE], each_detectable={LATE: 9.0, SLOW: 1.0})]
    found = family_score.figures(rows)
    assert (found["pairs_both_found"]["hits"], found["pairs_both_found"]["n"]) == (1, 2)
    assert (found["pairs_one_found"]["hits"], found["pairs_one_found"]["n"]) == (3, 3)


def test_what_cannot_swim_or_was_not_searched_is_counted_and_left_out():
    rows = [row("none", "AGREES"), row("single", "DIVERGED", [LATE]), row("single", "NOT_SEARCHED", [LATE], detectable=1.0)]
    found = family_score.figures(rows)
    assert (found["n"], found["diverged"], found["not_searched"]) == (1, 1, 1)
    assert found["coverage"]["n"] == found["coverage_old_definition"]["n"] == 0


def many(**answers):
    """Rows that meet every aim, but for what is given: kind -> [answers]."""
    good = {
        "none": ["AGREES"] * 100,
        "off": ["UNEXPLAINED"] * 40,
        "single": [[LATE]] * 90 + [()] * 10,
        "pair": [[LATE, SLOW]] * 30,
    }
    out = []
    for kind, given in (good | answers).items():
        truth = {"single": [LATE], "pair": [LATE, SLOW], "off": ["weed"]}.get(kind, [])
        for said in given:
            answer = said if isinstance(said, str) else "NAMED" if said else "AGREES"
            out.append(row(kind, answer, truth, said if isinstance(said, list) else (), family=("foil", "morison")[len(out) % 2]))
    for i, one in enumerate(r for r in out if r["kind"] == "single" and r["said"]):  # one interval of ten does not hold
        one["said"][0]["values"]["delay"] = [0.05, 0.04, 0.06] if i % 10 else [0.05, 0.051, 0.06]
    return out


def missed(rows):
    return [aim["aim"] for aim in family_score.score(rows)["aims"] if aim["met"] is False]


def test_the_aims():
    assert missed(many()) == []
    assert missed(many(none=["AGREES"] * 97 + ["NAMED"] * 3)) == ["false_alarms"]
    assert missed(many(none=["AGREES"] * 79 + ["UNEXPLAINED"] * 21)) == ["agrees"]
    assert missed(many(single=[[LATE]] * 85 + [[LATE, SLOW]] * 5 + [()] * 10)) == ["precision"]
    assert missed(many(single=[[LATE]] * 70 + [()] * 30)) == ["coverage"]
    assert missed(many(off=["UNEXPLAINED"] * 36 + ["NAMED"] * 4)) == ["misnamed_off_catalogue"]
    assert missed(many(pair=[[LATE]] * 20 + [[LATE, SLOW]] * 10)) == ["pairs_both_found"]
    assert missed([r for r in many() if r["kind"] == "none"]) == []  # of what was not asked nothing is said


def test_families_are_told_apart_and_small_numbers_are_said():
    result = family_score.score(many())
    assert set(result["families"]) == {"foil", "morison"} and result["models"] == {"fish": result["pooled"]}
    assert sum(f["agrees"]["n"] for f in result["families"].values()) == result["pooled"]["agrees"]["n"] == 100
    text = "\n".join(family_score.report_lines(result))
    assert "100 of 200 none" in text and "aim >= 80%: met" in text and "foil 15 pairs" in text


# ------------------------------------------------------------ the command
def kept(folder, rows):
    folder.mkdir()
    (folder / "rows.jsonl").write_text("".join(json.dumps(console.plain(one)) + "\n" for one in rows))
    return str(folder)


def test_rows_of_several_machines_are_scored_together(tmp_path, capsys):
    rows = many()
    one, two = kept(tmp_path / "a", rows[:150]), kept(tmp_path / "b", rows[100:])
    assert bench_command.main(["--score", one, two, "--json", "--out", str(tmp_path / "sum")]) == console.OK
    result = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert result["pooled"]["n"] == len(rows)  # a case that two machines did counts once
    assert json.loads((tmp_path / "sum" / "score.json").read_text())["pooled"] == result["pooled"]
    bad = kept(tmp_path / "c", many(none=["NAMED"] * 9))
    assert bench_command.main(["--score", bad]) == console.FAILED_CHECK
    assert bench_command.main(["--score", bad, "--small"]) == console.OK
    assert bench_command.main(["--score", bad, "--small", "--strict"]) == console.FAILED_CHECK


@pytest.mark.parametrize("generator", ["families", "robots"])
def test_a_case_of_another_processor_is_the_same_case(generator, tmp_path, monkeypatch):
    """NumPy's exp differs in the last digit between instruction sets."""
    here = {"id": "a", "kind": "single", "seed": 3, "truth": {"yaw_drag": {"coefficient": 0.3}}, "answer": "AGREES"}
    here |= {"family": "foil", "experiments": ["gait"]} if generator == "families" else {"generator": "mujoco"}
    judged, printed = (family_command, "print_rows") if generator == "families" else (robot_bench, "print_score")
    monkeypatch.setattr(judged, printed, lambda *given: len(next(rows for rows in given if isinstance(rows, list))))

    def scored(*sizes: float) -> int:
        rows = [here | {"truth": {"yaw_drag": {"coefficient": size}}} for size in sizes]
        folders = [Path(kept(tmp_path / f"{sizes[1]}-{i}", [one])) for i, one in enumerate(rows)]
        return judged.together(folders, SimpleNamespace(small=False, strict=False))

    assert scored(0.3, float(np.nextafter(0.3, 1.0))) == 1
    with pytest.raises(ConfigError, match="another case elsewhere"):
        scored(0.3, 0.3001)


def test_scores_of_nothing_of_another_benchmark_and_of_two_are_refused(tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(ConfigError, match="no rows.jsonl"):
        bench_command.main(["--score", str(tmp_path / "empty")])
    old = kept(tmp_path / "old", [{"id": "3-0001", "kind": "none", "answer": "AGREES"}])
    with pytest.raises(ConfigError, match="row 3-0001 is of another benchmark"):
        bench_command.main(["--score", old])
    first = row("none", "AGREES")
    one, two = kept(tmp_path / "one", [first]), kept(tmp_path / "two", [first | {"experiments": ["gait"]}])
    with pytest.raises(ConfigError, match="another case elsewhere"):
        bench_command.main(["--score", one, two])


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["--generator", "morison,lbm"], "lbm is scored alone"),
        (["--generator", "second,log"], "scored alone"),
        (["--generator", "foil", "--model", "tendon_fish"], "--model is for --generator second"),
        (["--generator", "families", "--baselines"], "--baselines is for --generator second"),
        (["--uncalibrated"], "--uncalibrated goes with --generator morison"),
        (["--logs", "6", "--generator", "lbm"], "--logs goes with"),
        (["--generator", "foil", "--cases", "2", "--shard", "3/4"], "no robot is left"),
    ],
)
def test_what_does_not_go_together_is_refused(argv, words):
    with pytest.raises(ConfigError, match=words):
        bench_command.main(argv)


def test_a_family_that_there_is_none_of_is_refused():
    with pytest.raises(UsageError, match="'morrison'.*Did you mean 'morison'"):
        bench_command.main(["--generator", "morrison"])


def test_families_stand_for_all_of_them():
    assert family_command.selected_families(["families"]) == ALL and family_command.selected_families(["foil", "morison"]) == (
        "morison",
        "foil",
    )
    assert family_command.selected_families(["second"]) == ()


def test_what_is_done_is_not_done_again(tmp_path, monkeypatch):
    args = dict(out=tmp_path, uncalibrated=True, weighed=False)
    todo, seen = robots(9, 3, ("foil",), KINDS), []

    def answer(asked):
        seen.extend(case.id for case in asked.robot.cases)
        return [{"id": case.id} for case in asked.robot.cases]

    monkeypatch.setattr(family_rows, "rows", answer)
    monkeypatch.setattr(family_command, "precompile", lambda names: None)
    ids = [case.id for robot in todo for case in robot.cases]
    kept = console.plain(family_rows.case_facts(todo[0].cases[2], family_rows.RobotQuery(todo[0], calibrate=False))) | {
        "kept": True
    }
    rows = family_command.judge_robots(todo, SimpleNamespace(**args), {ids[2]: kept}, 1)
    assert [one["id"] for one in rows] == ids and rows[2]["kept"] and seen == [*ids[:2], *ids[3:]]
    for key, value in (("as_described", False), ("experiments", ["gait"]), ("weighed", True)):
        with pytest.raises(ConfigError, match=f"another benchmark: row {ids[2]} differs in {key}"):
            family_command.judge_robots(todo, SimpleNamespace(**args), {ids[2]: kept | {key: value}}, 1)


def test_processes_that_write_at_once_lose_no_row(tmp_path):
    path, long = tmp_path / "rows.jsonl", "x" * 30_000

    def write(writer):
        for k in range(40):
            keep(path, {"id": f"{writer}-{k}", "long": long})

    with ThreadPoolExecutor(6) as pool:
        list(pool.map(write, range(6)))
    rows = family_command.finished_rows(tmp_path)
    assert set(rows) == {f"{writer}-{k}" for writer in range(6) for k in range(40)}
    assert all(row["long"] == long for row in rows.values())


def test_the_bar_follows_what_others_write():
    looks = []
    with family_command.call_repeatedly(lambda: looks.append(1), every=0.01):
        time.sleep(0.2)
    seen = len(looks)
    time.sleep(0.05)
    assert seen > 2 and len(looks) == seen


def test_a_robot_that_cannot_be_calibrated_says_so_in_every_row(tmp_path, monkeypatch):
    one = robots(4, 3, ("foil",), KINDS)[0]
    monkeypatch.setattr(drawn_robots, "DRAWS", 1)
    monkeypatch.setattr(drawn_robots, "SLOWEST", 1e9)
    rows = family_rows.rows(family_rows.RobotQuery(one._replace(drawn=True), out=tmp_path))
    assert [r["answer"] for r in rows] == ["REFUSED"] * len(one.cases) and "swims" in rows[0]["reason"]
    assert len((tmp_path / "rows.jsonl").read_text().splitlines()) == len(rows)
    assert family_score.figures(rows)["refused"] == len(rows)


@pytest.mark.slow
def test_a_case_is_the_same_twice_and_its_calibration_is_kept(tmp_path, monkeypatch):
    monkeypatch.setenv("FISHMJ_CACHE", str(tmp_path))
    monkeypatch.setattr(calibrated, "SWIMS", ("gait_small", "turn_right", "tow_ahead", "tow_sideways"))
    late = BenchCase("morison-0-0000-0", "single", {"command_latency": {"delay": 0.06}}, 1.0, ("gait_fast", "tow_oblique"), 8)
    one = family_rows.RobotQuery(BenchRobot("morison-0-0000", "morison", False, 8, (late,)))
    (first,), (second,) = family_rows.rows(one), family_rows.rows(one)
    still = lambda row: {key: value for key, value in row.items() if "seconds" not in key}
    assert still(first) == still(second)
    assert len(list((tmp_path / "bench").glob("*.json"))) == 1 and second["robot_cpu_seconds"] < first["robot_cpu_seconds"]
    assert first["detectable"] > family_score.BOUND and first["answer"] in ANSWERS
    known, model, own, facts = family_rows.questioned_model(one._replace(calibrate=False))
    assert own is None and facts["calibrated"] is None and model.robot == known == load_robot("fish")
    assert 0.0 < first["calibrated"]["value"] < 0.5 and family_score.score([first])["pooled"]["coverage"]["n"] == 1


ANSWERS = {"AGREES", "NAMED", "CLASS", "UNEXPLAINED", "NOT_REPEATABLE"}
