"""The fit of a shaft so blurred that the blurs of its two edges meet, before any smooth background.

With x₁ and x₂ a pixel's distances outward from the two edges its grey level is
Σ (Bₑ + Rₑ xₑ) over the outside of each edge plus S (1 + λ v + ρ (v² − 1/3)) between them, all
blurred, where v goes from −1 to 1 across the shaft. The five levels are free in every chunk of
rows; so a background may rise, fall, and be darker than the shaft in one place and brighter in
another. All else is common to the shaft: λ, how it is lit from one side, and ρ, how it darkens
towards its rims; the blur, whose square is a parabola, as the circle of confusion is an affine
function of the place along the shaft's image; and a bow, by which a shaft this thin may bend. What
is stated is the straight line that is nearest to each edge over its whole length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.shaft.fitting.evidence import blurs_meet, saturated_part
from pivometer.shaft.fitting.fitted import FittedEdges
from pivometer.shaft.fitting.lines import Lines, moved_lines, width_px
from pivometer.shaft.fitting.profile import normal_cdf
from pivometer.shaft.fitting.refusals import FARTHEST_PX
from pivometer.shaft.fitting.strip import CHUNK_ROWS
from pivometer.shaft.fitting.thin import ThinRows, thin_rows
from pivometer.shaft.fitting.view import ShaftView

WIDER = 1.3
"""The blur may turn out so much larger than another fit has it; if it is larger still, wider
windows are looked at."""

TILTS, BLUR, GROWTH, CURVE, BOW, LIT, ROUND = (1, 3), 4, 5, 6, 7, 8, 9
PARAMETERS = 10
"""Parameters beside the offsets 0 and 2, px: tilts; mean square of the blur, its growth towards the
end and its curvature, px²; how far the middle lies outward of the first edge's ends; λ and ρ."""

EXPECTED = np.array([np.inf] * 8 + [0.15, 0.3])
"""Standard deviation of each before anything is seen. One rim of a real silicon probe is brighter
than its middle by 0.07; a matt rod that is half as bright at its rims has a ρ of −0.35. Where
blurs hide the shading, edges are as uncertain as these make them."""

STEP_LIMIT = np.array([1.0, 1.0, 1.0, 1.0, 3.0, 3.0, 3.0, 1.0, 0.2, 0.2])
BLUR_RANGE_PX = (0.3, 8.0)
ROUNDS, ITERATIONS = 3, 12
CONVERGED_PX = 0.01

LEVELS = 5
LEAST_USED = 0.4
GATE_SIGMAS = 5.0

SEED_PX = 2.0
"""What a seed of sharp edges is good to. A search sees the grey steps of edges whose blurs meet
farther apart than they are, each by a blur at most: so far is the steepest place of a blurred thin
line from its middle."""

TOGETHER = (1, 3, 9)
"""Chunks whose offsets are summed to see how far they scatter: what no level holds moves chunks
that follow one another alike."""

LARGEST_SHADING = 1e12

SHADING_PART = 0.5
"""The part of what λ and ρ move the edges by that is uncertain, as real shading is not the same all
along a shaft; as between the models of sharp edges, half of their difference."""

SYSTEMATIC_BLURS = 0.02
"""What shading that the model has not moves an edge by, in blurs: as of shaded edges, whose 0.02 px
were found at a blur of 0.7 to 0.9 px. Chosen, not measured."""


