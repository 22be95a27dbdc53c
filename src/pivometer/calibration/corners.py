"""Find the board in one image and measure its inner corners.

OpenCV's detectors only say where to look. What they say is a hypothesis: every corner must be a
real saddle whose sign alternates like the squares do, and all of them must lie on one smoothly
distorted grid. The places come from the model fit in `pivometer.calibration.saddles`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pivometer._arrays import Floats
from pivometer.calibration.board import Board, BoardView, Ids
from pivometer.calibration.grid import GridMap, LocalFrames, fit_grid_map
from pivometer.calibration.saddles import Image, SaddleFits, Windows, fit_saddles
from pivometer.calibration.seeds import Seeds, board_hypotheses, other_sizes
from pivometer.cameras.mosaic import evened, is_mosaic
from pivometer.errors import BoardNotFoundError, ImageError

ARM_PX = 20.0
"""Longest arm of the cross of pixels used, px. Measured on synthetic 27 px squares (blur 0.7,
noise 2): error .0130, .0083, .0051, .0049 px at 10, 15, 20, 30 px, the time growing alike."""
REACH_SQUARES = 0.8
"""Longest arm in squares: the next corner must not blur into the window."""
SEED_BAND_PX = 5.0
"""How far to either side of a line the pixels of the first fit lie; a seed is better than that."""
LEAST_CONTRAST = 0.1
"""Part of the full range that an image's grey values must span to show a board."""

PART_OF_LARGER = 0.5
"""Part of the next row of corners that must be full saddles for the board to go on there: at most
0.17 on 134 whole boards, real and rendered, at least 0.83 on parts of larger ones."""
LEAST_FULL = 0.7
"""Contrast of a full saddle against the board's median."""
SEED_WINDOW_PX = 7.0
"""Half the first window, which only has to bring a seed to about 0.1 px."""


@dataclass(frozen=True, slots=True, eq=False)
class _Measured:
    """Corners of one hypothesis after the fit, their grid, and which of them stood the tests."""

    ids: Ids
    grid: GridMap
    fits: SaddleFits
    good: NDArray[np.bool_]
    first_square_black: bool


def find_corners(image: ArrayLike, board: Board, *, camera: str, view: str) -> BoardView:
    """Find `board` in an image and measure its inner corners.

    A checkerboard with an odd and an even count of squares is numbered from the end whose corner
    square is black, so all cameras agree; one that looks the same after a turn is numbered from
    any of its ends (see `Board.symmetries`).

    Parameters
    ----------
    image
        Grey image, shape (rows, columns), uint8 or uint16, raw (distorted).
    board
        The board looked for.
    camera, view
        Names for the result and the messages, as in `BoardView`.

    Returns
    -------
    BoardView
        The corners that stood all tests, with a standard uncertainty each; at least half of a
        checkerboard's, or a quarter of a ChArUco board's.

    Raises
    ------
    BoardNotFoundError
        If the board is not there, or not enough of it, with the likely cause.
    ImageError
        If `image` is not a grey image of 8 or 16 bit.
    """
    grey = _grey(image, view)
    best: _Measured | None = None
    for seeds in board_hypotheses(grey, board):
        measured = _measured(grey, board, seeds)
        if measured is None:
            continue
        if best is None or measured.good.sum() > best.good.sum():
            best = measured
        if best.good.sum() >= 0.9 * len(seeds.ids):
            break
    if best is None:
        raise _not_found(grey, board, view)
    _check_count(best, board, view)
    if board.kind == "checkerboard":
        _check_whole(grey, best, board, view)
    return _board_view(best, board, camera, view)


def _grey(image: ArrayLike, view: str) -> Image:
    array = np.asarray(image)
    if array.ndim != 2 or array.dtype not in (np.uint8, np.uint16) or min(array.shape) < 16:
        raise ImageError(
            f"{view}: the image is an array of shape {array.shape} and type {array.dtype}",
            next_step="pass a grey image of 8 or 16 bit, at least 16 px wide and high",
        )
    if not is_mosaic(array):
        return array
    return np.clip(np.rint(evened(array)), 0, np.iinfo(array.dtype).max).astype(array.dtype)


