"""What tests of the host share: a clock that moves when told, a robot of three joints that follows, a transport between them."""

from collections import deque
from pathlib import Path

import numpy as np

from fishmj.control.learned import LearnedController
from fishmj.deploy.link.links import Received, Sent
from fishmj.deploy.loop.arming import Refusal, examine
from fishmj.deploy.loop.pilot import PolicyPilot
from fishmj.deploy.loop.supervisor import NONE
from fishmj.deploy.loop.swim_loop import Rig, SwimLoop, SwimPlan
from fishmj.deploy.loop.trial_log import TrialLog
from fishmj.deploy.protocols.messages import RobotInfo, RobotState, ServoFault, Telemetry
from fishmj.deploy.tracker.fix import Fix
from fishmj.mjcf.reading import load_robot

DT = 0.02
COVARIANCE = np.diag([1e-6, 1e-6, 1e-5])


class FakeClock:
    """Moves only when somebody sleeps, and to where a test sets it; `overslept`: s added to each of the next sleeps."""

    def __init__(self, start: float = 100.0):
        self.t, self.overslept = start, deque()

    def now(self) -> float:
        return self.t

    def sleep_until(self, t: float) -> None:
        self.t = max(self.t, t) + (self.overslept.popleft() if self.overslept else 0.0)


class FakeRobot:
    """A link and a robot behind it: joints follow at 5 rad/s, telemetry comes at every tick; everything can be set wrong.

    Attributes:
        silent: nothing is heard. deaf: commands do not arrive. changes: fields of the telemetry to replace. joint_of: joint ->
            the angle that is told, for joints that do not follow. sent: commands (J,), in order.
    """

    name, watched, greets, lacks = "fake", True, True, ()
    robot_clock = None

    def __init__(self, clock: FakeClock, joints: int = 3):
        self.clock, self.joint, self.goal = clock, np.zeros(joints), np.zeros(joints)
        self.counts = {"packets": 0, "bad": 0, "old": 0}
        self.silent = self.deaf = False
        self.changes: dict = {}
        self.stuck: set[int] = set()
        self.state = RobotState.IDLE
        self.sent: list[np.ndarray] = []
        self.info = RobotInfo("fake-1", "", (1, 2, 3), ("j1", "j2", "j3"), np.pi / 3, 0.1, 0.3)
        self.greeted = self.disarmed = 0
        self._seq, self._echo, self._number, self._last = 0, None, 0, clock.now()

    def open(self) -> None: ...
    def close(self) -> None: ...
    def forget(self) -> None: ...

    def silence(self) -> str:
        return ""

    def hello(self, now: float) -> None:
        self.greeted += 1

    def arm(self, now: float, hold: float, neutral: float) -> None:
        self.state = RobotState.ARMED

    def disarm(self, now: float) -> None:
        self.disarmed += 1
        if not self.deaf:
            self.state = RobotState.IDLE

    def send(self, joint: np.ndarray, now: float) -> Sent:
        self._seq += 1
        self.sent.append(np.array(joint))
        if not self.deaf:
            self.goal, self._echo = np.array(joint), (self._seq, now)
        return Sent(self._seq, now, b"")

    def receive(self, now: float) -> list[Received]:
        step = 5.0 * (now - self._last)
        self._last = now
        moved = self.joint + np.clip(self.goal - self.joint, -step, step)
        self.joint = np.where([k in self.stuck for k in range(len(moved))], self.joint, moved)
        if self.silent:
            return []
        found: list[Received] = []
        if self.greeted:
            self.greeted = 0
            found.append(Received(now, self.info))
        self._number += 1
        echo, at = self._echo or (None, None)
        told = Telemetry(
            tuple(self.joint), self._number, now - 90.0, echo, at, self.state, 7.4, 0.5, (7.4,) * 3, (25.0,) * 3,
            (ServoFault.NONE,) * 3,
        )  # fmt: skip
        return [*found, Received(now, told._replace(**self.changes))]


class FakeEyes:
    """Fixes of a fish that drifts slowly, `age` s old; none while `blind`, shifted by `shift` m."""

    def __init__(self, clock: FakeClock):
        self.clock, self.blind, self.shift, self.frozen, self.age = clock, False, 0.0, False, 0.06
        self.counts = {"frames": 0, "fixes": 0}
        self.failed: Exception | None = None
        self._x = 0.0

    def open(self) -> None: ...
    def close(self) -> None: ...

    def fixes(self, now: float) -> list[Fix]:
        if self.blind:
            return []
        if not self.frozen:
            self._x = 0.3 + 0.01 * (now - 100.0)
        return [Fix(now - self.age, self._x + self.shift, 0.2, 0.1, COVARIANCE, 1.0)]


class Bench:
    """A swim of the fakes under a real policy; `at(t, what)` calls `what()` t s after the policy took over."""

    def __init__(self, folder: Path, *, seconds: float = 3.0, at_the_tank: bool = False, pilot=None, plan: dict | None = None):
        self.clock, self.folder = FakeClock(), folder
        self.robot, self.eyes = FakeRobot(self.clock), FakeEyes(self.clock)
        self.description = load_robot("fish")
        self.controller = LearnedController(self.description, "station")
        self.pilot = pilot or PolicyPilot(self.controller)
        self.rig = Rig(
            robot=self.description, link=self.robot, localiser=self.eyes, clock=self.clock,
            examine=lambda info: examine(self.robot, info, self.description, self.controller, at_the_tank),
        )  # fmt: skip
        self.plan = SwimPlan(seconds=seconds, **(plan or {}))
        self.agenda: list[tuple[float, object]] = []
        self.stopped = False

    def at(self, t: float, what) -> None:
        self.agenda.append((t, what))

    def swim(self, **options):
        with TrialLog(self.folder, {"origin": "synthetic", "robot": "fish"}, 3, every=1e6) as log:
            self.log = log
            self.made = SwimLoop(self.rig, self.pilot, self.plan, log, stop=self._stop, **options)
            return self.made.run()

    def _stop(self) -> bool:
        begun = self.made.began
        for entry in [e for e in self.agenda if begun is not None and self.clock.now() - begun >= e[0] - 1e-9]:
            self.agenda.remove(entry)
            entry[1]()
        return self.stopped

    @property
    def events(self) -> list:
        return self.rig.supervisor.events

    def to_neutral(self) -> float:
        """s from SWIMMING to NEUTRAL."""
        t = {event.after.name: event.t for event in self.events}
        return t["NEUTRAL"] - t["SWIMMING"]


NOTHING = Refusal(NONE, ())
