"""The grey levels across a shaft with a highlight, as a model of its whole width.

Windows about one edge cannot tell a highlight near it from a shift of it. But one light shines on
both edges, and the shading of a round shaft is a function of one angle θ around it, from −90° at
one edge to 90° at the other:

    f(θ) = a + b sin θ + c cos θ + d exp(−(θ − θ₀)² / 2w²) + g(θ),

what is diffuse, one highlight, and a Gaussian process g for what neither of them has. Levels a to d
are free in every part of the shaft's length; g is common to all. A pixel at distance u from the
axis sees ∫ f(θ) φ_s(u − R sin θ) R cos θ dθ, and the background outside.

A rough surface smears a lamp out to a Gaussian; a smooth one mirrors it, as the image of a lamp or
window of width 2h:

    Φ((θ − θ₀ + h) / w) − Φ((θ − θ₀ − h) / w).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from pivometer._arrays import Floats
from pivometer.shaft.fitting.profile import normal_cdf
from pivometer.shaft.fitting.rim import rim
from pivometer.shaft.fitting.rungs import Blur
from pivometer.shaft.fitting.samples import Indices

NODE_BLURS = 0.65
"""Spacing of the sum over angles in blurs. Sums of evenly spaced Gaussians converge so fast that at
0.65 they are exact to 1e-8, while highlights are wider than the spacing."""

ROUGHNESS_RAD = 0.25
ROUGHNESS_PART = 0.07
ROUGHNESS_GRID = 64
LIKELY_PARTS = 4.0
"""Of g: its correlation length, its likely height in parts of the range of grey levels, and how
many of its parts that counts as much as; the height is then found from the image. Its spectrum has
a heavy tail (rational quadratic, α = 2): with a Gaussian one of 0.2 rad oblique metal was 0.016
instead of 0.013 px rms off in 40 scenes, and its edges' stated sigma too small by a third."""

LIKELY = np.array([0.0, np.log(0.2), 0.0])
LIKELY_SIGMA = np.array([1.0, 1.0, 0.2])
LIKELY_OF_LAMP = np.array([0.0, np.log(0.1), 0.0, np.log(0.15)])
LIKELY_SIGMA_OF_LAMP = np.array([1.0, 1.0, 0.2, 1.0])
"""A highlight's place, width (its logarithm) and drift along the shaft as they are likely
beforehand; and of a lamp's image place, its edges' width, drift and h."""

SHARPEST_NODES = 0.3
"""To the width of a lamp's edges 0.3 of the nodes' spacing is added in quadrature: they do not tell
of sharper edges, and nor does the blur."""

LEVELS = 8
"""Of a part: outside a level and a ramp beside either edge, inside a, b, c and d."""

STEP_LIMITS = np.array([0.2, 0.2, 0.2, 0.2, 0.1, 0.1, 0.2, 0.1, 0.2])


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """Mean grey levels across a shaft, in parts of its length.

    Parameters
    ----------
    grey, count
        Mean grey level and number of pixels in each bin, shape (parts, p).
    x_px
        Distance from the own edge, raw px, positive outside, shape (parts, p).
    edge
        0 or 1, shape (p,).
    half_px, lever, scale
        Half the width (raw px), place along the edges (−1 … 1), and raw px per undistorted px,
        beside both edges, shape (parts, 2).
    noise
        Standard deviation of pixels within a bin, grey levels.
    """

    grey: Floats
    count: Floats
    x_px: Floats
    edge: Indices
    half_px: Floats
    lever: Floats
    scale: Floats
    noise: float


class Seen(NamedTuple):
    """How much bins see of angles: weights over noise and distances over blur, (parts, p, nodes).

    With the distances from the own edge over blur, (parts, p), and half the width, (parts,).
    """

    kernels: Floats
    z: Floats
    outward: Floats
    radius: Floats


class Terms(NamedTuple):
    """Values of terms and their derivatives by distance and by blur."""

    values: Floats
    slopes: Floats
    spreads: Floats


class Lobe(NamedTuple):
    """A highlight and its derivatives by its place and by the logarithms of its widths."""

    values: Floats
    by_place: Floats
    by_widths: tuple[Floats, ...]


