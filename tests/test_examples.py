"""Every example of one page runs as its own docstring says, and its own assertions hold."""

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from fishmj import control
from fishmj.hydro_fit.fit.training_loop import short_op_compiler_options

FOLDER = Path(__file__).resolve().parent.parent / "examples"
QUICK = ("own_controller", "own_effect", "own_importer", "own_reward", "read_trial", "side_by_side")
DEAR = ("boat_study", "flow_solver", "gymnasium_policy", "mjx_batch", "search", "solver_suite")  # more than 5 s of CPU
ELSEWHERE = ("cylinder", "gait_map", "lab_csv", "own_mjcf", "sb3_ppo", "whole_loop")  # run by tests of their own
LONGER = ("five_links", "gap_answers", "jax_ppo", "own_code")  # stories that pages of the docs quote; tests of their own
LINES = 60


@pytest.mark.parametrize("name", [*QUICK, *(pytest.param(name, marks=pytest.mark.slow) for name in DEAR)])
def test_an_example_runs(name, tmp_path):
    """What JAX compiles is compiled as a fit's programs are: in two thirds of the time."""
    flags = [f"--{key}={str(value).lower()}" for key, value in (short_op_compiler_options("cpu") or {}).items()]
    flags = " ".join([os.environ.get("XLA_FLAGS", ""), *flags])
    environment = os.environ | {"PYTHONPATH": str(FOLDER.parent), "XLA_FLAGS": flags}
    done = subprocess.run(
        [sys.executable, FOLDER / f"{name}.py"], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) >= 1


def run(tmp_path, *words: str) -> str:
    """Standard output of an example."""
    environment = os.environ | {"PYTHONPATH": str(FOLDER.parent)}
    command = [sys.executable, FOLDER / words[0], *words[1:]]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_one_file_ppo_learns_and_judges(tmp_path):
    """Two iterations; the file is one page of code that needs nothing of fishmj.train."""
    said = run(tmp_path, "jax_ppo.py", "--steps", "16384")
    found = dict(
        re.findall(r"^(untrained|trained): return (.*) of at most 150, RMS distance of the last 10 s \d\.\d{3} m$", said, re.M)
    )
    assert found.keys() == {"untrained", "trained"} and found["trained"] != found["untrained"]
    assert said.endswith("fishmj evaluate jax_ppo.safetensors\n") and control.make(tmp_path / "jax_ppo.safetensors").notes == ()
    text = (FOLDER / "jax_ppo.py").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 200 and "import fishmj.train" not in text and "from fishmj.train" not in text


@pytest.mark.sb3
def test_stable_baselines3_in_ten_lines(tmp_path):
    pytest.importorskip("stable_baselines3")
    said = run(tmp_path, "sb3_ppo.py", "2048")
    assert re.fullmatch(r"return of 64 episodes: untrained -?\d+\.\d, trained -?\d+\.\d \(standard deviation .*\)\n", said)
    code = (FOLDER / "sb3_ppo.py").read_text(encoding="utf-8").split("preset\n\n")[1]
    assert len(code.splitlines()) <= 10


def test_examples_have_one_page_and_say_how_they_are_run():
    found = {path.stem: path.read_text(encoding="utf-8") for path in FOLDER.glob("*.py")}
    assert set(found) == {*QUICK, *DEAR, *ELSEWHERE, *LONGER}
    for name in (*QUICK, *DEAR, *ELSEWHERE):
        assert len(found[name].splitlines()) <= LINES, name
        assert f"python examples/{name}.py" in (ast.get_docstring(ast.parse(found[name])) or ""), name
