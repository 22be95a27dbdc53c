"""Whether what stands behind the shaft shows beside an edge, as it must."""

from __future__ import annotations

import numpy as np

from pivometer._arrays import Floats
from pivometer.shaft.fitting.samples import Samples

NEAREST_PX, FARTHEST_PX = 1.5, 3.0
"""Where it must show: blur leaves none of the shaft at 1.5 px, and something else may stand
farther out. Both times the blur where that is over 1 px."""

KNOT_PX = 0.5
SHOWN = 0.5
"""A chunk shows the background if the picture has more than half of its changes."""

LARGEST_SIGMA = 1 / 6
"""... and tells whether it does if half is three standard deviations from both none and all."""

LEAST_CHUNKS = 2


def shown_part(samples: Samples, widen: float, noise: float) -> float:
    """Return in which part of the chunks beside an edge the background shows.

    The grey level at each distance from the edge is free in every chunk, for light and shadow;
    what counts is how much of the background's changes from row to row is in the picture: all of
    them beside the shaft, none on it. An edge that is a lane of the shaft is found out by that.

    Parameters
    ----------
    samples
        The single pixels of one edge, and what stands behind it.
    widen
        What the distances are multiplied by.
    noise
        Standard deviation of a pixel, grey levels.

    Returns
    -------
    float
        NaN if fewer than `LEAST_CHUNKS` chunks can tell.
    """
    x, behind = samples.x_px, samples.behind
    near, far = NEAREST_PX * widen, FARTHEST_PX * widen
    count = samples.count * ((x > near) & (x < far))
    if behind is None or not count.any():
        return float("nan")
    levels = hats(x, np.linspace(near, far, round((far - near) / (KNOT_PX * widen)) + 1))
    both = np.stack([behind.grey, samples.grey], axis=-1)
    left = both - np.swapaxes(levels, -1, -2) @ best_levels(levels, count, both)
    changes = (count * left[..., 0] ** 2).sum(axis=-1)
    tells = changes > (noise / LARGEST_SIGMA) ** 2
    if tells.sum() < LEAST_CHUNKS:
        return float("nan")
    gain = (count * left[..., 0] * left[..., 1]).sum(axis=-1)[tells] / changes[tells]
    return float((gain > SHOWN).mean())


def hats(x_px: Floats, knots_px: Floats) -> Floats:
    """Return 1 at each knot, falling to 0 at the next ones, shape (chunks, knots, p)."""
    hats: Floats = 1 - np.abs(x_px[:, None] - knots_px[:, None]) / (knots_px[1] - knots_px[0])
    return np.maximum(hats, 0.0)


def best_levels(terms: Floats, count: Floats, values: Floats) -> Floats:
    """Return what of each term is nearest to values (chunks, p, n), shape (chunks, terms, n)."""
    weighted = terms * count[:, None]
    gram = weighted @ np.swapaxes(terms, -1, -2) + 1e-9 * np.eye(terms.shape[1])
    return np.asarray(np.linalg.solve(gram, weighted @ values), dtype=np.float64)
