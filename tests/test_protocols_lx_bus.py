"""Frames of the servo bus: the same bytes and values as another library, and a reader that finds them in any stream."""

import random
import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fishmj.deploy.protocols import lx_bus
from fishmj.deploy.protocols.lx_bus import TABLE, Code, LxFrame, LxFrameReader, decode, encode, encode_reply
from fishmj.deploy.protocols.protocol_error import ProtocolError
from fishmj.mjcf.servo_buses import BUSES

try:
    import lewansoul_lx16a as lewansoul
except ImportError:
    lewansoul = None

against_another_library = pytest.mark.skipif(lewansoul is None, reason="needs the extra dev: pip install 'fishmj[dev]'")


class FakeSerial:
    """A line: keeps what is written, and holds what will be read."""

    def __init__(self, answer: bytes = b""):
        self.written, self.answer, self.timeout = b"", answer, None

    def write(self, data) -> None:
        self.written += bytes(data)

    def read(self, size: int = 1) -> bytes:
        taken, self.answer = self.answer[:size], self.answer[size:]
        return taken


def written(call: Callable) -> bytes:
    """What the other library writes."""
    line = FakeSerial()
    call(lewansoul.ServoController(line))
    return line.written


def asked(call: Callable, answer: bytes) -> tuple:
    """(what the other library writes for a question, what it reads from the answer)."""
    line = FakeSerial(answer)
    value = call(lewansoul.ServoController(line, timeout=1))
    return line.written, value


def values_of(code: Code, reply: bool) -> st.SearchStrategy[tuple[int, ...]]:
    fields = TABLE[code].replies if reply else TABLE[code].asks
    drawn = st.tuples(*(st.integers(field.least, field.most) for field in fields))
    ordered = "LIMIT" in code.name and len(fields) == 2
    return drawn.filter(lambda v: v[0] < v[1]) if ordered else drawn


FRAMES = st.sampled_from(
    [(code, reply) for code, row in TABLE.items() for reply in (False, True) if not reply or row.replies]
).flatmap(lambda kind: st.builds(LxFrame, st.integers(0, 253), st.just(kind[0]), values_of(*kind), st.just(kind[1])))


def bytes_of(frame: LxFrame) -> bytes:
    return (encode_reply if frame.reply else encode)(frame.servo, frame.code, *frame.values)


ID, ANGLE, TIME, MV = st.integers(0, 253), st.integers(0, 1000), st.integers(0, 30_000), st.integers(4500, 12_000)
OFFSET, SPEED, DEGREES = st.integers(-125, 125), st.integers(-1000, 1000), st.integers(50, 100)


