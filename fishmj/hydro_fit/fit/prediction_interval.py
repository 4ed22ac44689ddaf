"""The error bar of the means of a swim, from the swims of the training and validation parts.

    half width = sqrt(offset^2 + (share |mean|)^2 + (spread s)^2)       s: spread of the members at this swim
The residual variance of the swims is fitted as a sum of three parts that are not negative (least squares, weighted by the
variance itself). Then all parts are scaled until 90 % of the swims lie inside (split conformal, Lei et al. 2018). The fit decides
which part
matters: if the members do not separate good swims from bad, their share is zero. Training swims, on which the model was fitted,
count unchanged if they are easier than the validation ones by no more than chance; else their errors are scaled up by the ratio.

These swims need not resemble those of a later question, and the model was fitted to most of them. `calibrated` therefore scales
every channel by the ceil((n + 1) 90 %)-th smallest of error / half width over n fresh swims, drawn like those of the later use. A
swim drawn in the same way lies inside in 90 % of all cases, for any distribution of the errors (Lei et al. 2018,
doi 10.1080/01621459.2017.1307116).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fishmj.base.errors import DatasetError
from fishmj.hydro_fit.fit import prediction_interval
from fishmj.hydro_fit.fit.rollout import FishBatch, SwimTrack, SwimWindow, fish_batch_of, is_free, recorded
from fishmj.hydro_fit.record import SegmentRecord
from fishmj.mjcf.description import Robot
from fishmj.water import residual_hooks
from fishmj.water.dynamics import planar_chain
from fishmj.water.hydro_model import HydroModel
from fishmj.water.prior import flat

CHANNELS = ("speed", "yaw_rate", "power")
COVER = 0.90
ROUNDS, LEAST = 10, 1e-3  # of weighting; of the whole variance, so that no swim is expected to be exact
NOTHING = 1e-9  # of the whole variance: a part that small tells nothing
FEWEST = 40  # swims of a calibration: with fewer the factor hangs on the worst few


class Means(NamedTuple):
    """Mean of every channel over each piece, (B,): speed over ground m/s, yaw rate rad/s, servo power W."""

    speed: np.ndarray
    yaw_rate: np.ndarray
    power: np.ndarray


def means(track: SwimTrack, fleet: FishBatch) -> Means:
    """Means over the recorded part of each piece; speed is that along the body."""
    yaw = track.q[..., 2]
    surge = np.cos(yaw) * track.v[..., 0] + np.sin(yaw) * track.v[..., 1]
    over = lambda a: (a * fleet.mask).sum(1) / fleet.mask.sum(1)
    return Means(over(surge), over(track.v[..., 2]), over(track.power))


def of_members(swim: SwimWindow, fleet: FishBatch, waters, learnt) -> list[Means]:
    """Means of every member of the ensemble: waters (E, P), each with its own part of the residual if there is one."""
    return [means(swim.run(fleet, row, learnt and residual_hooks.member(learnt, e)), fleet) for e, row in enumerate(waters)]


def half_width(channel: str, mean: Means, members: list[Means], band: dict[str, list[float]]) -> np.ndarray:
    """Half width (B,) of a channel; `band`: (offset, share, spread) by channel, a missing one has no width."""
    return np.sqrt(_parts(channel, mean, members) @ np.square(band.get(channel, [0.0] * 3)))


def _parts(channel: str, mean: Means, members: list[Means]) -> np.ndarray:
    """One, squared mean, variance of the members: (B, 3)."""
    value, spread = getattr(mean, channel), np.var([getattr(m, channel) for m in members], axis=0, ddof=1)
    return np.stack([np.ones(len(value)), value**2, spread], 1)


def fit_band(mean: Means, members: list[Means], seen: Means, trained: np.ndarray) -> dict[str, list[float]]:
    """(offset, share, spread) of every channel from predictions and records of whole swims; `trained` (B,): used in the fit."""
    out = {}
    for channel in CHANNELS:
        error = np.abs(getattr(mean, channel) - getattr(seen, channel))
        parts = _parts(channel, mean, members)
        variance = _variance(parts, error**2)
        needed = error / np.sqrt(parts @ variance)
        needed = np.where(trained, needed * easier(needed, trained), needed)
        out[channel] = (conformal(needed) * np.sqrt(variance)).tolist()
    return out


def conformal(needed: np.ndarray) -> float:
    """Factor that bounds another swim's error over its unit in 90 % of all cases, from those of n exchangeable swims."""
    at = min(len(needed) - 1, int(np.ceil(COVER * (len(needed) + 1))) - 1)
    return float(np.sort(needed)[at])


