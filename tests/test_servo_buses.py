"""Hosts on a servo bus, LX or Dynamixel: questions and commands, servos that are missing, and a fish of two servos."""

import json
import os
import select
import struct
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from policy_files import header, stored

from fishmj.base import console
from fishmj.base.errors import ConfigError, UnknownName
from fishmj.control.policy_meta import structure_sha256
from fishmj.deploy.commands import swim_command
from fishmj.deploy.link.servo_bus_link import ServoBusLink
from fishmj.deploy.loopback import lockstep
from fishmj.deploy.loopback.loopback_server import LoopbackServer, ServeOptions
from fishmj.deploy.loopback.loopback_servos import LoopbackServos
from fishmj.deploy.loopback.loopback_settings import LoopbackSettings
from fishmj.deploy.loopback.readings import Readings
from fishmj.deploy.protocols import dynamixel, servo_counts
from fishmj.deploy.protocols.dynamixel import Instruction
from fishmj.deploy.protocols.messages import ServoFault
from fishmj.deploy.protocols.servo_bus import BUSES, X_TABLE, x_fault
from fishmj.deploy.rig import rig_experiment
from fishmj.mjcf import servo_buses
from fishmj.mjcf.description import RigSpec
from fishmj.mjcf.identity import constants_sha256, observation_of, structure_of
from fishmj.mjcf.new import __main__ as new
from fishmj.mjcf.new.answers import sheet_file
from fishmj.mjcf.reading import load_robot
from fishmj.mjcf.servos import SHELF
from fishmj.water.water_identity import water_identity
from tests.deploying import FakeClock

RIG = RigSpec(servo_ids=(4, 7, 9), signs=(1, -1, 1), zeros=(0.1, 0.0, -0.2))


class Line:
    """A serial line to the loopback's servos; every read costs 1 ms of the fake clock.

    Attributes:
        unplugged: numbers of servos that are not there. written: all that the host wrote. change: what becomes of an answer.
        stall: s that the host's computer is busy elsewhere after it wrote.
    """

    def __init__(self, clock, bus):
        self.clock, self.unplugged, self.written = clock, set(), b""
        self.robot = replace(load_robot("fish"), rig=replace(RIG, bus=bus))
        self.servos, self._line, self.change, self.stall = LoopbackServos(self.robot), b"", lambda data: data, 0.0
        self.see((0.0, 0.0, 0.0))

    def see(self, joint, degrees=31.0):
        none = (ServoFault.NONE,) * 3
        self.servos.readings = Readings(tuple(joint), 7.4, 0.5, (7.4,) * 3, (degrees,) * 3, none)

    @property
    def in_waiting(self):
        return len(self._line)

    def write(self, data):
        self.written += data
        fault = tuple(ServoFault.NO_REPLY if s in self.unplugged else ServoFault.NONE for s in RIG.servo_ids)
        self.servos.readings = self.servos.readings._replace(fault=fault)
        for answer in self.servos.hear(data, self.clock.t, ())[1]:
            self._line += self.change(answer)
        self.clock.t += self.stall

    def read(self, n):
        self.clock.t += 0.001
        found, self._line = self._line[:n], self._line[n:]
        return found

    def close(self): ...


def made(bus, **options):
    clock = FakeClock()
    port = Line(clock, bus)
    rig = port.robot.rig
    link = ServoBusLink(lambda: port, clock, rig.servo_ids, rig.zeros, rig.signs, bus=BUSES[bus], **options)
    link.open()
    return clock, port, link


def ticks(clock, link, count=8):
    """The packets of some ticks of 20 ms."""
    packets = []
    for _ in range(count):
        clock.t = round(clock.t + 0.02, 6)
        packets += [one.value for one in link.receive(clock.t)]
    return packets


@pytest.mark.parametrize("bus", BUSES)
def test_every_bus_commands_and_reads_joints_with_zeros_and_signs(bus):
    clock, port, link = made(bus)
    port.see((0.3, -0.2, 0.5))
    told = ticks(clock, link)[-1]
    half = BUSES[bus].scale.step / 2 + 1e-9
    np.testing.assert_allclose(told.joint, (0.3, -0.2, 0.5), atol=half)
    assert told.servo_voltage == (7.4, 7.4, 7.4) and told.temperature == (31.0, 31.0, 31.0)
    assert told.fault == (ServoFault.NONE,) * 3
    assert port.servos.act(0.0, ()) is None
    link.arm(clock.t, 0.1, 0.3)
    np.testing.assert_allclose(port.servos.act(0.0, ()), (0.3, -0.2, 0.5), atol=2 * half)  # torque on moves nothing
    link.send(np.array([0.1, 0.4, -0.3]), clock.t)
    np.testing.assert_allclose(port.servos.act(0.0, ()), (0.1, 0.4, -0.3), atol=half)
    link.disarm(clock.t)
    assert port.servos.act(0.0, ()) is None


