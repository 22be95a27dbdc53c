"""What is odd about board views: mirrored, inverted, or not of the moment their names say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.calibration.board import Board, BoardView, Ids
from pivometer.calibration.half_turn import PosedView, camera_tree, relative_pose_by_vote
from pivometer.calibration.intrinsics import CameraCalibration, calibrate_camera
from pivometer.errors import CalibrationError

LAGS = (1, -1, 2, -2)


def diagnosed(
    error: CalibrationError,
    views: Sequence[BoardView],
    board: Board,
    image_sizes: Mapping[str, tuple[int, int]],
) -> CalibrationError:
    """Return a better reason why a calibration failed, or the same one where there is none.

    Two causes are tried out, each on two cameras: that one of them delivers mirrored images, and
    that the files of one are one or two moments off. A cause is told where the cameras' views fit
    one relative pose with it, and none without it.

    Parameters
    ----------
    error
        What the calibration said.
    views
        All views found.
    board
        The board.
    image_sizes
        Width and height of each camera's images, px.
    """
    try:
        names = list(image_sizes)
        tree = camera_tree(views, names)
        alone = {
            name: calibrate_camera(
                [v for v in views if v.camera == name], board, image_sizes[name], camera=name
            )
            for name in names
        }
    except CalibrationError:  # one camera by itself is the trouble, as the error says
        return error
    for first, second in tree:
        if _agree(alone[first], alone[second], board):
            continue
        cause = _mirrored(alone, first, second, board, image_sizes)
        cause = cause or _late(alone[first], alone[second], board)
        if cause is not None:
            return cause
    return error


def _agree(first: CameraCalibration, second: CameraCalibration, board: Board, lag: int = 0) -> bool:
    """Tell whether the moments of two cameras, paired as they are or shifted, fit one pose."""
    mine, theirs = _posed(first), _posed(second)
    moments = sorted(name for name in mine if name.startswith("board/"))
    pairs = [
        (mine[a], theirs[b])
        for a, b in zip(moments[max(0, -lag) :], moments[max(0, lag) :], strict=False)
        if b in theirs
    ]
    if len(pairs) < 3:
        return False
    try:
        relative_pose_by_vote(
            [a for a, _ in pairs], [b for _, b in pairs], board, (first.camera, second.camera)
        )
    except CalibrationError:
        return False
    return True


def _posed(calibration: CameraCalibration) -> dict[str, PosedView]:
    rows = zip(calibration.views, calibration.camera_from_board, strict=True)
    return {view.view: PosedView(view, pose) for view, pose in rows}


def _mirrored(
    alone: Mapping[str, CameraCalibration],
    first: str,
    second: str,
    board: Board,
    image_sizes: Mapping[str, tuple[int, int]],
) -> CalibrationError | None:
    """Unmirror one camera's views, numbered from either side, and see whether that explains it."""
    for relabel in _reflections(board):
        views = [_unmirrored(v, image_sizes[second][0], relabel) for v in alone[second].views]
        try:
            other = calibrate_camera(views, board, image_sizes[second], camera=second)
        except CalibrationError:
            continue
        if _agree(alone[first], other, board):
            shown = ", ".join(v.view for v in views[:3])
            return CalibrationError(
                f"the images of camera {first} or of camera {second} are mirrored, left for right: "
                f"with those of one of them turned back, all moments fit one relative pose "
                f"({shown} and so on)",
                next_step="switch mirroring off in that camera's software, or mirror all of its "
                "images back, those of the shaft too; text in the picture shows which it is",
            )
    return None


def _reflections(board: Board) -> list[Ids]:
    """Return the renumberings of a board seen in a mirror: from the other side, or upside down."""
    across, down = board.inner_corners
    ids = np.arange(board.corner_count, dtype=np.int64).reshape(down, across)
    return [ids[:, ::-1].ravel(), ids[::-1].ravel()]


def _unmirrored(view: BoardView, width: int, relabel: Ids) -> BoardView:
    ids = relabel[view.ids]
    order = np.argsort(ids)
    pixels = np.stack([width - 1 - view.pixels[:, 0], view.pixels[:, 1]], axis=1)
    return BoardView(view.camera, view.view, ids[order], pixels[order], view.sigma_px[order])


def _late(
    first: CameraCalibration, second: CameraCalibration, board: Board
) -> CalibrationError | None:
    """See whether the moments agree with the files of one camera shifted."""
    for lag in LAGS:
        if not _agree(first, second, board, lag):
            continue
        moments = sorted(v.view for v in first.views if v.view.startswith("board/"))
        a, b = next(iter(zip(moments[max(0, -lag) :], moments[max(0, lag) :], strict=False)))
        return CalibrationError(
            f"the board images of cameras {first.camera.name} and {second.camera.name} fit "
            f"together only {abs(lag)} {'moment' if abs(lag) == 1 else 'moments'} apart: what "
            f"{first.camera.name} shows in {a} is in {b} of {second.camera.name}",
            next_step=f"rename the files of camera {second.camera.name}: the same name must mean "
            "the same moment",
        )
    return None


def shows_inverted(image: NDArray[Any], view: BoardView, board: Board) -> bool:
    """Tell whether a ChArUco board is bright where it should be dark, as printed or displayed.

    Its plain squares, those without markers, are black; the rims of the others are white.

    Parameters
    ----------
    image
        The grey image in which `view` was found.
    view
        The corners.
    board
        The board.
    """
    places = {int(number): place for number, place in zip(view.ids, view.pixels, strict=True)}
    across, down = board.inner_corners
    rims: tuple[list[float], list[float]] = ([], [])
    busy: tuple[list[float], list[float]] = ([], [])
    for row in range(down - 1):
        for column in range(across - 1):
            first = row * across + column
            numbers = (first, first + 1, first + across, first + across + 1)
            if not all(number in places for number in numbers):
                continue
            ends = np.array([places[number] for number in numbers])
            centre = ends.mean(axis=0)
            parity = (row + column) % 2
            rims[parity].append(float(_grey_at(image, centre + 0.86 * (ends - centre)).mean()))
            steps = np.linspace(-0.6, 0.6, 9)[:, None, None]
            busy[parity].append(float(_grey_at(image, centre + steps * (ends - centre)).std()))
    if not (rims[0] and rims[1]):
        return False
    plain = int(np.argmin([np.median(values) for values in busy]))
    return bool(np.median(rims[plain]) > np.median(rims[1 - plain]))


def _grey_at(image: NDArray[Any], points: Floats) -> Floats:
    limit = np.array([image.shape[1], image.shape[0]]) - 1
    place = np.rint(points).clip(0, limit).astype(np.intp)
    values: Floats = image[place[..., 1], place[..., 0]].astype(np.float64)
    return values
