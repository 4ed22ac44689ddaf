"""The tables of docs/tank/protocols.md are those of the code, byte by byte."""

import math
import re
import struct
import zlib
from pathlib import Path

import pytest

from fishmj.deploy.protocols import fishmj1, lx_bus, mish
from fishmj.deploy.protocols.firmware_guard import Bounds
from fishmj.deploy.protocols.fishmj1 import FieldFlags, Kind
from fishmj.deploy.protocols.messages import RobotInfo, RobotState, ServoFault, Telemetry
from fishmj.deploy.protocols.watchdog import LATE, LONGEST, Limits

PAGE = (Path(__file__).resolve().parent.parent / "docs" / "tank" / "protocols.md").read_text(encoding="utf-8")
FORMS = {"u8": "B", "i8": "b", "u16": "<H", "u32": "<I", "u64": "<Q", "f32": "<f", "i32": "<i"}
J = 3
TELEMETRY = Telemetry(
    joint=(0.5, -0.25, 0.125),
    seq=0x01020304,
    time=1.5,
    echo=0x0A0B0C0D,
    echo_time=99.25,
    state=RobotState.HOLD,
    voltage=7.5,
    current=-0.5,
    servo_voltage=(7.4, 7.3, 7.2),
    temperature=(25.0, -3.0, 90.0),
    fault=(ServoFault.HOT, ServoFault.LOCKED, ServoFault.STUCK),
)
INFO = RobotInfo("reference-0.1.0", "ab" * 32, (7, 8, 9), ("head", "middle", "tail"), 1.0, 0.1, 0.3, "cd" * 32)
MADE = {
    "ARM": (fishmj1.encode_arm(5, 2.0, 0.1, 0.3), {"hold": [100_000], "neutral": [300_000]}),
    "COMMAND": (
        fishmj1.encode_command(5, 2.0, (0.5, -0.5, 0.25), (1.0, 2.0, 4.0)),
        {"joint": [0.5, -0.5, 0.25], "speed": [1.0, 2.0, 4.0]},
    ),
    "TELEMETRY": (
        fishmj1.encode_telemetry(TELEMETRY),
        {
            "state": [2],
            "parts": [31],
            "reserved": [0],
            "echo": [0x0A0B0C0D],
            "echo_time": [99_250_000],
            "voltage": [7.5],
            "current": [-0.5],
            "joint": [0.5, -0.25, 0.125],
            "servo_voltage": [7400, 7300, 7200],
            "temperature": [25, -3, 90],
            "fault": [1, 4, 16],
        },
    ),
    "INFO": (
        fishmj1.encode_info(5, 2.0, INFO),
        {
            "hold": [100_000],
            "neutral": [300_000],
            "servo_range": [1.0],
            "firmware": [b"reference-0.1.0"],
            "firmware_sha256": [b"\xab" * 32],
            "policy_sha256": [b"\xcd" * 32],
            "servo_ids": [7, 8, 9],
            "joints": [b"head", b"middle", b"tail"],
        },
    ),
}


def section(title: str) -> str:
    return PAGE.split(f"{title}\n", 1)[1].split("\n#", 1)[0]


def rows(text: str, number: int = 0) -> list[list[str]]:
    """Rows of a table of a text, without its head."""
    table = [part for part in text.split("\n\n") if part.lstrip("\n").startswith("|")][number].strip("\n")
    return [[cell.strip().strip("`") for cell in line.strip("|").split("|")] for line in table.split("\n")[2:]]


def place(at: str, k: int, length: int = 0) -> int:
    """Where a formula of the page puts the bytes of joint k."""
    assert re.fullmatch(r"[\d +JkL]+", at)
    terms = [re.fullmatch(r"(\d*) ?([JkL]?)", term.strip()) for term in at.split("+")]
    value = {"": 1, "J": J, "k": k, "L": length}
    return sum(int(term[1] or 1) * value[term[2]] for term in terms if term)


def read(data: bytes, at: int, kind: str) -> tuple[object, int]:
    """(value, bytes) of a type of the page."""
    if found := re.fullmatch(r"text (\d+)|(\d+) bytes", kind):
        size = int(found[1] or found[2])
        raw = data[at : at + size]
        return (raw.rstrip(b"\0") if found[1] else raw), size
    return struct.unpack_from(FORMS[kind], data, at)[0], struct.calcsize(FORMS[kind])


@pytest.mark.parametrize("kind", MADE)
def test_each_payload_is_where_the_page_says(kind):
    data, values = MADE[kind]
    seen, fields = set(), []
    for at, form, field, _ in rows(section(f"### {kind}")):
        fields.append(field)
        for k in range(J if "k" in at else 1):
            value, size = read(data, place(at, k), form)
            assert value == values[field][k], (field, k)
            seen |= set(range(place(at, k), place(at, k) + size))
    assert fields == list(values)
    assert seen == set(range(20, len(data) - 4)), "each byte of the payload is in one row"


def test_the_header_is_where_the_page_says():
    data, length = MADE["TELEMETRY"][0], len(MADE["TELEMETRY"][0]) - 24
    values = {
        "magic": fishmj1.MAGIC, "version": fishmj1.VERSION, "kind": Kind.TELEMETRY, "joints": J, "reserved": 0, "length": length,
        "seq": TELEMETRY.seq, "time": 1_500_000, "crc": zlib.crc32(data[:-4]),
    }  # fmt: skip
    for at, form, field, _ in rows(section("### Every datagram")):
        if form:
            assert read(data, place(at, 0, length), form)[0] == values.pop(field), field
    assert values == {}


