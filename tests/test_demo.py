"""The demo in short: every part runs and leaves its files."""

import json
import re
import shlex

import numpy as np
import pytest

pytest.importorskip("numba", reason='the demo trains on the compiled engine: pip install "fishmj[fast]"')

from fishmj.base import console
from fishmj.evaluate import __main__ as evaluate
from fishmj.view import demo


@pytest.mark.part("training")
def test_the_demo_trains_judges_reports_and_replays(tmp_path, capsys):
    assert console.run(demo.main, ["--smoke", "--out", str(tmp_path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert found["trials"] == 2 and 0 <= found["arrivals"] <= 2 and found["rmse_last20"] >= 0
    assert found["training"]["steps"] >= demo.SMOKE["steps"]
    trained, shipped = found["other_water"].values()
    assert shipped["arrivals"] == 2 and shipped["rmse_last20"] < 0.1 and trained["trials"] == 2
    for name, least in (("replay.html", 1_000_000), ("report/report.html", 100_000), ("report/distance.png", 10_000)):
        assert (tmp_path / name).stat().st_size > least, name
    assert (tmp_path / "trial" / "meta.toml").is_file() and (tmp_path / "training" / "best.safetensors").is_file()
    told = shlex.split(re.search("<code>(.*?)</code>", (tmp_path / "report" / "report.html").read_text(encoding="utf-8"))[1])
    again = evaluate.options().parse_args(told[2:])
    assert told[:3] == ["fishmj", "evaluate", str(tmp_path / "training")] and again.log and again.out == tmp_path / "report"


def test_training_stops_when_fish_holds():
    assert demo.holds({"within": demo.ENOUGH}) and not demo.holds({"within": demo.ENOUGH - 0.01})


def test_plan_tells_time_from_measured_rate():
    told = demo.plan(10_000.0, 2_500_000)
    assert told.startswith("this machine trains 10,000 control steps/s: about 3 min 00 s to go, 4 min 40 s if")


@pytest.mark.parametrize(("asked", "there"), [(False, True), (True, True), (True, False)])
def test_the_demo_names_its_page_and_opens_it_only_when_asked(tmp_path, capsys, monkeypatch, asked, there):
    import webbrowser

    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", lambda address: bool(opened.append(address)) or there)
    monkeypatch.setattr(demo, "learn", lambda args: {"stopped": False, "policy": "p", "steps": 1, "seconds": 1.0})
    monkeypatch.setattr(demo, "judge", lambda args, policy, water=None: None)
    monkeypatch.setattr(demo, "verdict", lambda result: {"trials": 24, "arrivals": 20, "rmse_last20": 0.08})
    page = tmp_path / "replay.html"
    told = {"report": "report.html", "replay": str(page), "trials": 24, "arrivals": 24, "rmse_last20": 0.04}
    monkeypatch.setattr(demo, "show", lambda args, result: told)
    assert console.run(demo.main, ["--out", str(tmp_path), *(["--open"] if asked else [])]) == 0
    said = capsys.readouterr()
    assert f"replay: {page}" in said.out.splitlines()[-1]
    assert "swift-reference: 20 of 24 trials, 0.080 m; the shipped station-family: 20 of 24" in said.out
    assert opened == ([page.as_uri()] if asked else []) and ("no browser" in said.err) == (not there)


def test_one_fish_that_strays_is_no_judgement_of_all_and_a_lost_one_is_no_good_one(monkeypatch):
    speed = np.repeat([0.1, demo.SPEED], 8)
    trials = type("Trials", (), {"speed": speed, "__len__": lambda self: 16})()
    for rmse, wanted in (([0.05] * 7 + [1.5], 0.05), ([np.nan] * 5 + [0.05] * 3, np.inf)):
        found = {"arrival": np.ones(16), "rmse_last20": np.r_[np.full(8, 0.2), rmse]}
        monkeypatch.setattr("fishmj.evaluate.figures", lambda result, found=found: found)
        said = demo.verdict(type("Result", (), {"trials": trials})())
        assert said == {"trials": 16, "arrivals": 16, "rmse_last20": wanted}
