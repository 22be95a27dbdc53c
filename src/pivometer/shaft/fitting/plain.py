"""The quick fit of a shaft with flat grey levels: both edges by maximum likelihood.

A pixel at signed distance x from an edge has the grey level B Φ(x/s) + S (1 − Φ(x/s)), with levels
B and S of their own in every chunk of rows. Far from the edge that is B or S alone, so there only
sums count; the profile is evaluated in the few columns where it changes. The levels are eliminated
in closed form from every chunk's matrix of sums (Golub and Pereyra's variable projection), which
leaves five numbers: offset and tilt of both edges, and the blur.

The answer counts only where the levels *are* flat, which the far columns and the residuals tell;
else `None`, and the caller takes a richer model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pivometer._arrays import Floats
from pivometer.shaft.fitting.evidence import saturated_part
from pivometer.shaft.fitting.fitted import FittedEdges
from pivometer.shaft.fitting.lines import EdgeLine, Lines
from pivometer.shaft.fitting.profile import normal_cdf
from pivometer.shaft.fitting.response import common_shift_px
from pivometer.shaft.fitting.strip import CHUNK_ROWS, Strip, strip
from pivometer.shaft.fitting.view import ShaftView

NEAR_SIGMAS = 4.0
"""The profile is evaluated this far to both sides; Φ(−4) of a contrast of 160 is 0.005 levels."""

FAR_PX = 16.0
"""Reach of the grey levels' windows at usual blur. Unknown levels raise the variance by
1 / (1 − √π s / reach): 10 % at 16 px and blur 0.85."""

LEAST_FAR_PX = 4.0
FIRST_BLUR_PX = 0.85
GATE_SIGMAS = 5.0
ROW_GATE_SIGMAS = 7.0
"""χ² has a long tail: with 9 pixels a row, 7 sigmas throw out one clean row in 2000."""

COARSE_ROWS = 100
COARSE_FAR_PX = 4.0
COARSE_ITERATIONS = 8
COARSE_PX = 0.1
"""About so many rows give the start; after a step that small, a few thousandths are left."""

COARSE_USED, COARSE_SIGMAS, SHARP_PX = 0.35, 7.0, 1.2
"""Levels that are so far from flat in a quarter of the rows need no look at the rest; a wider blur
than this reaches into the coarse windows."""

ITERATIONS = 6
GATED_ITERATIONS = 2
STEP_LIMIT_PX = np.array([1.0, 1.0, 1.0, 1.0, 0.4])
BLUR_RANGE_PX = (0.3, 4.0)
CONVERGED_CHI2 = 4.0
CONVERGED_PX = 0.012
"""A step of under two standard deviations, or so small, is the last: what is left after it is its
square over the blur, 0.0001 px at most."""

LARGEST_EXCESS = 1.1
"""Residuals beside the edge may exceed the noise of both sides by a tenth in variance: what shot
noise and a point spread that is not quite Gaussian add. Chosen, not measured."""

LEAST_USED = 0.5
LEAST_CONTRAST_NOISES = 1.0
"""Rows whose chunk has less contrast do not show the edge: something hides it."""

FLAT_SIGMAS = 3.5
"""Levels are not flat where a trend is this many standard deviations from none: once in 2000."""


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """The normal equations after the levels are eliminated, at one estimate."""

    gram: Floats  # sums of products of every chunk's features, (2, chunks, 6, 6)
    information: Floats
    gradient: Floats
    chi2: Floats  # of every chunk, (2, chunks)
    levels: Floats  # outside and inside, (2, chunks, 2)
    chunk_information: Floats
    chunk_gradient: Floats


def linearize(
    bands: Strip, parameters: Floats, weights: Floats, kurtosis: Floats
) -> tuple[Step, Floats]:
    """Return the normal equations at an estimate, and the features of the near pixels.

    Parameters
    ----------
    bands
        The pixels.
    parameters
        Offset and tilt of both edges (undistorted px) and the blur (px), shape (5,).
    weights
        0 or 1 for each row, shape (2, rows).
    kurtosis
        Sum of the fourth powers of the pixel's projected sides on each edge's normal, shape (2,):
        a pixel is a box, not a Gaussian, and its fourth cumulant changes the profile near an axis.
    """
    blur = float(parameters[4])
    offset, tilt = (parameters[k:4:2][:, None, None] for k in (0, 1))
    x = bands.x_px - bands.scale * (offset + tilt * bands.lever)
    z = x / blur
    square = z * z
    bell = np.exp(-0.5 * square)
    bell *= 1 / (np.sqrt(2 * np.pi) * blur)
    outside = normal_cdf(z, bell * blur)
    outside *= weights[..., None]
    bell *= weights[..., None]
    outside += (kurtosis / (2880 * blur**3))[:, None, None] * (square - 3) * z * bell
    count, pixels = bands.near.shape[1] // CHUNK_ROWS, CHUNK_ROWS * bands.near.shape[2]
    features = np.empty((2, count, 6, pixels))
    shaped = (2, count, pixels)
    features[:, :, 0] = outside.reshape(shaped)
    features[:, :, 1] = (weights[..., None] - outside).reshape(shaped)
    features[:, :, 4] = (z * bell).reshape(shaped)
    bell *= bands.scale
    features[:, :, 2] = bell.reshape(shaped)
    features[:, :, 3] = (bell * bands.lever).reshape(shaped)
    features[:, :, 5] = (bands.near * weights[..., None]).reshape(shaped)
    gram = features @ np.swapaxes(features, -1, -2)
    _add_far(gram, bands, weights)
    return _eliminated(gram), features


def _add_far(gram: Floats, bands: Strip, weights: Floats) -> None:
    """Add the far columns, where one level is 1 and the other 0, to the chunks' sums."""
    for level, side in ((0, 1), (1, 0)):
        gram[..., level, level] += _by_chunk(bands.counts[..., side] * weights)
        far = _by_chunk(bands.sums[..., side] * weights)
        gram[..., level, -1] += far
        gram[..., -1, level] += far
        gram[..., -1, -1] += _by_chunk(bands.squares[..., side] * weights)


