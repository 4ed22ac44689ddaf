"""Tests that innovations are still those of the healthy robot: scores of blocks, and a CUSUM for each of them.

    r = e - phi W                          innovation less the part that the healthy reference explains by the probes phi (n, P)
    s_p = sum phi_p r / sqrt(sum phi_p^2 + c_p)   score of a block of n ticks: grows when the coefficient of probe p moves
    s_size = log rms r                     grows when anything makes the innovations larger
    z = normal quantile of the rank of s among the reference's blocks, over the deviation of its long run
    g = max(0, g + clip(+-z) - k)          Page 1954, doi 10.1093/biomet/41.1-2.100; one for each sign; alarm at g >= h

Ranks are used because a healthy robot has rare moments (a sharp turn to a new target) that are far from normal: an event as
frequent in the reference causes no alarm, however large. Beyond the reference's own range z continues in a straight line, for the
naming of the channel only: for the alarm itself z is clipped.

The mean run between false alarms of one CUSUM of independent normal z (Siegmund 1985, Sequential Analysis, section 2.6):

    ARL = (exp(2 k b) - 2 k b - 1) / (2 k^2),   b = h + 1.166

h is chosen so that all CUSUMs together have the requested rate of alarms, if their false alarms add up in the worst case;
clipping only makes them rarer. The mean of N blocks of reference is itself wrong by about 1 / sqrt(N) deviations; a drift of that
size would alarm for ever, so k allows for it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import exp, log
from statistics import NormalDist

import numpy as np

from fishmj.base.errors import ConfigError

OVERSHOOT = 1.166  # deviations, mean excess of a normal walk over a barrier, both ends
DRIFT = 0.5  # deviations: shifts of twice that are found soonest
UNSURE = 3.0  # standard errors of the reference's mean that are never taken for a shift
CLIP = 2.0  # deviations: a sharp turn of a few blocks, or a hand in the water, cannot alarm; what lasts ten blocks can
LAGS = 8  # blocks over which scores are taken to be correlated
RIDGE = 1e-3  # of the probes' own power
FLOOR = 0.1  # c_p, as a share of a block's mean power of the probe
BLOCK = 2.0  # s of one block: about two beats
LEAST_BLOCKS = 40  # of a reference
SIZE = "size"

Block = Mapping[str, tuple[np.ndarray, np.ndarray]]  # channel -> (e (n,), phi (n, P))


def run_length(h: float, k: float = DRIFT) -> float:
    """Mean number of blocks until one CUSUM of independent standard normal z exceeds h without any shift."""
    b = h + OVERSHOOT
    return (exp(2 * k * b) - 2 * k * b - 1) / (2 * k * k)


def threshold(blocks: float, k: float = DRIFT) -> float:
    """h at which `run_length` is `blocks`. Raises ConfigError: fewer blocks than a CUSUM needs without any shift."""
    if blocks < run_length(0.0, k):
        raise ConfigError(
            f"monitor: {blocks:.3g} blocks between false alarms of one test; expected at least {run_length(0.0, k):.0f}"
        )
    low, high = 0.0, log(blocks * 2 * k * k + 2.0) / k + 2.0
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if run_length(middle, k) < blocks else (low, middle)
    return 0.5 * (low + high)


def long_run_deviation(values: np.ndarray, lags: int = LAGS) -> float:
    """Square root of n times the variance of the mean of n correlated values (n,), by Bartlett's window.

    It is at least the standard deviation of the values.
    """
    x = values - values.mean()
    n, lags = len(x), min(lags, len(x) // 10)
    variance = float(x @ x) / n
    long = variance + 2.0 * sum((1.0 - l / (lags + 1)) * float(x[l:] @ x[:-l]) / n for l in range(1, lags + 1))
    return float(np.sqrt(max(long, variance)))


@dataclass(frozen=True)
class ChannelStatistics:
    """Reference distribution of one channel of the healthy robot: P probes."""

    probes: tuple[str, ...]
    weight: np.ndarray  # (P,), W
    floor: np.ndarray  # (P,), c_p
    seen: np.ndarray  # (N, P + 1) scores of the reference, each column sorted; the last one is `size`
    deviation: np.ndarray  # (P + 1,) of the long run, of their normal quantiles

    def raw(self, error: np.ndarray, phi: np.ndarray) -> np.ndarray:
        """Scores (P + 1,) of one block."""
        return scores(error - phi @ self.weight, phi, self.floor)

    def standard(self, error: np.ndarray, phi: np.ndarray) -> np.ndarray:
        """z (P + 1,) of one block, not clipped."""
        return normal_scores(self.seen, self.raw(error, phi)) / self.deviation


def normal_scores(seen: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Normal quantile of each value (P,) among the sorted columns of seen (N, P); extrapolated along a straight line."""
    n, out = len(seen), np.empty(len(values))
    quantile = NormalDist().inv_cdf
    most = quantile((n - 0.5) / n)
    for p, value in enumerate(values):
        column = seen[:, p]
        rank = 0.5 * (np.searchsorted(column, value, "left") + np.searchsorted(column, value, "right"))
        unit = max(float(column[-1] - column[0]) / (2 * most), 1e-12)  # a deviation, as its extremes tell it
        beyond = max(value - column[-1], 0.0) + min(value - column[0], 0.0)
        out[p] = quantile(float(np.clip(rank, 0.5, n - 0.5)) / n) + beyond / unit
    return out


