"""Controllers in two waters: which pairs count, Kendall's tau, gaps, resuming, and the whole command with a made-up solver."""

import json
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from fishmj import control, engines
from fishmj.base import console, interrupt
from fishmj.base.errors import UsageError
from fishmj.engines import lbm
from fishmj.evaluate import figures, metrics, trials
from fishmj.hydro_fit.__main__ import main
from fishmj.lbm_oracle.run.domain import preset
from fishmj.lbm_oracle.run.solver_water import PLAIN
from fishmj.mjcf import load_robot
from fishmj.water.flow import stack
from fishmj.water.hydro_model import HydroModel
from studies.rank_waters import compare_waters, rank
from studies.rank_waters import rank_waters_command as rank_command

ROBOT = load_robot("fish")
KEY = "rmse_after_arrival"
WOBBLE = 0.01 * np.array([1.0, -0.6, 0.3, -1.0, 0.7, -0.4, 0.5, -0.5])  # m, what differs from trial to trial


def water(**means):
    """Figures of eight trials; each controller's scatter is turned on by one, so that no paired difference is constant."""
    return {name: mean + np.roll(WOBBLE, i) for i, (name, mean) in enumerate(means.items())}


def rows(a, b):
    """Pairs as `kendall` reads them, from two lists of means."""
    two = combinations(range(len(a)), 2)
    return [{"solver": {"value": a[j] - a[i]}, "surrogate": {"value": b[j] - b[i]}} for i, j in two]


@pytest.mark.parametrize("a, b", [([1, 2, 3, 4], [1, 3, 2, 4]), ([1, 2, 2, 4, 5], [2, 1, 3, 3, 0]), ([1, 2, 3], [3, 2, 1])])
def test_tau_is_the_tau_b_of_the_textbook_ties_included(a, b):
    from scipy.stats import kendalltau

    assert rank.kendall(rows(a, b)) == pytest.approx(kendalltau(a, b).statistic, abs=1e-12)


def test_no_pair_has_no_tau():
    assert np.isnan(rank.kendall([])) and np.isnan(rank.kendall(rows([1, 1], [1, 2])))


def test_a_pair_within_its_interval_in_either_water_does_not_count():
    solver = water(dob=0.1, pi=0.2, pd=0.201, paper=0.3)  # pi and pd cannot be told apart here
    surrogate = water(dob=0.1, pi=0.2, pd=0.31, paper=0.309)  # nor pd and paper here
    found = rank.judged(KEY, [solver], [surrogate])
    left_out = {(row["a"], row["b"]) for row in found["pairs"] if not row["counted"]}
    assert left_out == {("pi", "pd"), ("pd", "paper")}
    assert (found["counted"], found["of"]) == (4, 6) and found["told_apart"] == {"solver": 5, "surrogate": 5}
    assert found["tau"] == 1.0 and found["passed"]["tau"] is True
    assert found["tau_all_pairs"] == pytest.approx(4 / 6), "the pair that only looks swapped would have cost a third"


def test_swapped_controllers_fail_and_the_tau_says_how_many():
    found = rank.judged(KEY, [water(dob=0.1, pi=0.2, pd=0.3)], [water(dob=0.1, pi=0.3, pd=0.2)])
    assert found["counted"] == 3 and found["tau"] == pytest.approx(1 / 3) and found["passed"] == {"gap_max": False, "tau": False}


def test_drift_is_shown_and_neither_ranked_nor_judged():
    found = rank.judged(KEY, [water(dob=0.1, pi=0.2, drift=1.0)], [water(dob=0.11, pi=0.21, drift=2.0)])
    assert [row["controller"] for row in found["controllers"]] == ["dob", "pi", "drift"] and found["of"] == 1
    assert found["gap_max"] == pytest.approx(0.01) and found["passed"] == {"gap_max": True, "tau": True}


def test_what_the_solver_itself_moves_by_is_allowed_twice():
    solver, surrogate = water(dob=0.1, pi=0.2), water(dob=0.15, pi=0.25)
    again = [water(dob=0.13, pi=0.201), water(dob=0.09, pi=0.2)]
    again[1]["pi"][0] = np.nan
    found = rank.judged(KEY, [solver, *again], [surrogate])
    assert [row["allowed"] for row in found["controllers"]] == pytest.approx([0.06, rank.GAP])
    assert [row["within"] for row in found["controllers"]] == [True, False] and found["passed"]["gap_max"] is False


def test_the_gap_of_repeated_trials_is_between_the_means_of_their_runs():
    solver, surrogate = [water(dob=0.1), water(dob=0.11)], [water(dob=x) for x in (0.2, 0.1, 0.15)]
    surrogate[0]["dob"][3] = solver[1]["dob"][5] = np.nan
    row = rank.judged(KEY, solver, surrogate)["controllers"][0]
    per_trial = np.full(8, 0.15 - 0.105)
    per_trial[3], per_trial[5] = 0.125 - 0.105, 0.15 - 0.1
    assert (row["n"], row["runs"]) == (8, [2, 3]) and row["gap"]["value"] == pytest.approx(per_trial.mean())


