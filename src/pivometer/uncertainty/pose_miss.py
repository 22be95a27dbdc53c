"""How well a single pose's miss is known."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats, checked
from pivometer.uncertainty.coverage import COVERAGE, coverage_factor


def miss_interval_mm(
    miss_mm: ArrayLike, covariance_mm2: ArrayLike, *, coverage: float = COVERAGE
) -> Floats:
    """Return the interval of the length of a miss, from the line's own covariance alone.

    Parameters
    ----------
    miss_mm
        From a point to the nearest point of a line, shape (3,), mm.
    covariance_mm2
        Covariance of the line's position there, shape (3, 3), mm².
    coverage
        Of the interval.

    Returns
    -------
    numpy.ndarray
        Its two ends, shape (2,), mm; the lower is never under zero.

    Examples
    --------
    >>> miss_interval_mm([0.1, 0, 0], np.diag([0.01, 0.5, 0]) ** 2).round(3)
    array([0.08, 0.12])
    >>> miss_interval_mm([0.0, 0, 0], np.diag([0.01, 0.01, 0]) ** 2).round(3)
    array([0.  , 0.02])
    """
    miss = checked(miss_mm, (3,), "miss_mm")
    covariance = checked(covariance_mm2, (3, 3), "covariance_mm2")
    length = float(np.linalg.norm(miss))
    if length > 0:
        u = float(np.sqrt(max(float(miss @ covariance @ miss), 0.0))) / length
    else:
        u = float(np.sqrt(max(float(np.linalg.eigvalsh(covariance)[-1]), 0.0)))
    half = coverage_factor(float("inf"), coverage=coverage) * u
    return np.array([max(length - half, 0.0), length + half])
