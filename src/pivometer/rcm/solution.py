"""Both RCM points of a set of lines at once."""

import numpy as np
from numpy.typing import ArrayLike

from pivometer.rcm.cone import apex_deg
from pivometer.rcm.least_squares import solve_least_squares
from pivometer.rcm.lines import centred_lines
from pivometer.rcm.minimax import solve_minimax
from pivometer.rcm.result import RcmSolution


def solve(points_mm: ArrayLike, directions: ArrayLike) -> RcmSolution:
    """Return the point that the lines miss least: in the worst case, and in the mean square.

    No camera is needed: the lines may come from anywhere. Whether they determine the point well
    enough to be believed is another question, which `geometry_findings` answers.

    Parameters
    ----------
    points_mm
        A point on each line, shape (n, 3), mm.
    directions
        The direction of each line, shape (n, 3), same frame, of any length and sign.

    Raises
    ------
    ShapeError
        If an array has the wrong shape or holds values that are not finite.
    TooFewPosesError
        If there are fewer than three lines.
    DegenerateGeometryError
        If the lines are parallel, so that no point along them is better than another.

    References
    ----------
    Wilson et al., eqs. (1)–(3) and section V.

    Examples
    --------
    >>> rcm = solve([[0, 0, 1], [5, 0, -1], [1, 5, 0], [-1, 9, 0]],
    ...             [[1, 0, 0], [2, 0, 0], [0, 1, 0], [0, -1, 0]])
    >>> rcm.minimax.max_mm, round(rcm.least_squares.rms_mm, 12), round(rcm.cone_deg, 6)
    (1.0, 1.0, 90.0)
    """
    lines = centred_lines(points_mm, directions)
    minimax = solve_minimax(lines)
    least_squares = solve_least_squares(lines)
    return RcmSolution(
        minimax=minimax,
        least_squares=least_squares,
        separation_mm=float(np.linalg.norm(minimax.point_mm - least_squares.point_mm)),
        cone_deg=apex_deg(lines.axes),
    )
