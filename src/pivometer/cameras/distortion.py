"""Lens distortion, eq. (18) and its common extensions, and the inverse iterated to convergence.

One function serves every model: coefficients are in OpenCV's order k₁ k₂ p₁ p₂ k₃ k₄ k₅ k₆, and a
model is how many of them it has, counted from the first. The paper's β₁ and β₂ are k₁ and k₂.
"""

from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats, checked
from pivometer.errors import DataError, ShapeError

DistortionModel = Literal["none", "radial2", "brown5", "rational8"]
COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
MODELS: dict[str, int] = {"none": 0, "radial2": 2, "brown5": 5, "rational8": 8}
"""How many of `COEFFICIENTS` each model has; the paper's is ``radial2``."""

_LARGEST_RADIUS = 1e3
"""A normalized radius no lens reaches: 89.94° off the axis."""


def model_of(coefficients: ArrayLike) -> str:
    """Return the name of the model that has this many coefficients.

    Raises
    ------
    ShapeError
        If no model has.

    Examples
    --------
    >>> model_of([-0.2, 0.1])
    'radial2'
    """
    count = checked(coefficients, (None,), "distortion").size
    names = {length: name for name, length in MODELS.items()}
    if count not in names:
        raise ShapeError(
            f"{count} distortion coefficients; models have "
            + ", ".join(f"{length} ({name})" for name, length in MODELS.items()),
            next_step="pass the coefficients in OpenCV's order k1 k2 p1 p2 k3 k4 k5 k6",
        )
    return names[count]


def full_length(coefficients: ArrayLike) -> Floats:
    """Return coefficients of shape (..., m) as all eight, those a model lacks being zero."""
    given = np.asarray(coefficients, dtype=np.float64)
    missing = len(COEFFICIENTS) - given.shape[-1]
    return np.concatenate([given, np.zeros((*given.shape[:-1], missing))], axis=-1)


def distort(normalized: ArrayLike, coefficients: ArrayLike) -> Floats:
    """Return the distorted image q_d of normalized points q_n, shape (..., 2).

    With s = r², q_d = q_n (1 + k₁s + k₂s² + k₃s³) / (1 + k₄s + k₅s² + k₆s³) plus the tangential
    part (2p₁xy + p₂(s + 2x²), p₁(s + 2y²) + 2p₂xy); the first two coefficients alone are (18).

    Parameters
    ----------
    normalized
        Normalized image points q_n (f = 1), shape (..., 2).
    coefficients
        The first m of k₁ k₂ p₁ p₂ k₃ k₄ k₅ k₆, shape (..., m), broadcast against the points.

    References
    ----------
    Wilson et al., eq. (18), β₁ = k₁ and β₂ = k₂; Brown (1966), "Decentering distortion of lenses".

    Examples
    --------
    >>> distort([0.5, 0.0], [-0.2, 0.0])
    array([0.475, 0.   ])
    """
    points = checked(normalized, (-1, 2), "normalized")
    k = full_length(coefficients)
    if not k.any():
        return points
    s = np.sum(points**2, axis=-1)
    numerator, denominator = _ratio(s, k)
    distorted: Floats = points * (numerator / denominator)[..., None]
    if k[..., 2:4].any():
        x, y, p1, p2 = points[..., 0], points[..., 1], k[..., 2], k[..., 3]
        across = 2 * p1 * x * y + p2 * (s + 2 * x**2)
        down = p1 * (s + 2 * y**2) + 2 * p2 * x * y
        distorted = distorted + np.stack([across, down], axis=-1)
    return distorted


def _ratio(s: Floats, k: Floats) -> tuple[Floats, Floats]:
    """Return numerator and denominator of the radial factor at s = r²."""
    numerator = 1 + s * (k[..., 0] + s * (k[..., 1] + s * k[..., 4]))
    return numerator, 1 + s * (k[..., 5] + s * (k[..., 6] + s * k[..., 7]))


