"""The loopback robot from the host's side: what comes back for the datagrams that are sent, healthy and failing."""

from dataclasses import replace

import numpy as np
import pytest

from fishmj.base.errors import ConfigError, UnknownName
from fishmj.deploy.loopback import bodies
from fishmj.deploy.loopback.faults import parse
from fishmj.deploy.loopback.firmware import FishmjFirmware, in_counts
from fishmj.deploy.loopback.readings import Readings
from fishmj.deploy.loopback.robot import LoopbackRobot
from fishmj.deploy.protocols import fishmj1, mish
from fishmj.deploy.protocols.messages import RobotInfo, RobotState, ServoFault, Telemetry
from fishmj.deploy.protocols.servo_counts import RAD_PER_COUNT
from fishmj.mjcf.reading import load_robot

TICK, CLOCK = 0.02, 1000.0  # s, s by which the host's clock is ahead


class Host:
    """The smallest host: numbers what it sends, keeps what it hears."""

    def __init__(self, *faults, protocol="fishmj-1", seed=0, noise=0.0, delay=0.005, **body):
        made = bodies.make(noise=noise, radio=delay, **body)
        self.robot = LoopbackRobot(made, protocol, parse(faults), seed, delay=delay, spread=0.0)
        self.seq, self.heard, self.raw = 0, [], []

    def send(self, encode, *values):
        self.seq += 1
        self.robot.receive(encode(self.seq, CLOCK + self.robot.time, *values))

    def wait(self, seconds=TICK):
        self.raw += (arrived := self.robot.advance_to(self.robot.time + seconds))
        self.heard += [(arrival.t, fishmj1.decode(arrival.data)) for arrival in arrived]

    def arm(self, hold=0.1, neutral=0.3):
        self.send(fishmj1.encode_arm, hold, neutral)
        self.wait()
        return self

    def swim(self, seconds, command=lambda t: (0.0, 0.0, 0.0)):
        """A command a tick."""
        for _ in range(round(seconds / TICK)):
            self.send(fishmj1.encode_command, tuple(float(angle) for angle in command(self.robot.time)))
            self.wait()
        return self

    @property
    def telemetry(self) -> list[tuple[float, Telemetry]]:
        return [(t, message.value) for t, message in self.heard if isinstance(message.value, Telemetry)]

    def states(self):
        """State -> s since the start when it was first heard."""
        first = {}
        for t, packet in self.telemetry:
            first.setdefault(packet.state, t)
        return first


def wave(t):
    return 0.4 * np.sin(2 * np.pi * t - 0.7 * np.arange(3))


def gentle(t):
    """A wave that grows, so that the firmware's rate limit has nothing to do."""
    return min(t / 0.5, 1.0) * wave(t)


def test_it_says_what_it_is_and_takes_commands_only_when_armed():
    host = Host()
    host.send(fishmj1.encode_hello)
    host.swim(0.5, wave)
    info = next(message.value for _, message in host.heard if isinstance(message.value, RobotInfo))
    assert info.joints == ("j1", "j2", "j3") and info.servo_ids == (1, 2, 3) and 0 < info.hold < info.neutral
    assert len(info.firmware_sha256) == 64
    assert {packet.state for _, packet in host.telemetry} == {RobotState.IDLE}
    assert np.abs(host.robot.body.truth()[3:]).max() < 0.02
    host.arm(0.2, 0.4).swim(0.5, wave)
    assert host.telemetry[-1][1].state is RobotState.ARMED and np.abs(host.robot.body.truth()[3:]).max() > 0.2
    info = [message.value for _, message in host.heard if isinstance(message.value, RobotInfo)][-1]
    assert (info.hold, info.neutral) == (0.2, 0.4)