def test_an_x_series_is_asked_by_one_sync_read_and_told_by_sync_writes():
    clock, port, link = made("dynamixel-x")
    ticks(clock, link, 2)
    port.written = b""
    ticks(clock, link, 1)
    link.send(np.zeros(3), clock.t)
    packets = dynamixel.PacketReader(dynamixel.Protocol2()).frames(port.written)
    assert [p.instruction for p in packets] == [Instruction.SYNC_READ, Instruction.READ, Instruction.SYNC_WRITE]
    assert packets[0].data == struct.pack("<HH", 132, 15) + bytes(RIG.servo_ids)
    assert packets[2].data[:4] == struct.pack("<HH", 116, 4) and link.counts["asked_again"] == 0


@pytest.mark.parametrize("bus", BUSES)
def test_a_servo_that_is_missing_is_named_with_those_that_answer(bus):
    clock, port, link = made(bus)
    port.unplugged = {7}
    assert ticks(clock, link) == []
    assert link.silence().startswith("servo 7 (joint 2 from the head) does not answer, 4, 9 do; look at the plug")
    port.unplugged = {4, 7, 9}
    link.forget()
    assert ticks(clock, link) == []
    assert link.silence().startswith(f"no servo answers (asked {bus} servos 4, 7, 9 at {BUSES[bus].baud} baud)")
    port.unplugged = set()
    assert ticks(clock, link)


@pytest.mark.parametrize("bus", BUSES)
def test_a_servo_that_falls_silent_is_lost_while_the_others_are_read(bus):
    clock, port, link = made(bus)
    ticks(clock, link)
    port.unplugged = {4}
    port.see((0.3, -0.2, 0.5))
    told = ticks(clock, link)[-1]
    assert [ServoFault.NO_REPLY in fault for fault in told.fault] == [True, False, False]
    link.patience = 0.3  # as of a simulated servo, which is late where the computer is busy
    lost = [ServoFault.NO_REPLY in told.fault[0] for told in ticks(clock, link, 30)]
    assert not lost[0] and lost[-1]
    np.testing.assert_allclose(told.joint[1:], (-0.2, 0.5), atol=BUSES[bus].scale.step)


@pytest.mark.parametrize("bus", BUSES)
def test_damaged_answers_are_asked_for_again_and_never_believed(bus):
    clock, port, link = made(bus)
    ticks(clock, link)
    rng, count = np.random.default_rng(0), [0]

    def spoil(answer):
        count[0] += 1
        bad = bytearray(answer)
        if count[0] % 3 == 0:
            bad[rng.integers(len(bad))] ^= 1 << int(rng.integers(8))
        return bytes(bad)

    port.change = spoil
    port.see((0.3, -0.2, 0.5))
    told = ticks(clock, link, 40)
    assert len(told) == 40 and link.counts["asked_again"] > 5
    np.testing.assert_allclose([packet.joint for packet in told[2:]], [(0.3, -0.2, 0.5)] * 38, atol=BUSES[bus].scale.step)


@pytest.mark.parametrize("bus", BUSES)
def test_answers_that_wait_while_the_host_was_busy_are_believed(bus):
    clock, port, link = made(bus)
    ticks(clock, link)
    port.stall = 0.015
    told = link.receive(clock.t)[0].value
    assert ServoFault.NO_REPLY not in told.fault[0] and link.counts["asked_again"] == 0


@pytest.mark.parametrize("bus", ["dynamixel-x", "dynamixel-ax"])
def test_a_hot_dynamixel_tells_so_and_lets_go(bus):
    clock, port, link = made(bus)
    ticks(clock, link)
    link.arm(clock.t, 0.1, 0.3)
    port.see((0.0, 0.0, 0.0), 71.0)
    assert port.servos.act(0.0, ()) is None
    assert ticks(clock, link)[-1].fault == (ServoFault.HOT,) * 3
    link.arm(clock.t, 0.1, 0.3)
    assert port.servos.act(0.0, ()) is None  # until it is switched off


def test_hardware_errors_are_faults():
    bits = {
        0x01: ServoFault.VOLTAGE,
        0x04: ServoFault.HOT,
        0x08: ServoFault.LOCKED,
        0x10: ServoFault.LOCKED,
        0x20: ServoFault.LOCKED,
    }
    assert {bit: x_fault(bit) for bit in bits} == bits and x_fault(0) == ServoFault.NONE
    bus = BUSES["dynamixel-ax"]
    state = bus.wire.encode(1, Instruction.STATUS, bytes(8), 0x24)  # the maker's example: overload and overheating
    assert bus.answer(bus.wire.decode(state)).fault == ServoFault.LOCKED | ServoFault.HOT


