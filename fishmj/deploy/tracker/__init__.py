"""Position of the fish: calibration of the camera, an AprilTag tracker, a colour tracker. NumPy and OpenCV only.

See docs/tank/tracker.md.
"""

from fishmj.deploy.tracker.apriltag import AprilTagTracker
from fishmj.deploy.tracker.calibration import Calibration, Mark, MarksFit, homography_from_marks
from fishmj.deploy.tracker.colour import ColourTracker, Paint
from fishmj.deploy.tracker.fix import Fix, Tracker
from fishmj.deploy.tracker.intrinsics import Board, Intrinsics, calibrate_intrinsics
from fishmj.deploy.tracker.video_tracking import Tracked, track_video

__all__ = [
    "AprilTagTracker",
    "Board",
    "Calibration",
    "ColourTracker",
    "Fix",
    "Intrinsics",
    "Mark",
    "MarksFit",
    "Paint",
    "Tracked",
    "Tracker",
    "calibrate_intrinsics",
    "homography_from_marks",
    "track_video",
]
