"""Relative pose of two cameras from corresponding image points, eqs. (19) and (20).

The eight-point algorithm gives the start; the bundle adjustment of (19) under (20) then moves the
image points as little as possible so that every pair of rays meets, over the five degrees of
freedom of the essential matrix E = [t]× R. In the paper's eq. (13) (R, t) is ``first_from_second``,
so (20) reads x₁ᵀ E x₂ = 0 with x₁ in the first (left) image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats, checked
from pivometer.calibration.homography import homography, normalising_similarity
from pivometer.errors import CalibrationError
from pivometer.geometry.rigid import RigidTransform, cross_matrix, rotation_from_vector

COPLANAR = 2e-3
"""Normalised distance (2 px at f = 1000 px) up to which all points may fit one plane."""


@dataclass(frozen=True, slots=True, eq=False)
class EpipolarSolution:
    """The relative pose up to scale, and the image points moved onto it.

    Parameters
    ----------
    first_from_second
        The paper's (R, t) of (13) with ‖t‖ = 1.
    first, second
        The noise-free images x₁, x₂ of (19), normalised coordinates, shape (n, 2).
    correction
        Root-mean-square of √(‖w₁‖² + ‖w₂‖²) over the points, in the unit of the weights (px where
        they are focal lengths). One of the four coordinates of a point is redundant, so this is
        the standard deviation of one coordinate.
    """

    first_from_second: RigidTransform
    first: Floats
    second: Floats
    correction: float


def eight_point(first: ArrayLike, second: ArrayLike) -> Floats:
    """Return the essential matrix with x₁ᵀ E x₂ = 0, shape (3, 3), singular values (1, 1, 0).

    Parameters
    ----------
    first, second
        Normalised undistorted image points, shape (n, 2), n ≥ 8.

    Raises
    ------
    CalibrationError
        If there are too few points, or all of them lie in one plane of the scene, for which the
        linear equations have many solutions.

    References
    ----------
    Longuet-Higgins (the paper's reference [17]), normalised after Hartley, doi:10.1109/34.601246.
    """
    a, b = checked(first, (None, 2), "first"), checked(second, (None, 2), "second")
    if len(a) < 8 or a.shape != b.shape:
        raise CalibrationError(
            f"{len(a)} corresponding points, the eight-point algorithm needs 8",
            next_step="add images of the board taken by both cameras at the same moment",
        )
    _refuse_coplanar(a, b)
    T1, T2 = normalising_similarity(a), normalising_similarity(b)
    x1, x2 = _homogeneous(a) @ T1.T, _homogeneous(b) @ T2.T
    rows = (x1[:, :, None] * x2[:, None, :]).reshape(-1, 9)
    E = np.linalg.eigh(rows.T @ rows)[1][:, 0].reshape(3, 3)
    left, _, right = np.linalg.svd(T1.T @ E @ T2)
    essential: Floats = left @ np.diag([1.0, 1.0, 0.0]) @ right
    return essential


def _refuse_coplanar(first: Floats, second: Floats) -> None:
    H = homography(first, second)
    mapped = _homogeneous(first) @ H.T
    misfit = float(np.sqrt(np.mean((mapped[:, :2] / mapped[:, 2:] - second) ** 2)))
    if misfit < COPLANAR:
        raise CalibrationError(
            f"all {len(first)} corners lie in one plane (to {misfit:.1e} of the focal length), "
            "which leaves the relative pose of the cameras undetermined",
            next_step="add images of the board at other distances and tilts, taken by both cameras",
        )


def _homogeneous(points: Floats) -> Floats:
    return np.concatenate([points, np.ones((len(points), 1))], axis=1)


def pose_from_essential(E: Floats, first: Floats, second: Floats) -> RigidTransform:
    """Return ``first_from_second`` with ‖t‖ = 1: of the four candidates the one in front of both.

    Parameters
    ----------
    E
        Essential matrix, shape (3, 3).
    first, second
        Normalised image points, shape (n, 2).

    Raises
    ------
    CalibrationError
        If fewer than 95 % of the points lie in front of both cameras for every candidate.

    References
    ----------
    Ma et al., theorem 5.7 and section 5.2 (the paper's reference [14]).
    """
    left, _, right = np.linalg.svd(E)
    left, right = left * np.linalg.det(left), right * np.linalg.det(right)
    W = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    candidates = [
        RigidTransform(left @ turn @ right, sign * left[:, 2])
        for turn in (W, W.T)
        for sign in (1.0, -1.0)
    ]
    shares = [_share_in_front(candidate, first, second) for candidate in candidates]
    best = int(np.argmax(shares))
    if shares[best] < 0.95:
        raise CalibrationError(
            f"only {100 * shares[best]:.0f} % of the board corners come to lie in front of both "
            "cameras",
            next_step="check that images with the same file name show the same moment",
        )
    return candidates[best]


def _share_in_front(pose: RigidTransform, first: Floats, second: Floats) -> float:
    """Return the fraction of points whose two rays meet in front of both cameras."""
    rays1 = _homogeneous(first)
    rays2 = pose.rotate(_homogeneous(second))
    normal = np.cross(rays1, rays2)
    size = np.sum(normal**2, axis=1)
    depth1 = np.sum(np.cross(pose.translation_mm, rays2) * normal, axis=1) / size
    depth2 = np.sum(np.cross(pose.translation_mm, rays1) * normal, axis=1) / size
    return float(np.mean((depth1 > 0) & (depth2 > 0)))


def corrected_points(
    E: Floats, first: Floats, second: Floats, *, weights: tuple[float, float] = (1.0, 1.0)
) -> tuple[Floats, Floats]:
    """Move image points as little as possible onto x₁ᵀ E x₂ = 0: (19) under (20) for fixed E.

    Each round puts the linearised constraint at the moved point through the measured one; at rest
    the correction is exactly normal to the constraint, so this is the maximum-likelihood
    (optimal) correction and not Sampson's approximation, which is its first round.

    Parameters
    ----------
    E
        Essential matrix, shape (3, 3).
    first, second
        Measured normalised points, shape (n, 2).
    weights
        Weight of a correction in each image: the focal lengths, for corrections in pixels.

    References
    ----------
    Kanatani, Sugaya and Niitsuma, doi:10.5244/C.22.18; Lindstrom, doi:10.1109/CVPR.2010.5539785.
    """
    x1, x2 = first, second
    for _ in range(10):
        value, slope1, slope2 = _constraint(E, x1, x2, weights)
        w1, w2 = (first - x1) * weights[0], (second - x2) * weights[1]
        size = np.sum(slope1**2, axis=1) + np.sum(slope2**2, axis=1)
        size = np.maximum(size, np.finfo(float).tiny)
        gap = (value + np.sum(slope1 * w1 + slope2 * w2, axis=1)) / size
        new1 = first - gap[:, None] * slope1 / weights[0]
        new2 = second - gap[:, None] * slope2 / weights[1]
        moved = max(float(np.abs(new1 - x1).max()), float(np.abs(new2 - x2).max()))
        x1, x2 = new1, new2
        if moved < 1e-15:
            break
    return x1, x2


def _constraint(
    E: Floats, x1: Floats, x2: Floats, weights: tuple[float, float]
) -> tuple[Floats, Floats, Floats]:
    """Return x₁ᵀ E x₂ and its derivatives by the weighted points."""
    along1 = _homogeneous(x2) @ E.T
    along2 = _homogeneous(x1) @ E
    value = np.sum(_homogeneous(x1) * along1, axis=1)
    return value, along1[:, :2] / weights[0], along2[:, :2] / weights[1]


def bundle_adjust(
    start: RigidTransform,
    first: ArrayLike,
    second: ArrayLike,
    *,
    weights: tuple[float, float] = (1.0, 1.0),
) -> EpipolarSolution:
    """Minimise (19) under (20) over all image points and the relative pose up to scale.

    Levenberg–Marquardt over the five degrees of freedom of (R, t), ‖t‖ = 1; for each pose the
    points are corrected exactly (`corrected_points`), and the linearisation at the corrected
    points makes the rest point of the iteration the constrained minimum itself.

    Parameters
    ----------
    start
        ``first_from_second`` to begin with, e.g. from the eight-point algorithm.
    first, second
        Normalised undistorted image points, shape (n, 2).
    weights
        Weight of a correction in each image. (19) weighs normalised coordinates alike (1, 1); the
        focal lengths make the corrections pixels, alike where the focal lengths are.

    Raises
    ------
    CalibrationError
        If it does not settle within 100 steps.

    References
    ----------
    Wilson et al., eqs. (19), (20); Ma et al., algorithm 5.5 (the paper's reference [14]).
    """
    a, b = checked(first, (None, 2), "first"), checked(second, (None, 2), "second")
    R, t = start.rotation, start.translation_mm / np.linalg.norm(start.translation_mm)
    damping, (cost, x1, x2) = 1e-6, _corrections(R, t, a, b, weights)
    for _ in range(100):
        e, J = _reduced_residuals(R, t, (a, b), (x1, x2), weights)
        H, g = J.T @ J, J.T @ e
        step = -np.linalg.solve(H + damping * np.diag(np.diag(H)), g)
        new_R, new_t = rotation_from_vector(step[:3]) @ R, t + _tangent(t) @ step[3:]
        new_t = new_t / np.linalg.norm(new_t)
        new_cost, y1, y2 = _corrections(new_R, new_t, a, b, weights)
        if new_cost > cost and damping < 1e8:
            settled = float(np.abs(step).max()) < 1e-12
            damping = 10 * damping
        else:
            settled = cost - new_cost <= 1e-12 * cost
            R, t, cost, x1, x2, damping = new_R, new_t, new_cost, y1, y2, 0.1 * damping
        if settled or cost <= 1e-28 * len(a):
            size = float(np.sqrt(cost / len(a)))
            return EpipolarSolution(RigidTransform(R, t), x1, x2, size)
    raise CalibrationError(
        "the bundle adjustment of (19) under (20) did not settle within 100 steps",
        next_step="check that images with the same file name show the same moment",
    )


def _corrections(
    R: Floats, t: Floats, first: Floats, second: Floats, weights: tuple[float, float]
) -> tuple[float, Floats, Floats]:
    """Return the value of (19) for one pose, and the corrected points."""
    x1, x2 = corrected_points(cross_matrix(t) @ R, first, second, weights=weights)
    w1, w2 = (first - x1) * weights[0], (second - x2) * weights[1]
    return float(np.sum(w1**2) + np.sum(w2**2)), x1, x2


def _tangent(t: Floats) -> Floats:
    """Return two unit vectors normal to `t` and each other, shape (3, 2)."""
    basis: Floats = np.linalg.svd(t[None])[2][1:].T
    return basis


def _reduced_residuals(
    R: Floats,
    t: Floats,
    measured: tuple[Floats, Floats],
    moved: tuple[Floats, Floats],
    weights: tuple[float, float],
) -> tuple[Floats, Floats]:
    """Return the signed length of each correction, (n,), and its derivatives, (n, 5)."""
    x1, x2 = moved
    value, slope1, slope2 = _constraint(cross_matrix(t) @ R, x1, x2, weights)
    w1, w2 = (measured[0] - x1) * weights[0], (measured[1] - x2) * weights[1]
    size = np.sqrt(np.sum(slope1**2, axis=1) + np.sum(slope2**2, axis=1))
    e = (value + np.sum(slope1 * w1 + slope2 * w2, axis=1)) / size
    ray1, turned = _homogeneous(x1), _homogeneous(x2) @ R.T
    # x₁·(t × y) with y = R x₂: by the left turn δ × y, and by t
    by_turn = np.cross(turned, np.cross(ray1, t))
    by_t = np.cross(turned, ray1) @ _tangent(t)
    return e, np.concatenate([by_turn, by_t], axis=1) / size[:, None]
