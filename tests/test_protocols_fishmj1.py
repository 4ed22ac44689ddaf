"""fishmj-1: what is sent is what is read, and nothing else is."""

import math
import random
import re
import struct
import zlib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from protocol_values import DIGEST, NAME, SEQ, TIME, commands, datagrams, fuzzed, infos, resealed, telemetries, watches

from fishmj.base.errors import FishmjError
from fishmj.deploy.protocols import fishmj1
from fishmj.deploy.protocols.fishmj1 import Kind
from fishmj.deploy.protocols.messages import RobotInfo, RobotState, ServoFault, Telemetry
from fishmj.deploy.protocols.protocol_error import ProtocolError

FULL = Telemetry(
    joint=(0.5, -0.25, 0.125),
    seq=7,
    time=1.5,
    echo=6,
    echo_time=99.25,
    state=RobotState.ARMED,
    voltage=7.5,
    current=-0.5,
    servo_voltage=(7.4, 7.3, 7.2),
    temperature=(25.0, -3.0, 90.0),
    fault=(ServoFault.NONE, ServoFault.HOT, ServoFault.STUCK | ServoFault.NO_REPLY),
)
INFO = RobotInfo("reference-0.1.0", "ab" * 32, (1, 2, 3), ("j1", "j2", "j3"), 1.0, 0.1, 0.3, "cd" * 32)


def again(message: fishmj1.Message) -> bytes:
    """The one encoding of a message."""
    kind, seq, time, value = message
    if kind is Kind.HELLO:
        return fishmj1.encode_hello(seq, time)
    if kind is Kind.DISARM:
        return fishmj1.encode_disarm(seq, time)
    if kind is Kind.ARM:
        return fishmj1.encode_arm(seq, time, *value)
    if kind is Kind.COMMAND:
        return fishmj1.encode_command(seq, time, *value)
    if kind is Kind.INFO:
        return fishmj1.encode_info(seq, time, value)
    return fishmj1.encode_telemetry(value)


@settings(max_examples=60)
@given(SEQ, TIME, watches(), commands())
def test_what_the_host_sends_is_what_the_robot_reads(seq, time, watch, command):
    assert fishmj1.decode(fishmj1.encode_hello(seq, time)) == (Kind.HELLO, seq, time, None)
    assert fishmj1.decode(fishmj1.encode_disarm(seq, time)) == (Kind.DISARM, seq, time, None)
    assert fishmj1.decode(fishmj1.encode_arm(seq, time, *watch)) == (Kind.ARM, seq, time, watch)
    assert fishmj1.decode(fishmj1.encode_command(seq, time, *command)) == (Kind.COMMAND, seq, time, command)


@settings(max_examples=60)
@given(telemetries())
def test_telemetry_comes_back_with_all_that_it_has_and_no_more(telemetry):
    message = fishmj1.decode(fishmj1.encode_telemetry(telemetry))
    assert message == (Kind.TELEMETRY, telemetry.seq, telemetry.time, telemetry)
    assert all(type(a) is type(b) for a, b in zip(message.value, telemetry, strict=True))


@settings(max_examples=50)
@given(SEQ, TIME, infos())
def test_info_comes_back(seq, time, info):
    assert fishmj1.decode(fishmj1.encode_info(seq, time, info)) == (Kind.INFO, seq, time, info)


def test_no_datagram_is_longer_than_the_bound():
    names = tuple("n" * 15 + str(k) for k in range(8))
    info = INFO._replace(firmware="f" * 32, servo_ids=tuple(range(8)), joints=names)
    assert len(fishmj1.encode_info(0, 0.0, info)) <= fishmj1.MOST_BYTES
    assert max(len(data) for data in datagrams(random.Random(0))) <= fishmj1.MOST_BYTES


def fuzz(seed: int, count: int) -> dict[str, int]:
    """Counts of accepted datagrams. wrong: not byte for byte the encoding of what was read. forged: the fuzzer did not put a
    fitting checksum there, and nobody had sent these bytes.
    """
    valid = datagrams(random.Random(seed))
    tally = {"accepted": 0, "wrong": 0, "forged": 0}
    for data, sealed in fuzzed(seed, count, valid):
        try:
            message = fishmj1.decode(data)
        except ProtocolError:
            continue
        tally["accepted"] += 1
        tally["wrong"] += again(message) != data
        tally["forged"] += not sealed and data not in valid
    return tally


