"""Where a gap is, how it grows, and the page that says so: on data in which the cause is planted. One small search for all."""

import dataclasses
import json
import re
import subprocess
from dataclasses import replace

import hostile
import numpy as np
import pytest

from fishmj import effects
from fishmj.base import console
from fishmj.gap import workflow
from fishmj.gap.commands import find
from fishmj.gap.laboratory.virtual_robot import generate
from fishmj.gap.localise import compared, error_growth, localise
from fishmj.gap.localise.comparison import KINDS, kinds_of
from fishmj.gap.localise.residual_patterns import compatible, significant
from fishmj.gap.models.swimming_fish import SwimmingFish
from fishmj.gap.null.null_runs import SimulatedNull
from fishmj.gap.records.records import record_of
from fishmj.gap.report import gather, sections, write
from fishmj.gap.report.report_data import RoundFinalists, channels, gap_of, record_parts
from fishmj.gap.report.sections import CONTRACT, gates, headline, html
from fishmj.gap.search.likelihood import likelihood_of
from fishmj.gap.thresholds import frozen
from fishmj.gap.wording import quantity
from fishmj.gap.workflow import investigate
from fishmj.log import excitation, write_dataset

EFFECTS = (  # as in test_gap.py: one compiled plant for both
    *("command_latency", "joint_sensor_delay", "coulomb_friction", "servo_gain", "steady_current", "camera_scale", "yaw_drag"),
)
RUNS = ("gait", "chirp", "turn_left", "drift_north")
NULL = SimulatedNull(runs=24)
SEED = 7


@pytest.fixture(scope="module")
def plant():
    catalogue = effects.catalogue()
    return SwimmingFish("fish", [catalogue[name] for name in EFFECTS])


@pytest.fixture(scope="module")
def inquiry(plant):
    return investigate(plant, generate({"command_latency": {"delay": 0.04}}, RUNS, SEED), null=NULL)


@pytest.fixture(scope="module")
def material(inquiry):
    return gather(inquiry)


def planted(plant, hidden: dict, runs=RUNS):
    """The comparison of records in which `hidden` is planted, before and after it is put into the model, where that has it."""
    records = [record_of(t, plant.dt) for t in generate(hidden, runs, SEED)]
    e = likelihood_of(plant, records, NULL)
    row = plant.null.copy()
    for name, values in hidden.items():
        for parameter, value in values.items() if name in EFFECTS else ():
            row[plant.index(name, parameter)] = value
    return compared(e, e.with_estimated_model_error(row), plant.null, row)


# ------------------------------------------------------------------------------------------------------------ localisation
@pytest.mark.slow
def test_a_late_command_is_upstream_of_the_joint(material):
    p = material.place
    assert significant(p.lags.joint) and significant(p.lags.heading) and compatible(p.lags.joint, p.lags.heading)
    assert 0.034 < p.lags.joint.lag < 0.050 and p.lags.joint.high - p.lags.joint.low < 0.01
    assert p.lags.command.lag - p.lags.model.lag == pytest.approx(p.lags.joint.lag, abs=0.006)
    assert p.share[p.channels.index("joint")].sum() > 0.7 and p.locked["joint"].locked > 0.8 and p.rates.ratio > 4
    assert "upstream of the joint" in p.text and not significant(p.lags.joint_after) and p.gap_after < 2 < 20 < p.gap


def test_every_number_of_the_paragraph_is_a_field(material):
    p = material.place
    joint = p.channels.index("joint")
    first = re.match(r"(\d+) % of the gap is in the joints, (\d+) % of that in ([\w ]+) \((\d+) %", p.text)
    k = p.kinds.index(first[3])
    assert int(first[1]) == round(100 * p.share[joint].sum())
    assert int(first[2]) == round(100 * p.share[joint, k] / p.share[joint].sum()) and int(first[4]) == round(
        100 * p.time[joint, k]
    )
    assert f"{1e3 * p.lags.joint.lag:.0f} ± " in p.text and f"{100 * p.locked['joint'].locked:.0f} % of it" in p.text