def test_the_sizes_are_those_of_the_page():
    table = rows(section("### Every datagram"), 1)
    sizes = {row[0]: [int(n) for n in row[3].split(",")] for row in table}
    assert sizes == {
        "HELLO": [len(fishmj1.encode_hello(0, 0.0))],
        "ARM": [len(MADE["ARM"][0])],
        "DISARM": [len(fishmj1.encode_disarm(0, 0.0))],
        "COMMAND": [len(fishmj1.encode_command(0, 0.0, (0.0,) * 3)), len(MADE["COMMAND"][0])],
        "TELEMETRY": [len(MADE["TELEMETRY"][0])],
        "INFO": [len(MADE["INFO"][0])],
    }
    assert f"at most {fishmj1.MOST_BYTES} bytes" in PAGE


def cell(title: str, field: str) -> str:
    return next(row[3] for row in rows(section(title)) if row[2] == field)


def test_numbers_of_states_kinds_parts_and_faults_are_those_of_the_page():
    assert cell("### Every datagram", "kind") == ", ".join(f"{kind.value} {kind.name}" for kind in Kind)
    assert cell("### TELEMETRY", "state") == ", ".join(f"{state.value} {state.name}" for state in RobotState)
    parts = {"ECHO": "echo", "POWER": "battery", "SERVO_VOLTAGE": "servo voltage", "TEMPERATURE": "temperature", "FAULT": "fault"}
    assert ", ".join(f"{part.value} {parts[str(part.name)]}" for part in FieldFlags) in cell("### TELEMETRY", "parts")
    faults = [f"{fault.value} {str(fault.name).lower().replace('_', ' ')}" for fault in ServoFault if fault]
    assert ", ".join(faults) in cell("### TELEMETRY", "fault")


def test_bounds_are_those_of_the_page():
    assert cell("### TELEMETRY", "voltage").endswith(f"0 to {fishmj1.MOST_VOLTAGE:g}")
    assert cell("### TELEMETRY", "current").endswith(f"+- {fishmj1.MOST_CURRENT:g}")
    assert f"above 0 to {fishmj1.MOST_SPEED:g}" in cell("### COMMAND", "speed")
    assert f"at most {fishmj1.MOST_WAIT:g} s; the firmware takes {LONGEST:g} s at most" in cell("### ARM", "neutral")
    assert cell("### Every datagram", "time").endswith("2^50") and fishmj1.MOST_TIME == 2**50
    limits, degrees = Limits(), lambda value: f"{round(value * 180 / 3.141592653589793)} deg"
    told = section("### The robot's watchdog")
    assert f"at most {degrees(limits.rate)}/s" in told and f"at most {degrees(limits.lead)}\n" in told
    assert f"within {degrees(limits.near)} of it, at the latest after {limits.rest:g} s in NEUTRAL" in told
    assert f"further than {degrees(limits.near)} beyond the servo range" in told
    assert f"zero at {degrees(limits.neutral_rate)}/s" in told and f"counts {LATE / 1e6:g} s at most" in told


def test_faults_begin_where_the_page_says():
    bounds, degrees = Bounds(), lambda value: f"{round(math.degrees(value))} deg"
    begins = {row[0]: row[2] for row in rows(section("### The robot's guard"))}
    assert list(begins) == [f"{fault.value} {str(fault.name).lower().replace('_', ' ')}" for fault in ServoFault if fault]
    stuck = f"under torque, {degrees(bounds.far)} from its target for {bounds.stuck:g} s, moved less than {degrees(bounds.still)}"
    assert begins["16 stuck"] == stuck and begins["1 hot"].startswith(f"{bounds.hot:g} deg C;")
    assert begins["2 voltage"] == f"each battery reading of {bounds.sag:g} s is below {bounds.low:g} V"


def test_the_open_robots_bytes_are_where_the_page_says():
    up = mish.encode_telemetry(Telemetry((0.0, 0.0, 0.0), servo_voltage=(7.5, 7.25, 7.0), temperature=(30, 31, 32)), (1, 2, 3))
    down = mish.encode_command((0.5, 0.25, -0.5), (1.0, 2.0, 3.0))
    wanted = {"id": (1, 2, 3), "theta": (0.0,) * 3, "vin": (7.5, 7.25, 7.0), "temp": (30, 31, 32)}
    speeds = {"theta": (0.5, 0.25, -0.5), "speed": (1.0, 2.0, 3.0)}
    for number, data, values in ((0, up, wanted), (1, down, speeds)):
        table = rows(section("## The open robot's layout"), number)
        for at, form, field, _ in table:
            letter = FORMS[form.removeprefix("3 x ")][1]
            assert struct.unpack_from(f"<3{letter}", data, int(at)) == values[field], field
        assert len(table) * 12 == len(data)


def test_the_codes_of_the_servo_bus_are_those_of_the_page():
    forms = {"B": "u8", "b": "i8", "H": "u16", "h": "i16"}
    wanted = []
    for code, row in lx_bus.TABLE.items():
        fields = row.replies or row.asks
        said = ", ".join(f"{f.name} {forms[f.form]} {f.least} to {f.most}" for f in fields) or "none"
        wanted.append([str(code.value), code.name, said])
    told = rows(section("## The servo bus"), 1)
    assert [[cell.removesuffix(" *") for cell in row] for row in told] == wanted
