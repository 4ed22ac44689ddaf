"""Frames of a swim with known truth, and the tracker's results on them."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from fishmj.deploy.loopback.camera_frames import FishLook, FrameArtist, FrameOptions, TagPlate
from fishmj.deploy.tracker.apriltag import AprilTagTracker
from fishmj.deploy.tracker.calibration import Calibration, overhead
from fishmj.deploy.tracker.colour import PAPER_FISH, ColourTracker
from fishmj.deploy.tracker.fix import Fix, Tracker, wrapped
from fishmj.mjcf.from_above import opencv

SIZE, FOCAL = (1280, 720), 3.0 / 0.0028  # px; px of the drawn lens: 2.8 mm/px from 3 m
LENS = (-0.12, 0.03, 0.001, -0.0008, 0.0)  # k1 k2 p1 p2 k3
FRAME = 0.02  # s
AFRESH = 500  # frames after which a tracker of a long run forgets the fish, and has to find it in the whole frame
PAINT = PAPER_FISH
CLEAN = FrameOptions()
GLARE = FrameOptions(glare=1.0, ripple=1.0, exposure=0.005, light=0.1)
FALSE_LOCK = (0.05, np.radians(20))  # m, rad: a fix farther from the truth is of something else


@dataclass(frozen=True, kw_only=True)
class Case:
    """One tracker, one camera, one kind of frames. `cold`: the tracker forgets the fish before every frame."""

    name: str
    method: str = "tag"  # tag, colour
    options: FrameOptions = CLEAN
    metres_per_pixel: float = 0.0028
    plate: TagPlate = field(default_factory=TagPlate)
    cold: bool = False
    absent: bool = False  # the fish is out of sight

    def camera(self) -> Calibration:
        """Drawn camera, slightly tilted."""
        height = FOCAL * self.metres_per_pixel
        return overhead(SIZE, self.metres_per_pixel, height, distortion=LENS, tilt=(0.03, -0.02), turn=0.1)

    def tracker(self, calibration: Calibration) -> Tracker:
        """Tracker with a typical user's settings."""
        if self.method == "colour":
            return ColourTracker(calibration, PAINT, height=-0.005)
        p = self.plate
        return AprilTagTracker(calibration, p.family, p.size, p.mount, p.number, p.height)


class Measured(NamedTuple):
    """Results of a case, frame by frame."""

    truth: np.ndarray  # (n, 3) m, m, rad
    error: np.ndarray  # (n, 3), NaN where there was no fix
    sigma: np.ndarray  # (n, 3) that the fixes claim
    seconds: np.ndarray  # (n,) of CPU a frame
    covered: np.ndarray  # (n,) share of the marks under saturated light

    def figures(self) -> dict[str, Any]:
        """Row of the table."""
        fixed = np.isfinite(self.error[:, 0])
        e = self.error[fixed]
        far = np.hypot(*e[:, :2].T) if len(e) else np.zeros(0)
        wrong = (far > FALSE_LOCK[0]) | (np.abs(e[:, 2]) > FALSE_LOCK[1])
        rms = lambda v: float(np.sqrt(np.mean(v**2))) if len(v) else float("nan")
        return {
            "frames": len(self.error),
            "fixes_%": 100 * float(fixed.mean()),
            "rms_mm": 1e3 * rms(far),
            "rms_deg": float(np.degrees(rms(e[:, 2]))),
            "p99_mm": 1e3 * float(np.percentile(far, 99)) if len(e) else float("nan"),
            "false_locks": int(wrong.sum()),
            "claimed_mm": 1e3 * rms(np.hypot(*self.sigma[fixed, :2].T)),
            "claimed_deg": float(np.degrees(rms(self.sigma[fixed, 2]))),
            "frames/s": 1 / float(self.seconds.mean()),
            "p99_ms": 1e3 * float(np.percentile(self.seconds, 99)),
            "glint_%": 100 * float(np.mean(self.covered > 0.02)),
        }


def swim(seed: int, reach: np.ndarray) -> Callable[[float], tuple[np.ndarray, np.ndarray]]:
    """Path (pose, velocity) over time through the view +-reach (2,) m: sums of sines, every heading, a beating head."""
    random = np.random.default_rng([seed, 77])
    phases, rates = random.uniform(0, 2 * np.pi, (3, 2)), random.uniform(0.13, 0.31, (3, 2))
    turn, swing = random.uniform(-0.5, 0.5), random.uniform(0.5, 1.2)

    def pose(t: float) -> np.ndarray:
        xy = reach * np.sin(rates[:2] * t + phases[:2]).mean(1)
        heading = turn * t + swing * np.sin(0.7 * t + phases[2, 0]) + 0.14 * np.sin(2 * np.pi * t + phases[2, 1])
        return np.array([*xy, heading])

    return lambda t: (pose(t), (pose(t + 1e-4) - pose(t - 1e-4)) / 2e-4)