@against_another_library
@given(ID, ANGLE, TIME, st.tuples(ANGLE, ANGLE), st.tuples(MV, MV), OFFSET, SPEED, st.tuples(DEGREES, ID, st.integers(0, 7)))
def test_each_write_has_the_bytes_of_another_library(servo, angle, time, angles, volts, offset, speed, rest):
    (low, high), (least, most), (degrees, new, faults) = sorted(angles), sorted(volts), rest
    high, most = (high, most) if low < high and least < most else (low + 1, least + 1)
    low, high, least, most = min(low, 999), min(high, 1000), min(least, 11_999), min(most, 12_000)
    pairs = {
        Code.MOVE_TIME_WRITE: (encode(servo, Code.MOVE_TIME_WRITE, angle, time), lambda c: c.move(servo, angle, time)),
        Code.MOVE_TIME_WAIT_WRITE: (
            encode(servo, Code.MOVE_TIME_WAIT_WRITE, angle, time),
            lambda c: c.move_prepare(servo, angle, time),
        ),
        Code.MOVE_START: (encode(254, Code.MOVE_START), lambda c: c.move_start()),
        Code.MOVE_STOP: (encode(servo, Code.MOVE_STOP), lambda c: c.move_stop(servo)),
        Code.ID_WRITE: (encode(servo, Code.ID_WRITE, new), lambda c: c.set_servo_id(servo, new)),
        Code.ANGLE_OFFSET_ADJUST: (
            encode(servo, Code.ANGLE_OFFSET_ADJUST, offset),
            lambda c: c.set_position_offset(servo, offset),
        ),
        Code.ANGLE_OFFSET_WRITE: (encode(servo, Code.ANGLE_OFFSET_WRITE), lambda c: c.save_position_offset(servo)),
        Code.ANGLE_LIMIT_WRITE: (
            encode(servo, Code.ANGLE_LIMIT_WRITE, low, high),
            lambda c: c.set_position_limits(servo, low, high),
        ),
        Code.VIN_LIMIT_WRITE: (
            encode(servo, Code.VIN_LIMIT_WRITE, least, most),
            lambda c: c.set_voltage_limits(servo, least, most),
        ),
        Code.TEMP_MAX_LIMIT_WRITE: (
            encode(servo, Code.TEMP_MAX_LIMIT_WRITE, degrees),
            lambda c: c.set_max_temperature_limit(servo, degrees),
        ),
        Code.LED_ERROR_WRITE: (encode(servo, Code.LED_ERROR_WRITE, faults), lambda c: c.set_led_errors(servo, faults)),
    }
    others = [
        (encode(servo, Code.OR_MOTOR_MODE_WRITE, 1, 0, speed), lambda c: c.set_motor_mode(servo, speed)),
        (encode(servo, Code.OR_MOTOR_MODE_WRITE, 0, 0, 0), lambda c: c.set_servo_mode(servo)),
        (encode(servo, Code.LOAD_OR_UNLOAD_WRITE, 1), lambda c: c.motor_on(servo)),
        (encode(servo, Code.LOAD_OR_UNLOAD_WRITE, 0), lambda c: c.motor_off(servo)),
        (encode(servo, Code.LED_CTRL_WRITE, 0), lambda c: c.led_on(servo)),
        (encode(servo, Code.LED_CTRL_WRITE, 1), lambda c: c.led_off(servo)),
    ]
    for ours, call in [*pairs.values(), *others]:
        assert ours == written(call), ours.hex(" ")
    covered = {*pairs, Code.OR_MOTOR_MODE_WRITE, Code.LOAD_OR_UNLOAD_WRITE, Code.LED_CTRL_WRITE}
    assert covered == {code for code in Code if not code.name.endswith("_READ")}


READS: dict[Code, tuple[Callable, Callable]] = {  # code -> (question of the other library, what it makes of our values)
    Code.MOVE_TIME_WAIT_READ: (lambda c, i: c.get_prepared_move(i), lambda v: v),
    Code.ID_READ: (lambda c, i: c.get_servo_id(i), lambda v: v[0]),
    Code.ANGLE_OFFSET_READ: (lambda c, i: c.get_position_offset(i), lambda v: v[0]),
    Code.ANGLE_LIMIT_READ: (lambda c, i: c.get_position_limits(i), lambda v: v),
    Code.VIN_LIMIT_READ: (lambda c, i: c.get_voltage_limits(i), lambda v: v),
    Code.TEMP_MAX_LIMIT_READ: (lambda c, i: c.get_max_temperature_limit(i), lambda v: v[0]),
    Code.TEMP_READ: (lambda c, i: c.get_temperature(i), lambda v: v[0]),
    Code.VIN_READ: (lambda c, i: c.get_voltage(i), lambda v: v[0]),
    Code.POS_READ: (lambda c, i: c.get_position(i), lambda v: v[0]),
    Code.OR_MOTOR_MODE_READ: (lambda c, i: c.get_motor_speed(i), lambda v: v[2] if v[0] else 0),
    Code.LOAD_OR_UNLOAD_READ: (lambda c, i: c.is_motor_on(i), lambda v: v[0] == 1),
    Code.LED_CTRL_READ: (lambda c, i: c.is_led_on(i), lambda v: v[0] == 0),
    Code.LED_ERROR_READ: (lambda c, i: c.get_led_errors(i), lambda v: v[0]),
}
UNKNOWN_TO_IT = {Code.MOVE_TIME_READ}  # the other library has no call for it; its frame is that of MOVE_TIME_WAIT_READ


def test_each_read_is_compared():
    assert set(READS) | UNKNOWN_TO_IT == {code for code in Code if code.name.endswith("_READ")}


@against_another_library
@pytest.mark.parametrize("code", READS, ids=lambda code: code.name)
def test_another_library_reads_our_answers(code):
    @settings(max_examples=40)
    @given(ID, values_of(code, True))
    def check(servo, values):
        call, made = READS[code]
        answer = encode_reply(servo, code, *values)
        question, value = asked(lambda c: call(c, servo), answer)
        assert question == encode(servo, code)
        assert value == made(values)
        assert decode(answer) == LxFrame(servo, code, values, True)

    check()


