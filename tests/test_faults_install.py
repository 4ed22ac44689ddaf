"""Faults of an installation: packages that are missing, and what still works without them."""

import importlib
import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace

import pytest

import fishmj
from fishmj.base import console, extras
from fishmj.base.errors import ConfigError
from fishmj.lbm_oracle.fluid import device
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


def test_fault_12_training_without_numba_says_what_to_install(tmp_path, capsys, monkeypatch):
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


EVERY_MODULE = """
import sys, importlib, pkgutil
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {absent!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Absent())
import fishmj
for found in pkgutil.walk_packages(fishmj.__path__, "fishmj."):
    if found.name not in {left!r}:
        importlib.import_module(found.name)
print("imported")
"""


@pytest.mark.slow
def test_every_module_imports_without_labmaze():
    """From Python 3.13 on it cannot be installed; dm_control's suite does not use it."""
    left = {"fishmj.train.sb3", "studies.benchmarks.peer_xlb"}  # of extras that this run has not
    code = EVERY_MODULE.format(absent={"labmaze"}, left=left)
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.stdout.endswith("imported\n"), done.stderr[-2000:]


def test_missing_package_names_its_extra():
    """Only an import statement of fishmj is explained; a question whether a package is there is answered."""
    code = """
import importlib.machinery as machinery, importlib.util, sys
import fishmj
find = machinery.PathFinder.find_spec
machinery.PathFinder.find_spec = lambda name, path=None, target=None: None if name == "warp" else find(name, path, target)
assert importlib.util.find_spec("warp") is None
try:
    import warp
except ModuleNotFoundError as error:
    assert type(error) is ModuleNotFoundError
import fishmj.lbm_oracle.fluid.fluid
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 1 and 'needs warp: pip install "fishmj[solver]"' in done.stderr


WITHOUT_WARP = """
from importlib.machinery import PathFinder
find = PathFinder.find_spec
PathFinder.find_spec = lambda name, *given: None if name.partition(".")[0] == "warp" else find(name, *given)
from fishmj.base import console
from fishmj.evaluate import __main__ as evaluate
from fishmj.evaluate.experiments import __main__ as experiments
from fishmj.view.play import __main__ as play
for verb in (evaluate, experiments, play):
    assert console.run(verb.main, ["--help"]) == console.OK
one = ["drift", "--speeds", "0.2", "--los", "0", "--repeats", "1", "--duration", "1"]
assert console.run(evaluate.main, [*one, "--json"]) == console.OK
assert console.run(evaluate.main, [*one, "--water", "lbm"]) == console.BAD_INPUT
"""


def test_judging_in_fitted_water_needs_no_flow_solver():
    """Only --water lbm asks for the extra `solver`, by its install line."""
    done = subprocess.run([sys.executable, "-c", WITHOUT_WARP], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert '"results"' in done.stdout and done.stderr.count('pip install "fishmj[solver]"') == 1


def test_extras_of_packages_are_those_of_the_project():
    """`base.extras` names for each import name an extra that installs it."""
    import importlib.metadata as metadata

    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    table = project["optional-dependencies"] | {"all": project["dependencies"]}
    distributions = metadata.packages_distributions() | {
        "mujoco.mjx": ["mujoco-mjx"],
        "roslibpy": ["roslibpy"],
        "tornado": ["meshcat"],
        "zstandard": ["mcap"],
        "ruamel": ["rosbags"],
        **{name: [name] for name in ("pysindy", "onnx", "ray", "torch", "stable_baselines3", "mujoco_menagerie")},
    }
    distributions["dm_env"], distributions["pinocchio"] = ["dm-control"], ["pin"]
    for name, extra in extras.EXTRA_OF.items():
        installed = {re.split(r"[^\w-]", line, maxsplit=1)[0] for line in table[extra]}
        assert installed & {distribution.replace("_", "-") for distribution in distributions[name]}, name


def test_fault_12_the_doctor_works_where_nothing_is_installed():
    """-S hides every installed package, -E the path settings."""
    command = [sys.executable, "-S", "-E", "-m", "fishmj.base.doctor", "--json"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    answer = json.loads(done.stdout.strip().splitlines()[-1])
    core = {f["name"]: f for f in answer["findings"] if f["section"] == "core"}
    assert done.returncode == 1 and done.stderr == ""
    assert {f["state"] for f in core.values()} == {"bad"} and 'pip install "mujoco==3.17.0"' in core["mujoco"]["text"]


@pytest.mark.parametrize("module", ["fishmj.sim", "fishmj.tasks.dm_control"])
def test_a_renderer_that_does_not_load_is_one_line_with_its_remedy(module):
    environ = {**os.environ, "MUJOCO_GL": "nonsense"}
    done = subprocess.run([sys.executable, "-c", f"import {module}"], capture_output=True, text=True, cwd=ROOT, env=environ)
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith("fishmj.base.errors.ConfigError: MUJOCO_GL = 'nonsense': this renderer does not load here (")
    assert "unset the variable, or set it to another of egl (GPU), osmesa" in last


def test_a_computer_without_a_screen_hears_no_warning_of_glfw():
    environ = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "MUJOCO_GL")}
    words = "import fishmj, warnings; warnings.warn('(65550) b\\'X11: The DISPLAY environment variable is missing\\'')"
    done = subprocess.run([sys.executable, "-c", words], capture_output=True, text=True, cwd=ROOT, env=environ)
    assert done.returncode == 0 and "DISPLAY" not in done.stderr


def test_a_command_with_a_wrong_renderer_is_bad_input_and_no_fault():
    environ = {**os.environ, "MUJOCO_GL": "nonsense"}
    command = [sys.executable, "-m", "fishmj", "evaluate", "drift", "--repeats", "1", "--los", "0", "--speeds", "0.1"]
    done = subprocess.run([*command, "--duration", "2"], capture_output=True, text=True, cwd=ROOT, env=environ)
    assert done.returncode == 2 and "Traceback" not in done.stderr
    assert done.stderr.strip().splitlines()[-1].startswith("fishmj: MUJOCO_GL = 'nonsense'")


def test_missing_mujoco_is_not_blamed_on_the_mujoco_gl_setting(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "disabled")
    done = fishmj_without({"mujoco"}, "bench", "engine_batch", "--quick")
    assert "MUJOCO_GL" not in done.stdout + done.stderr


def test_warp_without_a_folder_for_its_machine_code_says_which_to_name(tmp_path, capsys, monkeypatch):
    (tmp_path / "file").write_text("no folder")
    config = importlib.import_module("warp").config
    monkeypatch.setattr(config, "kernel_cache_dir", config.kernel_cache_dir)  # put back: later tests compile
    build = importlib.import_module("warp._src.build")
    assert console.run(lambda argv: build.init_kernel_cache(str(tmp_path / "file" / "warp")), []) == console.BAD_INPUT
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert "Not a directory" in said and said.endswith("set WARP_CACHE_PATH to a folder that can be written")


def test_the_solver_without_that_folder_says_it_from_python_too(monkeypatch):
    def refuse():
        raise PermissionError(13, "Permission denied", "/nonexistent")

    monkeypatch.setattr("warp.init", refuse)
    device._warp.cache_clear()
    with pytest.raises(ConfigError, match="/nonexistent: Permission denied.*set WARP_CACHE_PATH to a folder that can be written"):
        device.device_of("cpu")


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
