"""Judging the paper's other two tasks: starts, moving targets, and figures with known answers."""

import json
from argparse import Namespace

import numpy as np
import pytest

from fishmj import evaluate
from fishmj.base import console
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.evaluate import __main__ as command
from fishmj.evaluate import metrics, trial_logs, trial_report
from fishmj.evaluate.metrics import Result
from fishmj.lbm_oracle.run.domain import preset
from fishmj.lbm_oracle.run.solver_water import asked_for
from fishmj.mjcf.reading import load_robot
from fishmj.tasks.reference import eight, path_length
from fishmj.water.choice import in_water

ROBOT = in_water(load_robot("fish"), "structured")


def swim(pose, task: str, **options) -> Result:
    """Result of given poses (n, T + 1, 3) in a task at 0.2 m/s."""
    n, ticks = len(pose), pose.shape[1] - 1
    settings = {"repeats": n, "duration": ticks * 0.02, "turbulence": "none", "task": task, **options}
    trials = evaluate.trials(speeds=[0.2], **({"los_deg": [90]} if task == "angle_of_attack" else {}), **settings)
    t, zeros = np.arange(ticks + 1) * 0.02, np.zeros((n, ticks + 1, 3))
    return Result(
        controller="hand", policy_sha256="", robot=ROBOT, trials=trials, engine="none", t=t, target=trials.ends()[1], pose=pose,
        velocity=np.gradient(pose, 0.02, axis=1), joint=zeros, rate=zeros, power=np.full((n, ticks), 2.0), command=zeros[:, 1:],
        obs=np.zeros((n, 1, 11)), action=None, distance=np.linalg.norm(pose[:, :, :2] - trials.targets(t), axis=-1),
        left=np.full(n, ticks + 1),
    )  # fmt: skip


def on_path(behind: float = 0.0, aside: float = 0.0, ticks: int = 3050) -> np.ndarray:
    """Poses (1, T + 1, 3) of a fish on the figure eight, `behind` the target along it and `aside` to its left, m."""
    points, heading = eight(np, 0.3 * np.arange(ticks + 1) * 0.02 - behind)
    normal = np.stack([-np.sin(heading), np.cos(heading)], -1)
    return np.concatenate([points + aside * normal, heading[:, None]], -1)[None]


def test_fish_on_the_figure_eight_has_zero_cross_track_error():
    found = metrics.figures(swim(on_path(), "figure_eight"))
    assert found["cross_track"] == pytest.approx(0, abs=2e-4) and found["on_path"] == 1
    assert found["tracking_rmse"] == pytest.approx(0, abs=1e-6)


def test_lag_along_the_path_is_no_cross_track_error():
    found = metrics.figures(swim(on_path(behind=0.3), "figure_eight"))
    assert found["cross_track"] == pytest.approx(0, abs=2e-4)
    assert 0.25 < found["tracking_rmse"][0] <= 0.3, "a chord is shorter than its arc"


def test_offset_from_the_path_is_the_cross_track_error():
    found = metrics.figures(swim(on_path(aside=0.05), "figure_eight"))
    assert found["cross_track"] == pytest.approx(0.05, abs=2e-3) and found["on_path"] == 1


def test_fish_on_the_other_branch_of_the_crossing_is_off_the_path():
    """Only the part of the path near the target counts."""
    found = metrics.figures(swim(on_path(behind=path_length() / 2), "figure_eight"))
    assert found["cross_track"][0] > 0.3


def test_figure_eight_takes_three_cycles_and_starts_on_its_path():
    trials = evaluate.trials(task="figure_eight")
    start, target = trials.ends()
    assert len(trials) == 9 and trials.duration == 61 and np.all(start[:, :2] == target) and target == pytest.approx(0)
    later = trials.targets(np.array([0.0, path_length() / 0.3, 5.0]))
    assert later.shape == (9, 3, 2) and later[:, 1] == pytest.approx(0, abs=1e-6)
    assert later[0, 2] == pytest.approx(eight(np, np.array([1.5]))[0][0])


