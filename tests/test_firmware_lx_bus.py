"""The firmware's servo bus: the same frames, and the same ones found in any stream."""

import ctypes
import random

import pytest
from firmware_library import CFrame, CReader, firmware, needs_compiler

from fishmj.deploy.protocols import lx_bus
from fishmj.deploy.protocols.lx_bus import TABLE, Code, LxFrame, LxFrameReader
from fishmj.deploy.protocols.protocol_error import ProtocolError

__all__ = ["firmware"]  # a fixture
pytestmark = needs_compiler


def python_frame(it: CFrame) -> LxFrame:
    return LxFrame(it.servo, Code(it.code), tuple(it.value[: it.count]), it.reply)


def c_bytes(firmware, frame: LxFrame) -> bytes:
    out = (ctypes.c_uint8 * lx_bus.MOST_BYTES)()
    it = CFrame(frame.servo, frame.code, len(frame.values), frame.reply, (ctypes.c_int32 * 3)(*frame.values))
    return bytes(out[: firmware.lx_encode(ctypes.byref(it), out)])


def python_bytes(frame: LxFrame) -> bytes:
    """b"" where the frame cannot be."""
    try:
        return (lx_bus.encode_reply if frame.reply else lx_bus.encode)(frame.servo, frame.code, *frame.values)
    except ProtocolError:
        return b""


def frames(rng: random.Random, count: int) -> list[LxFrame]:
    """Frames of the table, at the ends of their ranges and just beyond as well."""
    found = []
    for _ in range(count):
        code, reply = rng.choice(list(Code)), rng.random() < 0.5
        fields = TABLE[code].replies if reply else TABLE[code].asks
        near = lambda f: rng.choice([f.least, f.most, f.least - 1, f.most + 1, *[rng.randint(f.least, f.most)] * 6])
        found.append(LxFrame(rng.choice([0, 1, 253, 254, 255, rng.randrange(256)]), code, tuple(near(f) for f in fields), reply))
    return found


def test_the_firmware_writes_the_same_frames_and_refuses_the_same_values(firmware):
    sent = [(c_bytes(firmware, frame), python_bytes(frame)) for frame in frames(random.Random(0), 3_000)]
    assert all(ours == theirs for ours, theirs in sent)
    assert sum(bool(data) for data, _ in sent) > 1_000 and sum(not data for data, _ in sent) > 300


def test_it_knows_each_code_and_no_other(firmware):
    for code in range(256):
        for reply in (False, True):
            known = any(int(c) == code and (not reply or TABLE[c].replies) for c in Code)
            out = (ctypes.c_uint8 * lx_bus.MOST_BYTES)()
            sizes = {
                firmware.lx_encode(ctypes.byref(CFrame(1, code, count, reply, (ctypes.c_int32 * 3)(*values))), out)
                for count, values in ((0, ()), (1, (1,)), (1, (60,)), (2, (100, 200)), (2, (5000, 6000)), (3, (0, 0, 0)))
            }
            assert any(sizes) == known, (code, reply)


def streams(rng: random.Random, count: int):
    """Frames, damaged frames and noise behind each other."""
    for _ in range(count):
        parts = []
        for frame in frames(rng, rng.randint(1, 4)):
            data = bytearray(python_bytes(frame))
            if data and rng.random() < 0.5:
                data[rng.randrange(len(data))] = rng.choice([0x55, rng.randrange(256)])
                del data[rng.randint(1, 2 * len(data)) :]
            parts.append(bytes(data) + bytes(rng.choice([0x55, 3, 7, rng.randrange(256)]) for _ in range(rng.randrange(5))))
        yield b"".join(parts)


def disagreements(firmware, seed: int, count: int) -> tuple[int, int]:
    """(streams in which C and Python find other frames, frames found)."""
    rng, differ, total = random.Random(seed), 0, 0
    for stream in streams(rng, count):
        reader, held, frame, found = LxFrameReader(), CReader(), CFrame(), []
        ours = reader.frames(stream)
        for byte in stream:
            if firmware.lx_reader_push(ctypes.byref(held), byte, ctypes.byref(frame)):
                found.append(python_frame(frame))
        late = []
        while firmware.lx_reader_silence(ctypes.byref(held), ctypes.byref(frame)):
            late.append(python_frame(frame))
        answers = [f for f in late if f.reply]
        same = found == ours and answers == reader.silence()
        counts = (held.skipped, held.damaged, held.echoes) == (reader.skipped, reader.damaged, reader.echoes)
        differ += not (same and counts)
        total += len(ours)
    return differ, total


def test_c_and_python_find_the_same_frames_in_2000_streams(firmware):
    differ, total = disagreements(firmware, 1, 2_000)
    assert differ == 0 and total > 1_000


@pytest.mark.slow
def test_c_and_python_find_the_same_frames_in_40000_streams(firmware):
    differ, total = disagreements(firmware, 2, 40_000)
    assert differ == 0 and total > 20_000


def test_one_datagram_of_the_bus_is_read_whole_or_not_at_all(firmware):
    rng = random.Random(3)
    for stream in streams(rng, 500):
        frame = CFrame()
        accepted = firmware.lx_decode(stream, len(stream), ctypes.byref(frame))
        try:
            read = lx_bus.decode(stream)
        except ProtocolError:
            read = None
        assert accepted == (read is not None) and (read is None or python_frame(frame) == read)
