"""Decides which of the numbered datagrams are new.

    newer  <=>  0 < (seq - last) mod 2^32 < 2^31

Older ones and duplicates are dropped. A sender that restarted counts from the beginning, so its datagrams would be dropped until
the numbers caught up. Its clock shows the restart: during one life of a sender, number and time grow together. So a datagram with
an older number is taken, and becomes the reference for all later ones, if

    its time is newer                              another program on a computer whose clock ran on, or
    its time is older by more than `late` s         no network keeps a datagram so long: the clock began anew, or
    it is one of `patience` dropped ones in a row, each newer than the one before in number and time: the sender
                                                    had run for less than `late` before it restarted.
"""

from dataclasses import dataclass

HALF, WHOLE = 1 << 31, 1 << 32


@dataclass
class SequenceGate:
    """Decides from each datagram's number and time if it is new.

    Attributes:
        late: longest time of a datagram on its way, s. patience: dropped datagrams in a row that count as a restart.
        taken, duplicates, older, missing, restarts: counts. `missing` are the gaps between the taken numbers; one that
            comes late is counted as older, too, since it was missing in its time.
    """

    late: float = 5.0
    patience: int = 10
    taken: int = 0
    duplicates: int = 0
    older: int = 0
    missing: int = 0
    restarts: int = 0
    _last: tuple[int, float] | None = None  # number and time of the newest that was taken
    _dropped: tuple[int, float] | None = None  # of the newest of the dropped ones in a row
    _row: int = 0

    def accept(self, seq: int, time: float) -> bool:
        """Returns True if a datagram is new. seq: 0 to 2^32 - 1. time: s, the sender's clock."""
        if self._last is None:
            return self._take(seq, time)
        last, then = self._last
        if newer(seq, last):
            self.missing += (seq - last) % WHOLE - 1
            return self._take(seq, time)
        if seq == last and time == then:
            self.duplicates += 1
            return False
        rising = self._dropped is None or (newer(seq, self._dropped[0]) and time > self._dropped[1])
        self._row = self._row + 1 if rising else 1
        self._dropped = seq, time
        ago = round((then - time) * 1e6)  # us, as the firmware counts
        if time > then or ago > round(self.late * 1e6) or self._row >= self.patience:
            self.restarts += 1
            return self._take(seq, time)
        self.older += 1
        return False

    def forget(self) -> None:
        """Makes any next datagram new; the counts stay."""
        self._last, self._dropped, self._row = None, None, 0

    def _take(self, seq: int, time: float) -> bool:
        self._last, self._dropped, self._row = (seq, time), None, 0
        self.taken += 1
        return True


def newer(seq: int, last: int) -> bool:
    """Returns True if `seq` comes after `last`, for numbers that wrap at 2^32."""
    return 0 < (seq - last) % WHOLE < HALF
