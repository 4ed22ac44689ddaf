"""Swimming speeds of the records, measured and by a model: of the second half of each steady swim."""

from collections.abc import Sequence

import numpy as np

SLOWEST = 0.02  # m/s: a slower record is no swim
STEADY = 0.2  # of the speed, by which the last two quarters may differ
FEWEST = 8  # poses in a quarter
PACE = 1.0  # s between two positions of a path


def speed_of(t: np.ndarray, place: np.ndarray) -> float:
    """Mean speed over ground [m/s] along a path of places (K, 2) at the times t (K,), which a turn does not shorten.

    The path is that of positions `PACE` apart, which leaves out the sway of a beat.
    """
    marks = np.linspace(t[0], t[-1], 1 + max(round((t[-1] - t[0]) / PACE), 1))
    x, y = (np.interp(marks, t, column) for column in place.T)
    return float(np.hypot(np.diff(x), np.diff(y)).sum() / (t[-1] - t[0]))


def steady_speeds(records: Sequence, predictions: Sequence[dict]) -> dict[str, tuple[float, float]]:
    """{record: (measured, simulated)} in m/s, of records that swim steadily without a push or a current.

    predictions: {"pose": (R, K, 3)} of each record, as of `model.predict`; the first row counts.
    """
    out = {}
    for r, p in zip(records, predictions, strict=True):
        if (pose := getattr(r, "pose", None)) is None or np.any(r.push) or np.any(r.flow):
            continue
        t, seen = pose.t, np.isfinite(pose.values).all(axis=1)
        share = (t - t[0]) / max(t[-1] - t[0], 1e-9)
        half, third, last = seen & (share >= 0.5), seen & (share >= 0.5) & (share < 0.75), seen & (share >= 0.75)
        if min(third.sum(), last.sum()) < FEWEST:
            continue
        measured, one, two = (speed_of(t[part], pose.values[part, :2]) for part in (half, third, last))
        if measured >= SLOWEST and abs(one - two) <= STEADY * measured:
            out[r.name] = measured, speed_of(t[half], p["pose"][0][half, :2])
    return out


def speed_errors(speeds: dict[str, tuple[float, float]]) -> np.ndarray:
    """(K,) share by which each measured speed exceeds the simulated one; negative for a robot that is slower."""
    return np.array([measured / simulated - 1.0 for measured, simulated in speeds.values() if simulated > SLOWEST])


def speeds_text(found: dict[str, tuple[float, float]]) -> str:
    """One line on the mean speeds; "" without steady swims."""
    if not found:
        return ""
    measured, simulated = np.mean(list(found.values()), axis=0)
    swims = f"{len(found)} steady swim{'s' * (len(found) > 1)}"
    return f"swimming speed: {measured:.3f} m/s measured, {simulated:.3f} m/s by the present model (mean of {swims})"
