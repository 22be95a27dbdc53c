"""What a camera sees across a shaft's edge, and the fit of two edges to all pixels beside them.

A pixel at signed distance x (px, positive outside) from an edge has the grey level
``B₀ + B₁ x`` outside and ``S₀ + S₁ x + S₂ √(1 − ξ²)`` inside, where ξ runs from 0 on the axis to 1
at the edge (the limb of a round shaft), all blurred by a Gaussian of standard deviation s with
s² = PSF² + 1/12 for the pixel's own width. The five numbers of two edges (offset and angle each,
and s) are common to the whole shaft; the grey levels are solved anew for every short chunk of it,
so a cluttered background or a collar changes them as it likes (variable projection).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pivometer._arrays import Floats

TABLE_STEP_PX = 0.05
"""Sampling of the blurred limb; from the nearest entry its series is good to 1e-5 of its height."""

BLUR_STEP_PX, HALF_STEP, RANGE_PX = 0.02, 0.1, 8.0
"""Of the tables of limbs: in blur, in the half width's logarithm, and what their ends are whole
multiples of, so that images share them."""

BLUR_RANGE_PX = (0.35, 6.0)
"""From an ideal lens (pixel width alone: √(1/12) = 0.29) to a defocus that hides a 12 px shaft."""


@dataclass(frozen=True, slots=True, eq=False)
class Bands:
    """The pixels beside both edges, in chunks along the shaft.

    Parameters
    ----------
    grey
        Grey levels, shape (edges, chunks, rows, columns).
    distance_px
        Signed distance from the first guess of the edge, positive outside, raw px; same shape.
    lever
        Position along the edge, −1 and +1 at its ends; same shape.
    scale
        Raw px per undistorted px across the edge, shape (edges, chunks, rows, 1).
    valid
        1 for a pixel that counts and 0 elsewhere; same shape as `grey`.
    half_width_px
        Half the shaft's width, raw px, in every row, shape (edges, chunks, rows, 1): the limb's ξ
        is 0 so far inside. It varies by a fifth and more along a shaft that points at the camera.
    """

    grey: Floats
    distance_px: Floats
    lever: Floats
    scale: Floats
    valid: Floats
    half_width_px: Floats

    def distances(self, parameters: Floats) -> Floats:
        """Return signed distances (raw px) from edges moved by (offset, tilt) each, (2, 2)."""
        move = parameters[:4].reshape(2, 2)[..., None, None, None]
        moved: Floats = self.distance_px - self.scale * (move[:, 0] + move[:, 1] * self.lever)
        return moved


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """Which terms the grey levels have.

    Parameters
    ----------
    ramp, limb
        Whether the inside has the terms S₁ and S₂.
    cluttered
        Whether the outside has grey levels of its own in every row, not only in every chunk.
    """

    ramp: bool
    limb: bool
    cluttered: bool

    @property
    def name(self) -> str:
        """What the report calls it."""
        if self.cluttered:
            return "clutter"
        return "limb" if self.limb else "ramp" if self.ramp else "flat"

    @property
    def inside_terms(self) -> int:
        """Number of inside grey levels of a chunk."""
        return 1 + self.ramp + self.limb

    def levels_per_row(self, rows: int) -> float:
        """Return the mean number of grey levels solved for in one of a chunk's `rows` rows."""
        outside = 2.0 if self.cluttered else 2.0 / rows
        return outside + self.inside_terms / rows


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """One linearization of the two-edge model.

    Parameters
    ----------
    parameters
        Offset and tilt (undistorted px at the ends) of both edges and the blur (px), shape (5,).
    jacobian
        Derivatives of the model by the offset and tilt of the pixel's own edge and by the blur,
        with the grey levels solved for, shape (edges, chunks, rows, columns, 3).
    residual
        Grey level minus model, shape (edges, chunks, rows, columns).
    contrast
        Inside minus outside grey level at the edge, shape (edges, chunks, rows).
    """

    parameters: Floats
    jacobian: Floats
    residual: Floats
    contrast: Floats

    def normal_equations(self, weights: Floats) -> tuple[Floats, Floats]:
        """Return the information matrix and the gradient, shapes (5, 5) and (5,)."""
        information, gradient = np.zeros((5, 5)), np.zeros(5)
        for edge, own in enumerate(([0, 1, 4], [2, 3, 4])):
            flat = self.jacobian[edge].reshape(-1, 3)
            weighted = (flat * weights[edge].reshape(-1, 1)).T
            information[np.ix_(own, own)] += weighted @ flat
            gradient[own] += weighted @ self.residual[edge].ravel()
        return information, gradient

    def step(self, weights: Floats) -> tuple[Floats, float]:
        """Return the Gauss–Newton step, shape (5,), and by how much it lowers the squares' sum."""
        information, gradient = self.normal_equations(weights)
        damped = information + np.diag(1e-6 * np.diag(information) + 1e-9)
        step = np.asarray(np.linalg.solve(damped, gradient), dtype=np.float64)
        return step, float(gradient @ step)


