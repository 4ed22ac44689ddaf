"""Known traps of the packages below, each reported only where it bites."""

import os
import platform
from collections.abc import Iterator

from fishmj.doctor.finding import Finding
from fishmj.doctor.packages import version

BACKENDS = ("egl", "glfw", "osmesa", "wgl", "cgl", "enable", "enabled", "on", "disable", "disabled", "off")  # MUJOCO_GL


def findings() -> list[Finding]:
    """Every trap that this machine can fall into."""
    return [Finding("traps", *found) for trap in (_mujoco, _graphics, _torch, _precision, _callback) for found in trap()]


def _mujoco() -> Iterator[tuple[str, str, str]]:
    found = version("mujoco")
    if found and int(found.split(".")[0]) >= 4:
        yield "mujoco 4", "bad", "dm-control 1.0.50 and the water's callback need 3.17: pip install mujoco==3.17.0"


def _graphics() -> Iterator[tuple[str, str, str]]:
    chosen = os.environ.get("MUJOCO_GL")
    if chosen is None and platform.system() == "Linux" and not os.environ.get("DISPLAY"):
        yield "MUJOCO_GL", "note", "no screen: set it to egl (GPU) or osmesa for MuJoCo's own pictures; replays need none"
    elif chosen is not None and chosen.lower() not in BACKENDS:
        yield "MUJOCO_GL", "bad", f"is {chosen!r}, expected egl, glfw, osmesa or disabled: MuJoCo's renderer will not load"


def _torch() -> Iterator[tuple[str, str, str]]:
    found = version("torch")
    if found and platform.system() == "Linux" and not found.endswith("+cpu"):
        yield "torch", "note", f"{found} brings CUDA libraries of its own, maybe not those of jax[cuda13]: keep two environments"


def _precision() -> Iterator[tuple[str, str, str]]:
    if os.environ.get("JAX_ENABLE_X64", "").lower() in ("1", "true"):
        yield "JAX_ENABLE_X64", "note", "is set: the jax engines run in float64, slower and not what the figures are for"


def _callback() -> Iterator[tuple[str, str, str]]:
    text = "MuJoCo has one per process: build models outside the water's block; threads must use another path"
    yield "passive callback", "note", text
