"""Checks that every tracker makes of a frame."""

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.deploy.tracker.calibration import Calibration


def same_size(image: np.ndarray, calibration: Calibration) -> None:
    """Raises ConfigError unless the image is a frame (H, W, 3) uint8 of the calibrated size."""
    width, height = calibration.size
    shape, kind = getattr(image, "shape", None), getattr(image, "dtype", None)
    if shape != (height, width, 3) or kind != np.uint8:
        raise ConfigError(
            f"frame of {shape} {kind}, expected ({height}, {width}, 3) uint8: a calibration holds for its own image size only"
        )
