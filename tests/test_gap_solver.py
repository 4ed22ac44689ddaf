"""Data sets of the flow solver (synthetic): bundles, nulls that were swum elsewhere, cases of the other generator."""

import json

import numpy as np
import pytest

from fishmj.base.errors import LogError, StoreError
from fishmj.gap.bench import solver
from fishmj.gap.null.null_runs import RecordedNull, SimulatedNull
from fishmj.gap.records.records import ResidualLayout, record_of
from fishmj.log import Trial
from fishmj.log.dataset import FINE, read_bundle, write_bundle

FOLDER = solver.folder()
FIRST = FOLDER / "nulls" / "nulls_000.npz"


@pytest.fixture(scope="module")
def trials():
    return read_bundle(FIRST)


def test_a_bundle_gives_its_trials_back_within_a_step(tmp_path, trials):
    back = read_bundle(write_bundle(tmp_path / "a.npz", trials[:3]))
    assert [t.name for t in back] == [t.name for t in trials[:3]] and back[0].meta == trials[0].meta
    for a, b in zip(back, trials[:3], strict=True):
        for table, columns in b.tables.items():
            for column, values in columns.items():
                step = b.value(f"sigma.{column}", FINE * 1e-5) / FINE
                np.testing.assert_allclose(a.tables[table][column], values, atol=step)


def test_a_bundle_refuses_what_it_cannot_keep(tmp_path, trials):
    with pytest.raises(LogError, match="no trials"):
        write_bundle(tmp_path / "a.npz", [])
    with pytest.raises(LogError, match="two trials named"):
        write_bundle(tmp_path / "a.npz", [trials[0], trials[0]])
    broken = {**trials[0].tables, "pose": {**trials[0].tables["pose"], "x": np.full(530, np.nan)}}
    with pytest.raises(LogError, match="pose.x: a value is not finite"):
        write_bundle(tmp_path / "a.npz", [Trial(trials[0].meta, broken, name="a")])
    (tmp_path / "b.npz").write_bytes(b"not a bundle")
    with pytest.raises(StoreError, match="b.npz"):
        read_bundle(tmp_path / "b.npz")


def test_nulls_are_the_same_experiments_of_other_fish(trials):
    plant, records = solver.plant(), [record_of(t, solver.plant().dt) for t in trials[:2]]
    null = RecordedNull(folder=FOLDER / "nulls", without=("nulls_000",))
    layout = ResidualLayout(records)
    residuals = null.residuals(plant, records, layout)
    assert residuals.shape == (47, layout.size) and np.isfinite(residuals).all()
    own = layout.residuals(plant.predict(records, plant.null))[0]
    spread = np.sqrt((residuals**2).mean(0))
    assert 0.3 < np.sqrt(np.mean((own / spread) ** 2)) < 1.6, "a fish from which nothing is missing looks like the others"


def test_an_experiment_that_the_sets_do_not_hold_has_no_null(trials):
    plant, sets = solver.plant(), RecordedNull(folder=FOLDER / "nulls")
    assert sets.holds("gait") and not sets.holds("square") and SimulatedNull().holds("square")
    other = Trial({**trials[0].meta, "excitation": "mine"}, trials[0].tables, name="01_mine")
    with pytest.raises(LogError, match="'mine' of record 01_mine exists for 0 of 48 fish.*The sets hold burst_and_coast, chirp"):
        sets.experiment(plant, record_of(other, plant.dt))
    with pytest.raises(LogError, match="0 null sets"):
        RecordedNull(folder=FOLDER)


def test_solver_cases_are_complete_and_excluded_from_their_own_null():
    given = solver.draw()
    kinds = [one.case.kind for one in given]
    assert (kinds.count("none"), kinds.count("single")) == (48, 48)
    effects = [next(iter(one.case.effects)) for one in given if one.case.kind == "single"]
    assert len(set(effects)) >= 12 and all(effects.count(name) >= 3 for name in effects)
    assert all(one.case.id not in {path.stem for path in one.null.bundles} for one in given)
    assert {one.trials[0].value("origin") for one in given} == {"synthetic"}
    assert all("effect" not in json.dumps(t.meta) for one in given for t in one.trials), "no trial says what is hidden"
