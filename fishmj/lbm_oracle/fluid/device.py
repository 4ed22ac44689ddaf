"""Selects the device of the fluid. `auto` takes an accelerator with enough free memory; an explicit `cuda` must exist and fit.

One water has one device (`device_of`). Independent waters may have several (`devices_of`): `cuda:all`, or a list.
"""

import os
from functools import cache

from fishmj.base import console
from fishmj.base.errors import ConfigError, UnknownName

KINDS = ("auto", "cpu", "cuda")
QUEUES = "32"  # of an accelerator's work, the most there are: with eight, its default, tanks with finer cells wait for each other


@cache
def _warp():
    """Returns Warp, initialised without a banner. Raises ConfigError if there is no folder for its machine code."""
    os.environ.setdefault("CUDA_DEVICE_MAX_CONNECTIONS", QUEUES)  # read once, when the device is first used
    import warp as wp

    wp.config.log_level = wp.LOG_WARNING
    try:
        wp.init()
    except OSError as error:
        where = f"{error.filename or 'its folder'}: {error.strerror or error}"
        raise ConfigError(
            f"Warp cannot keep its machine code ({where}); set WARP_CACHE_PATH to a folder that can be written"
        ) from error
    return wp


def accelerator(need: int = 0) -> bool:
    """Returns True if `auto` takes an accelerator: one exists and has room for `need` bytes."""
    found = _warp().get_cuda_devices()
    return bool(found) and found[0].free_memory >= need


def device_of(name: str = "auto", need: int = 0):
    """The Warp device of this name, with room for `need` bytes.

    Raises:
        UnknownName: not `auto`, `cpu`, `cuda` or `cuda:N`.
        ConfigError: `cuda` without a usable accelerator, or with too little free memory (both figures in MB).
    """
    wp = _warp()
    kind, colon, place = str(name).partition(":")
    if several(name):
        raise ConfigError(f"device: {name} names several, one water runs on one; expected {', '.join(KINDS)} or cuda:N")
    if kind not in KINDS or (colon and not place.isdecimal()):
        raise UnknownName("device", str(name), KINDS)
    found = wp.get_cuda_devices()
    if kind == "auto" and not accelerator(need):
        why = (
            f"{found[0].free_memory // 2**20} MB free on {found[0]}, {need // 2**20} MB needed"
            if found
            else "no accelerator found"
        )
        console.warn(f"device: {why}; running on the CPU")
        kind = "cpu"
    if kind == "cpu":
        return wp.get_device("cpu")
    if not found:
        raise ConfigError("device: cuda was asked for and no usable accelerator was found; use --device cpu, or auto")
    number = int(place or 0)
    if number >= len(found):
        raise ConfigError(f"device: {name} was asked for; this machine has cuda:0 to cuda:{len(found) - 1}")
    device = found[number]
    if device.free_memory < need:
        raise ConfigError(
            f"device: {name} has {device.free_memory // 2**20} MB free, the fluid needs {need // 2**20} MB; "
            "take a coarser dx, a smaller box, or --device cpu"
        )
    return device


def several(name: str) -> bool:
    """Returns True if `name` names several devices, as `devices_of` takes them."""
    return "," in str(name) or name == "cuda:all"


def devices_of(name: str = "auto", need: int = 0) -> tuple[str, ...]:
    """Names of the Warp devices that independent waters are spread over, each with room for `need` bytes.

    Args:
        name: as for `device_of`; or `cuda:all`, every accelerator that this process sees; or several devices of one kind with
            commas, `cuda:0,cuda:1`. A device that is named twice, as in `cpu,cpu`, gets two processes.

    Raises UnknownName, ConfigError: as `device_of`; ConfigError also for `auto` in a list and for two kinds in one list, because
    their results differ in the last bits.
    """
    names = str(name).split(",")
    if len(names) > 1 and (len(kinds := {one.partition(":")[0] for one in names}) > 1 or "auto" in kinds):
        raise ConfigError(f"device: {name} mixes kinds; expected one kind, as cuda:0,cuda:1 or cpu,cpu, or cuda:all")
    if name == "cuda:all":
        found = _warp().get_cuda_devices()
        names = [f"cuda:{number}" for number in range(len(found))] or ["cuda"]  # the last says that there is none
    return tuple(str(device_of(one, need)) for one in names)
