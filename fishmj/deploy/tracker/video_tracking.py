"""Tracks the poses in a video file into a trial folder, with an overlay video.

track_video("swim.mp4", tracker, "runs/swim", overlay="runs/swim.overlay.mp4", progress=lambda done, total, fixes: ...)
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fishmj.base.calib import shown_path
from fishmj.base.errors import LogError, StoreError
from fishmj.base.plain_file import why_unreadable
from fishmj.base.store import put_in_place, temporary_beside
from fishmj.deploy.tracker.apriltag import AprilTagTracker
from fishmj.deploy.tracker.fix import Fix, Tracker
from fishmj.log import Trial, write_trial
from fishmj.mjcf.from_above import opencv

LOOKED = 20  # frames without a fix whose mirror image is read too
AXIS = 0.1  # m, length of the drawn heading
GOOD, POOR, TEXT = (80, 220, 90), (40, 140, 250), (250, 250, 250)  # BGR


class Tracked(NamedTuple):
    """Result of tracking a video."""

    folder: Path  # of the trial
    frames: int
    fixes: int
    rate: float  # frames a second of the video, by its stamps
    overlay: Path | None


def track_video(
    path: str | Path,
    tracker: Tracker,
    folder: str | Path,
    *,
    overlay: str | Path | None = None,
    meta: dict[str, Any] | None = None,
    overwrite: bool = False,
    progress: Callable[[int, int, int], None] | None = None,
) -> Tracked:
    """Tracks a fish through a video file and writes the trial: table `pose` (t, x, y, yaw, quality), a row for every fix.

    t is the video's own stamp of a frame less the camera's lag, s, from 0; yaw is unwrapped. Frames without a fix have no row.

    Args:
        folder: of the trial; with `overwrite` an existing one is replaced. overlay: file.mp4 of the frames with the result.
        meta: entries of meta.toml besides those from the video. progress: receives (frames done, frames in all or 0, fixes).

    Raises:
        LogError: no video, a damaged one, or one in which the fish is never found. ConfigError: frames of another size than the
            calibration's. StoreError: the folder exists, or cannot be written.
    """
    cv2, path, folder = opencv("tracking a video"), Path(path), Path(folder)
    if wrong := why_unreadable(path, "a video"):
        raise LogError(f"{shown_path(path)}: {wrong}; expected a video file")
    if folder.exists() and not overwrite:
        raise StoreError(f"{shown_path(folder)}: exists; choose another name or pass overwrite=True")
    video = cv2.VideoCapture(str(path))
    writer, rows, done, rate, mirrored = None, [], 0, 0.0, ""
    hidden = None if overlay is None else temporary_beside(Path(overlay), ".mp4")
    try:
        if not video.isOpened():
            raise LogError(f"{shown_path(path)}: OpenCV cannot read it as a video; convert it to MP4 (H.264) and try again")
        total, told = max(int(video.get(cv2.CAP_PROP_FRAME_COUNT)), 0), float(video.get(cv2.CAP_PROP_FPS))
        last = -1.0
        while True:
            there, frame = video.read()
            if not there:
                break
            t = _stamp(video.get(cv2.CAP_PROP_POS_MSEC) / 1000, last, told, done)
            last, done = t, done + 1
            fix = tracker.locate(frame, t)
            if fix is not None:
                rows.append((fix.t, fix.x, fix.y, fix.yaw, fix.quality))
            elif not (rows or mirrored) and done <= LOOKED and isinstance(tracker, AprilTagTracker):
                mirrored = f"tag {tracker.number}" if tracker.reads_mirrored(frame) else ""
            if hidden is not None:
                if writer is None:
                    writer = _writer(cv2, hidden, told, frame)
                writer.write(drawn(frame, fix, tracker))
            if progress is not None:
                progress(done, total, len(rows))
        if not done:
            raise LogError(f"{shown_path(path)}: not one frame could be read; the file is damaged or cut short")
        if not rows and mirrored:
            raise LogError(
                f"{shown_path(path)}: no fix in {done} frames, and {mirrored} in their mirror image: the picture is flipped;"
                " switch the mirror of the camera or its driver off and film again"
            )
        if not rows:
            raise LogError(
                f"{shown_path(path)}: no fix in {done} frames; check the calibration, the light, and the tag's number and size"
                " or the paint"
            )
        rate = (done - 1) / last if last > 0 else told
        if writer is not None:
            writer.release()
        t, x, y, yaw, quality = np.array(rows).T
        pose = {"t": t - min(t[0], 0.0), "x": x, "y": y, "yaw": np.unwrap(yaw), "quality": quality}
        lag = tracker.calibration.lag if hasattr(tracker, "calibration") else 0.0
        known = {"origin": "measured", "clock": {"pose": "video"}, "source": path.name, "latency": {"camera_lag": lag}}
        known["notes"] = f"{len(rows)} fixes in {done} frames by {type(tracker).__name__}"
        write_trial(folder, Trial(known | (meta or {}), {"pose": pose}), overwrite=overwrite)
        if hidden is not None:
            put_in_place(hidden, Path(overlay))  # type: ignore[arg-type]
    finally:
        video.release()
        if writer is not None:
            writer.release()
        if hidden is not None:
            hidden.unlink(missing_ok=True)
    return Tracked(folder, done, len(rows), rate, None if overlay is None else Path(overlay))


def drawn(frame: np.ndarray, fix: Fix | None, tracker: Tracker) -> np.ndarray:
    """A copy of a frame with the found marks, the heading from the reference point, and the quality."""
    cv2, image = opencv("an overlay"), frame.copy()
    if fix is None:
        cv2.putText(image, "no fix", (12, 28), cv2.FONT_HERSHEY_SIMPLEX, 0.8, POOR, 2, cv2.LINE_AA)
        return image
    colour = GOOD if fix.quality > 0.5 else POOR
    cv2.polylines(image, [np.round(fix.outline * 16).astype(np.int32).reshape(-1, 1, 2)], True, colour, 1, cv2.LINE_AA, 4)
    calibration = getattr(tracker, "calibration", None)
    if calibration is not None:
        ahead = AXIS * np.array([np.cos(fix.yaw), np.sin(fix.yaw)])
        tail, head = calibration.to_pixel(fix.pose[:2] + np.array([[0.0, 0.0], ahead]), getattr(tracker, "height", 0.0))
        cv2.arrowedLine(image, tuple(int(v) for v in tail), tuple(int(v) for v in head), colour, 2, cv2.LINE_AA, tipLength=0.25)
    text = f"t {fix.t:7.2f} s   x {fix.x:+.3f} m   y {fix.y:+.3f} m   yaw {np.degrees(fix.yaw):+6.1f} deg"
    text += f"   quality {fix.quality:.2f}"
    cv2.putText(image, text, (12, 28), cv2.FONT_HERSHEY_SIMPLEX, 0.6, TEXT, 1, cv2.LINE_AA)
    return image


def _stamp(told: float, last: float, rate: float, done: int) -> float:
    """The video's own stamp [s]; in a container without rising stamps, the frame's number over the frame rate."""
    if np.isfinite(told) and told > last:
        return told
    return max(done / rate if rate > 0 else 0.02 * done, last + 1e-3)


def _writer(cv2, path: Path, rate: float, frame: np.ndarray) -> Any:
    """A writer of MP4. Raises StoreError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), rate if rate > 0 else 50.0, frame.shape[1::-1])
    if not writer.isOpened():
        raise StoreError(f"{shown_path(path)}: OpenCV cannot write an MP4 here; check the folder, or do without the overlay")
    return writer
