"""The frame of a board that stands still: its pose in the rig, from all cameras and all views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pivometer._arrays import Floats, checked, read_only
from pivometer.calibration.board import Board, BoardView
from pivometer.calibration.half_turn import board_turns
from pivometer.calibration.homography import homography
from pivometer.calibration.intrinsics import camera_from_board_pose
from pivometer.cameras import Rig
from pivometer.errors import CalibrationError
from pivometer.geometry.rigid import RigidTransform, cross_matrix, rotation_from_vector

MOVED_PX = 0.1
"""Least common movement of a board's corners between views that counts, px: 0.05 mm at the paper's
distance, where the location in the board's frame is uncertain by 0.01 to 0.03 mm. Corners of a
board that stands still keep their place to 0.01 px."""
DISAGREE_PX = 0.5
"""Least misfit of a common pose that counts, px: good rigs place a board to 0.02 to 0.2 px."""
ACROSS = 0.1
"""Directions whose cosines to the right differ by less point equally far to the right."""


@dataclass(frozen=True, slots=True, eq=False)
class FixedBoard:
    """A board that stood still, as all cameras see it.

    Parameters
    ----------
    reference_from_board
        Its pose in the rig.
    covariance
        Covariance of the pose from the corners alone, the rig taken as exact: rotation vector
        applied on the left (rad), then translation (mm), shape (6, 6).
    rms_px
        Root-mean-square distance between mean corners and projected ones, px.
    means
        For each camera the mean of its corners over all views, numbered alike.
    views
        Names of the moments.
    note
        How an ambiguous board was numbered; empty where it is not ambiguous.
    """

    reference_from_board: RigidTransform
    covariance: Floats
    rms_px: float
    means: tuple[BoardView, ...]
    views: tuple[str, ...]
    note: str

    def __post_init__(self) -> None:
        values = read_only(checked(self.covariance, (6, 6), "covariance"))
        object.__setattr__(self, "covariance", values)


def fixed_board(
    views: Sequence[BoardView], board: Board, rig: Rig, *, noise_px: float
) -> FixedBoard:
    """Estimate the pose of a board that stood still while all views were taken.

    Each camera's corners are averaged over its views: what scatters from view to view averages
    out, what is wrong in the same way in all of them does not, so the residuals of the means say
    how well the pose is known.

    Parameters
    ----------
    views
        Views of the board by cameras of the rig; any numbering that the board's symmetry allows.
    board
        The board.
    rig
        The calibrated cameras.
    noise_px
        Noise of one corner coordinate in the calibration, px: more than ten times of it between
        the cameras is a disagreement.

    Raises
    ------
    CalibrationError
        If the board moved between the views, or the cameras do not agree on where it is.
    """
    by_camera = {
        camera.name: _numbered_like_first([v for v in views if v.camera == camera.name], board)
        for camera in rig.cameras
    }
    seen = [mine for mine in by_camera.values() if mine]
    if not seen:
        raise CalibrationError(
            "no camera saw the reference board",
            next_step="add images of the whole board under reference/<camera>/",
        )
    _refuse_moved(seen)
    means = [_mean_view(mine) for mine in seen]
    start = pose_alone(max(means, key=lambda view: len(view.ids)), board, rig)
    means = [numbered_as_projected(view, board, rig, start) for view in means]
    pose = board_pose(means, board.corners_mm, rig, start, steps=20)
    turn = _upright(pose, board)
    means = [view.renumbered(board.symmetries[turn]) for view in means]
    pose = board_pose(means, board.corners_mm, rig, pose @ board_turns(board)[turn])
    errors, jacobian = projection_errors(means, board.corners_mm, rig, pose)
    rms_px = float(np.sqrt(2 * np.mean(errors**2)))
    _refuse_disagreement(rms_px, noise_px, views)
    floor = float(np.mean([np.mean(view.sigma_px**2) for view in means]))
    variance = max(float(errors @ errors) / (len(errors) - 6), floor)
    covariance: Floats = variance * np.linalg.inv(jacobian.T @ jacobian).astype(np.float64)
    return FixedBoard(
        pose,
        covariance,
        rms_px,
        tuple(means),
        tuple(dict.fromkeys(view.view for view in views)),
        _turn_note(board, rig),
    )


def board_pose(
    views: Sequence[BoardView],
    corners_mm: Floats,
    rig: Rig,
    start: RigidTransform,
    *,
    steps: int = 6,
) -> RigidTransform:
    """Return ``reference_from_board`` with the least squared distances in all images.

    Parameters
    ----------
    views
        What each camera saw of the board at one place, numbered alike.
    corners_mm
        The board's corners in its own frame, shape (n, 3), mm.
    rig
        The cameras.
    start
        Where to begin; good to a few degrees.
    steps
        Gauss–Newton steps; quadratic near the end.
    """
    pose = start
    for _ in range(steps):
        errors, jacobian = projection_errors(views, corners_mm, rig, pose)
        step: Floats = np.linalg.lstsq(jacobian, -errors, rcond=None)[0].astype(np.float64)
        pose = moved(pose, step)
        if float(np.abs(step).max()) < 1e-10:
            break
    return pose


def moved(pose: RigidTransform, step: Floats) -> RigidTransform:
    """Return a pose turned on the left by a rotation vector (rad) and shifted (mm), (6,)."""
    rotation = rotation_from_vector(step[:3]) @ pose.rotation
    return RigidTransform(rotation, pose.translation_mm + step[3:])


def shift_of_corners(view: BoardView, other: BoardView) -> Floats | None:
    """Return how corners common to two views of a camera moved, smoothed, shape (k, 2), px.

    A board or camera that moves shifts all corners together, so an affine map of the places is
    fitted to the differences; the noise of single corners drops out. `None` if fewer than six
    corners are common.
    """
    _, mine, theirs = np.intersect1d(view.ids, other.ids, return_indices=True)
    if len(mine) < 6:
        return None
    places = view.pixels[mine]
    away = np.concatenate([places - places.mean(axis=0), np.ones((len(mine), 1))], axis=1)
    shift: Floats = (
        away @ np.linalg.lstsq(away, other.pixels[theirs] - view.pixels[mine], rcond=None)[0]
    )
    return shift


def _numbered_like_first(views: Sequence[BoardView], board: Board) -> list[BoardView]:
    """Renumber one camera's views of a standing board like the fullest of them."""
    if not views:
        return []
    first = max(views, key=lambda view: len(view.ids))
    return [
        min(
            (view.renumbered(symmetry) for symmetry in board.symmetries),
            key=lambda turned: _apart_px(turned, first),
        )
        for view in views
    ]


