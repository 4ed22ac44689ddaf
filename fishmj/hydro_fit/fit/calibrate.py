"""The error bar, calibrated by swims that no fit has seen, drawn as those it is for.

    model = calibrated(model, robot, records, about)        its bands, each channel scaled by one factor

The fit makes the form of the bar from its own swims; these need not resemble what the bar is asked about, and the fit has seen
most of them. So every channel is scaled by the ceil((n + 1) 90 %)-th smallest of error / half width over n fresh swims: a swim
drawn in the same way lies inside in 90 % of all cases, whatever the errors look like (split conformal, Lei et al. 2018,
doi 10.1080/01621459.2017.1307116; by channel).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fishmj.dynamics import planar_chain
from fishmj.errors import DatasetError
from fishmj.hydro_fit.fit import prediction_interval
from fishmj.hydro_fit.fit.rollout import SwimWindow, fish_batch_of, is_free, recorded
from fishmj.hydro_fit.record import SegmentRecord
from fishmj.mjcf.description import Robot
from fishmj.water.hydro_model import HydroModel
from fishmj.water.prior import flat

LEAST = 40  # swims: with fewer the factor hangs on the worst few


def calibrated(model: HydroModel, robot: Robot, records: Sequence[SegmentRecord], about: dict) -> HydroModel:
    """The model with calibrated bands, with its residual and alone.

    Args:
        records: of which the free swims count. about: what is to be told about them; the number of swims is added.
    Raises:
        DatasetError: too few free swims, or records that the model was fitted to.
    """
    swims = [r for r in records if is_free(r)]
    if len(swims) < LEAST:
        raise DatasetError(f"calibrate: {len(swims)} free swims; expected {LEAST} or more: collect --fresh-test SEED --scale 5")
    if about.get("sha256") == model.dataset.get("sha256"):
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
