"""What one-sided light does to the edges, alike in all poses of a session."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats, checked
from pivometer.cameras.model import Camera
from pivometer.cameras.rig import Rig
from pivometer.shaft.triangulation import lines_from_edge_normals
from pivometer.uncertainty.carried_edges import (
    EdgePoints,
    SeenAlike,
    feet_of,
    normals_of,
    thinned_points,
    transforms_of,
)

SHADING_PX = 0.02
"""What shading shifts the edges of one camera by alike, all through a session, as a standard
uncertainty: on two rendered sets whole edges were up to 0.01 and 0.02 px off (`shaft.edges`)."""


def shifted_outward(normals: Floats, camera: Camera) -> Floats:
    """Return by how much normals change when shading shifts their edges outward.

    Parameters
    ----------
    normals
        Coimage normals, shape (..., 3), pointing away from the shaft, camera frame.
    camera
        Their camera.

    Returns
    -------
    numpy.ndarray
        Shape (..., 3), for `SHADING_PX`.
    """
    across = normals[..., 2:] * normals - np.array([0.0, 0.0, 1.0])
    across = across * np.hypot(normals[..., :1], normals[..., 1:2])
    return np.asarray(across * SHADING_PX / float(np.mean(camera.focal_px)))


def shading_displacements(
    edges: Sequence[Sequence[EdgePoints]], rig: Rig, point_mm: ArrayLike
) -> Floats:
    """Return how far one-sided light moves each line near a point.

    Light from one side shifts both edges of a shaft to that side, in all poses alike, so more poses
    do not lessen it. A shift of both edges outward leaves the centerline where it is.

    Parameters
    ----------
    edges
        For each pose, the edges that two cameras of the rig or more saw, in the rig's order.
    rig
        The calibrated cameras.
    point_mm
        Where the lines pass, shape (3,), mm: the RCM.

    Returns
    -------
    numpy.ndarray
        Shape (n, 3, c), mm: displacement of the foot of the perpendicular from the point on each
        line, for one standard uncertainty of the shift in each of the c cameras.
    """
    groups = thinned_points(edges, [camera.name for camera in rig.cameras])
    return displacements_of(groups, rig, checked(point_mm, (3,), "point_mm"))


def displacements_of(groups: Sequence[SeenAlike], rig: Rig, point_mm: Floats) -> Floats:
    """Return `shading_displacements` of edges that are thinned already."""
    count = sum(len(group.poses) for group in groups)
    moved = np.zeros((count, 3, len(rig.cameras)))
    for group in groups:
        normals, transforms = normals_of(group, rig), transforms_of(group, rig)
        for place, index in enumerate(group.cameras):
            shift = np.zeros_like(normals)
            shift[:, place] = one_sided(normals[:, place], rig.cameras[index])
            ahead, back = (
                feet_of(*lines_from_edge_normals(n, transforms)[:2], point_mm)
                for n in (normals + shift, normals - shift)
            )
            moved[group.poses, :, index] = (ahead - back) / 2
    return moved


def one_sided(normals: Floats, camera: Camera) -> Floats:
    """Return by how much both edges' normals, (n, 2, 3), change when light comes from one side.

    The side is the same in all poses: that to which most shafts turn their flanks.
    """
    flanks = normals[:, 0, :2]
    side = np.linalg.eigh(flanks.T @ flanks)[1][:, -1]
    turned = np.where(flanks @ side < 0, -1.0, 1.0)
    sides = turned[:, None, None] * np.array([[1.0], [-1.0]])
    return np.asarray(shifted_outward(normals, camera) * sides)