def test_telemetry_comes_every_20_ms_numbered_stamped_and_with_the_echo():
    host = Host().arm().swim(1.0, wave)
    times, packets = zip(*host.telemetry[5:], strict=True)
    np.testing.assert_allclose(np.diff([packet.time for packet in packets]), TICK, atol=1e-9)
    np.testing.assert_allclose(np.array(times) - [packet.time for packet in packets], 0.005, atol=1e-9)
    assert np.all(np.diff([packet.seq for packet in packets]) == 1)
    last = packets[-1]
    assert last.echo == host.seq - 1 and last.echo_time == pytest.approx(CLOCK + last.time - TICK, abs=1e-6)
    assert 6.5 < last.voltage < 8.5 and 0.1 < last.current < 3.0
    assert last.temperature == (20.0, 20.0, 20.0) and last.fault == (ServoFault.NONE,) * 3


@pytest.mark.parametrize("body", ["virtual", "structured"])
def test_nothing_switched_on_is_the_body_itself_to_the_servos_counts(body):
    """The radio's delay and the body's rest of it: the same joints as a body that gets the commands directly."""
    host = Host(name=body, delay=0.006).arm(0.2, 0.4).swim(2.0, gentle)
    twin, seen = bodies.make(body, noise=0.0, radio=0.006), []
    twin.torque(False)
    for k in range(len(host.telemetry)):
        seen.append(twin.sensors().joint)
        twin.advance(0.006)
        if k == 0:
            twin.torque(True)
            twin.send((0.0, 0.0, 0.0))
        else:
            twin.send([in_counts(float(angle)) for angle in gentle(TICK * k)])
        twin.advance(0.014)
    told = np.array([packet.joint for _, packet in host.telemetry])
    assert np.abs(told).max() > 0.3
    assert np.abs(told - seen).max() <= 0.51 * RAD_PER_COUNT


def test_two_step_command_does_not_split_later_commands():
    """The rate limit counts from the newest step; a step between two commands would leave the next one 6 ms to move in."""
    host, told = Host(delay=0.006).arm(0.2, 0.4), []
    send = host.robot.body.send
    host.robot.body.send = lambda angles: (told.append((host.robot.time, tuple(angles))), send(angles))
    host.swim(0.1)
    begin = host.robot.time
    fast = lambda t: (0.15 + 3.0 * (t - begin), 0.0, 0.0)  # begins with more than 5.2 rad/s x 20 ms
    host.swim(0.2, fast)
    goals = [in_counts(fast(begin + TICK * k)[0]) for k in range(9)]
    for k, goal in list(enumerate(goals))[4:]:
        (arrived,) = [t for t, angles in told if angles[0] == goal]
        assert arrived == pytest.approx(begin + TICK * k + 0.006, abs=1e-9)


def test_watchdog_holds_then_goes_neutral_on_time_and_only_disarm_exits():
    host = Host().arm(0.2, 0.5).swim(0.6, lambda t: (0.3, 0.3, 0.3))
    silent = host.robot.time - TICK + 0.005  # the last command arrived
    host.wait(3.0)
    states = host.states()
    assert states[RobotState.HOLD] - silent == pytest.approx(0.2, abs=TICK + 0.006)
    assert states[RobotState.NEUTRAL] - silent == pytest.approx(0.5, abs=TICK + 0.006)
    held = [packet.joint for t, packet in host.telemetry if states[RobotState.HOLD] + 0.1 < t < states[RobotState.NEUTRAL]]
    assert np.abs(np.array(held) - 0.3).max() < 0.03
    assert np.abs(host.telemetry[-1][1].joint).max() < 0.02
    host.swim(0.5, wave)
    assert host.telemetry[-1][1].state is RobotState.NEUTRAL
    host.send(fishmj1.encode_disarm)
    host.wait()
    host.wait()
    assert host.telemetry[-1][1].state is RobotState.IDLE
    host.arm().swim(0.5, wave)
    assert host.telemetry[-1][1].state is RobotState.ARMED


def test_a_host_that_dies_leaves_a_fish_that_is_straight_and_has_no_torque():
    host = Host().arm(0.2, 0.5).swim(0.6, lambda t: (0.5, 0.5, 0.5))
    host.wait(3.0)
    last = host.telemetry[-1][1]
    assert last.state is RobotState.NEUTRAL and host.robot.firmware.target is None
    assert np.abs(last.joint).max() < np.radians(3.0) and last.fault == (ServoFault.NONE,) * 3
    idle = next(packet.current for _, packet in host.telemetry if packet.state is RobotState.IDLE)
    assert last.current == pytest.approx(idle, abs=0.01)


