"""Where a known background begins beside a shaft, when what was taken for its edges is not.

Before clutter of its own brightness a shaft's edge is a faint step, and a lane of brushed metal or
a highlight beside it a clear one, from which the search and the fits start. The difference from the
background knows no lanes: beside the shaft it is noise, on the shaft it is more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.shaft.fitting.band_map import BandMap, picked
from pivometer.shaft.fitting.lines import EdgeLine, Lines, width_px
from pivometer.shaft.fitting.view import ShaftView

INWARD_PART, OUTWARD_PART, SPARE_PX = 0.25, 0.35, 4.0
"""Reach of the search in widths, and beyond that: lanes lie up to a third of the shaft inside."""

CHUNK_ROWS = 8
CHANGED_TIMES = 2.5
"""Eight pixels have changed if their mean square is 2.5 times the noise's, as 1 in 100 has by
chance. They vote from −1, where it is the noise's, to 1: no clear step outvotes other rows."""

WINDOW_PX = 3
"""Votes count so far on both sides of a line, so that another rod beside some rows gains little."""

FOOT_PART = 0.25
"""Blur carries a clear step outward, so the vote is repeated with a limit of a quarter of the grey
levels inside. With a half lanes are found again, and some fifty fewer of the edges below."""

OUTWARD_PX = 0.4
"""How far out the foot of an edge lies at usual blur."""

TILTS_PX = np.arange(-5.0, 5.5)
TILT_PENALTY_PER_PX2 = 0.02
NEAR_PX, NEAR_TILTS_PX = np.arange(-4.0, 4.25, 0.5), np.arange(-3.0, 3.25, 0.5)

LEAST_CLEAR = 0.25
"""Mean vote inside, and against it outside, of a line that counts."""

LEAST_MOVE_PX = 1.5
"""A fit finds closer lines by itself. In 16 drawn sessions, mostly of brushed metal, 1912 of 2218
edges started within that of the truth, and moved ones 2111; 16 had started better than moved."""


def uncovered_lines(view: ShaftView, background: Floats) -> Lines | None:
    """Return lines moved to where the background begins, good to 1 px; None if none need be.

    Parameters
    ----------
    view
        The image, and what was taken for the shaft's edges.
    background
        What stands behind the shaft, turned likewise; NaN where unknown.
    """
    noise = _noise(view.pixels, background)
    if not np.isfinite(noise):
        return None
    lines, width = view.lines, width_px(view.lines)
    moves = [
        _move(_Beside.of(view.pixels, background, m, line, width, noise))
        for m, line in zip(view.maps, lines, strict=True)
    ]
    if moves == [None, None]:
        return None
    one, other = (
        line if move is None else line.moved(*move) for line, move in zip(lines, moves, strict=True)
    )
    return one, other


def _noise(pixels: NDArray[np.generic], background: Floats) -> float:
    """Return the noise of the difference from the background, NaN where nothing is known."""
    away = pixels[::5, ::3].astype(np.float64) - background[::5, ::3]
    known = np.abs(away[np.isfinite(away)])
    return max(1.4826 * float(np.median(known)), 0.5) if len(known) else float("nan")


