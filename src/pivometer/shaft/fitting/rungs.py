"""Windows about an edge with a few grey levels each, fitted to one edge of a shaft.

Towards its edge any smooth shading of a round shaft is a function of the angle around it, so it
goes as c₀ + c₁ (1 − ξ) + c₂ √(1 − ξ²) + …; outside, the background is a level and a ramp. All are
blurred, and their levels solved for in every chunk of rows (variable projection).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from pivometer._arrays import Floats
from pivometer.shaft.fitting.profile import limb, normal_cdf
from pivometer.shaft.fitting.samples import Indices, Samples
from pivometer.shaft.fitting.strip import CHUNK_ROWS

OUT, OUT_RAMP, IN, RAMP, LIMB = range(5)

RIDGE = 1e-9
RIDGE_BEFORE_CLUTTER = 1e-5
"""Before a known background, whose shadow is one level more: with the smaller ridge 6 of 69 images
of a glossy shaft 10 px wide were lost, whose levels ran away."""

BIN_PX = 0.5
FULL_BIN = 20
"""Residuals are averaged across the edge in bins; those with fewer pixels are left out."""


@dataclass(frozen=True, slots=True)
class Rung:
    """A window, px at usual blur, and the terms in it; the first is OUT."""

    inner_px: float
    outer_px: float
    terms: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Blur:
    """What is known of the blur, px: little. Knowing it to 0.015 px helped nothing where tried."""

    mean_px: float = 0.85
    sigma_px: float = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Rest:
    """What a rung leaves of the grey levels of chunks of p samples.

    Parameters
    ----------
    information, gradient
        Normal equations of (offset, tilt, blur), grey levels², shapes (chunks, 3, 3), (chunks, 3).
    rung, blur_px, levels, behind
        The rung, the blur that it was evaluated at, its grey levels, shape (chunks, k), and what
        stands behind each sample, if that is known, shape (chunks, p).
    x_px, count
        Distance of each sample, and its number of pixels within the window, shape (chunks, p).
    residual
        Grey level less model of each sample, times the root of its count, shape (chunks, p).
    jacobian
        Derivatives of the model by offset, tilt and blur, times the same, shape (chunks, 3, p).
    edge
        0 or 1, shape (chunks,).
    terms
        Number of grey levels of a chunk.
    """

    information: Floats
    gradient: Floats
    rung: Rung
    blur_px: float
    levels: Floats
    behind: Floats | None
    x_px: Floats
    count: Floats
    residual: Floats
    jacobian: Floats
    edge: Indices
    terms: int

    def contrast(self) -> Floats:
        """Return the grey step at the edge without sign, mean over each chunk, shape (chunks,).

        Before clutter it differs from row to row.
        """
        terms, levels = self.rung.terms, self.levels
        inside = levels[:, terms.index(IN)]
        if self.behind is None:
            return np.abs(levels[:, 0] - inside)
        shift = levels[:, terms.index(OUT_RAMP)] if OUT_RAMP in terms else 0.0
        weights = self.count * (np.abs(self.x_px) < self.blur_px)
        steps = np.abs(levels[:, :1] * self.behind + (shift - inside)[:, None])
        total: Floats = (weights * steps).sum(axis=1) / np.maximum(weights.sum(axis=1), 1)
        return total

    def variance(self) -> tuple[Floats, Floats]:
        """Return each chunk's mean square residual and its number of samples, shape (chunks,)."""
        count = (self.count > 0).sum(axis=-1)
        square = np.einsum("kp,kp->k", self.residual, self.residual)
        return square / np.maximum(count - self.terms, 1), count

    def row_information(self) -> Floats:
        """Return each row's information on the edge's offset, shape (rows,); of pixels only.

        Free grey levels take a part of it, which is known for the whole chunk: without that
        correction a bow of the edge would seem a half or a tenth of what it is.
        """
        whole = np.einsum("kp,kp->k", self.jacobian[:, 0], self.jacobian[:, 0])
        left = self.information[:, 0, 0] / np.maximum(whole, 1e-12)
        told: Floats = self.by_row(self.jacobian[:, 0] ** 2) * np.repeat(left, CHUNK_ROWS)
        return told

    def by_row(self, values: Floats) -> Floats:
        """Return values (chunks, p) of pixels summed over each row, shape (rows,)."""
        sums: Floats = values.reshape(len(values) * CHUNK_ROWS, -1).sum(axis=1)
        return sums