def _measured(image: Image, board: Board, seeds: Seeds) -> _Measured | None:
    """Refine a hypothesis in two rounds and test every corner; `None` if it is no grid at all."""
    places = board.columns_rows[seeds.ids].astype(np.float64)
    grid = fit_grid_map(places, seeds.pixels, image.shape)
    frames = _possible_frames(grid, places, image)
    if frames is None:
        return None
    fits = _first_fit(image, frames, _near_grid(frames, seeds.pixels))
    good = _stands(fits, frames, seeds.ids, board)
    if not good.all() and good.sum() >= 4:
        # wrong seeds are tried again from where the good corners put them
        grid = fit_grid_map(places[good], fits.pixels[good], image.shape)
        frames = _possible_frames(grid, places, image)
        if frames is None:
            return None
        start = np.where(good[:, None], fits.pixels, frames.pixels)
        fits = _first_fit(image, frames, start)
        good = _stands(fits, frames, seeds.ids, board)
    if good.sum() >= 4:
        grid = fit_grid_map(places[good], fits.pixels[good], image.shape, start=grid)
        frames = _possible_frames(grid, places, image)
        if frames is None:
            return None
        fits = _final_fit(image, board, frames, seeds.ids, fits)
        good = _stands(fits, frames, seeds.ids, board)
    return _Measured(seeds.ids, grid, fits, good, _black_first(fits, seeds.ids, board))


def _possible_frames(grid: GridMap, places: Floats, image: Image) -> LocalFrames | None:
    """Return the frames at `places`, or `None` if no image can show such a grid.

    It must be right-handed and have squares of a sensible size.
    """
    frames = grid.frames(places)
    numbers = (frames.pixels, frames.axes, frames.curvatures)
    if not all(np.isfinite(values).all() for values in numbers):
        return None
    sides = frames.sides_px
    flat_enough = (frames.areas_px2 > 0.1 * sides[:, 0] * sides[:, 1]).all()
    possible = flat_enough and sides.min() > 4 and sides.max() < max(image.shape)
    return frames if possible else None


def _near_grid(frames: LocalFrames, pixels: Floats) -> Floats:
    """Replace seeds more than a fifth of a square off the grid by the grid's own points."""
    away = np.linalg.norm(pixels - frames.pixels, axis=1)
    wild = away > 0.2 * frames.sides_px.min(axis=1)
    return np.where(wild[:, None], frames.pixels, pixels)


def _first_fit(image: Image, frames: LocalFrames, start: Floats) -> SaddleFits:
    reach = np.minimum(SEED_WINDOW_PX / frames.sides_px, 0.4)[:, :, None].repeat(2, axis=2)
    count = len(start)
    windows = Windows(reach, np.full(count, SEED_BAND_PX), 1.0, stride_px=2)
    return fit_saddles(image, start, frames, windows, blur_px=np.full(count, 1.5), settled_px=0.05)


def _final_fit(
    image: Image, board: Board, frames: LocalFrames, ids: Ids, fits: SaddleFits
) -> SaddleFits:
    blur = np.clip(fits.blur_px, 0.3, 2 * np.median(fits.blur_px))
    blur_squares = blur[:, None] / frames.sides_px
    reach = np.minimum(ARM_PX / frames.sides_px, (1 - 3 * blur_squares).clip(0.4, REACH_SQUARES))
    margin = 1.0
    if board.marker_mm is not None:
        margin = 0.5 * (1 - board.marker_mm / board.square_mm)
        margin = max(margin - float(np.median(blur_squares)), 0.5 * margin)
    ends = _outer_ends(image, board, ids, frames, fits, min(0.25, margin / 2))
    ends = (ends - 3 * blur_squares[..., None]).clip(0.2)
    windows = Windows(np.minimum(reach[..., None], ends), 3 * blur + 1.5, margin)
    start = np.where(_finite_near(fits, frames.pixels)[:, None], fits.pixels, frames.pixels)
    return fit_saddles(image, start, frames, windows, blur_px=blur, settled_px=5e-3)


def _outer_ends(
    image: Image, board: Board, ids: Ids, frames: LocalFrames, fits: SaddleFits, aside: float
) -> Floats:
    """How far the squares around each corner go on, shape (n, 2, 2) as `Windows.reach_squares`.

    Inside the board that is one square. The outermost squares are often cut: in the 26 real
    pictures of the OpenCV stereo set they are 0.4 to 0.6 squares wide. For each side of the board
    the grey values on either side of the outgoing lines are compared; where their difference
    falls below 0.7 of the contrast, for the median corner of that side, the board has ended.
    """
    ends = np.ones((len(ids), 2, 2))
    distances = np.arange(0.2, 1.01, 0.05)
    column_row = board.columns_rows[ids]
    inverse_sign = 1 / np.where(fits.contrast == 0, 1, 2 * fits.contrast)
    for axis in (0, 1):
        for side, edge in ((0, 0), (1, board.inner_corners[axis] - 1)):
            at = np.flatnonzero(column_row[:, axis] == edge)
            if len(at) == 0:
                continue
            along = frames.axes[at, :, axis] * (2 * side - 1)
            across = frames.axes[at, :, 1 - axis] * aside
            points = fits.pixels[at, None] + distances[:, None] * along[:, None]
            left, right = (_sampled(image, points + sign * across[:, None]) for sign in (1, -1))
            agreement = (left - right) * inverse_sign[at, None] * (2 * side - 1)
            fails = np.median(agreement, axis=0) < 0.7
            ends[at, axis, side] = distances[np.argmax(fails)] if fails.any() else 1.0
    return ends


