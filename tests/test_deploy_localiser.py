"""Pictures into fixes: a camera that hangs gives none, whatever the tracker makes of it; its process ends with the host."""

import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from fishmj.base.errors import ConfigError
from fishmj.deploy.camera.localiser import InProcess, InStep, Newest, Repeats
from fishmj.deploy.camera.tracker_process import line
from fishmj.deploy.commands.swim_command import options
from fishmj.deploy.loop import wiring
from fishmj.deploy.loop.supervisor import Condition
from fishmj.deploy.loopback.camera_frames import FishLook, FrameArtist, TagPlate
from fishmj.deploy.loopback.shared_frames import FrameWriter
from fishmj.deploy.tracker.apriltag import AprilTagTracker
from fishmj.deploy.tracker.calibration import overhead
from fishmj.deploy.tracker.fix import Fix
from fishmj.mjcf.reading import load_robot
from tests.deploying import Bench

ROOT = Path(__file__).resolve().parent.parent
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


def test_the_newest_picture_is_looked_at_and_repeated_ones_are_left_out():
    image = Drawn(None).read(100.0)[0][1]
    frames = [[(0.0, image)], [], [(0.02, image), (0.04, image)], [(0.06, image), (0.08, image), (0.1, image + 1)]]

    class Films:
        def open(self): ...
        def close(self): ...

        def wait(self, most):
            return frames.pop(0)

    eyes = Newest(Films(), tag_tracker())
    found = [eyes.look(0.1) for _ in range(4)]
    assert [fix is not None for fix in found] == [True, False, False, True] and found[3].t == 0.1
    assert eyes.counts == {"frames": 3, "fixes": 2, "skipped": 3, "repeated": 1}


def process(script):
    return InProcess([sys.executable, "-c", f"import json, os, sys, time\n{script}"])


def until(eyes, done, seconds=600.0):
    """What came until it is done."""
    found, end = [], time.monotonic() + seconds
    while not done(found) and time.monotonic() < end:
        found += eyes.fixes(0.0)
        time.sleep(0.005)
    return found


def test_fixes_come_out_of_the_process_as_the_tracker_found_them():
    fix = Fix(12.3, 0.1, -0.2, 3.0, np.arange(9.0).reshape(3, 3), 0.7)
    told = [line(fix, {"frames": 5, "fixes": 3, "skipped": 1, "repeated": 0}), line(None, {"frames": 6, "f": 3, "s": 1, "r": 1})]
    eyes = process(f"print()\nfor told in {told!r}: print(json.dumps(told), flush=True)\ntime.sleep(60)")
    eyes.open()
    assert os.getsid(eyes._process.pid) != os.getsid(0)  # Ctrl-C in the terminal reaches the host alone
    (found,) = until(eyes, lambda _: eyes.counts["frames"] == 6)
    assert found[:4] == fix[:4] and found.quality == 0.7 and eyes.failed is None
    np.testing.assert_array_equal(found.covariance, fix.covariance)
    assert eyes.counts == {"frames": 6, "fixes": 3, "skipped": 1, "repeated": 1}
    pid = eyes._process.pid
    eyes.close()
    eyes.close()
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


@pytest.mark.parametrize(
    ("script", "why"),
    [
        ("print()\nprint(json.dumps({'failed': 'film: no more pictures'}), flush=True)\ntime.sleep(60)", "no more pictures"),
        ("print(flush=True)\nsys.stderr.write('fishmj: the camera is gone\\n')\nsys.exit(2)", "tracker: the camera is gone"),
        ("print(flush=True)\nos.kill(os.getpid(), 9)", "its process ended with exit code -9"),
    ],
)
def test_a_process_that_ends_is_a_camera_that_is_lost_and_says_why(tmp_path, script, why):
    bench = Bench(tmp_path / "swim", seconds=1.0)
    eyes = process(script)
    eyes.open()
    until(eyes, lambda _: eyes.failed is not None)
    bench.eyes.failed = eyes.failed  # what the swim reads of it
    bench.at(0.1, lambda: setattr(bench.eyes, "blind", True))
    outcome = bench.swim()
    assert outcome.cause == Condition.POSE_LOST and why in outcome.words and eyes.fixes(0.0) == []
    eyes.close()


def test_a_camera_that_does_not_open_is_said_in_one_line():
    eyes = process("sys.stderr.write('some library warns\\nfishmj: camera 7: does not open\\n')\nsys.exit(2)")
    with pytest.raises(ConfigError, match="^camera 7: does not open$"):
        eyes.open()


HOST = """
import sys, time
from fishmj.deploy.camera.localiser import InProcess
eyes = InProcess(sys.argv[1:])
eyes.open()
while not eyes.fixes(0.0):
    time.sleep(0.01)
print(eyes._process.pid, flush=True)
time.sleep(60)
"""


def test_the_real_process_finds_the_fish_and_ends_when_its_host_is_killed(tmp_path):
    CAMERA.write(tmp_path / "camera.toml")
    ring = FrameWriter(320, 240, 50.0)
    film, begun = Drawn(None), time.monotonic()
    args = options().parse_args(["--policy", "station", "--tracker", "tag"])
    fish = wiring.Loopback(0, 0, ring.name, tmp_path / "camera.toml")
    words = wiring.tracker_words(args, f"shm:{ring.name}", fish, load_robot("fish"))
    script = HOST.replace("sys.argv[1:]", "[*sys.argv[1:], f'--parent={__import__(\"os\").getpid()}']")
    host = subprocess.Popen([sys.executable, "-c", script, *words[:-1]], stdout=subprocess.PIPE, cwd=ROOT)
    try:
        while not select.select([host.stdout], [], [], 0.02)[0] and time.monotonic() < begun + 600:
            t = time.monotonic()
            ring.write(film.artist.draw((0.05, 0.0, 0.1), np.zeros(3), t), t)
        tracker = int(host.stdout.readline())
        os.kill(host.pid, signal.SIGKILL)
        host.wait()
        end = time.monotonic() + 600
        while alive(tracker) and time.monotonic() < end:
            time.sleep(0.02)
        assert not alive(tracker)
    finally:
        host.kill()
        host.wait()
        host.stdout.close()
        ring.close()


def alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return "Z" not in Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] if Path("/proc").is_dir() else True