def test_a_late_camera_is_downstream_of_the_joint(plant):
    p = localise(planted(plant, {"camera_latency": {"delay": 0.04}}), frozen().adequacy)
    assert not significant(p.lags.joint) and 0.034 < p.lags.heading.lag < 0.052
    assert p.share[p.channels.index("heading")].sum() > 0.5 and "downstream of the joint" in p.text


def test_a_late_joint_sensor_is_at_the_joint(plant):
    p = localise(planted(plant, {"joint_sensor_delay": {"delay": 0.04}}), frozen().adequacy)
    assert significant(p.lags.joint) and not significant(p.lags.heading) and "joint's sensor" in p.text


def test_a_current_is_fixed_in_the_tank(plant):
    runs = tuple(f"drift_{way}" for way in ("east", "north", "west", "south"))
    p = localise(planted(plant, {"steady_current": {"x": 0.03, "y": 0.02}}, runs), frozen().adequacy)
    towards = np.degrees(np.arctan2(p.frame.world[1], p.frame.world[0]))
    assert p.frame.points == "world" and abs(towards - np.degrees(np.arctan2(2, 3))) < 25
    assert p.share[p.channels.index("position")].sum() > 0.5 and "of the tank" in p.text
    assert p.thirds["position"][2] > 3 * p.thirds["position"][0] and "grows" in p.text


@pytest.mark.parametrize("offset", [0.06, -0.06])
def test_a_bent_joint_turns_the_robot_to_one_side(plant, offset):
    p = localise(
        planted(plant, {"joint_zero_offset": {"offset1": offset}}, ("gait", "gait_mirrored", "drift_north")), frozen().adequacy
    )
    assert np.sign(p.side.even) == -np.sign(offset) and abs(p.side.even) > 3 * p.side.even_sd
    assert p.frame.points != "world" and p.locked["heading"].locked < 0.5 and not significant(p.lags.joint)
    assert f"more to the {'right' if offset > 0 else 'left'} in turns to both sides" in p.text


def test_agreement_has_no_place(plant):
    p = localise(planted(plant, {}), frozen().adequacy)
    assert p.gap < 1.25 and "too small to localise" in p.text
    assert not significant(p.lags.joint) and not significant(p.lags.heading)


def test_a_fast_steady_beat_tells_no_lag(plant):
    """A delay of a period and none look the same: nothing is claimed rather than something wrong."""
    steady = excitation.Excitation(id="buzz", commands=excitation.gait(4.5, 0.2, 0.5, seconds=8.0), about="one fast beat")
    c = planted(plant, {"command_latency": {"delay": 0.04}}, (steady,))
    found = localise(c, frozen().adequacy).lags.joint
    assert found is None or abs(found.lag - 0.04) < 0.02


def test_regimes_are_told_apart_by_what_was_done(plant):
    drift, gait = (record_of(t, plant.dt) for t in generate({}, ("drift_north", "gait"), SEED))
    assert np.mean(kinds_of(drift, np.arange(1.0, 11.0)) == KINDS.index("rest")) > 0.8
    assert np.mean(kinds_of(gait, np.arange(4.0, 9.0)) == KINDS.index("steady swimming")) > 0.8


# ------------------------------------------------------------------------------------------------------------------ growth
def test_a_delay_is_there_at_once_and_a_current_grows(plant, material):
    joint = {c.channel: c for c in material.growth}["joint"]
    assert joint.kind == "there at once" and np.all(joint.after < 0.2 * joint.before)
    c = planted(plant, {"steady_current": {"x": 0.06, "y": 0.0}}, ("drift_north", "drift_west", "gait", "turn_left"))
    position = {k.channel: k for k in error_growth.curves(plant, c.records, *c.rows)}["position"]
    assert 0.8 < position.slope < 2.3 and position.after[-1] < position.before[-1] and position.restarts > 50