@dataclass(frozen=True, slots=True, eq=False)
class _Shape:
    """The blurred parts of the profile at every pixel, before levels; (2, rows, k) or (rows, k)."""

    outside: Floats
    bell: Floats
    z: Floats
    ramps: Floats
    inside: Floats
    side: Floats  # v over the inside
    rim: Floats  # v² − 1/3 over it
    blur: Floats
    half: Floats


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """One linearization; chunks of p pixels."""

    information: Floats  # (chunks, PARAMETERS, PARAMETERS)
    gradient: Floats  # (chunks, PARAMETERS)
    levels: Floats  # B₁, B₂, S, R₁, R₂; (chunks, 5)
    residual: Floats  # (chunks, p)
    jacobian: Floats  # (chunks, PARAMETERS, p)

    @property
    def own_information(self) -> Floats:
        """What each chunk tells of either edge's offset, the other held, shape (2, chunks)."""
        return np.stack([self.information[:, k, k] for k in (0, 2)])

    @property
    def own_gradient(self) -> Floats:
        """Its gradient by either edge's offset, shape (2, chunks)."""
        return np.stack([self.gradient[:, k] for k in (0, 2)])


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """Where the iteration ended."""

    rows: ThinRows
    view: ShaftView
    fit: _Fit
    parameters: Floats
    weights: Floats
    variance: Floats  # (chunks,)

    @property
    def blur_px(self) -> float:
        """Root mean square of the blur along the shaft."""
        return float(np.sqrt(self.parameters[BLUR]))

    @property
    def moved(self) -> Lines:
        """The fitted edges."""
        return moved_lines(self.view.lines, self.parameters)


def fit_defocused(view: ShaftView, blur_px: float) -> FittedEdges | None:
    """Return both edges, or None where they are not so blurred or too few rows agree.

    Parameters
    ----------
    view
        The image, and the edges to about a blur.
    blur_px
        The blur as another fit has it.
    """
    if not blurs_meet(width_px(view.lines), blur_px * WIDER):
        return None
    blur = float(np.clip(blur_px, *BLUR_RANGE_PX))
    found = _iterated(view, blur)
    if found.blur_px > WIDER * blur:
        found = _iterated(view, found.blur_px)
    if found.weights.sum() < LEAST_USED * max(1.0, float(found.rows.valid.sum())):
        return None
    if not blurs_meet(width_px(found.moved), found.blur_px) or _strays(found):
        return None
    return _fitted(found)


def _iterated(view: ShaftView, blur: float) -> _Found:
    """Return the fit from a start; what does not take part is told by the fit before, twice."""
    rows = thin_rows(view, blur)
    parameters, weights, shading = np.zeros(PARAMETERS), rows.valid, 0.0
    parameters[BLUR] = blur**2
    for _ in range(ROUNDS):
        parameters, fit = _settled(rows, weights, parameters, shading)
        used, variance = weights, _variances(rows, weights, fit)
        shading = _shading(fit, variance)
        weights = rows.valid * _alike_rows(rows, fit) * _seeing_chunks(rows, fit, parameters)
    return _Found(rows, view, fit, parameters, used, variance + shading * _effect(fit))


def _settled(
    rows: ThinRows, weights: Floats, parameters: Floats, shading: float
) -> tuple[Floats, _Fit]:
    """Return the most likely parameters, by Gauss–Newton steps, and the fit with them."""
    for _ in range(ITERATIONS):
        fit = _linearize(rows, weights, parameters)
        variance = _variances(rows, weights, fit) + shading * _effect(fit)
        gradient = (fit.gradient / variance[:, None]).sum(axis=0) - parameters / EXPECTED**2
        step = np.linalg.solve(_information(fit, variance), gradient)
        if np.abs(step).max() < CONVERGED_PX:
            break
        parameters = parameters + np.clip(step, -STEP_LIMIT, STEP_LIMIT)
        parameters[BLUR] = np.clip(parameters[BLUR], *np.square(BLUR_RANGE_PX))
    return parameters, fit


def _information(fit: _Fit, variance: Floats) -> Floats:
    whole = (fit.information / variance[:, None, None]).sum(axis=0)
    return np.asarray(whole + np.diag(1 / EXPECTED**2 + 1e-9))


def _bowed(lever: Floats) -> Floats:
    """Return how far outward a bow of 1 px is from the line nearest to it, (2, …).

    Both edges bow alike: the middle of the first lies outward then, of the second inward.
    """
    outward = np.array([-1.0, 1.0]).reshape(2, *[1] * (lever.ndim - 1))
    return np.asarray(outward * (lever**2 - 1 / 3))


