"""Finds the frames of a servo bus in a byte stream: after noise, damaged or truncated frames, and among echoes."""

from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from fishmj.deploy.protocols.protocol_error import ProtocolError


class BusFrame(Protocol):
    """A frame of any servo bus. reply: a servo sent it."""

    @property
    def reply(self) -> bool:
        """Returns True if a servo sent it."""


F = TypeVar("F", bound=BusFrame)


class FrameReader(Generic[F]):
    """Finds frames in a byte stream: after noise, damaged or truncated frames, and among echoes of the host's own frames.

    If the bytes form no frame, only one byte is dropped, not the length that they claim: a frame that begins inside a
    damaged one is found.

    Args:
        size: length of the frame that may begin at a place of a buffer; 0: none can; None: too few bytes to decide, or to have
            all of it. decode: the frame of such bytes; raises ProtocolError.

    Attributes:
        skipped: bytes outside any frame. damaged: of these, starts of possible frames with a wrong checksum or
            wrong values. echoes: received frames of the host itself.
    """

    def __init__(self, size: Callable[[bytearray, int], int | None], decode: Callable[[bytes], F]):
        self._size, self._decode = size, decode
        self._waiting = bytearray()
        self.skipped = self.damaged = self.echoes = 0

    def __len__(self) -> int:
        """Number of bytes that wait for the rest of their frame."""
        return len(self._waiting)

    def feed(self, data: bytes) -> list[F]:
        """The servos' answers that these bytes complete, in order; echoes are counted and left out."""
        return [frame for frame in self.frames(data) if frame.reply]

    def frames(self, data: bytes) -> list[F]:
        """All frames that these bytes complete, the host's own as well."""
        buffer, found, at = self._waiting + data, [], 0
        while at < len(buffer):
            size = self._size(buffer, at)
            if size is None:  # waits for more
                break
            frame = self._frame(bytes(buffer[at : at + size])) if size else None
            if frame is None:
                self.skipped += 1
                at += 1
                continue
            self.echoes += not frame.reply
            found.append(frame)
            at += size
        self._waiting = buffer[at:]
        return found

    def silence(self) -> list[F]:
        """Handles silence on the line: the waiting bytes are truncated.

        Returns the answers that begin inside them, usually none.
        """
        found: list[F] = []
        while self._waiting:
            del self._waiting[0]
            self.skipped += 1
            found += self.feed(b"")
        return found

    def _frame(self, data: bytes) -> F | None:
        try:
            return self._decode(data)
        except ProtocolError:
            self.damaged += 1
            return None