# ---------------------------------------------------------------------------------------------------------------- material
def test_the_gap_by_channel_is_that_of_the_pair_that_the_verdict_says(inquiry, material):
    assert record_parts(inquiry).count("held out") == 1 and record_parts(inquiry).count("fitted") == 3
    before, after = gap_of(material)
    assert (before, after) == (inquiry.verdict.gap_before, inquiry.verdict.gap_after) and after < 2 < before
    told = channels(inquiry)
    assert min(one for one, _ in told.values()) < before < max(one for one, _ in told.values())
    assert max(two for _, two in told.values()) < 3
    more = dataclasses.replace(inquiry, records=[*inquiry.records, inquiry.records[0]], unseen=np.array([False] * 4 + [True]))
    assert record_parts(more)[-1] == "never used"


def test_finalists_are_ranked_and_their_likeness_is_a_cosine(material):
    (first, *_) = material.rounds
    assert first.table[0].name == "command_latency" and first.table[0].behind == 0 and first.table[0].p_best > 0.9
    assert [r.behind for r in first.table] == sorted(r.behind for r in first.table)
    assert (
        np.allclose(np.diag(first.alike), 1) and np.allclose(first.alike, first.alike.T) and np.abs(first.alike).max() < 1 + 1e-9
    )
    names = [r.name for r in first.table]
    late = first.alike[0, names.index("joint_sensor_delay")]
    assert late > first.alike[0, names.index("steady_current")] if "steady_current" in names else late > 0.5


def test_more_finalists_than_letters_have_a_table_and_a_map(material):
    row = material.rounds[0].table[0]
    page = sections.ranked(RoundFinalists((row,) * 60, np.ones((60, 60))), 0, 1)
    table, picture = page.split("<svg")
    assert ">BH<" in table and table.count("<tr") >= 60
    assert ">P<" in picture and ">Q<" not in picture, "the first 16 are drawn"


def test_what_the_records_cannot_show_is_said(plant):
    still = generate({}, ("drift_north", "drift_west"), SEED)
    missed = {b.name for b in gather(investigate(plant, still, null=NULL)).blind}
    assert {"command_latency", "joint_sensor_delay", "servo_gain"} <= missed and "steady_current" not in missed


# -------------------------------------------------------------------------------------------------------------------- page
@pytest.fixture(scope="module")
def folder(inquiry, tmp_path_factory):
    made = tmp_path_factory.mktemp("gap") / "report"
    assert write(inquiry, made) == ["report.html", "report.json"]
    return made


def test_the_page_stands_alone_and_answers_first(folder):
    text = (folder / "report.html").read_text()
    assert len(text) < 3_000_000 and not re.search(r'(src|href)="(?!#|data:)', re.sub(r'xmlns(:\w+)?="[^"]*"', "", text))
    assert text.index("Missing: command latency") < text.index("<h2>") and text.count("<svg") >= 5
    for part in (
        "before and after",
        "Where it is",
        "tell most",
        "How it grows",
        "What it could be",
        "Why this answer",
        "The records",
    ):
        assert f"{part}</h2>" in text, part
    ids = re.findall(r'\bid="([^"]+)"', text)
    assert len(ids) == len(set(ids)) and set(re.findall(r"url\(#([^)]+)\)", text)) <= set(ids)
    assert not re.search(r"\bnan\b", re.sub(r"<svg.*?</svg>", "", text, flags=re.DOTALL))


def test_json_holds_what_the_page_shows(folder, material):
    kept = json.loads((folder / "report.json").read_text())
    assert kept["verdict"]["answer"] == "NAMED" and kept["verdict"]["effects"][0]["name"] == "command_latency"
    assert kept["localisation"]["text"] == material.place.text and kept["localisation"]["lags"]["joint"]["found"]
    assert (kept["gap"]["before"], kept["gap"]["after"]) == pytest.approx(gap_of(material)) and len(kept["growth"]) == 3
    assert kept["verdict"]["gap_after"] == kept["gap"]["after"]
    assert kept["rounds"][0]["table"][0]["name"] == "command_latency" and kept["records"][0]["part"] in ("fitted", "held out")