def test_the_worst_controller_decides_the_gap():
    found = rank.judged(KEY, [water(dob=0.1, pi=0.2)], [water(dob=0.1, pi=0.221)])
    assert found["gap_max"] == pytest.approx(0.021) and found["passed"]["gap_max"] is False
    assert [row["within"] for row in found["controllers"]] == [True, False]


def test_too_few_trials_tell_nobody_apart():
    few = lambda w: {name: x[: metrics.APART - 1] for name, x in w.items()}
    found = rank.judged(KEY, [few(water(dob=0.1, pi=0.9))], [few(water(dob=0.1, pi=0.9))])
    assert found["counted"] == 0 and found["passed"]["tau"] is None and np.isnan(found["tau"])


def test_a_trial_that_the_solver_lost_is_left_out_of_both_waters():
    solver, surrogate = water(dob=0.1, pi=0.2), water(dob=0.1, pi=0.2)
    solver["dob"][0], surrogate["dob"][0] = np.nan, 50.0
    row = rank.judged(KEY, [solver], [surrogate])["controllers"][0]
    assert (row["n"], row["lost"]) == (7, 1) and row["gap"]["value"] == pytest.approx(0)


def test_controller_without_whole_trials_is_undecided_unless_another_fails():
    none = {"pd": np.full(8, np.nan)}
    found = rank.judged(KEY, [water(dob=0.1) | none], [water(dob=0.1) | none])
    assert found["gap_max"] == pytest.approx(0) and found["passed"] == {"gap_max": None, "tau": None}
    assert rank.judged(KEY, [water(dob=0.1) | none], [water(dob=0.3) | none])["passed"]["gap_max"] is False


def test_every_beginning_of_the_order_is_spread_over_speeds_and_directions():
    plan = trials()
    order = compare_waters.spread(plan).items
    assert sorted(order) == sorted(plan.items) and all(t.repeat == 0 for t in order[:24])
    assert len({(t.speed, t.los) for t in order[:24]}) == 24
    assert len({t.los for t in order[:8]}) == 8 and [t.speed for t in order[:6]] == [0.1, 0.2, 0.3] * 2
    four = trials(speeds=[0.1, 0.2], los_deg=[0, 90, 180, 270], repeats=1)
    assert sorted(compare_waters.spread(four).items) == sorted(four.items), "also where the counts share a factor"


def test_the_figures_of_a_whole_trial_are_the_judges():
    plan = trials(speeds=[0.1], los_deg=[0, 180], repeats=1)
    result = compare_waters.in_surrogate(ROBOT)(control.make("paper", ROBOT), plan, lambda k: None)
    mine, decided = compare_waters.figures(result), figures(result)
    np.testing.assert_array_equal(mine["rmse_after_arrival"], decided["rmse_after_arrival"])
    np.testing.assert_array_equal(mine["rmse_holding"], decided["rmse_last20"])


class MadeUp:
    """A solver: the unfitted strips behind the tanks' interface. `asked` counts trials, `patience` ends the process's luck."""

    asked, patience, words = 0, 1000, ""
    stopped: list[str] = []

    def __init__(self, robot, flows, *, domain, slip, device, finer=1, **immersed):
        type(self).asked += len(flows)
        if self.asked > self.patience:
            type(self).words = interrupt._kept[-1][0]()
            raise KeyboardInterrupt
        self.domain = preset(domain)
        self.body, self.current, self.stopped = engines.make("batch", robot), stack(flows), [""] * len(flows)

    def advance(self, state, commands, params, current, tick):
        return self.body.advance(state, commands, params, self.current, tick)


@pytest.fixture
def solver(monkeypatch):
    made = type("Fresh", (MadeUp,), {})
    monkeypatch.setattr(lbm, "LbmEngine", made)
    return made


def command(out, *more):
    model = [] if "--model" in more else ["--model", "swift-base"]
    return main(["rank", "--device", "cpu", "--domain", "laptop", "--seconds", "2", "--out", str(out), *model, *more])


@pytest.mark.parametrize(("asked", "box"), [([], "window_coarse"), (["--domain", "laptop"], "laptop")])
def test_the_solver_has_the_box_of_the_model_where_no_other_is_asked_for(asked, box, tmp_path, monkeypatch):
    def refused(verb, device, work, **rest):
        raise UsageError(f"in {[domain.name for domain, _ in work]}")

    monkeypatch.setattr(rank_command.solver_cost, "agree", refused)
    with pytest.raises(UsageError, match=rf"in \['{box}'\]"):
        main(["rank", "pd", "--model", "swift", "--out", str(tmp_path), *asked])


