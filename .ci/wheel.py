"""Build the wheel, look inside, install it into a fresh environment elsewhere, and use it from a folder without the sources.

python .ci/wheel.py [WHEEL]         a wheel that is there already, in place of a new one
"""

import json
import os
import subprocess
import sys
import tempfile
import time
import tomllib
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LARGEST = 16_600_000  # bytes
LOAD = """
import sys
from pathlib import Path
import fishmj
assert not {"mujoco", "jax", "scipy"} & set(sys.modules), "import fishmj loads NumPy only"
home = Path(fishmj.__file__).resolve()
assert Path(sys.prefix).resolve() in home.parents, f"not the installed package: {home}"
from fishmj import suite
from fishmj.base import calib
from fishmj.gap.null.null_runs import RecordedNull
from fishmj.hydro_fit.__main__ import SHIPPED
from fishmj.hydro_fit.segment_dataset import open_dataset
from fishmj.base.store import Manifest, shipped
from fishmj.water.hydro_model import HydroModel
folder = calib.calib_folder()
assert folder.parent.name == "_data", folder
Manifest.read(folder).verify(folder)
judged = [open_dataset(place, test=True) for place in SHIPPED if place.is_dir()]
assert len(judged) == 2 and not any(data.whole for data in judged), "of both fish what a check needs, every file checked"
assert all(next(iter(data.records("test", slip=1.0))).seconds > 0 for data in judged)
assert len(RecordedNull(folder=shipped("data/gap/lbm/nulls")).bundles) == 48
assert [HydroModel.load(name).name for name in calib.waters()] == calib.waters() != []
env = suite.load("fish", "station_hold")
step = env.reset()
for _ in range(5):
    step = env.step(env.action_spec().generate_value())
print("station_hold:", {name: value.shape for name, value in step.observation.items()})
"""
CORE = """
import sys
import numpy as np
from fishmj.log import trial
from fishmj.sim import Sim
sim = Sim("fish")
for k in range(50):
    sim.step(0.3 * np.sin(0.1 * k * np.ones(3)))
assert np.isfinite(sim.pose).all() and not {"jax", "warp", "dm_control", "numba", "cv2"} & set(sys.modules)
print("one fish in MuJoCo:", sim.pose[:2])
"""
DRIFT = ["evaluate", "drift", "--speeds", "0.2", "--los", "0,180", "--repeats", "1", "--json"]
BAD_INPUT = 2
LEFT_OUT = (  # what asks for data that a wheel has not, and must say so
    ["hydro_fit", "fit"],
    ["hydro_fit", "check", "--data", "data/hydro/swift-fresh"],
    ["gap", "bench", "--generator", "lbm"],
    ["gap", "find", "data/gap/lbm/planted/planted_002.npz"],
)


def run(what: str, *command: str, cwd: Path, expected: int = 0) -> str:
    """Run a command without this checkout on the path; stop with its output when it ends otherwise than expected.

    Returns:
        what it printed, of a failure that was expected its stderr.
    """
    start = time.monotonic()
    clean = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "VIRTUAL_ENV")}
    done = subprocess.run(command, cwd=cwd, env=clean, capture_output=True, text=True, check=False)
    print(f"   {what}: {time.monotonic() - start:.0f} s", flush=True)
    if done.returncode != expected:
        raise SystemExit(f"{what} failed ({done.returncode}): {' '.join(command)}\n{done.stdout}\n{done.stderr}")
    return done.stderr if expected else done.stdout


def wanted() -> set[str]:
    """Every file that the wheel must have: what pyproject.toml names, as far as git keeps it."""
    wheel = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["hatch"]["build"]["targets"]["wheel"]
    patterns = [f":(glob){pattern[1:]}{end}" for pattern in wheel["include"] for end in ("", "/**")]
    kept = subprocess.run(["git", "ls-files", "-z", *patterns], cwd=ROOT, capture_output=True, text=True, check=True)
    return {
        name.replace("data/", "fishmj/_data/", 1) if name.startswith("data/") else name
        for name in kept.stdout.split("\0")
        if name
    }


def look_inside(wheel: Path) -> None:
    """Everything that is shipped is inside, nothing else, and all of it is small."""
    names = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    if wrong := sorted(names ^ wanted()):
        raise SystemExit(f"{wheel.name} lacks or carries {len(wrong)} files against pyproject.toml: {', '.join(wrong[:10])}")
    size = wheel.stat().st_size
    print(f"   {wheel.name}: {size / 1e6:.2f} MB, {len(names)} files beside its own records", flush=True)
    if size > LARGEST:
        raise SystemExit(f"{wheel.name}: {size} bytes, expected at most {LARGEST}; what has come in that no verb opens?")


def use(wheel: Path, there: Path) -> None:
    """Install it below `there`, without and with extras, and use it."""
    run("environment", sys.executable, "-m", "venv", str(there / "env"), cwd=there)
    python, fishmj = (str(there / "env" / "bin" / name) for name in ("python", "fishmj"))
    install = (python, "-m", "pip", "--quiet", "--disable-pip-version-check", "install", "--no-compile")
    run("install", *install, str(wheel), cwd=there)
    elsewhere = there / "elsewhere"
    elsewhere.mkdir()
    print("   " + run("core", python, "-c", CORE, cwd=elsewhere).strip())
    report = json.loads(run("doctor", fishmj, "doctor", "--json", cwd=elsewhere).strip().splitlines()[-1])
    if not report["healthy"]:
        raise SystemExit(f"the doctor finds faults: {report['findings']}")
    told = run("evaluate without its extra", fishmj, *DRIFT, cwd=elsewhere, expected=BAD_INPUT)
    if 'pip install "fishmj[train]"' not in told:
        raise SystemExit(f"the extra is not named: {told}")
    run("install extras", *install, f"{wheel}[train,suite,view,solver]", cwd=there)
    print("   " + run("suite.load", python, "-c", LOAD, cwd=elsewhere).strip())
    answer = json.loads(run("evaluate drift", fishmj, *DRIFT, cwd=elsewhere).strip().splitlines()[-1])
    print("   " + json.dumps(answer)[:200])
    for command in LEFT_OUT:
        told = run(" ".join(command), fishmj, *command, cwd=elsewhere, expected=BAD_INPUT).strip()
        if "sdist" not in told.splitlines()[-1]:
            raise SystemExit(f"fishmj {' '.join(command)} does not say where the data is: {told}")
    small = run("hydro_fit", fishmj, "hydro_fit", "--device", "cpu", "--budget", "10", cwd=elsewhere, expected=BAD_INPUT)
    if "--data DIR" not in small:
        raise SystemExit(f"the bare hydro_fit does not say where segments are expected: {small}")
    run("demo --smoke", fishmj, "demo", "--smoke", "--out", "demo", cwd=elsewhere)
    lines = run("calibrate", fishmj, "calibrate", "servo", cwd=elsewhere).strip().splitlines()
    print("   " + lines[-1][:200])


def main(argv: list[str]) -> None:
    with tempfile.TemporaryDirectory(prefix="fishmj-wheel-") as folder:
        there = Path(folder)
        if not argv:
            pip = (sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check")
            run("build", *pip, "wheel", "--no-deps", "--wheel-dir", folder, str(ROOT), cwd=there)
        (wheel,) = [Path(argv[0]).resolve()] if argv else there.glob("fishmj-*.whl")
        look_inside(wheel)
        use(wheel, there)


if __name__ == "__main__":
    main(sys.argv[1:])
