"""The RCM with every line weighted by what is known of it: generalized least squares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats, checked
from pivometer.errors import ShapeError
from pivometer.rcm.lines import CentredLines, centred_lines
from pivometer.rcm.result import Finding, WeightedRcm

LEAST_VARIANCE = 1e-12
"""Part of the largest variance under which a line's own variance is no uncertainty but rounding."""

UNLIKELY = 0.001
"""Probability of a shift between two points, from which chance is not taken for its cause."""

NEGLIGIBLE = 0.1
"""Part of the location's standard uncertainty below which a shift is of no consequence, however
well it is known: it would raise that uncertainty by half a percent."""


def weighted_rcm(
    points_mm: ArrayLike,
    directions: ArrayLike,
    covariances_mm2: ArrayLike,
    *,
    common_mm: ArrayLike | None = None,
) -> WeightedRcm:
    """Return the point that generalized least squares finds: lines that are known badly count less.

    Across line i, with the two rows of Bᵢ perpendicular to it, Bᵢrᵢ = Bᵢp + Bᵢ(Kᵢz + δᵢ) + ρᵢ: the
    instrument's noise δᵢ of covariance Sᵢ, r errors z common to all lines, of variance 1, and the
    robot's own scatter ρᵢ, of unknown variance τ² a component. For given τ² the point is the
    solution of one linear system; z are unknowns in it, too, each known to be 0 ± 1. τ² is the one
    for which the weighted sum of squares equals its degrees of freedom, 2n − 3; it falls
    monotonically with τ², so there is one solution, or none, and then τ = 0: the instrument
    explains all. Nothing is searched for, so there is no local optimum to end in.

    Parameters
    ----------
    points_mm, directions
        A point on each line (mm) and its direction, of any length, shape (n, 3), same frame.
    covariances_mm2
        Covariance of each line's position near the RCM, shape (n, 3, 3), mm², independent of the
        others'; the part along the line does not count.
    common_mm
        Displacements of each line near the RCM by one standard uncertainty of each of r independent
        sources that all lines share, such as the calibration, shape (n, 3, r), mm. They must not
        depend on what the lines miss: else those are favoured that make the misses small.

    Raises
    ------
    ShapeError
        If an array has the wrong shape, or a line has no uncertainty across it.
    TooFewPosesError, DegenerateGeometryError
        If the lines do not determine a point.

    References
    ----------
    R. Paule and J. Mandel, doi:10.6028/jres.087.022 (τ²). C. R. Henderson, doi:10.2307/2529430
    (common errors as unknowns).

    Examples
    --------
    >>> points = [[0, 0, 1], [0, 0, -1], [1, 5, 0], [-1, 9, 0]]
    >>> directions = [[1, 0, 0], [2, 0, 0], [0, 1, 0], [0, 1, 0]]
    >>> known = [0.1**2 * np.eye(3)] * 3 + [100**2 * np.eye(3)]
    >>> rcm = weighted_rcm(points, directions, known)
    >>> rcm.shares.round(2), rcm.point_mm.round(2)
    (array([0.33, 0.33, 0.33, 0.  ]), array([1., 0., 0.]))
    """
    lines = centred_lines(points_mm, directions)
    model = _model(lines, covariances_mm2, common_mm)
    own_mm2 = model.own_variance()
    unknowns, inverse, _ = model.solved(own_mm2)
    point, location = unknowns[:3], inverse[:3, :3]
    distances = lines.distances(point)
    weights = model.weights(own_mm2).reshape(-1, 2).sum(axis=1)
    return WeightedRcm(
        point_mm=lines.centre + lines.turn @ point,
        covariance_mm2=lines.turn @ location @ lines.turn.T,
        own_mm=float(np.sqrt(own_mm2)),
        max_mm=float(distances.max()),
        rms_mm=float(np.sqrt(distances.dot(distances) / len(distances))),
        distances_mm=distances,
        shares=weights / weights.sum(),
        shift_mm=lines.turn @ point,
        shift_covariance_mm2=lines.turn @ model.shift_covariance(own_mm2) @ lines.turn.T,
    )


