"""The fit of a shaft with bands around it: grey levels jump along it, not across.

A white-banded shaft has another grey level after every few rows, so levels in common to a chunk of
rows do not hold. Each place along the shaft, a row where it stands upright, gets its own level on
either side of the edge. That costs no certainty: the places' designs are alike, so levels in common
leave an edge's offset the same information.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pivometer._arrays import Floats
from pivometer.shaft.fitting.evidence import saturated_part
from pivometer.shaft.fitting.fitted import FittedEdges
from pivometer.shaft.fitting.lines import width_px
from pivometer.shaft.fitting.profile import normal_cdf
from pivometer.shaft.fitting.strip import CHUNK_ROWS, Strip, mean_beside, strip
from pivometer.shaft.fitting.view import ShaftView

INNER_PX, OUTER_PX = 5.0, 4.0
LEAST_HALF_PX = 3.0
"""Reach of the window to either side; in a shaft under 6 px the blurs of both edges meet."""

FIRST_BLUR_PX, BLUR_SIGMA_PX = 0.85, 0.5
BLUR_RANGE_PX = (0.3, 2.0)
ITERATIONS = 8
STEP_LIMIT_PX = np.array([0.7, 0.7, 0.7, 0.7, 0.3])
CONVERGED_PX = 0.003
FAR_PX = 2.5
"""From here on inwards a row shows the shaft's own level."""

BANDED_PART = 0.5
JUMP_NOISES = 8.0
JUMP_CONTRAST = 0.5
"""Banded is where in half the chunks the rows' own levels range over 8 noises and half the
contrast. In drawn banded shafts the median chunk's range was 1.8 to 8 contrasts; on the black arm,
parts of which something bright hides, at most 0.33."""

ROW_SIGMAS = 4.0
"""Tukey's biweight on the rows' own offsets ends here."""

LARGEST_PROFILE = 0.03
"""Mean residual across the edge, in parts of the contrast, up to which levels are flat: it moves an
edge by as many pixels, times the blur of about 1 px. A limb leaves 0.05 to 0.15."""

PROFILE_BINS = 17
PROFILE_ERRORS = 3.0
LEAST_USED = 0.3
SYSTEMATIC_PX = 0.02
"""Added to offsets and tilts: what the profile's limit may hide."""


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """Every row's normal equations by its offset and the blur, its residuals and its contrast."""

    information: Floats  # (2, rows, 2, 2)
    gradient: Floats  # (2, rows, 2)
    residual: Floats  # (2, rows, columns)
    used: Floats  # (2, rows, columns)
    contrast: Floats  # (2, rows)
    x_px: Floats  # (2, rows, columns)

    @property
    def own_px(self) -> Floats:
        """Every row's own offset from the estimate, raw px."""
        own: Floats = self.gradient[..., 0] / np.maximum(self.information[..., 0, 0], 1e-9)
        return own

    @property
    def square(self) -> Floats:
        """Mean square residual of every row."""
        freedom = np.maximum(self.used.sum(axis=-1) - 2, 1)
        mean: Floats = (self.residual**2).sum(axis=-1) / freedom
        return mean


