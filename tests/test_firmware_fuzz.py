"""Damaged frames in C, under the address and undefined-behaviour sanitizers; and the whole robot against the host's pieces."""

import ctypes
import math
import random
import re
import subprocess

import pytest
from firmware_library import FIRMWARE, SOURCES, CRobot, c_info, c_telemetry, compiled, firmware, floats, needs_compiler
from protocol_values import damaged

from fishmj.protocols import fishmj1
from fishmj.protocols.errors import ProtocolError
from fishmj.protocols.fishmj1 import Kind
from fishmj.protocols.messages import RobotInfo, ServoFault, Telemetry
from fishmj.protocols.sequence import SequenceGate
from fishmj.protocols.watchdog import Watchdog

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


def test_of_5000_damaged_frames_none_is_accepted_wrongly_and_none_touches_other_memory(fuzzer):
    found = tally(fuzzer, 5_000, 1)
    assert set(found) == {"fishmj-1", "LX", "robot"}
    assert all(row[0] == 5_000 and row[1] > 100 and row[-1] == 0 for row in found.values()), found


@pytest.mark.slow
def test_of_100000_damaged_frames_none_is_accepted_wrongly_and_none_touches_other_memory(fuzzer):
    found = tally(fuzzer, 100_000, 2)
    assert all(row[0] == 100_000 and row[1] > 2_000 and row[-1] == 0 for row in found.values()), found


class HostPieces:
    """The robot put together from the host's gate, watchdog and datagrams."""

    def __init__(self):
        self.watchdog, self.gate, self.sent, self.echo = Watchdog(3), SequenceGate(), 0, (None, None)

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

    def report(self, now: float, measured, last) -> Telemetry:
        self.sent += 1
        silent = [math.isnan(angle) for angle in measured]
        return Telemetry(
            joint=tuple(b if quiet else a for a, b, quiet in zip(measured, last, silent, strict=True)),
            seq=self.sent, time=now, echo=self.echo[0], echo_time=self.echo[1], state=self.watchdog.state,
            voltage=7.4, current=0.5, fault=tuple(ServoFault.NO_REPLY if quiet else ServoFault.NONE for quiet in silent),
        )  # fmt: skip


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
    ticks, last, states = 0, [0.0] * 3, set()
    former = host_says(rng, 0, 0.0)
    for number in range(1, 800):
        ticks += rng.choice([5_000, 20_000, 20_000, 150_000, 400_000])
        now, seq = ticks / 1e6, number if rng.random() < 0.9 else max(0, number - rng.randrange(5))
        measured = [rng.choice([-0.5, 0.0, 0.25, 0.5, *[math.nan] * (rng.random() < 0.05)]) for _ in range(3)]
        data = host_says(rng, seq, now)
        data = former if rng.random() < 0.1 else damaged(rng, [data]) if rng.random() < 0.1 else data
        former = data
        answer, read = (ctypes.c_uint8 * fishmj1.MOST_BYTES)(), floats(measured)
        size = firmware.fj_robot_hear(robot, data, len(data), ticks, read, answer, len(answer))
        assert bytes(answer[:size]) == host.hear(data, now, measured)
        moves, target = firmware.fj_robot_act(robot, ticks, read), host.watchdog.step(now, measured)
        assert moves == (target is not None) and (target is None or held.watchdog.target[:3] == pytest.approx(target, abs=2e-6))
        told = host.report(now, measured, last)
        last = list(told.joint)
        packet = c_telemetry(Telemetry(tuple(measured), 0, 0.0, state=told.state, voltage=7.4, current=0.5))
        size = firmware.fj_robot_report(robot, ticks, ctypes.byref(packet), answer, len(answer))
        assert bytes(answer[:size]) == fishmj1.encode_telemetry(told)
        states.add(told.state)
    assert len(states) == 4


def test_a_robot_that_cannot_say_what_it_is_does_not_start(firmware):
    for info in (INFO._replace(firmware="two words"), INFO._replace(servo_ids=(1, 1, 2)), INFO._replace(hold=0.3, neutral=0.1)):
        assert not firmware.fj_robot_init(ctypes.byref(CRobot()), ctypes.byref(c_info(info)), firmware.fj_default_limits())
