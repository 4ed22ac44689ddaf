"""The last state of a run that was certainly sound, so that a blow-up can be looked at, or started again with a smaller step.

A state is sound when the watch has found the water well *after* it. The newest one that was seen only before a look is a
candidate; the look that comes next makes it the last good one. Both stay on the device until they are needed:
176 bytes a cell.
"""

from pathlib import Path

from fishmj.lbm_oracle.immersed import snapshot
from fishmj.lbm_oracle.run.run import Run
from fishmj.lbm_oracle.run.time_refinement import TickState, checkpoint, restore


class LastGood:
    """Keeps the last good state of one run: at most two looks of the watch old."""

    def __init__(self) -> None:
        self.good: TickState | None = None
        self.candidate: TickState | None = None
        self.looks = 0

    def look(self, run: Run) -> None:
        """To be called after every tick."""
        if run.watch.looks > self.looks or self.candidate is None:
            self.looks, self.good = run.watch.looks, self.candidate
            self.candidate = checkpoint(run.coupled)

    def save(self, path: str | Path, run: Run) -> str:
        """Put the run back to its last good state and write it; "" where there was none: the water failed at once."""
        if self.good is None:
            return ""
        restore(run.coupled, self.good)
        notes = {"robot": run.robot.name, "stopped": run.stopped, "last_good": True}
        return str(snapshot.save(path, run.coupled, **notes))
