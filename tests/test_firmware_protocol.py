"""The firmware's fishmj-1 and its gate are the host's, byte for byte and decision for decision."""

import ctypes
import random
import zlib

import pytest
from firmware_library import Gate, Info, Message, c_info, c_telemetry, firmware, microseconds, needs_compiler
from hypothesis import given, settings
from hypothesis import strategies as st
from protocol_values import SEQ, TIME, commands, datagrams, fuzzed, infos, telemetries, watches

from fishmj.deploy.protocols import fishmj1
from fishmj.deploy.protocols.fishmj1 import Kind
from fishmj.deploy.protocols.protocol_error import ProtocolError
from fishmj.deploy.protocols.sequence import SequenceGate

__all__ = ["firmware"]  # a fixture
pytestmark = needs_compiler
OF_THE_HOST = (Kind.HELLO, Kind.ARM, Kind.DISARM, Kind.COMMAND)


def encoded(function, *arguments) -> bytes:
    out = (ctypes.c_uint8 * fishmj1.MOST_BYTES)()
    return bytes(out[: function(*arguments, out, len(out))])


def decoded(firmware, data: bytes) -> Message | None:
    message = Message()
    return message if firmware.fj_decode(data, len(data), ctypes.byref(message)) == 0 else None


def same(message: Message, read: fishmj1.Message) -> bool:
    """Whether C and Python read the same from a datagram."""
    it, value = message.values(), read.value
    watch = (microseconds(value.hold), microseconds(value.neutral)) if read.kind is Kind.ARM else (0, 0)
    joint = value.joint if read.kind is Kind.COMMAND else ()
    speed = (value.speed or ()) if read.kind is Kind.COMMAND else ()
    row = lambda values: (*values, *[0.0] * (8 - len(values)))
    return (
        (it["kind"], it["seq"], it["time_us"], it["joints"]) == (read.kind, read.seq, microseconds(read.time), len(joint))
        and (it["hold_us"], it["neutral_us"]) == watch
        and (tuple(it["joint"]), tuple(it["speed"]), it["has_speed"]) == (row(joint), row(speed), bool(speed))
    )


@given(data=st.binary(max_size=300))
def test_the_checksum_is_that_of_zip(firmware, data):
    assert firmware.fj_crc32(data, len(data)) == zlib.crc32(data)


@settings(max_examples=60)
@given(telemetry=telemetries())
def test_the_firmwares_telemetry_has_the_same_bytes(firmware, telemetry):
    assert encoded(firmware.fj_encode_telemetry, ctypes.byref(c_telemetry(telemetry))) == fishmj1.encode_telemetry(telemetry)


@settings(max_examples=50)
@given(seq=SEQ, time=TIME, info=infos())
def test_the_firmwares_info_has_the_same_bytes(firmware, seq, time, info):
    sent = encoded(firmware.fj_encode_info, seq, microseconds(time), ctypes.byref(c_info(info)))
    assert sent == fishmj1.encode_info(seq, time, info)


@settings(max_examples=60)
@given(seq=SEQ, time=TIME, watch=watches(), command=commands())
def test_the_firmware_reads_what_the_host_sends(firmware, seq, time, watch, command):
    for data in (
        fishmj1.encode_hello(seq, time),
        fishmj1.encode_disarm(seq, time),
        fishmj1.encode_arm(seq, time, *watch),
        fishmj1.encode_command(seq, time, *command),
    ):
        message = decoded(firmware, data)
        assert message is not None and same(message, fishmj1.decode(data))


def differences(firmware, seed: int, count: int) -> tuple[int, int]:
    """Datagrams on which C and Python differ; that both accept."""
    differ = accepted = 0
    for data, _ in fuzzed(seed, count, datagrams(random.Random(seed))):
        message = decoded(firmware, data)
        try:
            read = fishmj1.decode(data)
        except ProtocolError:
            read = None
        if read is not None and read.kind not in OF_THE_HOST:
            read = None
        accepted += message is not None
        differ += (message is None) != (read is None) or (message is not None and read is not None and not same(message, read))
    return differ, accepted


def test_c_and_python_agree_on_5000_damaged_datagrams(firmware):
    differ, accepted = differences(firmware, 5, 5_000)
    assert differ == 0 and accepted > 100


@pytest.mark.slow
def test_c_and_python_agree_on_100000_damaged_datagrams(firmware):
    differ, accepted = differences(firmware, 6, 100_000)
    assert differ == 0 and accepted > 2_000


@settings(max_examples=40)
@given(telemetry=telemetries(), room=st.integers(0, fishmj1.MOST_BYTES))
def test_nothing_is_written_where_there_is_no_room(firmware, telemetry, room):
    out = (ctypes.c_uint8 * fishmj1.MOST_BYTES)(*[0xAA] * fishmj1.MOST_BYTES)
    size = firmware.fj_encode_telemetry(ctypes.byref(c_telemetry(telemetry)), out, room)
    wanted = len(fishmj1.encode_telemetry(telemetry))
    assert size == (wanted if room >= wanted else 0) and set(out[size:]) <= {0xAA}


def test_values_that_cannot_be_carried_are_not_sent(firmware):
    it = fishmj1.decode(datagrams(random.Random(0))[6]).value
    for field, value in (("joints", 0), ("joints", 9), ("state", 4), ("has", 32), ("time_us", fishmj1.MOST_TIME + 1)):
        broken = c_telemetry(it)
        setattr(broken, field, value)
        assert encoded(firmware.fj_encode_telemetry, ctypes.byref(broken)) == b"", field
    broken = c_telemetry(it)
    broken.joint[0] = float("nan")
    assert encoded(firmware.fj_encode_telemetry, ctypes.byref(broken)) == b""


@pytest.mark.parametrize(
    ("field", "value"),
    [("joints", 9), ("firmware", b"two words"), ("firmware", b"-x"), ("firmware", b""), ("hold_us", 0), ("servo_range", 0.0)],
)
def test_an_info_that_cannot_be_is_not_sent(firmware, field, value):
    fine = fishmj1.decode(next(d for d in datagrams(random.Random(0)) if d[3] == Kind.INFO)).value
    broken: Info = c_info(fine)
    setattr(broken, field, value)
    assert encoded(firmware.fj_encode_info, 0, 0, ctypes.byref(broken)) == b""


@given(st.lists(st.tuples(st.integers(0, 30), st.integers(0, 12_000_000)), max_size=60), st.sampled_from([0, 2**32 - 15]))
def test_the_firmware_drops_the_same_datagrams(firmware, packets, start):
    gate, python = Gate(), SequenceGate()
    for seq, ticks in packets:
        number = (start + seq) % 2**32
        assert firmware.fj_gate_accept(ctypes.byref(gate), number, ticks) == python.accept(number, ticks / 1e6)


@pytest.mark.parametrize(("first", "second"), [(50, 50), (3_000, 50), (5, 40), (251, 30)])
def test_the_firmware_takes_a_restarted_host_at_the_same_datagram(firmware, first, second):
    gate, python = Gate(), SequenceGate()
    for seq, ticks in [(k, 20_000 * k) for count in (first, second) for k in range(count)]:
        assert firmware.fj_gate_accept(ctypes.byref(gate), seq, ticks) == python.accept(seq, ticks / 1e6)
    assert python.restarts == (first > 10)  # a shorter life is caught up with