def _sampled(image: Image, points: Floats) -> Floats:
    """Return the grey values of the pixels nearest to `points`, shape (..., 2)."""
    limit = np.array([image.shape[1], image.shape[0]]) - 1
    place = np.rint(points).clip(0, limit).astype(np.intp)
    values: Floats = image[place[..., 1], place[..., 0]].astype(np.float64)
    return values


def _finite_near(fits: SaddleFits, expected: Floats) -> NDArray[np.bool_]:
    near: NDArray[np.bool_] = np.linalg.norm(fits.pixels - expected, axis=1) < 3
    return near


def _stands(fits: SaddleFits, frames: LocalFrames, ids: Ids, board: Board) -> NDArray[np.bool_]:
    """Tell which corners are real: on the grid, of the right sign, and as sharp as the others."""
    side = frames.sides_px.min(axis=1)
    away: Floats = np.linalg.norm(fits.pixels - frames.pixels, axis=1)
    signed = fits.contrast * _signs(ids, board)
    contrast = float(np.median(signed))
    good = away < 0.5 + np.maximum(0.04 * side, 5 * np.median(away))
    good &= signed * np.sign(contrast) > 0.3 * abs(contrast)
    good &= fits.noise < 0.5 * np.abs(fits.contrast)
    good &= fits.blur_px < np.minimum(0.35 * side, 2.5 * np.median(fits.blur_px) + 0.5)
    good &= fits.sigma_px < 0.5
    good &= fits.coverage > 0.6
    return np.asarray(good, dtype=np.bool_)


def _signs(ids: Ids, board: Board) -> Floats:
    """+1 where the square across and down of a corner has the colour of the first square."""
    column_row = board.columns_rows[ids]
    signs: Floats = np.where(column_row.sum(axis=1) % 2, -1.0, 1.0)
    return signs


def _black_first(fits: SaddleFits, ids: Ids, board: Board) -> bool:
    return bool(np.median(fits.contrast * _signs(ids, board)) < 0)


def _board_view(measured: _Measured, board: Board, camera: str, view: str) -> BoardView:
    good, fits = measured.good, measured.fits
    found = BoardView(camera, view, measured.ids[good], fits.pixels[good], fits.sigma_px[good])
    if measured.first_square_black or board.kind == "charuco":
        return found
    turn = _recolouring_turn(board)
    return found if turn is None else found.renumbered(turn)


def _recolouring_turn(board: Board) -> Ids | None:
    """Return the renumbering by a turn that swaps the colours, where the board has one."""
    across, down = board.inner_corners
    ids = np.arange(board.corner_count, dtype=np.int64).reshape(down, across)
    if sum(board.squares) % 2:
        return np.rot90(ids, 2).ravel()
    if across == down and across % 2:
        return np.rot90(ids).ravel()
    return None


