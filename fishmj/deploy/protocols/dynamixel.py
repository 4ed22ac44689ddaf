"""Packets of Dynamixel servos: half-duplex UART, 8N1. Protocol 2.0 (X series) and protocol 1.0 (AX series).

    2.0   FF FF FD 00 | id | length u16 | instruction | parameters | CRC-16 u16     length = 3 + parameters
    1.0   FF FF       | id | length u8  | instruction | parameters | checksum u8    length = 2 + parameters

Numbers are little-endian. A servo answers with a status packet: in 2.0 instruction 0x55 and an error byte before the data, in 1.0
the error byte in the place of the instruction. Source: ROBOTIS e-Manual, "DYNAMIXEL Protocol 2.0", "DYNAMIXEL Protocol 1.0".

    CRC-16 of 2.0: polynomial 0x8005, start 0, most significant bit first, over all bytes before it
    checksum of 1.0: ~(id + length + instruction + sum of parameters) mod 256

In 2.0 a header inside instruction and parameters gets one more FD ("byte stuffing"); length and CRC count it. In 1.0 a status
looks like an instruction. The host sends only READ to single servos and SYNC_WRITE to all, and never reads two bytes. So a
packet of one servo with another length than READ is a status.
"""

import struct
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import NamedTuple

from fishmj.deploy.protocols.frame_reader import FrameReader
from fishmj.deploy.protocols.protocol_error import ProtocolError

BROADCAST = 254
MOST_BYTES = 160  # of a packet: SYNC_WRITE of eleven joints has 69