def test_angle_of_attack_starts_on_its_target_turned_from_upstream():
    trials = evaluate.trials(task="angle_of_attack", repeats=1)
    start, target = trials.ends()
    assert np.all(start[:, :2] == target) and list(trials.speed) == [0.2] * 4 and trials.duration == 30
    turned = start[:, 2] - trials.upstream
    assert np.cos(turned) == pytest.approx([-1, 0, 1, 0], abs=1e-9) and np.sin(turned) == pytest.approx([0, -1, 0, 1], abs=1e-9)


def test_settling_time_is_the_end_of_the_last_excursion():
    pose = np.zeros((3, 1501, 3))
    pose[0, 100:400, 0] = 0.3  # outside from 2 s, back at 8 s
    pose[2, 1400:, 0] = 0.3  # outside at the end
    found = metrics.figures(swim(pose, "angle_of_attack"))
    assert list(found["settled"]) == [1, 1, 0]
    assert found["settling_time"] == pytest.approx([8.0, 0.0, np.nan], nan_ok=True)
    assert list(found["furthest"]) == [0.3, 0.0, 0.3]


def test_report_of_a_task_names_it_and_has_its_own_columns(tmp_path):
    two = [swim(on_path(aside=a), "figure_eight")._replace(controller=name) for a, name in ((0.0, "near"), (0.3, "far"))]
    trial_report.write(
        tmp_path, two, command.findings(two, Namespace(argv=["near", "far"], controllers=["near", "far"])), plots=True
    )
    page = (tmp_path / "report.html").read_text()
    assert "FIGURE EIGHT" in page and "0.000 m RMS from the path" in page and "cross-track" in page
    assert "Robot swift, shipped as fish, sha256 " in page.split("</header>")[0]
    assert "start heading along the path" in page
    assert (tmp_path / "path.png").is_file() and not (tmp_path / "radar.png").exists()
    assert "cross_track" in (tmp_path / "trials.csv").read_text().splitlines()[0]
    log = trial_logs.trial_of(two[0], 0)
    assert len(log.table("target")["t"]) == 305 and log.table("target")["x"].max() == pytest.approx(0.5, abs=1e-3)


def test_condition_of_an_angle_of_attack_says_the_angles():
    trials = evaluate.trials(task="angle_of_attack", los_deg=[180, -90.5], repeats=2)
    assert trial_report.start_of(trials) == "start heading -90.5/180 deg from upstream"
    assert trial_report.start_of(evaluate.trials(heading="uniform")) == "start heading uniform"


def test_command_judges_a_task_and_refuses_what_it_does_not_have(capsys):
    quick = ["--water", "structured", "--engine", "compiled", "--duration", "2", "--repeats", "1", "--json"]
    assert console.run(command.main, ["drift", "--task", "figure_eight", *quick]) == 0
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    (only,) = told["results"]
    assert only["task"] == "figure_eight" and only["overall"]["cross_track"]["unit"] == "m" and only["n"] == 3
    with pytest.raises(ConfigError, match="starts on its path"):
        evaluate.trials(task="figure_eight", los_deg=[45])
    with pytest.raises(ConfigError, match="states its own"):
        evaluate.trials(task="angle_of_attack", heading="uniform")
    with pytest.raises(UnknownName, match="figure_eight"):
        evaluate.trials(task="figure_eigth")


def test_cells_of_the_tank_keep_its_size_and_divide_a_bus_tick():
    water = asked_for("evaluate", None, "paper", 0.985, dx=0.015)
    box = water.box
    assert box.size == pytest.approx(preset("paper").size, abs=0.01) and box.dx == 0.015
    assert 0.02 / box.dt == pytest.approx(7) and "cells of 15 mm" in water.label
    assert preset("paper").with_cells(0.04).dt == preset("paper").dt, "no longer than the robot's step"
    with pytest.raises(ConfigError, match="--dx 0.015 beside --reference"):
        asked_for("evaluate", "reference-2", None, None, dx=0.015)
