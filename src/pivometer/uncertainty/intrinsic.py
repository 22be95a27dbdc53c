"""The robot's own error, apart from the instrument's: what the misses would be without noise.

An instrument that adds noise to every line makes a good robot look worse: with 0.025 mm of noise a
robot of 0.0126 mm rms reads 0.028 mm. The noise is known, so it can be taken off, with an interval
that says how far.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats, checked, read_only
from pivometer.errors import ShapeError
from pivometer.rcm.lines import CentredLines, centred_lines
from pivometer.rcm.minimax import content, solve_minimax
from pivometer.uncertainty.coverage import COVERAGE, coverage_factor

CONFIDENCE = 0.95
"""Confidence with which `IntrinsicError.content` is stated."""

NORMAL_BEYOND = 1e6
"""Non-centrality from which the noncentral χ² distribution is taken as normal: its quantiles then
differ by less than 1e-3 of the interval's width, and its series needs 1e4 terms."""


@dataclass(frozen=True, slots=True, eq=False)
class IntrinsicError:
    """What is left of the RCM error when the instrument's part is taken off.

    Parameters
    ----------
    rms_mm
        Estimate of the robot's own rms miss over these poses, at its own least-squares point, mm;
        zero where the instrument's noise explains all that was seen.
    rms_interval_mm
        Interval that holds it with probability `coverage`, shape (2,), mm. Both ends are zero where
        the misses are smaller than the stated noise makes plausible: the noise is then overstated.
    max_interval_mm
        Interval that holds the robot's own largest miss over these poses, at its own minimax
        point, with at least that probability, shape (2,), mm.
    instrument_rms_mm
        Rms miss that the instrument alone would show with a perfect robot, mm.
    coverage
        Coverage probability of both intervals.
    content
        Fraction of all poses drawn like these that the observed largest miss is not exceeded in,
        at least. It needs no distribution, but poses drawn at random, not on a grid.
    confidence
        Confidence of that statement.
    """

    rms_mm: float
    rms_interval_mm: Floats
    max_interval_mm: Floats
    instrument_rms_mm: float
    coverage: float
    content: float
    confidence: float

    def __post_init__(self) -> None:
        for name in ("rms_interval_mm", "max_interval_mm"):
            object.__setattr__(self, name, read_only(checked(getattr(self, name), (2,), name)))

    @property
    def noise_overstated(self) -> bool:
        """Whether even the noise alone would have shown more than was seen."""
        return float(self.rms_interval_mm[1]) == 0.0


def intrinsic_error(
    points_mm: ArrayLike,
    directions: ArrayLike,
    covariances_mm2: ArrayLike,
    *,
    common_mm: ArrayLike | None = None,
    coverage: float = COVERAGE,
) -> IntrinsicError:
    """Return the robot's own RCM error with intervals.

    With T the stacked Pᵢ, R = I − T N⁻¹ Tᵀ and S the covariance of all lines, the sum of squares is
    that of the robot's own misses plus on average tr(RS). Its distribution is g times a noncentral
    χ² on ν degrees of freedom, g = tr((RS)²)/tr(RS) and ν = tr(RS)²/tr((RS)²).

    The largest miss is a convex function of the lines' displacements, so its tangent bounds the
    robot's own from above; and it changes by no more than the largest displacement of any line,
    which bounds it from below.

    Parameters
    ----------
    points_mm, directions
        A point on each line (mm) and its direction, of any length, shape (n, 3), same frame.
    covariances_mm2
        Covariance of each line's position near the RCM, shape (n, 3, 3), mm², independent of the
        others'.
    common_mm
        Displacements of each line near the RCM by one standard uncertainty of each of r independent
        sources that all lines share, such as the calibration, shape (n, 3, r), mm.
    coverage
        Coverage probability of the intervals.

    Raises
    ------
    ShapeError
        If an array has the wrong shape, or no line has an uncertainty.
    TooFewPosesError, DegenerateGeometryError
        If the lines do not determine a point.

    References
    ----------
    F. E. Satterthwaite, doi:10.2307/3002019 (g and ν).

    Examples
    --------
    >>> points = [[0, 0, 1], [0, 0, -1], [0.5, 5, 0], [-0.5, 9, 0]]
    >>> directions = [[1, 0, 0], [2, 0, 0], [0, 1, 0], [0, 1, 0]]
    >>> found = intrinsic_error(points, directions, [0.1**2 * np.eye(3)] * 4)
    >>> round(found.rms_mm, 3), found.rms_interval_mm.round(3), found.max_interval_mm.round(3)
    (0.783, array([0.686, 0.883]), array([0.681, 1.139]))
    """
    lines = centred_lines(points_mm, directions)
    count = len(lines.axes)
    alone, common = _turned(lines, covariances_mm2, common_mm)
    trace, trace_of_square = _traces(lines, alone, common)
    if not trace > 0:
        raise ShapeError(
            "no line has an uncertainty, so the instrument's part is not known",
            next_step="pass the covariance of every line",
        )
    squares = float(lines.radii() @ lines.radii())
    g, freedom = trace_of_square / trace, trace**2 / trace_of_square
    tail = (1 - coverage) / 2
    ends = [_noncentrality(squares / g, freedom, p) * g / count for p in (1 - tail, tail)]
    return IntrinsicError(
        rms_mm=float(np.sqrt(max(squares - trace, 0.0) / count)),
        rms_interval_mm=np.sqrt(ends),
        max_interval_mm=_max_interval(lines, alone, common, coverage),
        instrument_rms_mm=float(np.sqrt(trace / count)),
        coverage=coverage,
        content=content(count, confidence=CONFIDENCE),
        confidence=CONFIDENCE,
    )


