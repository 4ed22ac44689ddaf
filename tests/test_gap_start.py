"""Where the fish was put, and what a turned camera makes of it and of the null runs."""

import numpy as np
import pytest

pytest.importorskip("numba")

from test_gap import NULL, evidence_on, hidden, row_of

from fishmj import effects
from fishmj.base.errors import LogError
from fishmj.gap.decide.decide import within_null_scatter
from fishmj.gap.models.swimming_fish import SwimmingFish
from fishmj.gap.null.whitening import changes_sensing
from fishmj.gap.records.records import ResidualLayout, record_of
from fishmj.gap.verdict import NamedEffect, Value
from fishmj.gap.workflow import investigate
from fishmj.log import physical_checks

RUNS = ("gait", "drift_north", "turn_left", "gait_fast")


@pytest.fixture(scope="module")
def turning():
    return SwimmingFish(
        catalogue=[effects.get(n) for n in ("camera_yaw", "heading_marker_offset", "joint_zero_offset", "yaw_drag")]
    )


def test_only_what_was_put_to_rest_at_a_stated_place_shows_it(turning):
    still, pushed = (record_of(t, turning.dt) for t in hidden({}, 5, ("gait", "tow_oblique")))
    assert still.placed is not None and np.abs(still.placed.values[0] - still.place).max() < 0.02
    assert pushed.placed is None and set(turning.predict([pushed], turning.null)[0]) == {"joint", "pose", "power"}
    seen = turning.predict([still], row_of(turning, "camera_yaw", angle=0.1))[0]["placed"][0, 0]
    c, s = np.cos(0.1), np.sin(0.1)
    np.testing.assert_allclose(seen[:2], [[c, -s], [s, c]] @ still.place[:2])
    assert np.isclose(seen[2], still.place[2] + 0.1)


def test_a_heading_that_passes_half_a_turn_is_where_it_was_put(turning):
    (trial,) = hidden({}, 5, ("gait",))
    x, y, yaw = trial.value("start")
    there = trial.__class__({**trial.meta, "start": [x, y, yaw + 2 * np.pi]}, trial.tables, name=trial.name)
    placed = record_of(there, turning.dt).placed.values[0]
    assert np.isclose(placed[2], record_of(trial, turning.dt).placed.values[0, 2] + 2 * np.pi)


@pytest.fixture(scope="module")
def gait_log():
    return hidden({}, 5, ("gait",))[0]


def rows_of(trial, table, keep):
    """The trial with some rows of a table."""
    columns = {
        name: np.asarray(values)[keep(np.asarray(trial.tables[table]["t"]))] for name, values in trial.tables[table].items()
    }
    return trial.__class__(trial.meta, {**trial.tables, table: columns}, name=trial.name)


@pytest.mark.parametrize("table", ["pose", "joint"])
def test_table_that_begins_after_the_joints_move_is_no_start(gait_log, table):
    with pytest.raises(LogError, match=f"{table} begins 3 s after the first command, the joints move from"):
        record_of(rows_of(gait_log, table, lambda t: t >= 3.0), 0.004)
    assert record_of(rows_of(gait_log, table, lambda t: t >= 0.2), 0.004).seconds > 5


def test_lost_rows_of_commands_are_no_held_command(gait_log):
    gap = lambda t: (t < 2.0) | (t > 5.0)  # three beats: the command goes on where it was, the joints did not rest
    with pytest.raises(LogError, match="no commands for 3.0. s from t = .* rows were lost"):
        record_of(rows_of(gait_log, "cmd", gap), 0.004)
    unread = {name: table for name, table in gait_log.tables.items() if name != "joint"}
    other = rows_of(gait_log.__class__(gait_log.meta, unread, name="other"), "cmd", lambda t: (t < 2.0) | (t > 4.7))
    with pytest.raises(LogError, match="rows were lost"):
        record_of(other, 0.004)
    with pytest.raises(LogError, match="rows were lost"):  # the joints' rows, too: their file lacks whole beats
        record_of(rows_of(rows_of(gait_log, "cmd", gap), "joint", gap), 0.004)
    held = rows_of(gait_log, "cmd", lambda t: t < 2.0)  # an end is no pause
    assert len(record_of(held, 0.004).commands) > 2000
    assert not any(find.text for find in physical_checks.examine(rows_of(gait_log, "joint", gap), ["standing still"]))


@pytest.mark.slow
def test_a_turned_camera_is_named(turning):
    verdict = investigate(turning, hidden({"camera_yaw": {"angle": 0.04}}, 12, RUNS), null=NULL).verdict
    assert verdict.answer == "NAMED" and [e.name for e in verdict.effects] == ["camera_yaw"], verdict.text()
    assert verdict.effects[0].parameters["angle"].value == pytest.approx(0.04, abs=0.004)


def test_null_runs_are_turned_with_the_camera(turning):
    """A fish that swims too far ahead goes too far to the side for a camera turned by a quarter."""
    e = evidence_on(turning, {}, 13, RUNS[:2])
    there = e.linearised_at(row_of(turning, "camera_yaw", angle=np.pi / 2))
    x, y, yaw = (next(b.where for b in e.layout.blocks if b.sensor == "pose" and b.column == k) for k in range(3))
    np.testing.assert_allclose(there.factors[: e.runs, x], -e.factors[:, y], atol=1e-12)
    np.testing.assert_allclose(there.factors[: e.runs, y], e.factors[:, x], atol=1e-12)
    np.testing.assert_allclose(there.factors[: e.runs, yaw], e.factors[:, yaw], atol=1e-12)
    drag = row_of(turning, "yaw_drag", coefficient=0.01)
    assert not changes_sensing(turning, drag) and e.linearised_at(drag).factors[: e.runs] is not None
    np.testing.assert_array_equal(e.linearised_at(drag).factors[: e.runs], e.factors)


def test_what_null_runs_scatter_as_far_is_chance(turning):
    e = evidence_on(turning, {}, 14, RUNS[:2])
    said = lambda half: NamedEffect("yaw_drag", {"coefficient": Value(0.01, "N m s2", 0.01 - half, 0.01 + half)}, 1.0, 1.0)
    assert within_null_scatter(e, (said(0.006),)) and not within_null_scatter(e, (said(0.003),))
    assert not within_null_scatter(e, (said(0.006), said(0.006))) and not within_null_scatter(e, ())
    offsets = lambda least: {f"offset{i}": Value(0.02, "rad", low, 0.05) for i, low in enumerate((-0.01, -0.01, least), 1)}
    bent = lambda least: (NamedEffect("joint_zero_offset", offsets(least), 1.0, 1.0),)
    assert within_null_scatter(e, bent(-0.01)) and not within_null_scatter(e, bent(0.01))  # one of three is told from none


def test_averages_of_what_was_measured(turning):
    records = [record_of(t, turning.dt) for t in hidden({}, 5, ("gait",))]
    layout = ResidualLayout(records)
    assert np.isclose(layout.measured[layout.blocks[-1].where][0], records[0].placed.values[0, 2])
