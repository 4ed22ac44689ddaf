"""Body that coasts to rest: (m + X) du/dt = -c |u| u + effects; only its speed is measured.

The initial speed of each coast is fitted to its own rows under each law: the best of the trajectories from `STARTS` speeds. A law
is thus judged by the decay of the speed, not by its start.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from fishmj.base.errors import LogError
from fishmj.effects.effect import Effect
from fishmj.gap.measured.planar_body import Hull, PlanarBody
from fishmj.gap.measured.study_logs import Log
from fishmj.gap.measured.study_schema import StudyInput
from fishmj.gap.models.swimming_fish import Constant, ParameterRow
from fishmj.gap.records.records import Sensor

STARTS = 28  # initial speeds on the grid
STRIDE = 5  # steps of the model between two samples
LEAST = 5  # least rows of a coast
LONGEST = 1800.0  # s, of a coast


class CoastRecord(NamedTuple):
    """Speeds of one coast; pose: Sensor of one column, m/s."""

    name: str
    group: str
    dt: float
    pose: Sensor
    joint: None = None
    power: None = None


class CoastDown(ParameterRow):
    """Model of a coasting body.

    Args: hull: nominal mass and drag. constants: fitted factors. catalogue: effects. speeds: range of initial speeds, m/s.
    """

    def __init__(
        self, hull: Hull, constants: tuple[Constant, ...], catalogue: Iterable[Effect], speeds: tuple[float, float], dt: float
    ):
        self.body = PlanarBody(hull, constants, catalogue, dt)
        self.constants, self.active, self.dt = constants, self.body.active, dt
        self.starts = np.geomspace(*speeds, STARTS)

    def predict(self, records: Sequence[CoastRecord], rows) -> list[dict]:
        """Speeds at the stamps of every coast, for parameter rows (R, P): {"pose": (R, K, 1)}."""
        rows = np.atleast_2d(np.asarray(rows, float))
        step = STRIDE * self.dt
        seconds = step * (np.ceil(max(float(r.pose.t[-1]) for r in records) / step) + 1)
        tracks = self.body.coasts(self.starts, rows, float(seconds), STRIDE)
        speeds = np.nan_to_num(tracks, nan=1e3, posinf=1e3, neginf=-1e3)  # (R, S, N)
        return [{"pose": _nearest(speeds, r, step, self.starts)[..., None]} for r in records]


def _nearest(speeds: np.ndarray, r: CoastRecord, step: float, starts: np.ndarray) -> np.ndarray:
    """Best trajectory (R, K) for a coast's rows, interpolated between three initial speeds. speeds: (R, S, N)."""
    at = r.pose.t / step
    i = np.minimum(at.astype(int), speeds.shape[-1] - 2)
    sampled = speeds[..., i] + (at - i) * (speeds[..., i + 1] - speeds[..., i])  # (R, S, K)
    squares = np.sum((sampled - r.pose.values[:, 0]) ** 2, -1)
    middle = np.clip(np.argmin(squares, 1), 1, len(starts) - 2)
    which = np.arange(len(sampled))
    three = np.stack([sampled[which, middle + k] for k in (-1, 0, 1)], 1)  # (R, 3, K)
    # minimum of the parabola through three sums, in steps of the (geometric) grid
    a, b, c = (squares[which, middle + k] for k in (-1, 0, 1))
    bend = np.maximum(a - 2 * b + c, 1e-30)
    x = np.clip(0.5 * (a - c) / bend, -1.0, 1.0)[:, None]
    return 0.5 * x * (x - 1) * three[:, 0] + (1 - x * x) * three[:, 1] + 0.5 * x * (x + 1) * three[:, 2]


def records(study: StudyInput, logs: Sequence[Log], groups: Sequence[str], dt: float) -> list[CoastRecord]:
    """Records of all logs, whole or up to the horizon. Raises LogError: too few rows, too long, or no motion ahead."""
    out, sigma = [], np.array([study.given.noise.speed])
    for log, group in zip(logs, groups, strict=True):
        t, speed = log.series["speed"]
        t = t - t[0]
        keep = t <= study.given.prediction.horizon if study.given.prediction.horizon else np.ones(len(t), bool)
        if keep.sum() < LEAST:
            raise LogError(f"{log.where}: {int(keep.sum())} rows, expected {LEAST} at least in a coast; leave it out")
        if t[keep][-1] > LONGEST:
            raise LogError(
                f"{log.where}: {t[keep][-1]:.4g} s, expected at most {LONGEST:g} s; is the unit of t right? Or set a horizon"
            )
        if not float(np.median(speed[keep][:LEAST])) > 3 * study.given.noise.speed:
            raise LogError(
                f"{log.where}: begins at {np.median(speed[keep][:LEAST]):.3g} m/s, expected motion ahead at three times the "
                "noise or more; cut the log at the release, or turn the sign in [columns]"
            )
        out.append(CoastRecord(log.name, group, dt, Sensor(t[keep], speed[keep][:, None], sigma)))
    return out


def range_of(found: Sequence[CoastRecord]) -> tuple[float, float]:
    """Range of initial speeds that a coast can have, m/s."""
    first = [float(np.max(r.pose.values[: max(LEAST, 1)])) for r in found]
    return 0.4 * min(first), 2.0 * max(first)