@dataclass(frozen=True, slots=True, eq=False)
class _Beside:
    """The difference from the background beside one line, in chunks of rows.

    `square` is the mean square over the noise's, NaN where unknown, shape (chunks, columns), whose
    first column is `inward` from the line's; `lever` tells by how many columns a tilt of 1 px moves
    the line in each chunk, and `columns_per_px` how many an undistorted pixel has.
    """

    square: Floats
    inward: int
    lever: Floats
    columns_per_px: float

    @classmethod
    def of(
        cls,
        pixels: NDArray[np.generic],
        background: Floats,
        m: BandMap,
        line: EdgeLine,
        width: float,
        noise: float,
    ) -> _Beside:
        inward, outward = (
            round((part * width + SPARE_PX) * m.slant) for part in (INWARD_PART, OUTWARD_PART)
        )
        columns = m.columns(np.arange(-inward, outward + 1))
        within = np.clip(columns, 0, pixels.shape[1] - 1)
        seen, behind = (picked(of, m.rows, within) for of in (pixels, background))
        away = seen.astype(np.float64) - behind.astype(np.float64)
        known = np.isfinite(away) & (columns == within)
        first = np.arange(0, len(m.rows), CHUNK_ROWS)
        count = np.add.reduceat(known.astype(np.float64), first, axis=0)
        total = np.add.reduceat(np.where(known, away / noise, 0.0) ** 2, first, axis=0)
        square = np.where(2 * count < CHUNK_ROWS, np.nan, total / np.maximum(count, 1))
        half = line.half_px / (line.half_px @ line.half_px)
        lever = m.coordinate(half, -float(half @ line.middle_px), m.centre[:, None])[:, 0]
        lever = np.add.reduceat(lever, first) / np.diff(first, append=len(lever))
        return cls(square, inward, m.slant * lever, m.slant * float(np.median(m.scale)))

    def votes(self, limit: float | Floats) -> Floats:
        """Return 1 where clearly more has changed than a limit, to −1 where nothing has."""
        return np.nan_to_num(np.clip((self.square - limit) / (limit - 1), -1.0, 1.0))

    def place(self, offset: Floats | float, tilt: Floats | float) -> NDArray[np.intp]:
        """Return the first column outside of a line in each chunk, shape (..., chunks)."""
        at = np.rint(np.add(offset, np.multiply(tilt, self.lever)) + self.inward + 0.5)
        return np.clip(at, 0, self.square.shape[1]).astype(np.intp)

    def sides(self, votes: Floats) -> tuple[Floats, Floats]:
        """Return the mean votes inside and outside of a line before every column, or after all."""
        sums = np.pad(np.cumsum(votes, axis=1), ((0, 0), (1 + WINDOW_PX, WINDOW_PX)), mode="edge")
        sums[:, : 1 + WINDOW_PX] = 0.0
        step = (sums[:, WINDOW_PX:] - sums[:, :-WINDOW_PX]) / WINDOW_PX
        return step[:, :-WINDOW_PX], step[:, WINDOW_PX:]

    def best(self, votes: Floats, offsets: Floats, tilts: Floats) -> tuple[float, float]:
        """Return the offset and tilt, columns and px, of the line that most votes are for."""
        inside, outside = self.sides(votes)
        at = self.place(offsets[:, None, None], tilts[:, None])
        score = (inside - outside)[np.arange(len(votes)), at].mean(axis=-1)
        score -= TILT_PENALTY_PER_PX2 * tilts**2
        offset, tilt = np.unravel_index(np.argmax(score), score.shape)
        return float(offsets[offset]), float(tilts[tilt])


def _move(beside: _Beside) -> tuple[float, float] | None:
    """Return the offset and tilt, px, to where the background begins; None if near or unclear."""
    votes = beside.votes(CHANGED_TIMES)
    everywhere = np.arange(votes.shape[1] + 1) - beside.inward - 0.5
    offset, tilt = beside.best(votes, everywhere, TILTS_PX)
    at = beside.place(offset, tilt)[:, None] + np.arange(-1 - WINDOW_PX, -1)
    within = np.clip(at, 0, votes.shape[1] - 1)
    excess = np.nan_to_num(beside.square[np.arange(len(votes))[:, None], within] - 1)
    level = np.median(np.sqrt(np.maximum(excess, 0.0)), axis=1)
    foot = np.maximum(CHANGED_TIMES, 1 + (FOOT_PART * level) ** 2)
    votes = beside.votes(foot[:, None])
    offset, tilt = beside.best(votes, offset + NEAR_PX, tilt + NEAR_TILTS_PX)
    chunk, at = np.arange(len(votes)), beside.place(offset, tilt)
    inside, outside = (side[chunk, at].mean() for side in beside.sides(votes))
    moved = (offset - OUTWARD_PX) / beside.columns_per_px
    if min(inside, -outside) < LEAST_CLEAR or abs(moved) + abs(tilt) < LEAST_MOVE_PX:
        return None
    return moved, tilt
