"""The material of a localisation: records, what the model made of them before and after, and the floor."""

from typing import Any, NamedTuple

import numpy as np

from fishmj.gap.records.records import Record, ResidualLayout


class Comparison(NamedTuple):
    """Records beside two parameter rows: the model as it was (0) and with the effects found (1); the same row twice when none.

    scale: (m,) floor, standard deviation of what null runs leave. rows: (2, P). predictions: `model.predict` of both rows.
    residuals: (2, m) measured minus predicted, on `layout`.
    """

    model: Any
    records: list[Record]
    layout: ResidualLayout
    scale: np.ndarray
    rows: np.ndarray
    predictions: list[dict]
    residuals: np.ndarray

    @property
    def changed(self) -> bool:
        """Whether anything was found."""
        return not np.array_equal(self.rows[0], self.rows[1])

    @property
    def ratio(self) -> np.ndarray:
        """(2, m) squared residuals in units of the floor: agreement is about 1."""
        return (self.residuals / self.scale) ** 2

    def weights(self) -> np.ndarray:
        """(m,) such that sum(weights * ratio) is the gap: every channel alike, and in it every block."""
        blocks = self.layout.blocks
        channels = [b.channel for b in blocks]
        out = np.empty(self.layout.size)
        for b in blocks:
            out[b.where] = 1.0 / (len(set(channels)) * channels.count(b.channel) * len(b.t))
        return out


def compared(model, records: list[Record], scale: np.ndarray, before, after, layout: ResidualLayout | None = None) -> Comparison:
    """Roll both rows out over the records."""
    layout = ResidualLayout(records) if layout is None else layout
    rows = np.stack([np.asarray(before, float), np.asarray(after, float)])
    predictions = model.predict(records, rows)
    return Comparison(model, records, layout, scale, rows, predictions, layout.residuals(predictions))
