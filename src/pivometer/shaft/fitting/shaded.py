"""The fit of a shaft whose grey levels are not flat: shaded, striped, or before clutter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.cameras.model import Camera
from pivometer.shaft.fitting.bands import gather
from pivometer.shaft.fitting.evidence import saturated_part
from pivometer.shaft.fitting.fitted import FittedEdges
from pivometer.shaft.fitting.lines import Lines, width_px
from pivometer.shaft.fitting.profile import BLUR_RANGE_PX, Bands, Fit, Model, linearize
from pivometer.shaft.fitting.refusals import extrapolates
from pivometer.shaft.fitting.weights import RowTrust, trust_rows

INNER_PX = 5.0
OUTER_PX = 4.0
"""Reach of the fit to each side at usual blur. Wider windows meet highlights and clutter: on the
black glossy arm 6 px gave 0.030 px per edge, 4 to 5 px 0.016 to 0.023."""

CLEAR_PX = 3.0
"""Reach to both sides in chunks that the model does not fit: on the black arm this brought the
edges' error from 0.10 to 0.06 px rms and that of the largest RCM distance from 0.03 to 0.01 mm."""

MISFIT_TIMES = 1.3
"""A chunk whose mean square residual is over 1.3 times the noise's does not fit the model: chunks
have 200 pixels and more, so that noise alone scatters by 10 %. On the black arm 1.3, 1.5 and 2
gave edges good to 0.06, 0.08 and 0.10 px rms."""

CLOSE_PX = 2.5
"""Reach of the windows that the fit is compared with, inside of one and outside of the other: with
3 px lanes of brushed metal moved both alike, and 2 px tell little before noise."""

CHUNK_ROWS = 24
"""Rows that share inside grey levels: on the black arm, 8, 12, 16 and 24 rows gave edges good to
0.125, 0.061, 0.061 and 0.056 px rms; longer ones would mix a collar with what is beside it."""

FIRST_BLUR_PX = 0.75
"""A lens of 0.7 px and the pixel's own 0.29 px: inside what the fit converges from."""

LARGEST_MISFIT_PART = 0.3
CLUTTER_TIMES = 2.0
LARGEST_NOISE_RISE = 1.15
"""Surroundings are cluttered, and the fit stays guarded, if more than 3 in 10 chunks have over
twice the noise's mean square (shot noise alone makes a bright chunk differ by up to 1.7, and the
ends of a white shaft before black spoil 2 in 10), or if the noise appears 15 % larger than with
grey levels of their own in every row."""

SHADED_SYSTEMATIC_PX = 0.01
CLUTTERED_SYSTEMATIC_PX = 0.02
"""What shading that no model has moves a whole edge by: on the white bearing and the black arm
(independently rendered, true cameras) edges were 0.009 and 0.02 px off at their middle where noise
alone stated 0.002 and 0.012 px. Added to each edge's offset and tilt where a limb is needed."""

LADDER_HALF_PX = 6.0
"""In wider shafts `ladder` has found that no simple model holds."""

TRIAL_ITERATIONS = 4
"""Iterations until that is decided."""

WIDE_INNER_PX = 12.0
WIDE_OUTER_PX = 6.0
"""Reach where nothing disturbs: a limb is told from a shift of its edge by what is further in."""

RISE_SIGMAS = 3.0
"""Grey levels are dropped where χ² rises by less than three standard deviations of their number."""

ITERATIONS = 9
FIRST_ITERATIONS = 5
"""Iterations before it is decided which chunks the model fits; then at most the rest."""

STEP_LIMIT_PX = np.array([1.0, 1.0, 1.0, 1.0, 0.2])
CONVERGED_CHI2 = 0.04
"""A step that gains less moves no estimate by more than a fifth of its uncertainty."""