@pytest.mark.parametrize("answer", CONTRACT)
def test_each_of_the_five_answers_has_its_page(inquiry, material, answer):
    v = inquiry.verdict
    other = {"name": "joint_sensor_delay", "p_best": 0.3, "behind": 0.01, "instead_of": "command_latency"}
    term = {"name": "sway force ~ tail rate x yaw rate", "coefficient": 0.02, "unit": "N s2", "closure": 0.8, "stability": 1.0}
    term |= {"firm": True, "alike": ("yaw torque ~ yaw rate",)}
    changed = {
        "NAMED": {"warnings": ("torques of 0.44 N m remain unexplained",)},
        "CLASS": {"rivals": (other,)},
        "UNEXPLAINED": {
            "reason": "the catalogue explains 28%",
            "gates": v.gates | {"closure": 0.28, "rest": 9.0},
            "terms": (term,),
        },
        "AGREES": {"effects": ()},
        "NOT_REPEATABLE": {"effects": ()},
    }[answer]
    asked = dataclasses.replace(inquiry, verdict=dataclasses.replace(v, answer=answer, **changed))
    shown = dataclasses.replace(material, inquiry=asked)
    text = html(shown)
    assert "Robot swift, shipped as fish, sha256 " in text.split("</header>")[0]
    assert f'class="mark">{answer}<' in text and headline(asked.verdict) in text and text.count('class="on"') == 1
    if answer == "CLASS":
        assert "or joint sensor delay" in text and "the body lags too" in text, "what separates them comes from the catalogue"
    assert ("tail rate x yaw rate" in text and "As a force</h2>" in text) == (answer == "UNEXPLAINED")
    states = [g.state for g in gates(shown)] if answer in ("NAMED", "UNEXPLAINED") else []
    assert answer != "NAMED" or set(states) == {"passed"}
    assert answer != "UNEXPLAINED" or states[2:4] == ["failed", "not asked"]


def hostile_page(material) -> str:
    """The page of a search whose records, answer and terms have hostile words."""
    i = material.inquiry
    evil = {r.name: r._replace(name=f"{hostile.EVIL} {k}", excitation=hostile.EVIL) for k, r in enumerate(i.records)}
    terms = [{"name": hostile.EVIL, "unit": hostile.EVIL, "coefficient": 1.0, "closure": 0.5, "stability": 0.5, "firm": True}]
    verdict = dataclasses.replace(
        i.verdict,
        answer="UNEXPLAINED",
        reason=hostile.EVIL,
        warnings=(hostile.EVIL,),
        next_experiment=hostile.EVIL,
        terms=tuple(t | {"alike": [hostile.EVIL]} for t in terms),
    )
    inquiry = _with(i, records=[evil[r.name] for r in i.records], verdict=verdict)
    comparison = _with(material.comparison, records=[evil[r.name] for r in material.comparison.records])
    return html(dataclasses.replace(material, inquiry=inquiry, comparison=comparison, weighed=hostile.EVIL))


def test_text_of_a_hostile_data_set_is_shown_and_runs_nothing(material):
    hostile.check(hostile_page(material))


@pytest.mark.slow
@pytest.mark.browser
@hostile.needs_browser
def test_a_browser_runs_nothing_of_a_hostile_data_set(material, tmp_path):
    hostile.runs_nothing(hostile_page(material), tmp_path)


def _with(made, **changed):
    """The same dataclass or tuple with other fields."""
    return made._replace(**changed) if hasattr(made, "_replace") else dataclasses.replace(made, **changed)


def test_values_come_in_units_of_a_lab():
    assert quantity(0.0437, "s", 0.043, 0.0442) == "43.7 (43 to 44.2) ms" and quantity(1.49, "s") == "1.49 s"
    assert quantity(0.1, "rad") == "5.73 deg" and quantity(0.3, "1") == "0.3" and quantity(-0.002, "m") == "-2 mm"


