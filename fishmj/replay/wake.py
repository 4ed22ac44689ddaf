"""The water of a flow-solver run in its replay: vorticity slices, quantised, on the clock and in the colours of the page.

One byte a cell, 128 + 127 omega_z / strong, as grey PNGs: most of the water is at rest and packs away. The page turns bytes
into colours by the table that is made here, the film by the same one.
"""

import base64
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fishmj.errors import ConfigError, MissingExtra, StoreError
from fishmj.lbm_oracle.output.slices import Slice, read_slice, slices_in
from fishmj.log import Trial
from fishmj.replay.scene import Track

BUDGET = 5_000_000  # bytes of all pictures; a third more as text in the page
APART = 0.3  # m: farther from the logged pose, the outline in a slice is another fish's
TONES = (  # value, red, green, blue, opacity: dark water at rest, so that eddies of either sense glow
    (-1.0, 0.80, 1.00, 1.00, 0.98),
    (-0.6, 0.25, 0.82, 1.00, 0.95),
    (-0.25, 0.07, 0.42, 0.95, 0.88),
    (-0.08, 0.03, 0.16, 0.42, 0.70),
    (0.0, 0.01, 0.07, 0.13, 0.62),
    (0.08, 0.36, 0.10, 0.16, 0.70),
    (0.25, 0.86, 0.22, 0.14, 0.88),
    (0.6, 1.00, 0.58, 0.14, 0.95),
    (1.0, 1.00, 0.97, 0.72, 0.98),
)


@dataclass(frozen=True)
class Wake:
    """K slices at height z; `values` (ny, nx) uint8, north up, 128 = no vorticity, 1 and 255 = `strong` 1/s or more."""

    t: np.ndarray  # (K,) s, from the trial's own start
    z: float  # m
    strong: float  # 1/s
    rect: np.ndarray  # (K, 4) west, east, south, north edge, m
    values: tuple[np.ndarray, ...]

    def between(self, time: float) -> tuple[int, float]:
        """Number of the slice before `time` s, and the share of the one after it."""
        i = int(np.clip(np.searchsorted(self.t, time, side="right") - 1, 0, max(len(self.t) - 2, 0)))
        if len(self.t) == 1:
            return 0, 0.0
        return i, float(np.clip((time - self.t[i]) / (self.t[i + 1] - self.t[i]), 0, 1))


def read_wake(folder: str | Path, trial: Trial, track: Track) -> Wake:
    """The slices of a run that fall into its trial.

    Raises:
        ConfigError: no slices, or those of another run. StoreError: a damaged one.
    """
    start = float(trial.tables[track.pose_from]["t"][0])
    slices = [read_slice(path) for path in slices_in(folder)]
    slices = [one for one in slices if -0.5 <= one.t - start <= float(track.t[-1]) + 0.5]
    if not slices:
        raise ConfigError(f"{folder}: no slice in the {track.t[-1]:.2f} s of {track.label!r}; are these the fields of this run?")
    for one in slices:
        _same_fish(folder, one, track, start)
    strong = strongest(np.concatenate([one.omega_z.ravel() for one in slices]))
    images = [_bytes(one.omega_z, strong) for one in slices]
    rect = np.array([one.extent for one in slices])
    return Wake(np.array([one.t - start for one in slices]), slices[0].z, strong, rect, tuple(images))


def strongest(omega: np.ndarray) -> float:
    """A round scale for vorticity [1/s]: 1, 2 or 5 times a power of ten, above nine tenths of what is there."""
    size = np.abs(omega[np.isfinite(omega)])
    moving = size[size > 0.02 * size.max(initial=0.0)]
    high = max(float(np.percentile(moving, 90)) if len(moving) else 0.0, 1e-3)
    power = 10.0 ** np.floor(np.log10(high))
    return float(next(step * power for step in (1, 2, 5, 10) if step * power >= 0.999 * high))


def page_data(wake: Wake, budget: int = BUDGET) -> dict:
    """What the page needs; where the pictures would be too large, cells are averaged two by two."""
    images = list(wake.values)
    while sum(map(len, packed := [_png(image) for image in images])) > budget and min(images[0].shape) >= 16:
        images = [_halved(image) for image in images]
    return {
        "t": wake.t,
        "z": wake.z,
        "strong": wake.strong,
        "rect": wake.rect,
        "colours": base64.b64encode(colours().tobytes()).decode("ascii"),
        "images": [base64.b64encode(data).decode("ascii") for data in packed],
    }


def colours() -> np.ndarray:
    """(256, 4) uint8 RGBA for the bytes of a slice."""
    at, *channels = np.array(TONES).T
    value = (np.arange(256) - 128) / 127
    return (255 * np.stack([np.interp(value, at, channel) for channel in channels], -1) + 0.5).astype(np.uint8)


def _same_fish(folder, one: Slice, track: Track, start: float) -> None:
    if not one.outline:
        return
    rim = np.concatenate(one.outline)
    frame = int(np.clip(round((one.t - start) / track.t[-1] * (len(track.t) - 1)), 0, len(track.t) - 1))
    off = float(np.hypot(*(0.5 * (rim.min(0) + rim.max(0)) - track.q[frame, :2])))
    if off > APART:
        raise ConfigError(
            f"{folder}: at {one.t:.2f} s its fish is {off:.2f} m from where {track.label!r} has it; give the fields of this run"
        )


def _bytes(omega: np.ndarray, strong: float) -> np.ndarray:
    """(nx, ny) 1/s -> (ny, nx) uint8, north up."""
    value = np.clip(np.nan_to_num(omega / strong), -1, 1)
    return (128.5 + 127 * value).astype(np.uint8).T[::-1].copy()


def _halved(image: np.ndarray) -> np.ndarray:
    """Means of two by two cells; an odd last row or column counts double."""
    whole = np.pad(image, [(0, n % 2) for n in image.shape], mode="edge").astype(float)
    return (0.25 * (whole[::2, ::2] + whole[1::2, ::2] + whole[::2, 1::2] + whole[1::2, 1::2]) + 0.5).astype(np.uint8)


def _png(image: np.ndarray) -> bytes:
    try:
        import cv2
    except ModuleNotFoundError as error:
        raise MissingExtra("opencv-python-headless", "all", "replays with the water") from error
    done, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    if not done:
        raise StoreError("replay: OpenCV could not encode a slice as PNG")
    return data.tobytes()