def distort_jacobian(normalized: ArrayLike, coefficients: ArrayLike) -> Floats:
    """Return ∂q_d/∂q_n, shape (..., 2, 2), for points of shape (..., 2); see `distort`."""
    points = checked(normalized, (-1, 2), "normalized")
    k = full_length(coefficients)
    s = np.sum(points**2, axis=-1)
    numerator, denominator = _ratio(s, k)
    above = k[..., 0] + s * (2 * k[..., 1] + s * 3 * k[..., 4])
    below = k[..., 5] + s * (2 * k[..., 6] + s * 3 * k[..., 7])
    factor = numerator / denominator
    slope = 2 * (above - factor * below) / denominator
    jacobian: Floats = slope[..., None, None] * points[..., :, None] * points[..., None, :]
    jacobian += factor[..., None, None] * np.eye(2)
    if k[..., 2:4].any():
        x, y, p1, p2 = points[..., 0], points[..., 1], k[..., 2], k[..., 3]
        mixed = 2 * (p1 * x + p2 * y)
        rows = [[2 * p1 * y + 6 * p2 * x, mixed], [mixed, 6 * p1 * y + 2 * p2 * x]]
        jacobian += np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    return jacobian


def coefficient_jacobian(normalized: ArrayLike, coefficients: ArrayLike) -> Floats:
    """Return ∂q_d/∂(the m coefficients given), shape (..., 2, m); see `distort`."""
    points = checked(normalized, (-1, 2), "normalized")
    given = np.asarray(coefficients, dtype=np.float64)
    k = full_length(given)
    s = np.sum(points**2, axis=-1)
    numerator, denominator = _ratio(s, k)
    x, y = points[..., 0], points[..., 1]
    outward = points * (s / denominator)[..., None]
    inward = -outward * (numerator / denominator)[..., None]
    jacobian = np.empty((*points.shape, len(COEFFICIENTS)))
    jacobian[..., 0] = outward
    jacobian[..., 1] = outward * s[..., None]
    if given.shape[-1] > 2:
        jacobian[..., 0, 2] = jacobian[..., 1, 3] = 2 * x * y
        jacobian[..., 1, 2], jacobian[..., 0, 3] = s + 2 * y**2, s + 2 * x**2
        jacobian[..., 4] = jacobian[..., 1] * s[..., None]
        jacobian[..., 5] = inward
        jacobian[..., 6] = inward * s[..., None]
        jacobian[..., 7] = jacobian[..., 6] * s[..., None]
    return jacobian[..., : given.shape[-1]]


def fold_radius(coefficients: ArrayLike) -> float:
    """Return the normalized radius at which the radial part stops growing; infinite if never.

    Beyond it two points of the scene share one image point, so the model cannot be inverted. The
    tangential part, a thousandth of the radial one in real lenses, is left out.

    Examples
    --------
    >>> round(fold_radius([-1 / 3, 0.0]), 12)
    1.0
    >>> fold_radius([0.1, 0.0])
    inf
    """
    k = full_length(checked(coefficients, (None,), "distortion"))
    return _fold(*k.tolist())


@lru_cache(maxsize=64)
def _fold(*k: float) -> float:
    """Return the fold of a full set of coefficients; a camera's is asked for with each edge."""
    k1, k2, _, _, k3, k4, k5, k6 = k
    above, below = np.array([1, k1, k2, k3]), np.array([1, k4, k5, k6])
    power = 2 * np.arange(4)
    # d(r N/D)/dr = 0 is (N + 2sN')D − 2sND' = 0 with s = r²; a pole, D = 0, ends the lens as well
    slope = np.convolve((1 + power) * above, below) - np.convolve(above, power * below)
    return min(_smallest_root(slope), (1 - 1e-9) * _smallest_root(below))


def _smallest_root(polynomial: Floats) -> float:
    """Return √s at the smallest positive root s of 1 + c₁s + …, within a lens's reach."""
    # as a polynomial in 1/s it is monic, so that no coefficient is too small to divide by
    inverse = np.roots(polynomial)
    real = inverse.real[np.abs(inverse.imag) <= 1e-9 * np.abs(inverse)]
    largest = float(real.max(initial=0.0))
    return float(1 / np.sqrt(largest)) if largest > 1 / _LARGEST_RADIUS**2 else float("inf")


