"""Straight lines among edge pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.shaft.finding.background import MovingEdges

ANGLE_BINS = 360
SPREAD_BINS = 3
"""An edge pixel votes for normals within ±3° of its gradient's. Chosen, not measured."""

MOST_TURN_COSINE = 0.955
"""An edge pixel belongs to a line if its gradient is within 17° of the normal."""

BANDS = ((3.0, False), (2.6, False), (2.2, True))
"""Half-width of the band (px) that a line is fitted in and whether pixels of either polarity
count, round by round. First only pixels of one polarity: of neighbouring lines, a silhouette and
its highlight, every other one has the opposite polarity. Last both, because the polarity of a
silhouette changes with what lies behind. The last band holds the bow of a distorted line (sagitta
up to 4.2 px over the whole image, edges.md)."""

FOCUS_PX = 1.2
"""The fit's weights fall off over this distance, so that a highlight's edge 3 px away does not
drag the line."""

TIGHT_PX = 1.0
"""Edge pixels of a true edge, thinned to whole pixels, lie closer than this to the bowed line;
those of a chance line through texture fill the whole band."""

BIN_PX = 4.0
WINDOW_BINS = 12
"""A gap of up to half of this window (24 px) does not end an edge."""

_HELD_BOW = np.diag([0.0, 0.0, 3.0])

MOST_LINES = 40
MOST_PASSING = 160
"""Lines that are fitted, the longest first. Of those that pass a known pivot more than any drawn
scene has (20 to 140): lanes of brushed metal are as long as the shaft's edges and many."""

LEAST_SUPPORT_PX = 32.0

SAME_LINE_PX = 2.0
SAME_LINE_RAD = 0.03
"""Lines that differ by less, at the middle and in direction, are the same edge."""


@dataclass(frozen=True, slots=True, eq=False)
class EdgeLine:
    """A straight line n·x = offset among edge pixels, in pixels from the image's centre.

    `occupied` says for every 4 px along u = (−n_y, n_x) whether an edge pixel lies there, and
    `density` in which part of the window around it.
    """

    normal: Floats
    offset_px: float
    occupied: NDArray[np.bool_]
    density: Floats

    def reversed(self) -> EdgeLine:
        """Return the same line with the opposite normal."""
        return EdgeLine(-self.normal, -self.offset_px, self.occupied[::-1], self.density[::-1])


@dataclass(frozen=True, slots=True, eq=False)
class Passing:
    """Only lines that pass a point, px from the centre, and pairs about as wide there."""

    point_px: Floats
    reach_px: float
    width_px: float

    def both(self, normals: Floats, offsets: Floats) -> NDArray[np.bool_]:
        """Tell which pairs of lines can be the shaft's edges; far wider than any gate.

        Parameters
        ----------
        normals, offsets
            Of both lines, with normals the same way, shapes (..., 2, 2) and (..., 2).
        """
        sides = offsets - normals @ self.point_px
        apart = np.abs(sides[..., 1] - sides[..., 0])
        near = np.abs(sides.sum(axis=-1)) / 2 < self.reach_px
        wide = (0.5 * self.width_px - 4 < apart) & (apart < 1.6 * self.width_px + 4)
        return np.asarray(near & wide)


def edge_lines(
    edges: MovingEdges, centre_px: Floats, passing: Passing | None = None
) -> list[EdgeLine]:
    """Return the straight lines among the edge pixels, strongest first, none twice."""
    points, directions = edges.points_px - centre_px, edges.directions
    if passing is not None:
        arm = points - passing.point_px
        across = np.abs(np.einsum("ij,ij->i", arm, directions))
        near = across < passing.reach_px + 0.12 * np.hypot(*arm.T)
        points, directions = points[near], directions[near]
    if len(points) < LEAST_SUPPORT_PX:
        return []
    reach = float(np.hypot(*centre_px)) + 2
    normals, offsets = _peaks(points, directions, reach, passing)
    fitted = _fitted(points, directions, normals, offsets, reach)
    found = [(k, line) for k, line in enumerate(fitted) if line is not None]
    if not found:
        return []
    which, lines = [k for k, _ in found], [line for _, line in found]
    own = _stacked(lines)
    twice = _near(own, own) | _near((normals[which], offsets[which]), own)
    kept = np.zeros(len(lines), dtype=bool)
    for place, like in enumerate(twice):
        kept[place] = not (like & kept).any()
    return [line for line, one in zip(lines, kept, strict=True) if one]


