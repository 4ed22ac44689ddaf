"""Trackers of marks: one look where the last poses lead, then one at the whole frame."""

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.deploy.tracker.alignment import Aligned
from fishmj.deploy.tracker.calibration import Calibration
from fishmj.deploy.tracker.fix import Fix, PosePredictor, placed, widened, wrapped


class MarkTracker:
    """Finds marks of a known shape on one fish.

    Attributes:
        outline: (n, 2) m of the marks in the body frame. half: m that a window reaches beyond their middle.
        height: m of the marks over the water plane. scale: m/px there. unseen: m and rad, standard deviations of errors that
            one frame does not show; added to the covariance.
    """

    calibration: Calibration
    height: float
    unseen: tuple[float, float]
    motion: PosePredictor
    scale: float
    outline: np.ndarray
    half: float

    def reset(self) -> None:
        """Forgets the last pose of the fish."""
        self.motion.clear()

    def locate(self, image: np.ndarray, t: float) -> Fix | None:
        """The fish in a frame (H, W, 3) uint8 BGR stamped t [s]; None if it is not visible, or if there are two candidates.

        Raises ConfigError: an image of another size than the calibration's.
        """
        self._refuse_other_size(image)
        stamp = t - self.calibration.lag
        expected = self.motion.expected(stamp)
        found = None if expected is None else self._near(image, expected[0], self._window(*expected[:2]))
        found = found or self._anywhere(image)
        if found is None:
            return None
        quality = float(np.clip((found.match - 0.5) / 0.45, 0, 1) * min(1.0, found.seen))
        outline = self.calibration.to_pixel(placed(self.outline, found.pose), self.height)
        x, y, yaw = found.pose
        fix = Fix(stamp, float(x), float(y), wrapped(yaw), widened(found.covariance, self.unseen), quality, outline)
        self.motion.add(fix)
        return fix

    def _near(self, image: np.ndarray, pose: np.ndarray, window: tuple[int, int, int, int]) -> Aligned | None:
        """The marks near their expected pose, or else in the window round it."""
        raise NotImplementedError

    def _anywhere(self, image: np.ndarray) -> Aligned | None:
        """The marks in the whole frame."""
        raise NotImplementedError

    def _window(self, pose: np.ndarray, reach: float) -> tuple[int, int, int, int]:
        """Left, top, right, bottom px of the region that may hold the marks."""
        middle = self.calibration.to_pixel(placed(self.outline, pose).mean(0), self.height)[0]
        half = (self.half + reach) / self.scale
        low, high = np.floor(middle - half).astype(int), np.ceil(middle + half).astype(int) + 1
        width, height = self.calibration.size
        return max(low[0], 0), max(low[1], 0), min(high[0], width), min(high[1], height)

    def _refuse_other_size(self, image: np.ndarray) -> None:
        width, height = self.calibration.size
        shape, kind = getattr(image, "shape", None), getattr(image, "dtype", None)
        if shape != (height, width, 3) or kind != np.uint8:
            raise ConfigError(
                f"frame of {shape} {kind}, expected ({height}, {width}, 3) uint8: a calibration holds for its own image size only"
            )
