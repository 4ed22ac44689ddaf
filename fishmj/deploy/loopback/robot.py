"""The loopback robot: radio, microcontroller, body and camera on one clock that somebody else moves.

    robot = LoopbackRobot(bodies.make("virtual"), "fishmj-1", faults.parse(["silent_radio@10-12"]), seed=3)
    robot.receive(datagram)              # the host sends it now
    datagrams = robot.advance(0.02)      # what reached the host in the meantime
    robot.frames(since)                  # camera frames that became readable

Everything happens at whole milliseconds, in an order that only the seed decides: the same calls give the same bytes.
"""

import heapq
from collections.abc import Callable, Iterable
from functools import partial
from itertools import count
from math import ceil

import numpy as np

from fishmj.deploy.loopback import network_faults
from fishmj.deploy.loopback.body import MILLISECOND, Body
from fishmj.deploy.loopback.camera import CameraTiming, Frame, LoopbackCamera
from fishmj.deploy.loopback.faults import Fault
from fishmj.deploy.loopback.firmware import PERIOD, PROTOCOLS, Firmware, firmware_of
from fishmj.deploy.loopback.network_faults import Arrival, Radio
from fishmj.deploy.loopback.readings import Readings
from fishmj.deploy.loopback.robot_faults import RobotFaults
from fishmj.deploy.loopback.servos import Servos

Step = Callable[[], None]


class LoopbackRobot:
    """One robot in its tank.

    Args:
        body: what moves (`bodies.make`), at its time 0.
        protocol: one of `firmware.PROTOCOLS`. With "servo-bus" datagrams are pieces of the byte stream on the servos' wire.
        faults: `faults.parse`. seed: of radio and exposures; the body has its own.
        delay, spread: s, of the radio each way without faults.
        camera: when frames are taken; by default with the description's latency.
        policy_sha256: what INFO says of a policy in the firmware.

    Attributes:
        restarts: how often the microcontroller booted again.

    Raises:
        UnknownName, ConfigError: a protocol or a fault that this robot cannot have.
    """

    def __init__(
        self, body: Body, protocol: str = PROTOCOLS[0], faults: Iterable[Fault] = (), seed: int = 0, *,
        delay: float = network_faults.DELAY, spread: float = network_faults.SPREAD, camera: CameraTiming | None = None,
        policy_sha256: str = "",
    ):  # fmt: skip
        given = tuple(faults)
        self.body, self.protocol, self.restarts = body, protocol, 0
        self._policy = policy_sha256
        self._down, self._up = (Radio(way, seed, given, delay, spread) for way in ("down", "up"))
        self._faults = RobotFaults(body, given)
        timing = camera or CameraTiming(latency=body.robot.timing.camera_latency)
        self.camera = LoopbackCamera(body, timing, seed, given)
        self._now = 0  # ms
        self._agenda: list[tuple[int, int, Step]] = []
        self._order = count()
        self._arrived: list[Arrival] = []
        self._told: tuple[float, ...] | None = None  # rad, what the servos were sent last
        self.firmware: Firmware | None = None
        for t in self._faults.edges():
            self._at(t, lambda: self._faults.tell_the_body(self.time))
        for death, boot in self._faults.brown_outs():
            self._at(death, self._die)
            self._at(boot, self._boot)
        self._faults.tell_the_body(0.0)
        self._readings = self._read()
        self._boot()
        self.restarts = 0
        self._at(self.camera.next_exposure() * MILLISECOND, self._expose)

    @property
    def time(self) -> float:
        """s since the start."""
        return self._now * MILLISECOND

    def receive(self, data: bytes) -> None:
        """The host sends a datagram now; it arrives when, and if, the radio lets it."""
        for arrival in self._down.send(self.time, data):
            self._at(arrival.t, partial(self._hear, arrival.data))

    def advance(self, seconds: float) -> list[bytes]:
        """Move on; returns the datagrams that reached the host meanwhile."""
        return [arrival.data for arrival in self.advance_to(self.time + seconds)]

    def advance_to(self, t: float) -> list[Arrival]:
        """Move on to t [s], or to the next whole millisecond after it; returns what reached the host meanwhile, and when."""
        goal = ceil(t / MILLISECOND - 1e-6)
        while self._agenda and self._agenda[0][0] <= goal:
            when, _, step = heapq.heappop(self._agenda)
            self._move(when)
            step()
        self._move(goal)
        arrived, self._arrived = self._arrived, []
        return arrived

    def next_event(self) -> float:
        """s at which something happens next by itself."""
        return self._agenda[0][0] * MILLISECOND

    def pose(self) -> np.ndarray:
        """(3,): true x, y [m] and yaw [rad] of the reference point."""
        return self.body.truth()[:3]

    def frames(self, since: float) -> list[Frame]:
        """Camera frames that can be read now and became readable after `since` [s], oldest first."""
        return self.camera.frames(since, self.time)

    def _at(self, t: float, step: Step) -> None:
        """Do a step at t [s], not before now."""
        heapq.heappush(self._agenda, (max(round(t / MILLISECOND), self._now), next(self._order), step))

    def _move(self, when: int) -> None:
        if when > self._now:
            self.body.advance((when - self._now) * MILLISECOND)
            self._now = when

    def _boot(self) -> None:
        """A new life of the microcontroller: numbers and clock from the beginning, IDLE."""
        self.restarts += 1
        self._told = None
        self.firmware = firmware = firmware_of(self.protocol, self.body.robot, self.time, self._policy)
        self.body.torque(False)
        self._at(self.time, partial(self._tick, firmware))

    def _die(self) -> None:
        """The supply is gone: nothing is heard, said or held."""
        self.firmware = None
        self.body.torque(False)

    def _tick(self, firmware: Firmware) -> None:
        """Read the servos, tell them where to go, send telemetry; every 20 ms while this life lasts."""
        if firmware is not self.firmware:
            return
        self._readings = self._read()
        if isinstance(firmware, Servos):
            firmware.readings = self._readings
        self._act(firmware)
        if told := firmware.report(self.time, self._readings):
            self._say(told)
        self._at(self.time + PERIOD, partial(self._tick, firmware))

    def _hear(self, data: bytes) -> None:
        if self.firmware is None:
            return
        if isinstance(self.firmware, Servos):
            self._readings = self.firmware.readings = self._read()
        moves, answers = self.firmware.hear(data, self.time, self._readings.measured)
        if moves:
            self._act(self.firmware, taken=True)
        for answer in answers:
            self._say(answer)

    def _act(self, firmware: Firmware, taken: bool = False) -> None:
        """Tell the servos, where they are to go elsewhere or a command was taken: more would be repeats that hide a lost one."""
        target = firmware.act(self.time, self._readings.measured)
        self.body.torque(target is not None)
        if target is not None and (taken or target != self._told):
            self.body.send(target)
        self._told = target

    def _say(self, data: bytes) -> None:
        for arrival in self._up.send(self.time, data):
            self._at(arrival.t, partial(self._reach, arrival))

    def _reach(self, arrival: Arrival) -> None:
        self._arrived.append(arrival)

    def _read(self) -> Readings:
        return self._faults.readings(self.time, self.body.sensors(), self._told)

    def _expose(self) -> None:
        self.camera.expose()
        self._at(self.camera.next_exposure() * MILLISECOND, self._expose)
