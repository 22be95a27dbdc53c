"""The RCM point of the least sum of distances, which a few wrong lines do not move.

With 3 of 70 lines grossly wrong, the least-squares point is off by ten times as much as the point
of the least sum of distances, and the minimax point, which the wrong lines decide, by much more.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pivometer._arrays import Floats
from pivometer.errors import DegenerateGeometryError
from pivometer.rcm.least_squares import least_squares_rcm
from pivometer.rcm.lines import CentredLines, centred_lines
from pivometer.rcm.result import Finding, LeastDistanceRcm

Indices = NDArray[np.intp]

GOOD_GAP = 1e-14
"""A relative duality gap at the level of rounding, for sums of tens of distances."""

FAIR_GAP = 1e-13
"""What all but problems with outliers a million times farther than the rest reach at once."""

LARGEST_GAP = 1e-10
"""A relative duality gap above this is a failure, as for the minimax point."""

SMOOTHING = tuple(10.0**-k for k in range(1, 9))
"""Parts of the median distance by which the kinks of the distances are rounded off, in turn."""

NEWTON_STEPS = 50
"""For each smoothing; usual problems take 2 to 6."""

FALSE_ALARM = 0.01
"""Probability that any of the lines is called outlying where all errors are Gaussian: with the
allowance 1 + 2/√n for the median, 2 of 200 sessions of 10 lines and none of 600 of 20 to 70."""

FEWEST_FOR_OUTLIERS = 10
"""With 6 lines 3.5 % of sessions gave a false alarm."""


def least_distance_rcm(points_mm: ArrayLike, directions: ArrayLike) -> LeastDistanceRcm:
    """Return the point with the least sum of distances from the lines, with its certificate.

    The sum is convex. For vectors uᵢ across their lines, of length 1 at most, with Σ uᵢ = 0, it is
    nowhere less than −Σ uᵢ·rᵢ, rᵢ being the feet of the perpendiculars; at the optimum it is that.

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
        If the lines are parallel, or the optimum cannot be proved to 1e-10.

    References
    ----------
    Wilson et al., eq. (1) with the 1-norm as its cost.

    Examples
    --------
    >>> points = [[0, 0, 1], [0, 0, -1], [1, 5, 0], [-1, 9, 0]]
    >>> directions = [[1, 0, 0], [2, 0, 0], [0, 1, 0], [0, 1, 0]]
    >>> rcm = least_distance_rcm(points, directions)
    >>> round(rcm.mean_mm, 12), rcm.certificate_gap < 1e-12
    (1.0, True)
    """
    lines = centred_lines(points_mm, directions)
    scale = float(lines.radii().mean())
    if scale == 0:  # all lines pass through one point
        return LeastDistanceRcm(lines.centre, 0.0, 0.0, lines.radii())
    point, gap = _Sum(lines.projectors(), lines.offsets / scale).optimum()
    if gap > FAIR_GAP:  # outliers keep the least-squares centre so far off that rounding shows
        lines = _centred_at(lines, lines.centre + lines.turn @ (point * scale), points_mm)
        point, gap = _Sum(lines.projectors(), lines.offsets / scale).optimum()
    if not gap <= LARGEST_GAP:
        raise DegenerateGeometryError(
            f"the point of the least sum of distances from {len(lines.axes)} lines is only known "
            f"to {gap:.1e} of that sum",
            next_step="look for lines that are almost parallel or very far from the others",
        )
    distances = lines.distances(point * scale)
    return LeastDistanceRcm(
        point_mm=lines.centre + lines.turn @ (point * scale),
        mean_mm=float(distances.mean()),
        certificate_gap=gap,
        distances_mm=distances,
    )


def _centred_at(lines: CentredLines, centre: Floats, points_mm: ArrayLike) -> CentredLines:
    """Return the same lines relative to another point."""
    offsets = (np.asarray(points_mm, dtype=np.float64) - centre) @ lines.turn
    for _ in range(2):
        offsets = offsets - np.vecdot(offsets, lines.axes)[:, None] * lines.axes
    return replace(lines, centre=centre, offsets=offsets)


@dataclass(frozen=True, slots=True, eq=False)
class _Sum:
    """The sum of ‖Pᵢq − rᵢ‖; lengths in units of their mean."""

    projectors: Floats
    offsets: Floats

    def misses(self, point: Floats) -> Floats:
        misses: Floats = self.projectors @ point - self.offsets
        return misses

    def optimum(self) -> tuple[Floats, float]:
        """Return the point and its relative gap.

        Smoothed sums lead near it and show which lines pass through it, where the sum has a kink;
        Newton's method on what those lines leave free makes it exact.
        """
        point, best, least = np.zeros(3), np.zeros(3), np.inf
        for part in SMOOTHING:
            misses = self.misses(point)
            smoothing = part * float(np.sqrt(np.median(np.vecdot(misses, misses))))
            point = self._smoothed(point, smoothing)
            for through in self._passing(point, smoothing):
                found = self._polished(point, through)
                gap = self._gap(found, through)
                if gap < least:
                    best, least = found, gap
            if least <= GOOD_GAP:
                break
        return best, least

    def _smoothed(self, point: Floats, smoothing: float) -> Floats:
        """Minimize Σ √(‖Pᵢq − rᵢ‖² + μ²) from a point by Newton's method with halved steps."""

        def value(at: Floats) -> float:
            misses = self.misses(at)
            return float(np.sqrt(np.vecdot(misses, misses) + smoothing**2).sum())

        now = value(point)
        for _ in range(NEWTON_STEPS):
            misses = self.misses(point)
            lengths = np.sqrt(np.vecdot(misses, misses) + smoothing**2)
            slope, curvature = self._derivatives(misses, lengths)
            step = -np.linalg.lstsq(curvature, slope, rcond=1e-15)[0]
            length, after = 1.0, value(point + step)
            while after > now and length > 1e-9:
                length /= 2
                after = value(point + length * step)
            if not after < now:
                break
            point, gained, now = point + length * step, now - after, after
            if gained <= 1e-15 * now:
                break
        return point

    def _derivatives(self, misses: Floats, lengths: Floats) -> tuple[Floats, Floats]:
        """Return Σ uᵢ and Σ (Pᵢ − uᵢuᵢᵀ)/lᵢ with uᵢ = eᵢ/lᵢ."""
        towards = misses / lengths[:, None]
        weighted = ((1 / lengths) @ self.projectors.reshape(-1, 9)).reshape(3, 3)
        return towards.sum(axis=0), weighted - (towards.T / lengths) @ towards

    def _passing(self, point: Floats, smoothing: float) -> Iterator[Indices]:
        """Yield which lines may pass through the optimum: none, or the nearest ones."""
        misses = self.misses(point)
        distances = np.sqrt(np.vecdot(misses, misses))
        near = np.flatnonzero(distances < 30 * smoothing)
        near = near[np.argsort(distances[near])]
        yield near[:0]
        for count in {1, 2, len(near)} if len(near) else ():
            if count <= len(near):
                yield near[:count]

    def _polished(self, point: Floats, through: Indices) -> Floats:
        """Put the point on the lines that pass through it; minimize the sum of the others there."""
        free = np.eye(3)
        if len(through):
            values, vectors = np.linalg.eigh(self.projectors[through].sum(axis=0))
            held = values > 1e-9 * values[2]
            free = vectors[:, ~held]
            for _ in range(2):
                miss = vectors[:, held].T @ self.misses(point)[through].sum(axis=0)
                point = point - vectors[:, held] @ (miss / values[held])
        others = np.delete(np.arange(len(self.offsets)), through)
        rest = _Sum(self.projectors[others], self.offsets[others])
        for _ in range(8 if free.size and len(others) else 0):
            misses = rest.misses(point)
            lengths = np.sqrt(np.vecdot(misses, misses))
            if not lengths.min() > 0:
                break
            slope, curvature = rest._derivatives(misses, lengths)
            step = free @ np.linalg.lstsq(free.T @ curvature @ free, free.T @ slope, rcond=1e-14)[0]
            if not step @ step < 1:  # a wrong guess of what passes through; its gap will show it
                break
            point = point - step
        return point

    def _gap(self, point: Floats, through: Indices) -> float:
        """Return how far the sum may be above the least possible one, relative to it."""
        misses = self.misses(point)
        distances = np.sqrt(np.vecdot(misses, misses))
        dual = misses / np.maximum(distances, np.finfo(float).tiny)[:, None]
        if len(through):
            dual[through] = 0
            balance = np.linalg.pinv(self.projectors[through].sum(axis=0), rcond=1e-9)
            dual[through] = -self.projectors[through] @ (balance @ dual.sum(axis=0))
        lack = np.linalg.solve(self.projectors.sum(axis=0), dual.sum(axis=0))
        dual = dual - self.projectors @ lack
        dual /= max(1.0, float(np.sqrt(np.vecdot(dual, dual).max())))
        total = float(distances.sum())
        return abs(total + float(np.vecdot(dual, self.offsets).sum())) / total


