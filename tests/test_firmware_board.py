"""The robot's program on a board: a clock, a servo bus, a meter and a radio of this test, and the host that swims it."""

import ctypes
import math
from collections import deque
from ctypes import CFUNCTYPE, POINTER, c_bool, c_float, c_size_t, c_uint8, c_uint16, c_uint32, c_uint64, c_void_p

import numpy as np
import pytest
from firmware_library import Info, Struct, c_info, firmware, needs_compiler

from fishmj.deploy.link.links import Fishmj1Link
from fishmj.deploy.protocols import fishmj1, lx_bus, servo_counts
from fishmj.deploy.protocols.fishmj1 import Kind
from fishmj.deploy.protocols.lx_bus import Code
from fishmj.deploy.protocols.messages import RobotInfo, RobotState, ServoFault
from tests.deploying import Bench, FakeClock

__all__ = ["firmware"]  # a fixture
pytestmark = needs_compiler
INFO = RobotInfo("board-0.1.0", "00" * 32, (4, 5, 6), ("j1", "j2", "j3"), math.radians(60.0), 0.1, 0.3)
ZEROS, SIGNS, SHUNT, MOST = (0.02, -0.03, 0.0), (1.0, -1.0, 1.0), 0.01, 5.0
TICK, BYTE = 20_000, 87  # us

Now = CFUNCTYPE(c_uint64, c_void_p)
Receive = CFUNCTYPE(c_size_t, c_void_p, POINTER(c_uint8), c_size_t)
Send = CFUNCTYPE(None, c_void_p, POINTER(c_uint8), c_size_t)
Read = CFUNCTYPE(c_size_t, c_void_p, POINTER(c_uint8), c_size_t, c_uint32)
Put = CFUNCTYPE(c_bool, c_void_p, c_uint8, c_uint16)
Get = CFUNCTYPE(c_bool, c_void_p, c_uint8, POINTER(c_uint16))


class Hal(Struct):
    _fields_ = [
        ("at", c_void_p), ("now_us", Now), ("udp_receive", Receive), ("udp_send", Send), ("uart_write", Send),
        ("uart_read", Read), ("i2c_write", Put), ("i2c_read", Get),
    ]  # fmt: skip


class Parts(Struct):
    _fields_ = [
        ("info", Info), ("zero", c_float * 8), ("sign", c_float * 8), ("shunt_ohm", c_float), ("most_ampere", c_float),
        ("low_battery", c_float),
    ]  # fmt: skip


