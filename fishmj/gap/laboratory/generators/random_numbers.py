"""A separate random stream for every purpose, so that a hidden effect never changes the noise of another channel."""

import hashlib

import numpy as np


def stream(seed: int, purpose: str, trial: int = 0) -> np.random.Generator:
    """Random generator of one purpose ("camera", "radio", ..) in one trial of one robot."""
    key = int.from_bytes(hashlib.sha256(f"generators {purpose}".encode()).digest()[:8], "little")
    return np.random.Generator(np.random.Philox(np.random.SeedSequence([seed, trial, key])))