def _check_count(measured: _Measured, board: Board, view: str) -> None:
    """Refuse a board of which too little is left, with the numbers."""
    good, total = int(measured.good.sum()), board.corner_count
    wanted = -(-total // 2) if board.kind == "checkerboard" else max(6, -(-total // 4))
    column_row = board.columns_rows[measured.ids[measured.good]]
    if good >= wanted and (np.ptp(column_row, axis=0) > 0).all():
        return
    fits = measured.fits
    raise BoardNotFoundError(
        f"{view}: {len(measured.ids)} of the {total} corners of the {board} were guessed, but "
        f"only {good} are real corners on one flat grid ({wanted} wanted; blur "
        f"{np.median(fits.blur_px):.1f} px, contrast {2 * np.median(np.abs(fits.contrast)):.0f}, "
        f"residual {np.median(fits.noise):.1f} grey values)",
        next_step="take the picture again: a flat board, held still, in focus, without reflections",
    )


def _check_whole(image: Image, measured: _Measured, board: Board, view: str) -> None:
    """Refuse a part of a larger board: a detector asked for fewer squares finds some of them."""
    contrast = float(np.median(np.abs(measured.fits.contrast[measured.good])))
    beyond = [
        _goes_on(image, measured.grid, _row_outside(board, axis, side), contrast)
        for axis in (0, 1)
        for side in (0, 1)
    ]
    if max(beyond) > PART_OF_LARGER:
        raise BoardNotFoundError(
            f"{view}: the checkerboard goes on beyond the {board.squares[0]}×{board.squares[1]} "
            "squares that session.toml says",
            next_step="count the squares across and down, and correct [board] squares",
        )


def _row_outside(board: Board, axis: int, side: int) -> Floats:
    """Return where the next row of corners would be beyond one side of the board, (n, 2)."""
    along = np.arange(board.inner_corners[1 - axis], dtype=np.float64)
    place = board.inner_corners[axis] if side else -1
    row = np.stack([np.full_like(along, place), along], axis=1)
    return row if axis == 0 else row[:, ::-1].copy()


def _goes_on(image: Image, grid: GridMap, places: Floats, contrast: float) -> float:
    """Return the part of `places` that shows a full saddle; 0 where the image ends."""
    frames = _possible_frames(grid, places, image)
    if frames is None:
        return 0.0
    limit = np.array([image.shape[1], image.shape[0]]) - SEED_WINDOW_PX
    if not ((frames.pixels > SEED_WINDOW_PX) & (frames.pixels < limit)).all():
        return 0.0
    likely = _may_be_saddles(image, frames, contrast)
    if not likely.mean() > PART_OF_LARGER:
        return 0.0
    frames = grid.frames(places[likely])
    fits = _first_fit(image, frames, frames.pixels)
    near = np.linalg.norm(fits.pixels - frames.pixels, axis=1) < 0.1 * frames.sides_px.min(axis=1)
    full = np.abs(fits.contrast) > LEAST_FULL * contrast
    clear = fits.noise < 0.25 * np.abs(fits.contrast)
    return float((near & full & clear).sum() / len(places))


def _may_be_saddles(image: Image, frames: LocalFrames, contrast: float) -> NDArray[np.bool_]:
    """Tell where the four squares around a place alternate at all, from one pixel of each.

    Half of what a full saddle needs is asked, so that none is lost; a fit that finds none takes as
    long as that of the whole board.
    """
    across, down = 0.25 * frames.axes[..., 0], 0.25 * frames.axes[..., 1]
    grey = [
        sign * side * _sampled(image, frames.pixels + side * across + sign * down)
        for side in (1, -1)
        for sign in (1, -1)
    ]
    alternating: NDArray[np.bool_] = np.abs(np.mean(grey, axis=0)) > 0.5 * LEAST_FULL * contrast
    return alternating


def _not_found(image: Image, board: Board, view: str) -> BoardNotFoundError:
    """Say that there is no board, and why that may be."""
    across, down = board.squares
    what = f"{view}: no {board.kind} of {across}×{down} squares was found"
    light = _Light.of(image)
    searched = board.kind == "checkerboard" and not light.faint
    seen = _board_of_other_size(image, board) if searched else None
    if seen is not None:
        return BoardNotFoundError(
            f"{what}; the image shows one of {seen[0]}×{seen[1]} squares",
            next_step=(
                f"the image shows a board of {seen[0]}×{seen[1]} squares; session.toml says "
                f"{across}×{down}: correct squares there, or show the whole board"
            ),
        )
    reason, next_step = _likely_cause(light)
    return BoardNotFoundError(f"{what} ({reason})", next_step=next_step)


def _board_of_other_size(image: Image, board: Board) -> tuple[int, int] | None:
    """Return the size in squares of a complete checkerboard other than `board`, if one shows."""
    for size in other_sizes(image)[:2]:
        other = Board("checkerboard", size, board.square_mm)
        if sorted(size) == sorted(board.squares):
            continue
        seeds = next(board_hypotheses(image, other), None)
        measured = None if seeds is None else _measured(image, other, seeds)
        if measured is not None and measured.good.mean() > 0.9:
            return size
    return None


@dataclass(frozen=True, slots=True, eq=False)
class _Light:
    """About 500 rows of an image, their 1 and 99 percentiles, and the full scale."""

    rows: Floats
    dark: float
    bright: float
    full: float

    @classmethod
    def of(cls, image: Image) -> _Light:
        rows = image[:: max(1, image.shape[0] // 500)].astype(np.float64)
        dark, bright = np.percentile(rows, [1, 99])
        return cls(rows, float(dark), float(bright), float(np.iinfo(image.dtype).max))

    @property
    def faint(self) -> bool:
        """Whether there is too little contrast to show a board."""
        return self.bright - self.dark < LEAST_CONTRAST * self.full


def _likely_cause(seen: _Light) -> tuple[str, str]:
    """Describe an image's light and sharpness, and what follows from them."""
    steepest = float(np.percentile(np.abs(np.diff(seen.rows, axis=1)), 99.8))
    edge_px = (seen.bright - seen.dark) / max(steepest, 1e-9)
    clipped = float((seen.rows >= seen.full).mean())
    light = f"grey values from {seen.dark:.0f} to {seen.bright:.0f} of {seen.full:.0f}"
    if seen.faint:
        return f"{light}: too little contrast", "light the board more, or expose longer"
    if clipped > 0.3:
        return f"{clipped:.0%} of the pixels are saturated", "expose less, and avoid reflections"
    if edge_px > 8:
        return f"the sharpest edges are {edge_px:.0f} px wide", "focus, and hold the board still"
    return (
        light,
        "check that all inner corners are in view, and [board] in session.toml against the board",
    )
