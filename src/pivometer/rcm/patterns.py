"""Whether the misses follow something: how much of them a regression explains, and if by chance.

The misses eᵢ are explained as eᵢ = Pᵢ (p + Σ cₖ xₖᵢ): the point that the lines should pass moves by
the vector cₖ (mm) for each unit of the regressor xₖ. Whether that is more than chance is told by
giving the misses random signs, again and again (a wild bootstrap): their sizes, their planes and
whatever makes some poses worse than others stay as they are, so that neither equal variances nor a
normal distribution are assumed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pivometer._arrays import Floats, checked
from pivometer.rcm.lines import CentredLines

DRAWS = 9999
"""Draws of signs: the least p-value is 1/10000, and one of 0.001 is known to 0.0003."""

SAME_COLUMN = 1e-5
"""Regressors that agree to this part of their length are one: rounding, not data."""

LEAST_RMS_MM = 1e-9
"""Misses below a picometre are rounding, not a robot."""

LEAST_FREE = 0.05
"""A pose that leaves less than this of itself free of the null model says nothing by itself."""

_DRAWS_AT_ONCE = 500


@dataclass(frozen=True, slots=True, eq=False)
class Explanation:
    """What regressors explain of the misses, over what others explain already.

    Parameters
    ----------
    best
        Which of the alternatives explains most.
    share
        Part of the sum of squares of all misses that it explains, beyond what it would by chance.
    rms_mm
        The root mean square over the poses of that part, mm.
    p_value
        Probability that chance alone explains as much in any of the alternatives.
    coefficients_mm
        cₖ of the best alternative, shape (k, 3), mm for each unit of the regressor, in the frame
        of the lines.
    covariance_mm2
        Covariance of its first, shape (3, 3), mm², from the scatter that is left.
    left_mm
        What it leaves of the misses, shape (n, 3), mm, in the lines' principal axes.
    """

    best: int
    share: float
    rms_mm: float
    p_value: float
    coefficients_mm: Floats
    covariance_mm2: Floats
    left_mm: Floats


def explanation(
    lines: CentredLines,
    alternatives: Sequence[ArrayLike],
    *,
    known: ArrayLike | None = None,
    block: int = 1,
) -> Explanation | None:
    """Explain the misses of lines from their least-squares point by regressors.

    Parameters
    ----------
    lines
        The lines.
    alternatives
        Sets of regressors, shape (n, k) each, with the same k; the best one is told.
    known
        Regressors that explain a part beforehand, shape (n, j).
    block
        Number of successive lines that get the same sign: more than one where they are alike.

    Returns
    -------
    Explanation or None
        `None` where the regressors do not vary or take more than two thirds of the degrees of
        freedom, or where there are no misses to explain.

    References
    ----------
    R. Davidson and E. Flachaire, doi:10.1016/j.jeconom.2008.08.003 (signs with equal probability,
    residuals of the null model, HC3).
    """
    count, projectors = len(lines.axes), lines.projectors()
    before = np.ones((count, 1))
    if known is not None:
        before = np.hstack([before, checked(known, (count, None), "known")])
    base = _orthonormal(_columns(projectors, before))
    misses = np.ravel(lines.offsets)
    whole = float(misses @ misses)
    if whole < count * LEAST_RMS_MM**2:
        return None
    rest = misses - base @ (base.T @ misses)
    columns = [_columns(projectors, checked(x, (count, None), "regressors")) for x in alternatives]
    bases = [_orthonormal(matrix, base) for matrix in columns]
    taken = base.shape[1] + max((b.shape[1] for b in bases), default=0)
    if not bases or min(b.shape[1] for b in bases) == 0 or 3 * taken > 4 * count:
        return None
    explained = np.array([np.square(b.T @ rest).sum() for b in bases])
    best = int(np.argmax(explained))
    freedom = 2 * count - base.shape[1] - bases[best].shape[1]
    variance = max(float(rest @ rest - explained[best]), 0.0) / freedom
    beyond = max(float(explained[best]) - variance * bases[best].shape[1], 0.0)
    coefficients, covariance = _coefficients(columns[best], base, rest, variance)
    return Explanation(
        best=best,
        share=beyond / whole,
        rms_mm=float(np.sqrt(beyond / count)),
        p_value=_chance(rest.reshape(-1, 3), base, bases, block),
        coefficients_mm=coefficients @ lines.turn.T,
        covariance_mm2=lines.turn @ covariance @ lines.turn.T,
        left_mm=(rest - bases[best] @ (bases[best].T @ rest)).reshape(-1, 3),
    )


def _columns(projectors: Floats, regressors: Floats) -> Floats:
    """Return Pᵢ xₖᵢ stacked, shape (3 n, 3 k)."""
    stacked = np.einsum("nij,nk->nikj", projectors, regressors)
    return np.ascontiguousarray(stacked.reshape(3 * len(projectors), -1))


def _orthonormal(columns: Floats, base: Floats | None = None) -> Floats:
    """Return an orthonormal basis of columns, apart from what `base` spans."""
    lengths = np.linalg.norm(columns, axis=0)
    scaled = columns[:, lengths > 0] / lengths[lengths > 0]
    if base is not None:
        for _ in range(2):  # the second round removes what rounding leaves of the first
            scaled = scaled - base @ (base.T @ scaled)
    left, sizes, _ = np.linalg.svd(scaled, full_matrices=False)
    basis: Floats = left[:, sizes > SAME_COLUMN]
    return basis


def _coefficients(
    columns: Floats, base: Floats, rest: Floats, variance: float
) -> tuple[Floats, Floats]:
    """Return the coefficients, shape (k, 3), and the covariance of the first three."""
    free = columns - base @ (base.T @ columns)
    inverse = np.linalg.pinv(free, rcond=SAME_COLUMN)
    solved: Floats = (inverse @ rest).reshape(-1, 3)
    return solved, variance * (inverse[:3] @ inverse[:3].T)


def _chance(rest: Floats, base: Floats, bases: Sequence[Floats], block: int) -> float:
    """Return how probable it is that misses of random sign are explained as well."""
    edges = np.cumsum([base.shape[1], *(b.shape[1] for b in bases)])
    every = np.hstack([base, *bases]).reshape(len(rest), 3, -1)
    seen: Floats = np.asarray(np.einsum("nik,ni->k", every, rest), dtype=np.float64)
    least = _best_ratio(seen[None], edges, float(np.square(rest).sum()))[0] * (1 - 1e-9)
    free = _without_leverage(rest, every[:, :, : edges[0]])
    parts: Floats = np.add.reduceat(
        np.einsum("nik,ni->nk", every, free), np.arange(0, len(rest), block), axis=0
    )
    whole = float(np.square(free).sum())
    rng = np.random.default_rng(0)
    reached = 1
    for start in range(0, DRAWS, _DRAWS_AT_ONCE):
        size = min(_DRAWS_AT_ONCE, DRAWS - start), len(parts)
        signs = rng.integers(0, 2, size) * 2.0 - 1.0
        reached += int(
            (_best_ratio(np.asarray(signs @ parts, np.float64), edges, whole) >= least).sum()
        )
    return reached / (DRAWS + 1)


def _without_leverage(rest: Floats, base: Floats) -> Floats:
    """Return (I − Hᵢ)⁻¹ eᵢ with H the projection on the null model: its own pull undone (HC3)."""
    values, vectors = np.linalg.eigh(base @ np.swapaxes(base, 1, 2))
    grown = 1 / np.maximum(1 - values, LEAST_FREE)
    free: Floats = np.einsum("nij,nj,nkj,nk->ni", vectors, grown, vectors, rest)
    return free


def _best_ratio(sums: Floats, edges: NDArray[np.intp], whole: float) -> Floats:
    """Return the largest part that any alternative explains of what the null model leaves."""
    squares = np.square(sums)
    left = np.maximum(whole - squares[:, : edges[0]].sum(axis=1), np.finfo(float).tiny)
    explained = [squares[:, a:b].sum(axis=1) for a, b in pairwise(edges)]
    return np.asarray(np.max(explained, axis=0) / left)
