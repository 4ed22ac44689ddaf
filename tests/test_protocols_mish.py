"""The open robot's datagrams, and what its firmware makes of angles."""

import math
import random
import struct
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from protocol_values import ANGLE, damaged, floats, mish_datagrams

from fishmj.base.calib import constant
from fishmj.base.errors import UnknownName
from fishmj.deploy.protocols import mish
from fishmj.deploy.protocols.messages import Telemetry
from fishmj.deploy.protocols.protocol_error import ProtocolError

ROW = st.tuples(ANGLE, ANGLE, ANGLE)
IDS = st.tuples(*[st.integers(0, 253)] * 3)


@given(ROW, st.tuples(*[floats(0, mish.MOST_SPEED)] * 3))
def test_commands_come_back(joint, speed):
    assert mish.decode_command(mish.encode_command(joint, speed)) == (joint, speed)
    assert mish.decode_command(mish.encode_command(joint)) == (joint, (0.0, 0.0, 0.0))


@given(
    st.tuples(*[st.floats(-1.5, 1.5)] * 3), IDS, st.tuples(*[st.integers(0, 12_000)] * 3), st.tuples(*[st.integers(0, 90)] * 3)
)
def test_telemetry_comes_back_in_the_servos_steps(joint, ids, millivolts, degrees):
    it = Telemetry(joint, servo_voltage=tuple(v / 1000 for v in millivolts), temperature=tuple(float(d) for d in degrees))
    data = mish.encode_telemetry(it, ids, "fixed")
    read = mish.decode_telemetry(data)
    assert read.joint == pytest.approx(joint, abs=0.501 * math.radians(0.24))
    assert read.servo_voltage == pytest.approx(it.servo_voltage, rel=1e-6) and read.temperature == it.temperature
    assert mish.UPLINK.unpack(data)[:3] == tuple(ids)
    assert {name for name, value in read._asdict().items() if value is None} == {
        "seq", "time", "echo", "echo_time", "state", "voltage", "current", "fault",
    }  # fmt: skip


def test_the_layout_is_the_published_one():
    up = mish.encode_telemetry(Telemetry((0.0, 0.0, 0.0), servo_voltage=(7.5, 7.25, 7.0), temperature=(30, 31, 32)), (1, 2, 3))
    assert struct.unpack("<3i3f3f3i", up) == (1, 2, 3, 0.0, 0.0, 0.0, 7.5, 7.25, 7.0, 30, 31, 32)
    assert struct.unpack("<6f", mish.encode_command((0.5, 0.25, -0.5), (0.0, 1.0, 2.0))) == (0.5, 0.25, -0.5, 0.0, 1.0, 2.0)


def test_the_first_firmware_moves_to_0_96_of_the_angle_and_reports_nothing():
    asked = math.radians(50.0)
    scale = constant("robot", "firmware_scale_mish")
    assert mish.commanded(asked, "mish-0.1.0") == pytest.approx(asked * scale, abs=math.radians(0.24))
    assert mish.commanded(asked, "fixed") == pytest.approx(asked, abs=math.radians(0.12))
    assert mish.reading(asked, "mish-0.1.0") == 0.0
    data = mish.encode_telemetry(Telemetry((asked,) * 3), (1, 2, 3), "mish-0.1.0")
    assert mish.decode_telemetry(data).joint == (0.0, 0.0, 0.0)


@given(st.floats(-3, 3), st.sampled_from(mish.FIRMWARES))
def test_the_firmware_bounds_each_angle_at_60_deg(angle, firmware):
    assert abs(mish.commanded(angle, firmware)) <= mish.SERVO_RANGE + math.radians(0.12)


@pytest.mark.parametrize(("asked", "moved"), [(0.0, None), (0.01, 0.05), (1.0, 1.0), (9.0, 5.23)])
def test_speeds_are_bounded_and_zero_is_as_fast_as_it_can(asked, moved):
    assert mish.moved_at(asked) == moved


def test_an_unknown_firmware_is_named():
    with pytest.raises(UnknownName, match="mish-0.2.0"):
        mish.commanded(0.1, "mish-0.2.0")


def test_what_it_lacks_is_declared():
    assert {"sequence number", "watchdog", "checksum"} <= set(mish.LACKS)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        bytes(47),
        bytes(49),
        struct.pack("<3i3f3f3i", 1, 2, 254, 0, 0, 0, 7, 7, 7, 25, 25, 25),
        struct.pack("<3i3f3f3i", 1, 2, -1, 0, 0, 0, 7, 7, 7, 25, 25, 25),
        struct.pack("<3i3f3f3i", 1, 2, 3, math.nan, 0, 0, 7, 7, 7, 25, 25, 25),
        struct.pack("<3i3f3f3i", 1, 2, 3, 4.0, 0, 0, 7, 7, 7, 25, 25, 25),
        struct.pack("<3i3f3f3i", 1, 2, 3, 0, 0, 0, 7, math.inf, 7, 25, 25, 25),
        struct.pack("<3i3f3f3i", 1, 2, 3, 0, 0, 0, 7, -1, 7, 25, 25, 25),
        struct.pack("<3i3f3f3i", 1, 2, 3, 0, 0, 0, 7, 7, 7, 25, 256, 25),
    ],
)
def test_bytes_that_are_no_telemetry_are_refused(data):
    with pytest.raises(ProtocolError):
        mish.decode_telemetry(data)


@pytest.mark.parametrize(
    "values", [(math.nan, 0, 0, 0, 0, 0), (0, 0, 4, 0, 0, 0), (0, 0, 0, -1, 0, 0), (0, 0, 0, 0, math.inf, 0)]
)
def test_bytes_that_are_no_command_are_refused(values):
    with pytest.raises(ProtocolError):
        mish.decode_command(struct.pack("<6f", *values))
    with pytest.raises(ProtocolError):
        mish.encode_command(values[:3], values[3:])


def fuzz(seed: int, count: int) -> tuple[int, int, int]:
    """(spoiled, wrong, through): `wrong` are accepted with another length, or a value that is not finite or out of range;
    `through` are accepted with other bytes than any that were sent: there is no checksum.
    """
    rng = random.Random(seed)
    valid = mish_datagrams(rng)
    spoiled = wrong = through = 0
    for _ in range(count):
        data = damaged(rng, valid)
        if data in valid:
            continue
        spoiled += 1
        for decode, layout in ((mish.decode_command, "<6f"), (mish.decode_telemetry, "<3i3f3f3i")):
            try:
                decode(data)
            except ProtocolError:
                continue
            values = struct.unpack(layout, data)
            through += 1
            wrong += not all(math.isfinite(value) and abs(value) <= mish.MOST_TEMPERATURE for value in values)
    return spoiled, wrong, through


def test_5000_damaged_datagrams_yield_no_value_out_of_range():
    spoiled, wrong, through = fuzz(1, 5_000)
    assert wrong == 0 and 0 < through < spoiled


@pytest.mark.slow
def test_of_100000_spoiled_datagrams_as_many_get_through_as_the_page_says():
    page = (Path(__file__).resolve().parent.parent / "firmware" / "NOTES.md").read_text(encoding="utf-8")
    spoiled, wrong, through = fuzz(2, 100_000)
    assert wrong == 0 and f"{through:,} of {spoiled:,} spoiled ones" in page


@given(st.binary(max_size=60))
def test_any_bytes_give_values_or_one_error(data):
    for decode in (mish.decode_command, mish.decode_telemetry):
        try:
            decode(data)
        except ProtocolError as error:
            assert "\n" not in str(error)
