"""The second robot as a body: the physics and planted effects of `virtual_robot.ClosedLoopRobot`, computed on demand.

`ClosedLoopRobot` makes every table at every step, which costs seventeen times the motion itself. Here only time is counted first;
the motion is simulated when a sensor, a camera or a switch needs it. A test holds both equal.
"""

import heapq
from collections.abc import Sequence
from itertools import count

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.deploy.loopback.loopback_body import MILLISECOND, BodyReadings, Effects, bus_delay, whole_milliseconds
from fishmj.gap.laboratory import random_streams
from fishmj.gap.laboratory.virtual_robot import network
from fishmj.gap.laboratory.virtual_robot import sensors as cameras
from fishmj.gap.laboratory.virtual_robot.network import CommandRadio
from fishmj.gap.laboratory.virtual_robot.robot_constants import FIRMWARE_WAIT, RobotConstants
from fishmj.gap.laboratory.virtual_robot.simulate import STILL, StateRecording, at_rest, columns, run
from fishmj.gap.laboratory.virtual_robot.trials import plant, weather
from fishmj.mjcf.description import Robot
from fishmj.water.flow import Flow

HORIZON = 600.0  # s of weather drawn at the start where there is any; twice as much whenever it ends
ASK_THE_STREAM = ("none", "gust")  # turbulence that is uniform in space, which is all that the second robot has
PLANTED = ("delay", "offset", "scale", "angle", "heading", "marker", "k1")  # effects of the camera that are null at 0
GUST_TIME = 1.5  # s, memory of its gusts, as of the flow preset `gust`


