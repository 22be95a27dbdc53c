"""The calibration board, and what one camera saw of it.

Inner corners are numbered row by row, ``id = row * (across − 1) + column``, seen from the front.
The board frame has its origin at inner corner 0, x across, y down and z away from the viewer, so
a camera in front of the board sees across × down as a right-handed turn (y down in the image).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats, checked, read_only
from pivometer.errors import ShapeError, UsageError

BoardKind = Literal["checkerboard", "charuco"]
BoardForm = Literal["flat", "bowed", "free"]
Ids = NDArray[np.int64]
"""An int64 array of corner numbers."""


@dataclass(frozen=True, slots=True, eq=False)
class Board:
    """A calibration board of equal squares, nearly flat.

    Parameters
    ----------
    kind
        ``"checkerboard"``, or ``"charuco"``: a checkerboard with markers in its white squares.
    squares
        Number of squares (across, down), counting the outer ones: at least 4 each, ChArUco 3.
    square_mm
        Side of a square, mm.
    square_u_mm
        Standard uncertainty of `square_mm` as a scale common to the whole board, mm; `None` where
        it is not known.
    dictionary
        Name of the predefined ArUco dictionary (``"DICT_4X4_50"``); ChArUco only.
    marker_mm
        Side of a marker, mm, smaller than a square; ChArUco only.
    form
        What the joint adjustment takes the board for: ``"bowed"``, a quadric instead of a plane;
        ``"flat"``, as drawn; ``"free"``, every corner where it really is, with `square_mm` the mean
        over the whole board.

    Raises
    ------
    UsageError
        If the description is not that of a board.

    Examples
    --------
    >>> board = Board("checkerboard", (9, 7), 15.0)
    >>> board.inner_corners, board.corner_count
    ((8, 6), 48)
    >>> board.corners_mm[9]
    array([15., 15.,  0.])
    >>> board.symmetries[:, 0]
    array([ 0, 47])
    """

    kind: BoardKind
    squares: tuple[int, int]
    square_mm: float
    square_u_mm: float | None = None
    dictionary: str | None = None
    marker_mm: float | None = None
    form: BoardForm = "bowed"

    def __post_init__(self) -> None:
        across, down = (int(count) for count in self.squares)
        object.__setattr__(self, "squares", (across, down))
        fault = self._fault()
        if fault is not None:
            raise UsageError(fault, next_step="correct the [board] table of session.toml")

    def _fault(self) -> str | None:
        """Say what is wrong with this description, if anything is."""
        if self.kind not in get_args(BoardKind):
            return f"board kind {self.kind!r} is neither 'checkerboard' nor 'charuco'"
        if self.form not in get_args(BoardForm):
            return f"board form {self.form!r} is none of 'flat', 'bowed' and 'free'"
        if self.form == "free" and self.looks_same_turned:
            return (
                f"a board of {_times(self.squares)} squares looks the same after a turn: it "
                "cannot be told which corner is which, as form = 'free' must know"
            )
        if min(self.squares) < (4 if self.kind == "checkerboard" else 3):
            return f"a board of {_times(self.squares)} squares has too few inner corners"
        if not (np.isfinite(self.square_mm) and self.square_mm > 0):
            return f"the square size is {self.square_mm} mm"
        if self.square_u_mm is not None and not 0 <= self.square_u_mm < self.square_mm:
            return f"the uncertainty of the square size is {self.square_u_mm} mm"
        return self._charuco_fault() if self.kind == "charuco" else None

    def _charuco_fault(self) -> str | None:
        if not self.dictionary:
            return "a ChArUco board needs the name of its dictionary"
        if self.marker_mm is None or not 0 < self.marker_mm < self.square_mm:
            return f"the marker size is {self.marker_mm} mm, the square size {self.square_mm} mm"
        return None

    @property
    def looks_same_turned(self) -> bool:
        """Whether a turn in its plane leaves the pattern unchanged."""
        return self.kind == "checkerboard" and len(self.symmetries) > 1

    @property
    def inner_corners(self) -> tuple[int, int]:
        """Number of inner corners (across, down)."""
        return self.squares[0] - 1, self.squares[1] - 1

    @property
    def corner_count(self) -> int:
        """Number of inner corners."""
        return self.inner_corners[0] * self.inner_corners[1]

    @property
    def columns_rows(self) -> Ids:
        """Column and row of every inner corner, shape (n, 2), in the order of their numbers."""
        across = self.inner_corners[0]
        ids = np.arange(self.corner_count, dtype=np.int64)
        return np.stack([ids % across, ids // across], axis=1)

    @property
    def corners_mm(self) -> Floats:
        """The inner corners in the board frame, shape (n, 3), mm."""
        flat = self.columns_rows * self.square_mm
        return read_only(np.concatenate([flat, np.zeros((len(flat), 1))], axis=1))

    @property
    def edges(self) -> Ids:
        """Numbers of neighbouring inner corners, shape (m, 2): every side of every inner square."""
        across, down = self.inner_corners
        ids = np.arange(self.corner_count, dtype=np.int64).reshape(down, across)
        along = np.stack([ids[:, :-1].ravel(), ids[:, 1:].ravel()], axis=1)
        below = np.stack([ids[:-1].ravel(), ids[1:].ravel()], axis=1)
        return np.concatenate([along, below])

    @property
    def symmetries(self) -> Ids:
        """Turns in its plane that leave the pattern unchanged, shape (s, n), the identity first.

        ``symmetries[k, i]`` is the number that corner i of one numbering has in the other. A
        half-turn keeps the colours where across + down is even, a quarter-turn where the board is
        square with an odd count. Markers tell the turns of a ChArUco board apart.
        """
        across, down = self.inner_corners
        ids = np.arange(self.corner_count, dtype=np.int64).reshape(down, across)
        if self.kind == "charuco" or sum(self.squares) % 2:
            quarters = [0]
        elif across == down and self.squares[0] % 2:
            quarters = [0, 1, 2, 3]
        else:
            quarters = [0, 2]
        return np.stack([np.rot90(ids, turns).ravel() for turns in quarters])

    def __str__(self) -> str:
        return f"{self.kind} of {_times(self.squares)} squares of {self.square_mm:g} mm"


@dataclass(frozen=True, slots=True, eq=False)
class BoardView:
    """The inner corners that one camera saw of the board at one moment.

    Parameters
    ----------
    camera
        Name of the camera.
    view
        ``"board/000"`` for a moment seen by several cameras, ``"intrinsics/left/003"`` for a
        view of one camera.
    ids
        Numbers of the corners found, shape (k,), increasing.
    pixels
        Their raw (distorted) image points, shape (k, 2), px.
    sigma_px
        Standard uncertainty of each coordinate of `pixels`, shape (k,), px.

    Examples
    --------
    >>> BoardView("left", "board/000", [0, 1], [[10, 20], [30, 20]], [0.01, 0.01]).pixels.shape
    (2, 2)
    """

    camera: str
    view: str
    ids: Ids
    pixels: Floats
    sigma_px: Floats

    def __post_init__(self) -> None:
        ids = np.array(self.ids, dtype=np.int64)
        ids.setflags(write=False)
        if ids.ndim != 1 or (np.diff(ids) <= 0).any() or (ids < 0).any():
            raise ShapeError(
                f"{self.view}: corner numbers are not one increasing row of numbers from 0",
                next_step="pass each corner once, in the order of the numbers",
            )
        object.__setattr__(self, "ids", ids)
        for name, shape in (("pixels", (len(ids), 2)), ("sigma_px", (len(ids),))):
            object.__setattr__(self, name, read_only(checked(getattr(self, name), shape, name)))

    def renumbered(self, symmetry: Ids) -> BoardView:
        """Return this view with its corners numbered by one row of `Board.symmetries`.

        Examples
        --------
        >>> board = Board("checkerboard", (4, 4), 10.0)
        >>> view = BoardView("left", "board/000", [0, 8], [[1, 2], [3, 4]], [0.1, 0.2])
        >>> view.renumbered(board.symmetries[1]).pixels[0]
        array([3., 4.])
        """
        ids = np.asarray(symmetry, dtype=np.int64)[self.ids]
        order = np.argsort(ids)
        return BoardView(
            self.camera, self.view, ids[order], self.pixels[order], self.sigma_px[order]
        )


def _times(counts: tuple[int, int]) -> str:
    return f"{counts[0]}×{counts[1]}"
