"""Who steers: a policy, one decision every control step and one command a tick; or commands that were written down before."""

from collections.abc import Callable
from typing import Protocol

import numpy as np

from fishmj.base.errors import FishmjError
from fishmj.control.learned import LearnedController
from fishmj.engines import ticks_per

Observe = Callable[[], np.ndarray | None]


class Pilot(Protocol):
    """What the swim asks for commands.

    Attributes:
        obs, action: of the newest decision, (5 + 2 J,) and (J,); None where there is none. trouble: why it gave no command.
    """

    obs: np.ndarray | None
    action: np.ndarray | None
    trouble: str

    def reset(self) -> None:
        """A new swim."""

    def pause(self) -> None:
        """The fish is held; what was decided no longer holds."""

    def command(self, slot: int, observe: Observe, last: np.ndarray) -> tuple[np.ndarray | None, bool]:
        """The command (J,) rad of tick `slot`, and whether it was decided now.

        Args:
            observe: gives the observation (5 + 2 J,), None where it is not complete. last: (J,) rad, the command on the bus.
        Returns:
            (None, True) where there is no finite answer; `trouble` says what it was.
        """


class PlayedPilot:
    """Commands (T, J) rad, one a tick from the first on; the last one stays.

    A tick that was left out leaves its command out: the rhythm stays.
    """

    def __init__(self, commands: np.ndarray):
        self.commands = np.asarray(commands, float)
        self.obs: np.ndarray | None = None
        self.action: np.ndarray | None = None
        self.trouble = ""
        self._begun: int | None = None

    def reset(self) -> None:
        self._begun = None

    def pause(self) -> None:
        """Nothing to forget."""

    def command(self, slot: int, observe: Observe, last: np.ndarray) -> tuple[np.ndarray | None, bool]:
        if self._begun is None:
            self._begun = slot
        return self.commands[min(slot - self._begun, len(self.commands) - 1)], False


class PolicyPilot:
    """A policy: its commands begin wherever the last command left the joints."""

    def __init__(self, controller: LearnedController):
        self.controller = controller
        self.obs: np.ndarray | None = None
        self.action: np.ndarray | None = None
        self.trouble = ""
        self._chunk: np.ndarray | None = None
        self._begun = 0
        _, self.ticks = ticks_per(controller.robot)
        controller.reset(1)

    def reset(self) -> None:
        """Forget the past: a new swim."""
        self.controller.reset(1)
        self.obs = self.action = self._chunk = None
        self.trouble = ""

    def pause(self) -> None:
        """Whatever was decided no longer holds; the next tick decides anew."""
        self._chunk = None

    def command(self, slot: int, observe: Observe, last: np.ndarray) -> tuple[np.ndarray | None, bool]:
        fresh = self._chunk is None or slot - self._begun >= self.ticks
        if fresh:
            if (obs := observe()) is None:
                self.pause()
                return last, False
            if (
                self._chunk is None
            ):  # else it begins where the one before was to end, as in training, whatever the limits left of it
                self.controller.command = last[None].copy()
            self.obs, self.action = obs, None
            try:
                chunk = self.controller(obs[None])[0]
                self.action = np.array(self.controller.action[0], float)
            except FishmjError as error:
                self.trouble = str(error)
                return None, True
            if not np.isfinite(chunk).all():
                self.trouble = f"policy {self.controller.name}: commands {chunk[-1].tolist()} for observation {obs.tolist()}"
                return None, True
            self._chunk, self._begun = chunk, slot
        chunk = self._chunk
        return (None if chunk is None else chunk[slot - self._begun]), fresh