def _variance(parts: np.ndarray, square: np.ndarray) -> np.ndarray:
    """Three parts of a variance, none negative, the first at least `LEAST` of the whole."""
    from scipy.optimize import nnls

    whole = float(square.mean()) + 1e-18
    size = parts.mean(0)
    size[size < NOTHING * whole] = np.inf  # members that are equal but for round-off would get any factor
    expected = np.full(len(square), whole)
    for _ in range(ROUNDS):
        found, _ = nnls(parts / size / expected[:, None], square / expected)
        expected = parts / size @ found + LEAST * whole
    return found / size + np.array([LEAST * whole, 0.0, 0.0])


def easier(needed: np.ndarray, trained: np.ndarray) -> float:
    """Ratio by which errors of training swims are smaller than of others, 1 if that may be chance (one in twenty)."""
    apart, count = needed[~trained], int((~trained).sum())
    if not count or count == len(needed):
        return 1.0
    ratio = float(np.sqrt(np.mean(apart**2) / max(np.mean(needed[trained] ** 2), 1e-12)))
    return max(1.0, ratio / (1.0 + 1.64 / np.sqrt(2 * count)))


def covered(mean: Means, members: list[Means], seen: Means, band: dict[str, list[float]]) -> dict[str, float]:
    """Share of episodes inside the band, by channel."""
    inside = lambda c: np.abs(getattr(mean, c) - getattr(seen, c)) <= half_width(c, mean, members, band)
    return {channel: float(np.mean(inside(channel))) for channel in CHANNELS}


def calibrated(model: HydroModel, robot: Robot, records: Sequence[SegmentRecord], about: dict) -> HydroModel:
    """Model with its bands scaled by swims outside every fit, with its residual and alone.

    Args:
        records: records, of which the free swims count. about: metadata of them; the number of swims is added.
    Raises:
        DatasetError: too few free swims, or records to which the model was fitted.
    """
    swims = [r for r in records if is_free(r)]
    if len(swims) < FEWEST:
        raise DatasetError(f"calibrate: {len(swims)} free swims; expected {FEWEST} or more: collect --fresh-test SEED --scale 5")
    if about.get("sha256") in [model.dataset.get("sha256"), *model.dataset.get("also", [])]:
        raise DatasetError(f"calibrate: {about.get('folder')} is what {model.name!r} was fitted to; collect --fresh-test SEED")
    made = _scaled(model, robot, swims)
    alone = made if model.learnt is None else _scaled(model.base_only, robot, swims)
    return replace(model, band=made, band_alone=alone, calibration=about | {"swims": len(swims)})


def _scaled(model: HydroModel, robot: Robot, swims: Sequence[SegmentRecord]) -> dict[str, list[float]]:
    ch = planar_chain.chain_of(robot)
    swim, fleet = SwimWindow(ch, model.swimmer(robot)), fish_batch_of(ch, robot, swims, seconds=1e6)
    mean = prediction_interval.means(swim.run(fleet, flat(model.base), model.learnt), fleet)
    members = prediction_interval.of_members(swim, fleet, model.members, model.learnt)
    seen, out = prediction_interval.means(recorded(fleet), fleet), {}
    for channel in prediction_interval.CHANNELS:
        error = np.abs(getattr(mean, channel) - getattr(seen, channel))
        needed = error / prediction_interval.half_width(channel, mean, members, model.band)
        out[channel] = (prediction_interval.conformal(needed) * np.array(model.band[channel])).tolist()
    return out
