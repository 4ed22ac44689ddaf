"""A random stream of its own for every purpose, so that what is hidden never moves the noise of another channel."""

import hashlib

import numpy as np


def stream(seed: int, purpose: str, trial: int = 0) -> np.random.Generator:
    """Of one purpose ("camera", "radio", ..) in one trial of one robot."""
    key = int.from_bytes(hashlib.sha256(f"generators {purpose}".encode()).digest()[:8], "little")
    return np.random.Generator(np.random.Philox(np.random.SeedSequence([seed, trial, key])))
