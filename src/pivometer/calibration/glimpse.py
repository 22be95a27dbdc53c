"""The board at a glance, for live pictures: quick, good to a pixel or two, and never measured with.

A picture that counts is looked at again by `pivometer.calibration.corners`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pivometer._arrays import Floats, checked, read_only
from pivometer.calibration.board import Board, Ids
from pivometer.calibration.homography import homography
from pivometer.calibration.saddles import Image
from pivometer.calibration.seeds import board_hypotheses, stretched

GLANCE_SIDE_PX = 640
"""Longer images are averaged down to this: 8 to 15 ms a picture whatever the camera's size."""
ASSUMED_FOCAL = 1.5
"""Focal length over the longer side where no calibration is: tilts are then good to a third."""


@dataclass(frozen=True, slots=True, eq=False)
class BoardGlimpse:
    """What a glance shows of the board.

    Parameters
    ----------
    ids, pixels
        Corner numbers, shape (k,), and their rough places, shape (k, 2), raw px. A checkerboard may
        be numbered from any of its ends.
    middle
        The middle of its corners over the image's width and height, 0 to 1, shape (2,).
    size
        Square root of the part of the image that its corners span, 0 to 1.
    normal
        The board's normal in the camera's frame, towards the camera, with an assumed focal length,
        shape (3,).
    """

    ids: Ids
    pixels: Floats
    middle: Floats
    size: float
    normal: Floats

    def __post_init__(self) -> None:
        for name, shape in (("pixels", (None, 2)), ("middle", (2,)), ("normal", (3,))):
            object.__setattr__(self, name, read_only(checked(getattr(self, name), shape, name)))


def glimpse(image: Image, board: Board) -> BoardGlimpse | None:
    """Look for the board in a picture, quickly; `None` where it is not seen at once.

    Parameters
    ----------
    image
        Grey image, 8 or 16 bit.
    board
        The board looked for.
    """
    factor = -(-max(image.shape) // GLANCE_SIDE_PX)
    small = shrunk(image, factor)
    ids, pixels = (_charuco if board.kind == "charuco" else _checkerboard)(small, board)
    if len(ids) < 4:
        return None
    raw = (pixels + 0.5) * factor - 0.5
    height, width = image.shape
    normal = _normal(board.corners_mm[ids, :2], raw, width, height)
    if normal is None:
        return None
    return BoardGlimpse(
        ids, raw, raw.mean(axis=0) / [width, height], _size(raw, width, height), normal
    )


def shrunk(image: Image, factor: int) -> Image:
    """Return the means of blocks of pixels; whole ones take a quarter of the time of others.

    Examples
    --------
    >>> shrunk(np.array([[0, 4, 9], [4, 8, 9], [9, 9, 9]], dtype=np.uint8), 2)
    array([[4]], dtype=uint8)
    """
    import cv2

    if factor == 1:
        return image
    height, width = (side // factor for side in image.shape)
    whole = image[: height * factor, : width * factor]
    small: Image = np.ascontiguousarray(
        cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)
    )
    return small


def _checkerboard(small: Image, board: Board) -> tuple[Ids, Floats]:
    import cv2

    options = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
    found, corners = cv2.findChessboardCorners(stretched(small), board.inner_corners, flags=options)
    if not found:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 2))
    return np.arange(board.corner_count, dtype=np.int64), corners.reshape(-1, 2).astype(np.float64)


def _charuco(small: Image, board: Board) -> tuple[Ids, Floats]:
    seeds = next(board_hypotheses(small, board), None)
    if seeds is None:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 2))
    return seeds.ids, seeds.pixels


def _size(pixels: Floats, width: int, height: int) -> float:
    import cv2

    hull = cv2.convexHull(pixels.astype(np.float32))
    return float(np.sqrt(cv2.contourArea(hull) / (width * height)))


def _normal(plane_mm: Floats, pixels: Floats, width: int, height: int) -> Floats | None:
    """Return the board's normal from its homography K [r₁ r₂ t] (Zhang), towards the camera."""
    rays = (pixels - [(width - 1) / 2, (height - 1) / 2]) / (ASSUMED_FOCAL * max(width, height))
    try:
        H = homography(plane_mm, rays)
    except (np.linalg.LinAlgError, ValueError):
        return None
    normal = np.cross(H[:, 0], H[:, 1])
    length = float(np.linalg.norm(normal))
    if not np.isfinite(length) or length == 0:
        return None
    facing: Floats = normal * (-np.sign(normal[2]) / length)
    return facing
