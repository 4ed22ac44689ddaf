"""Residuals of a fit without null runs: over the sensors' own noise, constants of the fish adapted within tolerance."""

import numpy as np

from fishmj.gap.calibrate.parameter_fit import correlation_length
from fishmj.gap.null.whitening import residual_and_tangents, whitening
from fishmj.gap.records.records import Record, ResidualLayout
from fishmj.gap.search.fit import EffectFitter

LONGEST = 200  # averages over which an autocorrelation is summed


def searching(plant, records: list[Record]) -> EffectFitter:
    """A search with z = residual over noise and the constants' tolerance integrated out."""
    layout = ResidualLayout(records)
    residual, tangents = residual_and_tangents(plant, records, layout, plant.null)
    return EffectFitter(plant, records, layout, whitening(tangents, sigma_of(layout, residual)))


def sigma_of(layout: ResidualLayout, residual: np.ndarray) -> np.ndarray:
    """(m,) the sensors' noise; if unknown, the scatter of the residual from one average to the next."""
    noise = layout.noise()
    for b in layout.blocks:
        if not np.isfinite(noise[b.where]).all():
            noise[b.where] = np.std(np.diff(residual[b.where])) / np.sqrt(2) + 1e-9
    return noise


def correlation_time(values: np.ndarray) -> float:
    """Integrated autocorrelation time, in samples."""
    return correlation_length(values, LONGEST)


def channels(layout: ResidualLayout) -> dict[str, np.ndarray]:
    """Places in the vector of every channel."""
    return {str(c): np.flatnonzero(layout.channel == c) for c in np.unique(layout.channel)}


def effective(z: np.ndarray, layout: ResidualLayout) -> dict[str, float]:
    """Independent samples in each channel: sum over its blocks of n over the correlation time."""
    out: dict[str, float] = {}
    for b in layout.blocks:
        part = z[b.where]
        out[b.channel] = out.get(b.channel, 0.0) + len(part) / correlation_time(part)
    return out
