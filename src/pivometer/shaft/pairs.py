"""Straight lines among edge pixels, and pairs of them that could be a shaft's two edges."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.shaft.background import MovingEdges

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

LEAST_DENSITY = 0.15
"""Each edge shows in this part of the window; both together in half of two. Chosen."""

_HELD_BOW = np.diag([0.0, 0.0, 3.0])
_WINDOW = np.full(WINDOW_BINS + 1, 1 / (WINDOW_BINS + 1))

MOST_LINES = 40
MOST_PASSING = 16
"""Lines that are fitted of those that pass a known pivot; the shaft's are among the longest."""

LEAST_SUPPORT_PX = 32.0
MOST_TILT = 0.12
"""Largest angle (rad) between a shaft's two edges; a 10 mm shaft pointing at a camera 480 mm away
at 45° tapers by less."""

LEAST_WIDTH_PX = 3.0
MOST_WIDTH_FRACTION = 0.45


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

    @classmethod
    def through(cls, normal: Floats, offset_px: float, occupied: NDArray[np.bool_]) -> EdgeLine:
        """Return a line with its density."""
        density = np.convolve(occupied, _WINDOW, mode="same")
        return cls(normal, offset_px, occupied, density)

    def reversed(self) -> EdgeLine:
        """Return the same line with the opposite normal."""
        return EdgeLine(-self.normal, -self.offset_px, self.occupied[::-1], self.density[::-1])


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


