"""Camera frames of the loopback robot: no torn ones through shared memory, and each camera fault does what it says."""

import threading

import numpy as np
import pytest

from fishmj.base.errors import ConfigError, StoreError
from fishmj.deploy.loopback import bodies
from fishmj.deploy.loopback.camera import CameraTiming
from fishmj.deploy.loopback.faults import parse
from fishmj.deploy.loopback.robot import LoopbackRobot
from fishmj.deploy.loopback.shared_frames import FrameWriter, SharedFrameReader


@pytest.fixture
def ring():
    writer = FrameWriter(32, 24, 50.0, slots=3)
    reader = SharedFrameReader(writer.name)
    yield writer, reader
    reader.close()
    writer.close()


def grey(value, size=(24, 32)):
    return np.full((*size, 3), value, np.uint8)


def test_a_reader_gets_the_newest_frame_once_with_its_stamp(ring):
    writer, reader = ring
    assert reader.newest() is None and (reader.width, reader.height, reader.rate) == (32, 24, 50.0)
    for k in range(5):
        assert writer.write(grey(k), 10.0 + k) == k + 1
    found = reader.newest()
    assert (found.number, found.t) == (5, 14.0) and (found.image == 4).all()
    assert reader.newest() is None
    writer.write(grey(9), 20.0)
    assert reader.newest().number == 6


def test_a_frame_that_is_being_written_is_never_given(ring):
    writer, reader = ring
    writer.write(grey(1), 1.0)
    slot = int(writer.header[4])
    writer.numbers[slot][0] += 1  # as if the writer had come round and begun to write there
    assert reader.newest() is None and reader.torn == 3
    writer.numbers[slot][0] -= 1
    assert reader.newest().number == 1


def test_a_frame_that_changes_while_it_is_copied_is_never_given(ring):
    writer, reader = ring
    writer.write(grey(1), 1.0)

    class Slow(list):
        """Images whose copy takes so long that the writer laps the reader."""

        def __getitem__(self, slot):
            for k in range(writer.slots):
                writer.write(grey(100 + k), 2.0)
            return super().__getitem__(slot)

    plain, reader.images = reader.images, Slow(reader.images)
    assert reader.newest() is None and reader.torn == 3
    reader.images = plain
    assert reader.newest().number == 1 + 3 * writer.slots


def test_no_torn_frame_under_a_fast_writer():
    """Each frame is of one colour; a torn one would have two."""
    writer = FrameWriter(320, 240, 50.0, slots=2)
    reader, done, seen = SharedFrameReader(writer.name), threading.Event(), []

    def write():
        for k in range(400):
            writer.write(grey(k % 256, (240, 320)), float(k))
        done.set()

    thread = threading.Thread(target=write)
    thread.start()
    while not done.is_set() or not seen:
        if (found := reader.newest()) is not None:
            seen.append(found)
    thread.join()
    assert all(found.image.min() == found.image.max() == (found.number - 1) % 256 for found in seen)
    assert [found.number for found in seen] == sorted({found.number for found in seen})
    reader.close()
    writer.close()


def test_shared_memory_is_removed_when_the_writer_closes_not_a_reader(ring):
    writer, reader = ring
    SharedFrameReader(writer.name).close()
    SharedFrameReader(writer.name).close()
    name = writer.name
    writer.close()
    with pytest.raises(StoreError, match="no shared memory"):
        SharedFrameReader(name)
    writer.close()


def test_what_is_no_ring_is_refused():
    from multiprocessing.shared_memory import SharedMemory

    other = SharedMemory(create=True, size=200)
    try:
        with pytest.raises(StoreError, match="no ring"):
            SharedFrameReader(other.name)
    finally:
        other.close()
        other.unlink()
    with pytest.raises(ConfigError, match="2 slots"):
        FrameWriter(10, 10, 50.0, slots=1)


def test_an_image_of_another_size_is_refused(ring):
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
