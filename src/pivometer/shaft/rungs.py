"""Windows about an edge with a few grey levels each, fitted to one edge of a shaft.

Towards its edge any smooth shading of a round shaft is a function of the angle around it, so it
goes as c₀ + c₁ (1 − ξ) + c₂ √(1 − ξ²) + …; outside, the background is a level and a ramp. All are
blurred, and their levels solved for in every chunk of rows (variable projection).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pivometer._arrays import Floats
from pivometer.shaft.plain import CHUNK_ROWS, Strip
from pivometer.shaft.profile import limb, normal_cdf

OUT, OUT_RAMP, IN, RAMP, LIMB = range(5)

BIN_PX = 0.5
FULL_BIN = 60
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
class Behind:
    """What an empty frame shows at the pixels of a `Strip`, shape (…, rows, columns).

    Parameters
    ----------
    grey
        Its grey levels.
    slope
        Their derivative outward, grey levels per px.
    """

    grey: Floats
    slope: Floats

    def part(self, at: int | tuple[slice, slice]) -> Behind:
        """Return one edge's, or some rows and columns."""
        return Behind(self.grey[at], self.slope[at])


@dataclass(frozen=True, slots=True, eq=False)
class EdgeRows:
    """The pixels beside one edge, shape (rows, columns), as `Strip` has them for two."""

    grey: Floats
    x_px: Floats
    lever: Floats
    scale: Floats  # (rows, 1)
    half_px: Floats  # (rows, 1)
    valid: Floats  # (rows,)
    behind: Behind | None = None

    @classmethod
    def of(
        cls, bands: Strip, half_px: Floats, valid: Floats, behind: Behind | None, edge: int
    ) -> EdgeRows:
        """Return the rows of one edge of a strip."""
        return cls(
            bands.near[edge],
            bands.x_px[edge],
            bands.lever[edge],
            bands.scale[edge],
            half_px[edge],
            valid[edge],
            None if behind is None else behind.part(edge),
        )

    def within(self, low: float, high: float) -> EdgeRows:
        """Return the columns that may be between two distances."""
        rows = self.valid > 0
        if not rows.any():
            return self
        x = self.x_px[rows]
        place = np.flatnonzero((x.max(axis=0) > low) & (x.min(axis=0) < high))
        at = slice(int(place[0]), int(place[-1]) + 1) if place.size else slice(0, 1)
        cut = (self.grey[:, at], self.x_px[:, at], self.lever[:, at])
        seen = None if self.behind is None else self.behind.part((slice(None), at))
        return EdgeRows(*cut, self.scale, self.half_px, self.valid, seen)


@dataclass(frozen=True, slots=True, eq=False)
class Rest:
    """What a rung leaves of one edge after its grey levels, in chunks of p pixels.

    Parameters
    ----------
    information, gradient
        Normal equations of (offset, tilt, blur), grey levels², shapes (chunks, 3, 3), (chunks, 3).
    variance
        Mean square residual of each chunk, shape (chunks,).
    contrast
        Outside less inside level at the edge, shape (chunks,).
    x_px, used, residual
        Distance, whether it counts, and grey level less model of each pixel, shape (chunks, p).
    jacobian
        Derivatives of the model by offset, tilt and blur, shape (chunks, 3, p).
    """

    information: Floats
    gradient: Floats
    variance: Floats
    contrast: Floats
    x_px: Floats
    used: Floats
    residual: Floats
    jacobian: Floats

    def row_information(self) -> Floats:
        """Return each row's information on the edge's offset, shape (rows,).

        Free grey levels take a part of it, which is known for the whole chunk: without that
        correction a bow of the edge would seem a half or a tenth of what it is.
        """
        whole = np.einsum("kp,kp->k", self.jacobian[:, 0], self.jacobian[:, 0])
        left = self.information[:, 0, 0] / np.maximum(whole, 1e-12)
        told: Floats = self.by_row(self.jacobian[:, 0] ** 2) * np.repeat(left, CHUNK_ROWS)
        return told

    def by_row(self, values: Floats) -> Floats:
        """Return values (chunks, p) summed over each row, shape (rows,)."""
        sums: Floats = values.reshape(len(values) * CHUNK_ROWS, -1).sum(axis=1)
        return sums


