"""Both trackers on drawn frames with known truth: errors, glare, decoys, and what is no fish."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from fishmj.base.errors import ConfigError, UnknownName
from fishmj.deploy.loopback.camera_frames import FishLook, FrameArtist, FrameOptions, TagPlate
from fishmj.deploy.tracker import AprilTagTracker, ColourTracker, Paint
from studies.tracker import cases

cv2 = pytest.importorskip("cv2")
STILL = (0.0, 0.0, 0.0)


def artist_and_tracker(method: str, options: FrameOptions | None = None, **case):
    made = cases.Case(name=method, method=method, **case)
    calibration = made.camera()
    look = FishLook.of("fish", method, plate=made.plate)
    return FrameArtist(calibration, look, options), made.tracker(calibration)


@pytest.mark.parametrize("method", ["tag", "colour"])
def test_a_clean_frame_gives_the_pose(method):
    artist, tracker = artist_and_tracker(method)
    for pose in ((0.0, 0.0, 0.0), (1.2, 0.6, 2.5), (-1.3, -0.5, -1.9), (0.7, -0.6, -3.1)):
        tracker.reset()
        fix = tracker.locate(artist.draw(pose, (0.3, 0.4, 0.2), 1.0), 1.0)
        assert fix is not None and fix.t == 1.0
        assert np.hypot(fix.x - pose[0], fix.y - pose[1]) < 0.002
        assert abs((fix.yaw - pose[2] + np.pi) % (2 * np.pi) - np.pi) < np.radians(1.0)
        assert fix.quality > 0.8 and np.linalg.eigvalsh(fix.covariance).min() > 0


@pytest.mark.parametrize("method", ["tag", "colour"])
def test_the_gates_hold_on_a_short_swim(method):
    clean, glare = (case for case in cases.gated() if case.method == method)
    measured = cases.run(clean, 25, seed=4).figures()
    assert measured["rms_mm"] < 3 and measured["rms_deg"] < 1.5 and measured["fixes_%"] >= 99
    measured = cases.run(glare, 14, seed=6)
    found = measured.figures()
    assert measured.covered.max() > 0.05, "glints do cover the marks"
    assert found["rms_mm"] < 6 and found["rms_deg"] < 3 and found["fixes_%"] >= 85 and found["false_locks"] == 0


@pytest.mark.slow
@pytest.mark.parametrize("method", ["tag", "colour"])
def test_no_decoy_is_taken_for_the_fish(method):
    for case in cases.decoys(method):
        found = cases.run(case, 300, seed=9).figures()
        assert found["false_locks"] == 0
        assert found["fixes_%"] == 0 if case.absent else found["fixes_%"] > 80


@pytest.mark.parametrize("method", ["tag", "colour"])
def test_a_decoy_beside_the_fish_and_alone(method):
    beside, alone = cases.decoys(method)
    simple = replace(cases.CLEAN, decoy=True)
    found = cases.run(replace(beside, options=simple, cold=True), 12, seed=2).figures()
    assert found["fixes_%"] == 100 and found["false_locks"] == 0 and found["rms_mm"] < 3
    assert cases.run(replace(alone, options=simple), 5, seed=2).figures()["fixes_%"] == 0


def red_object(frame: np.ndarray, at, angle: float) -> None:
    ring = cv2.ellipse2Poly(tuple(int(v) for v in at), (23, 11), int(np.degrees(angle)), 0, 360, 10)
    cv2.fillPoly(frame, [ring], (38, 34, 205))


def test_a_red_object_at_the_neck_of_a_fish_without_a_head_is_no_fish():
    """The yellow of the fish, and red at the right distance from it, but lying across."""
    artist, tracker = artist_and_tracker("colour")
    calibration = tracker.calibration
    look = replace(artist.look, head=None)
    frame = FrameArtist(calibration, look, FrameOptions()).draw(STILL, STILL, 0.0)
    neck = np.array([-0.009, 0.0])
    side = calibration.to_pixel([neck + [0.0, 0.115]])[0]
    red_object(frame, side, 0.0)  # beside the neck, its long axis along the fish
    assert tracker.locate(frame, 0.0) is None


def test_two_fish_are_no_fix():
    artist, tracker = artist_and_tracker("colour")
    one, two = (artist.draw((x, 0.1, 0.5), STILL, 0.0).astype(int) for x in (-0.8, 0.8))
    half = np.concatenate([one[:, :640], two[:, 640:]], 1).astype(np.uint8)
    assert tracker.locate(one.astype(np.uint8), 0.0) is not None
    tracker.reset()
    assert tracker.locate(half, 0.0) is None


def test_two_tags_of_one_number_are_no_fix():
    artist, tracker = artist_and_tracker("tag")
    one, two = (artist.draw((x, 0.1, 0.5), STILL, 0.0) for x in (-0.8, 0.8))
    assert tracker.locate(np.concatenate([one[:, :640], two[:, 640:]], 1), 0.0) is None


def test_a_tag_of_another_number_or_another_size_is_not_ours():
    artist, tracker = artist_and_tracker("tag")
    frame = artist.draw((0.2, 0.1, 0.5), STILL, 0.0)
    calibration = tracker.calibration
    assert tracker.locate(frame, 0.0) is not None
    assert AprilTagTracker(calibration, number=1, mount=(0.06, 0, 0), height=0.03).locate(frame, 0.0) is None
    assert AprilTagTracker(calibration, size=0.08, mount=(0.06, 0, 0), height=0.03).locate(frame, 0.0) is None


@pytest.mark.parametrize("method", ["tag", "colour"])
def test_a_part_that_is_covered_does_not_pull_the_pose(method):
    """A leaf over a third of the marks: a plain centroid of the red would move by more than a centimetre."""
    artist, tracker = artist_and_tracker(method)
    pose = (0.2, -0.1, 0.7)
    frame = artist.draw(pose, STILL, 0.0)
    assert tracker.locate(frame, 0.0) is not None
    front = cases.PAINT.head[2][0] if method == "colour" else 0.07
    leaf = np.array([(front, -0.05), (0.2, -0.05), (0.2, 0.05), (front, 0.05)]) if method == "colour" else None
    leaf = np.array([(front, -0.05), (0.2, -0.05), (0.2, 0.002), (front, 0.002)]) if leaf is None else leaf
    c, s = np.cos(pose[2]), np.sin(pose[2])
    pixels = tracker.calibration.to_pixel(leaf @ np.array([[c, s], [-s, c]]) + pose[:2])
    cv2.fillPoly(frame, [np.round(pixels).astype(np.int32)], (52, 88, 92))
    fix = tracker.locate(frame, 0.02)
    assert fix is not None and fix.quality < 1.0
    assert np.hypot(fix.x - pose[0], fix.y - pose[1]) < 0.003 and abs(fix.yaw - pose[2]) < np.radians(1.5)


@pytest.mark.parametrize("method", ["tag", "colour"])
def test_the_fish_is_found_again_after_it_was_out_of_sight(method):
    artist, tracker = artist_and_tracker(method)
    empty = artist.draw((9.0, 9.0, 0.0), STILL, 0.0)
    assert tracker.locate(artist.draw((-1.0, 0.4, 1.0), STILL, 0.0), 0.0) is not None
    assert tracker.locate(empty, 0.02) is None
    fix = tracker.locate(artist.draw((1.0, -0.4, -2.0), STILL, 0.04), 0.04)
    assert fix is not None and fix.x == pytest.approx(1.0, abs=0.003)


def test_the_lag_of_the_camera_is_in_the_stamp():
    artist, tracker = artist_and_tracker("tag")
    tracker.calibration = replace(tracker.calibration, lag=0.04)
    fix = tracker.locate(artist.draw((0.1, 0.1, 0.0), STILL, 0.0), 5.0)
    assert fix is not None and fix.t == pytest.approx(4.96)


@pytest.mark.parametrize("method", ["tag", "colour"])
@pytest.mark.parametrize(
    "frame", [np.zeros((720, 1281, 3), np.uint8), np.zeros((720, 1280), np.uint8), np.zeros((720, 1280, 3)), None]
)
def test_a_frame_of_another_size_is_refused(method, frame):
    _, tracker = artist_and_tracker(method)
    with pytest.raises(ConfigError, match="1280"):
        tracker.locate(frame, 0.0)


@pytest.mark.parametrize("frame", [np.zeros, np.ones, lambda s, d: np.random.default_rng(0).integers(0, 256, s).astype(d)])
@pytest.mark.parametrize("method", ["tag", "colour"])
def test_frames_without_any_sense_give_no_fix(method, frame):
    _, tracker = artist_and_tracker(method)
    assert tracker.locate(frame((720, 1280, 3), np.uint8), 0.0) is None


def test_impossible_trackers_are_refused():
    calibration = cases.Case(name="x").camera()
    with pytest.raises(UnknownName, match="36h11"):
        AprilTagTracker(calibration, "36h12")
    with pytest.raises(ConfigError, match="0 to 29"):
        AprilTagTracker(calibration, "16h5", number=30)
    with pytest.raises(ConfigError, match="below the camera"):
        AprilTagTracker(calibration, height=3.5)
    with pytest.raises(ConfigError, match="x rising"):
        ColourTracker(calibration, Paint(head=((0.1, 0.05), (0.05, 0.05)), neck=((-0.03, 0.05), (0.01, 0.05))))
    with pytest.raises(ConfigError, match="red before the yellow"):
        ColourTracker(calibration, Paint(head=((-0.03, 0.05), (0.01, 0.05)), neck=((0.05, 0.05), (0.1, 0.05))))
    with pytest.raises(ConfigError, match="px"):
        ColourTracker(calibration, Paint(head=((0.05, 0.05), (0.1, 0.05)), neck=((0.0, 0.01), (0.003, 0.01))))


def test_a_mount_turned_by_a_right_angle_gives_the_same_pose():
    plate = TagPlate(mount=(0.04, 0.01, np.pi / 2))
    artist, tracker = artist_and_tracker("tag", plate=plate)
    fix = tracker.locate(artist.draw((0.3, 0.2, 1.0), STILL, 0.0), 0.0)
    assert fix is not None and fix.pose == pytest.approx([0.3, 0.2, 1.0], abs=0.01)


def test_the_trackers_need_numpy_and_opencv_alone():
    heavy = ("mujoco", "jax", "warp", "numba", "scipy", "matplotlib", "pydantic", "gymnasium", "torch")
    code = f"""
import sys
for name in {heavy}:
    sys.modules[name] = None
import numpy as np
from fishmj.deploy.tracker import AprilTagTracker, ColourTracker, Paint, track_video
assert "cv2" not in sys.modules, "loaded at the first use"
from fishmj.deploy.tracker.calibration import overhead
seen = overhead((1280, 720), 0.0028, 3.0)
paint = Paint(head=((0.05, 0.06), (0.17, 0.02)), neck=((-0.03, 0.05), (0.01, 0.05)))
for tracker in (AprilTagTracker(seen), ColourTracker(seen, paint)):
    assert tracker.locate(np.zeros((720, 1280, 3), np.uint8), 0.0) is None
"""
    subprocess.run([sys.executable, "-c", code], check=True)
