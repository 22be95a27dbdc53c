"""Trimmed least squares: the least sum of squares of the nearest three quarters of the lines.

The sum has many local minima. A good one is found by concentration steps; then space is searched
for a better one, box by box, until none can be left or the search has taken enough.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pivometer._arrays import Floats
from pivometer.rcm.least_squares import least_squares_rcm
from pivometer.rcm.lines import FEWEST_LINES, CentredLines, centred_lines
from pivometer.rcm.result import TrimmedRcm
from pivometer.rcm.robust import least_distance_rcm

Indices = NDArray[np.intp]

TRIMMED_PART = 0.25
"""Part of the lines left out by `trimmed_rcm`: as many may be wrong."""

GAP = 1e-9
"""Relative lessening of the sum of squares that is not searched for."""

MOST_WORK = 3_000_000
"""Boxes times lines after which the search ends unproved: 0.5 s."""

MOST_LINES = 1000
"""More lines are not searched: so few boxes would prove nothing."""

AT_ONCE = 100_000
"""Boxes times lines that are examined at once: 10 MB."""

FACE_CELLS = 24
"""Cells along a face of the cube of directions on which the search's first box is found."""

CORNERS = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3, indexing="ij")).reshape(3, 8)
"""The corners of a box, or the centres of the eight it is split into."""


def trimmed_rcm(
    points_mm: ArrayLike, directions: ArrayLike, *, trimmed: float = TRIMMED_PART
) -> TrimmedRcm:
    """Return the least-squares point of the nearest lines only.

    From the point of the least sum of distances the nearest lines are solved for in least squares,
    and chosen anew, until they stay the same. Then all points are searched for a better choice by
    branch and bound: over a box the squared distances are nowhere below their tangents at its
    centre, so the sum of the least of them is at least that at the best corner; and where the box
    is too small for another choice, its own least-squares point is as good as any in it.

    Parameters
    ----------
    points_mm, directions
        A point on each line (mm) and its direction, of any length, shape (n, 3), same frame.
    trimmed
        Part of the lines to leave out, from 0 to under 0.5; three always count.

    Raises
    ------
    ShapeError, TooFewPosesError, DegenerateGeometryError
        As `least_distance_rcm`; also if the lines that count are parallel.

    References
    ----------
    P. Rousseeuw and K. Van Driessen, doi:10.1007/s10463-005-0038-6 (concentration steps).

    Examples
    --------
    >>> points = [[0, 0, 1], [0, 0, -1], [1, 5, 0], [-1, 9, 0], [70, 0, 0]]
    >>> directions = [[1, 0, 0], [2, 0, 0], [0, 1, 0], [0, 1, 0], [0, 1, 1]]
    >>> rcm = trimmed_rcm(points, directions)
    >>> rcm.left_out, round(rcm.rms_mm, 12)
    ((4,), 1.0)
    """
    lines = centred_lines(points_mm, directions)
    count = len(lines.axes)
    kept = max(FEWEST_LINES, int(np.ceil((1 - trimmed) * count)))
    chosen = _concentrated(lines, least_distance_rcm(points_mm, directions).distances_mm, kept)
    least = 0.0
    if kept < count <= MOST_LINES:
        chosen, least = _searched(lines, chosen)
    found = least_squares_rcm(lines.offsets[chosen], lines.axes[chosen])
    squares = found.rms_mm**2 * kept
    proved = kept == count or squares == 0
    return TrimmedRcm(
        point_mm=lines.centre + lines.turn @ found.point_mm,
        rms_mm=found.rms_mm,
        distances_mm=lines.distances(found.point_mm),
        left_out=tuple(np.setdiff1d(np.arange(count), chosen).tolist()),
        certificate_gap=0.0 if proved else max(1 - least / squares, 0.0),
    )


def _concentrated(lines: CentredLines, distances: Floats, kept: int) -> Indices:
    """Return the nearest lines of their own least-squares point; each round lessens the sum."""
    chosen = np.zeros(0, dtype=np.intp)
    while True:
        nearest = np.sort(np.argsort(distances, kind="stable")[:kept])
        if np.array_equal(nearest, chosen):
            return chosen
        point = least_squares_rcm(lines.offsets[nearest], lines.axes[nearest]).point_mm
        after = lines.distances(point)
        if len(chosen) and not (after[nearest] ** 2).sum() < (distances[chosen] ** 2).sum():
            return chosen
        chosen, distances = nearest, after


