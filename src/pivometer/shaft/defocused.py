"""The fit of a shaft so blurred that the blurs of its two edges meet, before any smooth background.

With x₁ and x₂ a pixel's distances outward from the two edges its grey level is
Σ (Bₑ + Rₑ xₑ) over the outside of each edge plus S between them, all blurred, with the five levels
free in every chunk of rows; so a background may rise, fall, and be darker than the shaft in one
place and brighter in another. A shaft that comes towards the camera is in focus in one place only,
so the blur may grow along it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.shaft.band_map import BandMap
from pivometer.shaft.bands import EdgeLine, width_px
from pivometer.shaft.evidence import saturated_part
from pivometer.shaft.fitted import FittedEdges
from pivometer.shaft.profile import BLUR_RANGE_PX, normal_cdf
from pivometer.shaft.strip import CHUNK_ROWS
from pivometer.shaft.thin import ThinRows, thin_rows

Lines = tuple[EdgeLine, EdgeLine]

BLURS_ACROSS = 8.0
"""A shaft under so many blurs wide has no middle that is free of both edges."""

ITERATIONS, GATE_AT = 20, 8
CONVERGED_PX = 0.005
STEP_LIMIT = np.array([1.0, 1.0, 1.0, 1.0, 0.4, 0.4])
LEAST_USED = 0.4
GATE_SIGMAS = 5.0
SYSTEMATIC_BLURS = 0.02
"""What shading that no level and ramp has moves an edge by, in blurs: as of shaded edges, whose
0.02 px were found at a blur of 0.7 to 0.9 px. Chosen, not measured."""


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """One linearization; chunks of p pixels."""

    information: Floats  # (chunks, 6, 6)
    gradient: Floats  # (chunks, 6)
    levels: Floats  # B₁, B₂, S, R₁, R₂; (chunks, 5)
    residual: Floats  # (chunks, p)
    jacobian: Floats  # (chunks, 6, p)


def fit_defocused(
    turned: NDArray[np.generic], maps: tuple[BandMap, BandMap], lines: Lines, blur_px: float
) -> FittedEdges | None:
    """Return both edges, or None where they are not so blurred or too few rows agree.

    Parameters
    ----------
    turned
        The raw image, turned so that the shaft is upright.
    maps
        Where its pixels are.
    lines
        The edges to about a blur, undistorted px.
    blur_px
        The blur as another fit has it.
    """
    if width_px(lines) > BLURS_ACROSS * blur_px:
        return None
    blur = float(np.clip(blur_px, *BLUR_RANGE_PX))
    rows = thin_rows(turned, maps[0].towards(lines[0]), lines, blur)
    parameters, weights = np.array([0.0, 0.0, 0.0, 0.0, blur, 0.0]), rows.valid
    for iteration in range(ITERATIONS):
        fit = _linearize(rows, weights, parameters)
        if iteration == GATE_AT:
            weights = weights * _alike_rows(rows, fit)
            continue
        variance = _variances(rows, weights, fit)
        whole = (fit.information / variance[:, None, None]).sum(axis=0) + 1e-6 * np.eye(6)
        step = np.linalg.solve(whole, (fit.gradient / variance[:, None]).sum(axis=0))
        parameters = parameters + np.clip(step, -STEP_LIMIT, STEP_LIMIT)
        parameters[4] = np.clip(parameters[4], *BLUR_RANGE_PX)
        if iteration > GATE_AT and np.abs(step).max() < CONVERGED_PX:
            break
    if weights.sum() < LEAST_USED * max(1.0, float(rows.valid.sum())):
        return None
    if width_px(lines) > BLURS_ACROSS * parameters[4]:
        return None
    return _fitted(rows, lines, fit, parameters, weights, turned.dtype)


def _linearize(rows: ThinRows, weights: Floats, parameters: Floats) -> _Fit:
    along = rows.lever.mean(axis=(0, 2))[:, None]
    blur = np.clip(parameters[4] + parameters[5] * along, *BLUR_RANGE_PX)
    offset, tilt = (parameters[k:4:2][:, None, None] for k in (0, 1))
    x = rows.x_px - rows.scale * (offset + tilt * rows.lever)
    z = x / blur
    density = np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi)
    outside, bell = normal_cdf(z, density), density / blur
    ramps = x * outside + blur * density
    shape = (len(weights) // CHUNK_ROWS, -1)
    chunk = weights[:, None] * np.ones_like(rows.grey)
    used = chunk.reshape(shape)
    terms = np.stack([t.reshape(shape) for t in (*outside, 1 - outside.sum(0), *ramps)], axis=1)
    terms *= used[:, None]
    gram = terms @ np.swapaxes(terms, -1, -2)
    gram += (1e-9 * np.trace(gram, axis1=1, axis2=2)[:, None, None] + 1e-9) * np.eye(5)
    grey = rows.grey.reshape(shape) * used
    levels = np.linalg.solve(gram, terms @ grey[..., None])[..., 0]
    residual = grey - (levels[:, None] @ terms)[:, 0]
    # Levels that rise within a chunk look like a tilt of both edges there, so only the chunks'
    # own offsets tell the tilt, and their own blurs how the blur grows.
    lever = rows.lever.reshape(2, len(gram), -1).mean(axis=-1)[..., None]
    columns = np.zeros((len(gram), 6, terms.shape[-1]))
    for edge in (0, 1):
        step = (levels[:, edge] - levels[:, 2])[:, None]
        rise = levels[:, 3 + edge][:, None]
        bells, cover = bell[edge].reshape(shape), outside[edge].reshape(shape)
        across = -(rows.scale * np.ones_like(rows.grey)).reshape(shape) * used
        across *= step * bells + rise * cover
        columns[:, 2 * edge] = across
        columns[:, 2 * edge + 1] = across * lever[edge]
        spread = rise * (blur * np.ones_like(rows.grey)).reshape(shape)
        columns[:, 4] += used * (spread - step * z[edge].reshape(shape)) * bells
    columns[:, 5] = columns[:, 4] * lever.mean(axis=0)
    mixed = terms @ np.swapaxes(columns, -1, -2)
    solved = np.swapaxes(mixed, -1, -2) @ np.linalg.inv(gram)
    information = columns @ np.swapaxes(columns, -1, -2) - solved @ mixed
    gradient = (columns @ residual[..., None])[..., 0]
    return _Fit(information, gradient, levels, residual, columns)


def _variances(rows: ThinRows, weights: Floats, fit: _Fit) -> Floats:
    """Return each chunk's mean square residual: bright parts are noisier, clutter more so."""
    count = weights.reshape(-1, CHUNK_ROWS).sum(axis=1) * rows.grey.shape[1]
    square = (fit.residual**2).sum(axis=1)
    return np.where(count > 0, square / np.maximum(count - 5, 1), 1.0) + 1 / 12


