"""Covariance of a robot's readings from random commands (lost or late packets), about their mean.

Segments are independent: no packet acts far beyond the next start.
"""

from collections.abc import Mapping

import numpy as np

from fishmj.gap.records.records import ResidualLayout

DRAWS = 24  # random draws: more than the averages in a segment of four joints
WEAK = 1e-3  # of the largest change in a segment, which is none


def scatter_of(layout: ResidualLayout, seen: Mapping[int, np.ndarray]) -> tuple[np.ndarray, ...]:
    """Factors (k, m_l) of every record. seen: {number of a record: readings as of `drawn_factors`}; of others there are none."""
    none = [np.zeros((0, int(np.sum(layout.record == i)))) for i in range(len(layout.records))]
    return tuple(drawn_factors(layout, i, seen[i]) if i in seen else empty for i, empty in enumerate(none))


def drawn_factors(layout: ResidualLayout, number: int, seen: np.ndarray) -> np.ndarray:
    """Factors (k, m_l) of one record, each in one segment. seen: (1 + DRAWS, K, J) its readings, by the mean and by each draw."""
    record = layout.records[number]
    residual = np.nan_to_num(ResidualLayout([record]).residuals([{"joint": seen}]))
    change = (residual[1:] - residual[0]) / np.sqrt(len(residual) - 1)
    stamps = np.concatenate([b.t for b in layout.blocks if b.record == number])
    place = np.searchsorted(record.starts, stamps, side="right") - 1
    return np.concatenate([_fewest(change[:, place == s], place == s) for s in range(len(record.starts))])


def _fewest(change: np.ndarray, where: np.ndarray) -> np.ndarray:
    """(k, m) rows with the same sum of squares as changes (K, n) at samples `where` (m,), no more than needed."""
    _, size, v = np.linalg.svd(change, full_matrices=False)
    keep = size > WEAK * max(float(size.max(initial=0.0)), np.finfo(float).tiny)
    out = np.zeros((int(keep.sum()), len(where)))
    out[:, where] = size[keep, None] * v[keep]
    return out