def linearize(bands: Bands, parameters: Floats, weights: Floats, model: Model) -> Fit:
    """Return the model's fit and derivatives at the given edges and blur.

    Parameters
    ----------
    bands
        The pixels.
    parameters
        Offset and tilt of both edges (undistorted px) and the blur (px), shape (5,).
    weights
        Weight of each pixel, shape of ``bands.grey``.
    model
        The terms of the grey levels.

    References
    ----------
    Golub and Pereyra, "Separable nonlinear least squares", Inverse Problems 19 (2003) R1;
    Kaufman's simplification of the derivative.
    """
    x = bands.distances(parameters)
    values, slopes, spreads = _terms(x, float(parameters[4]), bands.half_width_px, model)
    # The terms lie along the last axis where they are projected, and apart where they are summed.
    grey = bands.grey[..., None]
    W = weights[..., None]
    if model.cluttered:
        outside, inside = values[..., :2], values[..., 2:]
        by_row = _PairProjection(outside, weights)
        by_chunk = _Projection(_chunked(by_row(inside)), _chunked(W))
        levels_in = by_chunk.levels(_chunked(by_row(grey)))[..., None, :, :]
        levels_out = by_row.levels(grey - inside @ levels_in)
        levels_in = np.broadcast_to(levels_in, (*levels_out.shape[:-2], *levels_in.shape[-2:]))
        levels = np.concatenate([levels_out, levels_in], axis=-2)
    else:
        by_row = None
        by_chunk = _Projection(_chunked(values), _chunked(W))
        levels = by_chunk.levels(_chunked(grey))[..., None, :, :]
    residual = (grey - values @ levels)[..., 0]
    jacobian = np.empty((*x.shape, 3))
    across = -bands.scale * _summed(slopes, levels)
    jacobian[..., 0] = across
    np.multiply(across, bands.lever, out=jacobian[..., 1])
    jacobian[..., 2] = _summed(spreads, levels)
    if by_row is not None:
        jacobian = by_row(jacobian)
    jacobian = by_chunk(_chunked(jacobian)).reshape(jacobian.shape)
    contrast = np.broadcast_to(levels[..., 2, 0] - levels[..., 0, 0], x.shape[:3])
    return Fit(parameters, jacobian, residual, contrast)


def _summed(terms: Sequence[Floats], levels: Floats) -> Floats:
    """Return the sum of terms times their levels (…, k, 1)."""
    total = terms[0] * levels[..., 0, :]
    for k, term in enumerate(terms[1:], start=1):
        total += term * levels[..., k, :]
    return total


def _chunked(values: Floats) -> Floats:
    """Return (edges, chunks, rows, columns, k) with the pixels of a chunk on one axis."""
    return values.reshape(*values.shape[:2], -1, values.shape[-1])


