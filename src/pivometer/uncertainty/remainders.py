"""What the edges of the poses say beyond their centerlines, and what may explain it.

A pose that c cameras saw gives 4c numbers, its axis takes four of them. Everything here is without
what each pose's own axis undoes, and in standard uncertainties of the edges.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats, checked
from pivometer.cameras.rig import Rig
from pivometer.errors import ShapeError
from pivometer.shaft.cylinder_fit import CylinderFits, fit_cylinders
from pivometer.shaft.silhouette import edge_normals
from pivometer.uncertainty.carried_edges import EdgePoints
from pivometer.uncertainty.propagation import square_root
from pivometer.uncertainty.shading import SHADING_PX, shifted_outward

POINTS_AN_EDGE = 5
"""Points by which an edge is carried through a changed lens: distortion bends a line to second and
third order."""


class FittedEdges(EdgePoints, Protocol):
    """What is needed of `ShaftEdges`: also the covariance of the normals."""

    @property
    def normals_covariance(self) -> Floats: ...  # noqa: D102 - documented by the class


@dataclass(frozen=True, slots=True, eq=False)
class Remainders:
    """Remainders of n poses and c cameras, and the changes that other causes would bring.

    Parameters
    ----------
    fits
        The cylinders, of one common radius.
    values
        The remainders, shape (n, 4c).
    freedom
        How many independent numbers each pose's remainder has, shape (n,).
    by_radius
        By the radius of all poses, shape (n, 4c), per mm.
    by_shading
        By one standard uncertainty of what shading does alike in all poses, shape (n, 4c, 2c + 1):
        for each camera both edges outward, then both to one side; then of what the cameras'
        responses do, in all of them at once.
    by_calibration
        By one standard uncertainty of each independent direction of the rig's covariance, shape
        (n, 4c, r).
    by_moves
        By a turn about the camera's centre (rad) and a shift (mm) of each camera in the reference
        frame, shape (n, 4c, c, 6).
    """

    fits: CylinderFits
    values: Floats
    freedom: Floats
    by_radius: Floats
    by_shading: Floats
    by_calibration: Floats
    by_moves: Floats


def remainders(
    edges: Sequence[Sequence[FittedEdges]],
    rig: Rig,
    rig_covariance: Floats | None,
    outward_px: Sequence[float],
) -> Remainders:
    """Fit cylinders of one radius to all poses, and say what their axes leave over.

    Parameters
    ----------
    edges
        For each pose, the edges that two cameras of the rig or more saw.
    rig
        The calibrated cameras.
    rig_covariance
        Covariance of the entries of `rig.parameter_names`, shape (d, d); `None` if unknown.
    outward_px
        By how much each camera's response moves both edges outward, or inward, px.

    Raises
    ------
    ShapeError, DegenerateGeometryError
        As `fit_cylinders`.
    """
    points, covariances, seen = _arranged(edges, rig)
    normals = np.tile([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]], (*seen.shape, 1, 1))
    for k, camera in enumerate(rig.cameras):
        normals[seen[:, k], k] = edge_normals(points[seen[:, k], k], camera)
    transforms = rig.reference_from_camera
    fits = fit_cylinders(normals, covariances, transforms, radius_mm="common", seen=seen)
    n, c = seen.shape
    moves = _by_moves(fits, normals, rig)
    causes = [
        fits.residuals[..., None],
        fits.slopes[..., 4:],
        _by_shading(fits, normals, rig, outward_px),
        _by_calibration(fits, points, moves, rig, rig_covariance),
        moves.reshape(n, c, 4, 6 * c),
    ]
    base = np.linalg.qr(fits.slopes[..., :4].reshape(n, 4 * c, 4))[0]
    rows = [cause.reshape(n, 4 * c, -1) for cause in causes]
    values, radius, shading, calibration, moved = (
        x - base @ (np.swapaxes(base, 1, 2) @ x) for x in rows
    )
    return Remainders(
        fits,
        values[..., 0],
        4.0 * seen.sum(axis=1) - 4,
        radius[..., 0],
        shading,
        calibration,
        moved.reshape(n, 4 * c, c, 6),
    )


def _arranged(
    edges: Sequence[Sequence[FittedEdges]], rig: Rig
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Return points of each edge, the normals' covariances, and which camera saw which pose."""
    n, c = len(edges), len(rig.cameras)
    points = np.zeros((n, c, 2, POINTS_AN_EDGE, 2))
    covariances = np.tile(np.eye(6), (n, c, 1, 1))
    seen = np.zeros((n, c), dtype=bool)
    names = [camera.name for camera in rig.cameras]
    for i, pose in enumerate(edges):
        for one in pose:
            if one.camera not in names:
                raise ShapeError(
                    f"pose {i} has edges of camera {one.camera}, which the rig does not have",
                    next_step="pass the rig of the session",
                )
            k = names.index(one.camera)
            along = checked(one.points_px, (2, None, 2), "points_px")
            chosen = np.linspace(0, along.shape[1] - 1, POINTS_AN_EDGE).round().astype(int)
            points[i, k], covariances[i, k] = along[:, chosen], one.normals_covariance
            seen[i, k] = True
    return points, covariances, seen