def _peaks(
    points: Floats, directions: Floats, reach: float, passing: Passing | None
) -> tuple[Floats, Floats]:
    """Return normals and offsets of the local maxima of the votes, strongest first."""
    step = 2 * np.pi / ANGLE_BINS
    angles = np.arctan2(directions[:, 1], directions[:, 0])
    bins = np.floor(angles[:, None] / step).astype(np.intp)
    bins = (bins + np.arange(-SPREAD_BINS, SPREAD_BINS + 1)) % ANGLE_BINS
    theta = (np.arange(ANGLE_BINS) + 0.5) * step
    normals = np.column_stack([np.cos(theta), np.sin(theta)])
    origin, span = np.zeros(2), reach
    if passing is not None:
        origin, span = passing.point_px, min(passing.reach_px, reach)
    arm = points - origin
    offset = arm[:, :1] * normals[bins, 0] + arm[:, 1:] * normals[bins, 1]
    width = int(2 * span) + 1
    flat = bins * width + np.floor(offset + span).astype(np.intp)
    if passing is not None:
        flat = flat[np.abs(offset) < span]
    votes = np.bincount(flat.ravel(), minlength=ANGLE_BINS * width).astype(np.uint16)
    votes = votes.reshape(ANGLE_BINS, width)
    padded = np.concatenate([votes[-2:], votes, votes[:2]])
    padded = cv2.boxFilter(padded, -1, (3, 1), normalize=False)
    top = cv2.dilate(padded, np.ones((5, 3)))[2:-2].ravel()
    smooth = padded[2:-2].ravel()
    found = np.flatnonzero(smooth >= 0.6 * LEAST_SUPPORT_PX)
    found = found[smooth[found] == top[found]]
    order = np.argsort(-smooth[found].astype(np.intp), kind="stable")
    order = order[: MOST_LINES if passing is None else MOST_PASSING]
    turn, place = np.divmod(found[order], width)
    return normals[turn], normals[turn] @ origin + place + 0.5 - span


@dataclass(frozen=True, slots=True, eq=False)
class _Around:
    """The edge pixels around several lines, the pixels of one after those of another.

    What a line costs is the calls, not its few hundred pixels; so all lines share them.
    """

    line: NDArray[np.intp]
    first: NDArray[np.intp]
    points: Floats
    directions: Floats

    @classmethod
    def lines(cls, close: NDArray[np.bool_], points: Floats, directions: Floats) -> _Around:
        """Return the pixels (n, 2) that are close to lines, some to each; shape (lines, n)."""
        count = np.count_nonzero(close, axis=1)
        line = np.repeat(np.arange(len(close)), count)
        pixel = np.flatnonzero(close) - line * close.shape[1]
        first = np.cumsum(count) - count
        return cls(line, first, points.T.take(pixel, axis=1), directions.T.take(pixel, axis=1))

    def only(self, kept: NDArray[np.bool_]) -> tuple[_Around, NDArray[np.intp]]:
        """Return some of the pixels, of those lines that have any, and which lines these are."""
        line = self.line[kept]
        first = np.flatnonzero(np.diff(line, prepend=-1))
        number = np.repeat(np.arange(len(first)), np.diff(first, append=len(line)))
        around = _Around(number, first, self.points[:, kept], self.directions[:, kept])
        return around, line[first]

    def dot(self, normals: Floats, vectors: Floats) -> Floats:
        """Return the products of each line's normal with vectors (..., 2, n) at its pixels."""
        n = normals.T.take(self.line, axis=1)
        return np.asarray(n[0] * vectors[..., 0, :] + n[1] * vectors[..., 1, :])

    def sums(self, values: Floats) -> Floats:
        """Return the sums of values (..., n) over each line's pixels, shape (..., lines)."""
        return np.asarray(np.add.reduceat(values, self.first, axis=-1))


def _fitted(
    points: Floats, directions: Floats, normals: Floats, offsets: Floats, reach: float
) -> Sequence[EdgeLine | None]:
    """Fit lines to the edge pixels (n, 2) around each peak; None where too few remain."""
    lines: list[EdgeLine | None] = [None] * len(normals)
    close = np.abs(normals @ points.T - offsets[:, None]) < 3 * BANDS[0][0]
    which = np.flatnonzero(close.any(axis=1))
    if len(which) == 0:
        return lines
    around = _Around.lines(close[which], points, directions)
    normals, offsets, near = _in_bands(around, normals[which], offsets[which])
    if not near.any():
        return lines
    around, kept = around.only(near)
    normals, offsets = normals[kept], offsets[kept]
    occupied = _occupied(around, normals, offsets, reach)
    density = _density(occupied)
    for k in np.flatnonzero(np.count_nonzero(occupied, axis=1) * BIN_PX >= LEAST_SUPPORT_PX):
        lines[which[kept[k]]] = EdgeLine(normals[k], float(offsets[k]), occupied[k], density[k])
    return lines


