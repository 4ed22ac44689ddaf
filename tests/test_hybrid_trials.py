"""The hybrid judged by what a right water is off itself; its solver is made up here, as in test_hybrid.py."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from test_hybrid import MORE, Better, swum

from fishmj import engines
from fishmj.engines.hybrid import HybridOptions
from fishmj.engines.hybrid import tanks as tanks_of_the_solver
from fishmj.engines.hybrid.hybrid_segment import Replay
from fishmj.evaluate import run_trials
from fishmj.lbm_oracle.run.solver_water import PLAIN, REFERENCE
from fishmj.mjcf import load_robot
from fishmj.water import choice
from fishmj.water.dynamics import planar_chain
from fishmj.water.flow import Flow
from studies.hybrid_trials import hybrid_trials_command


def arguments(*more):
    args = hybrid_trials_command.options().parse_args(["--device", "cpu", "--tanks", "1", *more])
    return args, {name: hybrid_trials_command.condition(name, args) for name in hybrid_trials_command.WRONG}


def test_what_is_wrong_is_wrong_about_the_water_or_the_tank_alone():
    args, all_of_them = arguments()
    right = all_of_them["none"]
    for name, one in all_of_them.items():
        water = one.options(args).solver(one.robot)
        assert water == PLAIN._replace(domain="window_coarse", slip=0.98 if name == "slip" else 1.0)
        assert choice.label(one.robot) == ("swift-noslip" if name == "tail" else "swift")
    k, wrong = (np.array(one.robot.water["k"]) for one in (right, all_of_them["added_mass"]))
    np.testing.assert_allclose(wrong / k, [1, 1, 1, 0.7])
    short = all_of_them["tail"].chain
    assert (
        short._replace(strips=right.chain.strips) == right.chain and short.strips.mu[-1][0] < 0.95 * right.chain.strips.mu[-1][0]
    )
    assert all_of_them["stream"].options(args).tank.speed == pytest.approx(0.25)


def test_the_tanks_have_the_slip_and_the_boundary_of_the_water_that_is_asked_for():
    """Also where the condition's own fit was made in other tanks, as that of the sticking hull."""
    args, all_of_them = arguments("--model", "swift-reference", "--noslip", "swift-noslip")
    right = PLAIN._replace(domain=REFERENCE.window, slip=REFERENCE.slip, sharpness=REFERENCE.sharpness)
    for name, one in all_of_them.items():
        expected = right._replace(slip=0.97) if name == "slip" else right
        assert one.options(args).solver(one.robot) == expected
    assert HybridOptions().solver(choice.in_water(load_robot("fish"), "swift-reference")) == right


def test_a_shorter_tail_swims_slower():
    """The same commands in the water of another chain."""
    _, all_of_them = arguments()
    tail = all_of_them["tail"]
    whole = dataclasses.replace(tail, chain=planar_chain.chain_of(tail.robot))
    far = [-swum(one.engine(), flows=(Flow(),))[0, -1, 0] for one in (tail, whole)]
    assert 0.0 < far[0] < far[1]


def test_the_trials_go_round_before_they_repeat():
    args, _ = arguments("--episodes", "12")
    items = hybrid_trials_command.trials_of(args).items
    assert len({item.los for item in items[:8]}) == 8 and [item.repeat for item in items] == [0] * 8 + [1] * 4
    told, tank = (
        hybrid_trials_command.trials_of(args),
        hybrid_trials_command.TankTrials(**vars(hybrid_trials_command.trials_of(args)), faster=0.05),
    )
    points = np.random.default_rng(2).normal(size=(20, 3))
    for slow, fast in zip(told.flows(), tank.flows(), strict=True):
        np.testing.assert_allclose(fast.at(points, 0.0) - slow.at(points, 0.0), np.tile([0.05, 0, 0], (20, 1)), atol=1e-9)


def measured(alone: float, hybrid: float, place: float = 0.0, seed: int = 4) -> dict:
    """Row of a condition of twelve trials whose RMSE in MuJoCo, alone and corrected, is off by so many m; 2 mm of chance."""
    noise = np.random.default_rng(seed).normal(size=(3, 12)) * 0.002
    rows = {}
    for swim, more, wobble in zip(("solver", "alone", "hybrid"), (0.0, alone, hybrid), noise, strict=True):
        far = 0.017 * np.ones(12) + (place if swim == "hybrid" else 0.0)
        rows[swim] = {"rmse": 0.022 + more + wobble, "speed": 0.02 + wobble / 4, "place": far}
    return hybrid_trials_command.compared(rows) | {"solver_share": 0.06}


CONTROL = measured(0.002, 0.0015)


