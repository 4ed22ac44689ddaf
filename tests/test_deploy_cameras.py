"""Cameras give pictures with the time they were taken, whatever they are; a localiser gives fixes and never waits."""

import threading
import time
from collections import deque
from types import SimpleNamespace

import numpy as np
import pytest

from fishmj.base.errors import ConfigError, StoreError
from fishmj.deploy.camera import cameras
from fishmj.deploy.camera.cameras import Device, SharedFrames, VideoFile
from fishmj.deploy.camera.localiser import InStep, Newest
from fishmj.deploy.loopback.shared_frames import FrameWriter
from fishmj.deploy.tracker.fix import Fix
from tests.deploying import FakeClock


def image(value, shape=(48, 64, 3)):
    return np.full(shape, value, np.uint8)


@pytest.fixture
def ring():
    writer = FrameWriter(64, 48, 50.0, slots=3)
    yield writer
    writer.close()


def test_the_newest_frame_of_a_ring_comes_once_with_its_stamp(ring):
    camera = SharedFrames(ring.name, FakeClock())
    camera.open()
    assert camera.read(0.0) == []
    for k in range(5):
        ring.write(image(10 * k), 7.0 + k)
    ((t, seen),) = camera.read(0.0)
    assert t == 11.0 and (seen == 40).all()
    assert camera.read(0.0) == []
    for k in range(3):
        ring.write(image(k), 20.0 + k)
    camera.read(0.0)
    assert camera.passed == 2
    camera.close()
    camera.close()
    assert camera.read(0.0) == []


def test_a_frame_that_is_being_written_is_not_taken(ring):
    camera = SharedFrames(ring.name, FakeClock())
    camera.open()
    ring.write(image(1), 1.0)
    ring.header[4] = 1
    ring.begin(1)
    assert camera.read(0.0) == []
    camera.close()


def test_waiting_for_a_ring_ends_in_time(ring):
    clock = FakeClock()
    camera = SharedFrames(ring.name, clock)
    camera.open()
    assert camera.wait(0.1) == [] and 0.1 <= clock.now() - 100.0 < 0.11
    camera.close()


def test_what_is_no_ring_of_frames_is_one_line():
    with pytest.raises(ConfigError, match="no shared memory"):
        SharedFrames("fishmj-no-such-ring").open()
    other = FrameWriter(64, 48, 50.0)
    other.header[0] = 1
    try:
        with pytest.raises(ConfigError, match="no ring of frames"):
            SharedFrames(other.name).open()
    finally:
        other.close()


def test_a_film_is_played_at_its_own_rate(tmp_path):
    cv2 = pytest.importorskip("cv2")
    film = cv2.VideoWriter(str(tmp_path / "film.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 25.0, (64, 48))
    if not film.isOpened():
        pytest.skip("this OpenCV writes no film")
    for k in range(10):
        film.write(image(20 * k))
    film.release()
    clock = FakeClock()
    camera = VideoFile(tmp_path / "film.avi", clock)
    camera.open()
    found = camera.read(clock.now() + 0.1)
    np.testing.assert_allclose([t for t, _ in found], [100.0, 100.04, 100.08])
    clock.t = 100.1
    assert [round(t, 3) for t, _ in camera.wait(0.1)] == [100.12]
    assert len(camera.read(200.0)) == 6 and camera.read(300.0) == []
    camera.close()


def test_what_is_no_film_is_one_line(tmp_path):
    (tmp_path / "film.avi").write_bytes(b"nothing")
    with pytest.raises(StoreError, match="no film"):
        VideoFile(tmp_path / "film.avi", FakeClock()).open()


class FakeDevice:
    """A camera as OpenCV gives it; it takes 1 ms a picture and is unplugged after `left`."""

    def __init__(self, opened=True, left=50):
        self.opened, self.left, self.released = opened, left, False

    def isOpened(self):
        return self.opened

    def set(self, key, value):
        return True

    def grab(self):
        time.sleep(0.001)
        self.left -= 1
        return self.left >= 0

    def retrieve(self):
        return True, image(self.left)

    def release(self):
        self.released = True


def fake_opencv(device):
    keys = ("CAP_PROP_FRAME_WIDTH", "CAP_PROP_FRAME_HEIGHT", "CAP_PROP_FPS", "CAP_PROP_BUFFERSIZE")
    return SimpleNamespace(VideoCapture=lambda number: device, **dict.fromkeys(keys, 0))


def test_a_device_keeps_only_fresh_pictures_and_survives_being_unplugged(monkeypatch):
    device = FakeDevice()
    monkeypatch.setattr(cameras, "cv2", lambda: fake_opencv(device))
    camera = Device(0)
    before = time.monotonic()
    camera.open()
    try:
        found = camera.wait(600.0)
        assert found and before <= found[0][0] <= time.monotonic()
        end = time.monotonic() + 600
        while device.left > -2 and time.monotonic() < end:
            time.sleep(0.01)
        assert 1 <= len(camera.read(0.0)) <= 4
        assert camera.wait(0.02) == []
    finally:
        camera.close()
    assert device.released


def test_a_camera_that_does_not_open_is_one_line(monkeypatch):
    monkeypatch.setattr(cameras, "cv2", lambda: fake_opencv(FakeDevice(opened=False)))
    with pytest.raises(ConfigError, match="plugged in"):
        Device(3).open()


class Frames:
    """A camera from a list; each call of `wait` gives the next entry."""

    def __init__(self, *groups):
        self.groups, self.closed = deque(groups), False
        self.empty = threading.Event()

    def open(self): ...

    def read(self, now):
        if not self.groups:
            self.empty.set()
            return []
        return self.groups.popleft()

    def wait(self, most):
        found = self.read(0.0)
        if not found:
            time.sleep(0.005)
        return found

    def close(self):
        self.closed = True


class Seer:
    """A tracker that finds the fish in bright pictures."""

    def locate(self, image, t):
        if image.max() > 250:
            raise ConfigError("frame of another size")
        return Fix(t, float(image.max()), 0.0, 0.0, np.eye(3), 1.0) if image.max() > 5 else None

    def reset(self): ...


def test_in_step_every_frame_is_looked_at():
    eyes = InStep(Frames([(1.0, image(10)), (1.1, image(0)), (1.2, image(30))]), Seer())
    eyes.open()
    assert [fix.t for fix in eyes.fixes(2.0)] == [1.0, 1.2]
    assert eyes.counts == {"frames": 3, "fixes": 2, "skipped": 0, "repeated": 0}
    eyes.close()
    assert eyes.camera.closed


def test_only_the_newest_frame_that_waits_is_looked_at():
    camera = Frames([(1.0, image(10)), (1.1, image(20))], [(1.2, image(30))])
    eyes = Newest(camera, Seer())
    eyes.open()
    assert [eyes.look(0.1).x for _ in range(2)] == [20.0, 30.0]
    eyes.close()
    assert eyes.counts["skipped"] == 1 and camera.closed
