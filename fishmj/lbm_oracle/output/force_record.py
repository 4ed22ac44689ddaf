"""Forces on the bodies of a scene over time: a table on disk, a mean with its drift, and the frequency of a wake.

drift = |mean of the second half - mean of the first half| / |mean|       of the window
St = f D / U, f from the times at which the side force rises through its mean; those within a swing count once
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.base.store import write_text

SETTLED = 0.01  # drift of a mean that is not reported
PERIODS = 3  # that a frequency needs
EVEN = 0.2  # of the periods: greatest standard deviation over their mean
SWING = 1e-3  # least amplitude of a side force coefficient that a wake makes
COLUMNS = ("fx", "fy", "fz", "mx", "my", "mz")


class ForceRecord(NamedTuple):
    """Means over intervals ending at `times` (T,) s: wrenches (T, L, 6) N and N m on each link, of a flat flow per metre of span.

    World frame, moments about the link's origin; on a hull without water inside, and without its buoyancy.
    """

    times: np.ndarray
    wrench: np.ndarray

    def write(self, path: str | Path) -> Path:
        """Writes a CSV: t, then fx0, fy0, fz0, mx0, my0, mz0 of link 0 and so on, in SI units. Raises OSError."""
        links = self.wrench.shape[1]
        head = ",".join(["t", *(f"{name}{link}" for link in range(links) for name in COLUMNS)])
        rows = np.column_stack([self.times, self.wrench.reshape(len(self.times), 6 * links)])
        return write_text(path, "\n".join([head, *(",".join(f"{value:.8g}" for value in row) for row in rows)]) + "\n")


def window(times: np.ndarray, seconds: float) -> np.ndarray:
    """Mask (T,) of the last `seconds`. Raises ConfigError for none, and for more than the record holds."""
    if not 0 < seconds <= times[-1]:
        raise ConfigError(f"scene: a mean over {seconds} s of a record of {times[-1]:.4g} s; expected less, and more than 0")
    return times > times[-1] - seconds


def settled_mean(name: str, values: np.ndarray, seconds: float) -> float:
    """Mean of values (T,) over a window of `seconds`; warns if its two halves differ by more than 1 %."""
    mean, middle = float(values.mean()), len(values) // 2
    if middle:
        first, second = float(values[:middle].mean()), float(values[middle:].mean())
        if abs(second - first) > SETTLED * abs(mean):
            console.warn(
                f"{name} has not settled: {first:.4g} and {second:.4g} in the halves of the last {seconds:.4g} s"
                f" ({100 * abs(second - first) / max(abs(mean), 1e-300):.2g} % of the mean); run longer"
            )
    return mean


def frequency(times: np.ndarray, side: np.ndarray) -> float:
    """Frequency, Hz, of a side force coefficient (T,) at times (T,) s.

    Raises ConfigError: it does not swing, or not evenly, or for fewer than three periods.
    """
    swing = side - side.mean()
    strong = float(np.sqrt(2) * swing.std())
    if not strong > SWING:
        raise ConfigError(f"scene: the side force swings by {strong:.1g} of a coefficient; expected {SWING:g}: no wake is shed")
    low = np.flatnonzero(swing < -strong / 2)  # one crossing for each fall below
    rises = np.flatnonzero((swing[:-1] <= 0) & (swing[1:] > 0))
    after = np.searchsorted(low, rises)
    rises = rises[np.concatenate([after[:1] > 0, np.diff(after) > 0])]
    at = times[rises] - swing[rises] * (times[rises + 1] - times[rises]) / (swing[rises + 1] - swing[rises])
    periods = np.diff(at)
    if len(periods) < PERIODS:
        raise ConfigError(
            f"scene: {len(periods)} whole periods of the side force in {times[-1] - times[0]:.4g} s; expected {PERIODS} or"
            " more: run longer, or take a longer window"
        )
    if periods.std() > EVEN * periods.mean():
        raise ConfigError(
            f"scene: periods of the side force from {periods.min():.3g} to {periods.max():.3g} s; expected even ones: the wake"
            " has no one frequency, or has not settled"
        )
    return float(len(periods) / (at[-1] - at[0]))
