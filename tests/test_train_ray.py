"""Seeds over Ray: two workers on this machine. Marked ray, but for what needs none."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from fishmj.base import console
from fishmj.train import ray_seeds
from fishmj.train.__main__ import main

ROOT = Path(__file__).resolve().parent.parent
TINY = ["--preset", "quick", "--engine", "compiled", "--envs", "16", "--horizon", "8", "--minibatches", "2", "--seeds", "3,4"]


@pytest.mark.parametrize(("more", "said"), [(["--together"], "--together beside --ray"), (["--force", "--resume"], "--resume")])
def test_options_that_contradict_ray_are_refused(more, said, tmp_path, capsys):
    assert console.run(main, [*TINY, "--ray", "local:2", *more, "--out", str(tmp_path / "run")]) == console.BAD_INPUT
    assert said in capsys.readouterr().err


def test_steps_of_a_run_are_read_while_a_line_is_written(tmp_path):
    assert ray_seeds.steps_of(tmp_path) == 0
    (tmp_path / "metrics.jsonl").write_text('{"step": 128}\n{"step": 256}\n{"ste')
    assert ray_seeds.steps_of(tmp_path) == 256


@pytest.mark.ray
def test_seeds_over_ray_are_those_trained_here_and_resume(tmp_path):
    def trained(out, steps, *more):
        words = [*TINY, "--steps", str(steps), "--out", str(tmp_path / out), "--json", *more]
        environ = os.environ | {"PYTHONPATH": str(ROOT)}
        command = [sys.executable, "-m", "fishmj", "train", *words]
        done = subprocess.run(command, cwd=tmp_path, env=environ, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr[-2000:]
        return json.loads(done.stdout.strip().splitlines()[-1])["runs"]

    spread = ("--ray", "local:2")
    assert [run["seed"] for run in trained("ray", 256, *spread)] == [3, 4]
    there = trained("ray", 512, *spread, "--resume")
    here = trained("here", 256) and trained("here", 512, "--resume")
    assert [run["steps"] for run in there] == [512, 512]
    for a, b in zip(there, here, strict=True):
        assert {k: a[k] for k in a if k.startswith("tune_")} == {k: b[k] for k in b if k.startswith("tune_")}