def _alike_rows(rows: ThinRows, fit: _Fit) -> Floats:
    """Return 1 for the rows whose residuals are like those of most in their chunk."""
    square = (fit.residual.reshape(rows.grey.shape) ** 2).mean(axis=1)
    usual = np.median(square.reshape(-1, CHUNK_ROWS), axis=1)
    limit = np.repeat(usual, CHUNK_ROWS) * (1.2 + GATE_SIGMAS * np.sqrt(2 / rows.grey.shape[1]))
    return np.asarray(square <= limit, dtype=np.float64)


def _fitted(
    rows: ThinRows,
    start: Lines,
    fit: _Fit,
    parameters: Floats,
    weights: Floats,
    depth: np.dtype[np.generic],
) -> FittedEdges:
    variance = _variances(rows, weights, fit)
    whole = (fit.information / variance[:, None, None]).sum(axis=0)
    covariance = np.linalg.inv(whole + 1e-9 * np.eye(6))[:5, :5] * _inflation(fit, variance)
    covariance[range(4), range(4)] += (SYSTEMATIC_BLURS * parameters[4]) ** 2
    across = np.moveaxis(fit.jacobian[:, [0, 2]], 1, 0).reshape(2, *rows.grey.shape)
    information = (across**2).sum(axis=-1)
    residual = fit.residual.reshape(rows.grey.shape)
    offset = (across * residual).sum(axis=-1) / np.maximum(information, 1e-9)
    scale, both = rows.scale[:, 0], np.stack([weights, weights]) > 0
    nearest = np.abs(rows.x_px).argmin(axis=-1)[..., None]
    count = weights.reshape(-1, CHUNK_ROWS).sum(axis=1)
    steps = np.abs(fit.levels[:, :2] - fit.levels[:, 2:3])
    return FittedEdges(
        start=start,
        parameters=parameters[:5],
        covariance=np.asarray(covariance),
        contrast=(steps * count[:, None]).sum(axis=0) / max(int(count.sum()), 1),
        noise_grey=float(np.sqrt(np.median(variance[count > 0]))),
        lever=np.take_along_axis(rows.lever, nearest, axis=-1)[..., 0],
        offset_px=offset * scale,
        weight=information / np.repeat(variance, CHUNK_ROWS) / scale**2,
        accepted=both & (information > 0),
        counted=np.stack([rows.valid, rows.valid]) > 0,
        saturated_part=saturated_part(np.stack([rows.grey] * 2), both, depth),
        shading="ramp",
    )


def _inflation(fit: _Fit, variance: Floats) -> float:
    """Return how much the chunks' own offsets scatter beyond noise, at least 1."""
    own = np.stack([fit.information[:, k, k] for k in (0, 2)]) / variance
    gradient = np.stack([fit.gradient[:, k] for k in (0, 2)]) / variance
    used = own > 1e-9
    freedom = max(int(used.sum()) - 4, 1)
    return max(1.0, float((gradient[used] ** 2 / own[used]).sum()) / freedom)
