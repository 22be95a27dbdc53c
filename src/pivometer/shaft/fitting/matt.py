"""Both edges of a matt round shaft, fitted at once to the shading of its whole width.

What a matt surface scatters goes as the cosine of the light's incidence (Lambert), so around a
shaft that all lights reach it is f(θ) = a + b sin θ + c cos θ, however many they are. A window
about one edge has these terms too; but with levels in common to both edges, the whole width tells
what they are, and the pixels beside the edges are left to tell where these are: twice as well as in
windows of 12 px. So it is one more window, the most certain of all, and must agree with the others.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pivometer._arrays import Floats
from pivometer.shaft.fitting.lines import halves_px
from pivometer.shaft.fitting.rungs import (
    IN,
    LIMB,
    OUT,
    OUT_RAMP,
    RAMP,
    Blur,
    Rung,
    mean_misfits,
    terms_of,
)
from pivometer.shaft.fitting.samples import Samples, binned, pixels
from pivometer.shaft.fitting.strip import strip
from pivometer.shaft.fitting.view import ShaftView
from pivometer.shaft.fitting.whole_width import LARGEST_HALF_PX

ROUND = Rung(np.inf, 6.0, (OUT, OUT_RAMP, IN, RAMP, LIMB))
SPARE_PX = 1.0

OWN, COMMON = 2, 3
LEVELS = 2 * OWN + COMMON
"""Of a chunk: outside a level and a ramp beside either edge, inside a, b and c."""

HOPELESS_MISFIT = 30.0
"""A misfit that is left if the model is taken as linear; at ten times what counts no step helps."""

ITERATIONS = 5
DONE_PX = 0.003
STEP_LIMIT_PX = np.array([0.3, 0.3, 0.3, 0.3, 0.2])


@dataclass(frozen=True, slots=True, eq=False)
class Matt:
    """What the shading of a whole width says of both edges.

    Parameters
    ----------
    parameters, covariance
        Offset and tilt of both edges and the blur, undistorted px, shapes (5,) and (5, 5).
    misfits
        By how many standard deviations each edge's mean residual across exceeds noise.
    """

    parameters: Floats
    covariance: Floats
    misfits: tuple[float, float]


def fit_matt(
    view: ShaftView,
    rows: Floats,
    parameters: Floats,
    *,
    noise: float,
    blur: Blur,
) -> Matt | None:
    """Return both edges as if the shaft were matt, or None where it does not look so at all.

    Parameters
    ----------
    view
        The image, and the lines that offsets and tilts are from.
    rows
        1 for the rows that count, shape (2, rows).
    parameters
        Where the edges are, and the blur, to a hundredth of a pixel or so, shape (5,).
    noise
        Standard deviation of a pixel, grey levels.
    blur
        What is known of the blur beforehand.
    """
    samples = _across(view, rows, parameters)
    if samples is None:
        return None
    for _ in range(ITERATIONS):
        fit = _evaluated(samples, parameters)
        step, covariance = fit.solved(noise, blur, parameters)
        left = fit.misfits(step, noise)
        if max(left) > HOPELESS_MISFIT:
            return None
        parameters = parameters + np.clip(step, -STEP_LIMIT_PX, STEP_LIMIT_PX)
        if np.abs(step).max() < DONE_PX:
            break
    return Matt(parameters, covariance * max(1.0, fit.variance / noise**2), left)


def _across(view: ShaftView, rows: Floats, parameters: Floats) -> Samples | None:
    """Return the means over bins of all pixels from beside either edge to the axis."""
    ends = halves_px(view.lines, np.array([[[-1.0], [1.0]]] * 2))
    reach = float(ends.max()) + SPARE_PX
    if reach > LARGEST_HALF_PX:
        return None
    outer = ROUND.outer_px + SPARE_PX
    bands = strip(view, near_px=(reach, outer))
    half = halves_px(view.lines, bands.lever[..., bands.lever.shape[2] // 2, None]) * bands.scale
    seen = pixels(bands, half, rows * bands.valid, None, slice(None))
    means = binned(seen, parameters, (-float(half.max()) - SPARE_PX, ROUND.outer_px))
    inside = means.moved(parameters) > -_radius(means, parameters)
    return replace(means, count=means.count * inside)


def _radius(samples: Samples, parameters: Floats) -> Floats:
    """Return half the width between edges at these parameters, raw px, shape (chunks, 1)."""
    moved = samples.count * (samples.x_px - samples.moved(parameters))
    total = np.maximum(samples.count.sum(axis=1), 1)
    moves = (moved.sum(axis=1) / total).reshape(2, -1).mean(axis=0)
    return np.asarray(samples.half_px + np.tile(moves, 2)[:, None])


class _Terms(NamedTuple):
    """Each edge's terms with their derivatives by distance, blur and, of the last, half the width.

    Shapes (2, chunks, OWN + COMMON, p) and (2, chunks, COMMON, p).
    """

    values: Floats
    slopes: Floats
    spreads: Floats
    widths: Floats


def _terms(samples: Samples, parameters: Floats) -> _Terms:
    """Return level and ramp outside, and 1, sin θ and cos θ inside, blurred."""
    x, blur, radius = samples.moved(parameters), float(parameters[4]), _radius(samples, parameters)
    told = terms_of(x, blur, replace(samples, half_px=radius), ROUND, slice(None))
    # Inward the ramp is R (1 − ξ), and sin θ is ξ towards the first edge.
    towards = np.where(samples.edge == 0, 1.0, -1.0)[:, None]
    for terms in told:
        terms[:, 3] = towards * (terms[:, 2] - terms[:, 3] / radius)
    # Those inside stay the same where distance, blur and radius grow alike.
    _, slopes, spreads = (terms[:, OWN:] for terms in told)
    widths = -(x[:, None] * slopes + blur * spreads) / radius[:, None]
    shape = (2, len(x) // 2, -1, x.shape[1])
    return _Terms(*(terms.reshape(shape) for terms in (*told, widths)))


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """The model at its best levels; all but counts and distances times the roots of the counts.

    Parameters
    ----------
    samples, x_px
        The grey levels, and their distances from the edges, shape (2 × chunks, p).
    columns
        Derivatives by offset and tilt of both edges and by the blur, and the residual, shape
        (chunks, 6, 2, p).
    products
        Their sums of products once the levels follow them, shape (6, 6).
    """

    samples: Samples
    x_px: Floats
    columns: Floats
    products: Floats

    @property
    def variance(self) -> float:
        """Mean square residual of a pixel, grey levels²."""
        freedom = int((self.samples.count > 0).sum()) - LEVELS * len(self.columns) - 5
        return float(np.square(self.columns[:, 5]).sum()) / max(freedom, 1)

    def solved(self, noise: float, blur: Blur, parameters: Floats) -> tuple[Floats, Floats]:
        """Return the step from here and the covariance."""
        whole, right = self.products[:5, :5] / noise**2, self.products[:5, 5] / noise**2
        whole[4, 4] += 1 / blur.sigma_px**2
        right[4] += (blur.mean_px - parameters[4]) / blur.sigma_px**2
        whole.flat[::6] = whole.flat[::6] * (1 + 1e-9) + 1e-9
        covariance = np.asarray(np.linalg.inv(whole))
        return covariance @ right, covariance

    def misfits(self, step: Floats, noise: float) -> tuple[float, float]:
        """Return each edge's misfit after a step."""
        left = self.columns[:, 5] - np.einsum("k,ckep->cep", step, self.columns[:, :5])
        left = np.moveaxis(left, 1, 0).reshape(self.x_px.shape)
        return mean_misfits(left, self.x_px, self.samples.count, self.samples.edge, noise)


