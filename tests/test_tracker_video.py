"""A video file becomes a trial folder and an overlay."""

import numpy as np
import pytest

from fishmj.base.errors import ConfigError, LogError, StoreError
from fishmj.deploy.loopback.camera_frames import FishLook, FrameArtist
from fishmj.deploy.tracker import track_video
from fishmj.log import read_trial
from studies.tracker import cases

cv2 = pytest.importorskip("cv2")
FRAMES, RATE = 12, 25.0


def pose(k: int) -> tuple[float, float, float]:
    """Turns through the cut of the angle at pi."""
    return (0.02 * k, 0.1, 3.1 + 0.01 * k)


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    path = tmp_path_factory.mktemp("video") / "swim.avi"
    case = cases.Case(name="video")
    artist = FrameArtist(case.camera(), FishLook.of("fish", "tag"))
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), RATE, cases.SIZE)
    for k in range(FRAMES):
        away = (9.0, 9.0, 0.0)
        writer.write(artist.draw(away if k in (3, 4) else pose(k), (0.0, 0.0, 0.0), k / RATE))
    writer.release()
    return path


def tracker():
    case = cases.Case(name="video")
    return case.tracker(case.camera())


def test_a_video_becomes_a_trial_with_its_own_stamps(video, tmp_path):
    told = []
    done = track_video(video, tracker(), tmp_path / "trial", overlay=tmp_path / "seen.mp4", progress=lambda *n: told.append(n))
    assert (done.frames, done.fixes) == (FRAMES, FRAMES - 2) and done.rate == pytest.approx(RATE)
    assert told[-1] == (FRAMES, FRAMES, FRAMES - 2)
    table = read_trial(tmp_path / "trial").table("pose")
    kept = [k for k in range(FRAMES) if k not in (3, 4)]
    assert table["t"] == pytest.approx(np.array(kept) / RATE, abs=1e-6)
    truth = np.array([pose(k) for k in kept])
    assert np.abs(table["x"] - truth[:, 0]).max() < 0.003 and np.abs(table["y"] - truth[:, 1]).max() < 0.003
    assert np.abs(table["yaw"] - truth[:, 2]).max() < 0.02, "unwrapped: it passes pi"
    assert ((table["quality"] > 0) & (table["quality"] <= 1)).all()
    seen = cv2.VideoCapture(str(tmp_path / "seen.mp4"))
    there, frame = seen.read()
    assert there and frame.shape == (720, 1280, 3) and int(seen.get(cv2.CAP_PROP_FRAME_COUNT)) == FRAMES
    assert sorted(p.name for p in tmp_path.iterdir()) == ["seen.mp4", "trial"], "no temporary file stays"


def test_a_trial_that_is_there_is_not_replaced_unasked(video, tmp_path):
    (tmp_path / "trial").mkdir()
    (tmp_path / "trial" / "mine.txt").write_text("kept")
    with pytest.raises(StoreError, match="exists"):
        track_video(video, tracker(), tmp_path / "trial")
    assert (tmp_path / "trial" / "mine.txt").read_text() == "kept"


@pytest.mark.parametrize("content", [b"", b"no video at all" * 100])
def test_what_is_no_video_is_refused_and_leaves_nothing(tmp_path, content):
    path = tmp_path / "broken.mp4"
    path.write_bytes(content)
    with pytest.raises(LogError, match="broken.mp4"):
        track_video(path, tracker(), tmp_path / "trial", overlay=tmp_path / "seen.mp4")
    assert [p.name for p in tmp_path.iterdir()] == ["broken.mp4"]


def test_a_video_without_the_fish_says_what_to_check(video, tmp_path):
    other = tracker()
    other.number, other.pattern = 5, other.pattern
    other = type(other)(other.calibration, number=5, mount=other.mount, height=other.height)
    with pytest.raises(LogError, match="no fix in 12 frames"):
        track_video(video, other, tmp_path / "trial", overlay=tmp_path / "seen.mp4")
    assert list(tmp_path.iterdir()) == []


def test_a_video_of_another_size_is_refused(tmp_path):
    path = tmp_path / "small.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 25.0, (640, 480))
    writer.write(np.zeros((480, 640, 3), np.uint8))
    writer.release()
    with pytest.raises(ConfigError, match="image size"):
        track_video(path, tracker(), tmp_path / "trial")


def test_a_mirrored_picture_of_the_tag_is_named(video, tmp_path):
    source = cv2.VideoCapture(str(video))
    size = tuple(int(source.get(key)) for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
    writer = cv2.VideoWriter(str(tmp_path / "flipped.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 25.0, size)
    while (frame := source.read())[0]:
        writer.write(cv2.flip(frame[1], 1))
    writer.release()
    with pytest.raises(LogError, match=r"no fix in 12 frames, and tag 0 in their mirror image: the picture is flipped"):
        track_video(tmp_path / "flipped.avi", tracker(), tmp_path / "trial")
