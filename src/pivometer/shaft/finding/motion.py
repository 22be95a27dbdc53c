"""What the pairs of edges of a whole sequence agree on: one pivot pixel and one width there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.shaft.finding.pairs import EdgePair
from pivometer.shaft.finding.straight import Passing

MOST_PAIRS = 30
"""Longest pairs of each frame that take part in the vote."""

HYPOTHESES = 3000
LEAST_TURN = 0.02
"""Two middle lines give a pivot only where they cross at more than this angle, rad."""

WIDTH_SPREAD = 0.12
"""Relative spread of a shaft's width half way: 28° towards the camera at 480 mm is ±10 %."""

WIDTH_POWER = 0.5
"""Stripes on a shaft move as it does: of equals the wider pair is the silhouette. A power of 1
prefers a shaft joined with its shadow (drawn scenes found: 16 % instead of 66 %)."""

ELONGATION = 3.0
"""A pair counts fully from this length in widths; a carriage is about as long as wide."""

NEARBY = 0.25
"""Spread of the middle lines about the pivot in widths (an arm with an RCM error of 3 mm rms and a
9 mm shaft has 0.3), to which 2 px are added."""

LEAST_SPREAD = 0.1
WIDTH_SPREADS = (0.02, 0.06)
"""The spreads follow twice the median departure of the agreeing frames, within these limits: the
width at the pivot scatters by 0.1 % (clean) to 1.5 % (dark clutter) over the rendered sets."""

AGREEING = 0.1
"""A pair agrees with a motion if this part of its weight counts: it is off by 2.1 spreads."""

EDGE_NOISE_PX = 0.5
"""How far an end of a pair's edges may be off, which extrapolating to the pivot magnifies; in their
middle it is half."""


@dataclass(frozen=True, slots=True, eq=False)
class PairTable:
    """All pairs in columns, frame after frame.

    `at` gives the frame and `which` the place in that frame's list; `weight` is the length in px,
    lowered for stout pairs and for those that do not hide the background.
    """

    at: NDArray[np.intp]
    which: NDArray[np.intp]
    normal: Floats
    offset: Floats
    middle: Floats
    width: Floats
    taper: Floats
    run: Floats
    length: Floats
    weight: Floats

    def rows(self, keep: NDArray[np.bool_]) -> PairTable:
        """Return the pairs that are to be kept."""
        return PairTable(*(getattr(self, column.name)[keep] for column in fields(self)))

    def best_per_frame(self, values: Floats) -> NDArray[np.intp]:
        """Return the row with the largest value in every frame that has a pair."""
        order = np.lexsort((-values, self.at))
        _, first = np.unique(self.at[order], return_index=True)
        return order[first]


def pair_table(
    pairs: Sequence[Sequence[EdgePair]], cover: Sequence[Floats], most: int | None = None
) -> PairTable:
    """Put the pairs of all frames in columns, at most the `most` weightiest of each frame."""
    rows = []
    for frame, (here, share) in enumerate(zip(pairs, cover, strict=True)):
        stout = [min(1.0, p.run_px / (ELONGATION * p.width_px)) ** 2 for p in here]
        weight = np.array([p.length_px for p in here]) * stout * share
        for k in np.argsort(-weight, kind="stable")[:most]:
            p = here[k]
            numbers = (p.offset_px, *p.middle_px, p.width_px, p.taper, p.run_px, p.length_px)
            rows.append((frame, k, *p.normal, *numbers, weight[k]))
    table = np.array(rows, dtype=np.float64).reshape(-1, 12)
    at, which = table[:, :2].T.astype(np.intp)
    return PairTable(at, which, table[:, 2:4], table[:, 4], table[:, 5:7], *table[:, 7:].T)


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """The pivot (px from the image's centre), the width there, and how far pairs may depart."""

    pivot_px: Floats
    width_px: float
    spread_px: float
    width_spread: float
    length_px: float
    frames: int

    @property
    def passing(self) -> Passing:
        """Where the edges of the shaft pass."""
        reach = 0.8 * self.width_px + 2 * self.spread_px
        return Passing(self.pivot_px, reach, self.width_px)

    def departures(self, table: PairTable) -> tuple[Floats, Floats]:
        """Return how far each pair passes the pivot and how its width differs, in spreads.

        The width at the pivot is extrapolated along the pair's own taper: there, and only there,
        it is the same in all poses, however the shaft leans towards the camera.
        """
        away, width, sigma = at_pivot(table, self.pivot_px, self.width_spread)
        there = (width - self.width_px) / sigma
        half_way = (table.width / self.width_px - 1) / WIDTH_SPREAD
        return away / self.spread_px, np.hypot(there, half_way)

    def agreement(self, table: PairTable) -> Floats:
        """Return each pair's weight times how well it fits the motion."""
        away, width = self.departures(table)
        return table.weight * np.exp(-0.5 * (away**2 + width**2))


