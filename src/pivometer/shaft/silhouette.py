"""From the two edge lines of a shaft to the plane of its centerline, eqs. (5)–(12) and (22)."""

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats, checked
from pivometer.cameras.model import Camera
from pivometer.errors import DegenerateGeometryError
from pivometer.geometry.line import cross, unit

SMALLEST_APEX_RAD = 1e-9
"""Edge planes closer than this are one plane to rounding: (8) has no direction left."""


def coimage_normal(a: ArrayLike, b: ArrayLike, f: float = 1.0) -> Floats:
    """Return the coimage normal n = [a; 0] × [b; f] of the image line l = a τ + b, (5) and (6).

    Parameters
    ----------
    a, b
        Direction and a point of the line in the image plane, shape (..., 2), in the unit of `f`.
    f
        Focal length in the unit of `b`; 1 for normalized coordinates.

    Returns
    -------
    numpy.ndarray
        Unit normal of the plane through the camera's centre and the line, shape (..., 3), camera
        frame. Its sign follows the direction of `a`.

    Raises
    ------
    ShapeError
        If a direction has no length.

    References
    ----------
    Wilson et al., eqs. (5) and (6).

    Examples
    --------
    >>> coimage_normal([0.0, 1.0], [0.5, 7.0]).round(6) + 0.0
    array([ 0.894427,  0.      , -0.447214])
    """
    directions, points = checked(a, (-1, 2), "a"), checked(b, (-1, 2), "b")
    directions, points = np.broadcast_arrays(directions, points)
    end = np.zeros_like(directions[..., :1])
    first = np.concatenate([directions, end], axis=-1)
    second = np.concatenate([points, end + f], axis=-1)
    return unit(cross(first, second), "a")


def normalized_line(
    a_px: ArrayLike, b_px: ArrayLike, calibration_matrix: ArrayLike
) -> tuple[Floats, Floats]:
    """Return (a, b) of a line in normalized coordinates from its (a′, b′) in pixels, l = K⁻¹ l′.

    Parameters
    ----------
    a_px, b_px
        Direction and a point of the line, shape (..., 2), undistorted px.
    calibration_matrix
        K of (17), shape (3, 3), px.

    Returns
    -------
    tuple of numpy.ndarray
        Direction a and point b, shape (..., 2) each, for a focal length of 1.

    References
    ----------
    Wilson et al., eq. (22): as a direction a′ has no homogeneous part, so K's offset leaves it.

    Examples
    --------
    >>> K = [[1000, 0, 320], [0, 500, 240], [0, 0, 1]]
    >>> normalized_line([10, 5], [420, 240], K)
    (array([0.01, 0.01]), array([0.1, 0. ]))
    """
    K = checked(calibration_matrix, (3, 3), "calibration_matrix")
    directions, points = checked(a_px, (-1, 2), "a_px"), checked(b_px, (-1, 2), "b_px")
    inverse = np.linalg.inv(K[:2, :2])
    return directions @ inverse.T, (points - K[:2, 2]) @ inverse.T


def outward_normals(normals: ArrayLike, inside: ArrayLike) -> Floats:
    """Return the two edges' normals with the signs that point away from the shaft.

    Parameters
    ----------
    normals
        Coimage normals of the two edges, shape (..., 2, 3), any length and sign, camera frame.
    inside
        Any ray between the two edges, shape (..., 3), camera frame.

    Returns
    -------
    numpy.ndarray
        Unit normals, shape (..., 2, 3), with n · inside < 0: the ñ_l and ñ_r of (10) and (11).

    References
    ----------
    Wilson et al., the text above eq. (10).

    Examples
    --------
    >>> outward_normals([[1, 0, 0.1], [1, 0, -0.1]], [0, 0, 1]).round(3)
    array([[-0.995, -0.   , -0.1  ],
           [ 0.995,  0.   , -0.1  ]])
    """
    planes = unit(checked(normals, (-1, 2, 3), "normals"), "normals")
    ray = checked(inside, (-1, 3), "inside")
    side = np.sum(planes * ray[..., None, :], axis=-1, keepdims=True)
    return planes * np.where(side > 0, -1.0, 1.0)


