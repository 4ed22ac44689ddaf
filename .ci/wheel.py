"""Build the wheel, look inside, install it into a fresh environment elsewhere, and use it from a folder without the sources."""

import json
import os
import subprocess
import sys
import tempfile
import time
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LOAD = """
import sys
from pathlib import Path
import fishmj
home = Path(fishmj.__file__).resolve()
assert Path(sys.prefix).resolve() in home.parents, f"not the installed package: {home}"
from fishmj import calib, suite
from fishmj.store import Manifest
folder = calib.calib_folder()
assert folder.parent.name == "_data", folder
Manifest.read(folder).verify(folder)
env = suite.load("fish", "station_hold")
step = env.reset()
for _ in range(5):
    step = env.step(env.action_spec().generate_value())
print("station_hold:", {name: value.shape for name, value in step.observation.items()})
"""
DRIFT = ["evaluate", "drift", "--speeds", "0.2", "--los", "0,180", "--repeats", "1", "--json"]


def run(what: str, *command: str, cwd: Path, **options) -> str:
    """Run a command without this checkout on the path; stop with its output when it fails."""
    start = time.monotonic()
    clean = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "VIRTUAL_ENV")}
    done = subprocess.run(command, cwd=cwd, env=clean, capture_output=True, text=True, check=False, **options)
    print(f"   {what}: {time.monotonic() - start:.0f} s", flush=True)
    if done.returncode:
        raise SystemExit(f"{what} failed ({done.returncode}): {' '.join(command)}\n{done.stdout}\n{done.stderr}")
    return done.stdout


def look_inside(wheel: Path) -> None:
    """Everything that is shipped is inside, and nothing else."""
    names = set(zipfile.ZipFile(wheel).namelist())
    shipped = {f"fishmj/_data/{p.relative_to(ROOT / 'data').as_posix()}" for p in (ROOT / "data").rglob("*.*") if p.is_file()}
    shipped |= {p.relative_to(ROOT).as_posix() for p in (ROOT / "fishmj" / "policies").glob("*.safetensors")}
    shipped |= {p.relative_to(ROOT).as_posix() for p in (ROOT / "fishmj").rglob("*.py")}
    if missing := sorted(shipped - names):
        raise SystemExit(f"{wheel.name} lacks {missing}")
    if foreign := sorted(name for name in names if not name.startswith(("fishmj/", "fishmj-"))):
        raise SystemExit(f"{wheel.name} carries {foreign}")
    print(f"   {wheel.name}: {wheel.stat().st_size / 1024:.0f} KiB, {len(names)} files", flush=True)


def main() -> None:
    with tempfile.TemporaryDirectory(prefix="fishmj-wheel-") as folder:
        there = Path(folder)
        pip = (sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check")
        run("build", *pip, "wheel", "--no-deps", "--wheel-dir", folder, str(ROOT), cwd=there)
        (wheel,) = there.glob("fishmj-*.whl")
        look_inside(wheel)
        run("environment", sys.executable, "-m", "venv", str(there / "env"), cwd=there)
        bin_ = there / "env" / "bin"
        install = (str(bin_ / "python"), "-m", "pip", "--quiet", "--disable-pip-version-check", "install", "--no-compile")
        run("install", *install, str(wheel), cwd=there)
        elsewhere = there / "elsewhere"
        elsewhere.mkdir()
        print("   " + run("suite.load", str(bin_ / "python"), "-c", LOAD, cwd=elsewhere).strip())
        answer = json.loads(run("evaluate drift", str(bin_ / "fishmj"), *DRIFT, cwd=elsewhere).strip().splitlines()[-1])
        print("   " + json.dumps(answer)[:200])
        report = json.loads(run("doctor", str(bin_ / "fishmj"), "doctor", "--json", cwd=elsewhere).strip().splitlines()[-1])
        if not report["healthy"]:
            raise SystemExit(f"the doctor finds faults: {report['findings']}")


if __name__ == "__main__":
    main()
