"""Is there enough in a set of records to tell effects apart? Asked before a search, so that no name comes out of nothing.

too few    one record cannot both fit and judge
too short  no record lasts 2 s: less than two beats
too quiet  no command moves, nothing was pushed and no water flowed: every effect predicts the same rest
"""

from collections import Counter
from dataclasses import dataclass

import numpy as np

from fishmj import effects
from fishmj.gap.records.records import Record
from fishmj.gap.wording import title

FEWEST, SHORTEST, QUIETEST = 2, 2.0, np.radians(1.0)  # records, s, rad of command from end to end
NEXT = 4  # excitations to suggest


@dataclass(frozen=True)
class InsufficientData:
    """Why nothing can be told. confounded: effects that these records cannot tell apart. record: excitations to do next."""

    reason: str
    confounded: tuple[str, ...]
    record: tuple[str, ...]

    def text(self) -> str:
        """For a terminal."""
        names, todo = ", ".join(map(title, self.confounded)), ", ".join(self.record)
        return f"{self.reason}\nconfounded: {names}\nrecord next: {todo} (fishmj.excitation; two runs of each)"


def insufficient_data(records: list[Record], catalogue) -> "InsufficientData | None":
    """What is missing, or None."""
    moved = max((float(np.ptp(r.commands, 0).max()) for r in records), default=0.0)
    alone = not any(np.any(r.push) or np.any(r.flow) for r in records)
    longest = max((r.seconds for r in records), default=0.0)
    if len(records) < FEWEST:
        reason = f"too few: {len(records)} record, at least {FEWEST} are needed, one to fit and one to judge"
    elif longest < SHORTEST:
        reason = f"too short: the longest record has {longest:.2f} s, at least {SHORTEST:g} s are needed"
    elif moved < QUIETEST and alone:
        reason = f"too quiet: commands move by {np.degrees(moved):.2f} deg at most, nothing was pushed and no water flowed"
    else:
        return None
    measured = channels(records)
    seen = [e for e in catalogue if measured & set(e.shows)]
    names = {e.name for e in seen}
    votes = Counter(x for e in seen for c in e.confusions if c.other in names for x in c.excitations)
    return InsufficientData(reason, tuple(sorted(names)), tuple(x for x, _ in votes.most_common(NEXT)))


def channels(records: list[Record]) -> set[str]:
    """Channels that were measured."""
    has = lambda name: any(getattr(r, name) is not None for r in records)
    found = {"joint"} if has("joint") else set()
    return found | ({"position", "heading"} if has("pose") else set()) | ({"power"} if has("power") else set())


def deterministic_effects() -> list:
    """All effects that change the mean of a log."""
    return [e for e in effects.catalogue().values() if not e.stochastic]
