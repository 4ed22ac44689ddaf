"""Beside the tank there is no simulator: protocols load NumPy and the standard library."""

import subprocess
import sys
from pathlib import Path

from fishmj.deploy import protocols

ROOM = Path(protocols.__file__).parent


def test_protocols_load_no_heavy_package():
    modules = sorted(f"fishmj.deploy.protocols.{path.stem}" for path in ROOM.glob("*.py") if path.stem != "__init__")
    assert len(modules) >= 9
    code = f"import sys, {', '.join(modules)}; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {name.split(".")[0] for name in done.stdout.split()}
    allowed = {"fishmj", "numpy", "safetensors"} | set(sys.stdlib_module_names)
    assert {name for name in loaded - allowed if not name.startswith("_")} == set(), "only these: numpy, safetensors"


def test_the_first_page_of_the_room_names_each_module():
    told = protocols.__doc__ or ""
    named = {path.stem for path in ROOM.glob("*.py")} - {"__init__", "protocol_error"}
    assert {name for name in named if f"    {name} " not in told} == set()
