"""Where most rows see a grey step near a seed: what the fits start from."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.shaft.fitting.band_map import BandMap, picked
from pivometer.shaft.fitting.lines import EdgeLine, Lines
from pivometer.shaft.fitting.view import ShaftView

SEARCH_PX = 4
"""Reach on each side of the seed: twice the 2 px a seed is good to."""

WINDOW_PX = 3.0
"""Grey levels are compared over this far on each side."""

OFFSETS_PX = np.arange(-SEARCH_PX, SEARCH_PX + 0.25, 0.5)
TILTS_PX = np.arange(-SEARCH_PX, SEARCH_PX + 0.5, 1.0)
"""What is tried: a tilt of half a pixel at the ends is a quarter in the mean."""

SEED_PENALTY_PER_PX2 = 0.04
"""What a square pixel away from the seed costs, as a part of the best score of 1; it keeps a strong
highlight 4 px inside a glossy shaft from winning over a faint edge at the seed."""


def found_lines(view: ShaftView) -> Lines:
    """Return the view's lines moved to where most rows see a grey step, to about half a pixel.

    Parameters
    ----------
    view
        The image, the rows that are looked at, and the seed's edges.
    """
    one, other = (
        line.moved(*_best_move(view.pixels, m, line))
        for m, line in zip(view.maps, view.lines, strict=True)
    )
    return one, other


def _best_move(pixels: NDArray[np.generic], m: BandMap, line: EdgeLine) -> tuple[float, float]:
    """Return the (offset, tilt) in px whose line collects most of the rows' grey steps."""
    places = int(np.ceil(SEARCH_PX * m.slant)) + 1
    window = int(np.rint(WINDOW_PX * m.slant))
    j = np.arange(-places - window, places + window)
    base = np.rint(m.centre)
    columns = base.astype(np.intp)[:, None] + m.outward * j
    rows = ((columns >= 0) & (columns < pixels.shape[1])).all(axis=1)
    if not rows.any():
        return 0.0, 0.0
    steps = _grey_steps(picked(pixels, m.rows[rows], columns[rows]), window)
    usual = float(np.median(steps.max(axis=1)))
    votes = steps / (steps + max(usual, 1e-9))  # a strong edge has one vote, not a hundred
    half = line.half_px / (line.half_px @ line.half_px)
    lever = m.coordinate(half, -float(half @ line.middle_px), m.centre[:, None])[rows]
    # Step k is between columns k − 1 and k of those beside the row's own.
    first = (0.5 + places - m.outward * (base - m.centre))[rows, None] + m.slant * lever * TILTS_PX
    index = (first[..., None] + (m.slant * OFFSETS_PX + 0.5)).astype(np.intp)  # rounded
    index = np.minimum(np.maximum(index, 0), 2 * places)
    index += (np.arange(len(votes)) * votes.shape[1])[:, None, None]
    found = votes.reshape(-1).take(index).mean(axis=0)
    square = TILTS_PX[:, None] ** 2 / 3 + OFFSETS_PX**2
    reached = np.abs(TILTS_PX)[:, None] + np.abs(OFFSETS_PX) <= SEARCH_PX
    score = np.where(reached, found - SEED_PENALTY_PER_PX2 * square, -np.inf)
    tilt, offset = np.unravel_index(np.argmax(score), score.shape)
    return float(OFFSETS_PX[offset]), float(TILTS_PX[tilt])


def _grey_steps(grey: NDArray[np.generic], window: int) -> Floats:
    """Return |mean outside − mean inside| at every place between columns with both windows."""
    sums = np.cumsum(grey, axis=1, dtype=np.float64)
    sums = np.concatenate([np.zeros((len(sums), 1)), sums], axis=1)
    box = sums[:, window:] - sums[:, :-window]
    steps: Floats = np.abs(box[:, window:] - box[:, :-window]) / window
    return steps