@given(FRAMES)
def test_each_frame_comes_back(frame):
    assert decode(bytes_of(frame)) == frame
    assert len(bytes_of(frame)) <= lx_bus.MOST_BYTES


def test_a_known_frame():
    """The maker's example: servo 1 to position 500 in 1000 ms."""
    assert encode(1, Code.MOVE_TIME_WRITE, 500, 1000).hex(" ") == "55 55 01 07 01 f4 01 e8 03 16"


def test_a_move_frame_takes_less_than_a_millisecond():
    assert len(encode(1, Code.MOVE_TIME_WRITE, 500, 20)) * 10 / BUSES["lx"].baud == pytest.approx(0.87e-3, abs=0.01e-3)


@pytest.mark.parametrize(
    ("servo", "code", "values", "words"),
    [
        (255, Code.MOVE_STOP, (), "expected 0 to 254"),
        (1, Code.MOVE_TIME_WRITE, (1001, 0), "position 1001; expected 0 to 1000"),
        (1, Code.MOVE_TIME_WRITE, (500, 30_001), "time_ms 30001"),
        (1, Code.MOVE_TIME_WRITE, (500,), "expected position, time_ms"),
        (1, Code.POS_READ, (500,), "expected none"),
        (1, Code.ANGLE_OFFSET_ADJUST, (126,), "offset 126; expected -125 to 125"),
        (1, Code.ANGLE_LIMIT_WRITE, (500, 500), "lower one first"),
        (1, Code.VIN_LIMIT_WRITE, (4499, 9000), "lowest_mv 4499"),
        (1, Code.ID_WRITE, (254,), "expected 0 to 253"),
    ],
)
def test_values_out_of_the_table_are_not_sent(servo, code, values, words):
    with pytest.raises(ProtocolError, match=words):
        encode(servo, code, *values)


def test_a_servo_answers_questions_only_and_with_its_own_id():
    with pytest.raises(ProtocolError, match="servos answer none"):
        encode_reply(1, Code.MOVE_STOP)
    with pytest.raises(ProtocolError, match="expected 0 to 253"):
        encode_reply(254, Code.POS_READ, 500)


@settings(max_examples=40)
@given(st.lists(FRAMES, max_size=6), st.data())
def test_a_stream_gives_its_frames_however_it_is_cut(frames, data):
    stream, reader, found = b"".join(bytes_of(f) for f in frames), LxFrameReader(), []
    while stream:
        count = data.draw(st.integers(1, len(stream)))
        found += reader.frames(stream[:count])
        stream = stream[count:]
    assert found == frames and len(reader) == reader.skipped == reader.damaged == 0
    assert reader.echoes == sum(not f.reply for f in frames)


NOISE = st.binary(max_size=12).filter(lambda b: 0x55 not in b)


@settings(max_examples=50)
@given(st.lists(st.tuples(NOISE, FRAMES), max_size=6))
def test_frames_are_found_after_noise(parts):
    reader = LxFrameReader()
    assert reader.frames(b"".join(noise + bytes_of(f) for noise, f in parts)) == [f for _, f in parts]
    assert reader.skipped == sum(len(noise) for noise, _ in parts)


def test_the_hosts_own_frames_are_no_answers():
    reader = LxFrameReader()
    question, answer = encode(3, Code.POS_READ), encode_reply(3, Code.POS_READ, -4)
    assert reader.feed(question + answer) == [LxFrame(3, Code.POS_READ, (-4,), True)] and reader.echoes == 1


@pytest.mark.parametrize("cut", range(1, 8))
def test_a_truncated_answer_does_not_swallow_the_next(cut):
    answer, reader = encode_reply(3, Code.POS_READ, 500), LxFrameReader()
    assert reader.feed(answer[:cut]) == []
    assert reader.feed(answer + answer)[-1:] == [decode(answer)]
    assert reader.silence() == [] and len(reader) == 0


def test_silence_ends_a_truncated_frame():
    answer, reader = encode_reply(3, Code.POS_READ, 500), LxFrameReader()
    assert reader.feed(answer[:7]) == [] and len(reader) == 7
    assert reader.silence() == [] and reader.skipped == 7
    assert reader.feed(answer) == [decode(answer)]


def test_a_frame_inside_a_damaged_one_is_found():
    """The header and length of a frame whose rest was lost claim the bytes of the next."""
    begun, answer = encode(1, Code.MOVE_TIME_WRITE, 500, 1000)[:5], encode_reply(2, Code.VIN_READ, 7400)
    reader = LxFrameReader()
    assert reader.feed(begun + answer + answer) == [decode(answer)] * 2 and reader.damaged == 1


