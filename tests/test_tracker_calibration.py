"""Calibration of the camera: pixels to metres and back, marks, lens, files."""

import numpy as np
import pytest

from fishmj.base.errors import ConfigError, UnknownName
from fishmj.deploy.tracker import Board, Calibration, Mark, calibrate_intrinsics, homography_from_marks
from fishmj.deploy.tracker.calibration import camera_of, overhead

cv2 = pytest.importorskip("cv2")

LENS = (-0.12, 0.03, 0.001, -0.0008, 0.002)
POINTS = [(-1.5, -0.8), (1.5, -0.8), (1.5, 0.8), (-1.5, 0.8), (0.1, 0.2), (-0.7, 0.4), (0.9, -0.3)]


def camera(**changes) -> Calibration:
    return overhead((1280, 720), 0.0028, 3.0, **{"distortion": LENS, "tilt": (0.05, -0.03), "turn": 0.05} | changes)


@pytest.mark.parametrize("height", [0.3, 0.03, 0.0, -0.01, -0.5])
def test_a_pixel_goes_to_the_tank_and_back(height):
    pixels = np.random.default_rng(1).uniform(0, [1280, 720], (200, 2))
    seen = camera()
    assert np.abs(seen.to_pixel(seen.to_tank(pixels, height), height) - pixels).max() < 1e-6


def test_points_project_as_opencv_projects_them():
    """An independent way to the same pixels: the camera's pose and cv2.projectPoints."""
    seen = camera()
    axes = np.linalg.inv(seen.matrix) @ np.linalg.inv(seen.homography)
    axes /= np.linalg.norm(axes[:, 0]) * np.sign(axes[2, 2])
    turn = np.c_[axes[:, :2], np.cross(axes[:, 0], axes[:, 1])]
    points = np.c_[np.random.default_rng(2).uniform(-1.4, 1.4, (50, 2)) * [1, 0.6], np.full(50, 0.2)]
    expected, _ = cv2.projectPoints(points, cv2.Rodrigues(turn)[0], axes[:, 2], seen.matrix, seen.distortion)
    assert np.abs(seen.to_pixel(points[:, :2], 0.2) - expected.reshape(-1, 2)).max() < 1e-6


def test_a_sunken_mark_is_seen_along_a_refracted_ray():
    """Snell's law by hand: 3 m up, 1.2 m away on the plane, 0.1 m deep."""
    seen = overhead((1280, 720), 0.0028, 3.0)
    sine = 1.2 / np.hypot(1.2, 3.0) / 1.333
    farther = 1.2 + 0.1 * np.tan(np.arcsin(sine))
    assert seen.to_tank(seen.to_pixel([(1.2, 0.0)]), -0.1)[0] == pytest.approx([farther, 0.0], abs=1e-9)
    assert farther - 1.2 == pytest.approx(1.2 * 0.1 / (1.333 * 3.0), rel=0.08)  # the refraction scale, for small angles


def test_a_mark_above_the_water_without_parallax_would_be_centimetres_off():
    seen = overhead((1280, 720), 0.0028, 3.0)
    pixel = seen.to_pixel([(1.5, 0.6)], 0.1)
    assert seen.to_tank(pixel, 0.1)[0] == pytest.approx([1.5, 0.6])
    assert np.hypot(*(seen.to_tank(pixel)[0] - [1.5, 0.6])) == pytest.approx(np.hypot(1.5, 0.6) * 0.1 / 2.9, rel=1e-6)


def test_the_scale_is_the_slope_of_the_mapping():
    seen, pixel = camera(), np.array([300.0, 500.0])
    step = seen.to_tank([pixel + [1, 0], pixel + [0, 1]]) - seen.to_tank([pixel])
    assert np.allclose(seen.scale(pixel), step.T, rtol=2e-3)


