"""Asks before work of more than a week or more memory than there is; without a terminal it raises TooMuch.

    cost.time("train", seconds, "1e+11 control steps", instead="take fewer --steps", flag="--yes", agreed=args.yes)

The caller estimates the cost from sizes and measured rates. The estimate may be wrong by a factor of two.
"""

from fishmj.base import console
from fishmj.base.cores import memory_bytes
from fishmj.base.errors import TooMuch

LONG = 7 * 86400.0  # s that a command takes without being asked
ROOM = 0.8  # of the memory of the machine


def time(
    verb: str, seconds: float, what: str, *, instead: str, flag: str, agreed: bool = False, limit: float = LONG, why: str = ""
) -> None:
    """Asks for agreement to `seconds` of work if they are more than `limit`.

    Args:
        what: the work, in numbers. instead: a cheaper request. flag: option that agrees; agreed: True if it was given.
        why: reason that it takes so long here.

    Raises TooMuch: not agreed.
    """
    if not agreed and seconds > limit:
        _ask(f"{verb}: {what} would take about {console.duration(seconds)}{why and f' {why}'}", instead, flag)


def memory(
    verb: str, need: float, what: str, *, instead: str, flag: str = "", agreed: bool = False, there: float | None = None
) -> None:
    """Asks for agreement to `need` bytes if they are more than the share `ROOM` of those there are, by default in this machine.

    Args:
        as `time`; without a flag the work is refused.

    Raises TooMuch: not agreed.
    """
    there = memory_bytes() if there is None else there
    if not agreed and need > ROOM * there:
        have = f"there are {there / 2**30:.3g} GB"
        _ask(f"{verb}: {what} would need about {need / 2**30:,.4g} GB of memory, {have}", instead, flag)


def _ask(said: str, instead: str, flag: str) -> None:
    if not (flag and console.confirmed(f"fishmj: {said}; {instead}. Begin all the same?")):
        raise TooMuch(f"{said}; nothing was begun: {instead}" + (f"; {flag} begins all the same" if flag else ""))