class _Projection:
    """Weighted least squares on a small basis, for many groups of pixels at once."""

    def __init__(self, basis: Floats, weights: Floats) -> None:
        self.basis = basis
        self.transposed = np.swapaxes(basis * weights, -1, -2)
        gram = self.transposed @ basis
        size = np.trace(gram, axis1=-2, axis2=-1)[..., None, None]
        self.gram = gram + (1e-9 * size + 1e-12) * np.eye(basis.shape[-1])

    def levels(self, values: Floats) -> Floats:
        """Return the coefficients of `values` (..., pixels, m), shape (..., k, m)."""
        return np.asarray(np.linalg.solve(self.gram, self.transposed @ values))

    def __call__(self, values: Floats) -> Floats:
        """Return what of `values` the basis does not explain."""
        return values - self.basis @ self.levels(values)


class _PairProjection:
    """`_Projection` on two terms, made orthonormal once: four times as fast for many short rows."""

    def __init__(self, basis: Floats, weights: Floats) -> None:
        first, second = basis[..., 0], basis[..., 1]
        weighted = weights * first
        square = (weighted * first).sum(axis=-1, keepdims=True) + 1e-12
        self.mix = (weighted * second).sum(axis=-1, keepdims=True) / square
        second = second - self.mix * first
        rest = (weights * second * second).sum(axis=-1, keepdims=True) + 1e-9 * square
        self.basis = np.stack([first, second], axis=-1)
        self.dual = np.stack([weighted / square, weights * second / rest], axis=-2)

    def levels(self, values: Floats) -> Floats:
        """Return the coefficients of `values` (..., pixels, m), shape (..., 2, m)."""
        levels = self.dual @ values
        levels[..., 0, :] -= self.mix * levels[..., 1, :]
        return levels

    def __call__(self, values: Floats) -> Floats:
        """Return what of `values` the basis does not explain."""
        return values - self.basis @ (self.dual @ values)


CDF_STEPS = 256
CDF_REACH = 8.5
_CDF = np.array([0.5 * math.erfc(-(k / CDF_STEPS - CDF_REACH) / math.sqrt(2)) for k in range(4353)])


def normal_cdf(z: Floats, density: Floats) -> Floats:
    """Return Φ(z) to 1e-9, given the normal density φ(z): a third of the time of `ndtr`.

    From the nearest entry of a table by a series in the distance d to it:
    Φ(z) = Φ(z − d) + d φ(z) (1 + d z / 2) + O(d³).

    Examples
    --------
    >>> z = np.array([-9.0, -1.2345, 0.0, 2.0])
    >>> normal_cdf(z, np.exp(-z * z / 2) / np.sqrt(2 * np.pi)).round(7)
    array([0.       , 0.1085083, 0.5      , 0.9772499])
    """
    place = np.minimum(np.maximum(z, -CDF_REACH), CDF_REACH)
    place += CDF_REACH
    place *= CDF_STEPS
    index = (place + 0.5).astype(np.intp)
    apart = (place - index) / CDF_STEPS
    value: Floats = _CDF.take(index)
    value += apart * density * (1 + 0.5 * apart * z)
    return value


def _terms(
    x: Floats, blur: float, half_width_px: Floats, model: Model
) -> tuple[Floats, list[Floats], list[Floats]]:
    """Return the blurred terms (…, k) with each one's derivatives by distance and by blur.

    Blurring is diffusion: ∂/∂s = s ∂²/∂x² for every term.
    """
    z = x / blur
    bell = np.exp(-0.5 * z * z) / (np.sqrt(2 * np.pi) * blur)
    outside = normal_cdf(z, bell * blur)
    inside = 1 - outside
    wide = blur * blur * bell
    steep = z * bell
    values = [outside, x * outside + wide, inside]
    slopes = [bell, outside, -bell]
    spreads = [-steep, blur * bell, steep]
    if model.ramp:
        values.append(wide - x * inside)
        slopes.append(-inside)
        spreads.append(spreads[1])
    if model.limb:
        half = half_width_px.mean(axis=2).reshape(-1, 1)
        table = [part.reshape(x.shape) for part in limb(x.reshape(len(half), -1), blur, half)]
        values.append(table[0])
        slopes.append(table[1])
        spreads.append(table[2])
    return np.stack(values, axis=-1), slopes, spreads


