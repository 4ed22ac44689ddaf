"""The slip calibration: what the table was read from is found again, what no ratio explains is told, a coast says little."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fishmj.base import console, interrupt
from fishmj.base.errors import LogError
from fishmj.gap.calibrate import __main__ as command
from fishmj.gap.calibrate import slip
from fishmj.gap.calibrate.calibration_logs import read
from fishmj.gap.laboratory.hidden_lbm import hidden
from fishmj.log import read_trial, write_trial

SHIPPED = Path(__file__).resolve().parent.parent / "data" / "calib" / "trials"


def test_slip_is_found_where_the_table_was_read_and_one_swim_says_less(monkeypatch):
    s = 0.985
    at = {name: (float(v[0]), 3) for name, v in slip.predictions("window", np.array([s])).items()}
    found = slip.profile(at, "window")
    assert found.estimate.low < s < found.estimate.high and found.estimate.value == pytest.approx(s, abs=0.003)
    assert found.cost.min() < 1e-2 < found.cost[0]
    whole = slip.predictions
    monkeypatch.setattr(slip, "predictions", lambda grid, at: {"gait": whole(grid, at)["gait"]})  # a table without the coast
    with pytest.raises(LogError, match="tow_ahead"):
        slip.profile({"tow_ahead": (1.0, 1)}, "window")


def test_swims_that_no_slip_ratio_explains_are_told():
    """A fish that beats slowly as if the hull were smooth and fast as if it were rough has another water."""
    ends = slip.predictions("laptop", np.array([0.97, 0.998]))
    fits = slip.profile({name: (float(v[0]), 3) for name, v in ends.items()}, "laptop")
    odd = slip.profile({"gait": (float(ends["gait"][0]), 3), "gait_slow": (float(ends["gait_slow"][1]), 3)}, "laptop")
    assert "no slip ratio explains" in odd.words and "no slip ratio" not in fits.words


def test_one_slip_ratio_explains_the_shipped_swims():
    """Two beats and a coast, read from nine trials against the table of their own grid; each swim alone agrees with all."""
    trials = read(SHIPPED).trials.values()
    found = slip.profile(swum := slip.measured(trials), slip.grid_of(trials))
    assert set(found.predicted) == {*slip.SWIMS, slip.COAST} and all(n == 3 for _, n in swum.values())
    assert found.cost.min() < 1.0 and "no slip ratio" not in found.words
    for name, value in swum.items():
        one = slip.profile({name: value}, found.grid).estimate
        assert one.low <= found.estimate.value <= one.high, name


def test_a_coast_alone_cannot_tell_the_slip_ratio():
    """On a grid of 2 cm the distance hardly changes from a hull that slides to one that sticks a little."""
    at = {"tow_ahead": (float(slip.predictions("window_coarse", np.array([0.99]))["tow_ahead"][0]), 3)}
    found = slip.profile(at, "window_coarse")
    assert found.estimate.high - found.estimate.low > 0.02 or "cannot be told" in found.words


def test_swims_that_were_finished_are_not_run_again(tmp_path, monkeypatch):
    """A table made anew, interrupted in its third swim."""
    run, said = [], []

    def swum(waiting, device, tanks):
        for job in waiting:
            if len(run) == 2 and not said:
                said.append(interrupt._kept[-1][0]())
                raise KeyboardInterrupt
            run.append((job.slip, job.what.id))
            yield SimpleNamespace(job=job)

    def trial_of(made):
        t = np.arange(0, 9, 0.02)
        tables = {"pose": {"t": t, "x": made.job.slip * t, "y": 0 * t, "yaw": 0 * t}}
        return SimpleNamespace(table=tables.get)

    monkeypatch.setattr(hidden, "run_jobs", swum)
    monkeypatch.setattr(hidden, "trial_of", trial_of)
    with pytest.raises(KeyboardInterrupt):
        slip.recompute("laptop", [0.5, 1.0], "cpu", 1, tmp_path)
    assert said == [f"{tmp_path} holds 2 of 6 swims; go on with the same command"]
    entry = slip.recompute("laptop", [0.5, 1.0], "cpu", 1, tmp_path)
    assert len(run) == len(set(run)) == 6, "the first two were kept"
    assert entry["gait"] == pytest.approx([0.5, 1.0]) and entry["tow_ahead"] == pytest.approx([2.0, 4.0])
    slip.recompute("window", [0.5], "cpu", 1, tmp_path)
    assert len(run) == 9, "another grid is another swim"


def test_speed_and_coast_are_read_from_a_path():
    t = np.arange(0, 9, 0.02)
    pose = {"t": t, "x": 0.25 * t, "y": 0 * t, "yaw": 0 * t}
    assert slip.metric("gait", pose) == pytest.approx(0.25, rel=1e-6)
    assert slip.metric("tow_ahead", pose) == pytest.approx(1.0, rel=1e-6)
    assert np.isnan(slip.metric("gait_slow", {k: v[:100] for k, v in pose.items()}))


def test_a_longer_trial_has_the_same_speed():
    """A fish still gains speed at the end: trials and table are read over the same seconds."""
    t = np.arange(0, 12.6, 0.02)
    pose = {"t": t, "x": 0.004 * t**2, "y": 0 * t, "yaw": 0 * t}
    short = {k: v[t < 8.2] for k, v in pose.items()}
    assert slip.metric("gait_slow", pose) == pytest.approx(slip.metric("gait_slow", short)) == pytest.approx(0.0472, rel=1e-3)


@pytest.mark.parametrize(("slower", "said"), [(0.1, "no slip ratio explains"), (0.0, "the fish does not move in a gait")])
def test_a_slip_that_cannot_be_told_writes_nothing(tmp_path, capsys, slower, said):
    trial = read_trial(SHIPPED / "swim_gait_1")
    pose = {c: slower * v if c in "xy" else v for c, v in trial.tables["pose"].items()}
    write_trial(tmp_path / "data" / "gait", replace(trial, tables=trial.tables | {"pose": pose}))
    where = ["--data", tmp_path / "data", "--out", tmp_path / "new.toml", "--report", tmp_path / "report"]
    assert console.run(command.main, ["slip", *map(str, where)]) == console.BAD_INPUT
    assert said in capsys.readouterr().err.strip().split("\n")[-1]
    assert [path.name for path in tmp_path.iterdir()] == ["data"]
