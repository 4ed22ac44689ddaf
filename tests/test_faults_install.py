"""Faults of an installation: packages that are missing, and what still works without them."""

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace

import pytest

import fishmj
from fishmj.train.settings import change, preset
from fishmj.train.training_run import TrainingRun

ROOT = Path(__file__).resolve().parent.parent
WITHOUT = """
import sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {absent!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Absent())
from fishmj.cli import main
raise SystemExit(main({arguments!r}))
"""


def fishmj_without(absent: set[str], *arguments: str) -> subprocess.CompletedProcess:
    """`fishmj ARGUMENTS` where these packages cannot be imported."""
    code = WITHOUT.format(absent=absent, arguments=list(arguments))
    return subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)


def test_fault_12_a_missing_extra_is_one_line_with_its_install_line():
    done = fishmj_without({"numba"}, "bench", "engine_compiled", "--quick", "--json")
    (found,) = json.loads(done.stdout.strip().splitlines()[-1])["benchmarks"]
    assert done.returncode == 0 and 'pip install "fishmj[fast]"' in found["skipped"]


def test_fault_12_training_without_the_compiled_engine_says_what_to_install(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "numba", None)
    settings = change(preset("quick"), steps=64, assess_every=64)
    shared = SimpleNamespace(init=lambda key: None)
    TrainingRun(settings, tmp_path / "auto", learner=(None, shared, None))
    advice = 'numba is not installed: training on the slower engine planar; pip install "fishmj[fast]"'
    assert capsys.readouterr().err.count(advice) == 1
    TrainingRun(change(settings, engine="planar"), tmp_path / "planar", learner=(None, shared, None))
    assert "numba" not in capsys.readouterr().err, "who asked for it needs no advice"


@pytest.mark.slow
def test_fault_12_the_other_verbs_work_without_the_extra():
    assert fishmj_without({"numba"}, "--help").returncode == 0
    done = fishmj_without({"numba"}, "bench", "engine_planar", "--quick", "--json")
    (found,) = json.loads(done.stdout.strip().splitlines()[-1])["benchmarks"]
    assert done.returncode == 0 and found["value"] > 0


def test_fault_12_the_doctor_works_where_nothing_is_installed():
    """-S hides every installed package, -E the path settings."""
    command = [sys.executable, "-S", "-E", "-m", "fishmj.doctor", "--json"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    answer = json.loads(done.stdout.strip().splitlines()[-1])
    core = {f["name"]: f for f in answer["findings"] if f["section"] == "core"}
    assert done.returncode == 1 and done.stderr == ""
    assert {f["state"] for f in core.values()} == {"bad"} and 'pip install "mujoco==3.17.0"' in core["mujoco"]["text"]


def test_an_exact_pin_says_which_abi_or_format_asks_for_it():
    pinned = [
        line for line in (ROOT / "pyproject.toml").read_text(encoding="utf-8").splitlines() if re.search(r"\w\]?==\d", line)
    ]
    assert pinned and all(re.search("# (ABI|format): ", line) for line in pinned), pinned


def test_the_version_is_the_same_everywhere():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert project["version"] == fishmj.__version__
    assert f"\nversion: {fishmj.__version__}\n" in citation