def _searched(lines: CentredLines, chosen: Indices) -> tuple[Indices, float]:
    """Return the best choice of lines, and what no choice's sum of squares can be less than."""
    best, point = _sum_of_squares(lines, chosen)
    half = _reach(lines.axes[chosen], len(lines.axes), best)
    centres, work = point[None], 0
    while best > 0 and len(centres):
        work += len(centres) * len(lines.axes)
        if not half < np.inf or work > MOST_WORK:
            return chosen, 0.0
        parts = np.array_split(centres, work // AT_ONCE + 1)
        examined = [_examined(lines, part, half, len(chosen)) for part in parts]
        bounds, settled, nearest = map(np.concatenate, zip(*examined, strict=True))
        better = bounds < best * (1 - GAP)
        for choice in np.unique(nearest[settled & better], axis=0):
            value, _ = _sum_of_squares(lines, choice)
            if value < best:
                chosen, best = choice, value
        half /= 2
        split = centres[better & ~settled][:, None] + half * CORNERS.T
        centres = split.reshape(-1, 3)
    return chosen, best * (1 - GAP)


def _examined(
    lines: CentredLines, centres: Floats, half: float, kept: int
) -> tuple[Floats, NDArray[np.bool_], Indices]:
    """Examine cubes, given by their centres, shape (m, 3), and half their side.

    Returns
    -------
    tuple of numpy.ndarray
        What the sum of the `kept` least squares cannot be less than anywhere in each cube; whether
        the nearest lines are the same everywhere in it; and which they are at its centre.
    """
    misses = np.einsum("nij,mj->mni", lines.projectors(), centres) - lines.offsets
    squares = np.vecdot(misses, misses)
    tangents = squares[..., None] + 2 * half * (misses @ CORNERS)
    bounds = np.partition(tangents, kept - 1, axis=1)[:, :kept].sum(axis=1).min(axis=1)
    order = np.argsort(squares, axis=1)
    ends = np.sqrt(np.take_along_axis(squares, order[:, kept - 1 : kept + 1], axis=1))
    settled = ends[:, 1] - ends[:, 0] > 2 * np.sqrt(3) * half
    return bounds, settled, np.sort(order[:, :kept], axis=1)


def _sum_of_squares(lines: CentredLines, chosen: Indices) -> tuple[float, Floats]:
    """Return the least sum of squares of some lines, and where it is."""
    found = least_squares_rcm(lines.offsets[chosen], lines.axes[chosen])
    return float(found.distances_mm @ found.distances_mm), found.point_mm


def _reach(axes: Floats, count: int, squares: float) -> float:
    """Return how far any better choice's point can be from that of the chosen lines' axes.

    Two choices of k of n lines share 2k − n at least. For the shift δ between their points, with
    sums of squares of S at most, Σ ‖Pᵢδ‖² ≤ 4 S over the shared lines, and the left side is at
    least ‖δ‖² times the sum of the least 2k − n of sin² of the angles between δ and the axes. That
    sum is bounded from below over cells of directions.
    """
    shared = 2 * len(axes) - count
    middles = (np.arange(FACE_CELLS) + 0.5) / FACE_CELLS * 2 - 1
    u, v = (grid.ravel() for grid in np.meshgrid(middles, middles))
    faces = [np.roll(np.stack([np.ones_like(u), u, v], axis=1), k, axis=1) for k in range(3)]
    directions = np.concatenate(faces)
    directions /= np.sqrt(np.vecdot(directions, directions))[:, None]
    angles = np.arccos(np.minimum(np.abs(directions @ axes.T), 1))
    least = np.sin(np.maximum(angles - np.sqrt(2) / FACE_CELLS, 0)) ** 2
    bound = float(np.partition(least, shared - 1, axis=1)[:, :shared].sum(axis=1).min())
    return float(np.sqrt(4 * squares / bound)) if bound > 0 else np.inf