def centerline_normal_average(normals: ArrayLike) -> Floats:
    """Return the centerline plane's normal as the average n_l ± n_r of normals of equal norm.

    The paper's sign depends on the directions of the two normals; for normals that point away
    from the shaft it is the minus sign, at any width.

    Parameters
    ----------
    normals
        Coimage normals of the two edges pointing away from the shaft, shape (..., 2, 3).

    Returns
    -------
    numpy.ndarray
        Unit normal of the plane through the camera's centre and the centerline, shape (..., 3).

    Raises
    ------
    DegenerateGeometryError
        If the two edges are one line.

    References
    ----------
    Wilson et al., Figs. 2 and 3 and the text between (6) and (7).

    Examples
    --------
    >>> from pivometer.geometry import tangent_plane_normals
    >>> centerline_normal_average(tangent_plane_normals([0, 0, 2], [0, -1, 0], 1.0)).round(9) + 0.0
    array([-1.,  0.,  0.])
    """
    planes = _distinct(normals)
    return unit(planes[..., 0, :] - planes[..., 1, :])


def centerline_normal_algebraic(normals: ArrayLike) -> Floats:
    """Return the centerline plane's normal by solving (10)–(12) for b and computing (7).

    The radius only scales b, so it is taken as 1.

    Parameters
    ----------
    normals
        Coimage normals of the two edges pointing away from the shaft, shape (..., 2, 3).

    Returns
    -------
    numpy.ndarray
        Unit normal, shape (..., 3), equal to that of `centerline_normal_average`.

    Raises
    ------
    DegenerateGeometryError
        If the two edges are one line.

    References
    ----------
    Wilson et al., eqs. (7), (8) and (10)–(12).

    Examples
    --------
    >>> from pivometer.geometry import tangent_plane_normals
    >>> normals = tangent_plane_normals([0, 0, 2], [0, -1, 0], 1.0)
    >>> centerline_normal_algebraic(normals).round(9) + 0.0
    array([-1.,  0.,  0.])
    """
    planes = _distinct(normals)
    a = unit(cross(planes[..., 0, :], planes[..., 1, :]))  # (8)
    matrix = np.concatenate([planes, a[..., None, :]], axis=-2)  # rows of (10), (11), (12)
    right = np.broadcast_to([[-1.0], [-1.0], [0.0]], (*a.shape, 1))
    b = np.linalg.solve(matrix, right)[..., 0]
    return unit(cross(a, b))  # (7)


def _distinct(normals: ArrayLike) -> Floats:
    """Return the normals as unit vectors, refusing pairs that are one plane."""
    planes = unit(checked(normals, (-1, 2, 3), "normals"), "normals")
    sine = np.linalg.norm(cross(planes[..., 0, :], planes[..., 1, :]), axis=-1)
    if (sine < SMALLEST_APEX_RAD).any():
        raise DegenerateGeometryError(
            f"the two edges of the shaft are one line to {float(np.min(sine)):.1e} rad",
            next_step="check that two different edges were found, or move the camera closer",
        )
    return planes


def edge_normals(points_px: ArrayLike, camera: Camera) -> Floats:
    """Return the coimage normals of two edges from raw points on them, (22) and (6).

    Points of `ShaftEdges` give its normals back, and with another camera those that the same
    image would have given: so the calibration's uncertainty is carried through.

    Parameters
    ----------
    points_px
        Points on both edges, shape (..., 2, m, 2), raw px, in the same order along the shaft.
    camera
        The camera, which undoes the distortion.

    Returns
    -------
    numpy.ndarray
        Unit normals, shape (..., 2, 3), pointing away from the shaft, camera frame.

    Raises
    ------
    ShapeError
        If the shape differs, or all points of an edge are one.

    References
    ----------
    Wilson et al., eqs. (18), (22) and (6).

    Examples
    --------
    >>> camera = Camera("left", 640, 480, [1000, 1000], [320, 240], [0, 0])
    >>> edge_normals([[[310, 0], [310, 400]], [[330, 0], [330, 400]]], camera).round(3) + 0.0
    array([[-1.  ,  0.  , -0.01],
           [ 1.  ,  0.  , -0.01]])
    """
    points = camera.undistorted_pixels(checked(points_px, (-1, 2, None, 2), "points_px"))
    middle = points.mean(axis=-2)
    apart = points - middle[..., None, :]
    scatter = np.swapaxes(apart, -1, -2) @ apart
    direction = np.linalg.eigh(scatter)[1][..., 1]
    a, b = normalized_line(direction, middle, camera.calibration_matrix)
    inside = np.concatenate([b.mean(axis=-2), np.ones_like(b[..., 0, :1])], axis=-1)
    return outward_normals(coimage_normal(a, b), inside)
