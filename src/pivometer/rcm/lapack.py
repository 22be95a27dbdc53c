"""LAPACK's own routines: for a few unknowns NumPy's checks take longer than the algebra."""

from functools import cache
from types import ModuleType


@cache
def lapack() -> ModuleType:
    """Return `scipy.linalg.lapack`, imported when it is first needed.

    Examples
    --------
    >>> lapack().dgesv([[2.0, 0.0], [0.0, 4.0]], [2.0, 2.0])[2]
    array([1. , 0.5])
    """
    from scipy.linalg import lapack as module

    return module
