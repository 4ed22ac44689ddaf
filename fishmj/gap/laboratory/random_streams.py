"""Separate random streams for each purpose: a planted effect never changes the noise of another channel."""

import hashlib
import zlib

import numpy as np


def stream(seed: int, purpose: str, trial: int = 0) -> np.random.Generator:
    """Random numbers of one purpose ("camera", "loss", ..) in one trial of one virtual robot."""
    return np.random.default_rng([seed, trial, zlib.crc32(purpose.encode())])


def generators_stream(seed: int, purpose: str, trial: int = 0) -> np.random.Generator:
    """Random numbers of one purpose in one trial of one robot of `generators`; never those of the virtual robot's seed."""
    key = int.from_bytes(hashlib.sha256(f"generators {purpose}".encode()).digest()[:8], "little")
    return np.random.Generator(np.random.Philox(np.random.SeedSequence([seed, trial, key])))


def jitter(rng: np.random.Generator) -> float:
    """Skewed delay of zero mean and unit standard deviation: most packets slightly early, a few very late (gamma, shape 2)."""
    return (rng.gamma(2.0) - 2.0) / 2.0**0.5


def lateness(rng: np.random.Generator) -> float:
    """Non-negative delay of unit standard deviation (gamma, shape 1.5; mean 1.22)."""
    return rng.gamma(1.5) / 1.5**0.5


def gusts(rng: np.random.Generator, n: int, step: float, sigma: float, time: float, smooth: float = 0.1) -> np.ndarray:
    """Gusts (n, 2) [m/s] every `step` s: smoothed Ornstein-Uhlenbeck process, standard deviation sigma, time constant `time` s.

    A first-order filter (time constant `smooth` s) makes the acceleration finite. It removes the share smooth / (time + smooth)
    of the variance, which a factor restores.
    """
    keep, blend = np.exp(-step / time), np.exp(-step / smooth)
    kick = np.sqrt(1.0 - keep * keep)
    raw = rng.standard_normal((n + 200, 2))
    fast, slow, out = raw[0], np.zeros(2), np.empty((n, 2))
    for k in range(n + 200):
        fast = keep * fast + kick * raw[k]
        slow = blend * slow + (1.0 - blend) * fast
        if k >= 200:
            out[k - 200] = slow
    return sigma * np.sqrt((time + smooth) / time) * out
