"""Study of a planar body: predicts short free runs from a smoothed initial pose and speed.

Examples are a fish, a boat, or an ROV at constant depth; position, heading and commands are known. Start and end of a run are
the middle of a cubic fitted to the rows around them (Savitzky and Golay 1964), which follows the path's curvature; rows that are
used as logged get a moving average.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.signal import savgol_coeffs, savgol_filter

from fishmj.base.errors import LogError
from fishmj.gap.measured.planar_body import MeanGait, PlanarBody, covered
from fishmj.gap.measured.study_logs import Log
from fishmj.gap.measured.study_schema import StudyInput
from fishmj.gap.records.records import ResidualLayout, Sensor

DT = 0.02  # s, largest step of the model
SHARE = 1 / 3  # default window as a share of the horizon
CUBIC = 3
DRAWS = 16  # of the sensors' noise, for its effect on a prediction
GAPS = 5.0  # steps without a row that no run crosses
MOST_RUNS = 4000


class RecordPath(NamedTuple):
    """Record at even steps h [s]. path: (T, 3) x, y, yaw; t: (T,); whole: (T - 1,) no gap before the next row."""

    path: np.ndarray
    t: np.ndarray
    h: float
    shown: float  # s, step that defines the rows of averages and runs
    whole: np.ndarray


def records(study: StudyInput, logs: Sequence[Log], groups: Sequence[str]) -> tuple[list[MeanGait], float]:
    """Returns (runs of every log that is long enough, step of the model [s]).

    Raises LogError: no log is long enough, or there are more runs than a study takes.
    """
    p = study.given.prediction
    step = p.step or (0.0 if p.as_logged else even_step(logs))
    dt = DT if p.as_logged else p.horizon / np.ceil(p.horizon / DT)
    found = [r for log, group in zip(logs, groups, strict=True) if (r := _runs(study, log, group, step, dt)) is not None]
    if not found:
        need = p.horizon * (1 + SHARE) if p.average is None else p.horizon + p.average
        raise LogError(
            f"{study.where}: no record is longer than {need:.3g} s (horizon and average); shorten [prediction] horizon"
        )
    if (runs := sum(len(r.starts) for r in found)) > MOST_RUNS:
        raise LogError(
            f"{study.where}: {runs} runs, expected at most {MOST_RUNS}; lengthen [prediction] horizon or take fewer files"
        )
    return found, dt


def even_step(logs: Sequence[Log]) -> float:
    """Median step of the rows of all logs, s."""
    return float(np.median(np.concatenate([np.diff(log.series["x"].t) for log in logs])))


def _track(study: StudyInput, log: Log, step: float) -> RecordPath:
    p = study.given.prediction
    x, y, yaw = (log.series[k] for k in ("x", "y", "yaw"))
    t = x.t
    if p.clock and log.trial is not None:
        t = t * log.trial.value("clock_ratio.pose", 1.0)
    path = np.stack([x.values, y.values, np.unwrap(yaw.values)], 1)
    if p.as_logged:
        h = float(np.median(np.diff(t)))
        return RecordPath(path, t, h, float(np.median(np.diff(x.t))) if p.pictures else h, np.ones(len(t) - 1, bool))
    even = t[0] + step * np.arange(int((t[-1] - t[0]) / step + 1e-9) + 1)
    path = np.stack([np.interp(even, t, column) for column in path.T], 1)
    wide = np.flatnonzero(np.diff(t) > GAPS * step)
    whole = np.ones(max(len(even) - 1, 0), bool)
    for i in wide:
        whole[(even[:-1] < t[i + 1]) & (even[1:] > t[i])] = False
    return RecordPath(path, even, step, step, whole)


def _runs(study: StudyInput, log: Log, group: str, step: float, dt: float) -> MeanGait | None:
    """Runs of one log; None if it is too short."""
    p = study.given.prediction
    track = _track(study, log, step)
    h = track.h
    rows = window(study, track.shown)
    steps = max(round(p.horizon / track.shown), 1)
    if len(track.path) < rows + steps:
        return None
    if p.as_logged:
        path = averaged(track.path, rows)
        rate = np.gradient(path, h, axis=0)
    else:
        inside = slice(rows // 2, len(track.path) - rows // 2)
        path = savgol_filter(track.path, rows, CUBIC, axis=0)[inside]
        rate = savgol_filter(track.path, rows, CUBIC, deriv=1, delta=h, axis=0)[inside]
    first = np.arange(0, len(path) - steps, steps)
    gap = np.concatenate([[0], np.cumsum(~track.whole)])
    first = first[gap[np.minimum(first + steps + rows - 1, len(gap) - 1)] == gap[first]]
    if not len(first):
        return None
    starts = np.concatenate([path[first], covered(0.0 * path[first], rate[first], path[first, 2])], 1)
    displacement = covered(path[first], path[first + steps], path[first, 2])
    span = steps * h
    begin = track.t[first] + 0.5 * (rows - 1) * h
    scale = np.array(p.scale if p.scale is not None else [np.nan] * 3)
    stamps = span * np.arange(1, len(first) + 1)
    return MeanGait(log.name, group, dt, _commands(log, begin, span, dt), starts, span, Sensor(stamps, displacement, scale))


def _commands(log: Log, begin: np.ndarray, span: float, dt: float) -> np.ndarray:
    """Commands: (1, 2) if constant in the log, else (K, T, 2) per run; missing ones are 0."""
    commands = [log.series.get(k) for k in ("amplitude", "bias")]
    if all(s is None or not np.ptp(s.values) for s in commands):
        return np.array([[0.0 if s is None else s.values[0] for s in commands]])
    at = begin[:, None] + dt * np.arange(int(np.ceil(span / dt)) + 1)
    held = lambda s: s.values[np.clip(np.searchsorted(s.t, at, side="right") - 1, 0, len(s.t) - 1)]
    return np.stack([np.zeros_like(at) if s is None else held(s) for s in commands], -1)


def averaged(values: np.ndarray, n: int) -> np.ndarray:
    """Moving average (T - n + 1, C) of n rows."""
    return np.stack([np.convolve(column, np.ones(n) / n, "valid") for column in values.T], 1)


def with_scale(found: list[MeanGait], least: np.ndarray) -> list[MeanGait]:
    """Runs with an error scale: the study's, else the rms of the displacements, at least `least` (3,)."""
    if np.isfinite(found[0].pose.sigma).all():
        return found
    every = np.concatenate([r.pose.values for r in found])
    scale = np.maximum(np.sqrt(np.mean(every**2, 0)), np.maximum(least, 1e-9))
    return [r._replace(pose=r.pose._replace(sigma=scale)) for r in found]


