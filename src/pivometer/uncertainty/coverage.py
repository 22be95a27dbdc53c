"""From standard uncertainties to statements that hold with a stated probability."""

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats, checked
from pivometer.errors import DegenerateGeometryError

COVERAGE = 0.95
"""Coverage probability of every expanded uncertainty, unless another is asked for."""


def coverage_factor(degrees_of_freedom: float, *, coverage: float = COVERAGE) -> float:
    """Return k, by which a standard uncertainty is multiplied for an interval of given coverage.

    Parameters
    ----------
    degrees_of_freedom
        Of the standard uncertainty; ``inf`` if it is known.
    coverage
        Probability, between 0 and 1.

    References
    ----------
    GUM (JCGM 100:2008), G.3: the quantile of Student's t distribution.

    Examples
    --------
    >>> round(coverage_factor(float("inf")), 3), round(coverage_factor(137), 3)
    (1.96, 1.977)
    """
    from scipy.special import ndtri, stdtrit

    quantile = (1 + coverage) / 2
    if np.isinf(degrees_of_freedom):
        return float(ndtri(quantile))
    return float(stdtrit(degrees_of_freedom, quantile))


def confidence_radius(
    degrees_of_freedom: float, *, coverage: float = COVERAGE, dimensions: int = 3
) -> float:
    """Return the Mahalanobis distance within which the true point lies with given probability.

    For a covariance s² C with C known and s² on ν degrees of freedom, the squared Mahalanobis
    distance over the number of dimensions has the F distribution; for ν = ∞ the square has the χ²
    distribution.

    Examples
    --------
    >>> round(confidence_radius(float("inf")), 3), round(confidence_radius(137), 3)
    (2.795, 2.831)
    """
    from scipy.special import fdtri, gammaincinv

    if np.isinf(degrees_of_freedom):
        return float(np.sqrt(2 * gammaincinv(dimensions / 2, coverage)))
    return float(np.sqrt(dimensions * fdtri(dimensions, degrees_of_freedom, coverage)))


def mahalanobis(point: ArrayLike, centre: ArrayLike, covariance: ArrayLike) -> float:
    """Return the distance of a point from an estimate in units of its standard uncertainty.

    Parameters
    ----------
    point, centre
        Shape (d,), same unit and frame.
    covariance
        Covariance of `centre`, shape (d, d), positive definite.

    Raises
    ------
    DegenerateGeometryError
        If the covariance is not positive definite.

    Examples
    --------
    >>> mahalanobis([3.0, 0.0, 8.0], [0.0, 0.0, 0.0], np.diag([1.0, 1.0, 4.0]))
    5.0
    """
    offset = checked(point, (None,), "point") - checked(centre, (None,), "centre")
    matrix = checked(covariance, (len(offset), len(offset)), "covariance")
    try:
        factor = np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        least = float(np.linalg.eigvalsh(matrix)[0])
        raise DegenerateGeometryError(
            f"a covariance is not positive definite: its smallest eigenvalue is {least:.1e}",
            next_step="give every direction an uncertainty",
        ) from None
    return float(np.linalg.norm(np.linalg.solve(factor, offset)))


def lies_within(
    point: ArrayLike,
    centre: ArrayLike,
    covariance: ArrayLike,
    *,
    degrees_of_freedom: float,
    coverage: float = COVERAGE,
) -> bool:
    """Tell whether a point lies inside the confidence ellipsoid of an estimate.

    Examples
    --------
    >>> lies_within([2, 2, 0], [0, 0, 0], np.eye(3), degrees_of_freedom=137)
    True
    >>> lies_within([2, 2, 1], [0, 0, 0], np.eye(3), degrees_of_freedom=137)
    False
    """
    radius = confidence_radius(
        degrees_of_freedom, coverage=coverage, dimensions=np.asarray(centre).size
    )
    return mahalanobis(point, centre, covariance) <= radius


def effective_degrees_of_freedom(variances: ArrayLike, degrees_of_freedom: ArrayLike) -> float:
    """Return the degrees of freedom of a sum of independent variances.

    Parameters
    ----------
    variances
        Its parts, shape (k,).
    degrees_of_freedom
        Of each part, shape (k,); ``inf`` where a part is known.

    References
    ----------
    Welch–Satterthwaite formula; GUM (JCGM 100:2008), G.4.1.

    Examples
    --------
    >>> effective_degrees_of_freedom([1.0, 1.0], [10, float("inf")])
    40.0
    """
    parts: Floats = checked(variances, (None,), "variances")
    lost = float((parts**2 / np.asarray(degrees_of_freedom, dtype=np.float64)).sum())
    return float(parts.sum() ** 2 / lost) if lost > 0 else float("inf")


def fewest_degrees_of_freedom(covariances: ArrayLike, degrees_of_freedom: ArrayLike) -> float:
    """Return the degrees of freedom of a sum of covariances, along the axis that has the fewest.

    Parameters
    ----------
    covariances
        Its independent parts, shape (k, d, d).
    degrees_of_freedom
        Of each part, shape (k,); ``inf`` where a part is known.

    Examples
    --------
    >>> fewest_degrees_of_freedom([np.diag([1.0, 3.0]), np.eye(2)], [10, float("inf")])
    17.77777777777778
    """
    variances = np.diagonal(checked(covariances, (None, None, None), "covariances"), 0, 1, 2)
    return min(effective_degrees_of_freedom(axis, degrees_of_freedom) for axis in variances.T)
