"""What a set of records says for and against candidates: gaps, gains, closure, who is best.

gap       mean over records and channels of mean_t (r / W)^2,  W^2(t) the null's own mean square: agreement is about 1
gain      |z_0|^2 - |z_1|^2 on records that no parameter was fitted to
closure   gain / (|z_0|^2 - m): share of what is unexpected that an effect explains, m = length of z
p_best    share of Bayesian bootstrap draws over records (Rubin 1981) in which a candidate has the least cost
"""

import numpy as np

DRAWS = 2000


def gap(residual: np.ndarray, scale: np.ndarray, layout) -> float:
    """Mean square in units of the floor; every record and channel counts alike."""
    return float(np.mean(list(by_channel(residual, scale, layout).values())))


def by_channel(residual: np.ndarray, scale: np.ndarray, layout) -> dict[str, float]:
    """The same for each channel: joint, position, heading, power."""
    ratio = (residual / scale) ** 2
    found: dict[str, list] = {}
    for b in layout.blocks:
        found.setdefault(b.channel, []).append(float(np.mean(ratio[b.where])))
    return {channel: float(np.mean(values)) for channel, values in found.items()}


def costs(z: np.ndarray, layout) -> np.ndarray:
    """|z|^2 of each record, (..., L)."""
    out = np.zeros((*z.shape[:-1], len(layout.records)))
    for b in layout.blocks:
        out[..., b.record] += np.sum(z[..., b.where] ** 2, -1)
    return out


def closure(cost_before: float, cost_after: float, size: float) -> float:
    """Share of the excess over m that is gone; all of it once |z|^2 is below m."""
    gone = cost_before - cost_after
    return float(gone / max(cost_before - size, gone)) if gone > 0 else 0.0


def p_best(per_record: np.ndarray, seed: int = 0) -> np.ndarray:
    """Share of draws that each candidate (C, L) wins."""
    weights = np.random.default_rng(seed).dirichlet(np.ones(per_record.shape[1]), DRAWS)
    winners = np.argmin(weights @ per_record.T, 1)
    return np.bincount(winners, minlength=len(per_record)) / DRAWS