def evaluate(samples: Samples, rung: Rung, parameters: Floats, widen: float) -> Rest:
    """Eliminate a rung's grey levels at offset and tilt of both edges and the blur (px).

    Parameters
    ----------
    samples
        The grey levels.
    rung
        The window and terms.
    parameters
        Where the edges are, from the strip's lines, and the blur, shape (5,).
    widen
        What the rung's window is multiplied by.
    """
    blur = float(parameters[4])
    x = samples.moved(parameters)
    low, high = -rung.inner_px * widen, rung.outer_px * widen
    count = samples.count * ((x > low) & (x < high))
    place = np.flatnonzero(count.max(axis=0)) if samples.sorted else np.arange(x.shape[1])
    cut = slice(int(place[0]), int(place[-1]) + 1) if place.size else slice(0, 1)
    x, count, lever = x[:, cut], count[:, cut], samples.lever[:, cut]
    root = np.sqrt(count)
    values, slopes, spreads = terms_of(x, blur, samples, rung, cut)
    grey = samples.grey[:, cut]
    levels, columns, rest = eliminated(
        values, slopes, spreads, grey, root, samples.scale, lever, ridge_of(samples)
    )
    return Rest(
        information=rest[:, :3, :3],
        gradient=rest[:, :3, 3],
        rung=rung,
        blur_px=blur,
        levels=levels,
        behind=None if samples.behind is None else samples.behind.grey[:, cut],
        x_px=x,
        count=count,
        residual=columns[:, 3],
        jacobian=columns[:, :3],
        edge=samples.edge,
        terms=len(rung.terms),
    )


def ridge_of(samples: Samples) -> float:
    """Return the ridge of `eliminated`, which steadies levels that the pixels hardly tell apart."""
    return RIDGE if samples.behind is None else RIDGE_BEFORE_CLUTTER


def eliminated(
    values: Floats,
    slopes: Floats,
    spreads: Floats,
    grey: Floats,
    root: Floats,
    scale: Floats,
    lever: Floats,
    ridge: float,
) -> tuple[Floats, Floats, Floats]:
    """Return each chunk's best levels, and what is left without them.

    Parameters
    ----------
    values
        Terms of every chunk, shape (chunks, k, p); they are multiplied by `root` in place.
    slopes, spreads
        Derivatives by distance and blur, shape (chunks, m, p), of the first terms; the others do
        not move with the edge.
    grey, root, lever
        Grey levels, roots of the numbers of pixels, and places along the edge, shape (chunks, p).
    scale
        Raw px per undistorted px, shape (chunks, 1).
    ridge
        What is added to each term's square, in parts of it.

    Returns
    -------
    levels, columns, rest
        The levels (chunks, k); derivatives by offset, tilt and blur, and the residual, times
        `root` (chunks, 4, p); and their products once the levels follow them (chunks, 4, 4).
    """
    values *= root[:, None]
    gram = values @ np.swapaxes(values, -1, -2)
    diagonal = np.einsum("kii->ki", gram)
    diagonal *= 1 + ridge
    diagonal += 1e-9
    inverse = np.linalg.inv(gram)
    grey = root * grey
    levels = inverse @ (values @ grey[..., None])
    row = np.swapaxes(levels, -1, -2)
    moving = row[..., : slopes.shape[1]]
    columns = np.empty((len(values), 4, values.shape[-1]))
    np.multiply((moving @ slopes)[:, 0], -scale * root, out=columns[:, 0])
    np.multiply(columns[:, 0], lever, out=columns[:, 1])
    np.multiply((moving @ spreads)[:, 0], root, out=columns[:, 2])
    np.subtract(grey, (row @ values)[:, 0], out=columns[:, 3])
    mixed = values @ np.swapaxes(columns, -1, -2)
    rest = columns @ np.swapaxes(columns, -1, -2)
    rest -= np.swapaxes(mixed, -1, -2) @ (inverse @ mixed)
    return levels[..., 0], columns, rest


def terms_of(
    x: Floats, blur: float, samples: Samples, rung: Rung, cut: slice
) -> tuple[Floats, Floats, Floats]:
    """Return a rung's blurred terms and their derivatives by distance and blur, (chunks, k, p).

    Where an empty frame B tells the background, it takes the place of the outside level, with its
    slope B' to first order, as blurring what the shaft leaves of it gives B Φ + s² B' φ; and a
    level takes the place of the outside ramp, for a shadow.
    """
    z = x / blur
    bell = np.exp(-0.5 * z * z) / (np.sqrt(2 * np.pi) * blur)
    outside = normal_cdf(z, bell * blur)
    inside = 1 - outside
    wide = blur * blur * bell
    behind = samples.behind
    values, slopes, spreads = np.empty((3, len(x), len(rung.terms), x.shape[1]))
    for k, term in enumerate(rung.terms):
        if term == OUT and behind is not None:
            seen = behind.grey[:, cut], behind.slope[:, cut]
            found = _hidden(*seen, outside, bell, z, blur)
        elif term == OUT or (term == OUT_RAMP and behind is not None):
            found = outside, bell, -z * bell
        elif term == OUT_RAMP:
            found = x * outside + wide, outside, blur * bell
        elif term == IN:
            found = inside, -bell, z * bell
        elif term == RAMP:
            found = wide - x * inside, -inside, blur * bell
        else:
            found = limb(x, blur, samples.half_px)
        values[:, k], slopes[:, k], spreads[:, k] = found
    return values, slopes, spreads