class VirtualBody:
    """See `body.Body`; arguments as `bodies.make`."""

    def __init__(
        self, robot: Robot, effects: dict, seed: int, noise: float, nuisance: float, start: tuple[float, float, float],
        flow: Flow, radio: float,
    ):  # fmt: skip
        self.robot, self.noise, self.radio = robot, noise, radio
        made = self._take(
            plant(_with_gusts(effects, flow), seed, nuisance=nuisance, robot=robot, flow=(flow.speed, flow.direction))
        )
        self._state = at_rest(start, made.zero, made.motor.voltage)
        for told in (self._state.goal, self._state.aim, self._state.seen, self._state.ramp):
            told[:] = 0.0
        self._anchor = self._state.z[:3].copy()
        self._changing = made.tank.sigma > 0.0 or made.odd.pulse != 0.0
        self._seed, self._horizon = seed, HORIZON
        self._gust = weather(made, HORIZON, seed, 0) if self._changing else STILL
        self._radio = CommandRadio(made.network, made.odd, seed, 0, noise)
        self._joint, self._meter = (random_streams.stream(seed, name, 0) for name in ("joint", "power"))
        self._queue: list[tuple[float, int, np.ndarray]] = []
        self._order = count()
        self._now = self._made = 0  # ms: asked for, simulated
        self._past = self._before_the_first()
        self._on = True
        self._volts: float | None = None
        self._jams: dict[int, float] = {}
        self._acting = made

    def change(self, made: RobotConstants) -> None:
        """Replaces the robot's constants (`virtual_robot.plant`) in mid-swim; its drawn weather stays."""
        self._catch_up()
        made = self._take(made)
        self._radio.network, self._radio.odd = made.network, made.odd
        self._rewire()

    def _take(self, made: RobotConstants) -> RobotConstants:
        """The robot's constants, with the remaining command latency; the camera's own latency is the loopback's."""
        left = max(bus_delay(self.robot, self.radio) - FIRMWARE_WAIT * made.motor.period, 0.0)
        self.plant = made = made.with_fields({"network.latency": left, "network.jitter": 0.0})
        self._camera = made.camera._replace(latency=0.0)
        sizes = [getattr(made.camera, name) for name in PLANTED]
        self._honest = not any(sizes) and made.camera.drift == 1.0 and made.odd.parallax == 0.0
        late = made.network.joint_delay + made.camera.delay + made.meter.average
        self._memory = round(late / MILLISECOND) + 2  # ms of motion that are looked back on
        return made

    @property
    def time(self) -> float:
        """Time since the body began, s."""
        return self._now * MILLISECOND

    def send(self, command: Sequence[float] | np.ndarray) -> None:
        """Puts joint angles (J,) [rad] on the servo bus now; they may be lost or arrive late."""
        angles = np.asarray(command, float)
        arrival = self._radio.arrival(self.time, angles)
        if arrival is not None:
            heapq.heappush(self._queue, (arrival, next(self._order), angles))

    def advance(self, seconds: float) -> None:
        """Advances by whole milliseconds; seconds: s."""
        self._now += whole_milliseconds(seconds)

    def sensors(self) -> BodyReadings:
        """Present readings, with the sensors' noise and planted errors."""
        self._catch_up()
        here, made, meter = np.array([self.time]), self.plant, self.plant.meter
        table = network.telemetry(made.network, made.zero, self._past, here, self._joint, self.noise)
        joint = np.array([float(column[0]) for name, column in table.items() if name != "t"])
        column = columns(len(joint))
        rows = self._past.data[-max(round(meter.average / MILLISECOND), 1) :]
        volts, amps = rows[:, column["V"]].mean(), rows[:, column["I"]].mean()
        amps += meter.offset / max(volts, 1.0)
        error = self.noise * self._meter.standard_normal(2)
        return BodyReadings(joint, float(volts + meter.voltage_noise * error[0]), float(amps + meter.current_noise * error[1]))

    def truth(self) -> np.ndarray:
        """(3 + J,): x, y [m], yaw [rad] of the reference point, hinge angles [rad]."""
        self._catch_up()
        z = self._state.z
        return np.array([z[0], z[1], z[2], *np.diff(z[2:])])

    def seen(self) -> tuple[float, np.ndarray]:
        """Stamp [s] and pose as the camera records them without noise, with its planted errors."""
        truth, camera = self.truth(), self._camera
        if self._honest:
            return self.time, truth
        frame = cameras.watch(camera, self.plant.odd, self._past, np.array([self.time]), np.random.default_rng(0), 0.0)
        stamped = cameras.on_its_clock(camera, frame)
        pose = [float(stamped[name][0]) for name in ("x", "y", "yaw")]
        return float(stamped["t"][0]), np.array([*pose, *truth[3:]])

    def torque(self, on: bool) -> None:
        """Switches the servos' torque."""
        if on != self._on:
            self._catch_up()
            self._on = on
            self._rewire()

    def supply(self, volts: float | None) -> None:
        """Feeds the servos from this open-circuit voltage [V]; None: from the battery."""
        if volts != self._volts:
            self._catch_up()
            self._volts = volts
            self._rewire()

    def jam(self, joint: int, stuck: bool) -> None:
        """Jams the gears of a joint (0 at the head) in place, or frees them."""
        if stuck == (joint in self._jams):
            return
        angle = float(self.truth()[3 + joint] - self.plant.zero[joint])
        if stuck:
            self._jams[joint] = angle
            self._state.goal[joint] = angle
        else:
            del self._jams[joint]

    def _rewire(self) -> None:
        """Applies the switches to the plant: gains of zero leave a motor with shorted leads, like an unpowered bridge."""
        fields = {} if self._on else {"motor.gain": 0.0, "motor.rate_gain": 0.0}
        if self._volts is not None:
            fields["motor.voltage"] = self._volts
        self._acting = self.plant.with_fields(fields) if fields else self.plant

    def _before_the_first(self) -> StateRecording:
        """Recording of the fish at rest, a millisecond before it begins."""
        column, row = columns(self.robot.n_joints), np.zeros(len(columns(self.robot.n_joints)))
        row[:3], row[[column[f"j{j + 1}"] for j in range(self.robot.n_joints)]] = self._state.z[:3], np.diff(self._state.z[2:])
        row[[column["V"], column["I"]]] = self.plant.motor.voltage, self.plant.motor.idle / self.plant.motor.nominal_voltage
        return StateRecording(np.array([-MILLISECOND]), row[None])

    def _catch_up(self) -> None:
        """Simulates up to the present time."""
        seconds = (self._now - self._made) * MILLISECOND
        if self._now == self._made:
            return
        due: list[tuple[float, np.ndarray]] = []
        while self._queue and self._queue[0][0] <= self.time - MILLISECOND + 1e-9:  # the last step begins then
            arrival, _, angles = heapq.heappop(self._queue)
            due.append((arrival, angles))
        commands = np.array([angles for _, angles in due]).reshape(-1, self.robot.n_joints)
        for joint, angle in self._jams.items():
            commands[:, joint] = angle
        while self._changing and self.time > self._horizon:  # the longer draw begins with the shorter one, number by number
            self._horizon *= 2.0
            self._gust = weather(self.plant, self._horizon, self._seed, 0)
        self._state.clock[0] = self._made * MILLISECOND  # a sum of milliseconds drifts over hours
        fresh = run(self._acting, self._state, [t for t, _ in due], commands, seconds, self._gust, self._anchor)
        self._made = self._now
        past = self._past
        keep = max(len(past.t) - self._memory, 0)
        self._past = StateRecording(np.concatenate([past.t[keep:], fresh.t]), np.concatenate([past.data[keep:], fresh.data]))


def _with_gusts(effects: Effects, flow: Flow) -> Effects:
    """The effects and, as one more, the turbulence of the flow.

    Raises ConfigError: turbulence that is not uniform in space, or stated twice.
    """
    if flow.rms == 0.0:
        return effects
    if flow.turbulence not in ASK_THE_STREAM:
        raise ConfigError(
            f"loopback body 'virtual': turbulence {flow.turbulence!r} varies in space, its water does not; take 'gust' or 'none',"
            " or the body fitted"
        )
    if "turbulence" in effects:
        raise ConfigError("loopback body 'virtual': turbulence as an effect and in the flow; say it once")
    return {**effects, "turbulence": {"sigma": flow.rms, "time": GUST_TIME}}
