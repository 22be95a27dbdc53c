"""The paper's ∞-norm RCM, eqs. (2)–(3), for any number of lines, with its optimality proved."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats
from pivometer.errors import DegenerateGeometryError
from pivometer.rcm.interior_point import GOOD_GAP, Constraints, Optimum, highest
from pivometer.rcm.lines import CentredLines, centred_lines
from pivometer.rcm.result import MinimaxRcm

LARGEST_GAP = 1e-10
"""A relative duality gap above this is a failure: over 11 900 random and adversarial problems the
largest was 1e-13."""

ALL_AT_ONCE = 150
"""Up to this many lines leaving some out costs as much as it saves (measured: 100 to 150)."""

UNKNOWNS = 4
"""Unknowns of (3) once each line's own is eliminated: the point and the radius."""


def minimax_rcm(points_mm: ArrayLike, directions: ArrayLike) -> MinimaxRcm:
    """Return the point whose largest distance from the lines is smallest, with its certificate.

    Parameters
    ----------
    points_mm, directions
        A point on each line (mm) and its direction, of any length, shape (n, 3), same frame.

    Raises
    ------
    ShapeError
        If an array has the wrong shape.
    TooFewPosesError
        If there are fewer than three lines.
    DegenerateGeometryError
        If the lines are parallel.

    Notes
    -----
    The radius is always unique. The point is too, unless the lines that decide are all parallel;
    then any point of a segment serves, and one of them is returned.

    References
    ----------
    Wilson et al., eqs. (2)–(3). S. Mehrotra, doi:10.1137/0802028 (the interior point).

    Examples
    --------
    >>> points = [[0, 0, 1], [0, 0, -1], [1, 5, 0], [-1, 9, 0]]
    >>> directions = [[1, 0, 0], [2, 0, 0], [0, 1, 0], [0, 1, 0]]
    >>> rcm = minimax_rcm(points, directions)
    >>> rcm.point_mm.round(12) + 0.0
    array([0., 0., 0.])
    >>> rcm.max_mm, rcm.certificate_gap
    (1.0, 0.0)
    """
    return solve_minimax(centred_lines(points_mm, directions))


def content(count: int, *, confidence: float = 0.95) -> float:
    """Return the part of all lines that lie within the minimax radius, at a confidence.

    With `confidence` at least this part of all lines that are drawn like the given ones, at random
    and independently, misses the minimax point by no more than the radius. Nothing is assumed of
    how the misses are distributed. It does not hold for a grid or a path of poses.

    Parameters
    ----------
    count
        Number of lines, n ≥ 4.
    confidence
        Probability that the statement holds.

    References
    ----------
    Calafiore and Campi, doi:10.1109/TAC.2006.875041; Campi and Garatti, doi:10.1137/07069821X: for
    a convex program in d = 4 unknowns (3) the part that violates the solution is at most ε with
    probability 1 − Σ_{i<d} C(n, i) εⁱ(1 − ε)ⁿ⁻ⁱ.

    Examples
    --------
    >>> [round(content(n), 3) for n in (20, 70, 153, 773)]
    [0.656, 0.893, 0.95, 0.99]
    """
    from scipy.special import betaincinv

    if count < UNKNOWNS:
        return 0.0
    return float(1 - betaincinv(UNKNOWNS, count - UNKNOWNS + 1, confidence))


def solve_minimax(lines: CentredLines) -> MinimaxRcm:
    """Return the minimax RCM of lines that are centred on their least-squares point."""
    optimum = _optimum(lines)
    distances = lines.distances(optimum.point)
    largest = float(distances.max())
    order = np.argsort(optimum.active)
    order = order[optimum.weights[order] > GOOD_GAP]  # others are as far by chance
    return MinimaxRcm(
        point_mm=lines.centre + lines.turn @ optimum.point,
        max_mm=largest,
        rms_mm=float(np.sqrt(distances.dot(distances) / len(distances))),
        certificate_gap=_proved_gap(largest, optimum.least, len(distances)),
        distances_mm=distances,
        active=tuple(optimum.active[order].tolist()),
        weights=optimum.weights[order],
    )


def _proved_gap(largest: float, least: float, count: int) -> float:
    """Return the relative gap between the largest distance and the least possible one."""
    gap = abs(largest - least) / largest if largest > 0 else 0.0
    if not gap <= LARGEST_GAP:
        raise DegenerateGeometryError(
            f"the minimax RCM of {count} lines is only known to {gap:.1e} of its radius, "
            f"{largest:.6g} mm",
            next_step="look for lines that are almost parallel or very far from the others",
        )
    return gap


def _optimum(lines: CentredLines) -> Optimum:
    """Return the optimum in mm, in the frame of the centred lines."""
    from_centre = lines.radii()
    scale = float(from_centre.max())
    count = len(from_centre)
    if scale == 0:  # all lines pass through one point
        return Optimum(np.zeros(3), 0.0, np.arange(count), np.full(count, 1 / count), 0.0)
    if count <= ALL_AT_ONCE:
        return _constraints(lines, scale).optimum().times(scale)
    return _optimum_of_farthest(lines, from_centre, scale)


def _optimum_of_farthest(lines: CentredLines, from_centre: Floats, scale: float) -> Optimum:
    """Solve for the farthest lines, add those that turn out farther, until there are none.

    A line at distance d from the centre is at most d + ‖q‖ from q, so only lines for which that
    exceeds the radius found so far need to be looked at: nothing is lost by this pruning.
    """
    chosen = highest(from_centre)
    while True:
        found = _constraints(lines.subset(chosen), scale).optimum().times(scale, chosen)
        reach = float(np.linalg.norm(found.point)) * (1 + 1e-9)
        near = np.flatnonzero(from_centre + reach >= found.largest)
        distances = lines.subset(near).distances(found.point)
        distances[np.isin(near, chosen)] = 0
        farther = np.flatnonzero(distances > found.largest * (1 + GOOD_GAP))
        if len(farther) == 0:
            return found
        chosen = np.concatenate([chosen, near[farther[highest(distances[farther])]]])


def _constraints(lines: CentredLines, scale: float) -> Constraints:
    """Return the constraints of (3) for lines with lengths in units of `scale`."""
    guard = np.diag(1e-10 / lines.information[2] * lines.information)
    return Constraints(lines.projectors(), lines.offsets / scale, guard)
