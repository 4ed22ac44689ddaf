"""`python -m fishmj.evaluate`: exit codes, tables, JSON, report, pictures, and trial folders that can be read back."""

import html
import json
import re
import shlex
import subprocess
import sys

import numpy as np
import pytest

from fishmj import engines, evaluate
from fishmj.base import console
from fishmj.evaluate import __main__ as command
from fishmj.evaluate import metrics, trial_logs, trial_report
from fishmj.log import read_trial, stacked
from fishmj.mjcf.reading import load_robot
from fishmj.view.replay import write_html

ROBOT = load_robot("fish")


@pytest.fixture(scope="module")
def engine():
    return engines.make("compiled", ROBOT)


def test_a_judged_trial_can_be_read_back(tmp_path, engine):
    trials = evaluate.trials(speeds=[0.2], los_deg=[45], repeats=1, duration=4)
    r = evaluate.run("dob", ROBOT, trials, engine)
    (folder,) = trial_logs.write_logs(r, tmp_path)
    trial = read_trial(folder)
    assert folder.name == "dob_u0.2_los045_r0"
    assert trial.value("flow.seed") == trials.flows()[0].seed and trial.value("origin") == "synthetic"
    assert trial.table("truth")["x"] == pytest.approx(r.pose[0, 1:, 0], abs=2e-3)
    assert stacked(trial.table("cmd"), "c#") == pytest.approx(r.command[0], abs=2e-3)
    flow = trials.flows()[0]
    centre = np.append(r.pose[0, 100, :2], 0.0)
    assert stacked(trial.table("flow"), "u#x")[100].mean() == pytest.approx(flow.at(centre, 2.0)[0], abs=0.02)


def run_command(capsys, *argv) -> tuple[int, str, str]:
    code = console.run(command.main, list(argv))
    out = capsys.readouterr()
    return code, out.out, out.err


def test_water_family_without_randomisation_names_the_fit_that_is_judged(capsys):
    words = "drift --water family --no-randomisation --speeds 0.2 --los 0 --repeats 1 --duration 1 --engine planar"
    code, out, _ = run_command(capsys, *words.split())
    assert code == 0 and "--no-randomisation: the first fit alone, swift" in out.splitlines()[0]


def test_a_wrong_controller_is_exit_2_with_the_nearest_name(capsys):
    code, _, err = run_command(capsys, "drit")
    assert code == 2 and "Did you mean 'drift'" in err


@pytest.mark.parametrize(
    "wrong", [["--water", "honey"], ["--engine", "warp"], ["--turbulence", "gusty"], ["--command-path", "lin"]]
)
def test_wrong_settings_are_exit_2(capsys, wrong):
    code, _, err = run_command(capsys, "drift", *wrong)
    assert code == 2 and "Known: " in err


def test_a_fitted_water_is_taken_by_name_with_and_without_its_residual(capsys):
    few = ["drift", "--engine", "compiled", "--speeds", "0.2", "--los", "0", "--repeats", "1", "--duration", "2"]
    for water, code in (("swift", 0), ("swift-base", 0), ("honey-base", 2)):
        assert run_command(capsys, *few, "--water", water)[0] == code