def weighting_findings(rcm: WeightedRcm) -> tuple[Finding, ...]:
    """Return a warning if the weights move the point by more than errors explain, and noticeably.

    References
    ----------
    J. Hausman, doi:10.2307/1913827: two estimates of one quantity, one of them efficient, differ by
    chance only as far as their covariances differ.
    """
    from scipy.special import fdtri

    allowed = rcm.shift_covariance_mm2 + NEGLIGIBLE**2 * rcm.covariance_mm2
    squares = float(rcm.shift_mm @ np.linalg.solve(allowed, rcm.shift_mm))
    size, freedom = len(rcm.shift_mm), 2 * len(rcm.distances_mm) - 3
    if squares <= size * float(fdtri(size, freedom, 1 - UNLIKELY)):
        return ()
    shift = float(np.linalg.norm(rcm.shift_mm))
    chance = float(np.sqrt(np.trace(rcm.shift_covariance_mm2)))
    return (
        Finding(
            "warning",
            f"weighting the lines by how well they are known moves the point by {shift:.3g} mm, "
            f"where chance explains about {chance:.2g} mm: the misses depend on the pose",
            "prefer the unweighted points, and say for which poses they hold",
        ),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Model:
    """Two uncorrelated rows for each line: along the principal axes of its covariance.

    Parameters
    ----------
    rows
        Coefficients of the point and of the r common errors, shape (2n, 3 + r).
    offsets
        What the rows should amount to, shape (2n,), mm.
    variances
        The instrument's variances, shape (2n,), mm².
    """

    rows: Floats
    offsets: Floats
    variances: Floats

    def weights(self, own_mm2: float) -> Floats:
        """Return the weight of each row, shape (2n,), mm⁻²."""
        weights: Floats = 1 / (self.variances + own_mm2)
        return weights

    def solved(self, own_mm2: float) -> tuple[Floats, Floats, Floats]:
        """Return the unknowns, their covariance, and the weighted residuals of the rows."""
        weights = self.weights(own_mm2)
        normal = (self.rows.T * weights) @ self.rows
        common = np.arange(3, len(normal))
        normal[common, common] += 1
        inverse: Floats = np.linalg.inv(normal).astype(np.float64)
        unknowns = inverse @ (self.rows.T @ (weights * self.offsets))
        return unknowns, inverse, weights * (self.offsets - self.rows @ unknowns)

    def own_variance(self) -> float:
        """Return τ² for which the weighted sum of squares Q is 2n − 3, or zero if Q is less.

        Q is a sum of cₖ/(λₖ + τ²), so 1/Q is concave in τ²: Newton's steps on it from zero grow
        towards the solution and never pass it.
        """
        freedom = len(self.offsets) - 3
        own = 0.0
        for _ in range(100):
            residuals = self.solved(own)[2]
            squares = float(residuals @ self.offsets)
            if squares <= freedom * (1 + 1e-12):
                break
            own += squares * (squares / freedom - 1) / float(residuals @ residuals)
        return own

    def shift_covariance(self, own_mm2: float) -> Floats:
        """Return the covariance of this point minus the least-squares point, shape (3, 3).

        With both linear in the offsets it is D V Dᵀ, D being the difference of their coefficients.
        """
        weights = self.weights(own_mm2)
        inverse = self.solved(own_mm2)[1]
        own, common = self.rows[:, :3], self.rows[:, 3:]
        # The point's rows of (XᵀWX + diag(0, 1))⁻¹XᵀW, minus those of (XᵀX)⁻¹Xᵀ.
        difference = (inverse[:3] @ self.rows.T) * weights - np.linalg.solve(own.T @ own, own.T)
        shared = difference @ common
        covariance: Floats = (difference / weights) @ difference.T + shared @ shared.T
        return covariance


def _model(lines: CentredLines, covariances_mm2: ArrayLike, common_mm: ArrayLike | None) -> _Model:
    """Return the rows of lines with their covariances in the frame of the lines."""
    count = len(lines.axes)
    covariances = checked(covariances_mm2, (count, 3, 3), "covariances_mm2")
    shared = np.zeros((count, 3, 0)) if common_mm is None else common_mm
    common = checked(shared, (count, 3, None), "common_mm")
    across = np.linalg.svd(lines.axes[:, None, :])[2][:, 1:]  # two unit vectors, (n, 2, 3)
    turned = across @ lines.turn.T
    variances, vectors = np.linalg.eigh(turned @ covariances @ np.swapaxes(turned, 1, 2))
    known = variances[:, 0] > LEAST_VARIANCE * variances.max()
    if not known.all():
        raise ShapeError(
            f"{int((~known).sum())} of {count} lines have no uncertainty across them, the first "
            f"is line {int(np.argmin(known))}",
            next_step="pass a positive definite covariance for every line",
        )
    rows = np.swapaxes(vectors, 1, 2) @ across
    return _Model(
        rows=np.concatenate([rows, rows @ (lines.turn.T @ common)], axis=2).reshape(2 * count, -1),
        offsets=np.vecdot(rows, lines.offsets[:, None, :]).ravel(),
        variances=variances.ravel(),
    )
