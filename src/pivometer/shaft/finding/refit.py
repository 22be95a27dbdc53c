"""The last fit of a found pair: only where both edges are one straight, evenly bowed line."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.shaft.finding.background import MovingEdges
from pivometer.shaft.finding.pairs import EdgePair
from pivometer.shaft.finding.straight import MOST_TURN_COSINE, EdgeLine

WINDOWS = ((0, 1), (0, 0.75), (0.25, 1), (0, 0.5), (0.25, 0.75), (0.5, 1), (0, 0.4), (0.6, 1))
"""Parts of the run that are fitted on their own; the part that explains most edge pixels wins.
A cannula 2–3 px wider than the shaft at one end otherwise tilts the fit by as much."""

REACH_PX = 2.8
INLIER_PX = 0.8
FOCUS_PX = 0.6
STATIONS = 60
GAP_STATIONS = 15
LEAST_SHARE = 0.5


def refitted_edges(pair: EdgePair, edges: MovingEdges, centre_px: Floats) -> Floats:
    """Return the two edges' end points (2, 2, 2), px from the image's centre.

    The ends follow the bow that lens distortion gives both edges alike, and stay within the part
    of the run where both edges lie on their lines.
    """
    seen = [_near(pair, line, edges, centre_px) for line in pair.lines]
    along = np.concatenate([places for places, _ in seen])
    across = np.concatenate([values for _, values in seen])
    second = np.repeat([0, 1], [len(places) for places, _ in seen])
    fit, supported = _best_fit(along, across, second)
    part = np.array(_common_part(supported))
    moved = _design(np.tile(part * 2 - 1, 2), np.repeat([0, 1], 2)) @ fit
    normals = np.stack([line.normal for line in pair.lines])
    first, last = pair.edges_px[:, :1], pair.edges_px[:, 1:]
    ends: Floats = first + (last - first) * part[:, None]
    shifted: Floats = ends + moved.reshape(2, 2, 1) * normals[:, None]
    return shifted


def _design(places: Floats, second: NDArray[np.intp]) -> Floats:
    """Offset and slope of each edge, and one bow for both."""
    edges = [np.where(second == e, x, 0.0) for e in (0, 1) for x in (np.ones_like(places), places)]
    return np.column_stack([*edges, places**2])


def _best_fit(along: Floats, across: Floats, second: NDArray[np.intp]) -> tuple[Floats, Floats]:
    """Return the best window's fit and which stations of the run lie on each edge's line."""
    design = _design(along, second)
    stations = np.clip(((along + 1) / 2 * STATIONS).astype(np.intp), 0, STATIONS - 1)
    begin, end = 2 * np.array(WINDOWS).T[..., None] - 1
    inside = ((along >= begin) & (along <= end)).astype(np.float64)
    fits = _robust_fits(design, across, inside, np.zeros((len(WINDOWS), 5)), (1.5, 1.0, 0.6, 0.6))
    fits = _robust_fits(design, across, np.ones_like(inside), fits, (FOCUS_PX,) * 3)
    window, on = np.nonzero(np.abs(across - fits @ design.T) < INLIER_PX)
    supported = np.zeros((len(WINDOWS), 2, STATIONS))
    supported[window, second[on], stations[on]] = 1.0
    best = int(supported.sum(axis=(1, 2)).argmax())
    return fits[best], supported[best]


def _near(
    pair: EdgePair, line: EdgeLine, edges: MovingEdges, centre_px: Floats
) -> tuple[Floats, Floats]:
    """Places along (−1 to 1 from end to end) and across (px) of the edge pixels of one line."""
    points = edges.points_px - centre_px
    along = points @ np.array([-line.normal[1], line.normal[0]])
    along = (2 * along - pair.start_px - pair.stop_px) / pair.run_px
    across = points @ line.normal - line.offset_px
    facing = np.abs(edges.directions @ line.normal) > MOST_TURN_COSINE
    near = (np.abs(across) < REACH_PX) & (np.abs(along) < 1) & facing
    return along[near], across[near]


def _robust_fits(
    design: Floats, across: Floats, inside: Floats, fits: Floats, focuses: tuple[float, ...]
) -> Floats:
    """Fit most of each window's pixels (w, n) from starts (w, 5); the bow is held a little."""
    held = np.diag([0.01, 0.01, 0.01, 0.01, 6.0])
    for focus in focuses:
        weights = inside * np.exp(-0.5 * ((across - fits @ design.T) / focus) ** 2)
        weighted = weights[:, None] * design.T
        right = (weighted @ across)[..., None]
        fits = np.asarray(np.linalg.solve(weighted @ design + held, right)[..., 0])
    return fits


def _common_part(supported: Floats) -> tuple[float, float]:
    """Return the longest part, as fractions of the run, where both edges lie on their lines."""
    kernel = np.ones(GAP_STATIONS) / GAP_STATIONS
    density = np.stack([np.convolve(row, kernel, mode="same") for row in supported])
    dense = (density.min(axis=0) > 0.05) & (density.sum(axis=0) > LEAST_SHARE)
    steps = np.flatnonzero(np.diff(np.concatenate([[0], dense.view(np.int8), [0]])))
    if len(steps) == 0:
        return 0.0, 1.0
    begin, end = max(steps.reshape(-1, 2), key=lambda part: float(part[1] - part[0]))
    filled = begin + np.flatnonzero(supported[:, begin:end].any(axis=0))
    return float(filled[0]) / STATIONS, float(filled[-1] + 1) / STATIONS
