"""Checks what works on this machine, what will not, and prints the line that mends it.

Exits with 1 if a core package is missing or at a version that fishmj does not run with. It imports only Python's own modules
here, so it runs where nothing is installed. A probe can crash or hang in a driver, so each runs in its own process with a
time limit.
"""

import importlib.util
import json
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

from fishmj.base import calib, console
from fishmj.base.cores import usable_cores
from fishmj.base.errors import FishmjError
from fishmj.base.renderer import CHOICES
from fishmj.base.source import version

MARKS = {"ok": "ok  ", "note": "note", "no": "no  ", "bad": "BAD "}
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
PROBE_TIME = 60  # s
JAX_PROBE = """
import json, jax
print(json.dumps({"backend": jax.default_backend(), "devices": [f"{d.platform}:{d.id} {d.device_kind}" for d in jax.devices()]}))
"""
RENDERER_PROBE = """
import json, dm_control._render
print(json.dumps({}))
"""
WARP_PROBE = """
import json, warp as wp
wp.config.quiet = True
wp.init()
print(json.dumps({"devices": [f"{d.alias} {d.name}" for d in wp.get_devices()]}))
"""
TORCH_PROBE = """
import json, torch
print(json.dumps({"build": torch.version.cuda, "usable": torch.cuda.is_available()}))
"""


class DoctorFinding(NamedTuple):
    """One line of the report. `state`: ok, note (works, know this), no (an option that is absent), bad (must be mended)."""

    section: str
    name: str
    state: str
    text: str


def main(argv: list[str]) -> int:
    """The verb `doctor`. Returns the exit code."""
    summary = "What works on this machine, what will not, and the line that mends it; exit 1 where a core package is not right."
    args = console.parser("doctor", summary, examples="example:\n  fishmj doctor --json").parse_args(argv)
    findings = examine()
    section = ""
    for finding in findings:
        if finding.section != section:
            section = finding.section
            console.say("", section)
        console.say(f"  {MARKS[finding.state]} {finding.name:<24} {finding.text}")
    bad = [f.name for f in findings if f.state == "bad"]
    console.say("", f"to mend: {', '.join(bad)}" if bad else "all that fishmj needs is here")
    if args.json:
        console.emit_json({"healthy": not bad, "findings": [f._asdict() for f in findings]})
    return console.FAILED_CHECK if bad else console.OK


def examine() -> list[DoctorFinding]:
    """All findings, in the order of the report."""
    findings = [*machine(), *packages(), *devices(), *surroundings(), *known_issues()]
    return [*findings, *verdicts(findings)]


def verdicts(findings: list[DoctorFinding]) -> list[DoctorFinding]:
    """Derives from the findings which parts of fishmj work here and which do not."""
    state = {(f.section, f.name): f.state for f in findings}
    core = all(f.state == "ok" for f in findings if f.section == "core")
    card = any(f.section == "devices" and f.name == "jax" and ("cuda" in f.text or "gpu" in f.text) for f in findings)
    extra = lambda name: state.get(("extras", name)) == "ok"
    mend = lambda name: f'pip install "fishmj[{name}]"' if core else "mend the core packages first"
    rows = (
        ("train, evaluate", core and extra("train"), "on the GPU" if card else "on the CPU", mend("train")),
        ("fast CPU engine", core and extra("fast"), "compiled", f"slower path: {mend('fast')}"),
        ("suite.load", core and extra("suite"), "yes", mend("suite")),
        ("flow solver", core and extra("solver"), "yes", mend("solver")),
        ("find what is missing", core and extra("search"), "yes", mend("search")),
        ("replay, play", core and extra("view"), "yes", mend("view")),
        ("deploy", core and extra("tank"), "yes", mend("tank")),
        ("--algo sb3-ppo", core and extra("sb3"), "yes", mend("sb3")),
        (
            "replay looked at",
            state.get(("files", "browser")) == "ok",
            "headless browser",
            "no browser here; open the file elsewhere",
        ),
    )
    return [
        DoctorFinding("works", name, "ok" if good else "no", text if good else otherwise) for name, good, text, otherwise in rows
    ]


# packages


def requirements() -> list[str]:
    """The requirement lines of fishmj: of the installed package, else of the checkout's pyproject.toml."""
    checkout = Path(__file__).resolve().parents[2] / "pyproject.toml"
    if checkout.is_file():
        project = tomllib.loads(checkout.read_text(encoding="utf-8"))["project"]
        extras = project["optional-dependencies"].items()
        return project["dependencies"] + [
            f'{line} {"and" if ";" in line else ";"} extra == "{extra}"' for extra, lines in extras for line in lines
        ]
    return metadata.requires("fishmj") or []