def test_the_command_prints_tables_and_one_json_object_last(capsys, tmp_path):
    argv = ("drift", "pd", "--speeds", "0.2", "--los", "180", "--repeats", "2", "--engine", "compiled", "--duration", "30")
    code, out, _ = run_command(capsys, *argv, "--json", "--out", str(tmp_path / "o"), "--plots")
    last = json.loads(out.strip().splitlines()[-1])
    assert code == 0 and [r["controller"] for r in last["results"]] == ["drift", "pd"]
    assert last["results"][0]["overall"]["arrival"]["value"] == 1.0
    assert {d["key"] for d in last["paired"]} == set(metrics.UNITS)
    assert "gust" not in out and "default turbulence 5 %" in out
    page = (tmp_path / "o" / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == 4 and "://" not in page
    rows = (tmp_path / "o" / "trials.csv").read_text(encoding="utf-8").splitlines()
    assert len(rows) == 1 + 4
    assert json.loads((tmp_path / "o" / "results.json").read_text(encoding="utf-8")) == last


def test_two_trials_report_no_interval_or_star_and_state_the_reason(capsys, tmp_path):
    argv = ("drift", "pd", "--speeds", "0.2", "--los", "180", "--repeats", "2", "--engine", "compiled", "--duration", "5")
    code, out, _ = run_command(capsys, *argv, "--json", "--out", str(tmp_path / "o"))
    *table, last = out.strip().splitlines()
    why, found = "too few trials for an interval: 2 of 5", json.loads(last)
    assert code == 0 and found["results"][0]["overall"]["power"]["why"] == why
    assert found["results"][1]["by_speed"]["0.2"]["power"]["low"] is None
    power = next(d for d in found["paired"] if d["key"] == "power")
    assert (power["n"], power["low"], power["welch_p"], power["why"]) == (2, None, None, why)
    assert any(line.startswith("pd: power") and line.endswith(why) for line in table)
    row = next(line for line in table if line.startswith("| power"))
    assert why in row and "*" not in row and "(" not in row
    assert (tmp_path / "o" / "report.html").read_text(encoding="utf-8").count(why) >= 3


def test_pictures_show_something(tmp_path, engine):
    from matplotlib import image

    from fishmj.evaluate.plots import pictures

    r = evaluate.run("drift", ROBOT, evaluate.trials(speeds=[0.2], repeats=1, duration=60), engine)
    for path, caption in pictures([r], tmp_path):
        pixels = image.imread(path)[..., :3]
        assert pixels.shape[0] > 300 and caption
        assert 0.01 < np.mean(pixels.min(-1) < 0.9) < 0.9, path.name


SHORT = ("--speeds", "0.2", "--los", "180", "--repeats", "1", "--engine", "compiled", "--duration", "2")


def test_a_part_that_cannot_be_written_takes_no_other_with_it(capsys, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(trial_report, "write_logs", full)
    code, out, err = run_command(capsys, "drift", *SHORT, "--out", str(tmp_path / "o"), "--log")
    assert code == 2 and "Not written: logs of drift: [Errno 28] No space left on device" in err
    last = err.splitlines()[-1]
    assert last.startswith("fishmj: ") and "Traceback" not in err and "by flow speed" in out
    assert {path.name for path in (tmp_path / "o").iterdir()} == {"results.json", "trials.csv", "report.html", "worst.html"}


def lead_of(text: str) -> str:
    """The head of a page: its headline, and the notes below it."""
    return text[text.index("<h1") : text.index("</header>")]


def test_the_report_leads_with_its_result_and_links_the_worst_trial(tmp_path, engine):
    from fishmj.evaluate import summary

    trials = evaluate.trials(speeds=[0.2], los_deg=[0, 180], repeats=2, duration=30)
    pd, drift = (evaluate.run(name, ROBOT, trials, engine) for name in ("pd", "drift"))
    found = {"condition": "c", "results": [summary(r) for r in (pd, drift)], "paired": []}
    text = trial_report.write(tmp_path, [pd, drift], found, logs=True, replay=write_html, again="again").read_text(
        encoding="utf-8"
    )
    after = metrics.figures(pd)["rmse_after_arrival"]
    held = int(np.sum((metrics.figures(pd)["arrival"] > 0) & (after <= 0.1)))
    lead = re.search("<h1[^>]*>(.*?)</h1>", lead_of(text))[1]
    assert f"of 4 trials and holds station in {held} (" in lead and f"{after.mean():.3f} m RMS" in lead and "drift" in lead
    i = int(np.argmax(after))
    assert text.count("<a href=") == 1 and '<a href="worst.html">' in text and trial_logs.name_of(pd, i) in text
    assert "<code>" not in text
    assert f"worst of 4 trials: {trial_logs.name_of(pd, i)}" in (tmp_path / "worst.html").read_text(encoding="utf-8")


def test_report_without_replay_names_worst_trial_and_command_to_show_it(capsys, tmp_path):
    argv = ("pd", "drift", *SHORT, "--out", str(tmp_path / "a b"))
    assert run_command(capsys, *argv)[0] == 0
    head = lead_of((tmp_path / "a b" / "report.html").read_text(encoding="utf-8"))
    told = shlex.split(html.unescape(re.search("<code>(.*?)</code>", head)[1]))
    assert told == ["fishmj", "evaluate", *argv, "--log"] and "pd_u0.2_los180_r0" in head
    assert run_command(capsys, *told[2:])[0] == 0
    assert (tmp_path / "a b" / "worst.html").is_file()
    assert '<a href="worst.html">' in (tmp_path / "a b" / "report.html").read_text(encoding="utf-8")


def test_the_headline_compares_with_the_best_rival_and_with_no_control_alone(engine):
    trials = evaluate.trials(speeds=[0.2], los_deg=[0, 60, 120, 180, 240, 300], repeats=1, duration=30)
    pd, drift = (evaluate.run(name, ROBOT, trials, engine) for name in ("pd", "drift"))
    far = pd._replace(controller="far", distance=pd.distance + 0.3)
    means = [metrics.figures(r)["rmse_after_arrival"].mean() for r in (pd, drift, far)]
    worse = pd._replace(controller="worse", distance=pd.distance + 0.6)
    nearer = f"{means[2] - means[0]:.3f} m nearer to the target than far ({means[2]:.3f} m)."
    for order in ([pd, worse, drift, far], [pd, drift, far, worse]):
        assert trial_report.headline(order).endswith(f"at {means[0]:.3f} m RMS on average; {nearer}")
    passive = f"{means[1] - means[0]:.3f} m nearer to the target than drift (no control, {means[1]:.3f} m)."
    assert trial_report.headline([pd, drift]).endswith(passive)
    found = {"condition": "c", "results": [evaluate.summary(r) for r in (pd, far, drift)], "paired": []}
    head = lead_of(trial_report.page([pd, far, drift], found, []))
    assert f"Against drift: {passive}" in head and nearer in head
    alone = lead_of(trial_report.page([pd], found | {"results": found["results"][:1]}, []))
    assert "Judged alone. Name drift (no control)" in alone and "Against" not in alone


def test_headline_reports_inconclusive_comparisons_and_too_short_trials(engine):
    trials = evaluate.trials(speeds=[0.2], los_deg=[0, 60, 120, 180, 240, 300], repeats=1, duration=30)
    pd = evaluate.run("pd", ROBOT, trials, engine)
    twin = pd._replace(controller="twin")
    assert trial_report.headline([pd, twin]).endswith("; in rmse after, these trials do not tell it from twin.")
    far = pd._replace(controller="far", distance=pd.distance + 0.3)
    assert "m farther from the target than pd" in trial_report.headline([far, pd])
    assert "of 6 trials and holds station in 0 (" in trial_report.headline([far])
    short = evaluate.run("pd", ROBOT, evaluate.trials(speeds=[0.2], los_deg=[0], repeats=1, duration=2), engine)
    assert "too short to judge" in trial_report.headline([short])


def test_a_controller_that_fails_leaves_what_was_judged_before_it(capsys, tmp_path, monkeypatch):
    class Broken:
        name = "broken"

        def reset(self, n): ...

        def __call__(self, obs):
            return np.full((len(obs), 10, 3), np.nan)

    make = command.control.make
    monkeypatch.setattr(
        command.control, "make", lambda name, robot, **how: Broken() if name == "pd" else make(name, robot, **how)
    )
    code, _, err = run_command(capsys, "drift", "pd", *SHORT, "--out", str(tmp_path / "o"))
    assert code == 2 and "controller broken" in err
    kept = json.loads((tmp_path / "o" / "results.json").read_text(encoding="utf-8"))
    assert [r["controller"] for r in kept["results"]] == ["drift"] and (tmp_path / "o" / "trials.csv").is_file()


def test_hours_of_the_solver_on_a_cpu_that_nobody_asked_for_are_not_begun(capsys, monkeypatch):
    from fishmj.lbm_oracle.run import solver_cost

    monkeypatch.setattr(solver_cost, "accelerator", lambda need: False)
    code, _, err = run_command(capsys, "drift", "--water", "lbm")
    assert code == 2 and "4320 s of water" in err and "--device cpu begins all the same" in err


def test_the_default_slip_of_a_described_fish_is_noted(capsys, monkeypatch):
    from fishmj.lbm_oracle.run import solver_cost

    monkeypatch.setattr(solver_cost, "agree", lambda *_, **__: None)
    monkeypatch.setattr(command, "judge_in_tanks", lambda *_: iter(()))
    monkeypatch.setattr(command, "report", lambda *_: 0)
    lbm = ("drift", "--water", "lbm", "--robot")
    assert "slip 1 (frictionless), the default" in run_command(capsys, *lbm, "tendon_fish")[2]
    for more in (("fish",), ("tendon_fish", "--slip", "1"), ("tendon_fish", "--boundary", "wall_stress")):
        assert "frictionless" not in run_command(capsys, *lbm, *more)[2]


def test_second_report_replaces_the_first_whole(capsys, tmp_path):
    """Logs, pictures and replay of the first run show other trials; files of the user's own stay."""
    out = tmp_path / "o"
    assert run_command(capsys, "drift", *SHORT, "--out", str(out), "--log")[0] == 0
    (out / "distance.png").write_bytes(b"of the first run")
    for own in ("notes.txt", "photo.png", "logs/mine.txt"):
        (out / own).write_text("mine")
    assert (out / "logs" / "drift_u0.2_los180_r0").is_dir() and (out / "worst.html").is_file()
    assert run_command(capsys, "pd", *SHORT, "--los=90", "--out", str(out))[0] == 2  # refused: nothing is touched
    assert (out / "worst.html").is_file()
    other = [*SHORT[:2], "--los", "90", *SHORT[4:]]
    assert run_command(capsys, "pd", *other, "--out", str(out))[0] == 0
    left = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}
    assert left == {"results.json", "trials.csv", "report.html", "notes.txt", "photo.png", "logs/mine.txt"}
    assert "drift" not in (out / "report.html").read_text(encoding="utf-8").split("</header>")[0].replace("Name drift", "")
    assert run_command(capsys, "pd", *other, "--out", str(out), "--log")[0] == 0
    assert [path.name for path in (out / "logs").iterdir() if path.is_dir()] == ["pd_u0.2_los090_r0"]


@pytest.mark.slow
def test_evaluate_into_a_closed_pipe_writes_everything(tmp_path):
    """`fishmj evaluate ... | head -1`."""
    line = '"$0" -m fishmj evaluate drift "${@:2}" --log --out "$1" 2>&1 | head -1; exit ${PIPESTATUS[0]}'
    words = ["bash", "-c", line, sys.executable, str(tmp_path / "o"), *SHORT]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == console.PIPE_CLOSED, done.stderr
    wanted = {"results.json", "trials.csv", "report.html", "worst.html", "logs"}
    assert {path.name for path in (tmp_path / "o").iterdir()} == wanted