def test_marks_give_the_plane_and_the_camera():
    truth = camera()
    marks = [Mark(f"m{k}", tuple(truth.to_pixel([p])[0]), p) for k, p in enumerate(POINTS)]
    fit = homography_from_marks(marks, truth.size, truth.matrix, truth.distortion)
    assert fit.rms < 1e-7 and fit.without is not None and fit.without.max() < 1e-6
    assert fit.calibration.camera == pytest.approx(truth.camera, abs=1e-5)
    assert camera_of(truth.homography, truth.matrix) == pytest.approx([0, 0, 3.0], abs=1e-9)


def test_a_mark_measured_wrongly_is_the_one_without_which_the_others_agree():
    truth = camera()
    marks = [Mark(f"m{k}", tuple(truth.to_pixel([p])[0]), p) for k, p in enumerate(POINTS)]
    marks[4] = marks[4]._replace(point=(0.1, 0.25))
    fit = homography_from_marks(marks, truth.size, truth.matrix, truth.distortion)
    assert fit.without is not None and int(np.argmin(fit.without)) == 4
    assert fit.without[4] < 1e-6 < 0.003 < np.delete(fit.without, 4).min() and fit.rms > 0.01


def test_four_marks_leave_nothing_to_check():
    truth = camera()
    marks = [Mark(f"m{k}", tuple(truth.to_pixel([p])[0]), p) for k, p in enumerate(POINTS[:4])]
    assert homography_from_marks(marks, truth.size, truth.matrix, truth.distortion).without is None


@pytest.mark.parametrize(
    ("points", "said"),
    [
        (POINTS[:3], "4 at least"),
        ([(x, 0.5 * x) for x in (-1.0, -0.4, 0.2, 1.0)], "one line"),
        ([*((x, 0.5 * x) for x in (-1.0, -0.4, 0.2, 1.0)), (0.3, -0.6)], "all marks but one"),
        ([*POINTS[:4], POINTS[2]], "m2 and m4 have one pixel"),
        ([*POINTS[:4], (3.0, 0.1)], "m4: pixel .* outside of the picture, 1280 x 720 px"),
    ],
)
def test_marks_that_cannot_do_are_refused(points, said):
    truth = camera()
    marks = [Mark(f"m{k}", tuple(truth.to_pixel([p])[0]), p) for k, p in enumerate(points)]
    with pytest.raises(ConfigError, match=said):
        homography_from_marks(marks, truth.size, truth.matrix, truth.distortion)


@pytest.mark.parametrize(("unit", "said"), [(100.0, "give the points of the marks in m"), (1000.0, "expected 0.05 to 100 m")])
def test_marks_in_another_unit_are_refused(unit, said):
    truth = camera()
    marks = [Mark(f"m{k}", tuple(truth.to_pixel([p])[0]), (unit * p[0], unit * p[1])) for k, p in enumerate(POINTS)]
    with pytest.raises(ConfigError, match=said):
        homography_from_marks(marks, truth.size, truth.matrix, truth.distortion)


def test_marks_that_no_camera_sees_so_are_refused():
    truth = camera()
    marks = [Mark(f"m{k}", tuple(truth.to_pixel([p])[0]), (1.3 * p[0], p[1])) for k, p in enumerate(POINTS)]
    with pytest.raises(ConfigError, match="no camera with this lens sees the marks so: 1 m along x would be 0.77 times"):
        homography_from_marks(marks, truth.size, truth.matrix, truth.distortion)


def test_marks_read_a_pixel_off_still_calibrate():
    truth, rng = camera(), np.random.default_rng(0)
    for _ in range(50):
        marks = [Mark(f"m{k}", tuple(truth.to_pixel([p])[0] + rng.normal(0, 1.0, 2)), p) for k, p in enumerate(POINTS[:6])]
        found = homography_from_marks(marks, truth.size, truth.matrix, truth.distortion).calibration
        assert abs(found.camera[2] / 3.0 - 1) < 0.1


