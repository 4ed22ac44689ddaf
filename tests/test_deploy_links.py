"""Links and transports: old packets are dropped, damaged ones counted, and a servo bus is asked no longer than a tick allows."""

import socket
import time

import numpy as np
import pytest

from fishmj.base.errors import ConfigError
from fishmj.deploy.link.links import Fishmj1Link, MishLink
from fishmj.deploy.link.servo_bus_link import ANSWER, SHARE, ServoBusLink
from fishmj.deploy.link.transports import UdpTransport, open_serial
from fishmj.deploy.loop.clock import MonotonicClock
from fishmj.deploy.protocols import fishmj1, lx_bus, mish, servo_counts
from fishmj.deploy.protocols.lx_bus import Code
from fishmj.deploy.protocols.messages import RobotInfo, RobotState, ServoFault, Telemetry
from tests.deploying import FakeClock


class Wire:
    """A transport in memory."""

    def __init__(self):
        self.out, self.waiting = [], []

    def open(self): ...
    def close(self): ...

    def send(self, data):
        self.out.append(data)

    def receive(self):
        found, self.waiting = self.waiting, []
        return found


def told(seq, joint=(0.1, 0.2, 0.3), time=None):
    return Telemetry(tuple(joint), seq, seq * 0.02 if time is None else time, state=RobotState.ARMED)


def test_packets_come_out_with_their_arrival_and_old_ones_do_not():
    wire = Wire()
    link = Fishmj1Link(wire)
    order = [1, 2, 2, 4, 3, 5]
    wire.waiting = [(10 + k, fishmj1.encode_telemetry(told(seq))) for k, seq in enumerate(order)]
    found = link.receive(20.0)
    assert [(one.t, one.value.seq) for one in found] == [(10, 1), (11, 2), (13, 4), (15, 5)]
    assert link.counts == {"packets": 6, "bad": 0, "old": 2}


def test_damaged_datagrams_are_counted_and_change_nothing():
    wire, rng = Wire(), np.random.default_rng(0)
    link, good = Fishmj1Link(wire), fishmj1.encode_telemetry(told(7))
    for _ in range(300):
        bad = bytearray(good)
        bad[rng.integers(len(bad))] ^= 1 << int(rng.integers(8))
        wire.waiting.append((0.0, bytes(bad)))
    wire.waiting += [(0.0, b""), (0.0, b"x" * 3000), (1.0, good)]
    assert [one.value.seq for one in link.receive(1.0)] == [7]
    assert link.counts["bad"] == 302


def test_what_the_host_sends_is_numbered_and_reads_back():
    wire = Wire()
    link = Fishmj1Link(wire)
    link.hello(1.0)
    link.arm(2.0, 0.1, 0.3)
    sent = link.send(np.array([0.1, -0.2, 0.3]), 3.0)
    link.disarm(4.0)
    read = [fishmj1.decode(data) for data in wire.out]
    assert [one.kind.name for one in read] == ["HELLO", "ARM", "COMMAND", "DISARM"]
    assert [one.seq for one in read] == [1, 2, 3, 4] and sent.seq == 3 and sent.data == wire.out[2]
    assert read[1].value == (0.1, 0.3)
    np.testing.assert_allclose(read[2].value.joint, [0.1, -0.2, 0.3], rtol=1e-6)


def test_a_robot_says_what_it_is():
    wire = Wire()
    info = RobotInfo("fw-1", "ab" * 32, (1, 2, 3), ("j1", "j2", "j3"), 1.0, 0.1, 0.3)
    wire.waiting = [(5.0, fishmj1.encode_info(1, 0.0, info))]
    found = Fishmj1Link(wire).receive(5.0)[0].value
    assert found.joints == info.joints and found.neutral == 0.3


