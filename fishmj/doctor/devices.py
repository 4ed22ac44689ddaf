"""Accelerators as the driver, jax, warp and torch see them.

A probe can crash or hang in a driver, so each runs in a process of its own with a time limit.
"""

import importlib.util
import json
import os
import shutil
import subprocess
import sys

from fishmj.doctor.finding import Finding

PROBE_TIME = 60  # s


def probe(code: str, needs: str) -> dict | str:
    """Run Python code that prints one JSON object last, elsewhere; its result, or one line that says why there is none."""
    if importlib.util.find_spec(needs) is None:
        return f"{needs} is not installed"
    env = {**os.environ, "XLA_PYTHON_CLIENT_PREALLOCATE": "false"}
    try:
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, timeout=PROBE_TIME, env=env, check=False
        )
    except subprocess.TimeoutExpired:
        return f"no answer within {PROBE_TIME} s"
    if done.returncode != 0:
        lines = done.stderr.strip().splitlines()
        return f"failed with exit {done.returncode}: {lines[-1] if lines else 'no message'}"
    try:
        return json.loads(done.stdout.strip().splitlines()[-1])
    except (ValueError, IndexError):
        return "gave no answer that can be read"


JAX_PROBE = """
import json, jax
print(json.dumps({"backend": jax.default_backend(), "devices": [f"{d.platform}:{d.id} {d.device_kind}" for d in jax.devices()]}))
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


def findings() -> list[Finding]:
    """GPUs as the driver, jax, warp and torch see them."""
    out = [_nvidia()]
    card = out[0].state == "ok"
    found = probe(JAX_PROBE, "jax")
    if isinstance(found, str):
        out.append(Finding("devices", "jax", "bad", found))
    else:
        lost = card and found["backend"] == "cpu"
        hint = '; the GPU is not used: pip install "fishmj[cuda]"' if lost else ""
        out.append(Finding("devices", "jax", "note" if lost else "ok", ", ".join(found["devices"]) + hint))
    found = probe(WARP_PROBE, "warp")
    out.append(
        Finding("devices", "warp", "bad", found)
        if isinstance(found, str)
        else Finding("devices", "warp", "ok", ", ".join(found["devices"]))
    )
    found = probe(TORCH_PROBE, "torch")
    if isinstance(found, str):
        out.append(Finding("devices", "torch", "no", found))
    elif card and not found["usable"]:
        text = f"built for CUDA {found['build']}, cannot use this GPU: the sb3 algorithms will run on the CPU"
        out.append(Finding("devices", "torch", "note", text))
    else:
        out.append(Finding("devices", "torch", "ok", f"built for {found['build'] or 'CPU'}"))
    return out


def _nvidia() -> Finding:
    tool = shutil.which("nvidia-smi")
    if tool is None:
        return Finding("devices", "nvidia", "no", "no nvidia-smi: everything runs on the CPU")
    query = [tool, "--query-gpu=name,memory.total,driver_version", "--format=csv,noheader"]
    try:
        done = subprocess.run(query, capture_output=True, text=True, timeout=PROBE_TIME, check=False)
    except (subprocess.TimeoutExpired, OSError) as error:
        return Finding("devices", "nvidia", "note", f"nvidia-smi gives no answer: {error}")
    if done.returncode != 0:
        return Finding("devices", "nvidia", "note", f"nvidia-smi: {(done.stdout + done.stderr).strip().splitlines()[-1:]}")
    return Finding("devices", "nvidia", "ok", "; ".join(done.stdout.strip().splitlines()))