def _blur(parameters: Floats, along: Floats) -> Floats:
    """Return the blur at places along the shaft, px."""
    square = parameters[BLUR] + parameters[GROWTH] * along + parameters[CURVE] * (along**2 - 1 / 3)
    return np.asarray(np.clip(np.sqrt(np.maximum(square, 0.0)), *BLUR_RANGE_PX))


def _shape(rows: ThinRows, parameters: Floats) -> _Shape:
    blur = _blur(parameters, rows.lever.mean(axis=(0, 2))[:, None])
    offset, tilt = (parameters[k:4:2][:, None, None] for k in (0, 1))
    moved = offset + tilt * rows.lever + parameters[BOW] * _bowed(rows.lever)
    x = rows.x_px - rows.scale * moved
    half = np.maximum(-x.sum(axis=0) / 2, 1.0)
    z = x / blur
    density = np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi)
    outside = normal_cdf(z, density)
    ramps = x * outside + blur * density
    squares = (x * x + blur**2) * outside + blur * x * density  # of x over the outside, blurred
    inside, v = 1 - outside.sum(axis=0), (x[1] - x[0]) / 2 / half
    beyond = outside + ramps / half
    rim = v**2 + (blur / half) ** 2 - (beyond + ramps / half + squares / half**2).sum(axis=0)
    side = v + beyond[0] - beyond[1]
    return _Shape(outside, density / blur, z, ramps, inside, side, rim - inside / 3, blur, half)