def edge_pair(
    lines: tuple[EdgeLine, EdgeLine], start_px: float, stop_px: float, length_px: float
) -> EdgePair:
    """Return a pair with all that follows from its two lines and its ends."""
    one, other = lines
    normals = np.stack([one.normal, other.normal])
    offsets = np.array([one.offset_px, other.offset_px])
    along = normals[:, None, ::-1] * [-1, 1] * np.array([start_px, stop_px])[:, None]
    edges = offsets[:, None, None] * normals[:, None] + along
    size = float(np.hypot(*normals.sum(axis=0)))
    normal = normals.sum(axis=0) / size
    low, high = (edges[1] - edges[0]) @ normal
    return EdgePair(
        lines,
        start_px,
        stop_px,
        length_px,
        edges,
        normal,
        float(offsets.sum() / size),
        edges.mean(axis=(0, 1)),
        float(low + high) / 2,
        float(high - low) / (stop_px - start_px),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Passing:
    """Only lines that pass a point, px from the centre, and pairs about as wide there."""

    point_px: Floats
    reach_px: float
    width_px: float

    def both(self, one: EdgeLine, other: EdgeLine) -> bool:
        """Tell whether two lines, normals the same way, can be a pair; far wider than any gate."""
        sides = [line.offset_px - line.normal @ self.point_px for line in (one, other)]
        apart = abs(sides[1] - sides[0])
        near = abs(sides[0] + sides[1]) / 2 < self.reach_px
        return bool(near and 0.5 * self.width_px - 4 < apart < 1.6 * self.width_px + 4)


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
    lines: list[EdgeLine] = []
    places = np.stack([*points.T, np.ones(len(points))])
    facing = np.ascontiguousarray(directions.T)
    for normal, offset in _peaks(points, directions, reach, passing):
        if any(_is_near(line, normal, offset) for line in lines):
            continue
        line = _fitted(places, facing, normal, offset, reach)
        if line is not None and not any(same_line(line, other) for other in lines):
            lines.append(line)
    return lines


def _peaks(
    points: Floats, directions: Floats, reach: float, passing: Passing | None
) -> list[tuple[Floats, float]]:
    """Return (normal, offset) of the local maxima of the votes, strongest first."""
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
    peaks = np.divmod(found[order], width)
    return [
        (normals[i], float(normals[i] @ origin) + j + 0.5 - span)
        for i, j in zip(*peaks, strict=True)
    ]


def _fitted(
    places: Floats, directions: Floats, normal: Floats, offset: float, reach: float
) -> EdgeLine | None:
    """Fit a line to the edge pixels (x, y, 1) around a peak; None where too few remain."""
    close = np.flatnonzero(np.abs(normal @ places[:2] - offset) < 3 * BANDS[0][0])
    places, directions = places.take(close, axis=1), directions.take(close, axis=1)
    for band, either in BANDS:
        facing = normal @ directions
        aligned = (np.abs(facing) if either else facing) > MOST_TURN_COSINE
        away = normal @ places[:2] - offset
        near = (np.abs(away) < band) & aligned
        if np.count_nonzero(near) < 0.5 * LEAST_SUPPORT_PX:
            return None
        weighted = places * (near * np.exp(away * away * (-0.5 / FOCUS_PX**2)))
        (xx, xy, x), (_, yy, y), (*_, total) = (weighted @ places.T).tolist()
        x, y = x / total, y / total
        xx, xy, yy = xx / total - x * x, xy / total - x * y, yy / total - y * y
        across = math.atan2(2 * xy, xx - yy) / 2 + math.pi / 2  # of the smaller principal axis
        found = np.array([math.cos(across), math.sin(across)])
        normal = found if found @ normal > 0 else -found
        offset = float(normal[0] * x + normal[1] * y)
    x, y = places[:2, near]
    along = normal[0] * y - normal[1] * x
    tight = np.abs(_bow_residual(along, normal[0] * x + normal[1] * y - offset)) < TIGHT_PX
    half = int(reach / BIN_PX) + 1
    occupied = np.zeros(2 * half, dtype=bool)
    occupied[np.floor(along[tight] / BIN_PX).astype(np.intp) + half] = True
    if np.count_nonzero(occupied) * BIN_PX < LEAST_SUPPORT_PX:
        return None
    return EdgeLine.through(normal, offset, occupied)


def _bow_residual(along: Floats, across: Floats) -> Floats:
    """Subtract the bow that lens distortion gives a long straight edge."""
    low, high = float(along.min()), float(along.max())
    x = (along - (low + high) / 2) / max((high - low) / 2, 1.0)
    A = np.stack([np.ones(len(x)), x, x * x])
    rest = across
    for _ in range(3):
        weighted = A * np.exp(rest * rest * (-0.5 / FOCUS_PX**2))
        fit = np.linalg.solve(weighted @ A.T + _HELD_BOW, weighted @ across)
        rest = across - fit @ A
    return rest


def same_line(one: EdgeLine, other: EdgeLine) -> bool:
    """Tell whether two lines are the same edge: within 2 px at the middle and 0.03 rad."""
    return _is_near(one, other.normal, other.offset_px)


def _is_near(line: EdgeLine, normal: Floats, offset_px: float) -> bool:
    facing = 1.0 if line.normal @ normal > 0 else -1.0
    turn = float(line.normal[0] * normal[1] - line.normal[1] * normal[0])
    return abs(turn) < 0.03 and abs(line.offset_px - facing * offset_px) < 2.0


def edge_pairs(
    lines: list[EdgeLine], size_px: tuple[int, int], passing: Passing | None = None
) -> list[EdgePair]:
    """Return all pairs of lines that run side by side at a shaft's distance."""
    most = MOST_WIDTH_FRACTION * min(size_px)
    pairs = []
    for both in _combinations(lines):
        if passing is not None and not passing.both(*both):
            continue
        run = _common_run(*both)
        if run is None:
            continue
        pair = edge_pair(both, *run)
        least = pair.width_px - abs(pair.taper) * pair.run_px / 2
        if least > LEAST_WIDTH_PX and pair.width_px < min(most, pair.run_px):
            pairs.append(pair)
    return pairs


def _combinations(lines: list[EdgeLine]) -> Iterator[tuple[EdgeLine, EdgeLine]]:
    """Yield nearly parallel lines with their normals the same way, the smaller offset first."""
    for i, one in enumerate(lines):
        for other in lines[i + 1 :]:
            facing = other if one.normal @ other.normal > 0 else other.reversed()
            turn = one.normal[0] * facing.normal[1] - one.normal[1] * facing.normal[0]
            if abs(turn) < MOST_TILT:
                first = one.offset_px < facing.offset_px
                yield (one, facing) if first else (facing, one)


def _common_run(one: EdgeLine, other: EdgeLine) -> tuple[float, float, float] | None:
    """Return start, stop and mean support (px) where both lines are edges; None if nowhere."""
    first, second = one.density, other.density
    dense = (first >= LEAST_DENSITY) & (second >= LEAST_DENSITY) & (first + second >= 0.5)
    if np.count_nonzero(dense) * BIN_PX < LEAST_SUPPORT_PX:
        return None
    closed = np.zeros(len(dense) + 2, dtype=np.int8)
    closed[1:-1] = dense
    steps = np.flatnonzero(np.diff(closed))
    runs = [
        (np.count_nonzero(one.occupied[a:b]), np.count_nonzero(other.occupied[a:b]), a, b)
        for a, b in steps.reshape(-1, 2)
    ]
    here, there, begin, end = max(runs, key=lambda run: min(run[0], run[1]))
    if min(here, there) * BIN_PX < LEAST_SUPPORT_PX:
        return None
    filled = begin + np.flatnonzero(one.occupied[begin:end] | other.occupied[begin:end])
    zero = len(one.occupied) / 2
    length = 2 * here * there / (here + there) * BIN_PX
    return (filled[0] - zero) * BIN_PX, (filled[-1] + 1 - zero) * BIN_PX, float(length)
