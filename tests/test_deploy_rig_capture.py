"""Pictures for the calibration are taken as a swim takes them: same size, stamps, and a rate that was measured."""

import textwrap
import time
from types import SimpleNamespace

import numpy as np
import pytest

from fishmj.base.errors import ConfigError
from fishmj.deploy.camera import cameras
from fishmj.deploy.commands import camera_command, doctor_command
from fishmj.deploy.rig import rig_capture
from fishmj.deploy.rig.rig_capture import Shots
from tests.deploying import FakeClock


class Film:
    """A camera of `rate` Hz on a fake clock whose picture k is all k, until it is unplugged after `left` pictures."""

    def __init__(self, clock, rate=50.0, left=10**6):
        self.clock, self.period, self.left, self.begun, self.count = clock, 1.0 / rate, left, clock.now(), 0

    def wait(self, most):
        self.clock.sleep_until(self.clock.now() + min(most, self.period))
        self.count += 1
        if self.count > self.left:
            return []
        return [(self.begun + self.count * self.period, np.full((2, 2, 3), self.count % 256, np.uint8))]


def test_calibration_pictures_keep_their_interval_and_report_camera_rate():
    clock = FakeClock()
    shots = Shots(Film(clock), clock, 2.0)
    stamps = [t for t, _ in shots.taken(3)]
    np.testing.assert_allclose(stamps, [102.0, 104.0, 106.0], atol=0.05)
    assert shots.rate == pytest.approx(50.0)


def test_a_camera_that_is_unplugged_is_one_line():
    clock = FakeClock()
    with pytest.raises(ConfigError, match="no picture for 5 s after 1 of 3"):
        list(Shots(Film(clock, left=150), clock, 2.0).taken(3))


class SmallUnlessAsked:
    """A device of OpenCV that gives 640 x 480 until another size is set, 100 Hz."""

    def __init__(self):
        self.size = {"W": 640, "H": 480}

    def isOpened(self):
        return True

    def set(self, key, value):
        self.size[key] = value

    def get(self, key):
        return self.size[key]

    def grab(self):
        time.sleep(0.01)
        return True

    def retrieve(self):
        return True, np.zeros((self.size["H"], self.size["W"], 3), np.uint8)

    def release(self): ...


@pytest.fixture
def plugged(monkeypatch):
    keys = {"CAP_PROP_FRAME_WIDTH": "W", "CAP_PROP_FRAME_HEIGHT": "H", "CAP_PROP_FPS": "F", "CAP_PROP_BUFFERSIZE": "B"}
    nothing = SimpleNamespace(isOpened=lambda: False, release=lambda: None)
    device = lambda number: SmallUnlessAsked() if number == 0 else nothing
    opencv = SimpleNamespace(VideoCapture=device, imencode=lambda kind, image: (True, np.zeros(len(image), np.uint8)), **keys)
    for module in (cameras, rig_capture):
        monkeypatch.setattr(module, "cv2", lambda: opencv)


def test_pictures_have_the_size_at_which_the_fish_swims(plugged, tmp_path, capsys):
    words = ["--camera", "0", "--count", "2", "--every", "0.1", "--out", str(tmp_path / "board")]
    assert rig_capture.main(words) == 0 and rig_capture.main(words) == 0
    assert [path.name for path in sorted((tmp_path / "board").iterdir())] == ["001.png", "002.png", "003.png", "004.png"]
    assert "2 pictures of 1280 x 720 px" in capsys.readouterr().out


def test_doctor_measures_a_camera_as_a_swim_opens_it(plugged):
    (said,) = doctor_command.cameras()
    assert said.startswith("0: 1280 x 720, ") and "asks for" not in said


def test_the_marks_of_the_help_are_marks(tmp_path):
    help_text = camera_command.options().format_help()
    shown = help_text[help_text.index("  [[mark]]") :].partition("\n\n")[0]
    (tmp_path / "marks.toml").write_text(textwrap.dedent(shown), encoding="utf-8")
    (mark,) = camera_command.marks(tmp_path / "marks.toml")
    assert (mark.name, mark.pixel, mark.point) == ("corner", (212.5, 88.0), (-1.5, 1.0))