def fit_shaded(
    image: NDArray[np.generic], camera: Camera, start: Lines, blur_px: float
) -> FittedEdges:
    """Return the maximum-likelihood edges near `start`: first guarded, then as simple as fits."""
    widen = max(1.0, blur_px)
    narrow = (INNER_PX * widen, OUTER_PX * widen)
    half = width_px(start) / 2
    model = Model(ramp=half >= INNER_PX / 2, limb=half >= INNER_PX, cluttered=True)
    bands = _gather(image, camera, start, narrow)
    first = np.array([0.0, 0.0, 0.0, 0.0, blur_px])
    half_of_it = _every_other_row(bands)
    fit, trust = _iterate(half_of_it, first, None, model, FIRST_ITERATIONS)
    fit, trust = _iterate(bands, fit.parameters, None, model, 2)
    if fit.parameters[4] > 1.3 * widen:
        solution = _solution(image, start, bands, fit, trust, model)
        return fit_shaded(image, camera, solution.lines, float(fit.parameters[4]))
    if half < LADDER_HALF_PX * widen:
        simple = _simplest(image, camera, _solution(image, start, bands, fit, trust, model), model)
        if simple is not None:
            return simple
    misfit = _misfit(bands, fit, trust, model) > MISFIT_TIMES
    far = np.abs(bands.distances(fit.parameters)) > CLEAR_PX * widen
    valid = np.where(misfit[..., None, None] & far, 0.0, bands.valid)
    bands = replace(bands, valid=valid)
    fit, trust = _iterate(bands, fit.parameters, trust, model, ITERATIONS)
    solution = _solution(image, start, bands, fit, trust, model)
    if model.limb and extrapolates(solution):
        # A limb beside a highlight is bent up to levels that no pixel has: without one are none.
        model = replace(model, limb=False)
        fit, trust = _iterate(bands, first, None, model, ITERATIONS)
        solution = _solution(image, start, bands, fit, trust, model)
    return _with_spread(solution, bands, trust, model, CLOSE_PX * widen)


def _with_spread(
    solution: FittedEdges, bands: Bands, trust: RowTrust, model: Model, close_px: float
) -> FittedEdges:
    """Return the solution less certain by how far windows move it that reach less far.

    Were the model true, all of them would tell the same edges.
    """
    distances = bands.distances(solution.parameters)
    covariance = solution.covariance.copy()
    for close in (distances > -close_px, distances < close_px):
        closer = replace(bands, valid=bands.valid * close)
        again, _ = _iterate(closer, solution.parameters, trust, model, ITERATIONS)
        covariance[range(4), range(4)] += (again.parameters - solution.parameters)[:4] ** 2
    return replace(solution, covariance=covariance)


def _every_other_row(bands: Bands) -> Bands:
    """Return half of the rows of every chunk."""
    return Bands(
        bands.grey[:, :, ::2],
        bands.distance_px[:, :, ::2],
        bands.lever[:, :, ::2],
        bands.scale[:, :, ::2],
        bands.valid[:, :, ::2],
        bands.half_width_px[:, :, ::2],
    )


def _gather(
    image: NDArray[np.generic],
    camera: Camera,
    lines: Lines,
    reach_px: tuple[float, float],
) -> Bands:
    half = width_px(lines) / 2
    return gather(
        image,
        camera,
        lines,
        inner_px=min(reach_px[0], half),
        outer_px=reach_px[1],
        half_width_px=half,
        chunk_rows=CHUNK_ROWS,
    )


def _simplest(
    image: NDArray[np.generic], camera: Camera, solution: FittedEdges, model: Model
) -> FittedEdges | None:
    """Return the fit with the fewest grey levels that explain the pixels, in wider windows.

    None if the surroundings are too cluttered for grey levels in common to a chunk.

    Every grey level that is not needed costs certainty: free ones in every row and a limb where
    there is none make it four times the bound.
    """
    noise = solution.noise_grey
    blur = float(solution.parameters[4])
    lines = solution.lines
    widen = max(1.0, blur)
    bands = _gather(image, camera, lines, (WIDE_INNER_PX * widen, WIDE_OUTER_PX * widen))
    model = Model(ramp=model.ramp, limb=model.limb, cluttered=False)
    first = np.array([0, 0, 0, 0, blur])
    fit, trust = _iterate(bands, first, None, model, TRIAL_ITERATIONS)
    misfit = (_misfit(bands, fit, trust, model) > CLUTTER_TIMES).mean()
    if misfit > LARGEST_MISFIT_PART or trust.noise_grey > LARGEST_NOISE_RISE * noise:
        return None
    weights = bands.valid * trust.weights[..., None]
    for ramp in (False, True):
        simple = Model(ramp=ramp, limb=False, cluttered=False)
        if simple.inside_terms >= model.inside_terms:
            break
        trial = linearize(bands, fit.parameters, weights, simple)
        gain = trial.step(weights)[1]
        rise = float((weights * (trial.residual**2 - fit.residual**2)).sum()) - gain
        levels = (model.inside_terms - simple.inside_terms) * bands.grey.shape[1] * 2
        if rise < (levels + RISE_SIGMAS * np.sqrt(2 * levels)) * trust.noise_grey**2:
            model = simple
            break
    fit, trust = _iterate(bands, fit.parameters, trust, model, ITERATIONS)
    return _solution(image, lines, bands, fit, trust, model)