def outlier_findings(
    names: Sequence[str], points_mm: ArrayLike, directions: ArrayLike
) -> tuple[Finding, ...]:
    """Return a warning that names the lines which miss the RCM by far more than the rest.

    For Gaussian errors the distances from the RCM have a Rayleigh distribution, whose scale the
    median tells whatever a few lines do; a line is outlying if it is farther than the farthest of
    so many lines is in 1 % of cases, with an allowance for the median's own scatter.

    Parameters
    ----------
    names
        What to call each line.
    points_mm, directions
        A point on each line (mm) and its direction, of any length, shape (n, 3), same frame.

    Examples
    --------
    >>> random = np.random.default_rng(0)
    >>> axes, points = random.normal([0, 0, 2], 1, (30, 3)), 0.1 * random.standard_normal((30, 3))
    >>> points[4] = [5, 0, 0]
    >>> names = [f"{i:03d}" for i in range(30)]
    >>> for finding in outlier_findings(names, points, axes):
    ...     print(finding.text)
    1 of 30 poses (004) misses the RCM by far more than the rest, 1.63 mm where chance explains \
0.49 mm at most; it moves the least-squares point by 0.17 mm
    """
    robust = least_distance_rcm(points_mm, directions)
    distances = robust.distances_mm
    count = len(distances)
    if count < FEWEST_FOR_OUTLIERS:
        return ()
    sigma = float(np.median(distances)) / np.sqrt(2 * np.log(2))
    most = float(sigma * np.sqrt(2 * np.log(count / FALSE_ALARM)) * (1 + 2 / np.sqrt(count)))
    outlying = np.flatnonzero(distances > most)
    if len(outlying) == 0 or most == 0:
        return ()
    farthest = outlying[np.argsort(-distances[outlying])]
    shift = least_squares_rcm(points_mm, directions).point_mm - robust.point_mm
    shown = ", ".join(names[i] for i in farthest[:6]) + (", …" if len(farthest) > 6 else "")
    verb, they = ("misses", "it moves") if len(outlying) == 1 else ("miss", "they move")
    return (
        Finding(
            "warning",
            f"{len(outlying)} of {count} poses ({shown}) {verb} the RCM by far more than the rest, "
            f"{distances[farthest[0]]:.2f} mm where chance explains {most:.2f} mm at most; "
            f"{they} the least-squares point by {np.linalg.norm(shift):.2f} mm",
            "look at their pictures: a wrong edge, a robot that was moving, or cameras that saw "
            "different moments; leave such poses out",
        ),
    )
