"""Time of swims on a CPU, cells times steps over the rate of a core; asks before work that takes hours."""

from collections.abc import Iterable
from math import prod

from fishmj.base import cost
from fishmj.base.cores import usable_cores
from fishmj.lbm_oracle.fluid.device import accelerator
from fishmj.lbm_oracle.fluid.fluid import BYTES_PER_CELL
from fishmj.lbm_oracle.fluid.slabs import MOST
from fishmj.lbm_oracle.run.domain import Domain

RATE = 1.0e7  # cells a core updates in a second round a swimming fish, on two idle ones (docs/solver/results.md, Speed)
UNASKED = 3600.0  # s of a CPU that `--device auto` begins without being asked

Work = Iterable[tuple[Domain, float]]  # boxes with the finer ones in them, and s of water in each


def cpu_seconds(work: Work, cores: int = 0) -> float:
    """Wall-clock time [s] on so many cores, by default those of this machine."""
    steps = (prod(level.shape) * water / level.dt for box, water in work for level in box.levels)
    return sum(steps) / (RATE * min(cores or usable_cores(), MOST))


def agree(
    verb: str, device: str, work: Work, *, instead: str, tanks: int = 1, flag: str = "--device cpu", asked: bool = False
) -> None:
    """Asks before work that takes a CPU too long or does not fit into its memory; refuses it without a terminal.

    Args:
        device: the user's option; a device by name counts as agreed.
        tanks: number of boxes side by side.
        asked: the user has already agreed to the time.

    Raises TooMuch: the user did not agree.
    """
    work = list(work)
    if device.startswith("cuda") or not work:
        return
    largest = max(prod(level.shape) for box, _ in work for level in box.levels)
    need = BYTES_PER_CELL * largest
    if device == "auto" and accelerator(need):
        return
    cells = f"boxes of up to {largest / 1e6:.3g} M cells"
    cost.memory(verb, need * tanks, f"{tanks} x {cells}", instead="take a coarser grid or fewer --tanks")
    water = sum(water for _, water in work)
    why = f"on {usable_cores()} cores, and no accelerator was found"
    agreed = asked or device != "auto"
    what = f"{water:.0f} s of water in {cells}"
    cost.time(verb, cpu_seconds(work), what, instead=instead, flag=flag, agreed=agreed, limit=UNASKED, why=why)
