"""`deploy track` and `deploy calibrate-camera`: a film of known poses, a board and marks of a known camera."""

import json

import numpy as np
import pytest

from fishmj.base import console
from fishmj.deploy.__main__ import main
from fishmj.deploy.loopback.camera_frames import FishLook, FrameArtist, TagPlate
from fishmj.deploy.tracker.calibration import Calibration, overhead
from fishmj.log import read_trial

cv2 = pytest.importorskip("cv2")
SIZE = (640, 480)


def film(path, calibration, poses, rate=25.0):
    artist = FrameArtist(calibration, FishLook.of("fish", "tag", plate=TagPlate()))
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), rate, SIZE)
    if not writer.isOpened():
        pytest.skip("this OpenCV writes no film")
    for k, pose in enumerate(poses):
        writer.write(artist.draw(tuple(pose), np.zeros(3), k / rate))
    writer.release()


def test_a_film_becomes_a_trial_with_the_poses_that_were_filmed(tmp_path, capsys):
    calibration = overhead(SIZE, 2.8e-3, 3.0)
    calibration.write(tmp_path / "tank.toml")
    t = np.arange(20) / 25.0
    poses = np.stack([-0.1 + 0.2 * t, 0.1 * t, 0.3 * t], 1)
    film(tmp_path / "swim.avi", calibration, poses)
    words = ["track", str(tmp_path / "swim.avi"), "--calibration", str(tmp_path / "tank.toml"), "--out", str(tmp_path / "swim")]
    assert console.run(main, [*words, "--json"]) == console.OK
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert told["frames"] == 20 and told["fixes"] >= 19
    pose = read_trial(tmp_path / "swim").tables["pose"]
    truth = [np.interp(pose["t"], t, column) for column in poses.T]
    assert np.abs(pose["x"] - truth[0]).max() < 0.004 and np.abs(pose["y"] - truth[1]).max() < 0.004
    assert np.abs(pose["yaw"] - truth[2]).max() < np.radians(2)


def test_film_without_fish_is_told_early(tmp_path, capsys, monkeypatch):
    from fishmj.deploy.commands import track_command

    monkeypatch.setattr(track_command, "EARLY", 5)
    calibration = overhead(SIZE, 2.8e-3, 3.0)
    calibration.write(tmp_path / "tank.toml")
    film(tmp_path / "swim.avi", calibration, np.tile([0.0, 0.0, 0.0], (10, 1)))
    words = ["track", str(tmp_path / "swim.avi"), "--calibration", str(tmp_path / "tank.toml"), "--out", str(tmp_path / "swim")]
    assert console.run(main, [*words, "--tag-number", "7"]) == console.BAD_INPUT
    lines = capsys.readouterr().err.splitlines()
    early = next(k for k, line in enumerate(lines) if "no fix in the first 5 frames" in line)
    assert "no fix in 10 frames" in lines[-1] and early < len(lines) - 1


def board_pictures(folder, count=8):
    """Pictures of a chessboard of 9 x 6 inner corners under a pinhole camera of 700 px; returns the camera's matrix."""
    folder.mkdir()
    matrix = np.array([[700.0, 0, 319.5], [0, 700.0, 239.5], [0, 0, 1]])
    cell, rng = 60, np.random.default_rng(0)
    flat = np.kron((np.indices((7, 10)).sum(0) % 2).astype(np.uint8) * 255, np.ones((cell, cell), np.uint8))
    flat = cv2.copyMakeBorder(flat, cell, cell, cell, cell, cv2.BORDER_CONSTANT, value=255)
    high, wide = flat.shape
    square = 0.03
    corners = np.array([[0, 0], [wide, 0], [wide, high], [0, high]], np.float32)
    metres = (corners - [wide / 2, high / 2]) / cell * square
    for k in range(count):
        turn = rng.uniform(-0.6, 0.6, 3) * [1, 1, 0.3]
        seen, _ = cv2.projectPoints(
            np.c_[metres, np.zeros(4)], turn, np.array([rng.uniform(-0.05, 0.05), rng.uniform(-0.03, 0.03), 0.6]), matrix, None
        )
        warp = cv2.getPerspectiveTransform(corners, seen.reshape(4, 2).astype(np.float32))
        picture = cv2.warpPerspective(flat, warp, SIZE, borderValue=127, flags=cv2.INTER_AREA)
        cv2.imwrite(str(folder / f"{k:02d}.png"), picture)
    return matrix


def test_a_camera_is_calibrated_from_pictures_of_a_board_and_marks(tmp_path, capsys):
    matrix = board_pictures(tmp_path / "board")
    points = [(-0.8, -0.6), (0.8, -0.6), (0.8, 0.6), (-0.8, 0.6), (0.1, 0.2), (-0.3, 0.4)]
    high = 2.5
    rows = ["" for _ in points]
    for k, (x, y) in enumerate(points):
        u, v = 319.5 + 700 * x / high, 239.5 - 700 * y / high
        rows[k] = f'[[mark]]\nname = "m{k}"\npixel = [{u}, {v}]\npoint = [{x}, {y}]\n'
    (tmp_path / "marks.toml").write_text("\n".join(rows), encoding="utf-8")
    words = ["calibrate-camera", "--pictures", str(tmp_path / "board"), "--board", "9x6", "--square", "0.03"]
    words += ["--marks", str(tmp_path / "marks.toml"), "--out", str(tmp_path / "tank.toml"), "--lag", "0.02", "--json"]
    assert console.run(main, words) == console.OK
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert told["marks_rms_m"] < 2e-3 and told["pictures"] >= 5
    made = Calibration.read(tmp_path / "tank.toml")
    assert made.lag == 0.02 and abs(made.matrix[0, 0] / matrix[0, 0] - 1) < 0.02
    assert abs(made.camera[2] / high - 1) < 0.03