def _in_bands(
    around: _Around, normals: Floats, offsets: Floats
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Return lines fitted in one band after another, and their pixels in the last one."""
    enough, (x, y) = np.ones(len(normals), dtype=bool), around.points
    both = np.stack([around.directions, around.points])
    for band, either in BANDS:
        facing, away = around.dot(normals, both)
        away = away - offsets.take(around.line)
        near = (np.abs(away) < band) & ((np.abs(facing) if either else facing) > MOST_TURN_COSINE)
        enough &= around.sums(near.astype(np.float64)) >= 0.5 * LEAST_SUPPORT_PX
        weights = np.exp(away * away * (-0.5 / FOCUS_PX**2)) * near
        wx, wy = weights * x, weights * y
        total, *means = around.sums(np.stack([weights, wx, wy, wx * x, wx * y, wy * y]))
        mean_x, mean_y, xx, xy, yy = np.stack(means) / np.maximum(total, 1e-9)
        xx, xy, yy = xx - mean_x * mean_x, xy - mean_x * mean_y, yy - mean_y * mean_y
        across = np.arctan2(2 * xy, xx - yy) / 2 + np.pi / 2  # of the smaller principal axis
        found = np.column_stack([np.cos(across), np.sin(across)])
        normals = np.where((found * normals).sum(axis=1)[:, None] > 0, found, -found)
        offsets = normals[:, 0] * mean_x + normals[:, 1] * mean_y
    return normals, offsets, near & enough[around.line]


def _occupied(around: _Around, normals: Floats, offsets: Floats, reach: float) -> NDArray[np.bool_]:
    """Tell where along each line pixels lie on it, shape (lines, bins)."""
    along = around.dot(np.column_stack([-normals[:, 1], normals[:, 0]]), around.points)
    across = around.dot(normals, around.points) - offsets[around.line]
    tight = np.abs(_bow_residual(around, along, across)) < TIGHT_PX
    half = int(reach / BIN_PX) + 1
    occupied = np.zeros((len(normals), 2 * half), dtype=bool)
    place = np.floor(along[tight] / BIN_PX).astype(np.intp) + half
    occupied[around.line[tight], place] = True
    return occupied


def _density(occupied: NDArray[np.bool_]) -> Floats:
    """Return which part of the window around each place is occupied."""
    before = WINDOW_BINS // 2
    padded = np.pad(occupied, ((0, 0), (before + 1, before)))
    sums = np.cumsum(padded, axis=1, dtype=np.intp)
    width = WINDOW_BINS + 1
    return np.asarray((sums[:, width:] - sums[:, :-width]) / width)


def _bow_residual(around: _Around, along: Floats, across: Floats) -> Floats:
    """Subtract the bow that lens distortion gives a long straight edge."""
    line = around.line
    low, high = (f.reduceat(along, around.first) for f in (np.minimum, np.maximum))
    middle, half = (low + high) / 2, np.maximum((high - low) / 2, 1.0)
    x = (along - middle[line]) / half[line]
    x2 = x * x
    powers = np.stack([np.ones_like(x), x, x2, x2 * x, x2 * x2])
    rest = across
    for _ in range(3):
        weighted = np.exp(rest * rest * (-0.5 / FOCUS_PX**2)) * powers
        moments, right = around.sums(weighted).T, around.sums(weighted[:3] * across).T
        gram = moments[:, np.add.outer(np.arange(3), np.arange(3))] + _HELD_BOW
        level, slope, bow = np.linalg.solve(gram, right[..., None])[..., 0].T
        rest = across - level[line] - x * slope[line] - x2 * bow[line]
    return rest


def other_lines(lines: Sequence[EdgeLine], known: Sequence[EdgeLine]) -> list[EdgeLine]:
    """Return the lines that are none of those known."""
    if not lines or not known:
        return list(lines)
    same = np.asarray(_near(_stacked(lines), _stacked(known)).any(axis=1))
    return [line for line, one in zip(lines, same, strict=True) if not one]


def _stacked(lines: Sequence[EdgeLine]) -> tuple[Floats, Floats]:
    """Return the lines' normals (n, 2) and offsets (n,)."""
    return np.stack([line.normal for line in lines]), np.array([line.offset_px for line in lines])


def _near(ones: tuple[Floats, Floats], others: tuple[Floats, Floats]) -> NDArray[np.bool_]:
    """Tell which lines are the same edge, shape (n, m)."""
    (a, b), (c, d) = ones, others
    facing = np.where(a @ c.T > 0, 1.0, -1.0)
    turn = a[:, :1] * c[:, 1] - a[:, 1:] * c[:, 0]
    away = b[:, None] - facing * d
    return np.asarray((np.abs(turn) < SAME_LINE_RAD) & (np.abs(away) < SAME_LINE_PX))