@pytest.mark.browser
@pytest.mark.skipif(hostile.browser() is None, reason="no chromium or chrome found; set FISHMJ_BROWSER to one")
def test_a_browser_shows_the_page_without_overflow(folder, tmp_path):
    import cv2

    text = (folder / "report.html").read_text()
    probe = (
        "<script>document.title=[document.documentElement.scrollWidth,document.querySelectorAll('svg').length].join(' ')</script>"
    )
    shown = tmp_path / "report.html"
    text = re.sub(r"<meta http-equiv=[^>]*>", "", text)  # the page's policy lets no script run, not even this one
    shown.write_text(text.replace("</body>", probe + "</body>"), encoding="utf-8")
    quiet = "--headless --no-sandbox --disable-gpu --no-first-run --disable-background-networking --hide-scrollbars".split()
    start = [hostile.browser(), *quiet, "--window-size=1200,1400", "--virtual-time-budget=2000"]

    def visit(profile: str, *options: str) -> str:
        command = [*start, f"--user-data-dir={tmp_path / profile}", *options, shown.as_uri()]
        return subprocess.run(command, capture_output=True, text=True, timeout=600, check=True).stdout

    width, pictures = map(int, re.search(r"<title>(\d+) (\d+)</title>", visit("a", "--dump-dom")).groups())
    assert width <= 1200 and pictures >= 5
    shot = tmp_path / "shot.png"
    visit("b", f"--screenshot={shot}")
    image = cv2.imread(str(shot)).astype(int)
    b, g, r = (image[..., i] for i in range(3))
    assert np.mean((r > 240) & (g > 240) & (b > 240)) > 0.6, "light"
    assert np.sum((b > 120) & (r < 40) & (g < 130) & (g > 60)) > 2000, "the answer's blue"
    assert np.sum((r > 200) & (g > 70) & (g < 120) & (b < 40)) > 50, "the orange of the model as it was"


# Work after the answer.


def failing(*given, **named):
    raise RuntimeError("no advice today")


@pytest.fixture
def second(inquiry, monkeypatch):
    """`investigate` with the finished search of `inquiry` in place of another one; of an answer that each advice needs."""

    def again(answer: str, **named):
        monkeypatch.setattr(workflow, "forward_select", lambda *given: inquiry.found)
        monkeypatch.setattr(workflow, "decide", lambda *given: replace(inquiry.verdict, answer=answer))
        monkeypatch.setattr(workflow, "VETOES", ())
        return investigate(inquiry.evidence.model, inquiry.trials, null=NULL, further=True, **named)

    return again


ADVICE = {
    "CLASS": "fishmj.gap.experiment.advise",
    "UNEXPLAINED": "fishmj.gap.terms.select.describe",
    "AGREES": "fishmj.gap.workflow.missed_sizes",
}


@pytest.mark.parametrize("answer", ADVICE)
def test_failing_advice_costs_no_answer(answer, second, monkeypatch, capsys):
    """The answer is given first; advice that raises is a warning."""
    monkeypatch.setattr(ADVICE[answer], failing)
    given: list = []
    done = second(answer, answered=given.append)
    assert [one.verdict.answer for one in given] == [answer] and done.verdict == given[0].verdict
    assert "the answer is complete, but" in (said := capsys.readouterr().err) and "no advice today" in said


def test_interrupted_advice_leaves_the_verdict(second, monkeypatch):
    def stop(*given):
        raise KeyboardInterrupt

    monkeypatch.setattr(ADVICE["CLASS"], stop)
    given: list = []
    with pytest.raises(KeyboardInterrupt):
        second("CLASS", answered=given.append)
    assert given[0].verdict.answer == "CLASS"


AFTER = (
    "fishmj.gap.commands.find.steady_speeds",
    "fishmj.gap.commands.find.settle",
    "fishmj.gap.report.gather",
    "fishmj.gap.report.html",
)


@pytest.mark.parametrize("stage", AFTER)
def test_failing_page_costs_no_answer(stage, inquiry, tmp_path, monkeypatch, capsys):
    """verdict.json is there, and the exit code is that of the answer, whatever fails behind it."""
    monkeypatch.setattr(stage, failing)
    monkeypatch.setattr(find, "search", lambda args, robot, given, notes, healthy, answered: answered(inquiry) or inquiry)
    logs = write_dataset(tmp_path / "logs", {t.name: t for t in inquiry.trials})
    assert console.run(find.main, [str(logs), "--out", str(tmp_path / "out"), "--json"]) == console.OK
    done = capsys.readouterr()
    assert json.loads((tmp_path / "out" / "verdict.json").read_text())["answer"] == inquiry.verdict.answer
    assert json.loads(done.out.splitlines()[-1])["answer"] == inquiry.verdict.answer and "no advice today" in done.err
