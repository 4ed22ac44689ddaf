"""Common parts of the baselines: an answer (effects with values, or nothing), and residuals of a fit without null runs.

Such residuals are over the sensors' own noise, with the constants of the fish adapted within tolerance.
"""

from typing import NamedTuple

import numpy as np

from fishmj.gap.calibrate.parameter_fit import correlation_length
from fishmj.gap.null.whitening import residual_and_tangents, whitening
from fishmj.gap.records.records import Record, ResidualLayout
from fishmj.gap.search.fit import EffectFitter


class BaselineAnswer(NamedTuple):
    """effects: {name: {parameter: value}}, empty for "nothing is missing". seen: True if it found a gap at all, named or not."""

    effects: dict[str, dict[str, float]]
    seen: bool
    reason: str

    @property
    def word(self) -> str:
        """One of the five answers."""
        return "NAMED" if self.effects else "UNEXPLAINED" if self.seen else "AGREES"


NOTHING = BaselineAnswer({}, False, "nothing stands out")


def values(plant, row: np.ndarray, names) -> dict[str, dict[str, float]]:
    """{effect: {parameter: value}} of a parameter row."""
    return {n: {p.name: float(row[plant.index(n, p.name)]) for p in plant.active.effect(n).parameters} for n in names}


def unsized(plant, name: str, reason: str) -> BaselineAnswer:
    """Answer that names an effect without a value; that something is missing, if the plant has no effect of this name."""
    effects = {e.name: {p.name: float("nan") for p in e.parameters} for e in plant.active.effects if e.name == name}
    return BaselineAnswer(effects, True, reason)


# ---------------------------------------------------------------------------------------------------- residuals without null runs
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
