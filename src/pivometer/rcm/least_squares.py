"""The paper's 2-norm RCM, with its covariance."""

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats, checked
from pivometer.errors import ShapeError
from pivometer.rcm.lines import CentredLines, centred_lines
from pivometer.rcm.result import LeastSquaresRcm


def least_squares_rcm(
    points_mm: ArrayLike, directions: ArrayLike, *, covariances_mm2: ArrayLike | None = None
) -> LeastSquaresRcm:
    """Return the point with the least sum of squared distances from the lines.

    With Pᵢ = I − aᵢaᵢᵀ and N = Σ Pᵢ the point is N⁻¹ Σ Pᵢbᵢ. Its covariance is s² N⁻¹ with
    s² = Σ dᵢ²/(2n − 3), as each line has two degrees of freedom and the point takes three; or,
    where the lines' own covariances Sᵢ are given, N⁻¹ (Σ PᵢSᵢPᵢ) N⁻¹.

    Parameters
    ----------
    points_mm, directions
        A point on each line (mm) and its direction, of any length, shape (n, 3), same frame.
    covariances_mm2
        Covariance of each line's position near the RCM, shape (n, 3, 3), mm²; the part along the
        line does not count. Without it the scatter of the lines says how well they are known.

    Raises
    ------
    ShapeError
        If an array has the wrong shape.
    TooFewPosesError
        If there are fewer than three lines.
    DegenerateGeometryError
        If the lines are parallel.

    References
    ----------
    Wilson et al., section V, J = ‖d₁‖² + … + ‖dₙ‖².

    Examples
    --------
    >>> points = [[0, 0, 1], [0, 0, -1], [1, 5, 0], [-1, 9, 0]]
    >>> directions = [[1, 0, 0], [2, 0, 0], [0, 1, 0], [0, 1, 0]]
    >>> rcm = least_squares_rcm(points, directions)
    >>> rcm.point_mm.round(12) + 0.0
    array([0., 0., 0.])
    >>> rcm.rms_mm, rcm.covariance_mm2.diagonal().round(12)
    (1.0, array([0.4, 0.4, 0.2]))
    """
    return solve_least_squares(centred_lines(points_mm, directions), covariances_mm2)


def solve_least_squares(
    lines: CentredLines, covariances_mm2: ArrayLike | None = None
) -> LeastSquaresRcm:
    """Return the least-squares RCM of lines that are centred on it already."""
    distances = lines.radii()
    squares = distances.dot(distances)
    if covariances_mm2 is None:
        covariance = squares / (2 * len(distances) - 3) * _inverse_information(lines)
    else:
        covariance = _sandwich(lines, covariances_mm2)
    return LeastSquaresRcm(
        point_mm=lines.centre,
        covariance_mm2=covariance,
        max_mm=float(distances.max()),
        rms_mm=float(np.sqrt(squares / len(distances))),
        distances_mm=distances,
    )


def _inverse_information(lines: CentredLines) -> Floats:
    """Return N⁻¹ in the frame of the given lines, shape (3, 3)."""
    inverse: Floats = (lines.turn / lines.information) @ lines.turn.T
    return inverse


def _sandwich(lines: CentredLines, covariances_mm2: ArrayLike) -> Floats:
    """Return N⁻¹ (Σ PᵢSᵢPᵢ) N⁻¹, shape (3, 3), mm²."""
    covariances = checked(covariances_mm2, (None, 3, 3), "covariances_mm2")
    if len(covariances) != len(lines.axes):
        raise ShapeError(
            f"{len(covariances)} covariances for {len(lines.axes)} lines",
            next_step="pass one covariance for each line",
        )
    projectors = lines.projectors() @ lines.turn.T
    middle = np.einsum("nij,njk,nlk->il", projectors, covariances, projectors, optimize=True)
    inverse = lines.turn / lines.information
    covariance: Floats = inverse @ middle @ inverse.T
    return covariance
