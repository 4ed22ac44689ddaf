"""Text of a hostile data set runs nothing: not on a page, not in a picture, not in a terminal, not as a path."""

import csv
import json
import re
from types import SimpleNamespace

import hostile
import numpy as np
import pytest
from hostile import EVIL, PAYLOADS, WATCH, needs_browser
from markupsafe import Markup
from synthetic import swim

from fishmj import engines, evaluate, log
from fishmj.base import console, pages
from fishmj.base.errors import ConfigError
from fishmj.evaluate import plots, trial_report
from fishmj.gap.calibrate import fit_plots
from fishmj.hydro_fit import fit_report as water
from fishmj.log import __main__ as command
from fishmj.mjcf import load_robot
from fishmj.view.replay import write_html, write_png
from fishmj.view.replay.replay_data import robot_of
from studies.rank_waters.rank_waters_command import picture as draw_rank

ROBOT = load_robot("fish")


@pytest.fixture(scope="module")
def trial():
    """A swim whose every word is hostile."""
    made = swim(2.0)
    words = dict.fromkeys(("robot", "excitation", "notes", "controller", "source", "licence", "title", "water", "commit"), EVIL)
    return log.Trial({**made.meta, **words, "sigma": {EVIL: 1.0}}, made.tables, name=PAYLOADS[1])


@pytest.fixture(scope="module")
def judged():
    """Two trials of a controller with a hostile name."""
    trials = evaluate.trials(speeds=[0.2], los_deg=[0, 180], repeats=1, duration=60)
    return evaluate.run("drift", ROBOT, trials, engines.make("compiled", ROBOT))._replace(controller=EVIL)


def found_of(results):
    summaries = [evaluate.summary(r) for r in results]
    return {"condition": EVIL, "results": summaries, "paired": []}


# ----------------------------------------------------------------------------------------------------------------- pages
def replay_of(trial, folder):
    return write_html([trial, trial], folder / "replay.html", ROBOT, EVIL)


def judgement_of(judged, folder):
    picture = folder / "p.png"
    picture.write_bytes(b"\x89PNG")
    text = trial_report.page([judged, judged], found_of([judged, judged]), [(picture, EVIL)])
    (folder / "report.html").write_text(text, encoding="utf-8")
    return folder / "report.html"


def calibration_of(folder):
    tables = {EVIL: [{EVIL: EVIL, "value": 1.0}, {EVIL: PAYLOADS[8], "value": 2.0}]}
    picture = folder / "p.png"
    picture.write_bytes(b"\x89PNG")
    return fit_plots.report(folder / "calibrate", EVIL, tables, picture, [EVIL], EVIL)


def water_of(folder, monkeypatch):
    rows = [{"figure": EVIL, "value": 1.0}]
    swum = SimpleNamespace(began=2.0)
    monkeypatch.setattr(water.free_swims, "judge", lambda *a: {"freerun_s": 1.0, "figures": {}})
    monkeypatch.setattr(water.free_swims, "FreeSwims", lambda *a: swum)
    monkeypatch.setattr(water, "by_regime", lambda *a: rows)
    monkeypatch.setattr(water, "static_map", lambda *a: {})
    monkeypatch.setattr(water, "means_figure", lambda *a: b"\x89PNG")
    monkeypatch.setattr(water, "runs_figure", lambda *a: b"\x89PNG")
    for name, made in (("free_runs", rows), ("gait_rows", (rows, [])), ("coefficients", rows), ("check_rows", rows)):
        monkeypatch.setattr(water, name, lambda *a, made=made: made)
    about = {"dataset": {"sha256": EVIL}, "band": {}, "preview": True}
    model = SimpleNamespace(name=EVIL, robot=EVIL, slip=1.0, dt=0.004, notes=EVIL, **about)
    return water.write(folder / "water", model, ROBOT, [])


