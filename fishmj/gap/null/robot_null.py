"""Null of a robot in MJCF: the searched model with random constants over the logged segments, plus sensor noise.

    r_i = predicted(constants_i) - predicted + noise      constants within their stated tolerance (data/calib/robot.toml)

Each draw starts every segment from the logged state, because with logged commands a random robot would soon leave the logged
path. Errors of those starts and unexplained torques are separate in each record (`RigidRobot.record_errors`).

The draws use the model's own integrator, not an independent one. So the error of its equations is not measured: it is the stated
tolerance of `torque`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from fishmj.gap.progress import Bars, silent_bar
from fishmj.gap.records.records import ResidualLayout

RUNS = 48
BATCH = 12


@dataclass(frozen=True)
class RobotNull:
    """Settings. runs: draws of the constants. noise: factor on the sensors' noise, which is estimated from the logs."""

    runs: int = RUNS
    noise: float = 1.0
    seed: int = 0
    without: str = ""
    kept: dict[tuple, np.ndarray] = field(default_factory=dict, repr=False, compare=False)  # residuals of each set of records

    @property
    def text(self) -> str:
        """Sentence on the null runs."""
        return f"{self.runs} draws of the model within its tolerances, with the noise of the logs, without any hidden effect"

    @staticmethod
    def key(model, records: Sequence, layout: ResidualLayout) -> tuple:
        """Key of a set of records in `kept`."""
        return (id(model.robot), layout.size, *(record.mark for record in records))

    def residuals(self, model, records: list, layout: ResidualLayout, bars: Bars = silent_bar) -> np.ndarray:
        """(n, m) residuals of the present model on every draw. bars: of the draws."""
        key = self.key(model, records, layout)
        if key not in self.kept:
            self.kept[key] = self._drawn(model, records, layout, bars)
        return self.kept[key]

    def _drawn(self, model, records: list, layout: ResidualLayout, bars: Bars) -> np.ndarray:
        rng = np.random.default_rng([self.seed, 0x20B07])
        sigma = np.array([constant.sigma for constant in model.constants])
        rows = np.tile(model.nothing, (1 + self.runs, 1))
        rows[1:, : len(sigma)] *= np.exp(sigma * rng.standard_normal((self.runs, len(sigma))))
        parts = []
        with bars(self.runs * len(records), "null runs", "runs") as bar:
            for i, record in enumerate(records):
                alone = ResidualLayout([record])
                seen = []
                for first in range(0, len(rows), BATCH):
                    seen.append(alone.residuals(model.predict([record], rows[first : first + BATCH])))
                    bar.update(i * self.runs + min(first + BATCH, self.runs))
                residual = np.concatenate(seen)
                parts.append(residual[0] - residual[1:])
        noise = self.noise * layout.noise() * rng.standard_normal((self.runs, layout.size))
        return np.nan_to_num(np.concatenate(parts, 1)) + noise