def _evaluated(samples: Samples, parameters: Floats) -> _Fit:
    """Return the model with the levels of every chunk eliminated."""
    at = _terms(samples, parameters)
    _, chunks, _, p = at.values.shape
    root = np.moveaxis(np.sqrt(samples.count).reshape(2, chunks, p), 0, 1)
    grey = np.moveaxis(samples.grey.reshape(2, chunks, p), 0, 1)
    laid = np.zeros((chunks, LEVELS, 2, p))
    for edge, own in enumerate(at.values):
        laid[:, OWN * edge : OWN * (edge + 1), edge] = own[:, :OWN]
        laid[:, 2 * OWN :, edge] = own[:, OWN:]
    terms = (laid * root[:, None]).reshape(chunks, LEVELS, -1)
    gram = terms @ np.swapaxes(terms, -1, -2)
    size = np.trace(gram, axis1=-2, axis2=-1)[:, None, None]
    gram += (1e-9 * size + 1e-9) * np.eye(LEVELS)
    seen = (grey * root).reshape(chunks, -1, 1)
    levels = np.asarray(np.linalg.solve(gram, terms @ seen), dtype=np.float64)
    columns = _derivatives(samples, at, levels[..., 0])
    columns[:, 5] = grey - (np.swapaxes(levels, -1, -2) @ laid.reshape(terms.shape)).reshape(
        grey.shape
    )
    columns *= root[:, None]
    flat = columns.reshape(chunks, 6, -1)
    mixed = terms @ np.swapaxes(flat, -1, -2)
    products = flat @ np.swapaxes(flat, -1, -2)
    products -= np.swapaxes(mixed, -1, -2) @ np.linalg.solve(gram, mixed)
    return _Fit(samples, samples.moved(parameters), columns, products.sum(axis=0))


def _derivatives(samples: Samples, at: _Terms, levels: Floats) -> Floats:
    """Return the derivatives by offset and tilt of both edges and by the blur, (chunks, 6, 2, p).

    An edge that moves outward takes its own distances along, and widens the shaft by as much.
    """
    _, chunks, _, p = at.values.shape
    scale, lever = samples.scale.reshape(2, chunks, 1), samples.lever.reshape(2, chunks, p)
    columns = np.zeros((chunks, 6, 2, p))
    for edge in range(2):
        own = np.hstack([levels[:, OWN * edge : OWN * (edge + 1)], levels[:, 2 * OWN :]])[:, None]
        by_distance, by_blur = (own @ terms[edge] for terms in (at.slopes, at.spreads))
        by_half = own[..., OWN:] @ at.widths[edge]
        for moving in range(2):
            by_move = by_half / 2 - by_distance * (moving == edge)
            columns[:, 2 * moving, edge] = scale[moving] * by_move[:, 0]
            columns[:, 2 * moving + 1, edge] = columns[:, 2 * moving, edge] * lever[edge]
        columns[:, 4, edge] = by_blur[:, 0]
    return columns