def run(case: Case, frames: int, seed: int = 0, tick: Callable[[int], None] | None = None) -> Measured:
    """Draws and tracks frames; `tick` is called after every frame with the number done.

    Seconds are the tracker's own CPU time.
    """
    cv2, calibration = opencv("the tracker study"), case.camera()
    artist = FrameArtist(calibration, FishLook.of("fish", case.method, plate=case.plate), replace(case.options, seed=seed))
    tracker = case.tracker(calibration)
    reach = np.array(SIZE) * case.metres_per_pixel * 0.5 - 0.28
    path = swim(seed, reach * 1.3)  # a mean of two sines hardly ever meets its bound
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    nan, rows, error, sigma, seconds, covered = np.full(3, np.nan), [], [], [], [], []
    try:
        for k in range(frames):
            t = k * FRAME
            pose, velocity = path(t)
            pose[:2] = pose[:2].clip(-reach, reach)
            shown = np.array([50.0, 50.0, 0.0]) if case.absent else pose
            joint = np.radians(30) * np.sin(2 * np.pi * t - np.radians(60) * np.arange(3))
            frame = artist.draw(shown, joint, t, velocity)
            if case.cold or k % AFRESH == 0:
                tracker.reset()
            begun = time.process_time()
            fix = tracker.locate(frame, t)
            seconds.append(time.process_time() - begun)
            rows.append(pose)
            error.append(nan if fix is None else _error(fix, pose))
            sigma.append(nan if fix is None else np.sqrt(np.diag(fix.covariance)))
            covered.append(_covered(cv2, frame, calibration, case, pose))
            if tick is not None:
                tick(k + 1)
    finally:
        cv2.setNumThreads(threads)
    return Measured(*map(np.array, (rows, error, sigma, seconds, covered)))


def _error(fix: Fix, truth: np.ndarray) -> np.ndarray:
    return np.array([fix.x - truth[0], fix.y - truth[1], wrapped(fix.yaw - truth[2])])


def _covered(cv2, frame: np.ndarray, calibration: Calibration, case: Case, pose: np.ndarray) -> float:
    """Share of the marks' rectangle under saturated light."""
    if case.options.glare == 0:
        return 0.0
    reach = 0.5 * case.plate.size
    ends = np.array([-0.03, 0.175]) if case.method == "colour" else case.plate.mount[0] + np.array([-reach, reach])
    half = 0.028 if case.method == "colour" else reach
    c, s = np.cos(pose[2]), np.sin(pose[2])
    box = np.array([(ends[0], -half), (ends[1], -half), (ends[1], half), (ends[0], half)])
    box = box @ np.array([[c, s], [-s, c]]) + pose[:2]
    mask = np.zeros(frame.shape[:2], np.uint8)
    cv2.fillConvexPoly(mask, np.round(calibration.to_pixel(box) * 16).astype(np.int32), 1, cv2.LINE_8, 4)
    inside = mask > 0
    return float(np.mean(frame[inside].min(1) >= 246)) if inside.any() else 0.0


GATES = {"clean": (3.0, 1.5, 99.0), "glare": (6.0, 3.0, 90.0)}  # mm, deg, % of frames with a fix
FASTEST = 60.0  # frames a second on one core that a tracker must reach


def gated() -> list[Case]:
    """Cases with a bound, both methods."""
    both = []
    for method in ("tag", "colour"):
        both += [Case(name=f"{method} clean", method=method), Case(name=f"{method} glare", method=method, options=GLARE)]
    return both


def reported() -> list[Case]:
    """Cases that are reported without a bound."""
    more = []
    for method in ("tag", "colour"):
        of = lambda name, method=method, **k: Case(name=f"{method} {name}", method=method, options=replace(CLEAN, **k))
        more += [of("glints only", glare=1.0), of("waves only", ripple=1.0), of("leaf over a quarter", occlusion=0.25)]
        more += [of("blur 10 ms, JPEG 75", exposure=0.01, jpeg=75), of("noise 8", noise=8.0), of("light +-40 %", light=0.4)]
    at = lambda name, method, options, **k: Case(name=name, method=method, options=options, metres_per_pixel=0.005, **k)
    for label, options in (("clean", CLEAN), ("glare", GLARE)):
        more.append(at(f"colour 5 mm/px {label}", "colour", options))
        for family, size in (("36h11", 0.1), ("16h5", 0.1), ("16h5", 0.06)):
            plate = TagPlate(family=family, size=size)
            more.append(at(f"{family} {1e3 * size:.0f} mm 5 mm/px {label}", "tag", options, plate=plate))
    return more


def heights() -> list[Case]:
    """Cases of tags by camera height: every frame is read without memory."""
    return [
        Case(
            name=f"{family} {1e3 * size:.0f} mm at {1e3 * scale:g} mm/px",
            plate=TagPlate(family=family, size=size),
            metres_per_pixel=scale,
            options=replace(CLEAN, exposure=0.005),
            cold=True,
        )
        for family in ("36h11", "16h5")
        for size in (0.06, 0.08, 0.1)
        for scale in (0.002, 0.0028, 0.004, 0.005, 0.0065)
    ]


def decoys(method: str) -> list[Case]:
    """Cases with a second red object, which has a tag of another number if the fish has one: beside the fish, and alone."""
    options = replace(CLEAN, glare=1.0, decoy=True)  # glints make the fish vanish; waves would only move both
    beside = Case(name=f"{method} beside a decoy", method=method, options=options)
    return [beside, replace(beside, name=f"{method} decoy alone", absent=True)]
