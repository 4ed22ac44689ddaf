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


def test_cards_name_the_judgements_of_the_flow_solver():
    kinds = {found.water["kind"] for found in read_card("station").judged}
    assert kinds == {"structured", "fitted", "lbm"}
