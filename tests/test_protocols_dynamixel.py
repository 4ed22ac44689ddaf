"""Packets of Dynamixel servos: the maker's published examples, another library's bytes, and a reader of any stream."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fishmj.deploy.protocols.dynamixel import MOST_BYTES, Instruction, Packet, PacketReader, Protocol1, Protocol2, crc16
from fishmj.deploy.protocols.protocol_error import ProtocolError

try:
    import dynamixel_sdk as sdk
except ImportError:
    sdk = None

against_another_library = pytest.mark.skipif(sdk is None, reason="needs the package dynamixel-sdk")
TWO, ONE = Protocol2(), Protocol1()
I = Instruction

# ROBOTIS e-Manual, DYNAMIXEL Protocol 2.0: the examples of each instruction
PUBLISHED_2 = {
    "ff ff fd 00 01 03 00 01 19 4e": Packet(1, I.PING, b""),
    "ff ff fd 00 01 07 00 55 00 06 04 26 65 5d": Packet(1, I.STATUS, bytes((6, 4, 38))),
    "ff ff fd 00 fe 03 00 01 31 42": Packet(254, I.PING, b""),
    "ff ff fd 00 02 07 00 55 00 06 04 26 6f 6d": Packet(2, I.STATUS, bytes((6, 4, 38))),
    "ff ff fd 00 01 07 00 02 84 00 04 00 1d 15": Packet(1, I.READ, bytes((132, 0, 4, 0))),
    "ff ff fd 00 01 08 00 55 00 a6 00 00 00 8c c0": Packet(1, I.STATUS, bytes((166, 0, 0, 0))),
    "ff ff fd 00 01 09 00 03 74 00 00 02 00 00 ca 89": Packet(1, I.WRITE, bytes((116, 0, 0, 2, 0, 0))),
    "ff ff fd 00 01 04 00 55 00 a1 0c": Packet(1, I.STATUS, b""),
    "ff ff fd 00 01 03 00 08 2f 4e": Packet(1, I.REBOOT, b""),
    "ff ff fd 00 fe 09 00 82 84 00 04 00 01 02 ce fa": Packet(254, I.SYNC_READ, bytes((132, 0, 4, 0, 1, 2))),
    "ff ff fd 00 02 08 00 55 00 1f 08 00 00 ba be": Packet(2, I.STATUS, bytes((0x1F, 8, 0, 0))),
    "ff ff fd 00 fe 11 00 83 74 00 04 00 01 96 00 00 00 02 aa 00 00 00 82 87": Packet(
        254, I.SYNC_WRITE, bytes((116, 0, 4, 0, 1, 150, 0, 0, 0, 2, 170, 0, 0, 0))
    ),
}
# the same of protocol 1.0
PUBLISHED_1 = {
    "ff ff 01 04 02 2b 01 cc": Packet(1, I.READ, bytes((43, 1))),
    "ff ff 01 03 00 20 db": Packet(1, I.STATUS, b"\x20"),
    "ff ff 01 02 24 d8": Packet(1, I.STATUS, b"", 0x24),
    "ff ff fe 0e 83 1e 04 00 10 00 50 01 01 20 02 60 03 67": Packet(
        254, I.SYNC_WRITE, bytes((0x1E, 4, 0, 0x10, 0, 0x50, 1, 1, 0x20, 2, 0x60, 3))
    ),
}


@pytest.mark.parametrize(("protocol", "text"), [*((TWO, t) for t in PUBLISHED_2), *((ONE, t) for t in PUBLISHED_1)])
def test_published_packets_are_written_and_read(protocol, text):
    data, packet = bytes.fromhex(text), (PUBLISHED_2 if protocol is TWO else PUBLISHED_1)[text]
    assert protocol.decode(data) == packet
    assert protocol.encode(*packet) == data


def test_reads_and_sync_writes_are_the_published_packets():
    assert TWO.read((1,), 132, 4).hex(" ") == "ff ff fd 00 01 07 00 02 84 00 04 00 1d 15"
    assert TWO.read((1, 2), 132, 4).hex(" ") == "ff ff fd 00 fe 09 00 82 84 00 04 00 01 02 ce fa"
    goals = {1: (150).to_bytes(4, "little"), 2: (170).to_bytes(4, "little")}
    assert TWO.sync_write(116, goals).hex(" ") == next(t for t, p in PUBLISHED_2.items() if p.instruction is I.SYNC_WRITE)
    assert ONE.read((1,), 43, 1).hex(" ") == "ff ff 01 04 02 2b 01 cc"
    values = {0: bytes((0x10, 0, 0x50, 1)), 1: bytes((0x20, 2, 0x60, 3))}
    assert ONE.sync_write(0x1E, values).hex(" ") == next(t for t, p in PUBLISHED_1.items() if p.instruction is I.SYNC_WRITE)


def test_headers_inside_are_stuffed():
    """The parameters FF FF FF FF FD 01: one more FD behind the header inside, counted by length and CRC."""
    packet = TWO.encode(1, I.WRITE, bytes((224, 0)) + bytes.fromhex("ff ff ff ff fd 01"))
    assert packet[7:-2].hex(" ") == "03 e0 00 ff ff ff ff fd fd 01" and packet[5] == 12
    assert TWO.decode(packet).data.hex(" ") == "e0 00 ff ff ff ff fd 01"


DATA = st.lists(st.sampled_from((0xFF, 0xFD, 0x00, 0x55, 7)), max_size=24).map(bytes)


@settings(max_examples=60)
@given(st.integers(0, 252), DATA, st.integers(0, 255), st.sampled_from((TWO, ONE)))
def test_each_status_comes_back(servo, data, error, protocol):
    if protocol is ONE and len(data) == 2:
        data += b"\x00"
    packet = Packet(servo, I.STATUS, data, error)
    assert protocol.decode(protocol.encode(*packet)) == packet


@settings(max_examples=40)
@given(st.lists(st.tuples(DATA, DATA), max_size=6), st.data(), st.sampled_from((TWO, ONE)))
def test_packets_are_found_in_noise_however_the_stream_is_cut(parts, data, protocol):
    clean = lambda noise: bytes(b for b in noise if b != 0xFF)
    sent = [Packet(3, I.STATUS, d + (b"\x00" if len(d) == 2 else b"")) for _, d in parts]
    stream = b"".join(clean(noise) + protocol.encode(*packet) for (noise, _), packet in zip(parts, sent, strict=True))
    reader, found = PacketReader(protocol), []
    while stream:
        count = data.draw(st.integers(1, len(stream)))
        found += reader.feed(stream[:count])
        stream = stream[count:]
    assert found == sent and reader.damaged == 0


def test_a_damaged_packet_is_dropped_and_the_next_is_found():
    rng, good = random.Random(1), TWO.encode(2, I.STATUS, bytes(15))
    for _ in range(2_000):
        bad = bytearray(TWO.encode(1, I.STATUS, rng.randbytes(15)))
        bad[rng.randrange(len(bad))] ^= 1 << rng.randrange(8)
        reader = PacketReader(TWO)
        found = reader.feed(bytes(bad) + good) + reader.silence()
        assert [packet.servo for packet in found] == [2]


def test_echoes_are_no_answers():
    for protocol in (TWO, ONE):
        reader = PacketReader(protocol)
        told = protocol.read((1,), 36, 8) + protocol.sync_write(30, {1: b"\x01\x02", 2: b"\x03\x04"})
        answer = protocol.encode(1, I.STATUS, bytes(8))
        assert reader.feed(told + answer) == [protocol.decode(answer)] and reader.echoes == 2


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: TWO.encode(253, I.PING), "expected 0 to 252"),
        (lambda: TWO.encode(254, I.STATUS), "expected 0 to 252"),
        (lambda: ONE.encode(255, I.READ, b"\x00\x01"), "expected 0 to 253"),
        (lambda: ONE.encode(1, I.STATUS, b"\x00\x01"), "two bytes"),
        (lambda: TWO.encode(1, I.WRITE, bytes(MOST_BYTES)), f"at most {MOST_BYTES}"),
        (lambda: TWO.sync_write(116, {1: b"\x00", 2: b"\x00\x00"}), "the same count"),
        (lambda: TWO.decode(bytes.fromhex("ff ff fd 00 01 03 00 01 19 4f")), "CRC 4f19; expected 4e19"),
        (lambda: TWO.decode(b"\xff\xff\xfd\x00"), "expected ff ff fd 00"),
        (lambda: ONE.decode(bytes.fromhex("ff ff 01 02 24 d9")), "checksum d9; expected d8"),
    ],
)
def test_impossible_packets_are_refused(call, words):
    with pytest.raises(ProtocolError, match=words):
        call()


def test_random_bytes_raise_nothing_but_the_protocols_error():
    rng = random.Random(2)
    for protocol in (TWO, ONE):
        for _ in range(3_000):
            data = (protocol.header if rng.random() < 0.7 else b"") + rng.randbytes(rng.randrange(20))
            try:
                protocol.decode(data)
            except ProtocolError:
                continue


class Port:
    """What the other library needs of a serial port: keeps what is written, reads what is put there."""

    is_using = False

    def __init__(self):
        self.out, self.line = b"", b""

    def clearPort(self): ...
    def setPacketTimeout(self, size): ...
    def setPacketTimeoutMillis(self, size): ...

    def isPacketTimeout(self):
        return not self.line

    def writePort(self, data):
        self.out += bytes(data)
        return len(data)

    def readPort(self, size):
        found, self.line = self.line[:size], self.line[size:]
        return found


def drawn(rng: random.Random, least: int) -> bytes:
    """Bytes without a header: the other library, 4.1.0, forgets the stuffing that it has worked out."""
    while True:
        data = bytes(rng.choice((0xFF, 0xFD, rng.randrange(256))) for _ in range(rng.randrange(least, 20)))
        if b"\xff\xff\xfd" not in data:
            return data


@against_another_library
def test_stuffing_is_that_of_another_library():
    rng = random.Random(5)
    for _ in range(300):
        data = bytes(rng.choice((0xFF, 0xFD)) for _ in range(rng.randrange(1, 20)))
        plain = [*TWO.header, 1, len(data) + 3, 0, I.WRITE, *data, 0, 0]
        assert bytes(sdk.PacketHandler(2.0).addStuffing(plain))[:-2] == TWO.encode(1, I.WRITE, data)[:-2]


@against_another_library
def test_bytes_are_those_of_another_library():
    rng = random.Random(3)
    for version, protocol in ((2.0, TWO), (1.0, ONE)):
        other = sdk.PacketHandler(version)
        for _ in range(300):
            data = drawn(rng, 1)
            servo, address = rng.randrange(253), rng.randrange(200)
            port = Port()
            other.syncWriteTxOnly(port, address, len(data), [servo, *data], len(data) + 1)
            assert port.out == protocol.sync_write(address, {servo: data})
            port = Port()
            other.readTx(port, servo, address, 8)
            assert port.out == protocol.read((servo,), address, 8)
    port = Port()
    sdk.PacketHandler(2.0).syncReadTx(port, 132, 15, [1, 2, 7], 3, False)
    assert port.out == TWO.read((1, 2, 7), 132, 15)
    assert sdk.PacketHandler(2.0).updateCRC(0, list(b"123456789"), 9) == crc16(b"123456789")


@against_another_library
def test_another_library_reads_each_status():
    rng = random.Random(4)
    for version, protocol in ((2.0, TWO), (1.0, ONE)):
        for _ in range(200):
            data = drawn(rng, 3)
            port = Port()
            port.line = protocol.encode(5, I.STATUS, data, 0x01)
            got, result, error = sdk.PacketHandler(version).readRx(port, 5, len(data))
            assert (bytes(got), result, error) == (data, sdk.COMM_SUCCESS, 1)
