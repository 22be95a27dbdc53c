"""A calibration board to print: the board in the middle of the page, instructions at its edges.

Around the board stays a white margin of at least one square, which detectors need. Above it the
page says what it shows and how to measure it; below it are a line of 100 mm, which tells whether
the printer has scaled the page, and the lines for ``session.toml``.
"""

import difflib
import math
from collections.abc import Iterator
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pivometer.calibration.board import Board
from pivometer.errors import UsageError
from pivometer.io.sheet import Rectangle, Sheet, Text

Paper = Literal["A4", "A3", "Letter"]

PAPERS_MM: dict[Paper, tuple[float, float]] = {
    "A4": (210.0, 297.0),
    "A3": (297.0, 420.0),
    "Letter": (215.9, 279.4),
}
"""Width and height of upright sheets, mm (ISO 216; ANSI Y14.1)."""

EDGE_MM = 7.0
"""What is left free at the paper's edges: usual printers leave out 3 to 6.4 mm."""
TYPE_MM, PITCH_MM = 2.4, 3.0
"""Size of the type and distance of its lines."""
CHECK_MM = 100.0
"""Length of the check line, between the middles of its ticks."""
_LINE_MM, _TICK_MM = 0.2, 4.0


def target_sheet(board: Board, *, paper: Paper = "A4") -> Sheet:
    """Lay out a board for printing, true to scale, in the middle of the page.

    The sheet lies as the board does (across the longer side if it has more squares across); it is
    turned where the board fits only so. Square (0, 0), top left, is black; ChArUco markers are
    those of OpenCV ≥ 4.6, in the white squares row by row.

    Parameters
    ----------
    board
        The board.
    paper
        The paper to print on.

    Returns
    -------
    Sheet
        The page, in mm.

    Raises
    ------
    UsageError
        If the board and a margin of one square do not fit, with the largest square that does; if
        OpenCV does not have the dictionary, or it has too few markers.

    Examples
    --------
    >>> sheet = target_sheet(Board("checkerboard", (9, 7), 15.0))
    >>> sheet.width_mm, sheet.height_mm
    (297.0, 210.0)
    >>> sheet.rectangles[0]
    Rectangle(x_mm=81.0, y_mm=52.5, width_mm=15.0, height_mm=15.0)
    """
    width, height = _page_mm(board, paper)
    across, down = board.squares
    left = (width - across * board.square_mm) / 2
    top = (height - down * board.square_mm) / 2
    footer = height - _band_mm(board)
    return Sheet(
        title=f"Calibration target: {board}",
        width_mm=width,
        height_mm=height,
        rectangles=(*_pattern(board, left, top), *_check_line(footer)),
        texts=(
            *_lines(_description(board), EDGE_MM, EDGE_MM),
            *_lines(_CHECK, EDGE_MM, footer + _TICK_MM),
            *_lines(session_lines(board), EDGE_MM + CHECK_MM + 2 * EDGE_MM, footer),
        ),
    )


def session_lines(board: Board) -> tuple[str, ...]:
    r"""Return the lines of ``session.toml`` that describe a board as it was meant.

    Examples
    --------
    >>> print(*session_lines(Board("checkerboard", (9, 7), 15.0)), sep="\n")
    [board]
    kind = "checkerboard"
    squares = [9, 7]
    square_mm = 15.0 # nominal: write what you measured
    """
    lines = (
        "[board]",
        f'kind = "{board.kind}"',
        f"squares = [{board.squares[0]}, {board.squares[1]}]",
        f"square_mm = {float(board.square_mm)} # nominal: write what you measured",
    )
    if board.kind == "checkerboard" or board.marker_mm is None:
        return lines
    scaled = f"marker_mm = {float(board.marker_mm)} # nominal: likewise"
    return (*lines, f'dictionary = "{board.dictionary}"', scaled)


# --- The page ---


def _page_mm(board: Board, paper: Paper) -> tuple[float, float]:
    """Return width and height of the sheet as it lies, mm."""
    upright = PAPERS_MM[paper]
    lying = upright[::-1]
    ways = (lying, upright) if board.squares[0] >= board.squares[1] else (upright, lying)
    for way in ways:
        if board.square_mm <= _largest_square_mm(board, way):
            return way
    largest = math.floor(10 * max(_largest_square_mm(board, way) for way in ways)) / 10
    smaller = f"squares of at most {largest:g} mm, " if largest >= 1 else ""
    raise UsageError(
        f"a {board} with a white margin of one square does not fit on {paper} paper",
        next_step=f"take {smaller}fewer squares or larger paper",
    )