def test_of_5000_damaged_datagrams_none_is_accepted_wrongly():
    tally = fuzz(1, 5_000)
    assert tally["wrong"] == tally["forged"] == 0
    assert tally["accepted"] > 300  # what is resealed or unchanged goes through: the fuzzer reaches the values


@pytest.mark.slow
def test_of_100000_damaged_datagrams_none_is_accepted_wrongly():
    tally = fuzz(2, 100_000)
    assert tally["wrong"] == tally["forged"] == 0 and tally["accepted"] > 6_000


@given(st.binary(max_size=300))
def test_any_bytes_give_a_message_or_one_error(data):
    for bytes_ in (data, resealed(data), resealed(fishmj1.MAGIC + b"\x01" + data)):
        try:
            assert again(fishmj1.decode(bytes_)) == bytes_
        except ProtocolError as error:
            assert "\n" not in str(error)


def test_each_single_bit_matters():
    """CRC-32 finds every error of up to 32 neighbouring bits."""
    for data in (fishmj1.encode_telemetry(FULL), fishmj1.encode_command(1, 2.0, (0.1, 0.2, 0.3))):
        for bit in range(8 * len(data)):
            broken = bytearray(data)
            broken[bit // 8] ^= 1 << bit % 8
            with pytest.raises(ProtocolError):
                fishmj1.decode(bytes(broken))


def patched(data: bytes, at: int, form: str, value) -> bytes:
    """A datagram with other bytes at an offset, and a checksum that fits."""
    broken = bytearray(data)
    struct.pack_into(form, broken, at, value)
    return bytes(broken[:-4]) + struct.pack("<I", zlib.crc32(broken[:-4]))


COMMAND = fishmj1.encode_command(1, 2.0, (0.1, 0.2, 0.3), (1.0, 1.0, 1.0))


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "0 bytes"),
        (b"XX" + COMMAND[2:], "no fishmj datagram"),
        (patched(COMMAND, 2, "B", 2), "version 2; expected 1: update"),
        (patched(COMMAND, 3, "B", 9), "kind 9"),
        (patched(COMMAND, 4, "B", 0), "COMMAND of 0 joints; expected 1 to 8"),
        (patched(COMMAND, 4, "B", 9), "COMMAND of 9 joints; expected 1 to 8"),
        (patched(COMMAND, 4, "B", 2), "expected 8 or 16"),
        (patched(COMMAND, 5, "B", 1), "byte 5 is 1"),
        (patched(COMMAND, 12, "<Q", fishmj1.MOST_TIME + 1), "time"),
        (COMMAND[:-1] + bytes([COMMAND[-1] ^ 1]), "damaged"),
        (COMMAND + b"\0", "says 24 of payload"),
        (patched(COMMAND, 20, "<f", math.nan), "joint 0 nan"),
        (patched(COMMAND, 24, "<f", math.inf), "joint 1 inf"),
        (patched(COMMAND, 28, "<f", 3.2), "joint 2 3.2"),
        (patched(COMMAND, 32, "<f", 0.0), "above 0"),
        (patched(COMMAND, 32, "<f", 51.0), "speed 0 51"),
        (patched(fishmj1.encode_arm(1, 2.0, 0.1, 0.3), 20, "<I", 300_000), "hold"),
        (patched(fishmj1.encode_arm(1, 2.0, 0.1, 0.3), 20, "<I", 0), "hold"),
        (patched(fishmj1.encode_hello(1, 2.0), 4, "B", 1), "HELLO of 1 joints"),
        (patched(fishmj1.encode_telemetry(FULL), 20, "B", 4), "state 4"),
        (patched(fishmj1.encode_telemetry(FULL), 21, "B", 32), "parts 32"),
        (patched(fishmj1.encode_telemetry(FULL), 21, "B", 30), "has no ECHO"),
        (patched(fishmj1.encode_telemetry(FULL), 21, "B", 29), "has no POWER"),
        (patched(fishmj1.encode_telemetry(FULL), 21, "B", 15), "has no FAULT"),
        (patched(fishmj1.encode_telemetry(FULL), 36, "<f", -0.1), "voltage"),
        (patched(fishmj1.encode_telemetry(FULL), 40, "<f", math.nan), "current"),
        (patched(fishmj1.encode_telemetry(FULL), 51, "B", 32), "faults"),
        (patched(fishmj1.encode_info(1, 2.0, INFO), 28, "<f", 0.0), "servo_range"),
        (patched(fishmj1.encode_info(1, 2.0, INFO), 32, "B", 10), "firmware"),
        (patched(fishmj1.encode_info(1, 2.0, INFO), 33, "B", 0), "then zeros"),
        (patched(fishmj1.encode_info(1, 2.0, INFO), 128, "B", 2), "each of them once"),
        (patched(fishmj1.encode_info(1, 2.0, INFO), 128, "B", 254), "ids at most 253"),
    ],
)
def test_a_refusal_says_what_is_wrong(data, words):
    with pytest.raises(ProtocolError, match=re.escape(words)):
        fishmj1.decode(data)


