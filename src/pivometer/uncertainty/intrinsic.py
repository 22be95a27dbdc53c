"""The robot's own error, apart from the instrument's: what the misses would be without noise.

An instrument that adds noise to every line makes a good robot look worse: with 0.025 mm of noise a
robot of 0.0126 mm rms reads 0.028 mm. The noise is known, so it can be taken off, with an interval
that says how far.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats, checked, read_only
from pivometer.errors import ShapeError
from pivometer.rcm.lines import CentredLines, centred_lines
from pivometer.rcm.minimax import content, solve_minimax
from pivometer.rcm.result import MinimaxRcm
from pivometer.uncertainty.coverage import COVERAGE, coverage_factor
from pivometer.uncertainty.line_errors import Noise

CONFIDENCE = 0.95
"""Confidence with which `IntrinsicError.content` is stated."""


@dataclass(frozen=True, slots=True, eq=False)
class IntrinsicError:
    """What is left of the RCM error when the instrument's part is taken off.

    Parameters
    ----------
    rms_mm
        Estimate of the robot's own rms miss over these poses, at its own least-squares point, mm;
        zero where the instrument's noise explains all that was seen.
    rms_interval_mm
        Interval that holds it with probability `coverage`, shape (2,), mm, whether or not the
        noise that is only possible is there. Both ends are zero where the misses are smaller than
        the stated noise makes plausible: the noise is then overstated.
    max_interval_mm
        Interval that holds the robot's own largest miss over these poses, at its own minimax
        point, with at least that probability, shape (2,), mm, on the same terms.
    instrument_rms_mm
        Rms miss that the instrument alone would show with a perfect robot, mm.
    coverage
        Coverage probability of both intervals.
    content
        Fraction of all poses drawn like these that the observed largest miss is not exceeded in,
        at least. It needs no distribution, but poses drawn at random, not on a grid.
    confidence
        Confidence of that statement.
    max_u_mm
        Standard uncertainty of the observed largest miss, mm, to first order: what the poses that
        decide it are uncertain by, with the noise that is only possible; `None` in files of
        versions that did not state it.
    """

    rms_mm: float
    rms_interval_mm: Floats
    max_interval_mm: Floats
    instrument_rms_mm: float
    coverage: float
    content: float
    confidence: float
    max_u_mm: float | None = None

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
    possible: Sequence[Noise] = (),
    coverage: float = COVERAGE,
) -> IntrinsicError:
    """Return the robot's own RCM error with intervals.

    With T the stacked Pᵢ, R = I − T N⁻¹ Tᵀ and S the covariance of all lines, the sum of squares is
    that of the robot's own misses θ² plus on average tr(RS), and varies by 2 tr((RS)²) + 4 mᵀSm, m
    the misses. A χ² distribution of this mean and variance is inverted for θ².

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
    possible
        Noise as it may be instead, where a part of it rests on a judgement: the intervals hold
        with each, the estimate rests on the first two arguments.
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
    F. E. Satterthwaite, doi:10.2307/3002019; P. B. Patnaik, doi:10.1093/biomet/36.1-2.202 (χ² of
    the same mean and variance, without and with misses of the robot's own).

    Examples
    --------
    >>> points = [[0, 0, 1], [0, 0, -1], [0.5, 5, 0], [-0.5, 9, 0]]
    >>> directions = [[1, 0, 0], [2, 0, 0], [0, 1, 0], [0, 1, 0]]
    >>> found = intrinsic_error(points, directions, [0.1**2 * np.eye(3)] * 4)
    >>> round(found.rms_mm, 3), found.rms_interval_mm.round(3), found.max_interval_mm.round(3)
    (0.783, array([0.684, 0.881]), array([0.681, 1.139]))
    """
    lines = centred_lines(points_mm, directions)
    count = len(lines.axes)
    stated = _turned(lines, covariances_mm2, common_mm)
    trace = _traces(lines, stated)[0]
    if not trace > 0:
        raise ShapeError(
            "no line has an uncertainty, so the instrument's part is not known",
            next_step="pass the covariance of every line",
        )
    noises = [stated, *(_turned(lines, one.alone_mm2, one.common_mm) for one in possible)]
    squares = float(lines.radii() @ lines.radii())
    rms = np.array([_rms_interval(lines, noise, squares, coverage) for noise in noises])
    found = solve_minimax(lines)
    deviations = np.array([_max_u(lines, found, noise) for noise in noises])
    below = max(_largest_displacement(noise, (1 - coverage) / 2) for noise in noises)
    above = coverage_factor(np.inf, coverage=coverage) * deviations.max()
    return IntrinsicError(
        rms_mm=float(np.sqrt(max(squares - trace, 0.0) / count)),
        rms_interval_mm=np.array([rms[:, 0].min(), rms[:, 1].max()]),
        max_interval_mm=np.array([max(found.max_mm - below, 0.0), found.max_mm + above]),
        instrument_rms_mm=float(np.sqrt(trace / count)),
        coverage=coverage,
        content=content(count, confidence=CONFIDENCE),
        confidence=CONFIDENCE,
        max_u_mm=float(deviations.max()),
    )


@dataclass(frozen=True, slots=True, eq=False)
class NoiseEffect:
    """What one noise does to the misses.

    Parameters
    ----------
    squares_mm2
        The sum of squared misses that it alone shows on average, tr(RS), mm².
    max_u_mm
        The standard uncertainty of the largest miss from it, mm, to first order.
    """

    squares_mm2: float
    max_u_mm: float


def noise_effects(
    points_mm: ArrayLike, directions: ArrayLike, noises: Sequence[Noise]
) -> tuple[NoiseEffect, ...]:
    """Return what each of several noises does to the misses of the same lines.

    Parameters
    ----------
    points_mm, directions
        As in `intrinsic_error`.
    noises
        Each by itself.
    """
    lines = centred_lines(points_mm, directions)
    found = solve_minimax(lines)
    turned = [_turned(lines, noise.alone_mm2, noise.common_mm) for noise in noises]
    return tuple(NoiseEffect(_traces(lines, one)[0], _max_u(lines, found, one)) for one in turned)


def _turned(lines: CentredLines, covariances_mm2: ArrayLike, common_mm: ArrayLike | None) -> Noise:
    """Return PᵢSᵢPᵢ and the common sources without their common shift, in the lines' axes."""
    count = len(lines.axes)
    alone = checked(covariances_mm2, (count, 3, 3), "covariances_mm2")
    shared = np.zeros((count, 3, 0)) if common_mm is None else common_mm
    common = checked(shared, (count, 3, None), "common_mm")
    projectors = lines.projectors()
    across = projectors @ lines.turn.T
    moved = across @ common
    shift = moved.sum(axis=0) / lines.information[:, None]
    return Noise(across @ alone @ np.swapaxes(across, 1, 2), moved - projectors @ shift)


def _traces(lines: CentredLines, noise: Noise) -> tuple[float, float]:
    """Return tr(RS) and tr((RS)²), in time and memory proportional to the number of lines.

    RS is D + U Vᵀ with D block-diagonal and U, V of few columns.
    """
    alone, common, inverse = noise.alone_mm2, noise.common_mm, 1 / lines.information
    trace = np.trace(alone, axis1=1, axis2=2).sum() + np.square(common).sum()
    trace -= inverse @ alone.sum(axis=0).diagonal()
    left = np.concatenate([common, -lines.projectors() * inverse], axis=2)
    right = np.concatenate([common, alone], axis=2)
    cross = np.einsum("nik,nil->kl", right, left)
    squared = np.square(alone).sum() + 2 * np.einsum("nik,nij,njk->", right, alone, left)
    return float(trace), float(squared + np.trace(cross @ cross))


def _rms_interval(
    lines: CentredLines, noise: Noise, squares: float, coverage: float
) -> tuple[float, float]:
    """Return the ends of the interval of the robot's own rms miss, mm."""
    trace, trace_of_square = _traces(lines, noise)
    misses = lines.offsets
    along = np.einsum("ni,nir->r", misses, noise.common_mm)
    seen = np.einsum("ni,nij,nj->", misses, noise.alone_mm2, misses) + along @ along
    each = float(seen) / squares if squares > 0 else trace_of_square / trace
    low, high = (
        np.sqrt(_own_squares(squares, trace, trace_of_square, each, p) / len(lines.axes))
        for p in ((1 + coverage) / 2, (1 - coverage) / 2)
    )
    return float(low), float(high)


def _own_squares(
    squares: float, trace: float, trace_of_square: float, each: float, probability: float
) -> float:
    """Return the θ² with P(sum of squares ≤ `squares`) = probability; zero where none is so small.

    The sum has mean tr(RS) + θ² and variance 2 tr((RS)²) + 4 h θ², with h = `each` the noise's
    variance along the misses; a χ² distribution of the same mean and variance stands for it.
    """
    from scipy.special import gammainc

    def chance(own: float) -> float:
        mean, variance = trace + own, 2 * trace_of_square + 4 * each * own
        return float(gammainc(mean**2 / variance, squares * mean / variance))

    if chance(0.0) <= probability:
        return 0.0
    low, high = 0.0, squares
    while chance(high) > probability:
        low, high = high, 2 * high
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if chance(middle) > probability else (low, middle)
    return high


def _max_u(lines: CentredLines, found: MinimaxRcm, noise: Noise) -> float:
    """Return the standard uncertainty of the minimax radius, mm, by its tangent."""
    if found.max_mm == 0:
        return 0.0
    active = list(found.active)
    point = lines.turn.T @ (found.point_mm - lines.centre)
    misses = lines.offsets[active] - lines.projectors()[active] @ point
    gradient = found.weights[:, None] * misses / found.max_mm
    own = np.einsum("ni,nij,nj->", gradient, noise.alone_mm2[active], gradient)
    shared = np.einsum("ni,nir->r", gradient, noise.common_mm[active])
    return float(np.sqrt(own + shared @ shared))


def _largest_displacement(noise: Noise, probability: float) -> float:
    """Return what no line is displaced by more than, except with the given probability, mm.

    A displacement across a line has two components, so P(‖δᵢ‖ > c) ≤ exp(−c²/2λᵢ) with λᵢ the
    larger variance; the probabilities of all lines are added.
    """
    whole = noise.alone_mm2 + noise.common_mm @ np.swapaxes(noise.common_mm, 1, 2)
    variances = np.linalg.eigvalsh(whole)[:, 2]
    largest = float(variances.max())
    low, high = 0.0, float(np.sqrt(2 * largest * np.log(len(variances) / probability)))
    relative = np.maximum(variances / largest, np.finfo(float).tiny)
    for _ in range(60):
        middle = (low + high) / 2
        exceeded = np.exp(-(middle**2) / (2 * largest * relative)).sum()
        low, high = (middle, high) if exceeded > probability else (low, middle)
    return high
