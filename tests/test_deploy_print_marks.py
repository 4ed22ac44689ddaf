"""Printed marks: the tag that the tracker finds, the board that the calibration finds, on pages of the right size."""

import re

import cv2
import numpy as np
import pytest

from fishmj.base import console
from fishmj.base.errors import ConfigError
from fishmj.deploy.__main__ import main
from fishmj.deploy.commands.print_command import board_page, options, pdf, tag_page
from fishmj.deploy.loop import wiring
from fishmj.deploy.tracker.apriltag import AprilTagTracker
from fishmj.deploy.tracker.calibration import overhead

DOTS = 4  # px/mm


def raster(page) -> np.ndarray:
    """A page (H, W) uint8 from its arrays, the upper edge first."""
    width, height = (round(DOTS * side) for side in page.size)
    image = np.full((height, width), 255, np.uint8)
    for x, y in page.cells:
        left, right = round(DOTS * x), round(DOTS * (x + page.side))
        image[height - round(DOTS * (y + page.side)) : height - round(DOTS * y), left:right] = 0
    return image


@pytest.mark.parametrize(("family", "number", "size"), [("36h11", 0, 0.06), ("36h11", 586, 0.1), ("16h5", 7, 0.08)])
def test_the_tracker_finds_the_printed_tag_at_its_size(family, number, size):
    page = tag_page(family, number, size)
    width, height = map(round, page.size)
    image = cv2.resize(raster(page), (width, height), interpolation=cv2.INTER_AREA)  # 1 px a mm: the tracker's cells are of 8 px
    camera = overhead((width, height), 1e-3, 1.0)
    frame = np.repeat((20 + 0.7 * image).astype(np.uint8)[..., None], 3, 2)  # a lit print: white of 198, no glint
    fix = AprilTagTracker(camera, family, size, number=number).locate(frame, 0.0)
    assert fix is not None and fix.quality > 0.9
    middle = (page.cells.min(0) + page.cells.max(0) + page.side) / 2  # the border is black: its middle is the tag's
    np.testing.assert_allclose([fix.x, fix.y], camera.to_tank([middle * [1, -1] + [-0.5, height - 0.5]])[0], atol=1e-3)
    assert fix.yaw == pytest.approx(0.0, abs=5e-3)
    assert AprilTagTracker(camera, family, 1.3 * size, number=number).locate(frame, 0.0) is None


def test_the_calibration_finds_the_printed_board_at_its_size():
    image = raster(board_page(9, 6, 0.025))
    there, corners = cv2.findChessboardCornersSB(image, (9, 6), flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    assert there
    steps = np.linalg.norm(np.diff(corners.reshape(6, 9, 2), axis=1), axis=2)
    np.testing.assert_allclose(steps / DOTS, 25.0, atol=0.1)


def test_the_pages_have_the_size_of_their_sheets_and_a_rule(tmp_path, capsys):
    out = tmp_path / "marks.pdf"
    assert console.run(main, ["print-marks", "--out", str(out), "--tag-size", "0.3"]) == console.OK
    said = capsys.readouterr().out
    assert (
        "black border 300 mm; right edge to the nose (--tag-mount X,Y,0), A2" in said
        and "squares of 25 mm, A4" in said
        and "rule of 100 mm" in said
    )
    boxes = [tuple(map(float, box)) for box in re.findall(rb"/MediaBox \[ 0 0 ([\d.]+) ([\d.]+) \]", out.read_bytes())]
    np.testing.assert_allclose(np.array(boxes) / 72 * 25.4, [(420, 594), (297, 210)], atol=0.01)
    assert out.read_bytes() == pdf([tag_page("36h11", 0, 0.3), board_page(9, 6, 0.025)])


def test_the_defaults_are_those_of_tracker_and_calibration():
    made, tracker = options().parse_args(["--out", "m.pdf"]), console.parser("x", "")
    wiring.tracker_options(tracker)
    theirs = tracker.parse_args([])
    assert [getattr(made, n) for n in ("tag_family", "tag_number", "tag_size")] == [
        getattr(theirs, n) for n in ("tag_family", "tag_number", "tag_size")
    ]
    assert made.board == (9, 6) and made.square == 0.025  # as the examples and the pages of calibrate-camera have it


@pytest.mark.parametrize(
    ("words", "told"),
    {
        "--tag-family 16h5 --tag-number 30": "16h5 has 0 to 29",
        "--square 0.2": "needs 2020 x 1434 mm; the largest sheet",
        "--board 2x6": "expected",
    }.items(),
)
def test_marks_that_cannot_be_printed_are_refused_in_one_line(words, told, tmp_path, capsys):
    assert console.run(main, ["print-marks", "--out", str(tmp_path / "m.pdf"), *words.split()]) == console.BAD_INPUT
    assert told in capsys.readouterr().err and not (tmp_path / "m.pdf").exists()
    with pytest.raises(ConfigError, match=r"FILE\.pdf"):
        main(["print-marks", "--out", str(tmp_path / "m.png")])