def packages(lines: list[str] | None = None) -> list[DoctorFinding]:
    """Core packages and extras against what is installed."""
    lines = requirements() if lines is None else lines
    if importlib.util.find_spec("packaging") is None:
        return _presence(lines)
    from packaging.requirements import Requirement

    out = []
    extras: dict[str, list[str]] = {}
    for line in lines:
        wanted = Requirement(line)
        extra = _extra(line)
        if extra is None:
            found = version(wanted.name)
            out.append(_core(wanted.name, str(wanted.specifier), found, found is not None and found in wanted.specifier))
        elif extra != "all":
            extras.setdefault(extra, []).extend(_lacking(wanted, extra))
    for extra, missing in extras.items():
        text = f'{", ".join(missing)}: pip install "fishmj[{extra}]"' if missing else "installed"
        out.append(DoctorFinding("extras", extra, "no" if missing else "ok", text))
    return out


def _presence(lines: list[str]) -> list[DoctorFinding]:
    """Checks only that the core packages are present: without `packaging` no version can be compared."""
    out = []
    for line in lines:
        if _extra(line) is None:
            name = re.split(r"[^\w.-]", line, maxsplit=1)[0]
            found = version(name)
            text = f"{found}, not compared" if found else f'missing: pip install "{line}"'
            out.append(DoctorFinding("core", name, "note" if found else "bad", text))
    return out


def _lacking(wanted, extra: str) -> list[str]:
    """Names of what a requirement lacks here, with one level of the extras that it asks of its package (`jax[cuda13]`)."""
    from packaging.requirements import Requirement

    found = version(wanted.name)
    if wanted.marker is not None and not wanted.marker.evaluate({"extra": extra}):
        return [] if found else [f"{wanted.name} (not installed on this version of Python; README, Install, has the way)"]
    if found is None or not wanted.specifier.contains(found, prereleases=True):
        return [f"{wanted.name}{wanted.specifier} (found {found or 'none'})"]
    inner = [(_extra(line), Requirement(line)) for line in metadata.requires(wanted.name) or [] if _extra(line) in wanted.extras]
    return [
        r.name for name, r in inner if version(r.name) is None and (r.marker is None or r.marker.evaluate({"extra": name or ""}))
    ]


def _extra(line: str) -> str | None:
    condition = line.partition(";")[2]
    return condition.split("extra ==")[1].strip().strip("\"'()") if "extra ==" in condition else None


def _core(name: str, wanted: str, found: str | None, fits: bool) -> DoctorFinding:
    if fits:
        return DoctorFinding("core", name, "ok", str(found))
    got = f"found {found}" if found else "missing"
    return DoctorFinding("core", name, "bad", f'{got}, needs {wanted}: pip install "{name}{wanted}"')


# machine


def machine() -> list[DoctorFinding]:
    """Findings on Python, the system and the cores."""
    fits, python = sys.version_info[:2] >= (3, 11), f"{platform.python_version()} at {sys.executable}"
    system = ("bad", "not supported: run it inside WSL") if platform.system() == "Windows" else ("ok", platform.platform())
    return [
        DoctorFinding("machine", "python", "ok" if fits else "bad", python if fits else f"{python}; fishmj needs 3.11 or later"),
        DoctorFinding("machine", "system", *system),
        DoctorFinding("machine", "cores", "ok", f"{usable_cores()} usable of {os.cpu_count()}, {processor()}"),
    ]


def processor() -> str:
    """The processor's name."""
    info = Path("/proc/cpuinfo")
    if info.is_file():
        for line in info.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def browser() -> str | None:
    """Path of a browser that can run without a screen, or None. `FISHMJ_BROWSER` names another one."""
    named = os.environ.get("FISHMJ_BROWSER")
    return shutil.which(named) if named else next((p for name in BROWSERS if (p := shutil.which(name))), None)


def surroundings() -> list[DoctorFinding]:
    """Findings on the browser, writable folders and the shipped files."""
    found = browser()
    missing = "none of " + ", ".join(BROWSERS) + ": replays are written and open in any browser, their test is skipped"
    out = [DoctorFinding("files", "browser", "ok" if found else "no", found or missing)]
    for name, folder in (("here", Path.cwd()), ("temporary", Path(tempfile.gettempdir()))):
        free = shutil.disk_usage(folder).free / 2**30
        writable = os.access(folder, os.W_OK)
        text = f"{folder}, {free:.1f} GiB free" if writable else f"{folder} cannot be written: run from another folder"
        out.append(DoctorFinding("files", name, "note" if not writable or free < 1 else "ok", text))
    return [*out, DoctorFinding("files", "calibration", *_calibration())]


def _calibration() -> tuple[str, str]:
    """State and text of the shipped calibration against its manifest."""
    try:
        from fishmj.base.store import Manifest

        folder = calib.calib_folder()
        changes = Manifest.read(folder).check(folder)
    except ImportError as error:
        return "bad", f"not compared with its manifest: {error}"
    except FishmjError as error:
        return "bad", str(error)
    text = "; ".join(map(str, changes)) or f"{', '.join(calib.shipped())} as stated in the manifest"
    return "note" if changes else "ok", text