def _by_moves(fits: CylinderFits, normals: Floats, rig: Rig) -> Floats:
    """Return what turns and shifts of each camera do to the residuals, shape (n, c, 4, c, 6).

    A shift moves the axes the other way; a turn by δ turns a normal by −Rᵀδ in the camera's frame.
    """
    n, c = fits.residuals.shape[:2]
    moves = np.zeros((n, c, 4, c, 6))
    for k, transform in enumerate(rig.reference_from_camera):
        turned = np.cross(normals[:, k, :, None, :], transform.rotation)  # (n, 2, 3 turns, 3)
        whitening = fits.whitening[:, k].reshape(n, 4, 2, 3)
        moves[:, k, :, k, :3] = np.einsum("nakj,nktj->nat", whitening, turned)
        moves[:, k, :, k, 3:] = -fits.slopes[:, k, :, :2] @ fits.bases
    return moves


def _by_shading(
    fits: CylinderFits, normals: Floats, rig: Rig, outward_px: Sequence[float]
) -> Floats:
    """Return what shifts of both edges do to the residuals, shape (n, c, 4, 2c + 1)."""
    n, c = fits.residuals.shape[:2]
    columns = np.zeros((n, c, 4, 2 * c + 1))
    for k, camera in enumerate(rig.cameras):
        shift = shifted_outward(normals[:, k], camera)
        for place, sides in enumerate(([1.0, 1.0], [1.0, -1.0])):
            moved = -(shift * np.array(sides)[:, None]).reshape(n, 6, 1)
            columns[:, k, :, 2 * k + place] = (fits.whitening[:, k] @ moved)[..., 0]
        columns[:, k, :, -1] = outward_px[k] / SHADING_PX * columns[:, k, :, 2 * k]
    return columns


def _by_calibration(
    fits: CylinderFits, points: Floats, moves: Floats, rig: Rig, covariance: Floats | None
) -> Floats:
    """Return what the rig's independent uncertainties do to the residuals, shape (n, c, 4, r)."""
    n, c = fits.residuals.shape[:2]
    if covariance is None:
        return np.zeros((n, c, 4, 0))
    size, at = len(rig.parameter_names), 0
    by_parameters = np.zeros((n, c, 4, size))
    sigma = np.sqrt(np.maximum(covariance.diagonal(), 0.0))
    for k, camera in enumerate(rig.cameras):
        seen = fits.whitening[:, k].any(axis=(1, 2))
        for index in range(len(camera.parameters)):
            step = np.zeros(len(camera.parameters))
            step[index] = sigma[at]
            if sigma[at] > 0:
                there, back = (
                    edge_normals(points[seen, k], camera.with_parameters(camera.parameters + s))
                    for s in (step, -step)
                )
                change = ((back - there) / (2 * sigma[at])).reshape(-1, 6, 1)
                by_parameters[seen, k, :, at] = (fits.whitening[seen, k] @ change)[..., 0]
            at += 1
    by_parameters[..., at:] = moves[..., 1:, :].reshape(n, c, 4, 6 * (c - 1))
    return np.asarray(by_parameters @ square_root(covariance))