def scores(r: np.ndarray, phi: np.ndarray, floor: np.ndarray) -> np.ndarray:
    """s_p and s_size of a block: (P + 1,)."""
    projected = phi.T @ r / np.sqrt(np.sum(phi * phi, 0) + floor)
    return np.append(projected, 0.5 * np.log(np.mean(r * r) + 1e-18))


@dataclass(frozen=True)
class Reference:
    """Reference distribution of the healthy robot's innovations, from `blocks` blocks."""

    channels: Mapping[str, ChannelStatistics]
    blocks: int

    @property
    def tests(self) -> int:
        """Number of CUSUMs: two signs of every score."""
        return 2 * sum(c.seen.shape[1] for c in self.channels.values())

    @property
    def allowance(self) -> float:
        """k with the uncertainty of the reference: DRIFT + UNSURE / sqrt(blocks)."""
        return DRIFT + UNSURE / float(np.sqrt(self.blocks))


def learn(blocks: Sequence[Block], probes: Mapping[str, tuple[str, ...]]) -> Reference:
    """The reference of healthy blocks. Raises ConfigError: too few of them."""
    if len(blocks) < LEAST_BLOCKS:
        there, least = len(blocks) * BLOCK, LEAST_BLOCKS * BLOCK
        what = f"{there:.0f} s of healthy swimming to learn from, without the first seconds of each swim"
        raise ConfigError(f"monitor: {what}; expected at least {least:.0f} s, better minutes")
    made = {}
    for name, names in probes.items():
        errors, phis = [b[name][0] for b in blocks], [b[name][1] for b in blocks]
        e, phi = np.concatenate(errors), np.concatenate(phis)
        power = np.sum(phi * phi, 0) + 1e-18
        gram = phi.T @ phi + np.diag(RIDGE * power)
        weight = np.linalg.solve(gram, phi.T @ e)
        floor = FLOOR * power / len(blocks)
        raw = np.array([scores(e_ - p_ @ weight, p_, floor) for e_, p_ in zip(errors, phis, strict=True)])
        seen = np.sort(raw, 0)
        normal = np.array([normal_scores(seen, row) for row in raw])
        spread = np.array([max(long_run_deviation(column), 1.0) for column in normal.T])
        made[name] = ChannelStatistics(tuple(names), weight, floor, seen, spread)
    return Reference(made, len(blocks))


class Cusums:
    """All CUSUMs of a reference. A large fault clips many z at once, so the unclipped ones name the channel.

    Args:
        rate: false alarms an hour, of all together. block: s.
    """

    def __init__(self, reference: Reference, rate: float, block: float):
        if not rate > 0.0:
            raise ConfigError(f"monitor: {rate} false alarms an hour; expected a positive number, such as 0.1")
        self.reference = reference
        self.limit = threshold(reference.tests * 3600.0 / (rate * block), DRIFT)
        self.level = {name: np.zeros((2, c.seen.shape[1])) for name, c in reference.channels.items()}
        self.whole = {name: np.zeros((2, c.seen.shape[1])) for name, c in reference.channels.items()}

    def take(self, block: Block) -> None:
        """Adds one block."""
        k = self.reference.allowance
        for name, channel in self.reference.channels.items():
            z = channel.standard(*block[name])
            both = np.stack([z, -z])
            self.level[name] = np.maximum(0.0, self.level[name] + np.clip(both, -CLIP, CLIP) - k)
            self.whole[name] = np.maximum(0.0, self.whole[name] + both - k)

    def share(self) -> dict[str, float]:
        """Channel -> its highest CUSUM over the limit; 1 is an alarm."""
        return {name: float(level.max()) / self.limit for name, level in self.level.items()}

    def parted(self) -> str:
        """The alarming channel with the largest deviation; "" if there is none."""
        over = [name for name, share in self.share().items() if share >= 1.0]
        return max(over, key=lambda name: float(self.whole[name].max()), default="")

    def highest(self, name: str) -> tuple[str, int]:
        """(probe or SIZE, sign) of the largest deviation in a channel."""
        whole = self.whole[name]
        sign, place = np.unravel_index(int(whole.argmax()), whole.shape)
        return (*self.reference.channels[name].probes, SIZE)[place], 1 - 2 * int(sign)
