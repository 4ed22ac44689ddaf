"""Pictures into fixes: a camera that hangs gives none, whatever the tracker makes of its picture."""

import numpy as np

from fishmj.deploy.localiser import InStep, InThread, Repeats
from fishmj.deploy.supervisor import Condition
from fishmj.loopback.camera_frames import FishLook, FrameArtist, TagPlate
from fishmj.tracker.apriltag import AprilTagTracker
from fishmj.tracker.calibration import overhead
from tests.deploying import Bench

CAMERA = overhead((320, 240), 0.0028, 3.0)


class Drawn:
    """A camera over a fish that drifts; from `hangs` s on it gives the picture of then, with new stamps and in new memory."""

    def __init__(self, clock):
        self.clock, self.hangs = clock, np.inf
        self.artist = FrameArtist(CAMERA, FishLook.of("fish", "tag", plate=TagPlate()))

    def open(self): ...
    def close(self): ...

    def read(self, now):
        t = min(now, self.hangs)
        return [(now, self.artist.draw((0.002 * (t - 100.0), 0.0, 0.1), np.zeros(3), t).copy())]


def tag_tracker():
    plate = TagPlate()
    return AprilTagTracker(CAMERA, plate.family, plate.size, plate.mount, plate.number, plate.height)


def test_a_tracker_that_follows_finds_other_bits_in_the_same_picture():
    """Why pictures are compared, and not fixes."""
    image, tracker = Drawn(None).read(100.0)[0][1], tag_tracker()
    fixes = [tracker.locate(image, 0.02 * k)[1:4] for k in range(6)]
    assert any(a != b for a, b in zip(fixes, fixes[1:], strict=False))


def test_a_camera_that_hangs_ends_a_swim_as_one_that_is_lost(tmp_path):
    bench = Bench(tmp_path / "swim", seconds=2.0)
    camera = Drawn(bench.clock)
    bench.rig.localiser = InStep(camera, tag_tracker())
    bench.at(0.5, lambda: setattr(camera, "hangs", bench.clock.now()))
    assert bench.swim().cause == Condition.POSE_LOST
    assert bench.to_neutral() <= 0.5 + 0.5 + 0.06
    assert bench.rig.localiser.counts["repeated"] >= 20


def test_a_fish_at_rest_before_a_camera_that_lives_is_seen(tmp_path):
    camera = Drawn(None)
    draw = camera.artist.draw
    frames = InStep(camera, tag_tracker())
    camera.artist.draw = lambda pose, joint, t: draw((0.0, 0.0, 0.1), joint, t)
    assert all(frames.fixes(100.0 + 0.02 * k) for k in range(5)) and frames.counts["repeated"] == 0


def test_one_pixel_is_enough_to_be_another_picture():
    repeats, image = Repeats(), np.zeros((40, 50, 3), np.uint8)
    other = image.copy()
    other[37, 3, 1] = 1
    assert [repeats(i) for i in (image, image.copy(), other, other)] == [False, True, False, True]
    assert not any(Repeats()(np.zeros(6)) for _ in range(2))


def test_the_thread_leaves_repeated_pictures_out_too():
    class Twice:
        def __init__(self):
            self.left, self.image = 5, Drawn(None).read(100.0)[0][1]

        def open(self): ...
        def close(self): ...

        def wait(self, most):
            self.left -= 1
            if not self.left:
                one._running.clear()
            return [(float(-self.left), self.image)]

    one = InThread(Twice(), tag_tracker())
    one.open()
    one._thread.join(10.0)
    assert len(one.fixes(0.0)) == 1 and one.counts == {"frames": 5, "fixes": 1, "skipped": 0, "repeated": 4}
