"""Pilots: a policy, with one decision every control step and one command a tick; or prepared commands."""

from collections.abc import Callable
from typing import Protocol

import numpy as np

from fishmj.base.errors import FishmjError
from fishmj.control.learned import LearnedController
from fishmj.engines import ticks_per

Observe = Callable[[], np.ndarray | None]


class Pilot(Protocol):
    """Interface of a pilot, which gives the swim its commands.

    Attributes:
        obs, action: of the newest decision, (5 + 2 J,) and (J,); None without one. trouble: reason for a missing command.
    """

    obs: np.ndarray | None
    action: np.ndarray | None
    trouble: str

    def reset(self) -> None:
        """Starts a new swim."""

    def pause(self) -> None:
        """Discards the running decision while the fish is held."""

    def command(self, slot: int, observe: Observe, last: np.ndarray) -> tuple[np.ndarray | None, bool]:
        """The command (J,) rad of tick `slot`, and True if it was decided now.

        Args:
            observe: gives the observation (5 + 2 J,), None if it is not complete. last: (J,) rad, the command on the bus.

        Returns:
            (None, True) if the answer is not finite; `trouble` describes it.
        """


class PlayedPilot:
    """Commands (T, J) rad, one a tick from the first on; the last one stays.

    A skipped tick skips its command, so that the rhythm stays.
    """

    def __init__(self, commands: np.ndarray):
        self.commands = np.asarray(commands, float)
        self.obs: np.ndarray | None = None
        self.action: np.ndarray | None = None
        self.trouble = ""
        self._begun: int | None = None

    def reset(self) -> None:
        """Starts the commands again at the next tick."""
        self._begun = None

    def pause(self) -> None:
        """Does nothing: the commands follow the ticks."""

    def command(self, slot: int, observe: Observe, last: np.ndarray) -> tuple[np.ndarray | None, bool]:
        """The prepared command of tick `slot`, and False."""
        if self._begun is None:
            self._begun = slot
        return self.commands[min(slot - self._begun, len(self.commands) - 1)], False


class PolicyPilot:
    """A policy whose commands begin at the last command's angles."""

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
        """Forgets the past for a new swim."""
        self.controller.reset(1)
        self.obs = self.action = self._chunk = None
        self.trouble = ""

    def pause(self) -> None:
        """Discards the running decision; the next tick decides anew."""
        self._chunk = None

    def command(self, slot: int, observe: Observe, last: np.ndarray) -> tuple[np.ndarray | None, bool]:
        """The policy's command of tick `slot`, and True if it was decided now; (last, False) without an observation."""
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
