"""Questions to the person at the rig: on the terminal, or from a file of answers, one a line."""

import sys
from typing import TextIO

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.deploy.loop.swim_loop import Rig

STOP = ("q", "quit", "stop")
HANDS_OFF = 3  # s from the person's word to torque: both hands out of the water, one at the switch


class Person:
    """Asks questions and reads lines. answers: their source, by default standard input."""

    def __init__(self, answers: TextIO | None = None):
        self.answers = answers

    def asked(self, question: str) -> str:
        """One line of answer, stripped. Raises ConfigError: no answer is available, or the answer is q."""
        console.say(question)
        line = (self.answers or sys.stdin).readline()
        if not line:
            raise ConfigError(f"nobody answers {question!r}; run it on a terminal, or give the answers on standard input")
        answer = line.strip()
        if answer.lower() in STOP:
            raise ConfigError(f"stopped by the person at {question!r}; what was finished is kept, the same command goes on")
        return answer

    def ready(self, what: str) -> None:
        """Waits until the person has confirmed a step."""
        self.asked(f"{what}; then press Enter (q stops)")

    def hands_off(self, rig: Rig) -> None:
        """Counts down before the robot gets torque; the fixes until then are dropped, for a hand may still move the fish."""
        for left in range(HANDS_OFF, 0, -1):
            console.say(f"hands off: {left}")
            rig.clock.sleep_until(rig.clock.now() + 1.0)
        rig.localiser.fixes(rig.clock.now())

    def number(self, what: str, low: float, high: float, empty: bool = False) -> float | None:
        """A number of a range; asks again until it is valid. empty: Enter alone is None. Raises ConfigError: as `asked`."""
        while True:
            answer = self.asked(f"{what} ({low:g} to {high:g}{', Enter when done' if empty else ''}):")
            if empty and not answer:
                return None
            try:
                value = float(answer.replace(",", "."))
            except ValueError:
                console.say(f"{answer[:40]!r} is no number")
                continue
            if low <= value <= high:
                return value
            console.say(f"{value:g} is outside {low:g} to {high:g}: is the unit right?")