# devices


def probe(code: str, needs: str) -> dict | str:
    """Runs Python code in another process.

    Returns the JSON object that it prints last, or one line with the reason for its failure.
    """
    if importlib.util.find_spec(needs) is None:
        return f"{needs} is not installed"
    env = {**os.environ, "XLA_PYTHON_CLIENT_PREALLOCATE": "false"}
    command = [sys.executable, "-c", code]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=PROBE_TIME, env=env, check=False)
    except subprocess.TimeoutExpired:
        return f"no answer within {PROBE_TIME} s"
    if done.returncode != 0:
        lines = done.stderr.strip().splitlines()
        return f"failed with exit {done.returncode}: {lines[-1] if lines else 'no message'}"
    try:
        return json.loads(done.stdout.strip().splitlines()[-1])
    except (ValueError, IndexError):
        return "gave no answer that can be read"


def devices() -> list[DoctorFinding]:
    """Findings on the GPUs as the driver, jax, warp and torch report them."""
    driver, told = _nvidia()
    card = driver == "ok"
    jax, warp, torch = probe(JAX_PROBE, "jax"), probe(WARP_PROBE, "warp"), probe(TORCH_PROBE, "torch")
    if not isinstance(jax, str):
        lost = card and jax["backend"] == "cpu"
        hint = '; the GPU is not used: pip install "fishmj[cuda]"' if lost else ""
        of_jax = "note" if lost else "ok", ", ".join(jax["devices"]) + hint
    else:
        of_jax = "bad" if version("jax") else "no", jax
    place = "; set WARP_CACHE_PATH to a folder that can be written" if "[Errno" in str(warp) else ""
    if isinstance(warp, str):
        of_warp = "bad" if version("warp-lang") else "no", warp + place
    else:
        of_warp = "ok", ", ".join(warp["devices"])
    if isinstance(torch, str):
        of_torch = "no", torch
    elif card and not torch["usable"]:
        of_torch = "note", f"built for CUDA {torch['build']}, cannot use this GPU: the sb3 algorithms will run on the CPU"
    else:
        of_torch = "ok", f"built for {torch['build'] or 'CPU'}"
    rows = {"nvidia": (driver, told), "jax": of_jax, "warp": of_warp, "torch": of_torch}
    return [DoctorFinding("devices", name, *found) for name, found in rows.items()]


def _nvidia() -> tuple[str, str]:
    """State of the driver, and the report of its own tool."""
    tool = shutil.which("nvidia-smi")
    if tool is None:
        return "no", "no nvidia-smi: everything runs on the CPU"
    query = [tool, "--query-gpu=name,memory.total,driver_version", "--format=csv,noheader"]
    try:
        done = subprocess.run(query, capture_output=True, text=True, timeout=PROBE_TIME, check=False)
    except (subprocess.TimeoutExpired, OSError) as error:
        return "note", f"nvidia-smi gives no answer: {error}"
    if done.returncode != 0:
        return "note", f"nvidia-smi: {(done.stdout + done.stderr).strip().splitlines()[-1:]}"
    return "ok", "; ".join(done.stdout.strip().splitlines())


# known issues of the packages below


def known_issues() -> list[DoctorFinding]:
    """Known faults of the packages below; each is reported only on a machine that it affects."""
    return [DoctorFinding("traps", *found) for found in _traps()]


def _traps() -> Iterator[tuple[str, str, str]]:
    linux, mujoco, torch = platform.system() == "Linux", version("mujoco"), version("torch")
    if mujoco and int(mujoco.split(".")[0]) >= 4:
        yield "mujoco 4", "bad", "dm-control 1.0.50 and the water's callback need 3.17: pip install mujoco==3.17.0"
    chosen = os.environ.get("MUJOCO_GL")
    if chosen is None and linux and not os.environ.get("DISPLAY"):
        yield "MUJOCO_GL", "note", "no screen: set it to egl (GPU) or osmesa for MuJoCo's own pictures; replays need none"
    elif chosen is not None and isinstance(found := probe(RENDERER_PROBE, "dm_control"), str):
        yield "MUJOCO_GL", "bad", f"is {chosen!r}, which does not load: {found}; unset it, or set it to {CHOICES}"
    if torch and linux and not torch.endswith("+cpu"):
        yield "torch", "note", f"{torch} brings CUDA libraries of its own, maybe not those of jax[cuda13]: keep two environments"
    if os.environ.get("JAX_ENABLE_X64", "").lower() in ("1", "true"):
        yield "JAX_ENABLE_X64", "note", "is set: the jax engines run in float64, slower and not what the figures are for"
    text = "MuJoCo has one per process: build models outside the water's block; threads must use another path"
    yield "passive callback", "note", text


if __name__ == "__main__":
    raise SystemExit(console.run(main))
