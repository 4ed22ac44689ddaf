"""Keys from a terminal without waiting for Enter, and what they do to the pond."""

import os
import select
import sys
from collections.abc import Iterator

import numpy as np

from fishmj.controllers import Controller
from fishmj.play.live_session import LiveSession

SPEED_STEP, TURN_STEP, TARGET_STEP = 0.02, np.pi / 12, 0.1  # m/s, rad, m a key press
REACH = 1.5  # m, the target stays in |x|, |y| <= REACH
ARROWS = {"\x1b[A": "up", "\x1b[B": "down", "\x1b[C": "right", "\x1b[D": "left"}
ARROWS |= {code.replace("[", "O"): name for code, name in ARROWS.items()}  # terminals in application mode
MOVES = {"w": (0, 1), "a": (-1, 0), "s": (0, -1), "d": (1, 0)}


class Keyboard:
    """Reads keys while in its `with` block; the terminal is put back as it was. Without a handle there are never keys."""

    def __init__(self, handle: int | None = None):
        self.handle = handle

    @classmethod
    def of_terminal(cls) -> "Keyboard":
        """Standard input, if it is a terminal."""
        return cls(sys.stdin.fileno() if sys.stdin and sys.stdin.isatty() else None)

    def __enter__(self) -> "Keyboard":
        if self.handle is not None:
            import termios
            import tty

            self._before = termios.tcgetattr(self.handle)
            tty.setcbreak(self.handle)
        return self

    def __exit__(self, *failure) -> None:
        if self.handle is not None:
            import termios

            termios.tcsetattr(self.handle, termios.TCSADRAIN, self._before)

    def read(self) -> list[str]:
        """The keys pressed since the last call, by name; never waits."""
        if self.handle is None or not select.select([self.handle], [], [], 0)[0]:
            return []
        text, keys = os.read(self.handle, 256).decode("utf-8", "ignore"), []
        while text:
            length = 3 if text[:3] in ARROWS else 1
            keys.append(ARROWS.get(text[:length], text[:length].lower()))
            text = text[length:]
        return keys


def press(session: LiveSession, key: str, choices: Iterator[Controller | str]) -> None:
    """What a key does: arrows change the current, w a s d the target, c the controller, r starts again; others do nothing."""
    flow = session.flow
    if key in ("up", "down"):
        session.set_flow(flow.speed + (SPEED_STEP if key == "up" else -SPEED_STEP), flow.direction)
    elif key in ("left", "right"):
        session.set_flow(flow.speed, flow.direction + (TURN_STEP if key == "left" else -TURN_STEP))
    elif key in MOVES:
        session.target = np.clip(session.target + TARGET_STEP * np.array(MOVES[key]), -REACH, REACH)
    elif key == "c":
        session.choose(next(choices))
    elif key == "r":
        session.reset()
