"""The radio between host and robot: time of arrival, copies and bits of each datagram.

    t_arrival = t_sent + max(delay + spread g, 1 ms) + faults,    g a skewed number of zero mean (gamma, shape 2)

Every datagram draws all its random numbers, independent of the active faults: switching one fault on never changes another's
effect.
"""

from collections.abc import Iterable, Sequence
from math import ceil
from typing import NamedTuple

from fishmj.deploy.loopback.faults import FAULTS, RADIO, LoopbackFault
from fishmj.deploy.loopback.loopback_body import MILLISECOND
from fishmj.gap.laboratory import random_streams

DELAY = 0.005  # s, one way over a quiet wireless network: the middle of 2 to 10 ms
SPREAD = 0.0015  # s
HELD = 0.03  # s, one and a half bus ticks: whatever waits so long is overtaken
BLOCK, NUMBERS = 256, 11  # datagrams whose random numbers are drawn at once, and how many each has


class Arrival(NamedTuple):
    """One datagram on its way."""

    t: float  # s, when it arrives; whole milliseconds
    data: bytes


class RadioChannel:
    """One direction of the radio.

    Args:
        direction: "down" (host to robot) or "up". seed: of the random numbers. faults: only those of the radio count.
        delay, spread: s, of a radio without faults; a wire has neither.
    """

    def __init__(
        self, direction: str, seed: int, faults: Iterable[LoopbackFault] = (), delay: float = DELAY, spread: float = SPREAD
    ):
        mine = [fault for fault in faults if FAULTS[fault.name].where == RADIO and fault.direction in ("", direction)]
        self.delay, self.spread, self._faults = delay, spread, mine
        self._base, self._late, self._chance = (
            random_streams.stream(seed, f"{direction} {purpose}") for purpose in ("base", "jitter", "chance")
        )
        self._drawn: list[list[float]] = []

    def send(self, t: float, data: bytes) -> list[Arrival]:
        """Arrivals of a datagram that is sent at t [s]: none, one or two."""
        size = {fault.name: fault.value for fault in self._faults if fault.active(t)}
        base, late = random_streams.jitter(self._base), random_streams.lateness(self._late)
        lost, held, twice, again, *bits = self._draw()
        if "silent_radio" in size or lost < size.get("loss", 0.0):
            return []
        if bits[0] < size.get("corrupt", 0.0):
            data = corrupted(data, bits[1:])
        arrives = (
            t
            + (max(self.delay + self.spread * base, MILLISECOND) if self.delay else 0.0)
            + size.get("delay", 0.0)
            + late * size.get("jitter", 0.0)
        )
        if held < size.get("reorder", 0.0):
            arrives += HELD
        out = [Arrival(_whole(arrives), data)]
        if twice < size.get("duplicate", 0.0):
            out.append(Arrival(_whole(arrives + HELD * again), data))
        return out

    def _draw(self) -> list[float]:
        """Draws the NUMBERS uniform numbers of one datagram, in [0, 1)."""
        if not self._drawn:
            self._drawn = self._chance.random((BLOCK, NUMBERS)).tolist()[::-1]
        return self._drawn.pop()


def corrupted(data: bytes, uniforms: Sequence[float]) -> bytes:
    """The datagram with one to four bits flipped, or, once in four, cut short. uniforms: (6,) in [0, 1)."""
    if not data:
        return data
    kind, many, *places = uniforms
    if kind < 0.25:
        return data[: int(places[0] * len(data))]
    out = bytearray(data)
    for place in {int(share * 8 * len(out)) for share in places[: 1 + int(4 * many)]}:
        out[place // 8] ^= 1 << place % 8
    return bytes(out)


def _whole(t: float) -> float:
    """t rounded up to whole milliseconds."""
    return ceil(t / MILLISECOND - 1e-6) * MILLISECOND
