"""Pairs of straight lines among edge pixels that could be a shaft's two edges."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.shaft.finding.straight import BIN_PX, LEAST_SUPPORT_PX, EdgeLine, Passing

LEAST_DENSITY = 0.15
"""Each edge shows in this part of the window; both together in half of two. Chosen."""

MOST_TILT = 0.12
"""Largest angle (rad) between a shaft's two edges; a 10 mm shaft pointing at a camera 480 mm away
at 45° tapers by less."""

LEAST_WIDTH_PX = 3.0
MOST_WIDTH_FRACTION = 0.45


@dataclass(frozen=True, slots=True, eq=False)
class EdgePair:
    """Two edge lines that run side by side from `start_px` to `stop_px` along the first's u.

    The middle line is n·x = offset_px; `middle_px` is its point half way, `width_px` the distance
    of the edges there and `taper` the change of that distance a pixel along u; `length_px` is the
    harmonic mean of the two edges' supports.
    """

    lines: tuple[EdgeLine, EdgeLine]
    start_px: float
    stop_px: float
    length_px: float
    edges_px: Floats
    normal: Floats
    offset_px: float
    middle_px: Floats
    width_px: float
    taper: float

    @property
    def run_px(self) -> float:
        """How far the two edges run side by side."""
        return self.stop_px - self.start_px


@dataclass(frozen=True, slots=True, eq=False)
class _Pairs:
    """Nearly parallel lines with their normals the same way, the smaller offset first, in columns.

    `line` gives the numbers of both lines and `turned` whether each is taken with the opposite
    normal, shape (pairs, 2); `normals` is (pairs, 2, 2) and `offsets` (pairs, 2).
    """

    line: NDArray[np.intp]
    turned: NDArray[np.intp]
    normals: Floats
    offsets: Floats

    def rows(self, keep: NDArray[Any]) -> _Pairs:
        """Return some of the pairs."""
        return _Pairs(self.line[keep], self.turned[keep], self.normals[keep], self.offsets[keep])

    def along(self, values: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return values (lines, bins) along the first and the second lines, the same way."""
        both = np.stack([values, values[:, ::-1]])
        return both[self.turned[:, 0], self.line[:, 0]], both[self.turned[:, 1], self.line[:, 1]]


@dataclass(frozen=True, slots=True, eq=False)
class _Runs:
    """Where the two lines of each pair are edges: from start to stop, and the mean support, px."""

    start: Floats
    stop: Floats
    length: Floats


def edge_pairs(
    lines: list[EdgeLine], size_px: tuple[int, int], passing: Passing | None = None
) -> list[EdgePair]:
    """Return all pairs of lines that run side by side at a shaft's distance."""
    if len(lines) < 2:
        return []
    pairs = _parallel(lines)
    if passing is not None:
        pairs = pairs.rows(passing.both(pairs.normals, pairs.offsets))
    pairs, runs = _common_runs(pairs, lines)
    if len(pairs.line) == 0:
        return []
    ends = np.column_stack([runs.start, runs.stop])
    along = pairs.normals[:, :, None, ::-1] * [-1, 1] * ends[:, None, :, None]
    edges = pairs.offsets[..., None, None] * pairs.normals[:, :, None] + along
    size = np.hypot(*pairs.normals.sum(axis=1).T)
    normal, offset = pairs.normals.sum(axis=1) / size[:, None], pairs.offsets.sum(axis=1) / size
    apart = ((edges[:, 1] - edges[:, 0]) * normal[:, None]).sum(axis=-1)
    run, width, middle = runs.stop - runs.start, apart.mean(axis=1), edges.mean(axis=(1, 2))
    taper = (apart[:, 1] - apart[:, 0]) / run
    most = np.minimum(MOST_WIDTH_FRACTION * min(size_px), run)
    good = (width - np.abs(taper) * run / 2 > LEAST_WIDTH_PX) & (width < most)
    numbers = np.column_stack([ends, runs.length, offset, width, taper]).tolist()
    found = []
    for k in np.flatnonzero(good):
        start, stop, length, away, wide, tapering = numbers[k]
        both = _taken(lines, pairs.line[k], pairs.turned[k])
        found.append(
            EdgePair(
                both, start, stop, length, edges[k], normal[k], away, middle[k], wide, tapering
            )
        )
    return found


