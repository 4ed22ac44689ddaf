"""The error bar: how far the means of a swim may be off, from the members' disagreement and from the validation part.

    half width = b sqrt(s^2 + (w / 3)^2)       s spread of the members, w tolerance of the channel at the predicted mean
b is the smallest number with which 90 % of the validation episodes lie inside (split conformal, Lei et al. 2018): the members
say where the model is less sure, the validation part says by how much.
"""

from typing import NamedTuple

import numpy as np

from fishmj.hydro_fit.fit.newton import TOLERANCE
from fishmj.hydro_fit.fit.rollout import Fleet, Track

CHANNELS = ("speed", "yaw_rate", "power")
COVER = 0.90


class Means(NamedTuple):
    """Mean of every channel over each piece, (B,): speed over ground m/s, yaw rate rad/s, servo power W."""

    speed: np.ndarray
    yaw_rate: np.ndarray
    power: np.ndarray


def means(track: Track, fleet: Fleet) -> Means:
    """Over what was recorded of each piece; speed is that along the body."""
    yaw = track.q[..., 2]
    surge = np.cos(yaw) * track.v[..., 0] + np.sin(yaw) * track.v[..., 1]
    over = lambda a: (a * fleet.mask).sum(1) / fleet.mask.sum(1)  # noqa: E731
    return Means(over(surge), over(track.v[..., 2]), over(track.power))


def width(channel: str, value: np.ndarray) -> np.ndarray:
    """Tolerance of a channel at a predicted mean."""
    share, floor = TOLERANCE[{"yaw_rate": "yaw"}.get(channel, channel)]
    return share * np.abs(value) + floor


def unit(channel: str, mean: np.ndarray, members: list[Means]) -> np.ndarray:
    """Half width of the band for b = 1."""
    spread = np.std([getattr(m, channel) for m in members], axis=0, ddof=1)
    return np.sqrt(spread**2 + (width(channel, mean) / 3) ** 2)


def fit_band(mean: Means, members: list[Means], seen: Means) -> dict[str, float]:
    """b of every channel from predictions and records of the validation part."""
    out = {}
    for channel in CHANNELS:
        value, wanted = getattr(mean, channel), getattr(seen, channel)
        needed = np.sort(np.abs(value - wanted) / unit(channel, value, members))
        at = min(len(needed) - 1, int(np.ceil(COVER * (len(needed) + 1))) - 1)
        out[channel] = float(needed[at])
    return out


def covered(mean: Means, members: list[Means], seen: Means, band: dict[str, float]) -> dict[str, float]:
    """Share of episodes inside the band, by channel."""
    out = {}
    for channel in CHANNELS:
        value, wanted = getattr(mean, channel), getattr(seen, channel)
        out[channel] = float(np.mean(np.abs(value - wanted) <= band.get(channel, 0.0) * unit(channel, value, members)))
    return out
