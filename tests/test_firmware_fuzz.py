"""Damaged frames in C, under the address and undefined-behaviour sanitizers; and the whole robot against the host's pieces."""

import ctypes
import math
import random
import re
import subprocess

import pytest
from firmware_library import FIRMWARE, SOURCES, CRobot, Info, c_info, c_telemetry, compiled, firmware, floats, needs_compiler
from protocol_values import damaged

from fishmj.deploy.protocols import fishmj1
from fishmj.deploy.protocols.firmware_guard import Guard
from fishmj.deploy.protocols.fishmj1 import Kind
from fishmj.deploy.protocols.messages import RobotInfo, RobotState, ServoFault, Telemetry
from fishmj.deploy.protocols.protocol_error import ProtocolError
from fishmj.deploy.protocols.sequence import SequenceGate
from fishmj.deploy.protocols.watchdog import Watchdog

__all__ = ["firmware"]  # a fixture
pytestmark = needs_compiler
SANITIZED = ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
INFO = RobotInfo("reference-0.1.0", "ab" * 32, (1, 2, 3), ("j1", "j2", "j3"), math.radians(60.0), 0.1, 0.3)


@pytest.fixture(scope="session")
def fuzzer(tmp_path_factory):
    """The fuzzer, with sanitizers where the compiler has them."""
    folder = tmp_path_factory.mktemp("fuzz")
    (folder / "probe.c").write_text("int main(void) { return 0; }\n")
    try:
        compiled(folder / "probe", [folder / "probe.c"], *SANITIZED)
        subprocess.run([folder / "probe"], check=True, capture_output=True)
    except (pytest.fail.Exception, subprocess.CalledProcessError):
        pytest.skip("this C compiler has no address and undefined-behaviour sanitizers")
    return compiled(folder / "fuzz", [FIRMWARE / "host" / "fuzz.c", *SOURCES], *SANITIZED)


