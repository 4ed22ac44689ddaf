"""Judging over Ray: the figures of one process, resumed controllers, refusals. Marked ray, but for what needs none."""

import json
from pathlib import Path

import numpy as np
import pytest

from fishmj import control, engines
from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.evaluate import __main__ as command
from fishmj.evaluate import run_trials, trials
from fishmj.evaluate.judge_over_ray import judge_controllers, judge_over_ray
from fishmj.mjcf import load_robot
from fishmj.water.choice import in_water

ROOT = Path(__file__).resolve().parent.parent
SOME = ["--speeds", "0.2", "--los", "0,90", "--repeats", "1", "--duration", "2"]
ARRAYS = ("pose", "velocity", "joint", "command", "obs", "power", "distance", "left")


def evaluated(out, *words):
    return console.run(command.main, ["drift", "pd", "dob", *SOME, "--out", str(out), *words])


def figures(out):
    told = json.loads((out / "results.json").read_text())
    return (out / "trials.csv").read_bytes(), [{k: v for k, v in r.items() if k != "worst"} for r in told["results"]]


def test_controllers_that_a_cluster_finished_are_not_judged_again(tmp_path, monkeypatch, capsys):
    asked = []

    def here(address, brains, robot, trials, engine, hybrid, progress):
        asked.append([brain.name for brain in brains])
        for brain in reversed(brains):
            ((_, found),) = judge_controllers([(brain.name, brain)], robot, trials, engine, hybrid)
            yield brain, found
            if len(asked) == 1:
                raise ConfigError("ray: no worker ended drift, pd")

    monkeypatch.setattr(command, "judge_over_ray", here)
    assert evaluated(tmp_path / "ray", "--ray", "auto") == console.BAD_INPUT
    assert "holds 1 of 3 controllers" in capsys.readouterr().err
    assert json.loads((tmp_path / "ray" / "results.json").read_text())["unfinished"] == ["drift", "pd"]
    assert evaluated(tmp_path / "ray", "--ray", "auto") == console.OK
    assert asked == [["drift", "pd", "dob"], ["drift", "pd"]] and not (tmp_path / "ray" / "judged").exists()
    assert evaluated(tmp_path / "here") == console.OK
    assert figures(tmp_path / "ray") == figures(tmp_path / "here")


@pytest.mark.usefixtures("catalogue")
@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["examples/own_controller.py:Chase"], "no code of your own"),
        (["pd", "--effects", "examples/own_effect.py:CABLE"], "no code of your own"),
        (["pd", "--water", "hybrid", "--device", "cuda:all"], "--device cuda:all"),
    ],
)
def test_what_a_worker_cannot_judge_is_refused(words, said, monkeypatch, capsys):
    monkeypatch.chdir(ROOT)
    assert console.run(command.main, [*words, *SOME, "--ray", "local:2"]) == console.BAD_INPUT
    assert said in capsys.readouterr().err


@pytest.mark.ray
@pytest.mark.parametrize("engine", ["batch", "compiled", "planar"])
def test_controllers_over_ray_have_the_bits_of_one_process(engine, cluster):
    robot = in_water(load_robot("fish"))
    some = trials(speeds=[0.2], los_deg=[0, 90], repeats=2, duration=2.0)
    brains = control.several(["station", "dob", "mpc-flow"], robot)
    progress = []
    found = {brain.name: made for brain, made in judge_over_ray("auto", brains, robot, some, engine, progress=progress.append)}
    assert progress[-1] == 3 * 4 * 2.0
    for brain in brains:
        here, there = run_trials.run(brain, robot, some, engines.make(engine, robot)), found[brain.name]
        assert there.engine == here.engine and there.policy_sha256 == here.policy_sha256
        for name in ARRAYS:
            np.testing.assert_array_equal(getattr(there, name), getattr(here, name))


@pytest.mark.ray
@pytest.mark.oracle
def test_trials_of_the_solver_over_ray_have_the_bits_of_one_process(cluster, tmp_path):
    robot, plan = load_robot("fish"), trials(speeds=[0.2], los_deg=[0], repeats=1, duration=1.0)
    made = control.several(["drift", "pd"], robot)
    there = run_trials.judge_each_in_solver(made, robot, plan, tmp_path, ray="auto", tanks=2, domain="laptop", device="cpu")
    here = run_trials.judge_each_in_solver(made, robot, plan, domain="laptop", device="cpu")
    for a, b in zip(there, here, strict=True):
        assert a.controller == b.controller
        for name in ARRAYS:
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
