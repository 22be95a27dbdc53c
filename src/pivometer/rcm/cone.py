"""How wide the lines fan out: the smallest cone that holds their directions."""

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats, checked
from pivometer.geometry.line import unit
from pivometer.rcm.interior_point import highest, smallest_ball_centre


def cone_deg(directions: ArrayLike) -> float:
    """Return the apex angle of the smallest circular cone that holds all directions, deg.

    Signs are ignored: each direction counts with the sign that brings it nearer to the cone's
    axis, found from the principal axis and then from the cone's own axis until no sign changes.
    For cones of up to 90° the result is exact; for wider ones it is the cone of that choice of
    signs, at most 180°.

    Parameters
    ----------
    directions
        Directions of any length but zero, shape (n, 3).

    Examples
    --------
    >>> round(cone_deg([[1, 0, 0], [-1, -1, 0], [2, 1, 0]]), 9)
    45.0
    """
    return apex_deg(unit(checked(directions, (None, 3), "directions")))


def apex_deg(axes: Floats) -> float:
    """Return the apex angle, deg, as `cone_deg`, of unit directions of shape (n, 3)."""
    tips, axis = signed_axes(axes)
    widest = tips[highest(-np.abs(tips @ axis))]  # to rounding; their angles are found exactly
    return 2 * float(np.degrees(angles_to_axis(widest, axis).max()))


def signed_axes(axes: Floats) -> tuple[Floats, Floats]:
    """Return unit directions with their signs made equal, (n, 3), and the cone's axis, (3,)."""
    centre = np.linalg.eigh(axes.T @ axes)[1][:, 2]
    for _ in range(10):  # one round is enough up to 90°
        against = axes @ centre < 0
        tips = np.where(against[:, None], -axes, axes) if against.any() else axes
        # Points of the unit sphere: the centre of their smallest ball lies on their cone's axis.
        centre = unit(smallest_ball_centre(tips))
        if (tips @ centre >= 0).all():
            break
    return tips, centre


def angles_to_axis(axes: Floats, axis: Floats) -> Floats:
    """Return the angle of each unit vector, shape (n, 3), to the line along `axis`, rad."""
    along = axes @ axis
    across = axes - along[:, None] * axis
    angle: Floats = np.arctan2(np.sqrt(np.vecdot(across, across)), np.abs(along))
    return angle