@pytest.mark.parametrize(
    ("bus", "place", "value", "words"),
    [
        ("dynamixel-x", 0, struct.pack("<H", 350), "servo 4 is of model number 350; expected an X series"),
        ("dynamixel-x", 11, b"\x01", "servo 4 is in operating mode 1; expected 3"),
        ("dynamixel-ax", 0, struct.pack("<H", 29), "servo 4 is of model number 29; expected an AX series"),
        ("dynamixel-ax", 6, bytes(4), "servo 4 is in wheel mode"),
    ],
)
def test_a_servo_of_another_kind_or_mode_is_refused_by_name(bus, place, value, words):
    clock, port, link = made(bus)
    wire = BUSES[bus].wire

    def other(answer):
        packet = wire.decode(answer)
        if len(packet.data) not in (10, 12):
            return answer
        data = packet.data[:place] + value + packet.data[place + len(value) :]
        return wire.encode(packet.servo, Instruction.STATUS, data, packet.error)

    port.change = other
    assert ticks(clock, link) == []
    assert words in link.silence()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"baud": 57600}, "at 57600 baud 3 servos need .* ms of each tick .* faster one, such as 1000000"),
        ({"move_time": 0.02}, "'move_time', which dynamixel-x does not have; take linear or hold"),
    ],
)
def test_a_bus_that_cannot_do_it_is_refused(options, words):
    with pytest.raises(ConfigError, match=words):
        made("dynamixel-x", **options)


def test_numbers_that_a_bus_does_not_have_are_refused():
    for ids, signs, words in (((1, 253), None, "dynamixel-x has 0 to 252"), ((1, 2), (1, 0), "expected 1 or -1")):
        with pytest.raises(ConfigError, match=words):
            ServoBusLink(lambda: None, FakeClock(), ids, None, signs, bus=BUSES["dynamixel-x"])


def test_the_control_table_is_that_of_the_maker():
    """Addresses of the e-Manual's table for XL330-M288-T and XW540-T260-R, the same."""
    assert (X_TABLE.torque[0], X_TABLE.error, X_TABLE.goal[0], X_TABLE.position[0]) == (64, 70, 116, 132)
    assert (X_TABLE.volts[0], X_TABLE.degrees[0]) == (144, 146)
    assert servo_counts.counts(np.pi / 2, 0.0, servo_buses.X) == 3072
    assert servo_counts.counts(np.radians(150), 0.0, servo_buses.AX) == 1023


# a fish of two XL330 at 5 V, from `fishmj new` on; synthetic


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    """The description of the fish, as `new` writes it, and a policy of small random weights for it."""
    folder = tmp_path_factory.mktemp("two")
    path = folder / "two.toml"
    sizes = ["--length", "0.4", "--links", "3", "--servo", "xl330-m288"]
    assert console.run(new.main, ["two", *sizes, "--yes", "--out", str(path)]) == console.OK
    robot, rng = load_robot(path), np.random.default_rng(0)
    shapes = ((8, 5 + 2 * robot.n_joints), (robot.n_joints, 8))
    weights = {f"w{i}": 0.3 * rng.normal(size=shape).astype(np.float32) for i, shape in enumerate(shapes)}
    weights |= {f"b{i}": np.zeros(shape[0], np.float32) for i, shape in enumerate(shapes)}
    meta = header(
        robot=robot.name, joints=robot.n_joints, structure=structure_of(robot), constants_sha256=constants_sha256(robot),
        structure_sha256=structure_sha256(structure_of(robot)), water=water_identity(robot),
        observation=observation_of(robot.n_joints), action=f"joint angle over {robot.servo.range:.6f} rad",
        scale=[1.0] * (5 + 2 * robot.n_joints),
    )  # fmt: skip
    return path, stored(folder, meta, weights)


def test_new_writes_the_rig_of_each_servo_it_offers():
    buses = {name: sheet.bus for name, sheet in SHELF.items()}
    assert buses == {
        "lx-824": "lx", "lx-16a": "lx", "ax-12a": "dynamixel-ax", "xl330-m288": "dynamixel-x", "xw540-t260": "dynamixel-x"
    }  # fmt: skip


def test_a_data_sheet_may_name_its_bus(tmp_path):
    sheet = 'stall_torque = "0.9 Nm"\nno_load_speed = "60rpm"\nvoltage = 5.0\n'
    (tmp_path / "xc330.toml").write_text(sheet + 'bus = "dynamixel-x"\n')
    (tmp_path / "plain.toml").write_text(sheet)
    (tmp_path / "can.toml").write_text(sheet + 'bus = "can"\n')
    assert [sheet_file(tmp_path / f"{name}.toml").bus for name in ("xc330", "plain")] == ["dynamixel-x", "lx"]
    with pytest.raises(UnknownName, match="can"):
        sheet_file(tmp_path / "can.toml")