def test_a_stuck_servo_has_torque_for_no_more_than_5_s_of_neutral():
    host = Host("stuck_servo=2@0.5").arm(0.2, 0.5).swim(1.0, lambda t: (0.5, 0.5, 0.5))
    host.wait(7.0)
    begun, rows = host.states()[RobotState.NEUTRAL], [(t, packet) for t, packet in host.telemetry]
    stuck = [t for t, packet in rows if packet.fault[1] & ServoFault.STUCK]
    assert max(stuck) - begun == pytest.approx(5.0, abs=0.05) and rows[-1][0] > max(stuck) + 1.0
    assert rows[-1][1].state is RobotState.NEUTRAL and rows[-1][1].current < max(packet.current for _, packet in rows) - 0.3


def test_old_and_repeated_commands_are_not_taken():
    host = Host().arm().swim(0.2, lambda t: (0.2, 0.2, 0.2))
    for _ in range(10):
        host.robot.receive(fishmj1.encode_command(host.seq - 3, CLOCK + host.robot.time - 0.06, (0.9, 0.9, 0.9)))
        host.swim(TICK, lambda t: (0.2, 0.2, 0.2))
    assert np.abs(np.array(host.telemetry[-1][1].joint) - 0.2).max() < 0.02


def test_a_silent_radio_ends_in_neutral_without_the_host():
    host = Host("silent_radio@1-2").arm().swim(2.5, wave)
    times = np.array([t for t, _ in host.telemetry])
    assert not np.any((times > 1.01) & (times < 2.0)) and host.telemetry[-1][1].state is RobotState.NEUTRAL


def test_corrupt_datagrams_are_refused_and_do_no_harm():
    host = Host("corrupt:down=0.5").arm(0.3, 0.6)
    while host.telemetry[-1][1].state is not RobotState.ARMED:
        host.arm(0.3, 0.6)
    host.swim(2.0, wave)
    assert host.robot.firmware.bad > 20 and host.telemetry[-1][1].state is RobotState.ARMED
    assert np.abs(np.array([packet.joint for _, packet in host.telemetry])).max() < 0.5


def test_a_brown_out_sags_restarts_and_forgets():
    host = Host("brown_out=0.3@1").arm().swim(2.0, wave)
    before = [packet for t, packet in host.telemetry if t < 1.06]
    after = [packet for t, packet in host.telemetry if t > 1.06]
    assert min(packet.voltage for packet in before) < 5.5 < min(packet.voltage for packet in before[:-3])
    assert (after[0].seq, after[0].time, after[0].state, after[0].echo) == (1, 0.0, RobotState.IDLE, None)
    assert host.telemetry[len(before)][0] == pytest.approx(1.4 + 0.005, abs=1e-6)  # 0.1 s of sag, 0.3 s to boot
    assert {packet.state for packet in after} == {RobotState.IDLE} and host.robot.restarts == 1
    host.arm().swim(0.2, wave)
    assert host.telemetry[-1][1].state is RobotState.ARMED


def test_a_stuck_servo_stays_draws_current_and_is_told():
    healthy, stuck = (Host(*faults).arm().swim(2.0, lambda t: (0.5, 0.5, 0.5)) for faults in ((), ("stuck_servo=2@0.1",)))
    last, well = stuck.telemetry[-1][1], healthy.telemetry[-1][1]
    assert abs(last.joint[1]) < 0.3 and last.joint[0] == pytest.approx(0.5, abs=0.02)
    assert last.fault == (ServoFault.NONE, ServoFault.STUCK, ServoFault.NONE) and well.fault == (ServoFault.NONE,) * 3
    assert last.current > well.current + 0.3