def test_an_interrupted_run_goes_on_where_it_was(tmp_path, solver):
    solver.patience = 3
    with pytest.raises(KeyboardInterrupt):
        command(tmp_path, "pd", "drift", "--trials", "2")
    assert len(list(tmp_path.rglob("*.npz"))) == 3
    assert "lbm holds 3 finished trials of the solver; go on with" in solver.words and str(tmp_path) in solver.words
    solver.patience = 1000
    command(tmp_path, "pd", "drift", "--trials", "2")
    assert solver.asked == 4 + 1, "the fourth was begun twice, the first three were kept"
    whole = json.loads((tmp_path / "rank.json").read_text())
    began = HydroModel.load("swift-base")
    slippery = replace(began, name="slippery", base=began.base._replace(ke=0.5 * began.base.ke)).save(tmp_path)
    command(tmp_path, "pd", "drift", "--trials", "2", "--model", str(slippery))
    assert solver.asked == 5, "another surrogate needs no new trial in the solver"
    other = json.loads((tmp_path / "rank.json").read_text())
    assert other["by_trial"]["solver"] == whole["by_trial"]["solver"]
    assert other["by_trial"]["surrogate"] != whole["by_trial"]["surrogate"]


def test_a_budget_leaves_whole_trials_of_all_controllers(tmp_path, solver, capsys):
    command(tmp_path, "pd", "pi", "--trials", "3", "--budget", "1e-9")
    found = json.loads((tmp_path / "rank.json").read_text())
    assert solver.asked == 2 and found["trials"]["n"] == 1 and found["trials"]["asked"] == 3
    assert "1 of 3 trials are finished" in capsys.readouterr().err


def test_the_command_ranks_draws_and_says_that_it_is_a_preview(tmp_path, solver, capsys):
    code = command(tmp_path, "paper", "pd", "drift", "--trials", "6", "--tanks", "6", "--json")
    *said, last = capsys.readouterr().out.strip().splitlines()
    found = json.loads(last)
    assert found["preview"] is True and any("preview, not a judgement" in line for line in said)
    assert found["model"] == "swift-base" and found["origin"] == "synthetic"
    judged = found[KEY]
    assert judged["of"] == 1 and [row["n"] for row in judged["controllers"]] == [6, 6, 6]
    assert code == {True: 0, False: 1, None: 3}[found["ok"]]
    assert (tmp_path / "rank.png").read_bytes().startswith(b"\x89PNG")


def test_the_solver_is_asked_again_a_part_of_a_cell_away_and_both_are_kept(tmp_path, solver, capsys):
    for _ in range(2):
        command(tmp_path, "pd", "--trials", "2", "--again", "1")
        found = json.loads((tmp_path / "rank.json").read_text())
        assert solver.asked == 4, "two trials and their repeats; the second time all were kept"
        first, again = (run["pd"][KEY] for run in found["by_trial"]["solver"])
        assert 1e-4 < np.abs(np.subtract(first, again)).max() < 0.02, "the fish began a few mm elsewhere"
        swum = [run["pd"][KEY][0] for run in found["by_trial"]["surrogate"]]
        assert len(set(swum)) == 1 + compare_waters.OFTEN and np.ptp(swum) < 0.02, "in the surrogate, too, each time"
        assert found[KEY]["controllers"][0]["repeats"] == pytest.approx([np.mean(np.subtract(again, first))])
    assert "solver again" in capsys.readouterr().out


def test_the_same_water_twice_has_no_gap(solver, tmp_path):
    brains = [control.make(name, ROBOT) for name in ("pd", "paper")]
    plan = compare_waters.spread(trials(repeats=1, duration=2.0, speeds=[0.2]))
    solved = compare_waters.in_solver(ROBOT, tmp_path, PLAIN._replace(domain="laptop"), device="cpu", tanks=8)
    _, a = compare_waters.solve(brains, plan, solved, group=8)
    b = compare_waters.swim(brains, plan, compare_waters.in_surrogate(ROBOT))
    found = rank.judged(KEY, *([{name: figures[KEY] for name, figures in water.items()}] for water in (a, b)))
    assert found["gap_max"] == pytest.approx(0, abs=1e-12), "targets, flows, fish, latencies and noise are the same"


@pytest.mark.parametrize("wrong", [["--trials", "0"], ["--trials", "73"], ["--tanks", "0"]])
def test_impossible_numbers_are_one_clear_error(wrong, tmp_path):
    with pytest.raises(UsageError, match=wrong[0]):
        command(tmp_path, *wrong)


def test_hours_on_a_cpu_that_nobody_asked_for_are_not_begun(tmp_path, solver, monkeypatch, capsys):
    monkeypatch.setattr(rank_command.solver_cost, "accelerator", lambda need: False)
    assert console.run(main, ["rank", "--device", "auto", "--model", "swift-base", "--out", str(tmp_path)]) == 2
    assert solver.asked == 0 and "nothing was begun" in capsys.readouterr().err
