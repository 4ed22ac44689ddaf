"""Where the fluid runs: `auto` takes an accelerator if there is one with room; explicit `cuda` must exist and fit."""

from functools import cache

from fishmj import console
from fishmj.errors import ConfigError, UnknownName

KINDS = ("auto", "cpu", "cuda")


@cache
def _warp():
    """Warp, initialised without a banner."""
    import warp as wp

    wp.config.log_level = wp.LOG_WARNING
    wp.init()
    return wp


def accelerator(need: int = 0) -> bool:
    """Whether `auto` takes an accelerator: there is one, with room for `need` bytes."""
    found = _warp().get_cuda_devices()
    return bool(found) and found[0].free_memory >= need


def device_of(name: str = "auto", need: int = 0):
    """The Warp device of this name, with room for `need` bytes.

    Raises:
        UnknownName: not `auto`, `cpu`, `cuda` or `cuda:N`.
        ConfigError: `cuda` without a usable accelerator, or with too little free memory (both figures in MB).
    """
    wp = _warp()
    kind = str(name).partition(":")[0]
    if kind not in KINDS:
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
    number = int(str(name).partition(":")[2] or 0)
    if number >= len(found):
        raise ConfigError(f"device: {name} was asked for; this machine has cuda:0 to cuda:{len(found) - 1}")
    device = found[number]
    if device.free_memory < need:
        raise ConfigError(
            f"device: {name} has {device.free_memory // 2**20} MB free, the fluid needs {need // 2**20} MB; "
            "take a coarser dx, a smaller box, or --device cpu"
        )
    return device
