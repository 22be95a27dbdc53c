"""Where most rows see a grey step near a seed: what the fits start from."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.shaft.band_map import BandMap
from pivometer.shaft.bands import EdgeLine

SEARCH_PX = 4
"""Reach on each side of the seed: twice the 2 px a seed is good to."""

WINDOW_PX = 3.0
"""Grey levels are compared over this far on each side."""

GRID_PX = np.arange(-SEARCH_PX, SEARCH_PX + 0.25, 0.5)
"""Offsets and tilts that are tried."""

SEED_PENALTY_PER_PX2 = 0.04
"""What a square pixel away from the seed costs, as a part of the best score of 1; it keeps a strong
highlight 4 px inside a glossy shaft from winning over a faint edge at the seed."""


def found_lines(
    turned: NDArray[np.generic], maps: tuple[BandMap, BandMap], lines: tuple[EdgeLine, EdgeLine]
) -> tuple[EdgeLine, EdgeLine]:
    """Return the lines moved to where most rows see a grey step, to about half a pixel.

    Parameters
    ----------
    turned
        The image, turned so that the shaft is upright.
    maps
        The rows that are looked at, and where each edge is in them.
    lines
        The seed's edges, undistorted px.
    """
    moves = [_best_move(turned, m, line) for m, line in zip(maps, lines, strict=True)]
    return lines[0].moved(*moves[0]), lines[1].moved(*moves[1])


def _best_move(turned: NDArray[np.generic], m: BandMap, line: EdgeLine) -> tuple[float, float]:
    """Return the (offset, tilt) in px whose line collects most of the rows' grey steps."""
    places = int(np.ceil(SEARCH_PX * m.slant)) + 1
    window = int(np.rint(WINDOW_PX * m.slant))
    j = np.arange(-places - window, places + window)
    base = np.rint(m.centre)
    columns = base.astype(np.intp)[:, None] + m.outward * j
    rows = ((columns >= 0) & (columns < turned.shape[1])).all(axis=1)
    if not rows.any():
        return 0.0, 0.0
    steps = _grey_steps(turned[m.rows[rows, None], columns[rows]], window)
    usual = float(np.median(steps.max(axis=1)))
    votes = steps / (steps + max(usual, 1e-9))  # a strong edge has one vote, not a hundred
    half = line.half_px / (line.half_px @ line.half_px)
    lever = m.coordinate(half, -float(half @ line.middle_px), m.centre[:, None])[rows]
    # Step k is between columns k − 1 and k of those beside the row's own.
    first = (0.5 - m.outward * (base - m.centre))[rows, None] + m.slant * lever * GRID_PX
    index = np.rint(first[..., None] + m.slant * GRID_PX).astype(np.intp) + places
    index = np.clip(index, 0, 2 * places)
    found = votes[np.arange(len(votes))[:, None, None], index].mean(axis=0)
    square = GRID_PX**2
    score = found - SEED_PENALTY_PER_PX2 * (square[:, None] / 3 + square)
    reached = np.abs(GRID_PX)[:, None] + np.abs(GRID_PX) <= SEARCH_PX
    tilt, offset = np.unravel_index(np.argmax(np.where(reached, score, -np.inf)), score.shape)
    return float(GRID_PX[offset]), float(GRID_PX[tilt])


def _grey_steps(grey: NDArray[np.generic], window: int) -> Floats:
    """Return |mean outside − mean inside| at every place between columns with both windows."""
    sums = np.cumsum(grey, axis=1, dtype=np.float64)
    sums = np.concatenate([np.zeros((len(sums), 1)), sums], axis=1)
    box = sums[:, window:] - sums[:, :-window]
    steps: Floats = np.abs(box[:, window:] - box[:, :-window]) / window
    return steps
