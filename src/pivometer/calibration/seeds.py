"""Where a board might be in an image: guesses of its corners, good to a few pixels.

Every guess is only a hypothesis for `pivometer.calibration.corners` to test: OpenCV's detectors
report success with corners several pixels off now and then.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.calibration.board import Board, Ids
from pivometer.calibration.saddles import Image
from pivometer.errors import UsageError

Grey8 = NDArray[np.uint8]

USUAL_SIDE_PX = 1000
"""Longer images are searched at this size first: OpenCV's search costs grow with the area."""
SMALL_SIDE_PX = 400
"""Shorter images are also searched at twice their size."""


@dataclass(frozen=True, slots=True, eq=False)
class Seeds:
    """A guess: corner numbers, shape (k,), and rough places, shape (k, 2), px."""

    ids: Ids
    pixels: Floats


def board_hypotheses(image: Image, board: Board) -> Iterator[Seeds]:
    """Guess where the board is, the likeliest and cheapest way first.

    Parameters
    ----------
    image
        Grey image, 8 or 16 bit.
    board
        The board looked for.

    Raises
    ------
    UsageError
        If OpenCV does not know the dictionary of a ChArUco board.
    """
    grey = stretched(image)
    yield from (_charuco if board.kind == "charuco" else _checkerboard)(grey, board)


def stretched(image: Image) -> Grey8:
    """Return `image` as 8 bit with its 0.5 to 99.5 percentiles spread over the full range.

    Examples
    --------
    >>> stretched(np.array([[1000, 1010], [1010, 1020]], dtype=np.uint16))
    array([[  0, 127],
           [127, 255]], dtype=uint8)
    """
    rows, columns = image.shape
    sample = image[:: max(1, rows // 400), :: max(1, columns // 400)]
    low, high = np.percentile(sample, [0.5, 99.5])
    levels = (np.arange(int(image.max()) + 1) - low) * (255 / max(high - low, 1))
    table = levels.clip(0, 255).astype(np.uint8)
    grey: Grey8 = table[image]
    return grey


def _checkerboard(grey: Grey8, board: Board) -> Iterator[Seeds]:
    """Try the classic detector, then the sector-based one, then the classic one on other sizes.

    Halving the size cures blur, which defeats both; doubling helps where squares are small, and is
    kept to small images: without a board it took 0.5 to 2 s of 640×480 pixels.
    """
    longest = max(grey.shape)
    usual = min(1.0, USUAL_SIDE_PX / longest)
    scales = [(usual, False), (usual, True), (0.5 * usual, False)]
    if usual < 1:
        scales.append((min(1.0, 2.5 * usual), False))
    elif longest <= SMALL_SIDE_PX:
        scales.append((2.0, False))
    for scale, sector_based in scales:
        found = _checkerboard_once(grey, board.inner_corners, scale, sector_based=sector_based)
        if found is not None:
            yield Seeds(np.arange(len(found), dtype=np.int64), _right_handed(found, board))


def _checkerboard_once(
    grey: Grey8, inner_corners: tuple[int, int], scale: float, *, sector_based: bool
) -> Floats | None:
    """Run one of OpenCV's detectors at one scale; `None` where it finds nothing.

    The classic detector's quick check comes first: with it all of 64 rendered and 35 of 36 real
    boards are still found (the last never was), and pictures without a board take it 0.02 to
    0.4 s instead of 0.2 to 1.1 s. One of several small boards in a montage of pictures is lost.
    A search by sectors that is not exhaustive takes half the time, but found only 14 of 22
    rendered boards.
    """
    import cv2

    small = _resized(grey, scale)
    if sector_based:
        found, corners = cv2.findChessboardCornersSB(
            small, inner_corners, flags=cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE
        )
    else:
        options = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
        found, corners = cv2.findChessboardCorners(small, inner_corners, flags=options)
    if not found:
        return None
    pixels: Floats = (corners.reshape(-1, 2).astype(np.float64) + 0.5) / scale - 0.5
    return pixels


def _resized(grey: Grey8, scale: float) -> Grey8:
    import cv2

    if scale == 1:
        return grey
    size = (round(grey.shape[1] * scale), round(grey.shape[0] * scale))
    method = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(grey, size, interpolation=method), dtype=np.uint8)


def _right_handed(pixels: Floats, board: Board) -> Floats:
    """Turn mirrored numbering round, so that across × down is positive with y down."""
    across, down = board.inner_corners
    grid = pixels.reshape(down, across, 2)
    right, below = grid[:, -1] - grid[:, 0], grid[-1] - grid[0]
    (x1, y1), (x2, y2) = right.mean(axis=0), below.mean(axis=0)
    return (grid if x1 * y2 - y1 * x2 > 0 else grid[:, ::-1]).reshape(-1, 2)


def _charuco(grey: Grey8, board: Board) -> Iterator[Seeds]:
    """Read the markers, of the image and of its negative, in today's and the old layout.

    Before OpenCV 4.6 boards with an even number of rows began with a white square.
    """
    import cv2

    name = str(board.dictionary)
    if not hasattr(cv2.aruco, name):
        raise UsageError(
            f"OpenCV knows no ArUco dictionary {name!r}",
            next_step='name one like "DICT_4X4_50" or "DICT_5X5_100" in session.toml',
        )
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    sides = float(board.square_mm), float(board.marker_mm or 0)
    for picture in (grey, 255 - grey):
        for old_layout in (False, True):
            pattern = cv2.aruco.CharucoBoard(board.squares, *sides, dictionary)
            pattern.setLegacyPattern(old_layout)
            detector = cv2.aruco.CharucoDetector(pattern)
            corners, found, _, _ = detector.detectBoard(picture)
            # nothing found comes back as None, which OpenCV's type stubs do not say
            ids = np.array([] if found is None else found, dtype=np.int64).ravel()  # type: ignore[redundant-expr]
            if len(ids) >= 4:
                order = np.argsort(ids)
                places = np.asarray(corners, dtype=np.float64).reshape(-1, 2)[order]
                yield Seeds(ids[order], places)


def other_sizes(image: Image) -> list[tuple[int, int]]:
    """Return sizes, in squares, of checkerboards that may be in view, the largest first.

    For messages only. OpenCV's search for boards of any size often stops at a part of the board
    (in 6 of 16 trials on four real and rendered pictures), differently with each of its options;
    a size is worth telling once a board of just that size has been found.
    """
    import cv2

    grey = _resized(stretched(image), min(1.0, USUAL_SIDE_PX / max(image.shape)))
    sizes = set()
    for option in (0, cv2.CALIB_CB_EXHAUSTIVE, cv2.CALIB_CB_NORMALIZE_IMAGE):
        found, _, meta = cv2.findChessboardCornersSBWithMeta(
            grey, (3, 3), cv2.CALIB_CB_LARGER | option
        )
        if found:
            across, down = sorted(meta.shape[:2], reverse=True)
            sizes.add((across + 1, down + 1))
    return sorted(sizes, key=lambda size: -size[0] * size[1])
