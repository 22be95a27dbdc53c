"""How good a calibration is: held-out edges, epipolar error, coverage, remarks in plain words."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pivometer._arrays import Floats
from pivometer.calibration.board import Board, BoardView
from pivometer.calibration.metric_scale import length_error, reconstructed_edges
from pivometer.calibration.result import CameraQuality, LengthError
from pivometer.calibration.two_view import corrected_points
from pivometer.cameras import Camera, Rig
from pivometer.errors import CalibrationError, DataError
from pivometer.geometry.rigid import RigidTransform, cross_matrix

GRID = (8, 6)
"""Cells across and down in which coverage of the image is counted."""


def shared_moments(views: Sequence[BoardView]) -> tuple[str, ...]:
    """Return the moments seen by at least two cameras, in the order of `views`."""
    counts: dict[str, int] = {}
    for view in views:
        counts[view.view] = counts.get(view.view, 0) + 1
    return tuple(moment for moment, count in counts.items() if count > 1)


def undetermined(error: DataError) -> CalibrationError:
    """Return the error of a distortion fitted so freely that it folds among the corners."""
    return CalibrationError(
        f"{error.what}; the board views do not determine as many coefficients",
        next_step="choose a distortion model of fewer coefficients, or add board views that fill "
        "the image",
    )


@dataclass(frozen=True, slots=True, eq=False)
class HeldOut:
    """Lengths of board edges in pairs that the rig was not estimated from.

    Parameters
    ----------
    lengths_mm
        For each fold the lengths of the edges left out, shape (m,), mm.
    """

    lengths_mm: tuple[Floats, ...]

    def error(self, edge_mm: float) -> LengthError:
        """Return the error of all of them."""
        return length_error(np.concatenate(self.lengths_mm), edge_mm)

    def mean_squares_mm2(self, edge_mm: float) -> Floats:
        """Return the mean square error of each fold, shape (folds,), mm²."""
        return np.array([float(np.mean((fold - edge_mm) ** 2)) for fold in self.lengths_mm])


def held_out_lengths(
    views: Sequence[BoardView],
    board: Board,
    estimate: Callable[[Sequence[str]], Rig],
    *,
    folds: int = 10,
) -> HeldOut:
    """Reconstruct board edges in pairs that the rig was not estimated from.

    Parameters
    ----------
    views
        All views used, their corners numbered alike.
    board
        The board.
    estimate
        Returns the rig estimated from the named moments only.
    folds
        Number of parts into which the shared moments are divided, each left out once.
    """
    moments = list(dict.fromkeys(view.view for view in views))
    shared = shared_moments(views)
    count = min(folds, len(shared))
    lengths = []
    for fold in range(count):
        out = set(shared[fold::count])
        rig = estimate([moment for moment in moments if moment not in out])
        lengths.append(_edges_of([v for v in views if v.view in out], board, rig))
    return HeldOut(tuple(lengths))


def _edges_of(views: Sequence[BoardView], board: Board, rig: Rig) -> Floats:
    try:
        return reconstructed_edges(views, board, rig)
    except CalibrationError:
        raise
    except DataError as error:
        raise undetermined(error) from error


def epipolar_rms(views: Sequence[BoardView], rig: Rig) -> float:
    """Return the rms correction √(‖w₁‖² + ‖w₂‖²) of (19) with the rig as it is, px.

    Every pair of cameras that saw a corner at the same moment counts once.
    """
    total, count = 0.0, 0
    for i, first in enumerate(rig.cameras):
        for j, second in enumerate(rig.cameras[i + 1 :], start=i + 1):
            a, b = matched_points(views, first, second)
            if not len(a):
                continue
            pose = rig.reference_from_camera[i].inverse() @ rig.reference_from_camera[j]
            weights = (float(first.focal_px.mean()), float(second.focal_px.mean()))
            E = cross_matrix(pose.translation_mm) @ pose.rotation
            x1, x2 = corrected_points(E, a, b, weights=weights)
            total += float(np.sum((weights[0] * (a - x1)) ** 2))
            total += float(np.sum((weights[1] * (b - x2)) ** 2))
            count += len(a)
    return float(np.sqrt(total / count))


def matched_points(
    views: Sequence[BoardView], first: Camera, second: Camera
) -> tuple[Floats, Floats]:
    """Return the normalised images of all corners that two cameras saw at the same moment.

    Returns
    -------
    Undistorted normalised points of the first and of the second camera, shape (n, 2) each.
    """
    by_moment = {v.view: v for v in views if v.camera == second.name}
    a, b = [np.zeros((0, 2))], [np.zeros((0, 2))]
    for view in views:
        other = by_moment.get(view.view)
        if view.camera != first.name or other is None:
            continue
        _, mine, theirs = np.intersect1d(view.ids, other.ids, return_indices=True)
        a.append(view.pixels[mine])
        b.append(other.pixels[theirs])
    return (
        first.normalized_from_pixels(np.concatenate(a)),
        second.normalized_from_pixels(np.concatenate(b)),
    )


def camera_quality(
    camera: Camera,
    views: Sequence[BoardView],
    camera_from_board: Sequence[RigidTransform],
    residuals_px: Sequence[Floats],
    covariance: Floats,
) -> CameraQuality:
    """Summarise one camera.

    Parameters
    ----------
    camera
        The camera.
    views, camera_from_board, residuals_px
        Its views with the board pose and the residuals (k, 2) of each.
    covariance
        Covariance of ``camera.parameters``, shape (4+m, 4+m).
    """
    each = [float(np.sqrt(np.mean(np.sum(r**2, axis=1)))) for r in residuals_px]
    everything = np.concatenate(list(residuals_px))
    worst = int(np.argmax(each))
    return CameraQuality(
        name=camera.name,
        rms_px=float(np.sqrt(np.mean(np.sum(everything**2, axis=1)))),
        view_count=len(views),
        corner_count=len(everything),
        parameters_u=np.sqrt(np.diag(covariance)),
        filled=filled_fraction(np.concatenate([v.pixels for v in views]), camera),
        tilt_deg=tilt_range_deg(camera_from_board),
        worst_view=views[worst].view,
        worst_rms_px=each[worst],
    )


def filled_fraction(pixels: Floats, camera: Camera) -> float:
    """Return the fraction of the cells of an 8×6 grid over the image that hold a corner.

    Examples
    --------
    >>> camera = Camera("left", 640, 480, [1000, 1000], [320, 240], [0, 0])
    >>> filled_fraction(np.array([[10.0, 10.0], [12.0, 9.0], [630.0, 470.0]]), camera) * 48
    2.0
    """
    cells = np.floor((pixels + 0.5) / [camera.width, camera.height] * GRID).astype(np.int64)
    cells = np.clip(cells, 0, np.array(GRID) - 1)
    return len(np.unique(cells, axis=0)) / (GRID[0] * GRID[1])


def tilt_range_deg(camera_from_board: Sequence[RigidTransform]) -> float:
    """Return the largest angle between the board's normals in two views, deg."""
    normals = np.array([pose.rotation[:, 2] for pose in camera_from_board])
    return float(np.degrees(np.arccos(np.clip(normals @ normals.T, -1, 1).min())))


