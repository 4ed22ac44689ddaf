"""How much of a gap is usual in a water that nobody has measured: by robots of others, and by the robot's own healthy swims."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fishmj.base.errors import ConfigError, LogError
from fishmj.gap.bench.bench_rows import read_rows
from fishmj.gap.commands import find
from fishmj.gap.laboratory.virtual_robot import generate
from fishmj.gap.models.swimming_fish import SwimmingFish
from fishmj.gap.null import structural_error
from fishmj.gap.null.null_runs import SimulatedNull
from fishmj.gap.records.records import ResidualLayout, record_of
from fishmj.gap.search import healthy_swims
from fishmj.gap.search.likelihood import Likelihood, launch_factors
from fishmj.gap.thresholds import frozen
from fishmj.mjcf.reading import load_robot
from studies.gap_benchmark import gates_again
from studies.structural_error.__main__ import Healthy
from studies.structural_error.sample import SOLVER
from studies.structural_error.unseen_family import level


def drawn(rng, families: int, robots: int, between: float, within: float) -> np.ndarray:
    """(families, robots) |z|^2 / m."""
    return np.exp(between * rng.standard_normal((families, 1)) + within * rng.standard_normal((families, robots)))


@pytest.mark.parametrize(("families", "between", "within"), [(3, 0.3, 0.1), (4, 0.3, 0.1), (3, 0.0, 0.2), (4, 0.1, 0.2)])
def test_nineteen_of_twenty_robots_of_a_new_family_stay_below_the_level(families, between, within):
    rng = np.random.default_rng(3)
    below = []
    for _ in range(600):
        known, new = drawn(rng, families, 8, between, within), drawn(rng, 1, 1, between, within)[0, 0]
        below.append(new < level(known.tolist(), 0.95))
    assert 0.92 < np.mean(below) < 0.99


def test_quantile_over_robots_of_three_families_undercovers_a_fourth():
    rng = np.random.default_rng(4)
    tries = [(drawn(rng, 3, 8, 0.3, 0.1), drawn(rng, 1, 1, 0.3, 0.1)[0, 0]) for _ in range(600)]
    assert np.mean([new < np.quantile(known, 0.95) for known, new in tries]) < 0.85


def test_families_that_are_alike_have_the_quantile_of_their_robots():
    known = drawn(np.random.default_rng(5), 4, 400, 0.0, 0.2)
    assert level(known.tolist(), 0.95) == pytest.approx(np.quantile(known, 0.95), rel=0.03)
    assert level([[1.5, 1.5], [1.5, 1.5]], 0.95) == pytest.approx(1.5)
    with pytest.raises(ConfigError, match="1 families of 3 robots; expected 2 of 2"):
        level([[1.0, 1.1, 1.2]], 0.95)


def test_own_healthy_swims_widen_the_gate_and_never_narrow_it():
    given = structural_error.widths("foil")._replace(adequacy=1.5, beyond_own=1.25)
    gate = lambda own: structural_error.allowed(frozen(), given, own)
    assert gate(0.0).adequacy == gate(0.8).adequacy == 1.5
    assert gate(2.0).adequacy == gate(2.0).residual == 2.5
    assert gate(2.0).gain == frozen().calibrated_gain


def test_every_family_left_out_has_a_ratio():
    ratios = {name: structural_error.widths(name).beyond_own for name in ("", "morison", "foil", "ellipsoid", "solver")}
    assert all(1.0 < ratio < 2.5 for ratio in ratios.values()), ratios


def test_healthy_swims_say_nothing_of_a_water_of_literature_values():
    model = SwimmingFish(load_robot("fish"))
    assert healthy_swims.read_healthy_swims(model, generate({}, ["gait"], seed=3), SimulatedNull(runs=12)) is None


def test_swims_of_a_water_that_was_not_calibrated_are_refused(tmp_path):
    healthy = tmp_path / "healthy swims"
    with pytest.raises(ConfigError, match=f"the water of fish was not calibrated; fishmj calibrate water '{healthy}' calibrates"):
        find.swims(type("Args", (), {"healthy": healthy, "model": "fish"}), load_robot("fish"))
    assert find.swims(type("Args", (), {"healthy": None}), load_robot("fish")) == []


def test_no_swim_is_no_evidence(monkeypatch):
    monkeypatch.setattr(healthy_swims, "applies", lambda model: True)
    with pytest.raises(LogError, match="no healthy swim found"):
        healthy_swims.read_healthy_swims(None, [], SimulatedNull())


def test_stated_launch_uncertainty_absorbs_a_wrong_launch_speed():
    model = SwimmingFish(load_robot("fish"))
    (trial,) = generate({}, ["tow_ahead"], seed=3)
    u, v, r = trial.meta["push"]
    null = SimulatedNull(runs=12)
    gaps = {}
    for off, sigma in ((0.0, 0.0), (0.04, 0.0), (0.04, 0.02)):
        told = replace(trial, meta=trial.meta | {"push": [u - off, v, r], "push_sigma": [sigma, 0.0, 0.0]})
        record = record_of(told, model.dt)
        layout = ResidualLayout([record])
        moved = launch_factors(model, [record], layout)
        assert moved.shape == (3 if sigma else 0, layout.size)
        runs = null.residuals(model, [record_of(trial, model.dt)], layout)
        gaps[off, sigma] = Likelihood(model, [record], runs).gap(model.null)[0]
    assert gaps[0.04, 0.0] > 3.0 * gaps[0.0, 0.0] and gaps[0.04, 0.02] < 1.5 * gaps[0.0, 0.0], gaps


def test_redecided_solver_rows_reproduce_the_answers_of_the_search():
    rows = read_rows(Path(__file__).resolve().parent.parent / "studies" / "gap_benchmark" / "rows" / "solver_21.jsonl")
    decided = [row for row in rows if "gates" in row]
    before = [gates_again.redecide(row, gates_again.gates_of(row, {})) for row in decided]
    changed = [(row["answer"], now) for row, now in zip(decided, before, strict=True) if row["answer"] != now]
    assert len(decided) == 81 and changed == [("UNEXPLAINED", gates_again.SEARCH)]  # one that a veto held
    wide = [gates_again.redecide(row, replace(frozen(), adequacy=9.0)) for row in decided if row["kind"] == "none"]
    assert wide.count("AGREES") == 26 and wide.count("CLASS") == 2


def test_a_family_without_free_swims_takes_no_part_in_the_ratio():
    new, own = [1.0, 1.1, 0.9, 1.0, 1.05, 0.95, 9.0, 8.0], [1.0, 1.0, 1.0, 1.0, 1.0, 1.0, np.nan, np.nan]
    families = ["foil"] * 3 + ["morison"] * 3 + [SOLVER] * 2
    told = Healthy(families, new, own, [{}] * 8)
    assert told.beyond_own == pytest.approx(level([new[:3], new[3:6]], 0.95))