def _iterate(
    bands: Bands, parameters: Floats, before: RowTrust | None, model: Model, count: int
) -> tuple[Fit, RowTrust]:
    """Return the fit after up to `count` Gauss–Newton steps, each with the weights of the last."""
    weights = bands.valid if before is None else bands.valid * before.weights[..., None]
    fit = linearize(bands, parameters, weights, model)
    trust = trust_rows(bands, fit, model)
    for _ in range(count - 1):
        weights = bands.valid * trust.weights[..., None]
        step, gain = fit.step(weights)
        parameters = parameters + np.clip(step, -STEP_LIMIT_PX, STEP_LIMIT_PX)
        parameters[4] = np.clip(parameters[4], *BLUR_RANGE_PX)
        if gain < CONVERGED_CHI2 * trust.noise_grey**2:
            return Fit(parameters, fit.jacobian, fit.residual, fit.contrast), trust
        fit = linearize(bands, parameters, weights, model)
        trust = trust_rows(bands, fit, model)
    return fit, trust


def _misfit(bands: Bands, fit: Fit, trust: RowTrust, model: Model) -> Floats:
    """Return the mean square residual of each chunk over the noise's, shape (edges, chunks)."""
    used = bands.valid * trust.accepted[..., None]
    levels = model.levels_per_row(bands.grey.shape[2]) * trust.accepted.sum(axis=-1)
    freedom = np.maximum(used.sum(axis=(-1, -2)) - levels, 1)
    square = (used * fit.residual**2).sum(axis=(-1, -2)) / freedom
    return np.asarray(square / trust.noise_grey**2)


def _solution(
    image: NDArray[np.generic],
    start: Lines,
    bands: Bands,
    fit: Fit,
    trust: RowTrust,
    model: Model,
) -> FittedEdges:
    """Return the fit with its covariance, raised by the scatter of the chunks' own offsets."""
    information = fit.normal_equations(bands.valid * trust.weights[..., None])[0]
    information = information / trust.noise_grey**2
    inverse = np.linalg.inv(information + np.diag(1e-9 * np.diag(information) + 1e-9))
    covariance = np.asarray(inverse * _chunk_inflation(bands, fit, trust), dtype=np.float64)
    if model.limb:
        systematic = CLUTTERED_SYSTEMATIC_PX if model.cluttered else SHADED_SYSTEMATIC_PX
        covariance[range(4), range(4)] += systematic**2
    weight = (bands.valid * fit.jacobian[..., 0] ** 2).sum(axis=-1) / trust.noise_grey**2
    total = np.maximum(trust.weights.sum(axis=(1, 2)), 1e-12)
    rows = (2, -1)
    return FittedEdges(
        start=start,
        parameters=fit.parameters,
        covariance=covariance,
        contrast=(trust.weights * np.abs(fit.contrast)).sum(axis=(1, 2)) / total,
        noise_grey=trust.noise_grey,
        lever=bands.lever[..., bands.lever.shape[-1] // 2].reshape(rows),
        offset_px=trust.offset_px.reshape(rows),
        weight=(weight * trust.weights).reshape(rows),
        accepted=trust.accepted.reshape(rows),
        counted=np.asarray(bands.valid.any(axis=-1)).reshape(rows),
        saturated_part=saturated_part(
            bands.grey.reshape(2, -1, bands.grey.shape[-1]),
            trust.accepted.reshape(rows),
            image.dtype,
        ),
        shading=model.name,
        overshoot=_overshoot(bands, fit, trust),
    )


def _overshoot(bands: Bands, fit: Fit, trust: RowTrust) -> Floats:
    """Return each edge's grey step over the range of grey levels in the same rows, shape (2,)."""
    seen = bands.valid > 0
    highest = np.where(seen, bands.grey, -np.inf).max(axis=-1)
    lowest = np.where(seen, bands.grey, np.inf).min(axis=-1)
    spread = np.where(seen.any(axis=-1), highest - lowest, 0.0)
    step = (trust.weights * np.abs(fit.contrast)).sum(axis=(1, 2))
    return np.asarray(step / np.maximum((trust.weights * spread).sum(axis=(1, 2)), 1e-9))


def _chunk_inflation(bands: Bands, fit: Fit, trust: RowTrust) -> float:
    """Return how much the chunks' own offsets scatter beyond the rows' variances, at least 1."""
    information = (bands.valid * fit.jacobian[..., 0] ** 2).sum(axis=-1)
    information = trust.weights * information / trust.noise_grey**2
    chunk = information.sum(axis=-1)
    offset = (information * trust.offset_px).sum(axis=-1)
    chi2 = float((offset[chunk > 0] ** 2 / chunk[chunk > 0]).sum())
    return max(1.0, chi2 / max(int((chunk > 0).sum()) - 4, 1))
