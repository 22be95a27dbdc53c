"""How a real board may differ from the drawing: bowed, or printed and glued unevenly.

The model is linear: the corners are displaced by modes times coefficients, which the joint bundle
adjustment estimates.

A printed board is no perfect plane of equal squares. On the 13 real pairs of the OpenCV stereo set
whole columns of corners stand up to 0.18 mm off, the same in every picture: a printer's feed. Taken
for noise, that makes all corners of an image miss together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pivometer._arrays import Floats, checked, read_only
from pivometer.calibration.board import Board, BoardView
from pivometer.errors import CalibrationError

FEWEST_IMAGES = 4
"""Images that must show a corner whose place is unknown: two of them would determine it."""


@dataclass(frozen=True, slots=True, eq=False)
class BoardShape:
    """The board as it was estimated.

    Parameters
    ----------
    displacements_mm
        Where each inner corner is minus where it was drawn, board frame, shape (n, 3), mm.
    """

    displacements_mm: Floats

    def __post_init__(self) -> None:
        values = read_only(checked(self.displacements_mm, (None, 3), "displacements_mm"))
        object.__setattr__(self, "displacements_mm", values)

    @property
    def aside_rms_mm(self) -> float:
        """Root mean square of the corners' distance from the drawing within the plane, mm."""
        return float(np.sqrt(np.square(self.displacements_mm[:, :2]).sum(axis=1).mean()))

    @property
    def bow_mm(self) -> float:
        """Distance between the corner farthest in front of the plane and that farthest behind."""
        return float(np.ptp(self.displacements_mm[:, 2]))


def shape_modes(board: Board) -> Floats:
    """Return the ways in which the corners of a board may be displaced, shape (n, 3, b).

    Parameters
    ----------
    board
        The board, n inner corners. Its `form` says which ways there are: none; three depths of a
        quadric (bent along the width, twisted, bent along the height), each 1 mm between the middle
        and the end; or all but shifts, turns and a change of size, as 3n − 7 orthonormal
        displacements.

    References
    ----------
    K. Strobl and G. Hirzinger, "More accurate pinhole camera calibration with imperfect planar
    target", doi:10.1109/ICCVW.2011.6130369.

    Examples
    --------
    >>> forms = ("flat", "bowed", "free")
    >>> [shape_modes(Board("checkerboard", (9, 6), 15.0, form=form)).shape[2] for form in forms]
    [0, 3, 113]
    """
    count = board.corner_count
    if board.form == "flat":
        return np.zeros((count, 3, 0))
    if board.form == "free":
        kept = np.linalg.svd(_same_shape(board))[0][:, 7:]
        return kept.reshape(count, 3, -1)
    x, y = (2 * board.columns_rows / (np.array(board.inner_corners) - 1.0) - 1).T
    # a board that looks the same after a quarter turn is numbered from any of its four ends
    quarter = board.looks_same_turned and len(board.symmetries) > 2
    depths = [x * x + y * y] if quarter else [x * x, x * y, y * y]
    modes = np.zeros((count, 3, len(depths)))
    modes[:, 2] = _flattened(board, np.stack(depths, axis=1))
    return modes


def _same_shape(board: Board) -> Floats:
    """Return the displacements that shift, turn or scale a board, shape (3n, 7)."""
    centred = board.corners_mm - board.corners_mm.mean(axis=0)
    shifts = np.broadcast_to(np.eye(3), (len(centred), 3, 3))
    turns = np.stack([np.cross(axis, centred) for axis in np.eye(3)], axis=2)
    return np.concatenate([shifts, turns, centred[:, :, None]], axis=2).reshape(-1, 7)


def _flattened(board: Board, depths: Floats) -> Floats:
    """Return depths (n, b) over their best plane: the rest is a matter of the board's pose."""
    plane = np.concatenate([board.corners_mm[:, :2], np.ones((len(depths), 1))], axis=1)
    return np.asarray(depths - plane @ np.linalg.lstsq(plane, depths)[0])


def require_seen(views: Sequence[BoardView], board: Board) -> None:
    """Refuse a free form of a board some of whose corners hardly any image shows.

    Raises
    ------
    CalibrationError
        If the form is free and a corner was seen fewer than `FEWEST_IMAGES` times.
    """
    if board.form != "free":
        return
    seen = np.bincount(np.concatenate([v.ids for v in views]), minlength=board.corner_count)
    few = np.flatnonzero(seen < FEWEST_IMAGES)
    if len(few):
        raise CalibrationError(
            f"{len(few)} of the board's {board.corner_count} corners were seen fewer than "
            f"{FEWEST_IMAGES} times, the first is corner {few[0]}: where they really are cannot be "
            "estimated",
            next_step="show the whole board in more images, or take it for flat or bowed",
        )
