"""A policy's card: made from judgements of its own weights, read back, shown; its worst trial can be swum again."""

import csv
import json
import shlex

import pytest
from policy_files import header, stored

from fishmj import cli
from fishmj.base.errors import ConfigError, StoreError
from fishmj.base.store import read_json, sha256
from fishmj.control.policy import FOLDER, Policy, file_of, shipped
from fishmj.evaluate.policy_card import POINTS, card_path, make_card, read_card, waters_of
from fishmj.evaluate.policy_command import _judged, comparison
from fishmj.water.choice import family_of

TRIALS = "--water structured --engine compiled --speeds 0.1,0.3 --los 0,180 --repeats 2 --duration 31".split()


@pytest.fixture(scope="module")
def judged(tmp_path_factory):
    """(copy of `paper` with a header of its own, folder in which it and `drift` were judged)"""
    folder = tmp_path_factory.mktemp("card")
    policy = Policy.load("paper")
    path = Policy(policy.weights, policy.meta | {"seed": 7}).save(folder / "mine.safetensors")
    assert cli.main(["evaluate", str(path), "drift", *TRIALS, "--out", str(folder / "judged")]) == 0
    return path, folder / "judged"


def test_every_shipped_policy_has_a_card_of_its_weights():
    assert {path.name for path in FOLDER.glob("*.card.json")} == {f"{name}.card.json" for name in shipped()}
    for name in shipped():
        card = read_card(name)
        assert card.sha256 == sha256(file_of(name)) and len(card.judged) >= 5
        assert all(judgement.command.startswith("fishmj evaluate ") for judgement in card.judged)
        assert all(judgement.worst.replay.startswith(f"fishmj evaluate {name} ") for judgement in card.judged)


def test_command_writes_a_card_from_its_judgements(judged, capsys):
    path, folder = judged
    assert cli.main(["policy", str(path), "--judged", str(folder), "--json"]) == 0
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    card = read_card(path)
    assert told["card"] == str(card_path(path)) and told["sha256"] == card.sha256 == sha256(path)
    found = next(row for row in read_json(folder / "results.json")["results"] if row["policy_sha256"])
    (row,) = card.judged
    assert row.n == 8 and row.water["name"] == "structured" and card.training["seed"] == 7
    assert row.overall["rmse_after_arrival"].value == found["overall"]["rmse_after_arrival"]["value"]
    assert cli.main(["policy", str(path)]) == 0
    shown = capsys.readouterr().out
    assert row.overall["rmse_after_arrival"].text() in shown and row.worst.replay in shown and row.arrived in shown


def test_worst_trial_is_the_largest_and_its_command_swims_it_again(judged, tmp_path, monkeypatch):
    path, folder = judged
    rows = list(csv.DictReader((folder / "trials.csv").read_text().splitlines()))
    after = [float(row["rmse_after_arrival"]) for row in rows if row["controller"] == "mine"]
    found = next(row["worst"] for row in read_json(folder / "results.json")["results"] if row["controller"] == "mine")
    assert found["rmse_after_arrival"] == pytest.approx(max(after), rel=1e-5) and len(after) == 8
    monkeypatch.chdir(tmp_path)
    assert cli.main(shlex.split(found["replay"])[1:]) == 0
    (again,) = read_json(tmp_path / "runs" / "worst_mine" / "results.json")["results"]
    assert again["worst"]["trial"] == found["trial"] and (tmp_path / "runs" / "worst_mine" / "worst.html").is_file()
    assert again["worst"]["rmse_after_arrival"] == pytest.approx(found["rmse_after_arrival"], rel=1e-4)


def test_card_says_how_many_trials_do_not_hold_at_each_speed(judged):
    path, folder = judged
    found = read_json(folder / "results.json")
    mine = next(row for row in found["results"] if row["controller"] == "mine")
    trials = [row for row in csv.DictReader((folder / "trials.csv").read_text().splitlines()) if row["controller"] == "mine"]
    near = lambda row: float(row["arrival"]) > 0 and float(row["rmse_after_arrival"]) <= 0.1
    assert mine["held_by_speed"] == {u: sum(near(row) for row in trials if row["speed"] == u) for u in ("0.1", "0.3")}
    assert sum(mine["held_by_speed"].values()) == mine["held"]

    def lost(held, by_speed):
        mine["held"], mine["held_by_speed"] = held, by_speed
        judgement = make_card(path, [found]).judged[0]
        return judgement.lost(), _judged(judgement)["do not hold"]

    assert lost(8, {"0.1": 4, "0.3": 4}) == ({}, "none")
    assert lost(7, {"0.1": 4, "0.3": 3}) == ({"0.3": (1, 4)}, "0.3 m/s: 1 of 4")
    assert lost(2, {"0.1": 2, "0.3": 0})[1] == "0.1 m/s: 2 of 4, 0.3 m/s: 4 of 4"
    assert lost(7, None) == ({"": (1, 8)}, "1 of 8"), "a judgement by an older fishmj"
    assert lost(8, None)[1] == "none" and lost(None, None)[1] == "not judged"


