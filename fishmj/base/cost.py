"""Days of work, and memory that the machine has not: said before anything begins, asked for on a terminal, refused elsewhere.

    cost.time("train", seconds, "1e+11 control steps", instead="take fewer --steps", flag="--yes", agreed=args.yes)

The estimate is the caller's, from sizes and measured rates; half or twice of it is as good as it gets.
"""

from fishmj.base import console
from fishmj.base.cores import memory_bytes
from fishmj.base.errors import TooMuch

LONG = 7 * 86400.0  # s that a command takes without being asked
ROOM = 0.8  # of the memory of the machine


def time(
    verb: str, seconds: float, what: str, *, instead: str, flag: str, agreed: bool = False, limit: float = LONG, why: str = ""
) -> None:
    """Have `seconds` of work agreed to where they are more than `limit`.

    Args:
        what: is to be done, in numbers. instead: what to ask for in its place. flag: begins all the same; agreed: it was given.
        why: it takes so long here.

    Raises:
        TooMuch: nobody agreed.
    """
    if not agreed and seconds > limit:
        _ask(f"{verb}: {what} would take about {console.duration(seconds)}{why and f' {why}'}", instead, flag)


def memory(
    verb: str, need: float, what: str, *, instead: str, flag: str = "", agreed: bool = False, there: float | None = None
) -> None:
    """Have `need` bytes agreed to where they are more than `ROOM` of those there are, by default in this machine.

    Args:
        as `time`; without a flag they are refused.

    Raises:
        TooMuch: nobody agreed.
    """
    there = memory_bytes() if there is None else there
    if not agreed and need > ROOM * there:
        have = f"there are {there / 2**30:.3g} GB"
        _ask(f"{verb}: {what} would need about {need / 2**30:,.4g} GB of memory, {have}", instead, flag)


def _ask(said: str, instead: str, flag: str) -> None:
    if not (flag and console.confirmed(f"fishmj: {said}; {instead}. Begin all the same?")):
        raise TooMuch(f"{said}; nothing was begun: {instead}" + (f"; {flag} begins all the same" if flag else ""))
