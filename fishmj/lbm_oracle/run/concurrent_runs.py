"""Several runs side by side in one process: the host looks after one tank while the device works on another's water.

Every tank has its own stream; `ConcurrentRuns.tick` goes round, finishing one step of each and beginning its next. Tanks share
nothing, so that results do not depend on their number or order.
"""

from collections.abc import Sequence

from fishmj.errors import ConfigError, OracleUnstable, SimDiverged
from fishmj.lbm_oracle.run.run import LeftDomain, Run


class ConcurrentRuns:
    """Runs that tick together. One that stops (see `Run.stopped`) is left as it is; the others go on."""

    def __init__(self, runs: Sequence[Run]):
        if not runs:
            raise ConfigError("tanks: no runs")
        self.runs = list(runs)

    @property
    def swimming(self) -> list[int]:
        """Numbers of the runs that have not stopped."""
        return [i for i, run in enumerate(self.runs) if not run.stopped]

    def tick(self, commands=None) -> list[int]:
        """One bus tick of all; commands (B, J) rad, or None for prescribed joints. Returns the numbers still swimming.

        Raises:
            ConfigError: not one command for every tank.
        """
        if commands is not None and len(commands) != len(self.runs):
            raise ConfigError(f"tanks: {len(commands)} commands for {len(self.runs)} tanks; stopped ones count")
        going = {i: self.runs[i].ticking(None if commands is None else commands[i]) for i in self.swimming}
        while going:
            for i in list(going):
                try:
                    next(going[i])
                except StopIteration:
                    del going[i]
                except (LeftDomain, SimDiverged, OracleUnstable) as error:
                    self.runs[i].stopped = str(error)
                    del going[i]
        return self.swimming
