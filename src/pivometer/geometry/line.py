"""Lines in space, as a point and a unit direction each (the paper's a τ + b)."""

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats, checked
from pivometer.errors import ShapeError


def unit(vectors: ArrayLike, name: str = "directions") -> Floats:
    """Return `vectors`, shape (..., 3), scaled to unit length.

    Raises
    ------
    ShapeError
        If a vector has no length.

    Examples
    --------
    >>> unit([0.0, 3.0, 4.0])
    array([0. , 0.6, 0.8])
    """
    array = checked(vectors, (-1, 3), name)
    with np.errstate(over="ignore", under="ignore"):
        squares = np.vecdot(array, array)
    if squares.size and not 1e-200 < squares.min() <= squares.max() < 1e200:
        array = array / _largest(array, name)  # or their squares are none
        squares = np.vecdot(array, array)
    normalized: Floats = array / np.sqrt(squares)[..., None]
    return normalized


def cross(one: Floats, other: Floats) -> Floats:
    """Return one × other, shape (..., 3): as `np.cross`, in a fifth of its time for few vectors.

    Examples
    --------
    >>> cross(np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
    array([0., 0., 1.])
    """
    after, before = [1, 2, 0], [2, 0, 1]
    product: Floats = one[..., after] * other[..., before] - one[..., before] * other[..., after]
    return product


def across(vectors: Floats, axes: Floats) -> Floats:
    """Return the parts of vectors across unit vectors, both of shape (n, 3).

    Examples
    --------
    >>> across(np.array([[3.0, 0.0, 4.0]]), np.array([[0.0, 0.0, 1.0]]))
    array([[3., 0., 0.]])
    """
    along: Floats = np.vecdot(vectors, axes)[:, None] * axes
    return np.subtract(vectors, along, out=along)  # a new array costs more than its numbers


def projectors(axes: Floats) -> Floats:
    """Return the projectors I − aaᵀ across unit vectors a (..., 3), shape (..., 3, 3).

    Examples
    --------
    >>> projectors(np.array([0.0, 0.0, 1.0])) @ [3.0, 0.0, 4.0]
    array([3., 0., 0.])
    """
    across_axes: Floats = np.eye(3) - axes[..., :, None] * axes[..., None, :]
    return across_axes


def _largest(vectors: Floats, name: str) -> Floats:
    """Return the largest component of each vector, shape (..., 1)."""
    largest: Floats = np.abs(vectors).max(axis=-1, keepdims=True)
    if not largest.all():
        raise ShapeError(f"{name} holds a vector of zero length", next_step="remove it")
    return largest


def nearest_points_on_lines(
    point_mm: ArrayLike, points_mm: ArrayLike, directions: ArrayLike
) -> Floats:
    """Return the point of each line nearest to `point_mm`, shape (n, 3), mm.

    Parameters
    ----------
    point_mm
        The point, shape (3,), mm.
    points_mm, directions
        A point on each line (mm) and its direction, shape (n, 3), same frame; the directions
        need not be of unit length.
    """
    point = checked(point_mm, (3,), "point_mm")
    origins = checked(points_mm, (None, 3), "points_mm")
    axes = unit(directions)
    tau = np.einsum("ij,ij->i", point - origins, axes)
    nearest: Floats = origins + tau[:, None] * axes
    return nearest


def distances_to_lines(point_mm: ArrayLike, points_mm: ArrayLike, directions: ArrayLike) -> Floats:
    """Return the distance of a point from each line, shape (n,), mm: the paper's ‖dᵢᶜ‖ in (1).

    Parameters
    ----------
    point_mm
        The point, shape (3,), mm.
    points_mm, directions
        A point on each line (mm) and its direction, shape (n, 3), same frame.

    Examples
    --------
    >>> distances_to_lines([0, 0, 1], [[0, 2, 0]], [[1, 0, 0]])
    array([2.23606798])
    """
    nearest = nearest_points_on_lines(point_mm, points_mm, directions)
    distance: Floats = np.linalg.norm(nearest - checked(point_mm, (3,), "point_mm"), axis=1)
    return distance
