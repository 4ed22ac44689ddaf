"""Localises the gap in words and numbers: channel and regime, lag, beat, world or body frame, left or right, time, growth.

    place = localise(compared(likelihood, linearised at after, before, after), gates.adequacy)
    place.text

It does not decide which effect is missing; it describes the residual of the model before and after the found effects.
"""

from dataclasses import dataclass

import numpy as np

from fishmj.gap.localise import residual_patterns as patterns
from fishmj.gap.localise.comparison import KINDS, Comparison, compared, kinds, shares

__all__ = ["Comparison", "Localisation", "compared", "localise"]
THIRDS = 3


@dataclass(frozen=True)
class Localisation:
    """Description of the present model's residual.

    gap, gap_after: |z|^2 / m of the logs; up to `allowed` model and records agree. channels (C,), kinds (K,): names.
    share, time: (C, K) shares of the gap above 1, and of the channel's time. level: (C, K) mean of
    z^2, NaN without data. locked: lock to the tail beat, for joint and heading.
    thirds: channel -> (3,) mean square over the floor in the first, middle and last third of a record. session: channel -> slope
    of the mean square over the session [1/s], relative to its mean; NaN if all records have one time.
    bias: (J,) mean residual of each joint, rad.
    """

    gap: float
    gap_after: float
    allowed: float
    channels: tuple[str, ...]
    kinds: tuple[str, ...]
    share: np.ndarray
    level: np.ndarray
    time: np.ndarray
    lags: patterns.Lags
    locked: dict[str, patterns.BeatLock]
    frame: patterns.FrameResidual | None
    side: patterns.Side | None
    thirds: dict[str, np.ndarray]
    session: dict[str, float]
    rates: patterns.BeatRates | None
    bias: np.ndarray

    @property
    def text(self) -> str:
        """The paragraph of the report."""
        from fishmj.gap.localise.narrative import paragraph

        return paragraph(self)


def localise(c: Comparison, allowed: float) -> Localisation:
    """Computes all diagnostics of a comparison. allowed: largest gap of healthy robots."""
    channels, share, level, time = shares(c, kinds(c))
    found = patterns.stretches(c)
    gaps = [float(np.mean(ratio)) for ratio in c.ratio]
    locked = {name: got for name in ("joint", "heading") if (got := patterns.beat(c, name)) is not None}
    return Localisation(
        *(gaps[0], gaps[1], allowed, channels, KINDS, share, level, time, patterns.lags(c), locked),
        *(patterns.frame(found), patterns.side(found), thirds(c), over_session(c), patterns.by_rate(c), bias(c)),
    )


def thirds(c: Comparison) -> dict[str, np.ndarray]:
    """Mean square by third of the record, for each channel."""
    sums: dict[str, list[np.ndarray]] = {}
    for b in c.layout.blocks:
        place = np.minimum((THIRDS * b.t / (b.t[-1] + 1e-9)).astype(int), THIRDS - 1)
        ratio = c.over_floor[0][b.where]
        if len(np.unique(place)) == THIRDS:
            sums.setdefault(b.channel, []).append(np.array([ratio[place == k].mean() for k in range(THIRDS)]))
    return {name: np.mean(values, 0) for name, values in sums.items()}


def over_session(c: Comparison) -> dict[str, float]:
    """Slope of each channel's mean square over the session, relative to its mean, 1/s."""
    times = np.array([r.session for r in c.records])
    out = {}
    for name in dict.fromkeys(c.layout.channel):
        mine = c.layout.channel == name
        sums, counts = (np.bincount(c.layout.record[mine], w, len(c.records)) for w in (c.over_floor[0][mine], None))
        known = counts > 0
        level = sums / np.maximum(counts, 1)
        spread = times[known] - times[known].mean()
        sizes = float(spread @ spread)
        out[str(name)] = float(spread @ level[known] / sizes / level[known].mean()) if sizes > 0 else float("nan")
    return out


def bias(c: Comparison) -> np.ndarray:
    """(J,) mean residual of each joint over all records, rad; empty without joints."""
    sums: dict[int, list[float]] = {}
    for b in c.layout.blocks:
        if b.channel == "joint":
            sums.setdefault(b.column, []).append(float(np.mean(c.residuals[0][b.where])))
    return np.array([np.mean(sums[k]) for k in sorted(sums)])
