"""Lists of runs: seeds and sweeps, here and over Ray with two workers on this machine. Marked ray, but for what needs none."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fishmj.base import console
from fishmj.base.errors import ConfigError, SimDiverged, UsageError
from fishmj.base.store import Checkpoints, read_json
from fishmj.train import planned_runs, training_run
from fishmj.train.__main__ import main, options
from fishmj.train.planned_runs import PlannedRun, grid_points, sweep_table
from fishmj.train.settings import change, preset

ROOT = Path(__file__).resolve().parent.parent
SMALL = ["--preset", "quick", "--engine", "compiled", "--envs", "16", "--horizon", "8", "--minibatches", "2"]
TINY = [*SMALL, "--seeds", "3,4"]


@pytest.mark.parametrize(("more", "said"), [(["--together"], "--together with --ray"), (["--force", "--resume"], "--resume")])
def test_options_that_contradict_ray_are_refused(more, said, tmp_path, capsys):
    assert console.run(main, [*TINY, "--ray", "local:2", *more, "--out", str(tmp_path / "run")]) == console.BAD_INPUT
    assert said in capsys.readouterr().err


def test_steps_of_a_run_are_read_while_a_line_is_written(tmp_path):
    assert planned_runs.steps_of(tmp_path) == 0
    (tmp_path / "metrics.jsonl").write_text('{"step": 128}\n{"step": 256}\n{"ste')
    assert planned_runs.steps_of(tmp_path) == 256


def points(line):
    parser = options()
    return grid_points(parser, parser.parse_args(line.split()))


def test_grid_has_every_combination_with_parsed_values():
    found = points(
        "--gamma 0.9 --reward wD=0.5 --sweep learning-rate 1e-3 3e-4 --sweep hidden 64,64 32 --sweep reward.wS 0.1 0.2"
    )
    assert [name for name, _ in found][:2] == [f"learning-rate=1e-3,hidden=64,64,reward.wS={w}" for w in ("0.1", "0.2")]
    assert len(found) == 8 and all(one.gamma == 0.9 for _, one in found)
    last = found[-1][1]
    assert (last.learning_rate, last.hidden, last.reward) == (3e-4, [32], [("wD", 0.5), ("wS", 0.2)])
    assert points("--gamma 0.9")[0][0] == "" and len(points("")) == 1


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("--sweep gama 0.9 0.8", "--sweep gama: .*expected one of"),
        ("--sweep water structured family", "--sweep water: cannot be swept, because points share task, robot and water"),
        ("--sweep gamma 0.9", "two or more different values"),
        ("--sweep gamma 0.9 0.9", "two or more different values"),
        ("--sweep gamma 0.9 0.8 --gamma 0.7", "gamma is given twice"),
        ("--sweep gamma 0.9 0.8 --sweep gamma 0.7 0.6", "gamma is given twice"),
        ("--sweep reward.wS 1 2 --reward wS=3", "reward.wS is given twice"),
        ("--sweep gamma 0.9 much", "argument --gamma: got 'much'"),
    ],
)
def test_sweep_that_means_nothing_is_refused(line, said):
    with pytest.raises((ConfigError, UsageError), match=said):
        points(line)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--sweep", "gamma", "0.9", "0.90"], "gamma=0.9 and gamma=0.90 are the same"),
        (["--sweep", "gamma", "0.9", "0.8", "--together"], "--together with --sweep"),
        (["--sweep", "gamma", "0.9", "0.8", "--correct"], "--correct with"),
        (["--sweep", "gamma", "0.9", "0.8", "--resume"], "nothing to resume"),
        (["--sweep", "utd", "1", "2"], "utd"),
    ],
)
def test_sweep_is_refused_before_anything_runs(more, said, tmp_path, capsys):
    assert console.run(main, [*SMALL, *more, "--out", str(tmp_path / "run")]) == console.BAD_INPUT
    assert said in capsys.readouterr().err and not (tmp_path / "run").exists()


@pytest.fixture
def instant_runs(monkeypatch):
    """Runs that take no time: their RMSE is |gamma - 0.9| + 0.01 seed, their learners are the list, and 0.7 diverges."""
    made, begins = [], []

    class Run:
        def __init__(self, settings, folder, *, resume, learner, begin, command, quiet):
            self.settings, self.folder = settings, folder
            begins.append((settings.seed, resume, begin is not None))
            assert learner[0].algorithm["gamma"] == settings.algorithm["gamma"]

        def go(self):
            gamma = self.settings.algorithm["gamma"]
            if gamma == 0.7:
                raise SimDiverged("non-finite figures")
            Checkpoints(self.folder / "checkpoints").save(1, {"x": np.zeros(1)}, {})
            figures = {"arrival": 1.0, "stayed": 1.0, "return": 3.0, "rmse_last10": abs(gamma - 0.9) + 0.01 * self.settings.seed}
            training_run.write_settings(self.settings, self.folder)
            return training_run.summary_of(self.settings, self.folder, self.settings.steps, 1.0, figures, False)

    monkeypatch.setattr(training_run, "TrainingRun", Run)
    monkeypatch.setattr(training_run, "learner_of", lambda settings, devices: made.append(settings) or (settings,))
    return SimpleNamespace(learners=made, begins=begins)


def test_sweep_names_the_best_point_on_the_tuning_flows(instant_runs, tmp_path, capsys):
    words = [*SMALL, "--sweep", "gamma", "0.95", "0.9", "0.8", "--seeds", "0,1", "--out", str(tmp_path / "grid"), "--json"]
    assert console.run(main, words) == console.OK
    out = capsys.readouterr().out
    assert "best on the tuning flows: gamma=0.9; evaluate it on other draws with: fishmj evaluate" in out and "run 6 of 6" in out
    assert len(instant_runs.learners) == 3, "the seeds of a point share their learner"
    told = json.loads(out.strip().splitlines()[-1])
    assert told["sweep"]["best"]["rmse_last10"] == pytest.approx(0.005) and len(told["sweep"]["rows"]) == 6
    assert read_json(tmp_path / "grid" / "sweep.json") == told
    assert (tmp_path / "grid" / "gamma=0.8" / "seed-1" / "settings.json").is_file()


def test_sweep_goes_on_where_a_run_diverges(instant_runs, tmp_path, capsys):
    assert console.run(main, [*SMALL, "--sweep", "gamma", "0.7", "0.8", "--out", str(tmp_path)]) == console.FAILED_CHECK
    out, err = capsys.readouterr()
    assert "best on the tuning flows: gamma=0.8" in out and "gamma=0.7 seed 0: non-finite figures" in err


def test_resumed_seeds_begin_with_the_policy_where_they_had_not_begun(instant_runs, tmp_path):
    words = [*SMALL, "--seeds", "0,1", "--begin", "station", "--out", str(tmp_path / "run")]
    assert console.run(main, words) == console.OK
    shutil.rmtree(tmp_path / "run" / "seed-1")
    assert console.run(main, [*words, "--resume"]) == console.OK
    assert instant_runs.begins == [(0, False, True), (1, False, True), (0, True, False), (1, False, True)]
    assert console.run(main, [*SMALL, "--begin", "station", "--resume", "--out", str(tmp_path / "run")]) == console.BAD_INPUT


def test_an_unfinished_point_is_never_the_best():
    runs = [
        PlannedRun(change(preset("quick"), seed=seed, reward={"wG": 1.0}), Path(), None, name) for name in "ab" for seed in (0, 1)
    ]
    done = lambda rmse: {"stopped": False, "tune_stayed": 1.0, "tune_rmse_last10": rmse, "tune_return": rmse}
    cut = done(0.01) | {"stopped": True}
    assert sweep_table(runs, [done(0.3), done(0.5), done(0.1), cut])["best"] == {"point": "a", "seeds": 2} | {
        "stayed": 1.0, "rmse_last10": 0.4, "return": 0.4,
    }  # fmt: skip
    assert sweep_table(runs, [done(0.3)])["best"] is None
    own = [run._replace(settings=change(preset("quick"), seed=run.settings.seed)) for run in runs]
    assert sweep_table(own, [done(0.3), done(0.5), done(0.1), done(0.1)])["best"]["point"] == "a", "a reward of its own ranks"


@pytest.mark.ray
def test_runs_over_ray_are_those_trained_here_and_resume(tmp_path):
    def trained(out, steps, *more):
        words = [*TINY, "--sweep", "gamma", "0.9", "0.99", "--steps", str(steps), "--out", str(tmp_path / out), "--json", *more]
        environ = os.environ | {"PYTHONPATH": str(ROOT)}
        command = [sys.executable, "-m", "fishmj", "train", *words]
        done = subprocess.run(command, cwd=tmp_path, env=environ, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr[-2000:]
        return json.loads(done.stdout.strip().splitlines()[-1])

    spread = ("--ray", "local:2")
    assert [run["seed"] for run in trained("ray", 256, *spread)["runs"]] == [3, 4, 3, 4]
    there = trained("ray", 512, *spread, "--resume")
    here = trained("here", 256) and trained("here", 512, "--resume")
    assert [run["steps"] for run in there["runs"]] == [512] * 4
    assert there["sweep"] == here["sweep"] and there["sweep"]["best"]
