"""Uncertainty of a fit to a recording, whose successive misses are alike: its blocks tell it."""

import numpy as np

from pivometer._arrays import Floats

FEWEST_BLOCKS = 8
"""Blocks are never so long that the recording has fewer: their scatter would say nothing."""

ALIKE = 0.3
"""Lag-1 autocorrelation from which a recording is said to be worth fewer poses: (1 + ρ)/(1 − ρ) is
then 1.9, and a standard error that ignores it 27 % too small."""


def lag_one(misses: Floats) -> float:
    """Return the autocorrelation of successive misses, shape (n, d), at most 0.999."""
    total = float(np.vecdot(misses, misses).sum())
    if total == 0:
        return 0.0
    return min(float(np.vecdot(misses[1:], misses[:-1]).sum()) / total, 0.999)


def worth(alike: float) -> float:
    """Return how many independent poses tell as much as one whose neighbours are alike."""
    return (1 - max(alike, 0.0)) / (1 + max(alike, 0.0))


def block_covariance(rows: Floats, misses: Floats) -> Floats:
    """Return the covariance of fitted unknowns from the scatter of blocks of the recording.

    This is what solving recordings drawn from all blocks of one length gives, to first order, in
    closed form: N⁻¹ (Σ sₖsₖᵀ / L) N⁻¹ with sₖ the sum of Aᵢᵀeᵢ over block k. A block is as long as
    the misses stay alike, (1 + ρ)/(1 − ρ) poses. It holds 57 % of the variance, or less where the
    recording is too short for such blocks; the rest, which goes from block to block, is added as
    for a first-order autoregression.

    Parameters
    ----------
    rows
        The Aᵢ, shape (n, d, k): how the misses depend on the k unknowns.
    misses
        The eᵢ that the fit leaves, shape (n, d), in the order of time.

    References
    ----------
    H. Künsch, doi:10.1214/aos/1176347265.
    """
    count, width, size = rows.shape
    alike = max(lag_one(misses), 0.0)
    part = worth(alike)
    length = int(np.clip(np.ceil(1 / part), 1, count // FEWEST_BLOCKS))
    held = 1 - 2 * alike * (1 - alike**length) / ((1 - alike**2) * length)
    scores = np.einsum("nij,ni->nj", rows, misses)
    running = np.cumsum(np.concatenate([np.zeros((1, size)), scores, scores[:length]]), axis=0)
    blocks = running[length : length + count] - running[:count]
    inverse = np.linalg.inv((np.swapaxes(rows, 1, 2) @ rows).sum(axis=0))
    # The fit has taken k of the misses' n d degrees of freedom, n as many as are independent.
    freedom = max(width * count * part, 1.5 * size)
    factor = freedom / (freedom - size) / (length * held)
    covariance: Floats = factor * inverse @ (blocks.T @ blocks) @ inverse
    return covariance


def halves_apart(rows: Floats, misses: Floats) -> Floats:
    """Return the unknowns of the second half of a recording minus those of the first, shape (k,).

    Parameters
    ----------
    rows, misses
        As in `block_covariance`.
    """
    half, size = len(rows) // 2, rows.shape[2]
    first, second = (
        np.linalg.lstsq(rows[part].reshape(-1, size), misses[part].reshape(-1))[0]
        for part in (slice(half), slice(half, None))
    )
    apart: Floats = second - first
    return apart