def test_the_reader_keeps_nine_bytes_at_most():
    reader, rng = LxFrameReader(), random.Random(0)
    for _ in range(2_000):
        reader.frames(bytes(rng.choice([0x55, 1, 3, 7, rng.randrange(256)]) for _ in range(rng.randint(1, 30))))
        assert len(reader) < lx_bus.MOST_BYTES


def all_frames(rng: random.Random) -> list[bytes]:
    """A frame of each code and direction."""
    found = []
    for code, row in TABLE.items():
        for reply, fields in ((False, row.asks), (True, row.replies)):
            if reply and not fields:
                continue
            values = [rng.randint(field.least, field.most) for field in fields]
            values = sorted(values) if "LIMIT" in code.name and len(values) == 2 else values
            if len(set(values)) == len(values) or "LIMIT" not in code.name:
                found.append(bytes_of(LxFrame(rng.randint(0, 253), code, tuple(values), reply)))
    return found


def spoiled(rng: random.Random, frame: bytes, sort: str) -> bytes:
    """One frame with one misfortune."""
    data = bytearray(frame)
    if sort == "one bit":
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    elif sort == "one byte":
        at = rng.randrange(len(data))
        data[at] = (data[at] + rng.randint(1, 255)) % 256
    elif sort == "several bytes":
        for _ in range(rng.randint(2, 5)):
            data[rng.randrange(len(data))] = rng.randrange(256)
    elif sort == "two bytes change places":
        i, j = rng.sample(range(len(data)), 2)
        data[i], data[j] = data[j], data[i]
    elif sort == "a byte lost":
        del data[rng.randrange(len(data))]
    else:
        return rng.randbytes(rng.randint(1, 20))
    return bytes(data)


SORTS = ("one bit", "one byte", "several bytes", "two bytes change places", "a byte lost", "noise")


class Tally(NamedTuple):
    """What became of spoiled frames of one sort, each followed by a sound one."""

    spoiled: int = 0
    through: int = 0  # a frame came out that was never sent: eight bits fitted by chance
    believed: int = 0  # of these, with the id and code of the spoiled one: whoever waits for it takes it
    lost: int = 0  # the sound frame behind did not come out
    wrong: int = 0  # what came out is not of the table, or its bytes with their checksum are not in the stream


def fuzz(seed: int, count: int) -> dict[str, Tally]:
    rng, tally = random.Random(seed), dict.fromkeys(SORTS, Tally())
    valid = all_frames(rng)
    for number in range(count):
        sort, sent, sound, reader = SORTS[number % len(SORTS)], rng.choice(valid), rng.choice(valid), LxFrameReader()
        data = spoiled(rng, sent, sort)
        if data == sent:
            continue
        found = reader.frames(data + sound) + reader.silence()
        made = [frame for frame in found if bytes_of(frame) not in (sent, sound)]
        believed = [frame for frame in made if (frame.servo, frame.code) == decode(sent)[:2]]
        wrong = any(bytes_of(frame) not in data + sound for frame in found)
        news = (1, bool(made), bool(believed), decode(sound) not in found, wrong)
        tally[sort] = Tally(*(a + b for a, b in zip(tally[sort], news, strict=True)))
    return tally


def test_of_5000_spoiled_frames_none_is_read_wrongly():
    tally = fuzz(1, 5_000)
    assert all(row.spoiled > 700 and row.wrong == 0 for row in tally.values())
    assert tally["one bit"].through == tally["one byte"].through == 0  # a sum finds any change of one byte
    assert tally["two bytes change places"].through > 0  # and does not find this


@pytest.mark.slow
def test_checksum_misses_in_100000_damaged_frames_match_the_firmware_notes():
    page = (Path(__file__).resolve().parent.parent / "firmware" / "NOTES.md").read_text(encoding="utf-8")
    told = re.findall(r"^\| ([\w ]+) \| ([\d,]+) \| ([\d,]+) \| ([\d,]+) \|$", page, flags=re.MULTILINE)
    tally = fuzz(2, 100_000)
    assert all(row.wrong == row.lost == 0 for row in tally.values())
    assert [tuple(int(n.replace(",", "")) for n in row[1:]) for row in told] == [row[:3] for row in tally.values()]