def test_a_silent_servo_is_told_and_its_last_angle_stays():
    host = Host("silent_servo=1@1-2").arm().swim(3.0, wave)
    gone = [packet for t, packet in host.telemetry if 1.006 < t < 2.0]
    assert {packet.fault for packet in gone} == {(ServoFault.NO_REPLY, ServoFault.NONE, ServoFault.NONE)}
    assert len({packet.joint[0] for packet in gone}) == 1 and len({packet.joint[1] for packet in gone}) > 20
    assert host.telemetry[-1][1].fault == (ServoFault.NONE,) * 3 and host.telemetry[-1][1].state is RobotState.ARMED


def test_a_robot_with_a_silent_servo_does_not_arm():
    host = Host("silent_servo=3").arm()
    host.wait()
    assert host.telemetry[-1][1].state is RobotState.IDLE


def test_a_hot_servo_heats_up_and_is_told_before_it_would_let_go():
    host = Host("hot_servo=3@0-7").arm().swim(7.0)
    rows = [packet.temperature for _, packet in host.telemetry]
    assert rows[-1][:2] == (20.0, 20.0) and 75 <= rows[-1][2] <= 80
    assert host.telemetry[-1][1].fault[2] & ServoFault.HOT and not host.telemetry[100][1].fault[2]
    assert np.diff([row[2] for row in rows]).max() <= 1.0


def test_a_stalled_servo_warms_slowly():
    host = Host("stuck_servo=1@0.1", "stuck_servo=2@0.1", "stuck_servo=3@0.1").arm().swim(20.0, lambda t: (1.0, 1.0, 1.0))
    assert 20.0 < max(host.robot._faults._heat) < 23.0


def test_a_low_battery_is_read():
    host = Host("low_battery=6.1@1-2").arm().swim(3.0, wave)
    volts = {t: packet.voltage for t, packet in host.telemetry}
    assert all(value < 6.2 for t, value in volts.items() if 1.1 < t < 2.0)
    assert all(value > 7.0 for t, value in volts.items() if t < 1.0 or t > 2.1)


@pytest.mark.parametrize("volts", [5.0, 7.4, 24.0])
def test_a_low_battery_is_that_of_the_robot(volts):
    shipped = load_robot("fish")
    robot = load_robot(replace(shipped, servo=replace(shipped.servo, voltage=volts)))
    body = bodies.make("structured", robot=robot)
    made = LoopbackRobot(body, faults=parse(["low_battery@0.5"]))
    made.advance_to(0.4)
    assert body.sensors().voltage > robot.low_voltage
    made.advance_to(1.0)
    assert 0.9 * robot.low_voltage < body.sensors().voltage < robot.low_voltage
    with pytest.raises(ConfigError, match=rf"{robot.low_voltage:g} V is no low battery of {robot.name}; expected less"):
        LoopbackRobot(body, faults=parse([f"low_battery={robot.low_voltage:g}"]))


def test_a_battery_that_is_low_for_a_second_is_told_and_the_host_decides():
    host = Host("low_battery=6.1@1-3").arm().swim(3.5, wave)
    low = [t for t, packet in host.telemetry if packet.fault[0] & ServoFault.VOLTAGE]
    assert 1.9 < min(low) < 2.2 and max(low) < 3.2
    assert host.telemetry[-1][1].state is RobotState.ARMED


def readings(*joint: float, volts: float = 7.4, amperes: float = 0.5) -> Readings:
    return Readings(joint, volts, amperes, (7.4,) * 3, (20.0,) * 3, (ServoFault.NONE,) * 3)


def test_implausible_servo_angle_is_no_reply_and_telemetry_goes_on():
    firmware = FishmjFirmware(load_robot("fish"), 0.0)
    firmware.report(0.0, readings(0.1, 0.2, 0.3))
    told = fishmj1.decode(firmware.report(0.02, readings(0.1, 40.0, 0.3, volts=50.0, amperes=150.0))).value
    assert told.joint == pytest.approx((0.1, 0.2, 0.3))
    assert told.fault == (ServoFault.NONE, ServoFault.NO_REPLY, ServoFault.NONE)
    assert (told.voltage, told.current) == (41.0, 100.0)