def test_a_mark_that_was_measured_wrongly_is_named(tmp_path, capsys):
    board_pictures(tmp_path / "board")
    points = [(-0.8, -0.6), (0.8, -0.6), (0.8, 0.6), (-0.8, 0.6), (0.1, 0.2), (-0.3, 0.4), (0.5, -0.1)]
    rows = [
        f'[[mark]]\nname = "m{k}"\npixel = [{319.5 + 280 * x}, {239.5 - 280 * y}]\npoint = [{x + 0.1 * (k == 5)}, {y}]\n'
        for k, (x, y) in enumerate(points)
    ]
    (tmp_path / "marks.toml").write_text("\n".join(rows), encoding="utf-8")
    words = ["calibrate-camera", "--pictures", str(tmp_path / "board"), "--board", "9x6", "--square", "0.03"]
    words += ["--marks", str(tmp_path / "marks.toml"), "--out", str(tmp_path / "tank.toml")]
    assert console.run(main, words) == console.FAILED_CHECK
    said = capsys.readouterr().err
    assert "mark m5: without it" in said and said.strip().split("\n")[-1].endswith("is written all the same")


MARKS = {
    "": ("", "got 0 marks"),
    "marks": ("[[marks]]\npixel = [1, 2]\npoint = [0, 0]\n", "expected blocks \\[\\[mark\\]\\]"),
    "nan": ("[[mark]]\npixel = [1, 2]\npoint = [nan, 0]\n", "mark\\]\\] 1: expected .*finite numbers"),
    "key": ("[[mark]]\npixel = [1, 2]\npoint = [0, 0]\nhight = 1\n", "mark\\]\\] 1: expected .*hight"),
}


@pytest.mark.parametrize("case", MARKS)
def test_bad_marks_are_refused_by_their_number(tmp_path, case):
    from fishmj.base.errors import ConfigError
    from fishmj.deploy.commands.camera_command import marks

    text, said = MARKS[case]
    (tmp_path / "marks.toml").write_text(text, encoding="utf-8")
    if not text:
        assert marks(tmp_path / "marks.toml") == []
        return
    with pytest.raises(ConfigError, match=said):
        marks(tmp_path / "marks.toml")


@pytest.mark.parametrize(("count", "more", "said"), [(4, [], "4 marks always fit"), (6, ["--camera", "0,0,30"], "27.50 m from")])
def test_what_the_marks_cannot_check_is_told(tmp_path, capsys, count, more, said):
    board_pictures(tmp_path / "board")
    points = [(-0.8, -0.6), (0.8, -0.6), (0.8, 0.6), (-0.8, 0.6), (0.1, 0.2), (-0.3, 0.4)][:count]
    rows = [f"[[mark]]\npixel = [{319.5 + 280 * x}, {239.5 - 280 * y}]\npoint = [{x}, {y}]\n" for x, y in points]
    (tmp_path / "marks.toml").write_text("".join(rows), encoding="utf-8")
    words = ["calibrate-camera", "--pictures", str(tmp_path / "board"), "--board", "9x6", "--square", "0.03"]
    words += ["--marks", str(tmp_path / "marks.toml"), "--out", str(tmp_path / "tank.toml"), *more]
    assert console.run(main, words) == console.OK
    assert said in capsys.readouterr().err


BAD = {
    "--board 9": "expected COLUMNSxROWS",
    "--board 9x6 --pictures nowhere": "no picture there",
    "--board 9x6 --camera 1,2": "expected X,Y,HEIGHT",
}


@pytest.mark.parametrize("words", BAD)
def test_a_bad_calibration_command_is_one_line(words, tmp_path, capsys):
    if "--pictures" not in words:
        board_pictures(tmp_path / "board", 6)
        words_given = [*words.split(), "--pictures", str(tmp_path / "board")]
    else:
        words_given = words.split()
    (tmp_path / "marks.toml").write_text("", encoding="utf-8")
    rest = ["--square", "0.03", "--marks", str(tmp_path / "marks.toml"), "--out", str(tmp_path / "tank.toml")]
    assert console.run(main, ["calibrate-camera", *words_given, *rest]) == console.BAD_INPUT
    assert BAD[words] in capsys.readouterr().err


def test_a_mark_without_numbers_is_one_line(tmp_path, capsys):
    board_pictures(tmp_path / "board", 6)
    (tmp_path / "marks.toml").write_text('[[mark]]\npixel = [1.0]\npoint = "here"\n', encoding="utf-8")
    words = ["calibrate-camera", "--pictures", str(tmp_path / "board"), "--board", "9x6", "--square", "0.03"]
    words += ["--marks", str(tmp_path / "marks.toml"), "--out", str(tmp_path / "tank.toml")]
    assert console.run(main, words) == console.BAD_INPUT
    assert "[[mark]] 1: expected pixel" in capsys.readouterr().err