def _parallel(lines: list[EdgeLine]) -> _Pairs:
    """Return all pairs of nearly parallel lines."""
    one, other = np.triu_indices(len(lines), 1)
    normals = np.array([line.normal for line in lines])
    offsets = np.array([line.offset_px for line in lines])
    here, there = normals[one], normals[other]
    parallel = np.abs(here[:, 0] * there[:, 1] - here[:, 1] * there[:, 0]) < MOST_TILT
    one, other, here, there = (values[parallel] for values in (one, other, here, there))
    turned = (here * there).sum(axis=1) <= 0
    facing = np.where(turned, -1.0, 1.0)
    line, turns = np.stack([one, other], axis=1), np.stack([np.zeros_like(turned), turned], axis=1)
    both = np.stack([here, there * facing[:, None]], axis=1)
    away = np.stack([offsets[one], offsets[other] * facing], axis=1)
    order = np.where((away[:, 0] < away[:, 1])[:, None], [0, 1], [1, 0])
    row = np.arange(len(one))[:, None]
    return _Pairs(
        line[row, order], turns[row, order].astype(np.intp), both[row, order], away[row, order]
    )


def _taken(
    lines: list[EdgeLine], numbers: NDArray[np.intp], turned: NDArray[np.intp]
) -> tuple[EdgeLine, EdgeLine]:
    """Return two lines, each with the opposite normal where it is turned."""
    one, other = (
        lines[i].reversed() if turn else lines[i] for i, turn in zip(numbers, turned, strict=True)
    )
    return one, other


def _common_runs(pairs: _Pairs, lines: list[EdgeLine]) -> tuple[_Pairs, _Runs]:
    """Return the pairs of which both lines are edges somewhere, side by side, and where."""
    first, second = pairs.along(np.array([line.density for line in lines]))
    dense = (first >= LEAST_DENSITY) & (second >= LEAST_DENSITY) & (first + second >= 0.5)
    enough = np.count_nonzero(dense, axis=1) * BIN_PX >= LEAST_SUPPORT_PX
    pairs, dense = pairs.rows(enough), dense[enough]
    first, second = pairs.along(np.array([line.occupied for line in lines]))
    row, begin, end = _runs(dense)
    here, there = (
        sums[row, end] - sums[row, begin] for sums in (_counted(first), _counted(second))
    )
    order = np.lexsort((-np.minimum(here, there), row))
    best = order[np.searchsorted(row[order], np.arange(len(dense)))]
    best = best[np.minimum(here, there)[best] * BIN_PX >= LEAST_SUPPORT_PX]
    row, begin, end, here, there = (values[best] for values in (row, begin, end, here, there))
    place = np.arange(dense.shape[1])
    filled = (first | second)[row] & (place >= begin[:, None]) & (place < end[:, None])
    start = filled.argmax(axis=1)
    stop = filled.shape[1] - filled[:, ::-1].argmax(axis=1)
    zero = filled.shape[1] / 2
    length = 2 * here * there / (here + there) * BIN_PX
    return pairs.rows(row), _Runs((start - zero) * BIN_PX, (stop - zero) * BIN_PX, length)


def _runs(
    dense: NDArray[np.bool_],
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp]]:
    """Return row, begin and end of all runs, row by row."""
    closed = np.zeros((len(dense), dense.shape[1] + 2), dtype=np.int8)
    closed[:, 1:-1] = dense
    row, place = np.nonzero(closed[:, 1:] != closed[:, :-1])
    return row[::2], place[::2], place[1::2]


def _counted(occupied: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return how many places before each are occupied."""
    sums = np.zeros((len(occupied), occupied.shape[1] + 1), dtype=np.intp)
    np.cumsum(occupied, axis=1, out=sums[:, 1:])
    return sums