@pytest.mark.parametrize(("angle", "state"), [(1.0, RobotState.ARMED), (1.2, RobotState.IDLE)])
def test_a_joint_beyond_its_range_is_not_armed(angle, state):
    firmware = FishmjFirmware(load_robot("fish"), 0.0)
    firmware.hear(fishmj1.encode_arm(1, 0.0, 0.1, 0.3), 0.01, (0.0, angle, 0.0))
    assert firmware.watchdog.state is state and (firmware.act(0.02, (0.0, angle, 0.0)) is None) == (state is RobotState.IDLE)


def test_same_seed_same_bytes_and_another_seed_others():
    texts = ("loss=0.1", "jitter=0.01", "duplicate=0.05", "brown_out@1")

    def bytes_of(seed):
        host = Host(*texts, seed=seed, noise=1.0).arm().swim(2.0, wave)
        return host.raw, [frame.t for frame in host.robot.frames(-1.0)]

    assert bytes_of(5) == bytes_of(5)
    assert bytes_of(5) != bytes_of(6)


def test_a_robot_that_is_asked_in_small_steps_says_the_same():
    one, two = (Host("jitter=0.01", noise=1.0) for _ in range(2))
    for host, step in ((one, 0.1), (two, 0.001)):
        for _ in range(round(0.5 / step)):
            host.wait(step)
    assert one.raw == two.raw


@pytest.mark.parametrize(("protocol", "share"), [("mish-0.1.0", 0.96), ("mish-fixed", 1.0)])
def test_the_open_robot_acts_at_once_without_arming_and_nothing_watches(protocol, share):
    body = bodies.make(noise=0.0, radio=0.005)
    robot = LoopbackRobot(body, protocol, delay=0.005, spread=0.0)
    assert len(robot.advance(0.1)) == 5 and np.abs(body.truth()[3:]).max() < 0.02
    robot.receive(mish.encode_command((0.5, 0.25, -0.5), (0.0, 0.0, 0.0)))
    told = [mish.decode_telemetry(data) for data in robot.advance(5.0)]
    np.testing.assert_allclose(body.truth()[3:], np.array([0.5, 0.25, -0.5]) * share, atol=0.01)
    shown = np.array(told[-1].joint)
    assert (shown == 0.0).all() if protocol == "mish-0.1.0" else np.allclose(shown, (0.5, 0.25, -0.5), atol=0.01)
    assert told[-1].servo_voltage[0] > 7.0 and told[-1].voltage is None and robot.firmware.bad == 0
    robot.receive(fishmj1.encode_disarm(1, 0.0))
    robot.advance(0.5)
    assert robot.firmware.bad == 1 and body.truth()[3] > 0.4


def test_the_open_robot_moves_a_servo_that_does_not_answer():
    body = bodies.make(noise=0.0, radio=0.005)
    robot = LoopbackRobot(body, "mish-fixed", parse(["silent_servo=1"]), delay=0.005, spread=0.0)
    robot.receive(mish.encode_command((0.5, 0.5, 0.5), (0.0, 0.0, 0.0)))
    told = mish.decode_telemetry(robot.advance(1.0)[-1])
    assert told.joint[0] == 0.0 and told.joint[1] > 0.4 and body.truth()[3] > 0.4


def test_the_open_robot_moves_at_the_speed_asked_for():
    body = bodies.make(noise=0.0, radio=0.005)
    robot = LoopbackRobot(body, "mish-fixed", delay=0.005, spread=0.0)
    robot.advance(0.1)
    robot.receive(mish.encode_command((1.0, 0.0, 0.0), (0.5, 0.0, 0.0)))
    robot.advance(1.06)
    assert body.truth()[3] == pytest.approx(0.5, abs=0.06)


def test_impossible_robots_are_refused():
    with pytest.raises(UnknownName, match="mish-fixed"):
        LoopbackRobot(bodies.make(), "mish")
    with pytest.raises(ConfigError, match="3 joints"):
        LoopbackRobot(bodies.make(), faults=parse(["hot_servo=5"]))