@dataclass(frozen=True, slots=True, eq=False)
class System:
    """The model linearized at its best levels.

    Parameters
    ----------
    cost
        Sum of squares over variance, of residuals and of what is likely beforehand.
    information, gradient
        Normal equations of the parameters, shapes (n, n) and (n,).
    gram, levels
        Normal equations of levels and g, shape (k, k), and their best values.
    """

    cost: float
    information: Floats
    gradient: Floats
    gram: Floats
    levels: Floats

    def step(self, damping: float) -> Floats:
        """Return Levenberg's and Marquardt's step from here."""
        damped = self.information + damping * np.diag(np.diag(self.information))
        limits = STEP_LIMITS[: len(damped)]
        return np.clip(np.linalg.solve(damped, self.gradient), -limits, limits)

    @property
    def improbability(self) -> float:
        """−2 log of the marginal likelihood (Laplace) but for a constant, whatever the levels."""
        volume = np.linalg.slogdet(self.gram)[1] + np.linalg.slogdet(self.information)[1]
        return self.cost + float(volume)

    @property
    def least(self) -> float:
        """The cost that the best step promises."""
        return self.cost - float(self.gradient @ np.linalg.solve(self.information, self.gradient))


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """A profile and what is likely beforehand.

    The parameters are offset and tilt of both edges, the blur, and place, width (its logarithm) and
    drift of the highlight; of a lamp's image, whose edges that width is, also h (its logarithm).

    Parameters
    ----------
    profile, blur
        The grey levels and what is known of the blur.
    root
        One over the standard deviation of each bin, shape (parts, p).
    angles
        Nodes, shape (n,), rad.
    rough
        Functions of the angle that sum up to g, each with a standard deviation of 1, (n, k).
    lamp
        Whether the highlight is the image of a lamp.
    """

    profile: Profile
    blur: Blur
    root: Floats
    angles: Floats
    rough: Floats
    lamp: bool = False

    @classmethod
    def of(cls, profile: Profile, noise: float, blur: Blur, blur_px: float) -> Model:
        """Return the model of a profile's grey levels with a pixel's noise and about its blur."""
        nodes = int(np.ceil(np.pi * float(profile.half_px.max()) / (NODE_BLURS * blur_px)))
        height = ROUGHNESS_PART * float(np.ptp(profile.grey[profile.count > 0]))
        root = np.sqrt(profile.count) / noise
        return cls(profile, blur, root, angles(nodes), height * rough(nodes))

    @property
    def likely(self) -> tuple[Floats, Floats]:
        """What is likely of the highlight beforehand, and its standard deviation."""
        if self.lamp:
            return LIKELY_OF_LAMP, LIKELY_SIGMA_OF_LAMP
        return LIKELY, LIKELY_SIGMA

    @property
    def freedom(self) -> int:
        """Number of bins that no free level takes up."""
        free = LEVELS * len(self.root) + len(self.likely[0]) + 5
        return max(int((self.root > 0).sum()) - free, 1)

    def precision(self) -> tuple[Floats, Floats]:
        """Return inverse variances known beforehand: of levels and g's parts, of parameters."""
        levels = np.full(LEVELS * len(self.root), 1e-8)
        known = np.concatenate([[self.blur.sigma_px], self.likely[1]])
        return (
            np.concatenate([levels, np.ones(self.rough.shape[1])]),
            np.concatenate([np.zeros(4), known**-2]),
        )

    def seen(self, parameters: Floats) -> Seen:
        """Return what bins see of angles if the edges are at these parameters."""
        at, blur = self.profile, float(parameters[4])
        half = at.half_px.mean(axis=1, keepdims=True)
        moves = at.scale * (parameters[[0, 2]] + parameters[[1, 3]] * at.lever)
        outer = half + moves
        radius, centre = outer.mean(axis=1), (outer[:, 0] - outer[:, 1]) / 2
        place = np.where(at.edge == 0, 1.0, -1.0) * (half + at.x_px)
        nodes = centre[:, None] + radius[:, None] * np.sin(self.angles)
        z = (place / blur)[:, :, None] - (nodes / blur)[:, None, :]
        kernels = -0.5 * z
        kernels *= z
        np.exp(kernels, out=kernels)
        step = np.pi / len(self.angles) / (np.sqrt(2 * np.pi) * blur)
        kernels *= self.root[:, :, None]
        kernels *= (step * radius[:, None] * np.cos(self.angles))[:, None, :]
        return Seen(kernels, z, (at.x_px - moves[:, at.edge]) / blur, radius)

    def outside(self, seen: Seen, blur: float) -> Terms:
        """Return level and ramp outside the own edge, by distance and blur, (2, parts, p)."""
        z = seen.outward
        bell = np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi)
        part = normal_cdf(z, bell)
        return Terms(
            np.stack([part, blur * (z * part + bell)]) * self.root,
            np.stack([bell / blur, part]) * self.root,
            np.stack([-z * bell / blur, bell]) * self.root,
        )

    def highlight(self, parameters: Floats) -> Lobe:
        """Return each part's highlight, shape (parts, nodes)."""
        place, width, drift, *half = parameters[5:]
        middle = place + drift * self.profile.lever.mean(axis=1)
        return self.lobe(self.angles - middle[:, None], *np.exp([width, *half]))

    def lobe(self, away: Floats, width: Floats, half: Floats | None = None) -> Lobe:
        """Return highlights by the angle from their middle; of given h, a lamp's images."""
        if half is None:
            z = away / width
            lobe = np.exp(-0.5 * z * z)
            return Lobe(lobe, lobe * z / width, (lobe * z * z,))
        soft = np.hypot(width, SHARPEST_NODES * np.pi / len(self.angles))
        first, last = (away + half) / soft, (away - half) / soft
        rise, fall = (np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi) for z in (first, last))
        by_soft = (last * fall - first * rise) * (width / soft) ** 2
        return Lobe(
            normal_cdf(first, rise) - normal_cdf(last, fall),
            (fall - rise) / soft,
            (by_soft, (rise + fall) * half / soft),
        )

    def terms(self, seen: Seen, outside: Floats, lobe: Floats) -> Floats:
        """Return what bins see of all levels and of g, over noise, shape (parts × p, k)."""
        parts, p = self.root.shape
        terms = np.zeros((parts, p, LEVELS * parts + self.rough.shape[1]))
        first = self.profile.edge == 0
        simple = np.stack([np.ones_like(self.angles), np.sin(self.angles), np.cos(self.angles)])
        common = seen.kernels @ np.concatenate([simple.T, self.rough], axis=1)
        lit = seen.kernels @ lobe[:, :, None]
        for part in range(parts):
            own = terms[part, :, LEVELS * part : LEVELS * (part + 1)]
            own[first, :2], own[~first, 2:4] = outside[:, part, first].T, outside[:, part, ~first].T
            own[:, 4:7], own[:, 7] = common[part, :, :3], lit[part, :, 0]
        terms[:, :, LEVELS * parts :] = common[:, :, 3:]
        return terms.reshape(parts * p, -1)

    def solved(self, terms: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the levels' normal equations, the best levels and g, and the residuals."""
        grey = (self.profile.grey * self.root).ravel()
        gram = terms.T @ terms
        gram.flat[:: len(gram) + 1] += self.precision()[0]
        levels = np.asarray(np.linalg.solve(gram, terms.T @ grey))
        return gram, levels, grey - terms @ levels

    def system(self, parameters: Floats) -> System:
        """Return the model linearized at these parameters."""
        seen, lobe = self.seen(parameters), self.highlight(parameters)
        outside = self.outside(seen, float(parameters[4]))
        terms = self.terms(seen, outside.values, lobe.values)
        gram, levels, left = self.solved(terms)
        jacobian = self.jacobian(parameters, seen, outside, lobe, levels)
        of_levels, certain = self.precision()
        away = np.concatenate([np.zeros(4), [self.blur.mean_px], self.likely[0]]) - parameters
        mixed = terms.T @ jacobian
        # At the best levels the gradient by them is 0.
        information = jacobian.T @ jacobian - mixed.T @ np.linalg.solve(gram, mixed)
        return System(
            cost=float(left @ left + of_levels @ levels**2 + certain @ (away * away)),
            information=information + np.diag(certain),
            gradient=jacobian.T @ left + certain * away,
            gram=gram,
            levels=levels,
        )

    def with_height(self, system: System) -> Model:
        """Return the model with g as high as levels tell: MacKay's rule, with what is likely."""
        first = LEVELS * len(self.root)
        g = system.levels[first:]
        told = len(g) - float(np.trace(np.linalg.inv(system.gram)[first:, first:]))
        height = float(np.sqrt((g @ g + LIKELY_PARTS) / (told + LIKELY_PARTS)))
        return replace(self, rough=self.rough * height)

    def jacobian(
        self, parameters: Floats, seen: Seen, outside: Terms, lobe: Lobe, levels: Floats
    ) -> Floats:
        """Return the derivatives by parameters, over noise, shape (parts × p, n)."""
        at, blur = self.profile, float(parameters[4])
        parts, p = self.root.shape
        own = levels[: LEVELS * parts].reshape(parts, LEVELS)
        sine, cosine = np.sin(self.angles), np.cos(self.angles)
        shading = own[:, 4:5] + own[:, 5:6] * sine + own[:, 6:7] * cosine
        shading += own[:, 7:] * lobe.values + self.rough @ levels[LEVELS * parts :]
        changes = (own[:, 7:] * change for change in (lobe.by_place, *lobe.by_widths))
        lit, by_place, by_width, *by_half = _applied(seen.kernels, shading, *changes)
        moved = seen.kernels * seen.z
        by_centre, by_radius = _applied(moved, shading, shading * sine) / blur
        by_radius = by_radius + lit / seen.radius[:, None]
        out = np.stack([own[:, :2], own[:, 2:4]])[at.edge]
        by_outer = -np.einsum("pgk,kgp->gp", out, outside.slopes)
        jacobian = np.empty((parts, p, len(parameters)))
        for edge, sign in ((0, 1.0), (1, -1.0)):
            by_edge = (by_radius + sign * by_centre) / 2 + by_outer * (at.edge == edge)
            by_edge *= at.scale[:, edge, None]
            jacobian[..., 2 * edge] = by_edge
            jacobian[..., 2 * edge + 1] = by_edge * at.lever[:, edge, None]
        moved *= seen.z
        jacobian[..., 4] = (_applied(moved, shading)[0] - lit) / blur
        jacobian[..., 4] += np.einsum("pgk,kgp->gp", out, outside.spreads)
        jacobian[..., 5], jacobian[..., 6] = by_place, by_width
        jacobian[..., 7] = by_place * at.lever.mean(axis=1)[:, None]
        for column in by_half:
            jacobian[..., 8] = column
        return jacobian.reshape(parts * p, -1)

    def moved_by_rim(self, parameters: Floats, system: System) -> Floats:
        """Return how far the parameters are off if the rim mirrors as is likely, shape (n,)."""
        levels, parts = system.levels, len(self.root)
        seen, lobe = self.seen(parameters), self.highlight(parameters)
        outside = self.outside(seen, float(parameters[4]))
        terms = self.terms(seen, outside.values, lobe.values)
        jacobian = self.jacobian(parameters, seen, outside, lobe, levels)
        own = levels[: LEVELS * parts].reshape(parts, LEVELS).mean(axis=0)
        shading = own[4] + own[5] * np.sin(self.angles) + own[6] * np.cos(self.angles)
        shading += own[7] * lobe.values.mean(axis=0) + self.rough @ levels[LEVELS * parts :]
        gain = rim(self.angles, (own[0], own[2]), (shading[-1], shading[0]))
        left = (seen.kernels @ gain).ravel()
        free = np.linalg.solve(terms.T @ terms + np.diag(self.precision()[0]), terms.T @ left)
        gradient = jacobian.T @ (left - terms @ free)
        return np.asarray(np.linalg.solve(system.information, gradient))

    def misfit(self, cost: float) -> float:
        """Return by how many standard deviations a sum of squares exceeds noise."""
        return (cost - self.freedom) / float(np.sqrt(2 * self.freedom))


def _applied(kernels: Floats, *shadings: Floats) -> Floats:
    """Return what each part's bins see of its shadings, shape (shadings, parts, p)."""
    return np.moveaxis(kernels @ np.stack(shadings, axis=-1), -1, 0)


def angles(nodes: int) -> Floats:
    """Return the middles of equal parts of the half circle."""
    return np.asarray((np.arange(nodes) + 0.5) * np.pi / nodes - np.pi / 2)


@lru_cache(maxsize=16)
def rough(nodes: int) -> Floats:
    """Return functions of the angle that sum up to a Gaussian process of unit height, (n, k)."""
    grid = np.linspace(-np.pi / 2, np.pi / 2, ROUGHNESS_GRID)

    def alike(at: Floats) -> Floats:
        square = ((at[:, None] - grid) / ROUGHNESS_RAD) ** 2
        return np.asarray((1 + square / 4) ** -2)

    size, vectors = np.linalg.eigh(alike(grid))
    kept = size > 1e-6 * size[-1]
    return np.asarray(alike(angles(nodes)) @ vectors[:, kept] / np.sqrt(size[kept]))
