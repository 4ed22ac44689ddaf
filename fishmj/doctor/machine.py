"""Python, system, cores, browser, folders, shipped files."""

import os
import platform
import shutil
import sys
import tempfile
from pathlib import Path

from fishmj import calib
from fishmj.cores import usable_cores
from fishmj.doctor.finding import Finding
from fishmj.errors import FishmjError

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")


def findings() -> list[Finding]:
    """Python, system, cores."""
    fits = (3, 11) <= sys.version_info[:2] < (3, 13)
    python = f"{platform.python_version()} at {sys.executable}"
    system = platform.system()
    windows = "not supported: run it inside WSL"
    return [
        Finding("machine", "python", "ok" if fits else "bad", python if fits else f"{python}; fishmj needs 3.11 or 3.12"),
        Finding(
            "machine", "system", "bad" if system == "Windows" else "ok", windows if system == "Windows" else platform.platform()
        ),
        Finding("machine", "cores", "ok", f"{usable_cores()} usable of {os.cpu_count()}, {processor()}"),
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


def surroundings() -> list[Finding]:
    """Browser, writable folders, shipped files."""
    found = browser()
    missing = "none of " + ", ".join(BROWSERS) + ": replays are written and open in any browser, their test is skipped"
    out = [Finding("files", "browser", "ok" if found else "no", found or missing)]
    for name, folder in (("here", Path.cwd()), ("temporary", Path(tempfile.gettempdir()))):
        free = shutil.disk_usage(folder).free / 2**30
        writable = os.access(folder, os.W_OK)
        text = f"{folder}, {free:.1f} GiB free" if writable else f"{folder} cannot be written: run from another folder"
        out.append(Finding("files", name, "note" if not writable or free < 1 else "ok", text))
    out.append(_calibration())
    return out


def _calibration() -> Finding:
    """The shipped calibration against its manifest."""
    try:
        from fishmj.store import Manifest

        folder = calib.calib_folder()
        changes = Manifest.read(folder).check(folder)
    except ImportError as error:
        return Finding("files", "calibration", "bad", f"not compared with its manifest: {error}")
    except FishmjError as error:
        return Finding("files", "calibration", "bad", str(error))
    text = "; ".join(map(str, changes)) or f"{', '.join(calib.shipped())} as stated in the manifest"
    return Finding("files", "calibration", "note" if changes else "ok", text)