def at_pivot(
    table: PairTable, pivot_px: Floats, width_spread: float
) -> tuple[Floats, Floats, Floats]:
    """Return each pair's distance from the pivot, its width there and that width's spread, px."""
    along = np.column_stack([-table.normal[:, 1], table.normal[:, 0]])
    distance = np.einsum("ij,ij->i", table.middle - pivot_px, along)
    width = table.width - table.taper * distance
    lever = np.hypot(0.5, distance / table.run)
    sigma = np.hypot(width_spread * table.width, EDGE_NOISE_PX * lever)
    return table.normal @ pivot_px - table.offset, width, sigma


def common_motion(table: PairTable) -> Motion | None:
    """Return the motion most of the frames' pairs agree on; None where no two lines cross."""
    start = _hypothesis(table)
    if start is None:
        return None
    motion = start
    for _ in range(6):
        motion = _refined(table, motion)
    return motion


def hinted_motion(table: PairTable, pivot_px: Floats, width_px: float | None) -> Motion | None:
    """Return the motion about a pivot that is roughly known; None where no pair passes it."""
    if len(table.at) == 0:
        return None
    widths = table.width if width_px is None else np.array([width_px])
    scores = _support(table, np.tile(pivot_px, (len(widths), 1)), widths)
    width = float(widths[np.argmax(scores * widths**WIDTH_POWER)])
    start = Motion(pivot_px, width, NEARBY * width + 2, WIDTH_SPREAD, 0.0, 0)
    fits = start.agreement(table)
    top = table.best_per_frame(fits)
    agreeing = int((fits[top] > AGREEING * table.weight[top]).sum())
    if agreeing < 3:
        return replace(start, frames=agreeing) if agreeing else None
    motion = start
    for _ in range(6):
        motion = _refined(table, motion)
    strayed = float(np.hypot(*(motion.pivot_px - pivot_px))) > 2 * start.spread_px
    return replace(start, frames=agreeing) if strayed else motion


def _hypothesis(table: PairTable) -> Motion | None:
    """Take pairs from two frames at a time and keep the crossing that most frames support."""
    if len(table.at) == 0:
        return None
    i, j = np.random.default_rng(0).integers(len(table.at), size=(2, 10 * HYPOTHESES))
    turn = table.normal[i, 0] * table.normal[j, 1] - table.normal[i, 1] * table.normal[j, 0]
    alike = np.abs(np.log(table.width[i] / table.width[j])) < 0.2
    usable = (table.at[i] != table.at[j]) & (np.abs(turn) > LEAST_TURN) & alike
    i, j, turn = (values[usable][:HYPOTHESES] for values in (i, j, turn))
    if len(i) == 0:
        return None
    x = table.offset[i] * table.normal[j, 1] - table.offset[j] * table.normal[i, 1]
    y = table.offset[j] * table.normal[i, 0] - table.offset[i] * table.normal[j, 0]
    pivots = np.column_stack([x, y]) / turn[:, None]
    widths = (table.width[i] + table.width[j]) / 2
    scores = np.concatenate(
        [_support(table, pivots[k : k + 300], widths[k : k + 300]) for k in range(0, len(i), 300)]
    )
    best = int(np.argmax(scores * widths**WIDTH_POWER))
    width = float(widths[best])
    return Motion(pivots[best], width, NEARBY * width + 2, WIDTH_SPREAD, 0.0, 0)


def _support(table: PairTable, pivots: Floats, widths: Floats) -> Floats:
    """Sum over the frames the best pair's agreement with each pivot and width."""
    away = (pivots @ table.normal.T - table.offset) / (NEARBY * widths + 2)[:, None]
    width = (table.width / widths[:, None] - 1) / WIDTH_SPREAD
    fits = table.weight * np.exp(-0.5 * (away**2 + width**2))
    first = np.flatnonzero(np.diff(table.at, prepend=-1))
    scores: Floats = np.maximum.reduceat(fits, first, axis=1).sum(axis=1)
    return scores


def _refined(table: PairTable, motion: Motion) -> Motion:
    """Fit pivot and width to each frame's best pair, and how far those spread."""
    fits = motion.agreement(table)
    top = table.best_per_frame(fits)
    weight = np.sqrt(fits[top] + 1e-12)
    sides = table.normal[top] * weight[:, None], table.offset[top] * weight
    pivot = np.linalg.lstsq(*sides)[0].astype(np.float64)
    away, width, sigma = (v[top] for v in at_pivot(table, pivot, motion.width_spread))
    mean = max(float(np.average(width, weights=fits[top] / sigma**2 + 1e-12)), 1.0)
    agreeing = fits[top] > AGREEING * table.weight[top]
    if agreeing.sum() < 3:
        return Motion(pivot, mean, motion.spread_px, motion.width_spread, 0.0, int(agreeing.sum()))
    least, most = 2 + LEAST_SPREAD * mean, 2 + NEARBY * mean
    return Motion(
        pivot,
        mean,
        float(np.clip(2 * np.median(np.abs(away[agreeing])), least, most)),
        float(np.clip(2 * np.median(np.abs(width[agreeing] / mean - 1)), *WIDTH_SPREADS)),
        float(np.median(table.length[top][agreeing])),
        int(agreeing.sum()),
    )
