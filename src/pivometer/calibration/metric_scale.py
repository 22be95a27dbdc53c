"""Triangulated board corners, their edges, and the metric upgrade (21)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pivometer._arrays import Floats, checked
from pivometer.calibration.board import Board, BoardView
from pivometer.calibration.result import LengthError
from pivometer.cameras import Rig
from pivometer.errors import CalibrationError
from pivometer.geometry.line import projectors
from pivometer.geometry.rigid import RigidTransform


def triangulate_points(
    normalized: ArrayLike,
    reference_from_camera: Sequence[RigidTransform],
    *,
    weights: Sequence[float] | None = None,
) -> Floats:
    """Return points in the reference frame from their images in several cameras, shape (n, 3).

    The point nearest to all rays starts; Gauss–Newton then minimises the squared distances in the
    images, which for two cameras is the optimal correction of (19) with the pose known.

    Parameters
    ----------
    normalized
        Normalised undistorted points in each camera, shape (c, n, 2).
    reference_from_camera
        Poses of the c cameras.
    weights
        Weight of each camera's image error, e.g. its focal length in px; alike by default.

    Returns
    -------
    Points, shape (n, 3), in the unit of the translations (mm).

    Raises
    ------
    CalibrationError
        If the rays to a point are parallel.

    References
    ----------
    Hartley and Zisserman, chapter 12 (the paper's reference [15]).

    Examples
    --------
    >>> left = RigidTransform.identity()
    >>> right = RigidTransform(np.eye(3), np.array([100.0, 0, 0]))
    >>> triangulate_points([[[0.1, 0.0]], [[-0.1, 0.0]]], [left, right]).round(9)
    array([[ 50.,   0., 500.]])
    """
    points = checked(normalized, (len(reference_from_camera), None, 2), "normalized")
    scale = np.ones(len(points)) if weights is None else checked(weights, (len(points),), "weights")
    R = np.array([t.rotation for t in reference_from_camera])
    centres = np.array([t.translation_mm for t in reference_from_camera])
    X = _nearest_to_rays(points, R, centres)
    for _ in range(3):  # quadratic from a start good to the noise
        X = X + _image_step(X, points, R, centres, scale)
    return X


def _nearest_to_rays(points: Floats, R: Floats, centres: Floats) -> Floats:
    ones = np.ones((*points.shape[:2], 1))
    rays = np.concatenate([points, ones], axis=-1) @ np.swapaxes(R, 1, 2)
    rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    across = projectors(rays)
    N = across.sum(axis=0)
    if len(N) and float(np.linalg.eigvalsh(N)[:, 0].min()) < 1e-8:
        raise CalibrationError(
            "the rays of the cameras to a board corner are parallel",
            next_step="move the cameras further apart; 60° to 90° between them is best",
        )
    target = np.einsum("cnij,cj->ni", across, centres)
    nearest: Floats = np.linalg.solve(N, target[..., None])[..., 0]
    return nearest


def _image_step(X: Floats, points: Floats, R: Floats, centres: Floats, scale: Floats) -> Floats:
    """Return the Gauss–Newton step that lowers the image errors, shape (n, 3)."""
    local = (X - centres[:, None]) @ R
    depth = local[..., 2:]
    image = local[..., :2] / depth
    error = (image - points) * scale[:, None, None]
    flat = np.broadcast_to(np.eye(2), (*image.shape, 2))
    J = np.concatenate([flat, -image[..., None]], axis=-1) / depth[..., None]
    J = (J @ np.swapaxes(R, 1, 2)[:, None]) * scale[:, None, None, None]
    H = np.einsum("cnki,cnkj->nij", J, J)
    g = np.einsum("cnki,cnk->ni", J, error)
    step: Floats = -np.linalg.solve(H, g[..., None])[..., 0]
    return step


def edge_lengths(points: ArrayLike, edges: ArrayLike) -> Floats:
    """Return the lengths of edges between points, shape (m,), in the unit of the points.

    Examples
    --------
    >>> edge_lengths([[0, 0, 0], [3, 4, 0]], [[0, 1]])
    array([5.])
    """
    ends = checked(points, (None, 3), "points")
    pairs = np.asarray(edges, dtype=np.int64)
    lengths: Floats = np.linalg.norm(ends[pairs[:, 0]] - ends[pairs[:, 1]], axis=-1)
    return lengths


def metric_scale(lengths: ArrayLike, edge_mm: float) -> float:
    """Return the scale s that minimises ‖L s − 1 l‖₂, mm per unit of `lengths`.

    Parameters
    ----------
    lengths
        Reconstructed edge lengths L, shape (m,), any unit.
    edge_mm
        The known edge length l, mm.

    Raises
    ------
    CalibrationError
        If there is no edge.

    References
    ----------
    Wilson et al., eq. (21).

    Examples
    --------
    >>> metric_scale([0.5, 0.5], 15.0)
    30.0
    """
    L = checked(lengths, (None,), "lengths")
    if not len(L) or not (L > 0).any():
        raise CalibrationError(
            "no board edge is seen by two cameras at once, so the scale is unknown",
            next_step="add images that show neighbouring board corners in both cameras",
        )
    return float(edge_mm * L.sum() / (L @ L))


def length_error(lengths_mm: ArrayLike, edge_mm: float) -> LengthError:
    """Return the largest and the rms difference of edges from their known length, mm."""
    errors = checked(lengths_mm, (None,), "lengths_mm") - edge_mm
    return LengthError(float(np.abs(errors).max()), float(np.sqrt(np.mean(errors**2))), len(errors))


def reconstructed_edges(views: Sequence[BoardView], board: Board, rig: Rig) -> Floats:
    """Return lengths of all board edges seen by at least two cameras at a moment, shape (m,), mm.

    Parameters
    ----------
    views
        Board views; those with the same ``view`` are of the same moment.
    board
        The board.
    rig
        The cameras, and their poses in mm or any other unit.
    """
    seen, images = _images_by_moment(views, board, rig)
    points = np.zeros((*seen.shape[1:], 3))
    for pattern in np.unique(seen.reshape(len(seen), -1), axis=1).T:
        if pattern.sum() < 2:
            continue
        at = (seen == pattern[:, None, None]).all(axis=0)
        who = np.flatnonzero(pattern)
        points[at] = triangulate_points(
            images[who][:, at],
            [rig.reference_from_camera[i] for i in who],
            weights=[float(rig.cameras[i].focal_px.mean()) for i in who],
        )
    both = (seen.sum(axis=0) > 1)[:, board.edges].all(axis=2)
    ends = points[:, board.edges]
    lengths: Floats = np.linalg.norm(ends[:, :, 0] - ends[:, :, 1], axis=2)[both]
    return lengths


def _images_by_moment(
    views: Sequence[BoardView], board: Board, rig: Rig
) -> tuple[NDArray[np.bool_], Floats]:
    """Return which corners each camera saw at each moment, (c, m, n), and their images, (…, 2)."""
    moments = {name: i for i, name in enumerate(dict.fromkeys(v.view for v in views))}
    seen = np.zeros((len(rig.cameras), len(moments), board.corner_count), dtype=np.bool_)
    images = np.zeros((*seen.shape, 2))
    for view in views:
        place = rig.index(view.camera), moments[view.view]
        seen[place][view.ids] = True
        images[place][view.ids] = view.pixels
    shared = seen & (seen.sum(axis=0) > 1)
    for camera, mine, points in zip(rig.cameras, shared, images, strict=True):
        points[mine] = camera.normalized_from_pixels(points[mine])
    return shared, images