def _largest_square_mm(board: Board, page_mm: tuple[float, float]) -> float:
    """Return the largest square for which board, margins and print fit on a page, mm."""
    across, down = board.squares
    return min(page_mm[0] / (across + 2), (page_mm[1] - 2 * _band_mm(board)) / (down + 2))


def _band_mm(board: Board) -> float:
    """Return the height that the print needs above and below; the same, to keep the middle."""
    return EDGE_MM + PITCH_MM * max(len(_description(board)), len(session_lines(board)))


# --- The print ---


def _description(board: Board) -> tuple[str, ...]:
    """Say what this is and what to do with it."""
    (across, down), side = board.squares, board.square_mm
    whole = f"{across * side:g} mm across / {across}, {down * side:g} mm down / {down}"
    what, markers = "Checkerboard", ""
    if board.marker_mm is not None and board.kind == "charuco":
        what, markers = "ChArUco board", f", markers {board.marker_mm:g} mm, {board.dictionary}"
    return (
        f"{what}: {across} × {down} squares (across × down), nominal square {side:g} mm{markers}",
        'Print at 100 % ("actual size", not "fit to page"). Glue it to something flat.',
        f"Measure one square over the whole board (nominally {whole}; both must give the same).",
        "Write it into session.toml, not the nominal size.",
    )


_CHECK = (
    "Measure this line: 100 mm between the middles of the end ticks.",
    "If it is not, the printer has scaled the page: print again at 100 %.",
)


def _lines(contents: tuple[str, ...], left: float, top: float) -> Iterator[Text]:
    """Set lines of text, the first one just below `top`."""
    for number, content in enumerate(contents):
        yield Text(left, top + TYPE_MM + PITCH_MM * number, TYPE_MM, content)


def _check_line(top: float) -> Iterator[Rectangle]:
    half = _LINE_MM / 2
    yield Rectangle(EDGE_MM + half, top + _TICK_MM / 2 - half, CHECK_MM - _LINE_MM, _LINE_MM)
    for x in (EDGE_MM, EDGE_MM + CHECK_MM):
        yield Rectangle(x - half, top, _LINE_MM, _TICK_MM)


# --- The board ---


def _pattern(board: Board, left: float, top: float) -> Iterator[Rectangle]:
    """Yield what is black, from the board's top left corner."""
    side = board.square_mm
    across, down = board.squares
    cells = [(row, column) for row in range(down) for column in range(across)]
    for row, column in cells:
        if (row + column) % 2 == 0:
            yield Rectangle(left + column * side, top + row * side, side, side)
    if board.kind == "checkerboard" or board.marker_mm is None:
        return
    white = [cell for cell in cells if sum(cell) % 2]
    aside = (side - board.marker_mm) / 2
    markers = _markers(str(board.dictionary), len(white))
    for (row, column), black in zip(white, markers, strict=True):
        x, y = left + column * side + aside, top + row * side + aside
        yield from _marker(black, x, y, board.marker_mm / len(black))


def _marker(
    black: NDArray[np.bool_], left: float, top: float, module: float
) -> Iterator[Rectangle]:
    """Yield the runs of black modules, row by row."""
    for row, modules in enumerate(black):
        edges = np.flatnonzero(np.diff(modules, prepend=False, append=False))
        for start, end in edges.reshape(-1, 2).tolist():
            x, y = left + start * module, top + row * module
            yield Rectangle(x, y, (end - start) * module, module)


def _markers(name: str, count: int) -> list[NDArray[np.bool_]]:
    """Return the first markers of a dictionary with their border, True where black."""
    import cv2

    known = [entry for entry in dir(cv2.aruco) if entry.startswith("DICT_")]
    if name not in known:
        near = difflib.get_close_matches(name.upper(), known, n=1, cutoff=0.4)
        raise UsageError(
            f"OpenCV knows no ArUco dictionary {name!r}",
            next_step=f"name one like {near[0] if near else 'DICT_4X4_50'}",
        )
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    if len(dictionary.bytesList) < count:
        raise UsageError(
            f"the board has {count} white squares, but {name} only {len(dictionary.bytesList)} "
            "markers",
            next_step="name a larger dictionary, such as DICT_4X4_1000, or take fewer squares",
        )
    size = dictionary.markerSize + 2
    images = (dictionary.generateImageMarker(number, size) for number in range(count))
    return [np.asarray(image) < 128 for image in images]