def test_a_new_fish_of_five_volts_carries_its_rig(two):
    rig = tomllib.loads(two[0].read_text())["rig"]
    assert (rig["bus"], rig["baud"], rig["servo_ids"], rig["signs"]) == ("dynamixel-x", 1_000_000, [1, 2], [1, 1])
    assert rig["low_voltage"] == 4.32 and load_robot(two[0]).low_voltage == 4.32


@pytest.mark.parametrize("protocol", ["servo-bus", "fishmj-1"])
def test_a_fish_of_two_servos_at_five_volts_arms_and_swims(two, tmp_path, capsys, protocol):
    words = ["--policy", two[1], "--robot", str(two[0]), "--link", "loopback", "--protocol", protocol]
    more = ["--seconds", "3", "--out", str(tmp_path / "swim"), "--json", "--loopback", "--body structured"]
    assert swim_command.main([*words, *more], lockstep.wired) == console.OK
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert told["complete"] and told["swum_s"] >= 3.0 and told["figures"]["link"]["bad"] == 0


def test_a_low_supply_ends_the_swim_of_a_fish_at_its_own_bound(two, tmp_path, capsys):
    words = ["--policy", two[1], "--robot", str(two[0]), "--link", "loopback", "--protocol", "servo-bus", "--seconds", "9"]
    more = ["--out", str(tmp_path / "swim"), "--json", "--loopback", "--body structured --fault low_battery=4.2@1"]
    assert swim_command.main([*words, *more], lockstep.wired) == console.FAILED_CHECK
    assert "BATTERY_LOW" in json.loads(capsys.readouterr().out.splitlines()[-1])["ended_by"]


@pytest.mark.parametrize(("fault", "words"), [("silent_servo=2@1", "does not answer"), ("hot_servo=2@1", "is hot")])
def test_a_servo_that_ends_a_swim_is_named(two, tmp_path, capsys, fault, words):
    args = ["--policy", two[1], "--robot", str(two[0]), "--link", "loopback", "--protocol", "servo-bus", "--seconds", "9"]
    more = ["--out", str(tmp_path / "swim"), "--json", "--loopback", f"--body structured --fault {fault}"]
    assert swim_command.main([*args, *more], lockstep.wired) == console.FAILED_CHECK
    assert f"(servo 2 (joint 2 from the head) {words})" in json.loads(capsys.readouterr().out.splitlines()[-1])["ended_by"]


def test_a_servo_of_another_number_is_named_before_arming(two, tmp_path, capsys):
    words = ["--policy", two[1], "--robot", str(two[0]), "--link", "loopback", "--protocol", "servo-bus", "--servo-ids", "1,5"]
    with pytest.raises(ConfigError, match="servo 5 .joint 2 from the head. does not answer, 1 does"):
        swim_command.main(
            [*words, "--wait", "1", "--out", str(tmp_path / "swim"), "--loopback", "--body structured"], lockstep.wired
        )


def test_servos_answer_on_a_pseudo_terminal(two):
    """The loopback robot's own server, moved by hand: bytes of a question in, bytes of the answer out."""
    clock = [0.0]
    settings = LoopbackSettings(robot=str(two[0]), body="structured", protocol="servo-bus")
    server = LoopbackServer(ServeOptions(settings=settings, camera=False), lambda: clock[0])
    bus = BUSES["dynamixel-x"]
    try:
        assert server.connection()["robot_port"] is None
        host = os.open(server.connection()["device"], os.O_RDWR | os.O_NOCTTY)
        os.write(host, bus.ask("state", (1, 2)))
        reader, found = bus.reader(), []
        for _ in range(1000):  # the system hands bytes on in its own time
            clock[0] += 0.001
            server.turn(clock[0])
            if len(found) == 2:
                break
            if select.select([host], [], [], 0.05)[0]:
                found += [bus.answer(frame) for frame in reader.feed(os.read(host, 200))]
        os.close(host)
    finally:
        server.close()
    assert [(answer.servo, answer.volts) for answer in found] == [(1, 5.0), (2, 5.0)]
    assert [abs(answer.position - 2048) < 3 for answer in found] == [True, True]


@pytest.mark.slow
def test_two_servos_on_a_serial_line_swim_in_real_time(two, tmp_path, capsys):
    """The loopback robot as a process of its own, its servos behind a pseudo-terminal; a busy computer may end the run early."""
    words = ["gait", "--repeats", "1", "--yes", "--robot", str(two[0]), "--link", "loopback", "--protocol", "servo-bus"]
    console.run(rig_experiment.main, [*words, "--wait", "100", "--out", str(tmp_path / "set"), "--json"])
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert told["trials"] == ["gait_1"] or told["unplayed"]["gait_1"].startswith("swam ")
