"""The benchmark's bookkeeping: what is kept, what is scored, and cases side by side."""

import json
import math
import os

import pytest

from fishmj.base import console
from fishmj.base.errors import ConfigError, UsageError
from fishmj.base.workers import ask_all
from fishmj.gap.bench import bench_command, bench_rows, cases, solver
from fishmj.gap.bench.score import score

ROW = {"id": "a", "kind": "single", "answer": "NAMED", "truth": {"command_latency": {"delay": 0.05}}, "rivals": []}
ROW |= {"true_gap": 9.0, "beyond_gap": 9.0, "gap_unseen": None, "gap_before": 2.0, "seconds": 1.0}


def named(*values):
    return ROW | {"said": [{"name": "command_latency", "p_best": 1.0, "values": {"delay": list(values)}}]}


def test_a_name_without_a_number_is_right_and_has_no_error():
    said = console.plain(named(math.nan, math.nan, math.nan))
    assert said["said"][0]["values"]["delay"] == [None] * 3
    found = score([said])
    assert found["precision"]["hits"] == 1 and found["parameter_error_median"] is None and found["interval_coverage"]["n"] == 0


def test_an_error_and_an_interval():
    found = score([named(0.045, 0.04, 0.06), named(0.05, 0.02, 0.04)])
    assert found["parameter_error_median"] == pytest.approx(0.05) and found["interval_coverage"]["hits"] == 1


@pytest.mark.parametrize("jobs", [1, 2])
def test_every_case_is_answered_once(jobs):
    before = dict(os.environ)
    assert sorted(ask_all([1.0, 4.0, 9.0], math.sqrt, jobs)) == [1.0, 2.0, 3.0]
    assert dict(os.environ) == before


def test_a_case_that_fails_is_heard_of():
    with pytest.raises(ValueError, match="math domain error|nonnegative"):
        list(ask_all([-1.0, 4.0], math.sqrt, 2))


def test_a_process_has_a_core_and_a_thread_of_its_own():
    if not hasattr(os, "sched_getaffinity"):
        pytest.skip("this system binds no process to a core")
    assert all(len(cores) == 1 for cores in ask_all([0, 0, 0], os.sched_getaffinity, 2))
    assert list(ask_all(["OMP_NUM_THREADS"] * 2, os.getenv, 2)) == [os.environ.get("OMP_NUM_THREADS", "1")] * 2


def test_cases_that_hide_some_effects_are_those_that_were_dealt():
    dealt = [solver.SolverCase(case, None, None) for case in cases.draw(60, 3, small=True)]
    asked = ("tether", "command_latency")
    some = bench_command.hiding_any(dealt, asked)
    assert some and some == [one for one in dealt if set(asked) & set(one.case.effects)] and len(some) < len(dealt)
    assert bench_command.hiding_any(dealt, None) == dealt


def test_an_effect_that_there_is_none_of_and_measured_sets_are_refused():
    with pytest.raises(UsageError, match="tethre.*Did you mean 'tether'"):
        bench_command.main(["--effects", "tethre"])
    with pytest.raises(ConfigError, match="--effects goes with"):
        bench_command.main(["--effects", "tether", "--generator", "log"])


class Asked:
    def __init__(self, name):
        self.id = name


def test_rows_are_kept_and_not_made_again(tmp_path):
    made = []

    def ask(one):
        made.append(one.id)
        return {"id": one.id}

    todo = [Asked("a"), Asked("b"), Asked("c")]
    (tmp_path / "rows.jsonl").write_text(json.dumps({"id": "b", "kept": True}) + "\n" + '{"id": "c", "ke')
    assert bench_rows.judge_cases(todo, tmp_path, ask) == [{"id": "a"}, {"id": "b", "kept": True}, {"id": "c"}]
    assert made == ["a", "c"]
    assert [row["id"] for row in bench_rows.read_rows(tmp_path / "rows.jsonl")] == ["b", "a", "c"]  # the cut line took none along
