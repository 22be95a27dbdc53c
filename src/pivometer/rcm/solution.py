"""All RCM points of a set of lines at once."""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from pivometer.errors import DegenerateGeometryError
from pivometer.rcm.cone import apex_deg
from pivometer.rcm.least_squares import solve_least_squares
from pivometer.rcm.lines import centred_lines
from pivometer.rcm.minimax import content, solve_minimax
from pivometer.rcm.result import RcmSolution
from pivometer.rcm.robust import least_distance_rcm
from pivometer.rcm.trimmed import trimmed_rcm
from pivometer.rcm.weighted import weighted_rcm


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


def with_other_points(
    rcm: RcmSolution,
    points_mm: ArrayLike,
    directions: ArrayLike,
    *,
    covariances_mm2: ArrayLike | None = None,
    common_mm: ArrayLike | None = None,
) -> RcmSolution:
    """Return a solution with the points that are not in the paper, and `content`, too.

    Parameters
    ----------
    rcm
        What `solve` returned for the lines.
    points_mm, directions
        The lines, shape (n, 3) each, mm.
    covariances_mm2, common_mm
        What is known of the lines, as `weighted_rcm` takes it; without covariances there is no
        weighted point.

    Raises
    ------
    ShapeError, TooFewPosesError, DegenerateGeometryError
        As `least_distance_rcm` and `weighted_rcm`.
    """
    weighted = None
    try:
        trimmed = trimmed_rcm(points_mm, directions)
    except DegenerateGeometryError:  # the nearest three quarters are parallel: they have no point
        trimmed = None
    if covariances_mm2 is not None:
        weighted = weighted_rcm(points_mm, directions, covariances_mm2, common_mm=common_mm)
    return replace(
        rcm,
        least_distance=least_distance_rcm(points_mm, directions),
        trimmed=trimmed,
        weighted=weighted,
        content=content(len(rcm.minimax.distances_mm)),
    )
