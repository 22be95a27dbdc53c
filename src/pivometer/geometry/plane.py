"""Planes through a camera's centre, as unit normals."""

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats
from pivometer.geometry.line import cross, unit


def angle_between_planes(first_normal: ArrayLike, second_normal: ArrayLike) -> Floats:
    """Return the dihedral angle φ of planes given by normals of shape (..., 3), rad, in [0, π/2].

    For the two centerline planes of a pose, eq. (14) divides by sin φ: the line is lost when φ
    vanishes, which happens for every centerline coplanar with the baseline.

    Examples
    --------
    >>> round(float(np.degrees(angle_between_planes([1, 0, 0], [-1, 1, 0]))), 9)
    45.0
    """
    a, b = unit(first_normal, "first_normal"), unit(second_normal, "second_normal")
    sine = np.linalg.norm(cross(a, b), axis=-1)
    cosine = np.abs(np.sum(a * b, axis=-1))
    return np.asarray(np.arctan2(sine, cosine))