def _by_chunk(rows: Floats) -> Floats:
    total: Floats = rows.reshape(2, -1, CHUNK_ROWS).sum(axis=-1)
    return total


def _eliminated(gram: Floats) -> Step:
    """Solve every chunk's sums for its two levels; what is left tells the edges and the blur."""
    rest, solved = _without_levels(gram)
    levels = solved[..., -1]
    used = (gram[..., 0, 0] > 1) & (gram[..., 1, 1] > 1)
    step = np.where(used, levels[..., 0] - levels[..., 1], 0.0)
    information = rest[..., :3, :3] * (step**2)[..., None, None]
    gradient = -rest[..., :3, 3] * step[..., None]
    whole, right = np.zeros((5, 5)), np.zeros(5)
    by_edge, moved = information.sum(axis=1), gradient.sum(axis=1)
    for edge, own in enumerate((slice(0, 2), slice(2, 4))):
        whole[own, own] = by_edge[edge, :2, :2]
        whole[own, 4] = whole[4, own] = by_edge[edge, :2, 2]
        right[own] = moved[edge, :2]
    whole[4, 4], right[4] = by_edge[:, 2, 2].sum(), moved[:, 2].sum()
    chi2, by_chunk = np.asarray(rest[..., 3, 3]), np.asarray(information)
    return Step(gram, whole, right, chi2, np.asarray(levels), by_chunk, np.asarray(gradient))


def _without_levels(gram: Floats) -> tuple[Floats, Floats]:
    """Return what is left of sums of products without the two levels, and their coefficients."""
    across = gram[..., :2, 2:]
    solved = np.linalg.solve(gram[..., :2, :2] + 1e-9 * np.eye(2), across)
    return gram[..., 2:, 2:] - np.swapaxes(across, -1, -2) @ solved, np.asarray(solved)


def _response_px(step: Step, features: Floats, variance: float, blur_px: float) -> float:
    """Return how far a response that is not linear moves both edges outward, px."""
    bent = features[:, :, 0] * features[:, :, 1]
    gram = np.empty((*step.gram.shape[:2], 7, 7))
    others = np.array([0, 1, 2, 3, 4, 6])
    gram[..., others[:, None], others] = step.gram
    gram[..., 5, 5] = np.einsum("ecp,ecp->ec", bent, bent)
    gram[..., 5, others] = gram[..., others, 5] = (features @ bent[..., None])[..., 0]
    contrast = step.levels[..., 0] - step.levels[..., 1]
    return common_shift_px(_without_levels(gram)[0], contrast, variance, blur_px)