class Instruction(IntEnum):
    """Instructions of packets."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REBOOT = 0x08
    STATUS = 0x55
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83


class Packet(NamedTuple):
    """A parsed packet. error: of a status, bits as in each protocol, else 0. data: the parameters, without stuffing."""

    servo: int
    instruction: Instruction
    data: bytes
    error: int = 0

    @property
    def reply(self) -> bool:
        """Returns True if a servo sent it."""
        return self.instruction is Instruction.STATUS


def _crc_of(byte: int) -> int:
    value = byte << 8
    for _ in range(8):
        value = (value << 1 ^ 0x8005 if value & 0x8000 else value << 1) & 0xFFFF
    return value


_CRC = tuple(_crc_of(byte) for byte in range(256))


def crc16(data: bytes) -> int:
    """CRC-16 of protocol 2.0."""
    crc = 0
    for byte in data:
        crc = (crc << 8 & 0xFF00) ^ _CRC[(crc >> 8 ^ byte) & 0xFF]
    return crc


class _Framing(ABC):
    """Header, length, and the address and count (`span`) of packets.

    known: bytes after which the length of the rest is known. least: bytes of a packet.
    """

    header: bytes
    known: int
    least: int
    span: struct.Struct

    @abstractmethod
    def encode(self, servo: int, instruction: Instruction, data: bytes = b"", error: int = 0) -> bytes:
        """A packet; error: of STATUS only. Raises ProtocolError: an impossible id or length."""

    def sync_write(self, address: int, values: Mapping[int, bytes]) -> bytes:
        """Packet that writes an equal number of bytes to each servo, without answers."""
        listed = b"".join(bytes((servo,)) + data for servo, data in values.items())
        return self.encode(BROADCAST, Instruction.SYNC_WRITE, self.span.pack(address, _count(values)) + listed)

    def span_of(self, packet: Packet) -> tuple[int, int]:
        """(address, count) of a READ, SYNC_READ or SYNC_WRITE. Raises ProtocolError."""
        if len(packet.data) < self.span.size:
            raise ProtocolError(f"{packet.instruction.name} without address and count")
        address, count = self.span.unpack_from(packet.data)
        return address, count

    def listed(self, packet: Packet) -> bytes:
        """Parameters behind address and count."""
        return packet.data[self.span.size :]

    def size(self, buffer: bytearray, at: int) -> int | None:
        """Length of the packet that may begin at `at`; see `FrameReader`."""
        there, servo = len(buffer) - at, at + len(self.header)
        head = bytes(buffer[at:servo])
        if head != self.header[: len(head)] or servo < len(buffer) and buffer[servo] > BROADCAST:
            return 0
        if there < self.known:
            return None
        size = self.known + int.from_bytes(buffer[servo + 1 : at + self.known], "little")
        if not self.least <= size <= MOST_BYTES:
            return 0
        return size if there >= size else None


class Protocol2(_Framing):
    """Packets of protocol 2.0."""

    header, most_id, known, least, span = b"\xff\xff\xfd\x00", 252, 7, 10, struct.Struct("<HH")

    def encode(self, servo: int, instruction: Instruction, data: bytes = b"", error: int = 0) -> bytes:
        """A packet; error: of STATUS only. Raises ProtocolError: an impossible id or length."""
        _checked_id(servo, self.most_id, instruction)
        body = bytes((instruction, *((error,) if instruction is Instruction.STATUS else ()))) + data
        body = body.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
        packet = self.header + struct.pack("<BH", servo, len(body) + 2) + body
        _checked_size(len(packet) + 2)
        return packet + struct.pack("<H", crc16(packet))

    def decode(self, packet: bytes) -> Packet:
        """The packet in `packet`, which must be exactly one. Raises ProtocolError for any other bytes, and no other error."""
        if self.size(bytearray(packet), 0) != len(packet):
            raise ProtocolError(f"{packet[:16].hex(' ')}; expected ff ff fd 00, id, length, instruction, parameters, CRC")
        (crc,) = struct.unpack("<H", packet[-2:])
        if crc != crc16(packet[:-2]):
            raise ProtocolError(f"CRC {crc:04x}; expected {crc16(packet[:-2]):04x}: the packet is damaged")
        body = packet[7:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
        instruction = _instruction(body[0])
        reply = instruction is Instruction.STATUS
        if reply and len(body) < 2:
            raise ProtocolError("a status packet without an error byte")
        return Packet(packet[4], instruction, body[1 + reply :], body[1] if reply else 0)

    def read(self, servos: Sequence[int], address: int, count: int) -> bytes:
        """READ of one servo, SYNC_READ of several: `count` bytes from `address`."""
        span = self.span.pack(address, count)
        if len(servos) == 1:
            return self.encode(servos[0], Instruction.READ, span)
        return self.encode(BROADCAST, Instruction.SYNC_READ, span + bytes(servos))


class Protocol1(_Framing):
    """Packets of protocol 1.0."""

    header, most_id, known, least, span = b"\xff\xff", 253, 4, 6, struct.Struct("<BB")

    def encode(self, servo: int, instruction: Instruction, data: bytes = b"", error: int = 0) -> bytes:
        """Packet, as of `Protocol2.encode`."""
        _checked_id(servo, self.most_id, instruction)
        if instruction is Instruction.STATUS and len(data) == 2:
            raise ProtocolError("a status of two bytes; expected another count, or it cannot be told from READ")
        what = error if instruction is Instruction.STATUS else instruction
        body = bytes((servo, len(data) + 2, what)) + data
        _checked_size(len(body) + 3)
        return self.header + body + bytes((~sum(body) & 0xFF,))

    def decode(self, packet: bytes) -> Packet:
        """The packet in `packet`, as of `Protocol2.decode`."""
        if self.size(bytearray(packet), 0) != len(packet):
            raise ProtocolError(f"{packet[:16].hex(' ')}; expected ff ff, id, length, instruction, parameters, checksum")
        if packet[-1] != ~sum(packet[2:-1]) & 0xFF:
            raise ProtocolError(f"checksum {packet[-1]:02x}; expected {~sum(packet[2:-1]) & 0xFF:02x}: the packet is damaged")
        servo, length, what, data = packet[2], packet[3], packet[4], packet[5:-1]
        if servo == BROADCAST or length == 4:
            return Packet(servo, _instruction(what), data)
        return Packet(servo, Instruction.STATUS, data, what)

    def read(self, servos: Sequence[int], address: int, count: int) -> bytes:
        """READ of one servo: `count` bytes from `address`, not two."""
        return self.encode(servos[0], Instruction.READ, self.span.pack(address, count))


class PacketReader(FrameReader[Packet]):
    """Finds packets in a byte stream; see `FrameReader`."""

    def __init__(self, protocol: Protocol1 | Protocol2):
        super().__init__(protocol.size, protocol.decode)


def _count(values: Mapping[int, bytes]) -> int:
    counts = {len(data) for data in values.values()}
    if len(counts) != 1:
        raise ProtocolError(f"SYNC_WRITE of {sorted(counts)} bytes; expected the same count for each servo")
    return counts.pop()


def _instruction(value: int) -> Instruction:
    try:
        return Instruction(value)
    except ValueError:
        raise ProtocolError(f"instruction {value:#04x}; expected one of {', '.join(i.name for i in Instruction)}") from None


def _checked_id(servo: int, most: int, instruction: Instruction) -> None:
    if not (0 <= servo <= most or servo == BROADCAST and instruction is not Instruction.STATUS):
        raise ProtocolError(f"{instruction.name} with servo id {servo}; expected 0 to {most}")


def _checked_size(size: int) -> None:
    if size > MOST_BYTES:
        raise ProtocolError(f"a packet of {size} bytes; expected at most {MOST_BYTES}")