def test_a_replay_shows_hostile_text_and_runs_its_own_scripts_only(trial, tmp_path):
    page = replay_of(trial, tmp_path).read_text()
    own = ("text/javascript", "text/javascript", "application/json", "text/javascript")
    hostile.check(page, scripts=own)
    data = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)[1]
    assert not set(data) & set("<>&") and json.loads(data)["tracks"][0]["label"].startswith(EVIL)


def test_the_policy_of_a_replay_allows_exactly_its_scripts(trial, tmp_path):
    import base64
    from hashlib import sha256

    page = replay_of(trial, tmp_path).read_text()
    sums = re.search(r"script-src ([^;\"]*)", page)[1].split()
    scripts = re.findall(r"<script>(.*?)</script>", page, re.DOTALL)
    assert sums == [f"'sha256-{base64.b64encode(sha256(s.encode()).digest()).decode()}'" for s in scripts] and len(sums) == 3
    assert "unsafe-inline" not in re.search(r"script-src [^;\"]*", page)[0]


def test_a_judgement_shows_hostile_names(judged, tmp_path):
    hostile.check(judgement_of(judged, tmp_path).read_text())


def test_a_calibration_shows_hostile_tables(tmp_path):
    hostile.check(calibration_of(tmp_path).read_text())


def test_a_report_on_a_water_shows_hostile_names(tmp_path, monkeypatch):
    hostile.check(water_of(tmp_path, monkeypatch).read_text())


def test_the_look_itself_is_awake():
    for payload in (PAYLOADS[1], PAYLOADS[4], PAYLOADS[6], "<iframe>", '<a href="https://x">'):
        assert hostile.Look(f"<p>{payload}").trouble != [], payload
    assert hostile.Look(PAYLOADS[0]).scripts == ["text/javascript"]
    with pytest.raises(AssertionError):
        hostile.check(pages.report("a", "a", [pages.Section("a", "", [Markup(f"<p>{EVIL}</p>")])]))


def test_cells_stay_cells():
    rows = [{"name": "a | b", "value": 1.0}, {"name": "two\nlines\\", "value": 2.0}]
    page = pages.table(rows)
    assert page.count("<tr>") == 3 and page.count("<td>") == 4 and "<td>a | b</td>" in page and "two lines" in page


def test_whatever_is_put_into_a_page_is_text_unless_a_template_made_it():
    rows = [{EVIL: EVIL, "n": 1.0}]
    parts = [EVIL, pages.table(rows), pages.figure(b"png", EVIL), pages.part("items", [EVIL]), pages.part("command", EVIL, EVIL)]
    found = hostile.check(pages.report(EVIL, EVIL, [pages.Section(EVIL, EVIL, parts)], mark=EVIL, notes=[EVIL]))
    assert " ".join(found.words).count("{{7*7}} ${7*7}") == 13, "shown as often as it was given"


# --------------------------------------------------------------------------------------------------------------- pictures
def test_a_formula_in_a_name_is_drawn_as_text(judged, tmp_path):
    for path, _ in plots.pictures([judged._replace(controller=PAYLOADS[7])], tmp_path):
        assert path.read_bytes().startswith(b"\x89PNG")
    row = {"value": 0.2, "low": 0.1, "high": 0.3}
    ranked = [
        {"controller": name, "n": 3, "ranked": i % 2 == 0, "solver": row, "surrogate": row} for i, name in enumerate(PAYLOADS)
    ]
    assert draw_rank({"controllers": ranked, "key": "rmse"}, tmp_path / "rank.png", EVIL).is_file()


def test_drawn_text_is_letter_by_letter():
    from matplotlib.figure import Figure

    for payload in (*PAYLOADS, r"\$a\$", "$$", "$" * 7):
        figure = Figure()
        drawn = figure.text(0, 0, pages.drawn(payload))
        figure.savefig("/dev/null", format="svg")
        assert drawn._preprocess_math(drawn.get_text())[1] is not True, payload
    assert pages.drawn("costs $5") == r"costs \$5" and len(pages.drawn("x" * 9999)) <= pages.LONGEST


def test_a_film_takes_any_label(trial, tmp_path):
    assert write_png([trial], tmp_path / "a.png", 1.0, ROBOT, title=EVIL * 50).is_file()


