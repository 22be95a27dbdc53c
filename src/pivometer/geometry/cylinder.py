"""The straight circular cylinder: its tangent planes through a viewpoint."""

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats, checked
from pivometer.errors import DegenerateGeometryError
from pivometer.geometry.line import unit


def tangent_plane_normals(
    axis_point_mm: ArrayLike, axis_direction: ArrayLike, radius_mm: float
) -> Floats:
    """Return the unit normals of the two planes through the origin that touch a cylinder.

    The normals point away from the cylinder, as the paper asks of ñ_l and ñ_r in (10)–(11):
    ñᵀ b + r = 0 for every point b of the axis. This is the forward model of a shaft's two edges.

    Parameters
    ----------
    axis_point_mm, axis_direction
        A point of the axis (mm) and its direction, shape (3,), in the frame of the viewpoint.
    radius_mm
        The radius, mm.

    Returns
    -------
    numpy.ndarray
        Shape (2, 3). Seen from the origin with the direction pointing up, the first touches the
        left side of the cylinder, the second the right one.

    Raises
    ------
    DegenerateGeometryError
        If the origin is inside the cylinder.

    References
    ----------
    Wilson et al., eqs. (10)–(12) and Fig. 3.

    Examples
    --------
    >>> tangent_plane_normals([0, 0, 2], [0, -1, 0], 1.0).round(9) + 0.0
    array([[-0.8660254,  0.       , -0.5      ],
           [ 0.8660254,  0.       , -0.5      ]])
    """
    axis = unit(axis_direction, "axis_direction")
    point = checked(axis_point_mm, (3,), "axis_point_mm")
    foot = point - (point @ axis) * axis
    distance = float(np.linalg.norm(foot))
    if distance <= radius_mm:
        raise DegenerateGeometryError(
            f"the viewpoint is {distance:.3f} mm from the axis of a cylinder of radius "
            f"{radius_mm:.3f} mm, inside it",
            next_step="check the pose and the shaft's diameter",
        )
    towards = foot / distance
    right = np.cross(towards, axis)
    sine = radius_mm / distance
    cosine = np.sqrt((1 - sine) * (1 + sine))
    return np.stack([-cosine * right - sine * towards, cosine * right - sine * towards])


def tangent_planes(
    axis_points_mm: ArrayLike,
    axis_directions: ArrayLike,
    radii_mm: ArrayLike,
    viewpoints_mm: ArrayLike,
    bases: ArrayLike,
) -> tuple[Floats, Floats]:
    """Return the normals of `tangent_plane_normals` for many cylinders and viewpoints, and slopes.

    Parameters
    ----------
    axis_points_mm, axis_directions
        A point of each axis (mm) and its unit direction, shape (n, 3).
    radii_mm
        The radii, shape (n,), mm.
    viewpoints_mm
        Where all of them are seen from, shape (c, 3), mm, in the frame of the axes. One inside a
        cylinder, where nothing is seen, counts as one that touches it.
    bases
        Two unit vectors perpendicular to each direction and to each other, shape (n, 2, 3).

    Returns
    -------
    tuple of numpy.ndarray
        Normals, shape (n, c, 2, 3), in the same frame; and their derivatives, shape
        (n, c, 2, 3, 5), by the offsets of the axis point along `bases` (mm), by the slopes of the
        direction along them (rad), and by the radius (mm).

    References
    ----------
    Wilson et al., eqs. (10)–(12) and Fig. 3.
    """
    axis = np.asarray(axis_directions)[:, None, :]
    start = np.asarray(axis_points_mm)[:, None, :] - np.asarray(viewpoints_mm)
    along = np.vecdot(start, axis)[..., None]
    foot = start - along * axis
    distance = np.sqrt(np.vecdot(foot, foot))[..., None]
    towards = foot / distance
    right = np.cross(towards, axis)
    sine = np.minimum(np.asarray(radii_mm)[:, None, None] / distance, 1 - 1e-9)
    cosine = np.sqrt((1 - sine) * (1 + sine))
    # All derivatives by the five parameters have the shape (n, c, 5, 3), or (n, c, 5, 1).
    across = np.asarray(bases)[:, None]
    turn = np.concatenate([np.zeros_like(across), across, np.zeros_like(axis[:, None])], axis=2)
    leans = -np.vecdot(start[:, :, None], across)[..., None] * axis[:, :, None]
    leans = leans - along[..., None] * across
    shifts = np.broadcast_to(across, leans.shape)
    d_foot = np.concatenate([shifts, leans, np.zeros_like(leans[:, :, :1])], axis=2)
    d_distance = np.vecdot(d_foot, towards[:, :, None])[..., None]
    d_towards = (d_foot - d_distance * towards[:, :, None]) / distance[..., None]
    d_right = np.cross(d_towards, axis[:, :, None]) + np.cross(towards[:, :, None], turn)
    d_sine = -sine[..., None] / distance[..., None] * d_distance
    d_sine[..., 4, 0] = 1 / distance[..., 0]
    d_cosine = -(sine / cosine)[..., None] * d_sine
    inward = sine * towards
    d_inward = d_sine * towards[:, :, None] + sine[..., None] * d_towards
    d_side = d_cosine * right[:, :, None] + cosine[..., None] * d_right
    normals = np.stack([-cosine * right - inward, cosine * right - inward], axis=2)
    slopes = np.stack([-d_side - d_inward, d_side - d_inward], axis=2)
    return normals, np.swapaxes(slopes, -1, -2)
