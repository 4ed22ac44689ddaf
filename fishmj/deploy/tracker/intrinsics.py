"""Camera matrix and distortion from pictures of a board: a chessboard, or a ChArUco board that may be cut off by the frame."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fishmj.base.errors import ConfigError
from fishmj.deploy.tracker.calibration import folding
from fishmj.mjcf.from_above import opencv

FEWEST = 5  # pictures
SIMPLER = 1.02  # times the rms with k3: a fit without it that is no worse is taken
DIFFERENT = 0.1  # of the focal length: pictures from one angle alone do not tell it


class Board(NamedTuple):
    """A printed board. `marker` > 0 makes it a ChArUco board with DICT_5X5_100.

    For a chessboard, columns x rows are its *inner* corners; for a ChArUco board its squares, as both are usually named.
    """

    columns: int
    rows: int
    square: float  # m
    marker: float = 0.0  # m


class Intrinsics(NamedTuple):
    """Lens data for `Calibration`."""

    size: tuple[int, int]  # px
    matrix: np.ndarray  # (3, 3)
    distortion: np.ndarray  # (5,) k1, k2, p1, p2, k3
    rms: float  # px, of all corners
    used: tuple[int, ...]  # which pictures showed the board
    each: np.ndarray  # (pictures used,) px, rms of each
    focal_sigma: float  # px, standard deviation of the focal length by the fit


def calibrate_intrinsics(images: Sequence[np.ndarray], board: Board) -> Intrinsics:
    """Fits the lens to pictures (H, W) or (H, W, 3) uint8 of a board held at different angles and places.

    Raises ConfigError: pictures of different sizes; the board in fewer than five of them; all from one angle; an impossible lens.
    """
    cv2 = opencv("the camera calibration")
    if board.columns < 3 or board.rows < 3 or board.square <= 0 or not 0 <= board.marker < board.square:
        raise ConfigError(
            f"board: got {tuple(board)}, expected 3 columns and rows at least, a square above 0 m and a smaller marker"
        )
    sizes = {image.shape[1::-1] for image in images}
    if len(sizes) != 1:
        raise ConfigError(f"intrinsics: pictures of {len(sizes)} sizes {sorted(sizes)}, expected one; use one camera mode")
    points, pixels, used = [], [], []
    for k, image in enumerate(images):
        grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        found = _charuco(cv2, grey, board) if board.marker else _chessboard(cv2, grey, board)
        if found is not None:
            points.append(found[0].astype(np.float32))
            pixels.append(found[1].astype(np.float32))
            used.append(k)
    if len(used) < FEWEST:
        raise ConfigError(
            f"intrinsics: the board of {board.columns} x {board.rows} was found in {len(used)} of {len(images)} pictures,"
            f" expected {FEWEST} at least; check the counts, the light and that the board is flat and wholly in sight"
        )
    (size,) = sizes
    fit = lambda flags: cv2.calibrateCameraExtended(points, pixels, size, None, None, flags=flags)
    found, plain = fit(0), fit(cv2.CALIB_FIX_K3)
    if plain[0] < SIMPLER * found[0]:  # a sixth power that mends nothing bends the corners, where no board was seen
        found = plain
    rms, matrix, distortion, _, _, sigma, _, each = found
    if folded := folding(size, matrix, distortion.ravel()[:5]):
        seen = np.concatenate([p.reshape(-1, 2) for p in pixels])
        reach = np.hypot(*(seen - matrix[:2, 2]).T).max() / np.hypot(*(np.array(size) / 2))
        raise ConfigError(
            f"intrinsics: k1, k2, k3 = {', '.join(f'{distortion.ravel()[i]:.2g}' for i in (0, 1, 4))} at rms {rms:.2f} px, the"
            f" board was seen out to {100 * reach:.0f} % of the half diagonal: {folded}"
        )
    focal_sigma = float(max(sigma.ravel()[:2]))
    if not focal_sigma < DIFFERENT * matrix[0, 0]:
        raise ConfigError(
            "intrinsics: the pictures do not tell the focal length; tilt the board by 20 to 40 degrees, each time another way"
        )
    return Intrinsics(size, matrix, distortion.ravel()[:5], float(rms), tuple(used), np.asarray(each).ravel(), focal_sigma)


def _chessboard(cv2, grey: np.ndarray, board: Board) -> tuple[np.ndarray, np.ndarray] | None:
    """Corners of the board, m, and in the picture, px."""
    there, corners = cv2.findChessboardCornersSB(grey, (board.columns, board.rows), flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    if not there:
        return None
    column, row = np.meshgrid(np.arange(board.columns), np.arange(board.rows))
    return np.c_[column.ravel(), row.ravel(), np.zeros(column.size)] * board.square, corners.reshape(-1, 1, 2)


def _charuco(cv2, grey: np.ndarray, board: Board) -> tuple[np.ndarray, np.ndarray] | None:
    """Visible corners of the board, m, and in the picture, px; six at least."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    printed = cv2.aruco.CharucoBoard((board.columns, board.rows), board.square, board.marker, dictionary)
    corners, numbers, _, _ = cv2.aruco.CharucoDetector(printed).detectBoard(grey)
    if numbers is None or len(numbers) < 6:
        return None
    return printed.getChessboardCorners()[np.asarray(numbers).ravel()], np.asarray(corners).reshape(-1, 1, 2)