def quality_notes(
    cameras: Sequence[CameraQuality], rig: Rig, pairs: Mapping[tuple[str, str], int]
) -> tuple[str, ...]:
    """Return warnings in plain words about what weakens a calibration.

    Parameters
    ----------
    cameras
        Quality of each camera.
    rig
        The rig.
    pairs
        Number of shared moments of each two cameras that the rig rests on.
    """
    notes = []
    for quality, camera in zip(cameras, rig.cameras, strict=True):
        notes += _camera_notes(quality, camera)
    for (first, second), count in pairs.items():
        if count < 10:
            notes.append(
                f"cameras {first} and {second} share only {count} board images; 20 halve the "
                "uncertainty of their relative pose"
            )
    return tuple(notes)


def _camera_notes(quality: CameraQuality, camera: Camera) -> list[str]:
    notes = []
    if quality.view_count < 10:
        notes.append(f"camera {quality.name}: only {quality.view_count} board images; take 30")
    if quality.tilt_deg < 30:
        notes.append(
            f"camera {quality.name}: the board's tilt varies by only {quality.tilt_deg:.0f}°; "
            "tilt it by up to 45° in all directions"
        )
    if quality.filled < 0.5:
        notes.append(
            f"camera {quality.name}: corners cover {100 * quality.filled:.0f} % of the image; show "
            "the board in its corners too"
        )
    u_centre = float(quality.parameters_u[2:4].max())
    if u_centre > 0.004 * camera.width:
        notes.append(
            f"camera {quality.name}: the principal point is uncertain by {u_centre:.1f} px "
            "(1 standard uncertainty), which shifts every location; add board images"
        )
    return notes
