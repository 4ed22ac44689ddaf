"""The loopback robot: radio, microcontroller, body and camera on one clock, which its owner advances.

    robot = LoopbackRobot(bodies.make("virtual"), "fishmj-1", faults.parse(["silent_radio@10-12"]), seed=3)
    robot.receive(datagram)              # the host sends it now
    datagrams = robot.advance(0.02)      # received by the host in the meantime
    robot.frames(since)                  # camera frames that became readable

Everything happens at whole milliseconds, in an order that depends on the seed alone: the same calls give the same bytes.
"""

import heapq
from collections.abc import Callable, Iterable
from functools import partial
from itertools import count
from math import ceil

import numpy as np

from fishmj.deploy.loopback import network_faults
from fishmj.deploy.loopback.camera import CameraFrame, CameraTiming, LoopbackCamera
from fishmj.deploy.loopback.faults import LoopbackFault
from fishmj.deploy.loopback.firmware import PERIOD, Firmware, firmware_of
from fishmj.deploy.loopback.loopback_body import MILLISECOND, Body
from fishmj.deploy.loopback.loopback_servos import LoopbackServos
from fishmj.deploy.loopback.network_faults import Arrival, RadioChannel
from fishmj.deploy.loopback.readings import Readings
from fishmj.deploy.loopback.robot_faults import RobotFaults
from fishmj.deploy.protocols import PROTOCOLS

Step = Callable[[], None]


class LoopbackRobot:
    """One robot in its tank.

    Args:
        body: the moving body (`bodies.make`), at its time 0.
        protocol: one of `protocols.PROTOCOLS`. With "servo-bus" datagrams are pieces of the byte stream on the servos' wire.
        faults: `faults.parse`. seed: of radio and exposures; the body has its own.
        delay, spread: s, of the radio each way without faults.
        camera: timing of frames; by default with the description's latency.
        policy_sha256: hash in INFO of a policy in the firmware.

    Attributes:
        restarts: number of reboots of the microcontroller.

    Raises UnknownName, ConfigError: a protocol or a fault that this robot does not support.
    """

    def __init__(
        self, body: Body, protocol: str = PROTOCOLS[0], faults: Iterable[LoopbackFault] = (), seed: int = 0, *,
        delay: float = network_faults.DELAY, spread: float = network_faults.SPREAD, camera: CameraTiming | None = None,
        policy_sha256: str = "",
    ):  # fmt: skip
        given = tuple(faults)
        self.body, self.protocol, self.restarts = body, protocol, 0
        self._policy = policy_sha256
        self._down, self._up = (RadioChannel(way, seed, given, delay, spread) for way in ("down", "up"))
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
        """Time since the start, s."""
        return self._now * MILLISECOND

    def receive(self, data: bytes) -> None:
        """Takes a datagram that the host sends now; the radio decides on its arrival."""
        for arrival in self._down.send(self.time, data):
            self._at(arrival.t, partial(self._hear, arrival.data))

    def advance(self, seconds: float) -> list[bytes]:
        """Advances by `seconds` s; returns the datagrams that reached the host in that time."""
        return [arrival.data for arrival in self.advance_to(self.time + seconds)]

    def advance_to(self, t: float) -> list[Arrival]:
        """Advances to t [s], or to the next whole millisecond; returns the datagrams that reached the host, with times."""
        goal = ceil(t / MILLISECOND - 1e-6)
        while self._agenda and self._agenda[0][0] <= goal:
            when, _, step = heapq.heappop(self._agenda)
            self._move(when)
            step()
        self._move(goal)
        arrived, self._arrived = self._arrived, []
        return arrived

    def next_event(self) -> float:
        """Time of the next event, s."""
        return self._agenda[0][0] * MILLISECOND

    def pose(self) -> np.ndarray:
        """(3,): true x, y [m] and yaw [rad] of the reference point."""
        return self.body.truth()[:3]

    def frames(self, since: float) -> list[CameraFrame]:
        """Camera frames that are readable now and became so after `since` [s], oldest first."""
        return self.camera.frames(since, self.time)

    def _at(self, t: float, step: Step) -> None:
        """Schedules a step at t [s], not before now."""
        heapq.heappush(self._agenda, (max(round(t / MILLISECOND), self._now), next(self._order), step))

    def _move(self, when: int) -> None:
        if when > self._now:
            self.body.advance((when - self._now) * MILLISECOND)
            self._now = when

    def _boot(self) -> None:
        """Starts a new life of the microcontroller: numbers and clock from the beginning, IDLE."""
        self.restarts += 1
        self._told = None
        self.firmware = firmware = firmware_of(self.protocol, self.body.robot, self.time, self._policy)
        self.body.torque(False)
        self._at(self.time, partial(self._tick, firmware))

    def _die(self) -> None:
        """Ends a life of the microcontroller for lack of supply: it neither receives, sends nor holds."""
        self.firmware = None
        self.body.torque(False)

    def _tick(self, firmware: Firmware) -> None:
        """Reads the servos, sets their targets, sends telemetry; every 20 ms during this life."""
        if firmware is not self.firmware:
            return
        self._readings = self._read()
        if isinstance(firmware, LoopbackServos):
            firmware.readings = self._readings
        self._act(firmware)
        if telemetry := firmware.report(self.time, self._readings):
            self._say(telemetry)
        self._at(self.time + PERIOD, partial(self._tick, firmware))

    def _hear(self, data: bytes) -> None:
        if self.firmware is None:
            return
        if isinstance(self.firmware, LoopbackServos):
            self._readings = self.firmware.readings = self._read()
        moves, answers = self.firmware.hear(data, self.time, self._readings.measured)
        if moves:
            self._act(self.firmware, taken=True)
        for answer in answers:
            self._say(answer)

    def _act(self, firmware: Firmware, taken: bool = False) -> None:
        """Sends targets to the servos, only if they changed or a command was taken: repeats would hide a lost one."""
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
