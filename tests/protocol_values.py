"""Messages drawn at random, and what noise, a lossy link and a hostile sender make of their bytes."""

import math
import random
import struct
import zlib
from collections.abc import Iterator

from hypothesis import strategies as st

from fishmj.deploy.protocols import fishmj1, mish
from fishmj.deploy.protocols.messages import RobotInfo, RobotState, ServoFault, Telemetry


def f32(value: float) -> float:
    """The nearest number that four bytes hold."""
    return struct.unpack("<f", struct.pack("<f", value))[0]


def floats(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(f32(low), f32(high), width=32)


COUNT = st.integers(1, 8)  # joints
SEQ = st.integers(0, 2**32 - 1)
TIME = st.integers(0, fishmj1.MOST_TIME).map(lambda us: us / 1e6)
ANGLE = floats(-fishmj1.MOST_ANGLE, fishmj1.MOST_ANGLE)
SPEED = st.floats(f32(1e-3), fishmj1.MOST_SPEED, width=32)
NAME = st.from_regex(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,14}", fullmatch=True)
DIGEST = st.one_of(st.just(""), st.binary(min_size=32, max_size=32).filter(any).map(bytes.hex))


@st.composite
def watches(draw) -> tuple[float, float]:
    hold = draw(st.integers(1, 59_999_999))
    return hold / 1e6, draw(st.integers(hold + 1, 60_000_000)) / 1e6


@st.composite
def commands(draw):
    count = draw(COUNT)
    row = lambda each: tuple(draw(st.lists(each, min_size=count, max_size=count)))
    return row(ANGLE), row(SPEED) if draw(st.booleans()) else None


@st.composite
def telemetries(draw) -> Telemetry:
    count = draw(COUNT)
    row = lambda each: tuple(draw(st.lists(each, min_size=count, max_size=count)))
    maybe = lambda value: value if draw(st.booleans()) else None
    echo, power = draw(st.booleans()), draw(st.booleans())
    return Telemetry(
        joint=row(ANGLE),
        seq=draw(SEQ),
        time=draw(TIME),
        echo=draw(SEQ) if echo else None,
        echo_time=draw(TIME) if echo else None,
        state=draw(st.sampled_from(RobotState)),
        voltage=draw(floats(0, fishmj1.MOST_VOLTAGE)) if power else None,
        current=draw(floats(-fishmj1.MOST_CURRENT, fishmj1.MOST_CURRENT)) if power else None,
        servo_voltage=maybe(row(st.integers(0, 65_535).map(lambda mv: mv / 1000))),
        temperature=maybe(row(st.integers(-128, 127).map(float))),
        fault=maybe(row(st.integers(0, 31).map(ServoFault))),
    )


@st.composite
def infos(draw) -> RobotInfo:
    count = draw(st.integers(1, 8))
    hold, neutral = draw(watches())
    return RobotInfo(
        firmware=draw(NAME),
        firmware_sha256=draw(DIGEST),
        servo_ids=tuple(draw(st.lists(st.integers(0, 253), min_size=count, max_size=count, unique=True))),
        joints=tuple(draw(st.lists(NAME, min_size=count, max_size=count, unique=True))),
        servo_range=draw(st.floats(f32(1e-3), fishmj1.MOST_ANGLE, width=32)),
        hold=hold,
        neutral=neutral,
        policy_sha256=draw(DIGEST),
    )


def datagrams(rng: random.Random) -> list[bytes]:
    """Valid datagrams of fishmj-1: each kind, in several sizes."""
    number, angle = lambda: rng.randrange(2**32), lambda: rng.uniform(-3, 3)
    found = [fishmj1.encode_hello(number(), rng.random()), fishmj1.encode_disarm(number(), 5.0)]
    found.append(fishmj1.encode_arm(number(), rng.uniform(0, 1e6), 0.1, rng.uniform(0.2, 1)))
    for count in range(1, 9):
        row = lambda each, count=count: tuple(each() for _ in range(count))
        found.append(fishmj1.encode_command(number(), rng.random(), row(angle)))
        found.append(fishmj1.encode_command(number(), rng.random(), row(angle), row(lambda: rng.uniform(0.1, 6))))
        it = Telemetry(row(angle), number(), rng.uniform(0, 1e4), number(), rng.random(), rng.choice(list(RobotState)))
        more = {"voltage": 7.4, "current": 0.5, "servo_voltage": row(lambda: 7.2), "temperature": row(lambda: 31.0)}
        found += [fishmj1.encode_telemetry(it), fishmj1.encode_telemetry(it._replace(**more, fault=row(lambda: ServoFault.HOT)))]
        names = tuple(f"j{k}" for k in range(1, count + 1))
        info = RobotInfo("reference-0.1.0", rng.randbytes(32).hex(), tuple(range(1, count + 1)), names, 1.0, 0.1, 0.3)
        found.append(fishmj1.encode_info(number(), rng.random(), info))
    return found


def mish_datagrams(rng: random.Random) -> list[bytes]:
    """Valid datagrams of the open robot, both ways."""
    row = lambda most: tuple(rng.uniform(-most, most) for _ in range(3))
    up = Telemetry(row(1.0), servo_voltage=(7.4, 7.3, 7.2), temperature=(25.0, 26.0, 27.0))
    return [mish.encode_command(row(1.0)), mish.encode_command(row(1.0), (1.0, 0.0, 3.0)), mish.encode_telemetry(up, (1, 2, 3))]


def damaged(rng: random.Random, valid: list[bytes]) -> bytes:
    """One frame after a random misfortune, of nine sorts."""
    data = bytearray(rng.choice(valid))
    sort = rng.randrange(9)
    if sort == 0:
        return rng.randbytes(rng.randrange(300))
    if sort == 1:  # bits
        for _ in range(rng.randint(1, 8)):
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    elif sort == 2:  # bytes
        for _ in range(rng.randint(1, 4)):
            data[rng.randrange(len(data))] = rng.randrange(256)
    elif sort == 3:
        del data[rng.randrange(len(data)) :]
    elif sort == 4:
        data += rng.randbytes(rng.randint(1, 20))
    elif sort == 5:  # two bytes change places
        i, j = rng.randrange(len(data)), rng.randrange(len(data))
        data[i], data[j] = data[j], data[i]
    elif sort == 6:  # a burst
        at = rng.randrange(len(data))
        data[at : at + rng.randint(1, 16)] = rng.randbytes(rng.randint(1, 16))
    elif sort == 7:  # two frames in one
        other = rng.choice(valid)
        data = bytearray(data[: rng.randrange(len(data) + 1)] + other[rng.randrange(len(other)) :])
    else:  # a number that is none
        at = rng.randrange(max(1, len(data) - 4))
        data[at : at + 4] = struct.pack("<f", rng.choice([math.nan, math.inf, -math.inf, 1e30, -0.0]))
    return bytes(data)


def resealed(data: bytes) -> bytes:
    """A datagram of fishmj-1 with the length and the checksum that fit it: what a hostile sender writes."""
    if len(data) < 24:
        return data
    body = bytearray(data[:-4])
    body[6:8] = struct.pack("<H", len(body) - 20)
    return bytes(body) + struct.pack("<I", zlib.crc32(body))


def fuzzed(seed: int, count: int, valid: list[bytes]) -> Iterator[tuple[bytes, bool]]:
    """`count` damaged datagrams of fishmj-1, each third one with a checksum that fits; whether it was given one."""
    rng = random.Random(seed)
    for number in range(count):
        data, sealed = damaged(rng, valid), number % 3 == 0
        yield (resealed(data) if sealed else data), sealed
