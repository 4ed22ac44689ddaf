"""Every example of one page runs as its own docstring says, and its own assertions hold."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

from fishmj.hydro_fit.fit.descent import quick

FOLDER = Path(__file__).resolve().parent.parent / "examples"
QUICK = ("own_controller", "own_effect", "own_importer", "own_reward", "read_trial", "side_by_side")
DEAR = ("boat_study", "flow_solver", "gymnasium_policy", "mjx_batch", "search", "solver_suite")  # more than 5 s of CPU
ELSEWHERE = ("gait_map", "lab_csv", "whole_loop")  # run by tests of their own
LONGER = ("five_links", "gap_answers", "own_code")  # stories that pages of the docs quote; tests of their own
LINES = 60


@pytest.mark.parametrize("name", [*QUICK, *(pytest.param(name, marks=pytest.mark.slow) for name in DEAR)])
def test_an_example_runs(name, tmp_path):
    """What JAX compiles is compiled as a fit's programs are: in two thirds of the time."""
    flags = [f"--{key}={str(value).lower()}" for key, value in (quick("cpu") or {}).items()]
    flags = " ".join([os.environ.get("XLA_FLAGS", ""), *flags])
    environment = os.environ | {"PYTHONPATH": str(FOLDER.parent), "XLA_FLAGS": flags}
    done = subprocess.run(
        [sys.executable, FOLDER / f"{name}.py"], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) >= 1


def test_examples_have_one_page_and_say_how_they_are_run():
    found = {path.stem: path.read_text(encoding="utf-8") for path in FOLDER.glob("*.py")}
    assert set(found) == {*QUICK, *DEAR, *ELSEWHERE, *LONGER}
    for name in (*QUICK, *DEAR, *ELSEWHERE):
        assert len(found[name].splitlines()) <= LINES, name
        assert f"python examples/{name}.py" in (ast.get_docstring(ast.parse(found[name])) or ""), name