def test_marks_that_mirror_the_tank_are_refused():
    truth = camera()
    marks = [Mark(f"m{k}", tuple(truth.to_pixel([p])[0]), (p[0], -p[1])) for k, p in enumerate(POINTS)]
    with pytest.raises(ConfigError, match="mirror"):
        homography_from_marks(marks, truth.size, truth.matrix, truth.distortion)


def test_a_calibration_survives_its_file(tmp_path):
    seen = camera(lag=0.031)
    back = Calibration.read(seen.write(tmp_path / "camera.toml"))
    assert back.lag == 0.031 and back.size == (1280, 720)
    pixels = np.random.default_rng(3).uniform(0, [1280, 720], (20, 2))
    assert np.array_equal(back.to_tank(pixels, -0.01), seen.to_tank(pixels, -0.01))


@pytest.mark.parametrize(
    ("old", "new", "error"),
    [
        ('schema = "fishmj.camera/1"', 'schema = "other"', ConfigError),
        ("size = [1280, 720]", "size = [1280]", ConfigError),
        ("size = [1280, 720]", 'size = "large"', ConfigError),
        ("lag = 0.0", "lag = -1.0", ConfigError),
        ("lag = 0.0", "delay = 0.0", UnknownName),
        ("distortion = [-0.12", "distortion = [nan", ConfigError),
        ("camera = [0.0, 0.0, 3.0]", "camera = [0.0, 0.0, -3.0]", ConfigError),
        ("camera = [0.0, 0.0, 3.0]\n", "", ConfigError),
    ],
)
def test_a_broken_file_is_one_line_that_names_it(tmp_path, old, new, error):
    path = camera().write(tmp_path / "camera.toml")
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(error, match="camera.toml") as told:
        Calibration.read(path)
    assert "\n" not in str(told.value)


def pictures(count: int, board: np.ndarray, corners: np.ndarray, matrix: np.ndarray, distortion: np.ndarray, tilt: float):
    """A board (its picture, its outer corners (4, 3) m) photographed at different angles."""
    random, made = np.random.default_rng(5), []
    size = (640, 480)
    pixels = np.stack(np.meshgrid(np.arange(size[0] * 2), np.arange(size[1] * 2)), -1).reshape(-1, 1, 2) / 2 - 0.25
    plain = cv2.undistortPoints(pixels, matrix, distortion, None, None, matrix).reshape(-1, 2)
    for _ in range(count):
        turn = cv2.Rodrigues(np.r_[random.uniform(-tilt, tilt, 2), random.uniform(-0.4, 0.4)])[0]
        middle = corners.mean(0)
        place = np.r_[random.uniform(-0.06, 0.06, 2), random.uniform(0.55, 0.75)] - turn @ middle
        flat = matrix @ np.c_[turn[:, :2], place]
        high, wide = board.shape
        x, y = corners[2, :2] / [wide, high]
        fine = flat @ np.array([[x, 0, 0.5 * x], [0, y, 0.5 * y], [0, 0, 1.0]])
        back = np.c_[plain, np.ones(len(plain))] @ np.linalg.inv(fine).T
        at = (back[:, :2] / back[:, 2:]).astype(np.float32).reshape(size[1] * 2, size[0] * 2, 2)
        large = cv2.remap(board, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderValue=170)
        made.append(cv2.resize(large, size, interpolation=cv2.INTER_AREA))
    return made


def chessboard() -> tuple[np.ndarray, np.ndarray]:
    cells = np.pad(np.indices((6, 8)).sum(0) % 2, 1, constant_values=1)
    board = np.kron(cells, np.ones((24, 24))) * 205 + 25
    return board.astype(np.uint8), np.array([(0, 0, 0), (0.3, 0, 0), (0.3, 0.24, 0), (0, 0.24, 0)])