def evaluate(rows: EdgeRows, rung: Rung, parameters: Floats, widen: float) -> Rest:
    """Eliminate a rung's grey levels at offset, tilt and blur (px), shape (3,).

    Parameters
    ----------
    rows
        The pixels.
    rung
        The window and terms.
    parameters
        Where the edge is, from the strip's line, and the blur.
    widen
        What the rung's window is multiplied by.
    """
    offset, tilt, blur = (float(value) for value in parameters)
    low, high = -rung.inner_px * widen, rung.outer_px * widen
    spare = abs(offset) + abs(tilt)
    cut = rows.within(low - 1.1 * spare, high + 1.1 * spare)
    x = cut.x_px - cut.scale * (offset + tilt * cut.lever)
    shape = (len(x) // CHUNK_ROWS, -1)
    used = (cut.valid[:, None] * ((x > low) & (x < high))).reshape(shape)
    values, slopes, spreads = _terms(x, blur, cut, rung, shape)
    values *= used[:, None]
    gram = values @ np.swapaxes(values, -1, -2)
    size = np.trace(gram, axis1=-2, axis2=-1)[:, None, None]
    gram += (1e-9 * size + 1e-9) * np.eye(len(rung.terms))
    grey = cut.grey.reshape(shape)
    levels = np.linalg.solve(gram, values @ grey[..., None])
    row = np.swapaxes(levels, -1, -2)
    columns = np.empty((len(values), 4, values.shape[-1]))
    across = -(cut.scale * np.ones_like(x)).reshape(shape) * used
    np.multiply((row @ slopes)[:, 0], across, out=columns[:, 0])
    np.multiply(columns[:, 0], cut.lever.reshape(shape), out=columns[:, 1])
    np.multiply((row @ spreads)[:, 0], used, out=columns[:, 2])
    np.subtract(used * grey, (row @ values)[:, 0], out=columns[:, 3])
    mixed = values @ np.swapaxes(columns, -1, -2)
    rest = columns @ np.swapaxes(columns, -1, -2)
    rest -= np.swapaxes(mixed, -1, -2) @ np.linalg.solve(gram, mixed)
    freedom = np.maximum(used.sum(axis=-1) - len(rung.terms), 1)
    return Rest(
        information=rest[:, :3, :3],
        gradient=rest[:, :3, 3],
        variance=np.einsum("kp,kp->k", columns[:, 3], columns[:, 3]) / freedom,
        contrast=levels[:, 0, 0] - levels[:, rung.terms.index(IN), 0],
        x_px=x.reshape(shape),
        used=used,
        residual=columns[:, 3],
        jacobian=columns[:, :3],
    )


def _terms(
    x: Floats, blur: float, rows: EdgeRows, rung: Rung, shape: tuple[int, int]
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
    found = []
    for term in rung.terms:
        if term == OUT and rows.behind is not None:
            found.append(_hidden(rows.behind, outside, bell, z, blur))
        elif term == OUT or (term == OUT_RAMP and rows.behind is not None):
            found.append((outside, bell, -z * bell))
        elif term == OUT_RAMP:
            found.append((x * outside + wide, outside, blur * bell))
        elif term == IN:
            found.append((inside, -bell, z * bell))
        elif term == RAMP:
            found.append((wide - x * inside, -inside, blur * bell))
        else:
            found.append(limb(x, blur, rows.half_px))
    stacks = [np.stack([f[k].reshape(shape) for f in found], axis=1) for k in range(3)]
    return stacks[0], stacks[1], stacks[2]


def _hidden(
    behind: Behind, outside: Floats, bell: Floats, z: Floats, blur: float
) -> tuple[Floats, Floats, Floats]:
    """Return B Φ + s² B' φ and its derivatives by distance and blur."""
    grey, slope = behind.grey, behind.slope * blur
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
        Of both edges.
    noise
        Standard deviation of a pixel, grey levels.
    blur
        What is known of the blur beforehand.
    parameters
        Where the rests were taken, shape (5,).
    """
    whole, right = np.zeros((5, 5)), np.zeros(5)
    for rest, own in zip(rests, ([0, 1, 4], [2, 3, 4]), strict=True):
        whole[np.ix_(own, own)] += rest.information.sum(axis=0) / noise**2
        right[own] += rest.gradient.sum(axis=0) / noise**2
    whole[4, 4] += 1 / blur.sigma_px**2
    right[4] += (blur.mean_px - parameters[4]) / blur.sigma_px**2
    covariance = np.asarray(np.linalg.inv(whole + np.diag(1e-9 * np.diag(whole) + 1e-9)))
    return covariance @ right, covariance


def misfit(rest: Rest, step: Floats, noise: float) -> float:
    """Return by how many standard deviations the mean residual across an edge exceeds noise.

    Parameters
    ----------
    rest
        The edge's.
    step
        The step of its offset, tilt and blur, which is taken first, shape (3,).
    noise
        Standard deviation of a pixel, grey levels.
    """
    used = rest.used.ravel() > 0
    if not used.any():
        return float("inf")
    place = np.floor(rest.x_px.ravel()[used] / BIN_PX).astype(np.intp)
    place -= place.min()
    left = (rest.residual - (step @ rest.jacobian)).ravel()[used]
    count = np.bincount(place)
    mean = np.bincount(place, left) / np.maximum(count, 1)
    full = count >= FULL_BIN
    number = max(int(full.sum()), 1)
    chi2 = float((mean[full] ** 2 * count[full]).sum() / noise**2)
    return (chi2 - number) / float(np.sqrt(2 * number))
