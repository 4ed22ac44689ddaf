"""What is compared: short averages of every channel, measured minus predicted, as one long vector.

A fast channel is averaged over 60 ms, a slow one over 0.2 s: less noise, nothing lost that a beat of 3 Hz carries. Heading and
position are whole free runs from the known start, so what accumulates is seen; the covariance of the null (null/whitening.py)
knows that late times are uncertain and that neighbouring values are not independent.
"""

from typing import NamedTuple

import numpy as np

from fishmj.gap.records.records import Record

WINDOW = {"joint": 0.06, "pose": 0.2, "power": 0.2, "placed": 0.2, "weighed": 0.2}  # s
CHANNELS = {
    "joint": ("joint",),
    "pose": ("position", "position", "heading"),
    "power": ("power",),
    "placed": ("start",) * 3,
    "weighed": ("weighing",) * 3,
}


class ChannelBlock(NamedTuple):
    """A stretch of the vector: one column of one sensor of one record."""

    record: int
    sensor: str
    column: int
    channel: str  # joint, position, heading, power, start, weighing
    t: np.ndarray  # (n,) middle of each average, s
    window: np.ndarray  # (n,) number of each average since t = 0
    where: slice  # in the vector
    first: np.ndarray  # (n,) first stamp of each average
    counts: np.ndarray  # (n,)
    sigma: float  # of one measurement, NaN unknown


class ResidualLayout:
    """Where everything lies, for a set of records. `size` is the length of the vector."""

    def __init__(self, records: list[Record]):
        self.records, self.blocks, self.size = records, [], 0
        for i, record in enumerate(records):
            for sensor in WINDOW:
                given = getattr(record, sensor, None)
                if given is None:
                    continue
                window, first, counts = np.unique(
                    np.floor(given.t / WINDOW[sensor]).astype(int), return_index=True, return_counts=True
                )
                t = np.add.reduceat(given.t, first) / counts
                for column in np.flatnonzero(np.isfinite(given.values).any(0)).tolist():
                    channel = CHANNELS[sensor][column % len(CHANNELS[sensor])]
                    where = slice(self.size, self.size + len(counts))
                    sigma = float(given.sigma[column])
                    self.blocks.append(ChannelBlock(i, sensor, column, channel, t, window, where, first, counts, sigma))
                    self.size = where.stop
        self.record = np.concatenate([np.full(len(b.t), b.record) for b in self.blocks])
        self.channel = np.concatenate([np.full(len(b.t), b.channel) for b in self.blocks])

    @property
    def measured(self) -> np.ndarray:
        """(size,) the averages themselves."""
        zero = lambda record: {s: np.zeros((1, *x.values.shape)) for s in WINDOW if (x := getattr(record, s, None)) is not None}
        return self.residuals([zero(record) for record in self.records])[0]

    def residuals(self, predictions: list[dict]) -> np.ndarray:
        """(R, size) measured minus predicted; predictions as `model.predict` gives them for these records."""
        rows = len(next(iter(predictions[0].values())))
        out = np.empty((rows, self.size))
        for b in self.blocks:
            measured = getattr(self.records[b.record], b.sensor).values[:, b.column]
            values = measured - predictions[b.record][b.sensor][:, :, b.column]
            out[:, b.where] = np.add.reduceat(values, b.first, axis=1) / b.counts
        return out

    def aligned(self, other: "ResidualLayout", vector: np.ndarray) -> np.ndarray:
        """A vector of `other`, the same experiments with their own stamps, at this layout's windows.

        A window that `other` lacks takes its neighbours' straight line.
        """
        out = np.empty(self.size)
        for mine, theirs in zip(self.blocks, other.blocks, strict=True):
            out[mine.where] = np.interp(mine.window, theirs.window, vector[theirs.where])
        return out

    def noise(self) -> np.ndarray:
        """(size,) standard deviation of the averages from the sensors' own noise, NaN where unknown."""
        out = np.empty(self.size)
        for b in self.blocks:
            out[b.where] = b.sigma / np.sqrt(b.counts)
        return out