class Board:
    """A board around the C: servos that go where they are told at 300 deg/s, an INA226 at 7.4 V and 0.5 A.

    Attributes:
        silent: servo ids that do not answer. dead: the meter does not answer. echoes: the line gives back what was written.
    """

    def __init__(self, firmware, parts=None):
        self.firmware, self.us = firmware, 1_000_000
        self.counts = dict.fromkeys(INFO.servo_ids, 500.0)
        self.goal, self.loaded = dict(self.counts), dict.fromkeys(INFO.servo_ids, True)
        self.silent, self.dead, self.echoes = set(), False, True
        self.arriving: deque[bytes] = deque()
        self.told: list[tuple[int, bytes]] = []
        self.frames: list[lx_bus.LxFrame] = []
        self.words: dict[int, int] = {}
        self._line, self._reader, self._moved = bytearray(), lx_bus.LxFrameReader(), self.us
        calls = (self.now, self.receive, self.send, self.write, self.read, self.put, self.get)
        self.hal = Hal(None, *[kind(call) for (_, kind), call in zip(Hal._fields_[1:], calls, strict=True)])
        floats = lambda values: (c_float * 8)(*values)
        self.parts = parts or Parts(c_info(INFO), floats(ZEROS), floats(SIGNS), SHUNT, MOST, 0.0)
        self.memory = (c_uint64 * 512)()
        self.begun = firmware.fj_board_init(self.memory, ctypes.byref(self.hal), ctypes.byref(self.parts))

    def now(self, at):
        self.us += 1  # nothing is done in no time
        return self.us

    def receive(self, at, data, room):
        if not self.arriving:
            return 0
        got = self.arriving.popleft()[:room]
        ctypes.memmove(data, got, len(got))
        return len(got)

    def send(self, at, data, size):
        self.told.append((self.us, bytes(data[:size])))

    def write(self, at, data, size):
        self.us += BYTE * size
        self._move()
        if self.echoes:
            self._line += bytes(data[:size])
        for frame in self._reader.frames(bytes(data[:size])):
            self.frames.append(frame)
            if frame.code is Code.MOVE_TIME_WRITE and self.loaded[frame.servo]:
                self.goal[frame.servo] = float(frame.values[0])
            elif frame.code is Code.LOAD_OR_UNLOAD_WRITE:
                self.loaded[frame.servo] = bool(frame.values[0])
            elif frame.servo not in self.silent and frame.code in (Code.POS_READ, Code.VIN_READ, Code.TEMP_READ):
                value = {Code.POS_READ: round(self.counts[frame.servo]), Code.VIN_READ: 7300, Code.TEMP_READ: 30}[frame.code]
                self._line += lx_bus.encode_reply(frame.servo, frame.code, value)

    def _move(self):
        step, self._moved = 1250.0 * (self.us - self._moved) / 1e6, self.us  # counts
        for servo, goal in self.goal.items():
            if not self.loaded[servo]:
                continue
            self.counts[servo] += max(-step, min(step, goal - self.counts[servo]))

    def read(self, at, data, room, wait):
        if not self._line:
            self.us += wait
            return 0
        got, self._line = self._line[:room], self._line[room:]
        self.us += BYTE * len(got)
        ctypes.memmove(data, bytes(got), len(got))
        return len(got)

    def put(self, at, register, word):
        self.words[register] = word
        return not self.dead

    def get(self, at, register, word):
        calibration = self.words.get(5, 0)
        values = {2: round(7.4 / 1.25e-3), 4: round(0.5 * SHUNT / 2.5e-6) * calibration // 2048}
        word[0] = values[register]
        return not self.dead

    def tick(self):
        """The next tick; how long it took, us."""
        self.us = self.us - self.us % TICK + TICK
        begun = self.us
        self._move()
        self.firmware.fj_board_tick(self.memory)
        return self.us - begun

    def heard(self, kind):
        """The newest datagram of a kind."""
        return next(m.value for _, data in reversed(self.told) if (m := fishmj1.decode(data)).kind is kind)


@pytest.fixture
def board(firmware):
    firmware.fj_board_init.restype, firmware.fj_board_init.argtypes = c_bool, [c_void_p, c_void_p, c_void_p]
    firmware.fj_board_tick.restype, firmware.fj_board_tick.argtypes = None, [c_void_p]
    made = Board(firmware)
    assert made.begun
    return made


class Wire:
    """Datagrams between host and board, 2 ms each way."""

    def __init__(self, board):
        self.board, self.taken = board, 0

    def open(self): ...
    def close(self): ...

    def send(self, data):
        self.board.arriving.append(data)

    def receive(self):
        fresh, self.taken = self.board.told[self.taken :], len(self.board.told)
        return [(us / 1e6 + 0.002, data) for us, data in fresh]


class BoardClock(FakeClock):
    """The host's clock; the board ticks while the host sleeps."""

    board: Board

    def sleep_until(self, t):
        while (self.board.us // TICK + 1) * TICK / 1e6 <= t:
            self.board.tick()
        super().sleep_until(t)


def test_the_host_swims_a_board_that_runs_the_c(board, tmp_path):
    """Supervisor, link and log of the host; frames of the servo bus behind it: the joints go where the policy wants them."""
    bench = Bench(tmp_path / "swim", seconds=3.0)
    clock = BoardClock(1.0)
    clock.board = board
    link = Fishmj1Link(Wire(board))
    bench.clock = bench.rig.clock = bench.eyes.clock = clock
    bench.rig.link = bench.robot = link
    outcome = bench.swim()
    assert outcome.complete and outcome.released is True, outcome.words
    cmd, joint = bench.log.trial().tables["cmd"], bench.log.trial().tables["joint"]
    assert np.ptp(cmd["c1"]) > 0.2  # it swam
    for k, (servo, zero, sign) in enumerate(zip(INFO.servo_ids, ZEROS, SIGNS, strict=True)):
        moves = [f.values[0] for f in board.frames if f.servo == servo and f.code is Code.MOVE_TIME_WRITE]
        angles = sign * np.array([servo_counts.angle(int(c), zero) for c in moves])
        asked, got = cmd[f"c{k + 1}"], joint[f"j{k + 1}"]
        assert np.ptp(asked) > 0.05 and 0.8 < np.ptp(angles) / np.ptp(asked) < 1.01  # what the watchdog lets through
        follows = np.interp(joint["t"] - 0.03, cmd["t"], asked)
        assert np.corrcoef(follows[20:], got[20:])[0, 1] > 0.9
    assert not any(board.loaded.values())
    assert np.allclose(bench.log.trial().tables["power"]["V"], 7.4, atol=2e-3)
    assert np.allclose(bench.log.trial().tables["power"]["I"], 0.5, atol=2e-3)


def test_board_tick_meets_its_time_limit_on_healthy_and_dead_buses(board):
    assert max(board.tick() for _ in range(12)) < 13_000
    board.silent = set(INFO.servo_ids)
    assert max(board.tick() for _ in range(12)) < 17_000
    assert all(fault & ServoFault.NO_REPLY for fault in board.heard(Kind.TELEMETRY).fault)


def test_one_silent_servo_is_told_and_the_others_go_on(board):
    for _ in range(10):
        board.tick()
    board.silent = {5}
    board.counts[6] = 600.0  # bent by hand; without torque it stays there
    board.tick()  # three tries for servo 5: whoever is behind it may have to wait a tick
    assert not board.heard(Kind.TELEMETRY).fault[2] & ServoFault.NO_REPLY
    board.tick()
    told = board.heard(Kind.TELEMETRY)
    assert [bool(f & ServoFault.NO_REPLY) for f in told.fault] == [False, True, False]
    assert told.joint[2] == pytest.approx(servo_counts.angle(600, 0.0), abs=1e-6) and told.temperature == (30.0,) * 3
    for _ in range(200):
        board.tick()
    assert board.heard(Kind.TELEMETRY).temperature is None  # of one servo it is not known any more


def test_a_meter_that_does_not_answer_is_left_out_and_taken_in_again(board):
    for _ in range(3):
        board.tick()
    assert board.heard(Kind.TELEMETRY).voltage == pytest.approx(7.4, abs=2e-3)
    board.dead = True
    board.tick()
    assert board.heard(Kind.TELEMETRY).voltage is None
    board.dead = False
    for _ in range(60):
        board.tick()
    assert board.heard(Kind.TELEMETRY).current == pytest.approx(0.5, abs=2e-3)


def test_a_host_that_falls_silent_leaves_joints_at_zero_without_torque(board):
    board.arriving.append(fishmj1.encode_arm(1, 1.0, 0.1, 0.3))
    board.tick()
    for number in range(2, 40):
        board.arriving.append(fishmj1.encode_command(number, number / 50, (0.4, -0.4, 0.4), None))
        board.tick()
    assert board.heard(Kind.TELEMETRY).state is RobotState.ARMED and all(board.loaded.values())
    assert board.heard(Kind.TELEMETRY).joint == pytest.approx((0.4, -0.4, 0.4), abs=0.01)
    states = []
    for _ in range(150):
        board.tick()
        states.append(board.heard(Kind.TELEMETRY).state)
    assert list(dict.fromkeys(states)) == [RobotState.ARMED, RobotState.HOLD, RobotState.NEUTRAL]
    assert not any(board.loaded.values()) and board.heard(Kind.TELEMETRY).joint == pytest.approx((0, 0, 0), abs=0.04)


def test_a_flood_of_datagrams_does_not_stop_the_servos(board):
    board.arriving.extend([b"no datagram"] * 1000)
    assert board.tick() < 13_000 and len(board.arriving) == 1000 - 8


@pytest.mark.parametrize("wrong", [{"sign": 0.0}, {"sign": 2.0}, {"zero": math.nan}, {"joints": 0}, {"joints": 9}])
def test_parts_that_cannot_be_are_refused(board, wrong):
    parts = Parts.from_buffer_copy(board.parts)
    if "joints" in wrong:
        parts.info.joints = wrong["joints"]
    else:
        getattr(parts, next(iter(wrong)))[1] = next(iter(wrong.values()))
    assert not Board(board.firmware, parts).begun
