"""The leaderboard on the page and the cards beside the policies are those of the stored rows."""

import json
from functools import cache

import pytest

from fishmj.control.policy import shipped
from fishmj.evaluate.policy_card import card_path, read_card
from studies import leaderboard

ROWS = cache(leaderboard.stored)


def test_page_shows_the_leaderboard_of_the_stored_rows():
    text = leaderboard.PAGE.read_text(encoding="utf-8")
    assert leaderboard.on_page(text, leaderboard.tables(ROWS())) == text
    changed = leaderboard.tables(ROWS()).replace("72, 0.036 (", "72, 0.035 (")
    assert leaderboard.on_page(text, changed) != text


def test_cards_of_shipped_policies_are_those_of_the_stored_rows(tmp_path, monkeypatch):
    monkeypatch.setattr(leaderboard, "card_path", lambda name: tmp_path / card_path(name).name)
    leaderboard.cards(ROWS())
    for name in shipped():
        made, there = (json.loads(path.read_text()) for path in (tmp_path / card_path(name).name, card_path(name)))
        assert made == there, f"{name}: run python -m studies.leaderboard --write"


def test_rows_of_the_solver_are_the_means_of_their_trials():
    plain = ROWS()["solver, plain"]["station"]
    assert plain["n"] == 72 and plain["overall"]["arrival"]["value"] == 1.0
    assert plain["overall"]["rmse_after_arrival"]["value"] == pytest.approx(0.0411, abs=5e-4)
    assert ROWS()["solver, plain"]["paper"]["n"] == 24


def test_policy_trained_anew_has_no_rows_of_its_former_weights(monkeypatch):
    monkeypatch.setattr(leaderboard, "arrays_sha256", lambda name: "0" * 64)
    rows = leaderboard.solved(leaderboard.SOLVER[0])
    assert "station" not in rows and "pi" in rows


def test_card_of_the_family_has_the_waters_in_which_it_fails(monkeypatch):
    card = read_card("station-family")
    found = {judgement.where: judgement for judgement in card.judged}
    slip = found["solver, paper slip 0.97, two draws"]
    assert (slip.n, slip.arrived, slip.held) == (48, "45/48", 42)
    assert slip.lost() == {"0.1": (1, 16), "0.2": (1, 16), "0.3": (4, 16)} and slip.worst.rmse_after_arrival > 1
    assert slip.command.count("fishmj evaluate station-family ") == 2 and "--slip 0.97 --repeats 1; " in slip.command
    assert "--seed 10 --slip 0.97 --speeds 0.3 " in slip.worst.replay
    assert sum(lost for lost, _ in found["solver, reference-2, 0 to 0.04 m/s"].lost().values()) == 6
    assert found["solver, reference-2, 0 to 0.04 m/s"].worst.replay.count("--speeds") == 1
    assert all(judgement.held_by_speed for judgement in card.judged)
    assert (
        "late.toml --repeats 1; python -m studies.judged_waters --list"
        in found["solver, reference-2, commands 85 ms later"].command
    )
    assert all(row["n"] == sum(f["arrival"]["n"] for f in row["by_speed"].values()) > 0 for row in _others().values())
    monkeypatch.setattr(leaderboard, "arrays_sha256", lambda name: "0" * 64)
    assert leaderboard.in_other_waters() == {}, "these are rows of other weights"


def _others() -> dict:
    return {heading: rows["station-family"] for heading, rows in leaderboard.in_other_waters().items()}


def test_cards_name_the_judgements_of_the_flow_solver():
    kinds = {found.water["kind"] for found in read_card("station").judged}
    assert kinds == {"structured", "fitted", "lbm"}
