"""An edge of a shaft of whatever shading, before a known background that changes along it.

Lanes of brushed metal beside an edge look like the edge in every row, and no few terms have their
shape. Here the grey level at each distance from the edge is free in every chunk of rows, so that
shading tells nothing. What is left tells where the edge is: how far in the picture follows the
changes of the background from row to row, B Φ(x/s) about their mean. It is a second opinion, and
errs with nothing that misleads a fit to the shading.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pivometer._arrays import Floats
from pivometer.shaft.fitting.beside import best_levels, hats, shown_part
from pivometer.shaft.fitting.fitted import FittedEdges
from pivometer.shaft.fitting.ladder import inflation, known_behind
from pivometer.shaft.fitting.lines import width_px
from pivometer.shaft.fitting.rungs import OUT, Blur, Rest, Rung, eliminated, ridge_of, terms_of
from pivometer.shaft.fitting.samples import Behind, Samples, pixels
from pivometer.shaft.fitting.strip import strip
from pivometer.shaft.fitting.view import ShaftView

WINDOW = Rung(3.5, 4.0, (OUT,))
SPARE_PX = 1.0
KNOT_PX = 0.5
"""The free profile is linear between places so far apart: blur leaves nothing finer."""

ITERATIONS = 15
CONVERGED_CHI2 = 0.04
"""A step that gains less moves no estimate by more than a fifth of its uncertainty."""

STEP_LIMIT_PX = np.array([0.5, 0.5, 0.2])
BLUR_RANGE_PX = (0.3, 4.0)
BLUR_SIGMA_PX = 0.1
"""What the first fit tells of the blur, which lanes spoil a little."""

FARTHEST_PX = 2.0
"""An edge that goes so far from where it was found is another one."""

SYSTEMATIC_PX = 0.02
"""Of each chunk, and of the edge. In 13 drawn sessions chunks that noise alone states to 5 to 20
mpx were off by 1.4 times as much; and all are 0.01 px outward, as the blurred background stands for
the sharp one."""

HUBER_SIGMAS = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Lanes:
    """Offset and tilt of an edge, px, and their covariance (2, 2)."""

    parameters: Floats
    covariance: Floats


def with_lanes(view: ShaftView, fitted: FittedEdges, background: Floats) -> FittedEdges:
    """Return the mean of fitted edges and of what the background's changes tell of each.

    Both are weighted by their certainty. Where they differ by more than they state, so much less
    certain is their mean (Birge's ratio).

    Parameters
    ----------
    view
        The image.
    fitted
        The edges as another fit tells them; only its rows count.
    background
        What stands behind the shaft, turned likewise; NaN where unknown.
    """
    near = view.about(fitted.lines)
    blur = Blur(float(fitted.parameters[4]), BLUR_SIGMA_PX)
    widen = max(1.0, blur.mean_px)
    reach = WINDOW.inner_px * widen + SPARE_PX, WINDOW.outer_px * widen + SPARE_PX
    bands = strip(near, near_px=reach)
    behind, known = known_behind(near, background, reach, bands.x_px)
    rows = bands.valid * known * fitted.accepted_at(bands.lever.mean(axis=-1))
    half = np.full_like(bands.scale, width_px(near.lines) / 2)
    samples = pixels(bands, half, rows, behind, slice(None))
    parameters, covariance = fitted.parameters.copy(), fitted.covariance.copy()
    sides = samples.of_edge(0), samples.of_edge(1)
    for edge, side in enumerate(sides):
        lanes = fit_lanes(side, widen, blur, fitted.noise_grey)
        if lanes is None:
            continue
        at = slice(2 * edge, 2 * edge + 2)
        first, second = covariance[at, at].copy(), lanes.covariance
        gain = first @ np.linalg.inv(first + second)
        apart = lanes.parameters
        birge = max(1.0, float(apart @ np.linalg.solve(first + second, apart)) / 2)
        covariance[at] = covariance[:, at] = 0.0
        covariance[at, at] = (first - gain @ first) * birge
        parameters[at] += gain @ apart
    shown = np.array([shown_part(side, widen, fitted.noise_grey) for side in sides])
    return replace(fitted, parameters=parameters, covariance=covariance, shown_part=shown)


def fit_lanes(samples: Samples, widen: float, blur: Blur, noise: float) -> Lanes | None:
    """Return an edge by the background's changes; None where they do not lead to one.

    Parameters
    ----------
    samples
        The single pixels of one edge, and what stands behind it.
    widen
        What the window is multiplied by.
    blur
        What is known of the blur.
    noise
        Standard deviation of a pixel, grey levels.
    """
    x, behind = samples.x_px, samples.behind
    low, high = -WINDOW.inner_px * widen, WINDOW.outer_px * widen
    count = samples.count * ((x > low) & (x < high))
    if behind is None or not count.any():
        return None
    changes = replace(samples, count=count, behind=_changes(behind, x, count))
    profile = hats(x, np.linspace(low, high, round((high - low) / (KNOT_PX * widen)) + 1))
    own, prior = np.array([0.0, 0.0, blur.mean_px]), (noise / blur.sigma_px) ** 2
    for _ in range(ITERATIONS):
        rest = _weighted(_linearized(changes, profile, own), noise)
        normal, gradient = rest.information.sum(axis=0), rest.gradient.sum(axis=0)
        normal[2, 2] += prior
        gradient[2] += (blur.mean_px - own[2]) * prior
        normal[range(3), range(3)] += 1e-9 * normal.diagonal() + 1e-9
        inverse = np.asarray(np.linalg.inv(normal))
        step = inverse @ gradient
        own = own + np.clip(step, -STEP_LIMIT_PX, STEP_LIMIT_PX)
        own[2] = np.clip(own[2], *BLUR_RANGE_PX)
        if np.abs(own[:2]).sum() > FARTHEST_PX:
            return None
        if gradient @ step < CONVERGED_CHI2 * noise**2:
            covariance = inverse[:2, :2] * noise**2 * inflation([rest], noise)
            return Lanes(own[:2], covariance + SYSTEMATIC_PX**2 * np.eye(2))
    return None


def _weighted(rest: Rest, noise: float) -> Rest:
    """Return the normal equations with each chunk's misfit, its own error and Huber's weight.

    Where a shadow or something else beside the shaft is not in the background, single pixels tell
    it by residuals beyond the noise. Where one chunk tells nearly all, its error of a hundredth
    would pass for a tilt.
    """
    misfit = np.maximum(rest.variance()[0] / noise**2, 1.0)
    informed = np.maximum(rest.information[:, 0, 0] / noise**2 / misfit, 1e-12)
    own = 1 / (1 + SYSTEMATIC_PX**2 * informed)
    away = np.abs(rest.gradient[:, 0]) / noise**2 / misfit * np.sqrt(own / informed)
    weight = own / misfit * np.minimum(1.0, HUBER_SIGMAS / np.maximum(away, 1e-12))
    return replace(
        rest,
        information=rest.information * weight[:, None, None],
        gradient=rest.gradient * weight[:, None],
    )


def _changes(behind: Behind, x: Floats, count: Floats) -> Behind:
    """Return the background less each chunk's parabola across.

    A profile that is linear between its knots leaves a little of the parabola times Φ, which would
    pass for the edge: at a mean of 120 levels for more of it than changes of 2 levels tell.
    """
    basis = np.stack([np.ones_like(x), x, x * x], axis=1)
    levels = best_levels(basis, count, behind.grey[..., None])[..., 0]
    ramp = levels[:, 1:2] + 2 * levels[:, 2:] * x
    return Behind(behind.grey - (levels[:, None] @ basis)[:, 0], behind.slope - ramp)


def _linearized(samples: Samples, profile: Floats, own: Floats) -> Rest:
    """Return what is left of each chunk with offset, tilt and blur of the edge as given."""
    x = samples.x_px - samples.scale * (own[0] + own[1] * samples.lever)
    root = np.sqrt(samples.count)
    seen, slope, spread = terms_of(x, float(own[2]), samples, WINDOW, slice(None))
    values = np.concatenate([seen, profile], axis=1)
    levels, columns, rest = eliminated(
        values, slope, spread, samples.grey, root, samples.scale, samples.lever, ridge_of(samples)
    )
    return Rest(
        information=rest[:, :3, :3],
        gradient=rest[:, :3, 3],
        rung=WINDOW,
        blur_px=float(own[2]),
        levels=levels,
        behind=None,
        x_px=x,
        count=samples.count,
        residual=columns[:, 3],
        jacobian=columns[:, :3],
        edge=samples.edge,
        terms=values.shape[1],
    )