def _hidden(
    grey: Floats, slope: Floats, outside: Floats, bell: Floats, z: Floats, blur: float
) -> tuple[Floats, Floats, Floats]:
    """Return B Φ + s² B' φ and its derivatives by distance and blur."""
    slope = slope * blur
    return (
        grey * outside + slope * blur * bell,
        (grey - slope * z) * bell,
        (slope * (1 + z * z) - grey * z) * bell,
    )


def solve(
    rests: Sequence[Rest], noise: float, blur: Blur, parameters: Floats
) -> tuple[Floats, Floats]:
    """Return step and covariance of offset and tilt of both edges and their common blur.

    Parameters
    ----------
    rests
        Of both edges, together or one by one.
    noise
        Standard deviation of a pixel, grey levels.
    blur
        What is known of the blur beforehand.
    parameters
        Where the rests were taken, shape (5,).
    """
    whole, right = np.zeros((5, 5)), np.zeros(5)
    for edge, information, gradient in _by_edge(rests):
        own = slice(2 * edge, 2 * edge + 2)
        whole[own, own] = information[:2, :2]
        whole[own, 4] = whole[4, own] = information[:2, 2]
        whole[4, 4] += information[2, 2]
        right[own] = gradient[:2]
        right[4] += gradient[2]
    whole /= noise**2
    right /= noise**2
    whole[4, 4] += 1 / blur.sigma_px**2
    right[4] += (blur.mean_px - parameters[4]) / blur.sigma_px**2
    whole.flat[:: len(whole) + 1] *= 1 + 1e-9
    whole.flat[:: len(whole) + 1] += 1e-9
    covariance = np.asarray(np.linalg.inv(whole))
    return covariance @ right, covariance


def _by_edge(rests: Sequence[Rest]) -> Iterator[tuple[int, Floats, Floats]]:
    """Yield each edge with the sums of its chunks' normal equations."""
    for rest in rests:
        first, last = int(rest.edge[0]), int(rest.edge[-1])
        parts = rest.information.reshape(last - first + 1, -1, 3, 3).sum(axis=1)
        rights = rest.gradient.reshape(last - first + 1, -1, 3).sum(axis=1)
        yield from zip(range(first, last + 1), parts, rights, strict=True)


def misfits(rest: Rest, step: Floats, noise: float) -> tuple[float, float]:
    """Return by how many standard deviations each edge's mean residual across exceeds noise.

    Parameters
    ----------
    rest
        Of both edges.
    step
        The step of offsets, tilts and blur, which is taken first, shape (5,).
    noise
        Standard deviation of a pixel, grey levels.
    """
    own = np.stack([step[[0, 1, 4]], step[[2, 3, 4]]])[rest.edge]
    left = rest.residual - (own[:, None] @ rest.jacobian)[:, 0]
    return mean_misfits(left, rest.x_px, rest.count, rest.edge, noise)


def mean_misfits(
    residual: Floats, x_px: Floats, count: Floats, edge: Indices, noise: float
) -> tuple[float, float]:
    """Return `misfits` of residuals, which are times the roots of their counts.

    Parameters
    ----------
    residual, x_px, count, edge
        As of a `Rest`.
    noise
        Standard deviation of a pixel, grey levels.
    """
    place = np.floor(x_px / BIN_PX).astype(np.intp)
    place -= place.min()
    bins = int(place.max()) + 1
    place += bins * edge[:, None]
    number, total = (
        np.bincount(place.ravel(), values.ravel(), 2 * bins).reshape(2, bins)
        for values in (count, residual * np.sqrt(count))
    )
    full = number >= FULL_BIN
    freedom = np.maximum(full.sum(axis=1), 1)
    chi2 = (full * total**2 / np.maximum(number, 1)).sum(axis=1) / noise**2
    seen = number.any(axis=1)
    first, second = np.where(seen, (chi2 - freedom) / np.sqrt(2 * freedom), np.inf).tolist()
    return first, second