def test_robot_clock_uses_the_fastest_reply_and_ignores_ambiguous_ones():
    wire = Wire()
    info = RobotInfo("fw-1", "ab" * 32, (1, 2, 3), ("j1", "j2", "j3"), 1.0, 0.1, 0.3)
    link = Fishmj1Link(wire)

    def answered(heard, robot):
        wire.waiting = [(heard, fishmj1.encode_info(1, robot, info))]
        link.receive(heard)
        return link.robot_clock

    assert answered(1.0, 0.0) is None  # nobody asked
    link.hello(5.0)
    assert answered(5.010, 2.004) == pytest.approx((3.001, 0.010))
    link.hello(5.2)
    assert answered(5.230, 2.204) == pytest.approx((3.001, 0.010))  # a slower one
    link.hello(5.4)
    link.arm(5.5, 0.1, 0.3)  # one of the two was lost, nobody knows which
    assert answered(5.502, 2.501) == pytest.approx((3.001, 0.010))
    link.arm(5.6, 0.1, 0.3)
    assert answered(5.606, 2.603) == pytest.approx((3.0, 0.006))
    link.forget()
    assert link.robot_clock is None


def test_the_open_robots_layout_lacks_a_watchdog_and_says_so():
    wire = Wire()
    link = MishLink(wire, "fixed")
    wire.waiting = [(1.0, mish.encode_telemetry(Telemetry((0.1, 0.2, 0.3)), (1, 2, 3))), (2.0, b"short")]
    assert len(link.receive(2.0)) == 1 and link.counts["bad"] == 1
    assert not link.watched and "watchdog" in link.lacks and "joint angles" not in link.lacks
    assert "joint angles" in MishLink(wire, "mish-0.1.0").lacks
    link.send(np.array([0.5, 0.0, -0.5]), 3.0)
    np.testing.assert_allclose(mish.decode_command(wire.out[0]).joint, [0.5, 0.0, -0.5], rtol=1e-6)


def until(condition, seconds=600.0):
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.005)
    return condition()


def test_datagrams_go_over_a_socket_with_the_time_of_their_arrival():
    robot = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    robot.bind(("127.0.0.1", 0))
    robot.settimeout(600.0)
    transport = UdpTransport("127.0.0.1", robot.getsockname()[1], MonotonicClock())
    transport.open()
    try:
        transport.send(b"to the robot")
        data, host = robot.recvfrom(100)
        assert data == b"to the robot"
        before = time.monotonic()
        robot.sendto(b"to the host", host)
        found = []
        assert until(lambda: found.extend(transport.receive()) or found)
        assert found[0][1] == b"to the host" and before <= found[0][0] <= time.monotonic()
    finally:
        transport.close()
        transport.close()
        robot.close()


def test_a_port_that_is_taken_is_one_line():
    first = UdpTransport("127.0.0.1", 9, MonotonicClock())
    taken = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    taken.bind(("", 0))
    try:
        with pytest.raises(ConfigError, match="another program on that port"):
            UdpTransport("127.0.0.1", 9, MonotonicClock(), taken.getsockname()[1]).open()
    finally:
        taken.close()
        first.close()


def test_a_serial_line_that_is_not_there_is_one_line():
    with pytest.raises(ConfigError, match="devices here"):
        open_serial("/dev/no-such-line", 0.002, 115200)


class Servos:
    """A serial line with servos on it; every read costs 1 ms of the fake clock. `mute`: ids that do not answer, `drop`: answers
    that are lost before the next one comes through."""

    def __init__(self, clock, ids=(1, 2, 3)):
        self.clock, self.position = clock, dict.fromkeys(ids, 500)
        self.mute, self.drop, self.asked, self.closed = set(), 0, [], False
        self.loaded = dict.fromkeys(ids, 0)
        self._line = b""
        self.reader = lx_bus.LxFrameReader()

    @property
    def in_waiting(self):
        return len(self._line)

    def write(self, data):
        for frame in self.reader.frames(data):
            self._line += lx_bus.encode(frame.servo, frame.code, *frame.values)  # adapters hear themselves
            if frame.code is Code.MOVE_TIME_WRITE:
                self.position[frame.servo] = frame.values[0]
            if frame.code is Code.LOAD_OR_UNLOAD_WRITE:
                self.loaded[frame.servo] = frame.values[0]
            answer = {Code.POS_READ: self.position[frame.servo], Code.VIN_READ: 7400, Code.TEMP_READ: 31}.get(frame.code)
            if answer is None:
                continue
            self.asked.append((frame.servo, frame.code))
            if frame.servo in self.mute:
                continue
            if self.drop:
                self.drop -= 1
                continue
            self._line += lx_bus.encode_reply(frame.servo, frame.code, answer)

    def read(self, n):
        self.clock.t += 0.001
        found, self._line = self._line[:n], self._line[n:]
        return found

    def close(self):
        self.closed = True


