"""Camera frames of the loopback robot: no torn ones through shared memory, and each camera fault does what it says."""

import threading

import numpy as np
import pytest

from fishmj.base.errors import ConfigError
from fishmj.deploy.camera import cameras
from fishmj.deploy.camera.cameras import SharedFrames
from fishmj.deploy.loopback import bodies
from fishmj.deploy.loopback.camera import CameraTiming
from fishmj.deploy.loopback.faults import parse
from fishmj.deploy.loopback.robot import LoopbackRobot
from fishmj.deploy.loopback.shared_frames import FrameWriter


def grey(value, size=(24, 32)):
    return np.full((*size, 3), value, np.uint8)


@pytest.fixture
def ring():
    writer = FrameWriter(32, 24, 50.0, slots=3)
    reader = SharedFrames(writer.name)
    reader.open()
    yield writer, reader
    reader.close()
    writer.close()


def test_a_frame_that_changes_while_it_is_copied_is_never_given(ring, monkeypatch):
    """Frames whose copy takes so long that the writer laps the reader."""
    writer, reader = ring
    writer.write(grey(1), 1.0)
    plain, laps = cameras.np.frombuffer, []

    def slowly(*place):
        laps.append([writer.write(grey(100 + k), 2.0) for k in range(writer.slots)])
        return plain(*place)

    monkeypatch.setattr(cameras.np, "frombuffer", slowly)
    assert reader.read(0.0) == [] and len(laps) == 3
    monkeypatch.undo()
    ((t, image),) = reader.read(0.0)
    assert t == 2.0 and (image == 102).all()


def test_no_torn_frame_under_a_fast_writer():
    """Each frame is of one colour; a torn one would have two."""
    writer = FrameWriter(320, 240, 50.0, slots=2)
    reader, done, seen = SharedFrames(writer.name), threading.Event(), []
    reader.open()

    def write():
        for k in range(400):
            writer.write(grey(k % 256, (240, 320)), float(k))
        done.set()

    thread = threading.Thread(target=write)
    thread.start()
    while not done.is_set() or not seen:
        seen += reader.read(0.0)
    thread.join()
    assert all(image.min() == image.max() == t % 256 for t, image in seen)
    assert [t for t, _ in seen] == sorted({t for t, _ in seen})
    reader.close()
    writer.close()


def test_shared_memory_is_removed_when_the_writer_closes_not_a_reader(ring):
    writer, _ = ring
    for _ in range(2):
        again = SharedFrames(writer.name)
        again.open()
        again.close()
    writer.close()
    with pytest.raises(ConfigError, match="no shared memory"):
        SharedFrames(writer.name).open()
    writer.close()


def test_a_ring_of_one_slot_and_an_image_of_another_size_are_refused(ring):
    with pytest.raises(ConfigError, match="2 slots"):
        FrameWriter(10, 10, 50.0, slots=1)
    with pytest.raises(ConfigError, match="24, 32"):
        ring[0].write(grey(1, (32, 24)), 0.0)


def taken(*faults, seconds=2.0, timing=CameraTiming(), **body):  # noqa: B008  an immutable value
    """Frames of a fish that drifts along x, as they became readable."""
    robot = LoopbackRobot(bodies.make(noise=0.0, **body), faults=parse(faults), camera=timing)
    robot.body._state.rate[0] = 0.2
    found = []
    for _ in range(round(seconds / 0.02)):
        since = robot.time
        robot.advance(0.02)
        found += robot.frames(since)
    return found


def test_camera_frames_arrive_after_their_latency_with_jittered_stamps():
    found = taken()
    assert len(found) == pytest.approx((2.0 - 0.065) / 0.02, abs=1.5)
    assert all(frame.readable - frame.t == pytest.approx(0.065, abs=1e-6) for frame in found)
    gaps = np.diff([frame.t for frame in found])
    assert 0.018 <= gaps.min() + 1e-9 and gaps.max() <= 0.022 + 1e-9 and gaps.std() > 1e-4
    x = np.array([frame.pose[0] for frame in found])
    assert x[-1] > 0.1 and np.all(np.diff(x) > 0)


def test_without_jitter_frames_come_on_the_dot():
    found = taken(timing=CameraTiming(jitter=0.0, latency=0.03))
    np.testing.assert_allclose([frame.t for frame in found], 0.02 * np.arange(len(found)), atol=1e-9)


def test_a_lost_camera_gives_nothing():
    t = np.array([frame.t for frame in taken("camera_loss@0.5-1.5")])
    assert t.size and not np.any((t >= 0.5) & (t < 1.5)) and t.max() > 1.5


def test_a_frozen_camera_gives_the_same_picture_with_new_stamps():
    found = taken("camera_freeze@0.5-1.5")
    frozen = [frame for frame in found if 0.5 <= frame.t < 1.5]
    assert len(frozen) == 50 and len({frame.drawn for frame in frozen}) == 1 and len({frame.t for frame in frozen}) == 50
    assert all((frame.pose == frozen[0].pose).all() for frame in frozen)
    assert found[-1].drawn == found[-1].t and found[-1].pose[0] > frozen[0].pose[0]


def test_a_camera_that_jumps_shifts_the_picture():
    found, still = taken("camera_jump=0.4@0.5-1.5"), taken()
    shift = np.array([a.pose[0] - b.pose[0] for a, b in zip(found, still, strict=True)])
    inside = np.array([0.5 <= frame.t < 1.5 for frame in found])
    np.testing.assert_allclose(shift[inside], 0.4, atol=1e-12)
    np.testing.assert_allclose(shift[~inside], 0.0, atol=1e-12)
