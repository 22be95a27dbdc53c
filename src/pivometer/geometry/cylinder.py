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
