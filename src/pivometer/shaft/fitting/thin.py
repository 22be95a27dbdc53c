"""The fit of a thin shaft: the blurs of its edges meet, so both are fitted to the same pixels.

With x₁ and x₂ a pixel's distances outward from the two edges, its grey level is
B₁ Φ(x₁/s) + B₂ Φ(x₂/s) + S (1 − Φ(x₁/s) − Φ(x₂/s)), with B₁, B₂ and S free in every chunk of rows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.shaft.fitting.band_map import picked
from pivometer.shaft.fitting.evidence import saturated_part
from pivometer.shaft.fitting.fitted import FittedEdges
from pivometer.shaft.fitting.plain import (
    BLUR_RANGE_PX,
    COARSE_ROWS,
    FAR_PX,
    FIRST_BLUR_PX,
    FLAT_SIGMAS,
    GATE_SIGMAS,
    LARGEST_EXCESS,
    LEAST_USED,
    NEAR_SIGMAS,
    STEP_LIMIT_PX,
)
from pivometer.shaft.fitting.profile import normal_cdf
from pivometer.shaft.fitting.strip import CHUNK_ROWS
from pivometer.shaft.fitting.view import ShaftView

COARSE_ITERATIONS = 10
ITERATIONS = 4
CONVERGED_PX = 1e-3
LEAST_ROWS = 20


@dataclass(frozen=True, slots=True, eq=False)
class ThinRows:
    """Rows across the whole shaft; far columns lie outside the first and the second edge.

    Shapes: grey (rows, k); x_px, lever (2, rows, k); scale (2, rows, 1); counts, sums, squares,
    trends (2, rows), `spread` (2,) the sum of the squares of the far columns' offsets.
    """

    grey: Floats
    x_px: Floats
    lever: Floats
    scale: Floats
    counts: Floats
    sums: Floats
    squares: Floats
    trends: Floats
    spread: Floats
    valid: Floats


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """One linearization; chunks of p pixels."""

    information: Floats
    gradient: Floats
    levels: Floats  # B₁, B₂, S; (chunks, 3)
    residual: Floats  # (chunks, p)
    jacobian: Floats  # (chunks, 5, p)


def fit_thin(view: ShaftView) -> FittedEdges | None:
    """Return both edges of a thin shaft with flat grey levels, else None.

    Parameters
    ----------
    view
        The image, and the edges to a pixel or so.
    """
    few = view.every(max(1, len(view.maps[0].rows) // COARSE_ROWS))
    estimate = np.array([0.0, 0.0, 0.0, 0.0, FIRST_BLUR_PX])
    coarse = thin_rows(few, FIRST_BLUR_PX)
    weights, _ = _flat(coarse)
    if weights.sum() < LEAST_ROWS:
        return None
    estimate = _iterated(coarse, weights, estimate, COARSE_ITERATIONS)
    if estimate[4] > 1.5 * FIRST_BLUR_PX:
        wider = thin_rows(few, float(estimate[4]))
        estimate = _iterated(wider, weights, estimate, COARSE_ITERATIONS)
    near = view.moved(estimate)
    return _fine(thin_rows(near, float(estimate[4])), near, float(estimate[4]))


def thin_rows(view: ShaftView, blur: float) -> ThinRows:
    """Gather rows across the whole shaft and 4 blurs beside it, and the sums of farther columns."""
    lines, m, columns_of_image = view.lines, view.maps[0], view.pixels.shape[1]
    ends = lines[0].at(np.array([-1.0, 1.0])) - lines[1].middle_px
    width = float(np.abs(ends @ lines[1].outward).max()) * float(m.scale.max())
    near = int(np.ceil((NEAR_SIGMAS * blur + 1.0) * m.slant))
    beyond = near + int(np.ceil(width * m.slant))
    far = int(np.ceil(FAR_PX * max(1.0, blur) * m.slant))
    j = np.arange(-beyond - far, near + far + 1)
    columns = np.rint(m.centre).astype(np.intp)[:, None] + m.outward * j
    within = (columns >= 0) & (columns < columns_of_image)
    grey = picked(view.pixels, m.rows, np.clip(columns, 0, columns_of_image - 1)).astype(np.float64)
    count = -(-len(grey) // CHUNK_ROWS) * CHUNK_ROWS
    grey = np.concatenate([grey * within, np.zeros((count - len(grey), len(j)))])
    inside = np.concatenate([within, np.zeros((count - len(within), len(j)), dtype=bool)])
    middle = slice(far, len(j) - far)
    sides = slice(len(j) - far, len(j)), slice(0, far)
    weights = np.zeros((len(j), 4))
    for side, place in enumerate(sides):
        weights[place, side] = 1.0
        weights[place, 2 + side] = j[place] - j[place].mean()
    sums = (grey @ weights).T
    x, lever = np.zeros((2, 2, count, beyond + near + 1))
    for edge, line in enumerate(lines):
        half = line.half_px / (line.half_px @ line.half_px)
        at, about = slice(0, len(m.rows)), -float(line.outward @ line.middle_px)
        x[edge, at] = m.coordinate(line.outward, about, columns[:, middle]) * m.scale[:, None]
        lever[edge, at] = m.coordinate(half, -float(half @ line.middle_px), columns[:, middle])
    scale = np.ones((count, 1))
    scale[: len(m.rows), 0] = m.scale
    return ThinRows(
        grey=grey[:, middle],
        x_px=x,
        lever=lever,
        scale=scale,
        counts=(inside @ weights[:, :2]).T,
        sums=sums[:2],
        squares=((grey * grey) @ weights[:, :2]).T,
        trends=sums[2:],
        spread=(weights[:, 2:] ** 2).sum(axis=0),
        valid=np.asarray(inside[:, middle].all(axis=1), dtype=np.float64),
    )


def _flat(rows: ThinRows) -> tuple[Floats, float]:
    """Return 1 for rows with their chunk's levels outside, and the noise's variance."""
    count = np.maximum(rows.counts, 1)
    mean = rows.sums / count
    variance = (rows.squares - rows.sums * mean) / np.maximum(count - 1, 1)
    usable = (rows.valid > 0) & (rows.counts.min(axis=0) >= 3)
    if not usable.any():
        return np.zeros_like(rows.valid), 1.0
    freedom = max(float(rows.counts.max()) - 1, 1)
    noise = max(float(np.median(variance[:, usable])) / (1 - 2 / (9 * freedom)) ** 3, 1 / 12)
    chunks = mean.reshape(2, -1, CHUNK_ROWS)
    apart = np.abs(chunks - np.median(chunks, axis=2, keepdims=True)).reshape(mean.shape)
    limit = GATE_SIGMAS * np.sqrt(noise / count)
    return np.asarray(usable & (apart < limit).all(axis=0), dtype=np.float64), noise


def _linearize(rows: ThinRows, weights: Floats, parameters: Floats) -> _Fit:
    blur = float(parameters[4])
    offset, tilt = (parameters[k:4:2][:, None, None] for k in (0, 1))
    z = (rows.x_px - rows.scale * (offset + tilt * rows.lever)) / blur
    density = np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi)
    outside = normal_cdf(z, density) * weights[:, None]
    bell = density * (weights[:, None] / blur)
    shape = (len(weights) // CHUNK_ROWS, -1)
    terms = np.stack(
        [part.reshape(shape) for part in (*outside, weights[:, None] - outside.sum(axis=0))], axis=1
    )
    grey = (rows.grey * weights[:, None]).reshape(shape)
    gram = terms @ np.swapaxes(terms, -1, -2) + 1e-9 * np.eye(3)
    moment = (terms @ grey[..., None])[..., 0]
    for side in (0, 1):
        gram[:, side, side] += _by_chunk(rows.counts[side] * weights)
        moment[:, side] += _by_chunk(rows.sums[side] * weights)
    levels = np.linalg.solve(gram, moment[..., None])[..., 0]
    residual = grey - (levels[:, None] @ terms)[:, 0]
    columns = np.zeros((len(gram), 5, terms.shape[-1]))
    for edge in (0, 1):
        step = (levels[:, edge] - levels[:, 2])[:, None]
        across = -step * (bell[edge] * rows.scale).reshape(shape)
        columns[:, 2 * edge] = across
        columns[:, 2 * edge + 1] = across * rows.lever[edge].reshape(shape)
        columns[:, 4] -= step * (z[edge] * bell[edge]).reshape(shape)
    mixed = terms @ np.swapaxes(columns, -1, -2)
    solved = np.linalg.solve(gram, mixed)
    information = columns @ np.swapaxes(columns, -1, -2) - np.swapaxes(mixed, -1, -2) @ solved
    # The far pixels' residuals belong to the levels' equations, so the moments are taken whole.
    direct = (columns @ grey[..., None])[..., 0] - (
        np.swapaxes(solved, -1, -2) @ moment[..., None]
    )[..., 0]
    return _Fit(information.sum(axis=0), direct.sum(axis=0), levels, residual, columns)


def _by_chunk(values: Floats) -> Floats:
    sums: Floats = values.reshape(-1, CHUNK_ROWS).sum(axis=-1)
    return sums


def _stepped(fit: _Fit, parameters: Floats) -> tuple[Floats, float]:
    step = np.linalg.solve(fit.information + 1e-9 * np.eye(5), fit.gradient)
    after: Floats = parameters + np.clip(step, -STEP_LIMIT_PX, STEP_LIMIT_PX)
    after[4] = np.clip(after[4], *BLUR_RANGE_PX)
    return after, float(np.abs(step).max())


def _iterated(rows: ThinRows, weights: Floats, parameters: Floats, most: int) -> Floats:
    for _ in range(most):
        parameters, length = _stepped(_linearize(rows, weights, parameters), parameters)
        if length < CONVERGED_PX:
            break
    return parameters


def _fine(rows: ThinRows, view: ShaftView, blur: float) -> FittedEdges | None:
    """Return the fit to all rows, or None where levels are not flat or too few rows agree."""
    parameters = np.array([0.0, 0.0, 0.0, 0.0, blur])
    weights, noise = _flat(rows)
    if weights.sum() < LEAST_ROWS:
        return None
    fit = _linearize(rows, weights, parameters)
    square = (fit.residual.reshape(rows.grey.shape) ** 2).sum(axis=1)
    pixels = rows.grey.shape[1]
    weights = weights * (square < noise * (pixels + GATE_SIGMAS * np.sqrt(2 * pixels)))
    for _ in range(ITERATIONS):
        fit = _linearize(rows, weights, parameters)
        parameters, length = _stepped(fit, parameters)
        if length < CONVERGED_PX:
            break
    used, valid = weights > 0, rows.valid > 0
    if used.sum() < max(LEAST_ROWS, LEAST_USED * float(valid.sum())):
        return None
    freedom = float(used.sum() * pixels)
    excess = float((fit.residual**2).sum()) / noise / freedom
    whole = weights * (rows.counts >= rows.counts.max())
    spread = np.sqrt(np.maximum(whole.sum(axis=1) * rows.spread * noise, 1e-9))
    trend = float(np.abs((whole * rows.trends).sum(axis=1) / spread).max())
    if excess > LARGEST_EXCESS + FLAT_SIGMAS * np.sqrt(2 / freedom) or trend > FLAT_SIGMAS:
        return None
    return _fitted(rows, fit, parameters, used, noise * max(1.0, excess), view)


def _fitted(
    rows: ThinRows,
    fit: _Fit,
    parameters: Floats,
    used: NDArray[np.bool_],
    variance: float,
    view: ShaftView,
) -> FittedEdges:
    across = fit.jacobian[:, [0, 2]]
    by_row = (2, *rows.grey.shape)
    across = np.moveaxis(across, 1, 0).reshape(by_row)
    information = (across**2).sum(axis=-1)
    residual = fit.residual.reshape(rows.grey.shape)
    offset = (across * residual).sum(axis=-1) / np.maximum(information, 1e-9)
    scale = rows.scale[:, 0]
    both = np.stack([used, used])
    nearest = np.abs(rows.x_px).argmin(axis=-1)[..., None]
    steps = np.abs(fit.levels[:, :2] - fit.levels[:, 2:])
    chunk = _by_chunk(used.astype(np.float64))
    return FittedEdges(
        start=view.lines,
        parameters=parameters,
        covariance=np.asarray(np.linalg.inv(fit.information + 1e-9 * np.eye(5)) * variance),
        contrast=(steps * chunk[:, None]).sum(axis=0) / chunk.sum(),
        noise_grey=float(np.sqrt(variance)),
        lever=np.take_along_axis(rows.lever, nearest, axis=-1)[..., 0],
        offset_px=offset * scale,
        weight=information / variance / scale**2,
        accepted=both & (information > 0),
        counted=np.stack([rows.valid, rows.valid]) > 0,
        saturated_part=saturated_part(np.stack([rows.grey] * 2), both, view.depth),
        shading="flat",
    )