def test_effects_of_a_training_stand_on_the_card_and_are_drawn_on_demand(tmp_path, capsys):
    path = stored(tmp_path, header(task={"effects": ["coulomb_friction", "tether"]}))
    assert cli.main(["policy", path]) == 0
    assert "effects drawn: coulomb_friction, tether\n" in capsys.readouterr().out
    note, drawn = "effects drawn: coulomb_friction, tether; here none", ["--randomise-effects", "tether,coulomb_friction"]
    short = "--water structured --engine planar --speeds 0.2 --los 0 --repeats 1 --duration 1".split()
    judge = lambda name, *more: cli.main(["evaluate", path, "dob", *short, *more, "--out", str(tmp_path / name)])
    read = lambda name: read_json(tmp_path / name / "results.json")
    assert judge("plain") == 0
    out, err = capsys.readouterr()
    assert f"policy mine: not as trained: {note}\n" in err and f"mine is not judged as trained: {note}" in out
    assert "effects drawn" in read("plain")["results"][0]["policy"]["differs"] and read("plain")["results"][1]["policy"] is None
    assert judge("drawn", *drawn) == 0
    assert "not as trained" not in capsys.readouterr().err
    assert "effects tether, coulomb_friction drawn" in read("drawn")["condition"]
    power = lambda name: read(name)["results"][1]["overall"]["power"]["value"]
    assert power("drawn") != power("plain"), "the effects act"
    assert judge("none", *drawn, "--no-randomisation") == 2 and "leave one of them out" in capsys.readouterr().err
    assert judge("none", "--randomise-effects", "nothing") == 2


def test_judgement_of_other_weights_makes_no_card(judged):
    path, folder = judged
    with pytest.raises(ConfigError, match=rf"judges mine {sha256(path)[:12]}"):
        make_card("station", [read_json(folder / "results.json")])


@pytest.mark.parametrize("wrong", [{}, [], {"results": [{"controller": "mine"}]}, {"results": 3}])
def test_file_that_is_no_judgement_makes_no_card(wrong):
    with pytest.raises(ConfigError, match=r"results\.json"):
        make_card("station", [wrong])


def test_card_of_other_weights_is_refused(judged, tmp_path):
    path, folder = judged
    policy = Policy.load("paper")
    other = Policy(policy.weights, policy.meta | {"seed": 8}).save(tmp_path / "other.safetensors")
    card_path(other).write_text(json.dumps(make_card(path, [read_json(folder / "results.json")]).plain()))
    with pytest.raises(ConfigError, match="of the weights"):
        read_card(other)
    card_path(other).write_text('{"schema": "fishmj.policy-card/2"}')
    with pytest.raises(ConfigError, match="card: schema"):
        read_card(other)
    card_path(other).write_text("{")
    with pytest.raises(StoreError):
        read_card(other)
    card_path(other).unlink()
    assert read_card(other).judged == [] and read_card(other).training["seed"] == 8


def test_curve_of_a_training_is_thinned_to_its_ends(tmp_path):
    rows = [{"step": 100 * k, "seconds": 0.1 * k, "reward": k / 100, "late_distance": 1 - k / 100} for k in range(100)]
    (tmp_path / "metrics.jsonl").write_text("\n".join(map(json.dumps, [*rows, {"step": 9900, "tune_return": 3.0}])))
    curve = make_card("station", (), tmp_path / "metrics.jsonl").curve
    assert len(curve) == POINTS and curve[0] == rows[0] and curve[-1] == rows[-1]


def test_waters_have_hashes_of_their_segments_and_a_family_its_members():
    (water,) = waters_of(Policy.load("station").meta)
    assert water["name"] == "swift" and len(water["sha256"]) == len(water["segments"]) == 64
    other = {"name": "swift", "kind": "fitted", "sha256": "0" * 64}
    assert waters_of({"water": other}) == [other]  # another fit of that name: its segments are not these
    family = family_of("swift-family")
    found = waters_of({"water": {"name": family.name, "kind": "family", "sha256": family.sha256}})
    assert [row["sha256"] for row in found] == [family.sha256, *(member.sha256 for member in family.members)]
    assert len(waters_of({"water": {"name": family.name, "kind": "family", "sha256": "0" * 64}})) == 1
    assert waters_of({}) == []


def test_options_of_one_policy_need_its_name(capsys):
    assert cli.main(["policy", "--onnx", "x.onnx"]) == 2 and "name it" in capsys.readouterr().err
    assert cli.main(["policy", "station", "--curve", "x.jsonl"]) == 2


def test_card_names_the_robot_of_the_training(capsys):
    assert cli.main(["policy", "station", "--json"]) == 0
    out = capsys.readouterr().out
    assert "trained for robot swift" in out and json.loads(out.splitlines()[-1])["robot"] == "swift"


def test_a_policy_of_another_fish_that_was_not_judged_shows_its_curve_and_how_to_judge_it(tmp_path, capsys):
    (folder := tmp_path / "my run").mkdir()
    path = stored(folder, header(robot="mine"))
    (folder / "metrics.jsonl").write_text(json.dumps({"step": 100, "seconds": 1.0, "reward": 0.123, "late_distance": 0.5}))
    assert cli.main(["policy", path]) == 0
    out = capsys.readouterr().out
    assert f"judge it, `fishmj evaluate '{path}' --robot FILE --out DIR`, then `fishmj policy '{path}' --judged DIR`" in out
    assert "0.123" in out and "not kept" not in out


def test_policies_are_listed_side_by_side(capsys):
    assert cli.main(["policy"]) == 0
    out = capsys.readouterr().out
    assert all(name in out for name in shipped()) and read_card("station").judged[0].overall["rmse_after_arrival"].text() in out


def test_policies_stand_side_by_side_in_the_waters_that_several_have():
    rows = {row["water"]: row for row in comparison([read_card("station-family"), read_card("station")])}
    assert len(rows) == 7 and all(row["station"] and row["station-family"] for row in rows.values())
