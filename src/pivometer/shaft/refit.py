"""The last fit of a found pair: only where both edges are one straight, evenly bowed line."""

from __future__ import annotations

import numpy as np

from pivometer._arrays import Floats
from pivometer.shaft.background import MovingEdges
from pivometer.shaft.pairs import MOST_TURN_COSINE, EdgeLine, EdgePair

WINDOWS = ((0, 1), (0, 0.75), (0.25, 1), (0, 0.5), (0.25, 0.75), (0.5, 1), (0, 0.4), (0.6, 1))
"""Parts of the run that are fitted on their own; the part that explains most edge pixels wins.
A cannula 2–3 px wider than the shaft at one end otherwise tilts the fit by as much."""

REACH_PX = 3.5
INLIER_PX = 0.8
FOCUS_PX = 0.6
STATIONS = 60
GAP_STATIONS = 9
LEAST_SHARE = 0.5


def refitted_edges(pair: EdgePair, edges: MovingEdges, centre_px: Floats) -> Floats:
    """Return the two edges' end points (2, 2, 2), px from the image's centre.

    The ends follow the bow that lens distortion gives a straight edge, and stay within the part
    of the run where both edges lie on their lines.
    """
    fits = [_edge_fit(pair, line, edges, centre_px) for line in pair.lines]
    start, stop = _common_part(np.stack([supported for _, supported in fits]))
    places = np.array([start, stop]) * 2.0 - 1.0
    normals = np.stack([line.normal for line in pair.lines])
    moved = np.stack([_design(places) @ coefficients for coefficients, _ in fits])
    first, last = pair.edges_px[:, :1], pair.edges_px[:, 1:]
    ends: Floats = first + (last - first) * np.array([start, stop])[:, None]
    shifted: Floats = ends + moved[..., None] * normals[:, None]
    return shifted


def _design(places: Floats) -> Floats:
    return np.column_stack([np.ones(len(places)), places, places**2])


def _edge_fit(
    pair: EdgePair, line: EdgeLine, edges: MovingEdges, centre_px: Floats
) -> tuple[Floats, Floats]:
    """Return the best window's bowed line and which stations of the run lie on it."""
    along, across = _near(pair, line, edges, centre_px)
    stations = np.clip(((along + 1) / 2 * STATIONS).astype(np.intp), 0, STATIONS - 1)
    best = np.zeros(3), np.zeros(STATIONS)
    for begin, end in WINDOWS:
        inside = (along >= 2 * begin - 1) & (along <= 2 * end - 1)
        if inside.sum() < 12:
            continue
        fit = _robust_fit(along[inside], across[inside])
        fit = _robust_fit(along, across, fit)
        supported = np.zeros(STATIONS)
        supported[stations[np.abs(across - _design(along) @ fit) < INLIER_PX]] = 1.0
        if supported.sum() > best[1].sum():
            best = fit, supported
    return best


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


def _robust_fit(along: Floats, across: Floats, start: Floats | None = None) -> Floats:
    """Fit a line with a small bow to most of the pixels, from a median or a given start."""
    design = _design(along)
    fit = np.array([np.median(across), 0.0, 0.0]) if start is None else start
    # The bow is held back by 3 pixels' worth: distortion bends the run by 4 px at most.
    for focus in (2.0, 1.2, FOCUS_PX, FOCUS_PX) if start is None else (FOCUS_PX,) * 3:
        weighted = design * np.exp(-0.5 * ((across - design @ fit) / focus) ** 2)[:, None]
        held = weighted.T @ design + np.diag([0.01, 0.01, 3.0])
        fit = np.asarray(np.linalg.solve(held, weighted.T @ across), dtype=np.float64)
    return fit


def _common_part(supported: Floats) -> tuple[float, float]:
    """Return the longest part, as fractions of the run, where both edges lie on their lines."""
    kernel = np.ones(GAP_STATIONS) / GAP_STATIONS
    density = np.stack([np.convolve(row, kernel, mode="same") for row in supported])
    dense = (density.min(axis=0) > 0.1) & (density.sum(axis=0) > LEAST_SHARE)
    steps = np.flatnonzero(np.diff(np.concatenate([[0], dense.view(np.int8), [0]])))
    if len(steps) == 0:
        return 0.0, 1.0
    begin, end = max(steps.reshape(-1, 2), key=lambda part: float(part[1] - part[0]))
    filled = begin + np.flatnonzero(supported[:, begin:end].any(axis=0))
    return float(filled[0]) / STATIONS, float(filled[-1] + 1) / STATIONS