def _apart_px(view: BoardView, other: BoardView) -> float:
    _, mine, theirs = np.intersect1d(view.ids, other.ids, return_indices=True)
    if not len(mine):
        return float("inf")
    return float(np.sqrt(np.mean((view.pixels[mine] - other.pixels[theirs]) ** 2)))


def _refuse_moved(seen: Sequence[Sequence[BoardView]]) -> None:
    """Refuse views between which the board, or a camera, moved."""
    named = []
    for views in seen:
        middle = _median_view(views)
        for view in views:
            shift = shift_of_corners(middle, view)
            if shift is None:
                continue
            rms = float(np.sqrt(np.mean(np.sum(shift**2, axis=1))))
            if rms > MOVED_PX:
                named.append(f"{view.view} by {rms:.2f} px in camera {view.camera}")
    if named:
        raise CalibrationError(
            "the reference board moved between its views (or a camera did): apart from the "
            f"others are {', '.join(named)}",
            next_step="fix board and cameras, keep only the views taken before the movement, or "
            "take them again",
        )


def _stacked(views: Sequence[BoardView]) -> tuple[Floats, Floats, Floats]:
    """Return ids of all corners, and their places in every view, NaN where not seen."""
    ids = np.unique(np.concatenate([view.ids for view in views]))
    places = np.full((len(views), len(ids), 2), np.nan)
    sigma = np.full((len(views), len(ids)), np.nan)
    for row, view in enumerate(views):
        at = np.searchsorted(ids, view.ids)
        places[row, at], sigma[row, at] = view.pixels, view.sigma_px
    return ids, places, sigma


def _median_view(views: Sequence[BoardView]) -> BoardView:
    ids, places, sigma = _stacked(views)
    return BoardView(
        views[0].camera,
        views[0].view,
        ids.astype(np.int64),
        np.nanmedian(places, axis=0),
        np.nanmedian(sigma, axis=0),
    )


