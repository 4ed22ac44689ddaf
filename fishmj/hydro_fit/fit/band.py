"""The error bar: how far the means of a swim may be off, from the members' disagreement and from the validation part.

    half width = 1.645 sqrt(s^2 + (b w)^2)       s spread of the members, w tolerance of the channel at the predicted mean
b is the smallest number with which 90 % of the validation episodes lie inside: what no member knows of.
"""

from typing import NamedTuple

import numpy as np

from fishmj.hydro_fit.fit.newton import TOLERANCE
from fishmj.hydro_fit.fit.rollout import Fleet, Track

CHANNELS = ("speed", "yaw_rate", "power")
NORMAL = 1.645  # half width of a normal 90 % band
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


def half(channel: str, mean: np.ndarray, spread: np.ndarray, extra: float) -> np.ndarray:
    """Half width of the 90 % band."""
    return NORMAL * np.sqrt(spread**2 + (extra * width(channel, mean)) ** 2)


def fit_band(mean: Means, members: list[Means], seen: Means) -> dict[str, float]:
    """b of every channel from predictions and records of the validation part."""
    out = {}
    for channel in CHANNELS:
        value, wanted = getattr(mean, channel), getattr(seen, channel)
        spread = np.std([getattr(m, channel) for m in members], axis=0, ddof=1)
        lacking = np.maximum(((value - wanted) / NORMAL) ** 2 - spread**2, 0.0)
        needed = np.sort(np.sqrt(lacking) / width(channel, value))
        at = min(len(needed) - 1, int(np.ceil(COVER * (len(needed) + 1))) - 1)
        out[channel] = float(needed[at])
    return out


def covered(mean: Means, members: list[Means], seen: Means, band: dict[str, float]) -> dict[str, float]:
    """Share of episodes inside the band, by channel."""
    out = {}
    for channel in CHANNELS:
        value, wanted = getattr(mean, channel), getattr(seen, channel)
        spread = np.std([getattr(m, channel) for m in members], axis=0, ddof=1)
        out[channel] = float(np.mean(np.abs(value - wanted) <= half(channel, value, spread, band.get(channel, 0.0))))
    return out