@pytest.mark.parametrize(
    "call",
    [
        lambda: fishmj1.encode_hello(2**32, 0.0),
        lambda: fishmj1.encode_hello(-1, 0.0),
        lambda: fishmj1.encode_hello(0, -1.0),
        lambda: fishmj1.encode_hello(0, math.nan),
        lambda: fishmj1.encode_arm(0, 0.0, 0.3, 0.1),
        lambda: fishmj1.encode_arm(0, 0.0, math.inf, math.inf),
        lambda: fishmj1.encode_command(0, 0.0, ()),
        lambda: fishmj1.encode_command(0, 0.0, (0.0,) * 9),
        lambda: fishmj1.encode_command(0, 0.0, (math.nan, 0.0, 0.0)),
        lambda: fishmj1.encode_command(0, 0.0, (4.0, 0.0, 0.0)),
        lambda: fishmj1.encode_command(0, 0.0, (0.0, 0.0), (1.0,)),
        lambda: fishmj1.encode_command(0, 0.0, (0.0,), (0.0,)),
        lambda: fishmj1.encode_command(0, 0.0, (0.0,), (1e-50,)),  # zero in four bytes
        lambda: fishmj1.encode_telemetry(FULL._replace(seq=None)),
        lambda: fishmj1.encode_telemetry(FULL._replace(echo=None)),
        lambda: fishmj1.encode_telemetry(FULL._replace(current=None)),
        lambda: fishmj1.encode_telemetry(FULL._replace(fault=(ServoFault.HOT,))),
        lambda: fishmj1.encode_telemetry(FULL._replace(voltage=1e9)),
        lambda: fishmj1.encode_info(0, 0.0, INFO._replace(firmware="two words")),
        lambda: fishmj1.encode_info(0, 0.0, INFO._replace(firmware_sha256="0" * 64)),
        lambda: fishmj1.encode_info(0, 0.0, INFO._replace(policy_sha256="XY")),
        lambda: fishmj1.encode_info(0, 0.0, INFO._replace(servo_ids=(1, 1, 2))),
        lambda: fishmj1.encode_info(0, 0.0, INFO._replace(servo_ids=(1, 2))),
        lambda: fishmj1.encode_info(0, 0.0, INFO._replace(joints=("a", "a", "b"))),
        lambda: fishmj1.encode_info(0, 0.0, INFO._replace(joints=("a", "b", "c" * 17))),
        lambda: fishmj1.encode_info(0, 0.0, INFO._replace(servo_range=0.0)),
    ],
)
def test_what_cannot_be_carried_is_not_sent(call):
    with pytest.raises(ProtocolError):
        call()


@pytest.mark.parametrize("angle", [math.pi, -math.pi])
def test_half_a_turn_can_be_sent_and_read(angle):
    assert fishmj1.decode(fishmj1.encode_command(0, 0.0, (angle,))).value.joint[0] == pytest.approx(angle)


def test_the_error_is_one_that_a_user_can_mend():
    assert issubclass(ProtocolError, FishmjError) and issubclass(ProtocolError, ValueError)


@settings(max_examples=50)
@given(NAME, DIGEST)
def test_names_and_digests_fill_their_places(name, digest):
    info = INFO._replace(firmware=name, firmware_sha256=digest)
    assert fishmj1.decode(fishmj1.encode_info(1, 2.0, info)).value == info
