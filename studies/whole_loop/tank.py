"""The loopback robot in lockstep behind the host's own commands: the same options, no second process, no waiting.

    tank = Tank()
    swim_command.main([..., "--link", "loopback", "--loopback", "--seed 3 --flow 0.2,0"], wire=tank.wire)
    tank.path, tank.begun                    # true path of the fish, and start of the host's steering

No camera is drawn: the host gets poses with the noise of training and the latency of frames.
"""

from contextlib import ExitStack
from dataclasses import replace
from typing import Any, cast

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.deploy.link.links import Fishmj1Link, Sent
from fishmj.deploy.loop.wiring import Wired
from fishmj.deploy.loopback.lockstep import FixNoise, LockstepClock, LockstepTransport, wired
from fishmj.deploy.loopback.robot import LoopbackRobot
from fishmj.deploy.protocols import PROTOCOLS
from fishmj.mjcf.description import Robot


class Watched(LockstepClock):
    """Lockstep clock that records the true pose at each of its steps."""

    def __init__(self, robot: LoopbackRobot):
        super().__init__(robot)
        self.rows: list[tuple[float, ...]] = []

    def sleep_until(self, t: float) -> None:
        """Advances the robot to time t, s, and records its pose."""
        super().sleep_until(t)
        self.rows.append((self.now(), *map(float, self.robot.pose())))


class FirstNoted(Fishmj1Link):
    """Link that records the time of its first command, s: row 0 of the table `cmd` of the host's log."""

    first: float | None = None

    def send(self, joint: np.ndarray, now: float) -> Sent:
        """Sends joint angles (J,) rad at `now`, s, and records the time of the first call."""
        self.first = now if self.first is None else self.first
        return super().send(joint, now)


class Tank:
    """Opens loopback robots in lockstep, one for each command, and keeps the path of the last one."""

    def __init__(self) -> None:
        self._clock: Watched | None = None
        self._link: FirstNoted | None = None

    @property
    def path(self) -> np.ndarray:
        """Path (T, 4): the host's clock [s], true x, y [m], yaw [rad] of the reference point; (0, 4) before the first command."""
        return np.array(self._clock.rows if self._clock is not None else []).reshape(-1, 4)

    @property
    def begun(self) -> float:
        """Time of the first command, s on the host's clock; NaN without one."""
        return float("nan") if self._link is None or self._link.first is None else self._link.first

    def wire(self, args: Any, robot: Robot, stack: ExitStack) -> Wired:
        """Replaces `wiring.wire`. Raises ConfigError for options of a robot that lockstep does not support."""
        if args.link != "loopback" or args.protocol != PROTOCOLS[0]:
            raise ConfigError(f"lockstep: --link {args.link} --protocol {args.protocol}; expected loopback and {PROTOCOLS[0]}")
        found = wired(args, robot, stack, Watched, FixNoise.of_the_task())
        self._clock = clock = cast(Watched, found.clock)
        self._link = link = FirstNoted(LockstepTransport(clock))
        return replace(found, link=link)
