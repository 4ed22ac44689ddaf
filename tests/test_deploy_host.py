"""The host runs beside the tank with the packages of one list, and loads nothing else."""

import importlib.util
import json
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest

from fishmj.deploy.commands import doctor_command

ROOT = Path(__file__).resolve().parent.parent
HEAVY = {
    *("mujoco", "jax", "jaxlib", "warp", "numba", "scipy", "matplotlib", "pydantic", "torch", "dm_control", "optax", "gymnasium"),
    *("meshcat", "pyarrow", "ray", "rosbags"),
}
ASKED_FOR = {"cv2", "serial", "mcap", "roslibpy"}  # loaded only by what uses them
ALL = """
import json, sys
from importlib import import_module
for name in json.loads(sys.argv[1]):
    import_module(name)
print(json.dumps(sorted({name.partition(".")[0] for name in sys.modules})))
"""


def modules():
    files = [path for path in sorted((ROOT / "fishmj" / "deploy").rglob("*.py")) if "loopback" not in path.parts]
    named = [".".join(path.relative_to(ROOT).with_suffix("").parts) for path in files]
    return [name.removesuffix(".__init__") for name in named if not name.endswith("__main__")]


def test_importing_all_of_the_host_loads_nothing_heavy():
    done = subprocess.run(
        [sys.executable, "-c", ALL, json.dumps(modules())], capture_output=True, text=True, cwd=ROOT, check=True
    )
    loaded = set(json.loads(done.stdout))
    assert loaded & HEAVY == set()
    assert loaded & ASKED_FOR == set()


def test_the_list_of_packages_is_the_one_that_doctor_reads():
    assert set(doctor_command.required()) == {"numpy", "opencv-python-headless", "pyserial", "safetensors"}


def test_doctor_says_what_is_missing(monkeypatch, capsys):
    monkeypatch.setattr(doctor_command, "version", lambda name: None if name == "pyserial" else "1.0")
    assert doctor_command.main(["--seconds", "0.5", "--json"]) == 1
    said = capsys.readouterr()
    assert "pyserial is missing" in said.err
    assert json.loads(said.out.splitlines()[-1])["ticks"]["ticks"] == 25


LOCKSTEP = """
import sys
sys.path[:] = sys.argv[1].split("\\n")
from pathlib import Path
import numpy as np
import cv2, serial, safetensors
from importlib import import_module
for name in sys.argv[2].split("\\n"):
    import_module(name)
from tests.deploying import Bench
from fishmj.log import read_trial
bench = Bench(Path(sys.argv[3]), seconds=3.0)
outcome = bench.swim()
assert outcome.complete, outcome.words
trial = read_trial(bench.folder)
assert len(trial.tables["obs"]["t"]) == 15
from fishmj.deploy.tracker.apriltag import AprilTagTracker
from fishmj.deploy.tracker.calibration import overhead
tracker = AprilTagTracker(overhead((640, 480), 0.0028, 3.0))
assert tracker.locate(np.full((480, 640, 3), 90, np.uint8), 0.0) is None
print("\\n".join(sorted({name.partition(".")[0] for name in sys.modules})))
"""


def linked(folder, package):
    """Link what a distribution installs at its top level into `folder`."""
    for file in metadata.files(package) or []:
        top = file.parts[0]
        place = folder / top
        if top not in ("..", "bin") and not place.exists():
            place.symlink_to(Path(metadata.distribution(package).locate_file(top)))


@pytest.mark.slow
def test_the_host_swims_in_an_environment_that_has_nothing_else(tmp_path):
    """An interpreter without its site-packages (-I -S), given the listed packages, the standard library and the checkout."""
    site = tmp_path / "site"
    site.mkdir()
    for package in doctor_command.required():
        linked(site, package)
    assert importlib.util.find_spec("mujoco") is not None, "the test shows nothing where MuJoCo is not installed"
    standard = [path for path in sys.path if path.startswith(sys.base_prefix) and "site-packages" not in path]
    path = "\n".join([*standard, str(site), str(ROOT)])
    words = [sys.executable, "-I", "-S", "-c", LOCKSTEP, path, "\n".join(modules()), str(tmp_path / "swim")]
    done = subprocess.run(words, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    third = set(done.stdout.split()) - set(sys.stdlib_module_names)
    known = {"numpy", "cv2", "serial", "safetensors", "fishmj", "tests", "cython_runtime"}  # the last is a part of NumPy
    assert {name for name in third if not name.startswith("_")} <= known
