"""Mean of a correlated record with its standard error.

    sem = s sqrt(2 T_c / T),   T_c = integral of the autocorrelation to its first zero

Samples of a wake are not independent: s / sqrt(n) would be far too small.
"""

from typing import NamedTuple

import numpy as np


class Average(NamedTuple):
    """Of one record: mean, its standard error, rms about the mean, all in the record's unit; `samples` is T / 2 T_c."""

    mean: float
    sem: float
    rms: float
    samples: float


def average(record) -> Average:
    """Of a record (T,) of equal steps; NaN where it is empty, sem NaN for one sample."""
    x = np.asarray(record, float)
    n = len(x)
    if n == 0:
        return Average(np.nan, np.nan, np.nan, 0.0)
    mean, part = float(x.mean()), x - x.mean()
    rms = float(np.sqrt(np.mean(part**2)))
    if n == 1:
        return Average(mean, np.nan, 0.0, 1.0)
    if rms <= 1e-12 * max(abs(mean), 1e-300):  # a constant has no error and no time scale
        return Average(mean, 0.0, rms, float(n))
    spectrum = np.abs(np.fft.rfft(part, 2 * n)) ** 2
    correlation = np.fft.irfft(spectrum)[:n] / np.arange(n, 0, -1)
    correlation /= correlation[0]
    zero = int(np.argmax(correlation < 0)) or n
    steps = max(2 * float(correlation[:zero].sum()) - 1, 1.0)  # 2 T_c in steps
    return Average(mean, rms * np.sqrt(min(steps / n, 1.0)), rms, n / steps)