def fit_banded(view: ShaftView) -> FittedEdges | None:
    """Return both edges of a shaft with bands around it, or None where it has none.

    Parameters
    ----------
    view
        The image, and the edges to a pixel or so.
    """
    half = width_px(view.lines) / 2
    if half < LEAST_HALF_PX:
        return None
    inner = min(INNER_PX, half)
    if not _is_banded(view, half):
        return None
    bands = _by_place(strip(view, near_px=(inner + 1, OUTER_PX + 1)))
    estimate = np.array([0.0, 0.0, 0.0, 0.0, FIRST_BLUR_PX])
    for _ in range(ITERATIONS):
        rows = _linearized(bands, estimate, inner)
        variance, weight = _trusted(rows)
        step, covariance = _solved(bands, rows, weight / variance, estimate)
        estimate = estimate + np.clip(step, -STEP_LIMIT_PX, STEP_LIMIT_PX)
        estimate[4] = np.clip(estimate[4], *BLUR_RANGE_PX)
        if np.abs(step).max() < CONVERGED_PX:
            break
    used = (weight > 0.1) & (bands.valid > 0)
    few = (used.sum(axis=1) < LEAST_USED * np.maximum(bands.valid.sum(axis=1), 1)).any()
    if few or _profile(rows, weight) > LARGEST_PROFILE:
        return None
    covariance[range(4), range(4)] += SYSTEMATIC_PX**2
    total = np.maximum(weight.sum(axis=1), 1e-12)
    return FittedEdges(
        start=view.lines,
        parameters=estimate,
        covariance=covariance,
        contrast=(weight * np.abs(rows.contrast)).sum(axis=1) / total,
        noise_grey=float(np.sqrt(np.median(rows.square[used]))),
        lever=bands.lever[..., bands.lever.shape[2] // 2],
        offset_px=rows.own_px,
        weight=weight * rows.information[..., 0, 0] / variance,
        accepted=used,
        counted=bands.valid > 0,
        saturated_part=saturated_part(bands.near, used, view.depth),
        shading="flat",
    )


def _is_banded(view: ShaftView, half_px: float) -> bool:
    """Tell whether the shaft's own grey level jumps along it."""
    level, seen = mean_beside(view, (-min(INNER_PX, half_px), -min(FAR_PX, half_px / 2)))
    beyond, _ = mean_beside(view, (FAR_PX, OUTER_PX))
    both = seen[:, 1:] & seen[:, :-1]
    change = np.diff(level, axis=1)[both]
    if change.size < 2 * CHUNK_ROWS:
        return False
    noise = 1.4826 * float(np.median(np.abs(change))) / np.sqrt(2)
    contrast = float(np.median(np.abs(level - beyond)[seen]))
    chunks, there = level.reshape(2, -1, CHUNK_ROWS), seen.reshape(2, -1, CHUNK_ROWS)
    high = np.where(there, chunks, -np.inf).max(axis=-1)
    low = np.where(there, chunks, np.inf).min(axis=-1)
    jumps = (high - low)[there.sum(axis=-1) > CHUNK_ROWS // 2]
    limit = max(JUMP_NOISES * max(noise, 0.3), JUMP_CONTRAST * contrast)
    return bool(jumps.size and (jumps > limit).mean() > BANDED_PART)


def _by_place(bands: Strip) -> Strip:
    """Return a strip each of whose rows is a place along the shaft, which leans in the image."""
    if (bands.valid.sum(axis=1) < 2).any():
        return bands
    count, middle = bands.valid.shape[1], bands.lever.shape[2] // 2
    rows = np.arange(count)[:, None]
    sources = []
    for lever, counts in zip(bands.lever, bands.valid, strict=True):
        beside = counts @ lever / counts.sum()
        away = counts * (rows[:, 0] - counts @ rows[:, 0] / counts.sum())
        by_row = away @ lever[:, middle] / (away @ away)
        further = (beside - beside[middle]) / by_row
        sources.append(rows - np.rint(further).astype(np.intp))
    source = np.array(sources)
    inside = (source >= 0) & (source < count)
    source = np.clip(source, 0, count - 1)
    valid = np.take_along_axis(bands.valid[..., None], source, axis=1) * inside
    near, x_px, lever = (
        np.take_along_axis(values, source, axis=1)
        for values in (bands.near, bands.x_px, bands.lever)
    )
    return replace(bands, near=near, x_px=x_px, lever=lever, valid=valid.min(axis=-1))


def _linearized(bands: Strip, estimate: Floats, inner_px: float) -> _Rows:
    """Eliminate every row's two levels."""
    blur = float(estimate[4])
    offset, tilt = (estimate[k:4:2][:, None, None] for k in (0, 1))
    x = bands.x_px - bands.scale * (offset + tilt * bands.lever)
    used = ((x > -inner_px) & (x < OUTER_PX)) * bands.valid[..., None]
    z = x / blur
    bell = np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi)
    outside = normal_cdf(z, bell)
    values = np.stack([outside * used, (1 - outside) * used], axis=-2)
    gram = values @ np.swapaxes(values, -1, -2) + 1e-9 * np.eye(2)
    levels = np.linalg.solve(gram, values @ (bands.near * used)[..., None])[..., 0]
    contrast = levels[..., 0] - levels[..., 1]
    residual = bands.near * used - np.einsum("erk,erkc->erc", levels, values)
    slope = -(contrast[..., None] * bell / blur) * used
    columns = np.stack([slope, slope * z], axis=-2)
    mixed = values @ np.swapaxes(columns, -1, -2)
    columns = columns - np.swapaxes(np.linalg.solve(gram, mixed), -1, -2) @ values
    information = columns @ np.swapaxes(columns, -1, -2)
    gradient = (columns @ residual[..., None])[..., 0]
    return _Rows(information, gradient, residual, used, contrast, x)


def _trusted(rows: _Rows) -> tuple[Floats, Floats]:
    """Return the variance (grey²) and the weight (0 to 1) of every row.

    A row's own variance is its residuals', but no less than the usual; its weight falls with its
    offset in standard deviations, of what the rows scatter about the line.
    """
    informed = rows.information[..., 0, 0]
    seen = (rows.used.sum(axis=-1) > 4) & (informed > 0.02 * np.median(informed, axis=1)[:, None])
    square = rows.square
    usual = max(float(np.median(square[seen])) if seen.any() else 1.0, 1 / 12)
    variance = np.maximum(square, usual)
    own, weight = rows.own_px, np.zeros(informed.shape)
    sigma = np.sqrt(variance / np.maximum(informed, 1e-9))
    for edge in range(2):
        at = seen[edge]
        if not at.any():
            continue
        ratio = own[edge] / sigma[edge]
        scatter = max(1.4826 * float(np.median(np.abs(ratio[at]))), 1.0)
        part = (ratio / (ROW_SIGMAS * scatter)) ** 2
        weight[edge] = at * np.clip(1 - part, 0, None) ** 2 / scatter**2
    return variance, weight


def _solved(bands: Strip, rows: _Rows, weight: Floats, estimate: Floats) -> tuple[Floats, Floats]:
    """Return the step of offsets, tilts and blur, and their covariance."""
    whole, right = np.zeros((5, 5)), np.zeros(5)
    lever = bands.lever[..., bands.lever.shape[2] // 2]
    scale = bands.scale[..., 0]
    for edge, own in enumerate(([0, 1, 4], [2, 3, 4])):
        ones = np.ones_like(lever[edge])
        design = np.zeros((len(ones), 2, 3))
        design[:, 0, 0], design[:, 0, 1] = scale[edge], scale[edge] * lever[edge]
        design[:, 1, 2] = ones
        told = rows.information[edge] * weight[edge, :, None, None]
        moved = rows.gradient[edge] * weight[edge, :, None]
        whole[np.ix_(own, own)] += np.einsum("rik,rij,rjl->kl", design, told, design)
        right[own] += np.einsum("rik,ri->k", design, moved)
    whole[4, 4] += 1 / BLUR_SIGMA_PX**2
    right[4] += (FIRST_BLUR_PX - estimate[4]) / BLUR_SIGMA_PX**2
    covariance = np.asarray(np.linalg.inv(whole + np.diag(1e-9 * np.diag(whole) + 1e-9)))
    return covariance @ right, covariance


def _profile(rows: _Rows, weight: Floats) -> float:
    """Return the largest mean residual across an edge, in parts of the contrast, beyond chance.

    Chance is three standard errors of the chunks' own means: textured surroundings differ from
    chunk to chunk, a limb is the same in all.
    """
    part = weight[..., None] * rows.used
    step = rows.contrast[..., None]
    count, bins = weight.shape[1] // CHUNK_ROWS, PROFILE_BINS
    place = np.clip(np.rint(rows.x_px).astype(np.intp) + bins // 2, 0, bins - 1)
    chunk = np.arange(weight.size)[:, None] // CHUNK_ROWS
    flat = (chunk * bins + place.reshape(weight.size, -1)).ravel()
    moved, total = (
        np.bincount(flat, values.ravel(), 2 * count * bins).reshape(2, count, bins)
        for values in (part * rows.residual * step, part * step**2)
    )
    whole = np.maximum(total.sum(axis=1), 1e-9)
    mean = moved.sum(axis=1) / whole
    error = np.sqrt(((moved - mean[:, None] * total) ** 2).sum(axis=1)) / whole
    full = whole > 0.3 * whole.max()
    return float((np.abs(mean) - PROFILE_ERRORS * error)[full].max())