def _linearize(rows: ThinRows, weights: Floats, parameters: Floats) -> _Fit:
    form, lit, round_ = _shape(rows, parameters), parameters[LIT], parameters[ROUND]
    shaded = form.inside + lit * form.side + round_ * form.rim
    shape = (len(weights) // CHUNK_ROWS, -1)

    def flat(values: Floats) -> Floats:
        return np.asarray(np.broadcast_to(values, rows.grey.shape).reshape(shape))

    used = flat(weights[:, None])
    terms = np.stack([flat(t) for t in (*form.outside, shaded, *form.ramps)], axis=1)
    terms *= used[:, None]
    gram = terms @ np.swapaxes(terms, -1, -2)
    gram += (1e-9 * np.trace(gram, axis1=1, axis2=2)[:, None, None] + 1e-9) * np.eye(LEVELS)
    grey = flat(rows.grey) * used
    levels = np.asarray(np.linalg.solve(gram, terms @ grey[..., None])[..., 0])
    residual = grey - (levels[:, None] @ terms)[:, 0]
    # Levels that rise within a chunk look like a tilt of both edges there, so only the chunks'
    # own offsets tell the tilt, and their own blurs how the blur grows.
    lever = rows.lever.reshape(2, len(gram), -1).mean(axis=-1)[..., None]
    bowed, middle = _bowed(lever), lever.mean(axis=0)
    beside = _beside(levels, weights.reshape(shape[0], -1).sum(axis=1) > 0)
    inner, half, blur = beside[:, 2:3], flat(form.half), flat(form.blur)
    columns = np.zeros((len(gram), PARAMETERS, terms.shape[-1]))
    for edge, side in ((0, -lit), (1, lit)):
        step = beside[:, edge : edge + 1] - inner * (1 + side + round_ * 2 / 3)
        rise = beside[:, 3 + edge : 4 + edge] - inner * (side + 2 * round_) / half
        bell = flat(form.bell[edge]) * used
        across = -flat(rows.scale[edge]) * (step * bell + rise * flat(form.outside[edge]) * used)
        columns[:, 2 * edge] = across
        columns[:, TILTS[edge]] = across * lever[edge]
        columns[:, BOW] += across * bowed[edge]
        columns[:, BLUR] += (rise * blur - step * flat(form.z[edge])) * bell / (2 * blur)
    columns[:, GROWTH] = columns[:, BLUR] * middle
    columns[:, CURVE] = columns[:, BLUR] * (middle**2 - 1 / 3)
    columns[:, LIT] = used * inner * flat(form.side)
    columns[:, ROUND] = used * inner * flat(form.rim)
    mixed = terms @ np.swapaxes(columns, -1, -2)
    solved: Floats = np.swapaxes(mixed, -1, -2) @ np.linalg.inv(gram)
    information = columns @ np.swapaxes(columns, -1, -2) - solved @ mixed
    gradient = np.asarray((columns @ residual[..., None])[..., 0])
    return _Fit(information, gradient, levels, residual, columns)


def _beside(levels: Floats, used: NDArray[np.bool_]) -> Floats:
    """Return the mean levels of the chunks before and after each one, or its own.

    What stands behind a shaft moves a chunk's own levels and its residuals together, and so would
    move the edges.
    """
    seen, count = levels * used[:, None], used.astype(np.float64)
    total, around = np.zeros_like(levels), np.zeros_like(count)
    for one, other in ((slice(1, None), slice(-1)), (slice(-1), slice(1, None))):
        total[one] += seen[other]
        around[one] += count[other]
    return np.where(around[:, None] > 0, total / np.maximum(around, 1)[:, None], levels)


def _variances(rows: ThinRows, weights: Floats, fit: _Fit) -> Floats:
    """Return each chunk's mean square residual: bright parts are noisier, clutter more so."""
    count = weights.reshape(-1, CHUNK_ROWS).sum(axis=1) * rows.grey.shape[1]
    square = (fit.residual**2).sum(axis=1)
    return np.where(count > 0, square / np.maximum(count - LEVELS, 1), 1.0) + 1 / 12


def _effect(fit: _Fit) -> Floats:
    """Return how shading of one grey level and px raises the chunks' variances, (chunks,).

    Grey levels that no level holds move an edge by a length in proportion to them, and inversely
    to the contrast; and an offset's variance is the pixels' over its information.
    """
    contrast = ((fit.levels[:, :2] - fit.levels[:, 2:3]) ** 2).mean(axis=1)
    return np.asarray(fit.own_information.mean(axis=0) / np.maximum(contrast, 1.0))


def _shading(fit: _Fit, variance: Floats) -> float:
    """Return how much of that the scatter of the chunks' own offsets tells, grey² px²."""
    own, gradient, effect, found = fit.own_information, fit.own_gradient, _effect(fit), 0.0

    def excess(size: float, together: int) -> float:
        begin = np.arange(0, own.shape[1], together)
        weight = 1 / (variance + size * effect)
        square = np.add.reduceat(gradient * weight, begin, axis=1) ** 2
        total = np.add.reduceat(own * weight, begin, axis=1)
        used = total > 1e-9
        return float((square[used] / total[used]).sum()) - max(int(used.sum()) - 5, 1)

    for together in TOGETHER:
        if excess(found, together) > 0:  # χ² falls with the size: bisection
            low, high = max(found, 1e-3), LARGEST_SHADING
            while high > 1.05 * low:
                middle = float(np.sqrt(low * high))
                low, high = (middle, high) if excess(middle, together) > 0 else (low, middle)
            found = high
    return found


def _alike_rows(rows: ThinRows, fit: _Fit) -> Floats:
    """Return 1 for the rows whose residuals are like those of most in their chunk."""
    square = (fit.residual.reshape(rows.grey.shape) ** 2).mean(axis=1)
    usual = np.median(square.reshape(-1, CHUNK_ROWS), axis=1)
    limit = np.repeat(usual, CHUNK_ROWS) * (1.2 + GATE_SIGMAS * np.sqrt(2 / rows.grey.shape[1]))
    return np.asarray(square <= limit, dtype=np.float64)


def _seeing_chunks(rows: ThinRows, fit: _Fit, parameters: Floats) -> Floats:
    """Return 1 for rows of chunks whose own offsets are under their blur: others see no edge."""
    along = rows.lever.mean(axis=(0, 2)).reshape(-1, CHUNK_ROWS).mean(axis=1)
    seeing = (np.abs(fit.own_gradient) < _blur(parameters, along) * fit.own_information).all(axis=0)
    return np.repeat(seeing, CHUNK_ROWS).astype(np.float64)


def _strays(found: _Found) -> bool:
    """Tell whether an end of the fit lies farther from the seed's than blur explains."""
    ends = np.array([-1.0, 1.0])
    limit = np.maximum(SEED_PX + _blur(found.parameters, ends), FARTHEST_PX)
    pairs = zip(found.moved, found.view.lines, strict=True)
    return any(
        bool((np.abs((a.at(ends) - b.at(ends)) @ b.outward) > limit).any()) for a, b in pairs
    )


def _fitted(found: _Found) -> FittedEdges:
    rows, fit, weights, variance = found.rows, found.fit, found.weights, found.variance
    whole = np.linalg.inv(_information(fit, variance))
    shading = slice(LIT, ROUND + 1)
    moved = whole[:4, shading] @ np.linalg.inv(whole[shading, shading])
    moved = moved * found.parameters[shading] * SHADING_PART
    covariance = whole[:5, :5]
    covariance[:4, :4] += moved @ moved.T
    covariance[BLUR] /= 2 * found.blur_px
    covariance[:, BLUR] /= 2 * found.blur_px
    covariance[range(4), range(4)] += (SYSTEMATIC_BLURS * found.blur_px) ** 2
    offset, information = _by_row(rows, fit)
    scale, both = rows.scale[:, 0], np.stack([weights, weights]) > 0
    nearest = np.abs(rows.x_px).argmin(axis=-1)[..., None]
    lever = np.take_along_axis(rows.lever, nearest, axis=-1)[..., 0]
    count = weights.reshape(-1, CHUNK_ROWS).sum(axis=1)
    steps = np.abs(fit.levels[:, :2] - fit.levels[:, 2:3])
    noise = _variances(rows, weights, fit)
    return FittedEdges(
        start=found.moved,
        parameters=np.array([0.0, 0.0, 0.0, 0.0, found.blur_px]),
        covariance=np.asarray(covariance),
        contrast=(steps * count[:, None]).sum(axis=0) / max(int(count.sum()), 1),
        noise_grey=float(np.sqrt(np.median(noise[count > 0]))),
        lever=lever,
        offset_px=(offset + found.parameters[BOW] * _bowed(lever)) * scale,
        weight=information / np.repeat(variance, CHUNK_ROWS) / scale**2,
        accepted=both & (information > 0),
        counted=np.stack([rows.valid, rows.valid]) > 0,
        saturated_part=saturated_part(np.stack([rows.grey] * 2), both, found.view.depth),
        shading="ramp",
        together=True,
    )


def _by_row(rows: ThinRows, fit: _Fit) -> tuple[Floats, Floats]:
    """Return the rows' own offsets from the fit, and what tells them, both (2, rows).

    The levels follow a move of a whole chunk, so its residuals show only a part of it.
    """
    across = np.moveaxis(fit.jacobian[:, [0, 2]], 1, 0).reshape(2, *rows.grey.shape)
    residual = fit.residual.reshape(rows.grey.shape)
    information = (across**2).sum(axis=-1)
    offset = (across * residual).sum(axis=-1) / np.maximum(information, 1e-9)
    whole = information.reshape(2, -1, CHUNK_ROWS).sum(axis=-1)
    own, moment = fit.own_information, fit.own_gradient
    lost = moment / np.maximum(own, 1e-9) - moment / np.maximum(whole, 1e-9)
    offset += np.repeat(lost, CHUNK_ROWS, axis=1)
    return offset, information * np.repeat(own / np.maximum(whole, 1e-9), CHUNK_ROWS, axis=1)
