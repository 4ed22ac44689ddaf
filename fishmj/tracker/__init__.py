"""Where the fish is: calibration of the camera, an AprilTag tracker, a colour tracker. NumPy and OpenCV only.

See docs/methods/tracker.md.
"""

from fishmj.tracker.apriltag import AprilTagTracker
from fishmj.tracker.calibration import Calibration, Mark, MarksFit, homography_from_marks
from fishmj.tracker.colour import ColourTracker, Paint
from fishmj.tracker.fix import Fix, Tracker
from fishmj.tracker.intrinsics import Board, Intrinsics, calibrate_intrinsics
from fishmj.tracker.video import Tracked, track_video

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