def limb(x: Floats, blur: float, half_width_px: Floats) -> tuple[Floats, Floats, Floats]:
    """Return √(1 − ξ²) inside the edge, blurred, with its derivatives by distance and blur.

    From tables of half widths 10 % apart and blurs 0.02 px apart, which are kept: the nearest is
    scaled, and from its nearest distance and blur it goes on by the derivatives. That is true to
    0.0002 of the limb's height.

    Parameters
    ----------
    x
        Distances outward from the edge, px, in chunks of the same half width, shape (chunks, p).
    blur
        Standard deviation of the blur, px.
    half_width_px
        Half the shaft's width, shape (chunks, 1).
    """
    # x, blur and R may all be multiplied alike: the shape stays.
    place = np.rint(np.log(half_width_px) / HALF_STEP)
    wider = np.exp(place * HALF_STEP) / half_width_px
    x = x * wider
    first = float(np.floor(x.min() / RANGE_PX) * RANGE_PX)
    last = float(np.ceil(x.max() / RANGE_PX) * RANGE_PX)
    nearest = round(blur / BLUR_STEP_PX) * BLUR_STEP_PX
    low, high = int(place.min()), int(place.max())
    halves = np.exp(np.arange(low, high + 1) * HALF_STEP)
    tables = np.stack([_limb_table(first, last, nearest, float(half)) for half in halves], axis=1)
    at = (x - first) * (1 / TABLE_STEP_PX)
    index = (at + 0.5).astype(np.intp)
    apart = (at - index) * TABLE_STEP_PX
    index += (place - low).astype(np.intp) * tables.shape[2]
    value, slope, spread, twist = (table.take(index) for table in tables)
    # Taylor's series to the entry; ∂²/∂x² is the derivative by the blur over the blur.
    turn = apart * spread * (1 / nearest)
    value += apart * (slope + 0.5 * turn)
    blurrier = blur * wider - nearest
    slope += turn
    slope += blurrier * twist
    spread += apart * twist
    value += blurrier * spread
    slope *= wider
    spread *= wider
    return value, slope, spread


@lru_cache(maxsize=256)
def _limb_table(first: float, last: float, blur: float, half_width_px: float) -> Floats:
    """Return one half width's blurred limb from first on, shape (4, n).

    With its derivatives by distance and blur, and that of the latter by distance.
    """
    half = int(np.ceil(5 * blur / TABLE_STEP_PX))
    count = round((last - first) / TABLE_STEP_PX) + 2
    # The integral of the sharp limb is smooth at its end, so differences of it are exact cells.
    cells: Floats = np.arange(-half, count + half + 1, dtype=np.float64)
    edges = first + (cells - 0.5) * TABLE_STEP_PX
    sharp = np.diff(_limb_integral(edges / half_width_px)) * half_width_px / TABLE_STEP_PX
    t = np.arange(-half, half + 1) * TABLE_STEP_PX
    kernel = np.exp(-0.5 * (t / blur) ** 2)
    kernel /= kernel.sum()
    z = t / blur
    twist = kernel * z * (3 - z**2) / blur**2
    weights = (kernel, -kernel * z / blur, kernel * (z**2 - 1) / blur, twist)
    return np.stack([np.convolve(sharp, weight, mode="valid") for weight in weights])


def _limb_integral(u: Floats) -> Floats:
    """Return the integral of √(1 − ξ²) from far outside to u = x / R, with ξ = 1 + u, u ≤ 0."""
    xi = np.clip(1 + u, -1.0, 1.0)
    area: Floats = 0.5 * (xi * np.sqrt((1 - xi) * (1 + xi)) + np.arcsin(xi))
    return area