def _mean_view(views: Sequence[BoardView]) -> BoardView:
    """Average one camera's views; each corner over the views that have it."""
    ids, places, sigma = _stacked(views)
    count = np.isfinite(sigma).sum(axis=0)
    return BoardView(
        views[0].camera,
        views[0].view,
        ids.astype(np.int64),
        np.nanmean(places, axis=0),
        np.sqrt(np.nanmean(sigma**2, axis=0) / count),
    )


def pose_alone(view: BoardView, board: Board, rig: Rig) -> RigidTransform:
    """Return the board's pose in the reference frame from one camera's view."""
    index = rig.index(view.camera)
    normalized = rig.cameras[index].normalized_from_pixels(view.pixels)
    corners = board.corners_mm[view.ids]
    H = homography(corners[:, :2], normalized)
    return rig.reference_from_camera[index] @ camera_from_board_pose(np.eye(3), H, corners)


def numbered_as_projected(
    view: BoardView, board: Board, rig: Rig, pose: RigidTransform
) -> BoardView:
    """Choose the numbering under which the board, posed as it is, lands nearest to the corners."""
    normalized, _ = _normalized(view.camera, board.corners_mm, rig, pose)
    image = rig.cameras[rig.index(view.camera)].pixels_from_normalized(normalized)
    turned = [view.renumbered(symmetry) for symmetry in board.symmetries]
    return min(turned, key=lambda v: float(np.sum((image[v.ids] - v.pixels) ** 2)))


def _normalized(
    camera: str, corners_mm: Floats, rig: Rig, pose: RigidTransform
) -> tuple[Floats, Floats]:
    """Return normalized images (n, 2) and the points in the camera's frame (n, 3)."""
    to_camera = rig.reference_from_camera[rig.index(camera)].inverse()
    points = to_camera @ (pose @ corners_mm)
    if (points[:, 2] <= 0).any():
        raise CalibrationError(
            f"camera {camera} has the reference board behind it, by the other cameras' views",
            next_step="check that its images show the same board at the same place",
        )
    return points[:, :2] / points[:, 2:], points


def projection_errors(
    views: Sequence[BoardView], corners_mm: Floats, rig: Rig, pose: RigidTransform
) -> tuple[Floats, Floats]:
    """Return projected minus seen corners (m,), px, and their derivatives (m, 6), see `moved`."""
    errors, jacobians = [], []
    for view in views:
        index = rig.index(view.camera)
        camera = rig.cameras[index]
        normalized, points = _normalized(view.camera, corners_mm[view.ids], rig, pose)
        flat = np.broadcast_to(np.eye(2), (len(points), 2, 2))
        slope = np.concatenate([flat, -normalized[..., None]], axis=2) / points[:, 2:, None]
        slope = camera.pixels_jacobian(normalized) @ slope
        slope = slope @ rig.reference_from_camera[index].rotation.T
        arms = corners_mm[view.ids] @ pose.rotation.T
        jacobians.append(np.concatenate([-slope @ cross_matrix(arms), slope], axis=2))
        errors.append(camera.pixels_from_normalized(normalized) - view.pixels)
    return np.concatenate(errors).ravel(), np.concatenate(jacobians).reshape(-1, 6)


def _upright(pose: RigidTransform, board: Board) -> int:
    """Return the turn after which the board's x axis points right in the reference camera.

    Where it points neither right nor left, it shall point down.
    """
    x = np.array([(pose @ turn).rotation[:, 0] for turn in board_turns(board)])
    right = x[:, 0] > x[:, 0].max() - ACROSS
    return int(np.argmax(np.where(right, x[:, 1], -np.inf)))


def _turn_note(board: Board, rig: Rig) -> str:
    if len(board.symmetries) == 1:
        return ""
    return (
        "the reference board looks the same after a turn in its plane: of the frames it allows, "
        f"the one is used whose x axis points right in the image of camera {rig.reference} (down, "
        "where it points neither right nor left); a board with one even and one odd number of "
        "squares has only one frame"
    )


def _refuse_disagreement(rms_px: float, noise_px: float, views: Sequence[BoardView]) -> None:
    if rms_px <= max(DISAGREE_PX, 10 * noise_px):
        return
    names = ", ".join(dict.fromkeys(view.view for view in views))
    raise CalibrationError(
        f"the cameras do not agree on where the reference board stands ({names}): the best common "
        f"place misses the corners by {rms_px:.2f} px rms, where the calibration leaves "
        f"{noise_px:.2f} px",
        next_step="check that a camera was not moved since the board images, and take them again",
    )