def test_a_chessboard_gives_the_lens():
    matrix, distortion = np.array([[620.0, 0, 325], [0, 615, 236], [0, 0, 1]]), np.array([-0.15, 0.05, 0.001, -0.001, 0])
    found = calibrate_intrinsics(pictures(7, *chessboard(), matrix, distortion, 0.5), Board(7, 5, 0.03))
    assert found.rms < 0.3 and len(found.used) >= 5
    assert np.diag(found.matrix)[:2] == pytest.approx([620, 615], rel=0.01)
    assert found.matrix[:2, 2] == pytest.approx([325, 236], abs=5)
    assert found.distortion[0] == pytest.approx(-0.15, abs=0.03)


@pytest.mark.slow
def test_a_charuco_board_gives_the_lens():
    matrix = np.array([[620.0, 0, 325], [0, 615, 236], [0, 0, 1]])
    printed = cv2.aruco.CharucoBoard((7, 5), 0.04, 0.03, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100))
    board = printed.generateImage((7 * 48, 5 * 48), marginSize=0)
    corners = np.array([(0, 0, 0), (0.28, 0, 0), (0.28, 0.2, 0), (0, 0.2, 0)])
    found = calibrate_intrinsics(pictures(6, board, corners, matrix, np.zeros(5), 0.5), Board(7, 5, 0.04, 0.03))
    assert np.diag(found.matrix)[:2] == pytest.approx([620, 615], rel=0.015)


def test_pictures_without_a_board_say_so():
    grey = [np.full((480, 640), 120, np.uint8)] * 6
    with pytest.raises(ConfigError, match="found in 0 of 6"):
        calibrate_intrinsics(grey, Board(7, 5, 0.03))


def test_pictures_of_two_cameras_are_refused():
    with pytest.raises(ConfigError, match="2 sizes"):
        calibrate_intrinsics([np.zeros((480, 640), np.uint8), np.zeros((720, 1280), np.uint8)], Board(7, 5, 0.03))


def test_a_lens_that_folds_rays_back_inside_the_picture_is_refused():
    with pytest.raises(
        ConfigError, match=r"shows nothing beyond \d+ % of the way .* photograph the board in the corners"
    ) as told:
        overhead((1280, 720), 0.0028, 3.0, distortion=(-0.2, 0.1, 0.0, 0.0, -0.89))
    assert "\n" not in str(told.value)
    overhead((1280, 720), 0.0028, 3.0, distortion=(-0.28, 0.09, 0.0, 0.0, -0.01))  # a wide lens


def test_a_third_coefficient_that_mends_nothing_is_left_out():
    """A board in the middle of the picture alone tells k1; k3 would bend the corners at will."""
    matrix, distortion = np.array([[620.0, 0, 325], [0, 615, 236], [0, 0, 1]]), np.array([-0.15, 0.05, 0.001, -0.001, 0])
    found = calibrate_intrinsics(pictures(7, *chessboard(), matrix, distortion, 0.5), Board(7, 5, 0.03))
    assert found.distortion[4] == 0.0


def test_pictures_of_a_lens_that_cannot_be_are_refused_with_the_evidence(monkeypatch):
    def fitted(points, pixels, size, *_, **__):
        each = np.full(len(points), 0.3)
        lens = np.array([[620.0, 0, 325], [0, 615, 236], [0, 0, 1]])
        return 0.3, lens, np.array([[-0.4, 0.3, 0.0, 0.0, -0.89]]), None, None, np.ones(18), None, each

    matrix = np.array([[620.0, 0, 325], [0, 615, 236], [0, 0, 1]])
    images = pictures(5, *chessboard(), matrix, np.zeros(5), 0.4)
    monkeypatch.setattr(cv2, "calibrateCameraExtended", fitted)
    with pytest.raises(ConfigError, match=r"k1, k2, k3 = -0.4, 0.3, -0.89 at rms 0.30 px, the board was seen out to \d+ %"):
        calibrate_intrinsics(images, Board(7, 5, 0.03))