def _turned(
    lines: CentredLines, covariances_mm2: ArrayLike, common_mm: ArrayLike | None
) -> tuple[Floats, Floats]:
    """Return PᵢSᵢPᵢ, (n, 3, 3), and the common sources without their common shift, (n, 3, r)."""
    count = len(lines.axes)
    alone = checked(covariances_mm2, (count, 3, 3), "covariances_mm2")
    shared = np.zeros((count, 3, 0)) if common_mm is None else common_mm
    common = checked(shared, (count, 3, None), "common_mm")
    projectors = lines.projectors()
    across = projectors @ lines.turn.T
    moved = across @ common
    shift = moved.sum(axis=0) / lines.information[:, None]
    return across @ alone @ np.swapaxes(across, 1, 2), moved - projectors @ shift


def _traces(lines: CentredLines, alone: Floats, common: Floats) -> tuple[float, float]:
    """Return tr(RS) and tr((RS)²), in time and memory proportional to the number of lines.

    RS is D + U Vᵀ with D block-diagonal and U, V of few columns.
    """
    inverse = 1 / lines.information
    trace = np.trace(alone, axis1=1, axis2=2).sum() + np.square(common).sum()
    trace -= inverse @ alone.sum(axis=0).diagonal()
    left = np.concatenate([common, -lines.projectors() * inverse], axis=2)
    right = np.concatenate([common, alone], axis=2)
    cross = np.einsum("nik,nil->kl", right, left)
    squared = np.square(alone).sum() + 2 * np.einsum("nik,nij,njk->", right, alone, left)
    return float(trace), float(squared + np.trace(cross @ cross))


def _noncentrality(value: float, freedom: float, probability: float) -> float:
    """Return λ with P(χ²_ν(λ) ≤ value) = probability; zero where none is small enough."""
    from scipy.special import chndtr, chndtrinc, ndtri

    if value - freedom > NORMAL_BEYOND:
        z = float(ndtri(probability))
        # value = ν + λ + z √(2ν + 4λ), solved for the root
        root = -z + np.sqrt(z**2 + value - freedom / 2)
        return float(max(root**2 - freedom / 2, 0.0))
    if chndtr(value, freedom, 0.0) <= probability:
        return 0.0
    return float(chndtrinc(value, freedom, probability))


def _max_interval(lines: CentredLines, alone: Floats, common: Floats, coverage: float) -> Floats:
    """Return bounds of the noiseless minimax radius, mm."""
    found = solve_minimax(lines)
    tail = (1 - coverage) / 2
    active = list(found.active)
    gradient = np.zeros((len(active), 3))
    if found.max_mm > 0:
        point = lines.turn.T @ (found.point_mm - lines.centre)
        misses = lines.offsets[active] - lines.projectors()[active] @ point
        gradient = found.weights[:, None] * misses / found.max_mm
    own = np.einsum("ni,nij,nj->", gradient, alone[active], gradient)
    shared = np.einsum("ni,nir->r", gradient, common[active])
    above = coverage_factor(np.inf, coverage=coverage) * np.sqrt(own + shared @ shared)
    whole = alone + common @ np.swapaxes(common, 1, 2)
    variances: Floats = np.linalg.eigvalsh(whole)[:, 2].astype(np.float64)
    below = _largest_displacement(variances, tail)
    return np.array([max(found.max_mm - below, 0.0), found.max_mm + above])


def _largest_displacement(variances_mm2: Floats, probability: float) -> float:
    """Return what no line is displaced by more than, except with the given probability, mm.

    A displacement across a line has two components, so P(‖δᵢ‖ > c) ≤ exp(−c²/2λᵢ) with λᵢ the
    larger variance; the probabilities of all lines are added.
    """
    largest = float(variances_mm2.max())
    low, high = 0.0, float(np.sqrt(2 * largest * np.log(len(variances_mm2) / probability)))
    relative = np.maximum(variances_mm2 / largest, np.finfo(float).tiny)
    for _ in range(60):
        middle = (low + high) / 2
        exceeded = np.exp(-(middle**2) / (2 * largest * relative)).sum()
        low, high = (middle, high) if exceeded > probability else (low, middle)
    return high