def fit_plain(view: ShaftView) -> FittedEdges | None:
    """Return both edges if grey levels are flat beside them, else None.

    Parameters
    ----------
    view
        The image, and the edges to a pixel or two.
    """
    lines = view.lines
    half = _least_gap(lines) / 2
    if half < NEAR_SIGMAS * FIRST_BLUR_PX + LEAST_FAR_PX:
        return None
    step = max(1, len(view.maps[0].rows) // COARSE_ROWS)
    estimate = _coarse(view.every(step), half)
    if estimate is None:
        return None
    return _fine(view.moved(estimate), half, float(estimate[4]))


def _coarse(view: ShaftView, half: float) -> Floats | None:
    """Return the parameters from a part of the rows, good to a few thousandths of a pixel.

    None where even they show that levels are not flat.
    """
    kurtosis = np.array([_kurtosis(line) for line in view.lines])
    estimate = np.array([0.0, 0.0, 0.0, 0.0, FIRST_BLUR_PX])
    reach = NEAR_SIGMAS * FIRST_BLUR_PX + 2.0 + COARSE_FAR_PX
    bands = strip(
        view,
        near_px=(NEAR_SIGMAS * FIRST_BLUR_PX + 1.0,) * 2,
        inner_px=min(reach, half),
        outer_px=reach,
    )
    noise, weights = _flat_rows(bands)
    valid = np.maximum(bands.valid.sum(axis=1), 1)
    if (weights.sum(axis=1) < COARSE_USED * valid).any():
        return None
    for _ in range(COARSE_ITERATIONS):
        step, _ = linearize(bands, estimate, weights, kurtosis)
        move = np.linalg.solve(step.information + 1e-9 * np.eye(5), step.gradient)
        estimate = estimate + np.clip(move, -STEP_LIMIT_PX, STEP_LIMIT_PX)
        estimate[4] = np.clip(estimate[4], *BLUR_RANGE_PX)
        if np.abs(move).max() < COARSE_PX:
            break
    sharp = estimate[4] < SHARP_PX
    return None if sharp and _trend(bands, weights, noise) > COARSE_SIGMAS else estimate


def _fine(view: ShaftView, half: float, blur: float) -> FittedEdges | None:
    """Return the fit to all rows, or None where it does not hold."""
    widen = max(1.0, blur)
    bands = strip(
        view,
        near_px=(NEAR_SIGMAS * blur + 0.5,) * 2,
        inner_px=min(FAR_PX * widen, half),
        outer_px=FAR_PX * widen,
    )
    kurtosis = np.array([_kurtosis(line) for line in view.lines])
    estimate = np.array([0.0, 0.0, 0.0, 0.0, blur])
    noise, weights = _flat_rows(bands)
    for iteration in range(ITERATIONS):
        step, features = linearize(bands, estimate, weights, kurtosis)
        if iteration < GATED_ITERATIONS:
            fitting = weights * _fitting_rows(bands, step, features, noise)
            if fitting.sum() < weights.sum():
                weights = fitting
                continue
        move = np.linalg.solve(step.information + 1e-9 * np.eye(5), step.gradient)
        gain = float(move @ step.gradient)
        estimate = estimate + np.clip(move, -STEP_LIMIT_PX, STEP_LIMIT_PX)
        estimate[4] = np.clip(estimate[4], *BLUR_RANGE_PX)
        if gain < CONVERGED_CHI2 * noise.mean() or np.abs(move).max() < CONVERGED_PX:
            break
    return _judged(bands, step, features, noise, weights, estimate, view)


def _least_gap(lines: Lines) -> float:
    """Return how far the edges are apart at the nearer end, px."""
    other = lines[1]
    away = (lines[0].at(np.array([-1.0, 1.0])) - other.middle_px) @ other.outward
    return float(np.abs(away).min())


def _kurtosis(line: EdgeLine) -> float:
    return float((line.outward**4).sum())


def _flat_rows(bands: Strip) -> tuple[Floats, Floats]:
    """Return the noise variance of each side (2, 2) and which rows have their chunk's levels."""
    count = np.maximum(bands.counts, 1)
    mean = bands.sums / count
    variance = (bands.squares - bands.sums * mean) / np.maximum(count - 1, 1)
    usable = (bands.valid > 0) & (bands.counts.min(axis=-1) >= 3)
    # Medians by sorting, as masked ones are ten times slower. That of χ²/k is (1 − 2/9k)³ of its
    # mean (Wilson and Hilferty).
    ordered = np.sort(np.where(usable[..., None], variance, np.inf), axis=1)
    middle = ordered[[0, 1], np.minimum(usable.sum(axis=1) // 2, len(usable[0]) - 1)]
    freedom = np.maximum(bands.counts.max(axis=1) - 1, 1)
    noise = np.where(np.isfinite(middle), middle, 1.0) / (1 - 2 / (9 * freedom)) ** 3
    noise = np.maximum(noise, 1 / 12)
    chunks = mean.reshape(2, -1, CHUNK_ROWS, 2)
    half = CHUNK_ROWS // 2
    median = np.sort(chunks, axis=2)[:, :, half - 1 : half + 1].mean(axis=2, keepdims=True)
    apart = np.abs(chunks - median).reshape(mean.shape)
    limit = GATE_SIGMAS * np.sqrt(noise[:, None] / count)
    return noise, (usable & (apart < limit).all(axis=-1)).astype(np.float64)


def _residuals(bands: Strip, step: Step, features: Floats) -> Floats:
    """Return grey level minus model of the near pixels, shape (2, rows, columns)."""
    levels = step.levels[..., None]
    residual = features[:, :, 5] - levels[:, :, 0] * features[:, :, 0]
    residual -= levels[:, :, 1] * features[:, :, 1]
    shaped: Floats = residual.reshape(bands.near.shape)
    return shaped


def _fitting_rows(bands: Strip, step: Step, features: Floats, noise: Floats) -> Floats:
    """Return 1 for the rows whose residuals are noise."""
    square = (_residuals(bands, step, features) ** 2).sum(axis=-1) / noise.mean(axis=1)[:, None]
    freedom = bands.near.shape[2]
    limit = freedom + ROW_GATE_SIGMAS * np.sqrt(2.0 * freedom)
    return np.asarray(square < limit, dtype=np.float64)


def _judged(
    bands: Strip,
    step: Step,
    features: Floats,
    noise: Floats,
    weights: Floats,
    estimate: Floats,
    view: ShaftView,
) -> FittedEdges | None:
    """Return the fit, or None where the levels are not flat or too few rows agree."""
    used, valid = weights > 0, bands.valid > 0
    if (used.sum(axis=1) < LEAST_USED * np.maximum(valid.sum(axis=1), 1)).any():
        return None
    residual = _residuals(bands, step, features)
    freedom = float(used.sum() * residual.shape[2])
    expected = float((noise.mean(axis=1) * used.sum(axis=1)).sum()) * residual.shape[2]
    excess = float(np.einsum("ijk,ijk,ij->", residual, residual, weights)) / expected
    if excess > LARGEST_EXCESS + FLAT_SIGMAS * np.sqrt(2 / freedom):
        return None
    if _trend(bands, weights, noise) > FLAT_SIGMAS:
        return None
    variance = float(noise.mean()) * max(1.0, excess)
    covariance = np.linalg.inv(step.information + 1e-9 * np.eye(5)) * variance
    covariance = covariance * _inflation(step, variance)
    response_px = _response_px(step, features, variance, float(estimate[4]))
    # Both move outward alike, so the centre is as certain as before.
    covariance[np.ix_([0, 2], [0, 2])] += response_px**2
    contrast = step.levels[..., 0] - step.levels[..., 1]
    slope = features[:, :, 2].reshape(residual.shape)
    slope = slope * np.repeat(contrast, CHUNK_ROWS, axis=1)[..., None]
    information = np.einsum("ijk,ijk->ij", slope, slope)
    left = step.chunk_information[..., 0, 0] / np.maximum(_by_chunk(information), 1e-9)
    information = information * np.repeat(left, CHUNK_ROWS, axis=1)
    offset = -np.einsum("ijk,ijk->ij", slope, residual) / np.maximum(information, 1e-9)
    seen = _by_chunk(weights) * (np.abs(contrast) > LEAST_CONTRAST_NOISES * np.sqrt(noise.mean()))
    chunk = seen / np.maximum(seen.sum(axis=1, keepdims=True), 1e-9)
    used &= np.repeat(chunk > 0, CHUNK_ROWS, axis=1)
    scale = bands.scale[..., 0]
    return FittedEdges(
        start=view.lines,
        parameters=estimate,
        covariance=covariance,
        contrast=(np.abs(contrast) * chunk).sum(axis=1),
        noise_grey=float(np.sqrt(noise.mean())),
        lever=bands.lever[..., bands.lever.shape[2] // 2],
        offset_px=offset * scale,
        weight=information / variance / scale**2,
        accepted=used,
        counted=valid,
        saturated_part=saturated_part(bands.near, used, view.depth),
        shading="flat",
        response_px=response_px,
    )


def _trend(bands: Strip, weights: Floats, noise: Floats) -> float:
    """Return by how many standard deviations far grey levels rise or fall across the shaft."""
    whole = weights[..., None] * (bands.counts >= bands.counts.max(axis=1, keepdims=True))
    variance = np.maximum(whole.sum(axis=1) * bands.spread * noise, 1e-9)
    z = (whole * bands.trends).sum(axis=1) / np.sqrt(variance)
    return float(np.abs(z).max())


def _inflation(step: Step, variance: float) -> float:
    """Return how much the chunks' own offsets scatter beyond noise, at least 1."""
    own = step.chunk_information[..., 0, 0] * variance
    used = own > 1e-9
    chi2 = float((step.chunk_gradient[..., 0][used] ** 2 / own[used]).sum())
    freedom = max(int(used.sum()) - 4, 1)
    return max(1.0, chi2 / freedom - 2 * float(np.sqrt(2 / freedom)))
