"""Radial lens distortion, eq. (18), and its inverse iterated to convergence."""

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats, checked
from pivometer.errors import DataError

_LARGEST_RADIUS = 1e3
"""A normalized radius no lens reaches: 89.94° off the axis."""


def distort(normalized: ArrayLike, beta: ArrayLike) -> Floats:
    """Return the distorted image q_d = (1 + β₁ r² + β₂ r⁴) q_n, shape (..., 2).

    Parameters
    ----------
    normalized
        Normalized image points q_n (f = 1), shape (..., 2).
    beta
        The radial coefficients β₁ and β₂, shape (2,).

    References
    ----------
    Wilson et al., eq. (18).

    Examples
    --------
    >>> distort([0.5, 0.0], [-0.2, 0.0])
    array([0.475, 0.   ])
    """
    points = checked(normalized, (-1, 2), "normalized")
    beta1, beta2 = checked(beta, (2,), "beta")
    r2 = np.sum(points**2, axis=-1, keepdims=True)
    distorted: Floats = points * (1 + r2 * (beta1 + r2 * beta2))
    return distorted


def distort_jacobian(normalized: ArrayLike, beta: ArrayLike) -> Floats:
    """Return ∂q_d/∂q_n of (18), shape (..., 2, 2), for points of shape (..., 2)."""
    points = checked(normalized, (-1, 2), "normalized")
    beta1, beta2 = checked(beta, (2,), "beta")
    r2 = np.sum(points**2, axis=-1)[..., None, None]
    factor = 1 + r2 * (beta1 + r2 * beta2)
    slope = 2 * (beta1 + 2 * beta2 * r2)
    jacobian: Floats = factor * np.eye(2) + slope * points[..., :, None] * points[..., None, :]
    return jacobian


def fold_radius(beta: ArrayLike) -> float:
    """Return the normalized radius at which (18) stops growing; infinite where it never does.

    Beyond it two points of the scene share one image point, so the model cannot be inverted.

    Examples
    --------
    >>> round(fold_radius([-1 / 3, 0.0]), 12)
    1.0
    >>> fold_radius([0.1, 0.0])
    inf
    """
    beta1, beta2 = checked(beta, (2,), "beta")
    # d(r + β₁r³ + β₂r⁵)/dr = 1 + 3β₁s + 5β₂s² = 0 with s = r², in the form that never cancels.
    discriminant = 9 * beta1**2 - 20 * beta2
    denominator = -3 * beta1 + np.sqrt(max(discriminant, 0.0))
    folds = discriminant >= 0 and denominator > 2 / _LARGEST_RADIUS**2
    return float(np.sqrt(2 / denominator)) if folds else float("inf")


def undistort(distorted: ArrayLike, beta: ArrayLike) -> Floats:
    """Invert (18) to rounding by Newton's method on the radius, shape (..., 2).

    Parameters
    ----------
    distorted
        Distorted normalized points q_d, shape (..., 2).
    beta
        The radial coefficients β₁ and β₂, shape (2,).

    Raises
    ------
    DataError
        If a point lies beyond the fold of the model, where no inverse exists.

    References
    ----------
    The inverse of Wilson et al., eq. (18).

    Examples
    --------
    >>> undistort(distort([0.4, -0.3], [-0.28, 0.1]), [-0.28, 0.1])
    array([ 0.4, -0.3])
    """
    points = checked(distorted, (-1, 2), "distorted")
    beta1, beta2 = checked(beta, (2,), "beta")
    target = np.linalg.norm(points, axis=-1)
    fold = min(fold_radius(beta), _LARGEST_RADIUS)
    reach = fold * (1 + fold**2 * (beta1 + fold**2 * beta2))
    if (target >= reach).any():
        raise DataError(
            f"{int((target >= reach).sum())} image points lie beyond normalized radius "
            f"{reach:.3f}, where the distortion model (β₁ = {beta1:.3f}, β₂ = {beta2:.3f}) folds",
            next_step="add board views that reach the corners of the image and calibrate again",
        )
    radius = np.minimum(target, 0.999 * fold)
    low, high = np.zeros_like(target), np.full_like(target, fold)
    for _ in range(100):
        r2 = radius**2
        miss = radius * (1 + r2 * (beta1 + r2 * beta2)) - target
        low, high = np.where(miss < 0, radius, low), np.where(miss > 0, radius, high)
        newton = radius - miss / (1 + r2 * (3 * beta1 + r2 * 5 * beta2))
        step = np.where((newton >= low) & (newton <= high), newton, (low + high) / 2)
        settled = np.abs(step - radius) <= 4e-16 * np.maximum(radius, 1e-3)
        radius = step
        if settled.all():
            break
    scale = np.divide(radius, target, out=np.ones_like(target), where=target > 0)
    undistorted: Floats = points * scale[..., None]
    return undistorted