def error(plant: PlanarBody, found: Sequence[Any], row: np.ndarray) -> float:
    """Mean over runs and columns of (error / scale)^2."""
    layout = ResidualLayout(list(found))
    residual = layout.residuals(plant.predict(list(found), row))[0]
    return float(np.mean((residual / layout.noise()) ** 2))


def window(study: StudyInput, h: float) -> int:
    """Number of rows that determine start and end of a run; odd for a cubic."""
    p = study.given.prediction
    rows = max(round((p.horizon * SHARE if p.average is None else p.average) / h), 1)
    return rows if p.as_logged else max(rows + 1 - rows % 2, CUBIC + 2)


def smoothed_noise(study: StudyInput, h: float) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations of a smoothed pose (3,) and of its rate (3,) from the noise of one reading."""
    n, rows = study.given.noise, window(study, h)
    if study.given.prediction.as_logged:
        pose, rate = 1 / rows, (1 / (rows * h) ** 2 if rows > 1 else 0.5 / h**2)
    else:
        pose = float(np.sum(savgol_coeffs(rows, CUBIC) ** 2))
        rate = float(np.sum(savgol_coeffs(rows, CUBIC, deriv=1, delta=h) ** 2))
    one = np.array([n.position, n.position, n.heading])
    return np.sqrt(pose) * one, np.sqrt(rate) * one


def seen_noise(plant: PlanarBody, found: Sequence[MeanGait], row: np.ndarray, noise: tuple[np.ndarray, np.ndarray]) -> float:
    """Error from sensor noise alone, at starts and ends of runs of the body with a parameter row.

    noise: of pose (3,) and rate (3,).
    """
    (pose, rate), rng, records = noise, np.random.default_rng(0), list(found)
    ends, squares = plant.ends(records, row), []
    for _ in range(DRAWS):
        noisy = [r._replace(starts=r.starts + rng.normal(size=r.starts.shape) * np.concatenate([pose, rate])) for r in records]
        for r, a, b in zip(noisy, ends, plant.ends(noisy, row), strict=True):
            last = a[0, :, :3] + rng.normal(size=a[0, :, :3].shape) * pose
            squares.append(np.mean((covered(b[0, :, :3], last, r.starts[:, 2]) / r.pose.sigma) ** 2, 1))
    return float(np.mean(np.concatenate(squares)))


def repeats(found: Sequence[MeanGait], near: float) -> float:
    """Error of a perfect model: half the mean square difference between runs of two records of one group.

    Initial speeds of both runs differ by less than `near` times the error scale per run.
    """
    errors = []
    for i, a in enumerate(found):
        scale = a.pose.sigma
        for b in found[i + 1 :]:
            if a.group != b.group:
                continue
            for s, end in zip(a.starts, a.pose.values, strict=True):
                difference = np.abs(b.starts[:, 3:] - s[3:]) * a.span / scale
                j = int(np.argmin(difference.max(1)))
                if difference[j].max() < near:
                    errors.append(0.5 * np.mean(((end - b.pose.values[j]) / scale) ** 2))
    return float(np.mean(errors)) if errors else 0.0