def tally(fuzzer, count: int, seed: int) -> dict[str, list[int]]:
    """What the fuzzer counted, by protocol."""
    done = subprocess.run([fuzzer, str(count), str(seed)], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr[-2000:]
    return {line.split(":")[0]: [int(n) for n in re.findall(r"\d+", line.split(":")[1])] for line in done.stdout.splitlines()}


def test_5000_damaged_frames_cause_no_wrong_accept_and_no_memory_error(fuzzer):
    found = tally(fuzzer, 5_000, 1)
    assert set(found) == {"fishmj-1", "LX", "robot"}
    assert all(row[0] == 5_000 and row[1] > 100 and row[-1] == 0 for row in found.values()), found


@pytest.mark.slow
def test_100000_damaged_frames_cause_no_wrong_accept_and_no_memory_error(fuzzer):
    found = tally(fuzzer, 100_000, 2)
    assert all(row[0] == 100_000 and row[1] > 2_000 and row[-1] == 0 for row in found.values()), found


class HostPieces:
    """The robot put together from the host's gate, watchdog and datagrams."""

    def __init__(self):
        self.watchdog, self.gate, self.sent, self.echo = Watchdog(3), SequenceGate(), 0, (None, None)
        self.guard, self.target = Guard(3), None

    def hear(self, data: bytes, now: float, measured) -> bytes:
        try:
            message = fishmj1.decode(data)
        except ProtocolError:
            return b""
        if message.kind in (Kind.TELEMETRY, Kind.INFO) or not self.gate.accept(message.seq, message.time):
            return b""
        if message.kind is Kind.COMMAND:
            if self.watchdog.command(now, *message.value):
                self.echo = message.seq, message.time
            return b""
        if message.kind is Kind.DISARM:
            self.watchdog.disarm()
            return b""
        if message.kind is Kind.ARM:
            self.watchdog.arm(now, *message.value, measured)
        self.sent += 1
        return fishmj1.encode_info(self.sent, now, INFO._replace(hold=self.watchdog.hold, neutral=self.watchdog.neutral))

    def act(self, now: float, measured):
        self.target = self.watchdog.step(now, measured)
        return self.target

    def report(self, now: float, measured, degrees, volts, amperes, last) -> Telemetry:
        self.sent += 1
        angles = tuple(angle if abs(angle) <= fishmj1.MOST_ANGLE else math.nan for angle in measured)
        told = Telemetry(
            joint=tuple(measured), seq=self.sent, time=now, echo=self.echo[0], echo_time=self.echo[1], state=self.watchdog.state,
            voltage=volts, current=amperes, temperature=degrees, fault=self.guard.check(now, self.target, angles, degrees, volts),
        )  # fmt: skip
        return fishmj1.clamped_to_wire_range(told, last)


def host_says(rng: random.Random, seq: int, now: float) -> bytes:
    if (sort := rng.randrange(12)) < 2:
        return fishmj1.encode_hello(seq, now)
    if sort == 2:
        return fishmj1.encode_disarm(seq, now)
    if sort < 5:
        return fishmj1.encode_arm(seq, now, 0.1, rng.choice([0.3, 2.0, 3.0]))
    return fishmj1.encode_command(seq, now, tuple(rng.uniform(-1.5, 1.5) for _ in range(3)), rng.choice([None, (1.0, 2.0, 3.0)]))


@pytest.mark.parametrize("seed", range(4))
def test_the_robot_in_c_is_the_hosts_pieces_put_together(firmware, seed):
    rng, held, host = random.Random(seed), CRobot(), HostPieces()
    robot = ctypes.byref(held)
    info = c_info(INFO)
    assert firmware.fj_robot_init(robot, ctypes.byref(info), firmware.fj_default_limits())
    ticks, last, states, faults, rests = 0, [0.0] * 3, set(), set(), 0
    former = host_says(rng, 0, 0.0)
    for number in range(1, 800):
        ticks += rng.choice([5_000, 20_000, 20_000, 150_000, 400_000])
        now, seq = ticks / 1e6, number if rng.random() < 0.9 else max(0, number - rng.randrange(5))
        if number % 25 == 1:  # joints stay for a while, as stuck ones do; straight ones let NEUTRAL end
            place = [rng.choice([-0.5, 0.0, 0.25, 0.5]) if rng.random() < 0.5 else 0.0 for _ in range(3)]
        measured = [rng.choice([math.nan, math.inf, 4.0, -400.0]) if rng.random() < 0.02 else angle for angle in place]
        low = number // 40 % 2
        volts, amperes = 6.0 if low else 7.4, rng.choice([0.5, 0.5, 120.0, -200.0])
        degrees = tuple(float(rng.choice([20, 74, 75, 90])) for _ in range(3))
        data = host_says(rng, seq, now)
        data = former if rng.random() < 0.1 else damaged(rng, [data]) if rng.random() < 0.1 else data
        former = data
        answer, read = (ctypes.c_uint8 * fishmj1.MOST_BYTES)(), floats(measured)
        size = firmware.fj_robot_hear(robot, data, len(data), ticks, read, answer, len(answer))
        assert bytes(answer[:size]) == host.hear(data, now, measured)
        moves, target = firmware.fj_robot_act(robot, ticks, read), host.act(now, measured)
        assert moves == (target is not None) and (target is None or held.watchdog.target[:3] == pytest.approx(target, abs=2e-6))
        told = host.report(now, measured, degrees, volts, amperes, last)
        last = list(told.joint)
        raw = Telemetry(tuple(measured), 0, 0.0, state=told.state, voltage=volts, current=amperes, temperature=degrees)
        packet = c_telemetry(raw)
        size = firmware.fj_robot_report(robot, ticks, ctypes.byref(packet), answer, len(answer))
        assert bytes(answer[:size]) == fishmj1.encode_telemetry(told)
        states.add(told.state)
        faults |= set(told.fault)
        rests += host.watchdog.rested and told.state == RobotState.NEUTRAL
    seen = ServoFault(0)
    for fault in faults:
        seen |= fault
    assert len(states) == 4 and rests and seen == ServoFault.HOT | ServoFault.VOLTAGE | ServoFault.NO_REPLY | ServoFault.STUCK


def test_a_robot_that_cannot_say_what_it_is_does_not_start(firmware):
    assert not firmware.fj_robot_init(ctypes.byref(CRobot()), ctypes.byref(Info()), firmware.fj_default_limits()), "not filled in"
    for info in (INFO._replace(firmware="two words"), INFO._replace(servo_ids=(1, 1, 2)), INFO._replace(hold=0.3, neutral=0.1)):
        assert not firmware.fj_robot_init(ctypes.byref(CRobot()), ctypes.byref(c_info(info)), firmware.fj_default_limits())


@pytest.mark.parametrize(
    ("joint", "volts", "amperes", "told"),
    [
        ((0.1, 4.0, 0.3), 7.4, 0.5, ((0.1, 0.2, 0.3), 7.4, 0.5)),
        ((0.1, -math.inf, math.nan), 7.4, 0.5, ((0.1, 0.2, 0.3), 7.4, 0.5)),
        ((0.1, 0.2, 0.3), 50.0, 250.0, ((0.1, 0.2, 0.3), 41.0, 100.0)),
        ((0.1, 0.2, 0.3), -1.0, -250.0, ((0.1, 0.2, 0.3), 0.0, -100.0)),
        ((0.1, 0.2, 0.3), math.nan, 0.5, ((0.1, 0.2, 0.3), None, None)),
    ],
)
def test_whatever_is_measured_the_host_hears_of_it(firmware, joint, volts, amperes, told):
    robot = ctypes.byref(CRobot())
    assert firmware.fj_robot_init(robot, ctypes.byref(c_info(INFO)), firmware.fj_default_limits())

    def said(joint, volts, amperes) -> Telemetry:
        out, packet = (ctypes.c_uint8 * fishmj1.MOST_BYTES)(), c_telemetry(Telemetry((0.0,) * 3, 0, 0.0, state=RobotState.IDLE))
        packet.joint[:3], packet.voltage, packet.current, packet.has = joint, volts, amperes, fishmj1.FieldFlags.POWER
        return fishmj1.decode(bytes(out[: firmware.fj_robot_report(robot, 0, ctypes.byref(packet), out, len(out))])).value

    said((0.1, 0.2, 0.3), 7.4, 0.5)
    heard, bad = said(joint, volts, amperes), [not abs(angle) <= math.pi for angle in joint]
    assert heard.joint == pytest.approx(told[0]) and (heard.voltage, heard.current) == (pytest.approx(told[1]), told[2])
    assert [bool(fault & ServoFault.NO_REPLY) for fault in heard.fault] == bad
    ours = fishmj1.clamped_to_wire_range(
        Telemetry(joint, 0, 0.0, state=RobotState.IDLE, voltage=volts, current=amperes), (0.1, 0.2, 0.3)
    )
    assert (ours.joint, ours.voltage, ours.current) == told and [bool(fault) for fault in ours.fault] == bad
    assert fishmj1.decode(fishmj1.encode_telemetry(ours))