def image_reach(coefficients: ArrayLike) -> float:
    """Return the radius of the image of the fold: further out, no point has an inverse."""
    k = full_length(checked(coefficients, (None,), "distortion"))
    return _image_radius(min(_fold(*k.tolist()), _LARGEST_RADIUS), k)


def _image_radius(radius: float, k: Floats) -> float:
    """Return the distorted radius of a radius."""
    numerator, denominator = _ratio(np.array(radius**2), k)
    return float(radius * numerator / denominator)


def undistort(distorted: ArrayLike, coefficients: ArrayLike) -> Floats:
    """Invert `distort` to rounding by Newton's method, shape (..., 2).

    The radial part is inverted along the radius, held between bounds; where there is a tangential
    part, Newton's method in two dimensions goes on from there.

    Parameters
    ----------
    distorted
        Distorted normalized points q_d, shape (..., 2).
    coefficients
        The coefficients of a model, shape (m,).

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
    k = full_length(checked(coefficients, (None,), "distortion"))
    if not k.any():
        return points
    tangential = bool(k[2:4].any())
    target = np.linalg.norm(points, axis=-1)
    fold = min(_fold(*k.tolist()), _LARGEST_RADIUS)
    reach = _image_radius(fold, k)
    inside = np.minimum(target, 0.999 * reach) if tangential else target
    _refuse(inside >= reach, k)
    radius = _radial_inverse(inside, k, fold)
    scale = np.divide(radius, target, out=np.ones_like(target), where=target > 0)
    undistorted: Floats = points * scale[..., None]
    return _two_dimensional(points, undistorted, k) if tangential else undistorted


def _radial_inverse(target: Floats, k: Floats, fold: float) -> Floats:
    """Return the radii up to `fold` whose distorted radii are `target`, by safe Newton steps."""
    radius = np.minimum(target, 0.999 * fold)
    low, high = np.zeros_like(target), np.full_like(target, fold)
    for _ in range(100):
        s = radius**2
        numerator, denominator = _ratio(s, k)
        factor = numerator / denominator
        above = k[0] + s * (2 * k[1] + s * 3 * k[4])
        below = k[5] + s * (2 * k[6] + s * 3 * k[7])
        miss = radius * factor - target
        low, high = np.where(miss < 0, radius, low), np.where(miss > 0, radius, high)
        newton = radius - miss / (factor + 2 * s * (above - factor * below) / denominator)
        step = np.where((newton >= low) & (newton <= high), newton, (low + high) / 2)
        settled = np.abs(step - radius) <= 4e-16 * np.maximum(radius, 1e-3)
        radius = step
        if settled.all():
            break
    return radius


def _two_dimensional(target: Floats, start: Floats, k: Floats) -> Floats:
    """Return the points whose images are `target`, by Newton's method from `start`."""
    points = start
    for _ in range(50):
        miss = distort(points, k) - target
        jacobian = distort_jacobian(points, k)
        determinant = np.linalg.det(jacobian)
        _refuse(~(determinant > 0), k)
        step = np.linalg.solve(jacobian, miss[..., None])[..., 0]
        points = points - step
        if (np.abs(step) <= 1e-10 * determinant[..., None]).all():  # its square is rounding
            break
    # fitted rational models may have a numerator and denominator near 1e-3: rounding of 1e-13
    lost = np.abs(distort(points, k) - target).max(axis=-1) > 1e-10
    _refuse(lost | (np.linalg.norm(points, axis=-1) > fold_radius(k)), k)
    return points


def _refuse(beyond: Floats, k: Floats) -> None:
    """Refuse points without an inverse; `beyond` says which."""
    if np.any(beyond):
        stated = ", ".join(f"{n} = {v:.3f}" for n, v in zip(COEFFICIENTS, k, strict=True) if v)
        raise DataError(
            f"{np.count_nonzero(beyond)} image points have no inverse: the distortion model "
            f"({stated}) folds at normalized radius {image_reach(k):.3f} or nearer",
            next_step="add board views that reach the corners of the image and calibrate again",
        )