def test_right_water_with_a_small_clear_error_passes_as_its_own_control():
    """A surrogate within its tolerance is off by more than two standard errors of many trials; no correction is asked of it."""
    control = hybrid_trials_command.judged(CONTROL, None)
    rmse = control["off"][0]
    assert abs(rmse["alone"]["value"]) > 2 * rmse["standard_error"] and rmse["left"] > 0.5
    assert control["ok"] and not control["first_kind"]
    again = hybrid_trials_command.judged(measured(0.002, 0.0015, seed=5), CONTROL)
    assert again["ok"] and not again["first_kind"]


def test_control_that_is_off_itself_or_is_made_worse_is_missed():
    assert not hybrid_trials_command.judged(measured(0.03, 0.001), None)["ok"]
    assert not hybrid_trials_command.judged(measured(0.002, 0.006), None)["ok"]
    assert not hybrid_trials_command.judged(measured(0.002, 0.0015, place=0.002), None)["ok"]
    assert not hybrid_trials_command.judged(CONTROL | {"solver_share": 0.2}, None)["ok"]


@pytest.mark.parametrize(
    ("alone", "hybrid", "first", "ok"),
    [
        (0.1, 0.04, True, True),
        (0.1, 0.06, True, False),
        (0.006, 0.003, True, True),  # half is left, as much as the right water's
        (-0.1, -0.04, True, True),
        (0.0025, 0.002, False, True),  # what the right water is off, too
        (0.0025, 0.02, False, False),
    ],
)
def test_hybrid_condition_is_judged_by_what_the_right_water_is_off(alone, hybrid, first, ok):
    found = hybrid_trials_command.judged(measured(alone, hybrid), CONTROL)
    assert (found["first_kind"], found["ok"]) == (first, ok)


def test_stored_conditions_and_the_page_say_which_correction_holds():
    folder = Path(__file__).resolve().parent.parent / "studies" / "fitted_water" / "rows" / "hybrid"
    rows = {name: json.loads((folder / f"{name}.json").read_text()) for name in hybrid_trials_command.WRONG}
    page = (folder.parents[3] / "docs" / "simulate" / "results.md").read_text()
    for name, row in rows.items():
        again = hybrid_trials_command.judged(row, None if name == "none" else rows["none"])
        assert again == row, f"{name}: the stored row has another judgement"
        (line,) = [line for line in page.splitlines() if line.startswith("|") and f"(`{name}`)" in line]
        assert ("missed" in line, "holds" in line) == (not row["ok"], row["ok"])


@pytest.mark.slow
def test_the_verb_swims_three_times_and_goes_on_where_it_was(tmp_path, monkeypatch, capsys):
    """The solver's trials are MuJoCo's own in the faster stream: the stream alone is wrong, and the correction finds it."""
    swum_before: list = []
    options: list = []

    def tanks(robot, water, **given):
        options.append(given)
        return Better(Replay(robot), stream=MORE)

    def solved(brain, robot, trials, folder, **water):
        swum_before.append(water)
        return run_trials.run(brain, robot, trials, engines.make("batch", robot))

    monkeypatch.setattr(tanks_of_the_solver, "Tanks", tanks)
    monkeypatch.setattr(hybrid_trials_command.run_trials, "judge_in_solver", solved)
    asked = "--wrong stream --episodes 2 --seconds 35 --own 0.5 --device cpu --json --out".split()
    code = hybrid_trials_command.main([*asked, str(tmp_path)])
    found = json.loads(capsys.readouterr().out.strip().splitlines()[-1])
    assert swum_before[0]["water"].domain == "window_coarse" and options[-1]["stream"].speed == pytest.approx(0.25)
    assert [row["condition"] for row in found["conditions"]] == ["none", "stream"] and code == (0 if found["ok"] else 1)
    stream = found["conditions"][1]
    assert stream["solver_share"] == pytest.approx(0.1, rel=0.01)
    assert all(report["segments"][0]["moved"] and report["stream"][0] > 0.03 for report in stream["reports"])
    place = stream["same"][1]
    assert place["hybrid"] < place["alone"]
    assert hybrid_trials_command.main([*asked, str(tmp_path)]) == code and len(swum_before) == 2


@pytest.mark.slow
def test_water_that_is_right_by_construction_passes(tmp_path, monkeypatch, capsys):
    """The better water is MuJoCo's own, in the trials by another engine and in the segments by the closed form."""
    monkeypatch.setattr(tanks_of_the_solver, "Tanks", lambda robot, *_, **given: Better(Replay(robot)))
    solved = lambda brain, robot, trials, folder, **water: run_trials.run(brain, robot, trials, engines.make("planar", robot))
    monkeypatch.setattr(hybrid_trials_command.run_trials, "judge_in_solver", solved)
    asked = "--wrong none --episodes 6 --seconds 35 --device cpu --json --out".split()
    assert hybrid_trials_command.main([*asked, str(tmp_path)]) == 0
    (row,) = json.loads(capsys.readouterr().out.strip().splitlines()[-1])["conditions"]
    assert row["ok"] and not any(segment["moved"] for report in row["reports"] for segment in report["segments"])