def bus(**options):
    clock = FakeClock()
    port = Servos(clock)
    link = ServoBusLink(lambda: port, clock, (1, 2, 3), **options)
    link.open()
    return clock, port, link


def test_servo_bus_applies_joint_zeros_and_signs_to_commands_and_readings():
    clock, port, link = bus(zeros=(0.1, 0.0, 0.0), signs=(1, 1, -1))
    link.arm(clock.t, 0.1, 0.3)
    assert port.loaded == {1: 1, 2: 1, 3: 1}
    joint = np.array([0.3, -0.2, 0.5])
    link.send(joint, clock.t)
    assert port.position[3] == servo_counts.counts(-0.5)
    for _ in range(6):
        clock.t += 0.02
        packet = link.receive(clock.t)[0].value
    np.testing.assert_allclose(packet.joint, joint, atol=servo_counts.RAD_PER_COUNT / 2 + 1e-9)
    assert packet.servo_voltage == (7.4, 7.4, 7.4) and packet.temperature == (31.0, 31.0, 31.0)
    assert packet.fault == (ServoFault.NONE,) * 3
    link.disarm(clock.t)
    assert port.loaded == {1: 0, 2: 0, 3: 0}
    link.close()
    assert port.closed


def test_an_answer_that_is_lost_is_asked_for_again_within_the_tick():
    clock, port, link = bus()
    link.receive(clock.t)
    port.drop, port.asked = 2, []
    packet = link.receive(clock.t)[0].value
    assert packet.fault == (ServoFault.NONE,) * 3 and link.counts["asked_again"] == 2
    assert [one for one in port.asked if one[0] == 1].count((1, Code.POS_READ)) == 3


def test_silent_servo_is_reported_as_no_reply_within_the_tick_budget():
    clock, port, link = bus()
    link.receive(clock.t)
    for mute in ({3}, {1}, {2, 3}, {1, 2}):
        port.mute, begin = mute, clock.t
        packets = [link.receive(clock.t)[0].value for _ in range(1)]
        assert clock.t - begin <= SHARE * 0.02 + ANSWER
        lost = {k + 1 for k, fault in enumerate(packets[0].fault) if fault & ServoFault.NO_REPLY}
        assert lost and lost <= mute
        clock.t = begin + 0.02


def test_a_voltage_that_is_read_no_more_is_none_after_three_seconds():
    clock, port, link = bus()
    for _ in range(6):
        clock.t += 0.02
        link.receive(clock.t)
    write = port.write
    port.write = lambda data: None if data[4] in (Code.VIN_READ, Code.TEMP_READ) else write(data)
    for seconds, there in ((2.5, True), (1.0, False)):
        clock.t += seconds
        packet = link.receive(clock.t)[0].value
        assert (packet.servo_voltage is not None) is there and (packet.temperature is not None) is there


def test_a_bus_without_servos_says_nothing():
    clock, port, link = bus()
    port.mute = {1, 2, 3}
    assert link.receive(clock.t) == []


def test_ids_that_stand_twice_are_refused():
    with pytest.raises(ConfigError, match="two servos of one number answer at the same time"):
        ServoBusLink(lambda: None, FakeClock(), (1, 1, 2))