# ---------------------------------------------------------------------------------------------- terminal, tables, names
def test_nothing_of_a_log_commands_the_terminal(trial, tmp_path, capsys):
    folder = log.write_trial(tmp_path / "swim\x1b[31m", trial)
    extra = {**trial.tables["cmd"], "\x1b]0;owned\x07": trial.tables["cmd"]["t"]}
    log.write_trial(folder, log.Trial(trial.meta, {**trial.tables, "cmd": extra}), overwrite=True)
    assert console.run(command.main, ["check", str(folder)]) == 0
    said = capsys.readouterr()
    assert not set(said.out + said.err) & {"\x1b", "\x07", "\x9b", "\u202e", "\r"} and "swim[31m" in said.out
    assert console.run(command.main, ["check", str(tmp_path / "no\x1b[2J")]) == 2
    assert "\x1b" not in capsys.readouterr().err


def test_tables_and_progress_hold_no_control_characters():
    assert console.table([{"a": PAYLOADS[8]}]).isprintable() is False  # line ends only
    assert not set(console.table([{"a": EVIL}])) & {"\x1b", "\x07", "\x9b", "\u202e", "\r"}
    assert console.printable("a\tb\nc\x00\x7f\ud800") == "a\tb\nc"


def test_a_table_of_trials_opens_in_a_spreadsheet_without_a_formula(judged):
    for name in ("=cmd|' /C calc'!A0", "+1", "-1", "@SUM(A1)"):
        rows = list(csv.reader(trial_report.trials_csv([judged._replace(controller=name)]).splitlines()))
        assert {row[0] for row in rows[1:]} == {f"'{name}"}


def test_the_robot_of_a_log_is_never_a_path(tmp_path):
    other = tmp_path / "other.toml"
    other.write_text("[[link]]\n")
    for name in (str(other), "../" * 9 + "etc/passwd", EVIL, 3, {"a": 1}, ["fish"], "fish\x00"):
        with pytest.raises(ConfigError, match="does not come with fishmj"):
            robot_of(log.Trial({"robot": name}, {}))


def test_a_hostile_trial_can_be_exported_and_read_again(trial, tmp_path):
    from fishmj.log.export import export

    log.write_trial(tmp_path / "a", trial, form="csv")
    for form in ("mcap", "csv", "parquet"):
        export(tmp_path / "a", form, tmp_path / form)
    assert log.read_trial(tmp_path / "csv").value("controller") == EVIL
    assert np.array_equal(log.read_trial(tmp_path / "csv").tables["cmd"]["c1"], trial.tables["cmd"]["c1"])


# ---------------------------------------------------------------------------------------------------------------- browser


@pytest.mark.browser
@needs_browser
def test_a_browser_runs_it_where_it_is_not_escaped(tmp_path):
    """The watcher is awake: the same text, left as it is, does run."""
    page = tmp_path / "raw.html"
    page.write_text(f"<html><head><script>{WATCH}</script></head><body>{PAYLOADS[1]}</body></html>", encoding="utf-8")
    assert 'data-pwned="1"' in hostile.visited(page, tmp_path / "profile")[0]


@pytest.mark.browser
@needs_browser
@pytest.mark.parametrize("kind", [pytest.param("replay", marks=pytest.mark.slow), "judgement", "calibration", "water"])
def test_a_browser_runs_nothing_of_it(kind, trial, judged, tmp_path, monkeypatch):
    made = {
        "replay": lambda: replay_of(trial, tmp_path),
        "judgement": lambda: judgement_of(judged, tmp_path),
        "calibration": lambda: calibration_of(tmp_path),
        "water": lambda: water_of(tmp_path, monkeypatch),
    }
    guards = (False,) if kind == "replay" else (True, False)  # a replay is opened with its policy in test_replay.py
    dom = hostile.runs_nothing(made[kind]().read_text(encoding="utf-8"), tmp_path, guards)
    assert kind != "replay" or 'data-ready="ready' in dom
