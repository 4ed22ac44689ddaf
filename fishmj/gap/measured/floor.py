"""Replaces the empirical null if no simulator exists for the robot: by the scatter between records of one condition.

    r_gi = b_g + e_gi                    residual of the baseline, group g (a condition, a gain), i within it
    S    = D + sum_g t^2 1_g 1_g^T       D = var e, t^2 = var b, both for each sensor's column: one-way analysis of variance
    z    = S^-1/2 r

A constant error of the model in one condition counts once, not once per row: S gives each group about its independent weight. It
gives no adequacy, since the scatter includes the missing effect; that needs replicates.
"""

import numpy as np

from fishmj.gap.null.whitening import Whitening, whitening
from fishmj.gap.records.records import ResidualLayout

LEAST = 1e-3  # of a column's rms: D never goes below


class Scatter:
    """Standard deviations within and between groups, from the residuals (m,) of a baseline. groups: (L,) of each record."""

    def __init__(self, layout: ResidualLayout, groups, residual: np.ndarray):
        self.within, self.between = {}, {}
        for key in {(b.sensor, b.column) for b in layout.blocks}:
            parts: dict[str, list] = {}
            for b in layout.blocks:
                if (b.sensor, b.column) == key:
                    parts.setdefault(groups[b.record], []).append(residual[b.where])
            values = [np.concatenate(p) for p in parts.values()]
            n = np.array([len(v) for v in values])
            whole = np.concatenate(values)
            if len(values) < 2 or not (n > 1).any():
                self.within[key], self.between[key] = float(np.sqrt(np.mean(whole**2))), 0.0
                continue
            within = sum(float(np.sum((v - v.mean()) ** 2)) for v in values) / max(int(np.sum(n - 1)), 1)
            means = np.array([v.mean() for v in values])
            least = (LEAST**2) * float(np.mean(whole**2))
            self.within[key] = float(np.sqrt(max(within, least)))
            self.between[key] = float(np.sqrt(max(float(np.mean(means**2)) - within * float(np.mean(1.0 / n)), 0.0)))

    def factors(self, layout: ResidualLayout, groups) -> tuple[np.ndarray, np.ndarray]:
        """(k, m) t 1_g of every group and column, and D^1/2 (m,)."""
        rows: dict[tuple, np.ndarray] = {}
        d = np.empty(layout.size)
        for b in layout.blocks:
            key = (b.sensor, b.column)
            d[b.where] = self.within[key]
            row = rows.setdefault((key, groups[b.record]), np.zeros(layout.size))
            row[b.where] = self.between[key]
        return np.array(list(rows.values())), d

    def whiten(self, layout: ResidualLayout, groups, tangents: np.ndarray | None = None) -> Whitening:
        """S^-1/2; `tangents` (c, m) are directions that a fit could change anyway and that have little weight."""
        factors, d = self.factors(layout, groups)
        return whitening(factors if tangents is None else np.concatenate([factors, tangents]), d)
