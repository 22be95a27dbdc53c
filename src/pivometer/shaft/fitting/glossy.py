"""Both edges of a shaft with a highlight, fitted at once to the shading of its whole width.

Windows about one edge cannot tell a highlight near it from a shift of it. But one light shines on
both edges, and the shading of a round shaft is a function of one angle θ around it, from −90° at
one edge to 90° at the other:

    f(θ) = a + b sin θ + c cos θ + d exp(−(θ − θ₀)² / 2w²) + g(θ),

what is diffuse, one highlight, and a Gaussian process g for what neither of them has. Levels a to d
are free in every part of the shaft's length; g is common to all. A pixel at distance u from the
axis sees ∫ f(θ) φ_s(u − R sin θ) R cos θ dθ, and the background outside.

A rough surface smears a lamp out to a Gaussian; a smooth one mirrors it. Where the highlight is
narrow, or no Gaussian one fits, the image of a lamp or window of width 2h is tried in its place,

    Φ((θ − θ₀ + h) / w) − Φ((θ − θ₀ − h) / w),

and counts if it is clearly likelier.
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

PLACES_RAD = np.arange(-1.4, 1.41, 0.1)
WIDTHS_RAD = np.array([0.05, 0.08, 0.13, 0.2, 0.3, 0.5])
LIKELY = np.array([0.0, np.log(0.2), 0.0])
LIKELY_SIGMA = np.array([1.0, 1.0, 0.2])
"""Where highlights are looked for first; their place, width (its logarithm) and drift along the
shaft as they are likely beforehand."""

SOFTNESS_RAD = 0.04
LIKELY_OF_LAMP = np.array([0.0, np.log(0.1), 0.0, np.log(0.15)])
LIKELY_SIGMA_OF_LAMP = np.array([1.0, 1.0, 0.2, 1.0])
SHARPEST_NODES = 0.3
"""The same of a lamp's image: its edges' width at first, and place, that width, drift and h as they
are likely. To the width 0.3 of the nodes' spacing is added in quadrature: they do not tell of
sharper edges, and nor does the blur."""

NARROW_RAD = 0.07
LIKELIER = 6.0
"""An image of a lamp is looked for where the highlight is narrower, as Gaussian ones on an end of a
window's image are (0.02 to 0.07 rad in most of 40 bad scenes; 0.07 to 0.11 beside stripes, 0.15 and
more on metal), and counts if it is likelier by 20 to 1, of which this is twice the logarithm."""

SHIFT_PX = 0.3
STARTS, APART = 4, 0.35
GOOD_MISFIT = 3.0
TRIAL_STEPS = 4
"""While a highlight is looked for, edges may move as if they were known to 0.3 px. Up to four
different ones are tried with a few steps, until one leaves no more than noise; then the best that
converges counts."""

LIMB_RAD = 1.4
"""Beyond it a highlight is much like a shift of the edge, and misfits do not tell which it is: in 3
of 400 drawn scenes of oblique metal centres were 0.14 px off by such ones. A fit that ends there
counts only if it is likelier than the next best that does not."""

HOPELESS_MISFIT = 10.0
"""A fit that promises no better is given up, at twice the misfit that counts at most: finding g's
height took a tenth off it in 24 images. So is a start from which two steps, as good as the first
promises to be, would not lead there: on a white shaft in a bearing, where nearly all such fits end
so, that is half of their time; of 300 drawn scenes with highlights it changed none."""

LEVELS = 8
"""Of a part: outside a level and a ramp beside either edge, inside a, b, c and d."""

HEIGHT_ROUNDS = 2
ITERATIONS = 25
DONE_PX = 0.001
DONE_CHI2 = 0.02
"""A step that promises less moves no estimate by more than a seventh of its uncertainty. Around
edges sharper than the blur steps go to and fro for long."""

COST_NOISE = 1e-3
STEP_LIMITS = np.array([0.2, 0.2, 0.2, 0.2, 0.1, 0.1, 0.2, 0.1, 0.2])
BLUR_RANGE_PX = (0.3, 4.0)


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


@dataclass(frozen=True, slots=True, eq=False)
class Glossy:
    """What the shading of the whole width tells of both edges.

    Parameters
    ----------
    parameters, covariance
        Offset and tilt of both edges and the blur, undistorted px, shapes (5,) and (5, 5). What a
        rim that mirrors its surroundings may move is in the covariance: both edges alike.
    misfit
        By how many standard deviations the sum of squares exceeds that of noise.
    """

    parameters: Floats
    covariance: Floats
    misfit: float


class _Seen(NamedTuple):
    """How much bins see of angles: weights over noise and distances over blur, (parts, p, nodes).

    With the distances from the own edge over blur, (parts, p), and half the width, (parts,).
    """

    kernels: Floats
    z: Floats
    outward: Floats
    radius: Floats


class _Terms(NamedTuple):
    """Values of terms and their derivatives by distance and by blur."""

    values: Floats
    slopes: Floats
    spreads: Floats


class _Lobe(NamedTuple):
    """A highlight and its derivatives by its place and by the logarithms of its widths."""

    values: Floats
    by_place: Floats
    by_widths: tuple[Floats, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _System:
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


class _Found(NamedTuple):
    """Where steps led, how much the next one is damped, and whether there is none to come."""

    parameters: Floats
    system: _System
    damping: float = 1e-3
    done: bool = False

    @property
    def at_limb(self) -> bool:
        """Whether the highlight lies where it is much like a shift of the edge."""
        return bool(abs(self.parameters[5]) > LIMB_RAD)

    @property
    def is_narrow(self) -> bool:
        """Whether the highlight is so narrow that it may be the edge of a lamp's image."""
        return bool(self.parameters[6] < np.log(NARROW_RAD))

    def likelier_than(self, other: _Found) -> bool:
        """Tell whether it is likelier than another, clearly."""
        return self.system.improbability + LIKELIER < other.system.improbability


@dataclass(frozen=True, slots=True, eq=False)
class _Model:
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

    def seen(self, parameters: Floats) -> _Seen:
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
        return _Seen(kernels, z, (at.x_px - moves[:, at.edge]) / blur, radius)

    def outside(self, seen: _Seen, blur: float) -> _Terms:
        """Return level and ramp outside the own edge, by distance and blur, (2, parts, p)."""
        z = seen.outward
        bell = np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi)
        part = normal_cdf(z, bell)
        return _Terms(
            np.stack([part, blur * (z * part + bell)]) * self.root,
            np.stack([bell / blur, part]) * self.root,
            np.stack([-z * bell / blur, bell]) * self.root,
        )

    def highlight(self, parameters: Floats) -> _Lobe:
        """Return each part's highlight, shape (parts, nodes)."""
        place, width, drift, *half = parameters[5:]
        middle = place + drift * self.profile.lever.mean(axis=1)
        return self.lobe(self.angles - middle[:, None], *np.exp([width, *half]))

    def lobe(self, away: Floats, width: Floats, half: Floats | None = None) -> _Lobe:
        """Return highlights by the angle from their middle; of given h, a lamp's images."""
        if half is None:
            z = away / width
            lobe = np.exp(-0.5 * z * z)
            return _Lobe(lobe, lobe * z / width, (lobe * z * z,))
        soft = np.hypot(width, SHARPEST_NODES * np.pi / len(self.angles))
        first, last = (away + half) / soft, (away - half) / soft
        rise, fall = (np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi) for z in (first, last))
        by_soft = (last * fall - first * rise) * (width / soft) ** 2
        return _Lobe(
            normal_cdf(first, rise) - normal_cdf(last, fall),
            (fall - rise) / soft,
            (by_soft, (rise + fall) * half / soft),
        )

    def terms(self, seen: _Seen, outside: Floats, lobe: Floats) -> Floats:
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

    def system(self, parameters: Floats) -> _System:
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
        return _System(
            cost=float(left @ left + of_levels @ levels**2 + certain @ (away * away)),
            information=information + np.diag(certain),
            gradient=jacobian.T @ left + certain * away,
            gram=gram,
            levels=levels,
        )

    def height(self, system: _System) -> float:
        """Return what g's height should be multiplied by: MacKay's rule, with what is likely."""
        first = LEVELS * len(self.root)
        g = system.levels[first:]
        told = len(g) - float(np.trace(np.linalg.inv(system.gram)[first:, first:]))
        return float(np.sqrt((g @ g + LIKELY_PARTS) / (told + LIKELY_PARTS)))

    def jacobian(
        self, parameters: Floats, seen: _Seen, outside: _Terms, lobe: _Lobe, levels: Floats
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

    def starts(self, blur_px: float) -> list[Floats]:
        """Return parameters with different highlights, that which explains most first."""
        still = np.concatenate([np.zeros(4), [blur_px], self.likely[0]])
        seen = self.seen(still)
        outside = self.outside(seen, blur_px)
        none = np.zeros((len(self.root), len(self.angles)))
        terms = self.terms(seen, outside.values, none)
        _, levels, _ = self.solved(terms)
        dark = _Lobe(none, none, (none,) * (len(still) - 7))
        moves = self.jacobian(still, seen, outside, dark, levels)[:, [0, 2, 4]]
        terms = np.hstack([terms, moves])
        tried = [(place, width) for place in PLACES_RAD for width in WIDTHS_RAD]
        places, widths = np.transpose(tried)
        away = self.angles[:, None] - places
        sizes = (np.array(SOFTNESS_RAD), widths) if self.lamp else (widths,)
        lobes = self.lobe(away, *sizes).values
        columns = (seen.kernels @ lobes).reshape(len(terms), -1)
        columns = np.hstack([columns, (self.profile.grey * self.root).reshape(-1, 1)])
        gram = terms.T @ terms
        gram.flat[:: len(gram) + 1] += np.append(self.precision()[0], np.full(3, SHIFT_PX**-2))
        mixed = terms.T @ columns
        free = np.linalg.solve(gram, mixed)
        size = np.einsum("nk,nk->k", columns, columns) - np.einsum("nk,nk->k", mixed, free)
        along = columns.T @ columns[:, -1] - mixed.T @ free[:, -1]
        gain = along[:-1] ** 2 / (size[:-1] + 1e-6)
        found: list[Floats] = []
        for best in np.argsort(-gain):
            place, width = tried[int(best)]
            shape = np.array([place, np.log(width), 0.0])
            if self.lamp:
                shape = np.array([place, np.log(SOFTNESS_RAD), 0.0, np.log(width)])
            if all(np.abs(shape - other[5:]).max() > APART for other in found):
                found.append(np.concatenate([still[:5], shape]))
            if len(found) == STARTS:
                break
        return found

    def started(self, parameters: Floats) -> _Found:
        """Return a beginning."""
        return _Found(parameters, self.system(parameters))

    def followed(self, found: _Found, steps: int) -> _Found:
        """Return where up to so many of Levenberg's and Marquardt's steps lead."""
        parameters, system, damping, done = found
        if done:
            return found
        for _ in range(steps):
            step = system.step(damping)
            after = parameters + step
            after[4] = np.clip(after[4], *BLUR_RANGE_PX)
            if np.abs(step[:5]).max() < DONE_PX or system.cost - system.least < DONE_CHI2:
                return _Found(after, system, damping, done=True)
            tried = self.system(after)
            if tried.cost > system.cost + COST_NOISE:
                damping *= 10
            else:
                parameters, system, damping = after, tried, damping / 10
        return _Found(parameters, system, damping)

    def best(self, blur_px: float) -> _Found | None:
        """Return the best fit from all starts, or None where no fit converges."""
        trials: list[_Found] = []
        for start in map(self.started, self.starts(blur_px)):
            if not self.promises(start):
                continue
            trial = self.followed(start, TRIAL_STEPS)
            if self.misfit(trial.system.cost) < GOOD_MISFIT:
                trial = self.followed(trial, ITERATIONS)
                if trial.done and not trial.at_limb:
                    return trial
            trials.append(trial)
        trials.sort(key=lambda trial: trial.system.cost)
        hopeful = [t for t in trials if self.misfit(t.system.least) < HOPELESS_MISFIT]
        ends: list[_Found] = []
        for end in (self.followed(trial, ITERATIONS) for trial in hopeful):
            if end.done:
                ends.append(end)
            if end.done and not end.at_limb:
                break
        return min(ends, key=lambda end: end.system.improbability, default=None)

    def likeliest(self, blur_px: float) -> _Found | None:
        """Return the likeliest fit from all starts, or None where no fit converges.

        A misfit of noise is no sign that no other is far likelier: at the limb any end of a lamp's
        image passes for the shaft's edge.
        """
        starts = map(self.started, self.starts(blur_px))
        ends = [self.followed(start, ITERATIONS) for start in starts if self.promises(start)]
        done = (end for end in ends if end.done)
        return min(done, key=lambda end: end.system.improbability, default=None)

    def promises(self, start: _Found) -> bool:
        """Tell whether two steps, as good as the first promises to be, leave little but noise."""
        return self.misfit(2 * start.system.least - start.system.cost) <= HOPELESS_MISFIT

    def moved_by_rim(self, found: _Found) -> Floats:
        """Return how far the parameters are off if the rim mirrors as is likely, shape (n,)."""
        parameters, levels, parts = found.parameters, found.system.levels, len(self.root)
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
        return np.asarray(np.linalg.solve(found.system.information, gradient))

    def misfit(self, cost: float) -> float:
        """Return by how many standard deviations a sum of squares exceeds noise."""
        return (cost - self.freedom) / float(np.sqrt(2 * self.freedom))


def fit_glossy(profile: Profile, noise: float, blur: Blur, blur_px: float) -> Glossy | None:
    """Return both edges from the shading of the whole width, or None where no fit converges.

    Parameters
    ----------
    profile
        The grey levels.
    noise
        Standard deviation of a pixel, grey levels.
    blur, blur_px
        What is known of the blur beforehand, and what was found so far.

    References
    ----------
    Rasmussen and Williams, "Gaussian Processes for Machine Learning" (2006), section 2.7, for
    explicit terms beside a Gaussian process; MacKay, "Bayesian interpolation", Neural Computation
    4 (1992) 415, for its height; Golub and Pereyra, "Separable nonlinear least squares", Inverse
    Problems 19 (2003) R1, for the levels.
    """
    if not (profile.count > 0).any():
        return None
    nodes = int(np.ceil(np.pi * float(profile.half_px.max()) / (NODE_BLURS * blur_px)))
    height = ROUGHNESS_PART * float(np.ptp(profile.grey[profile.count > 0]))
    root = np.sqrt(profile.count) / noise
    model = _Model(profile, blur, root, _angles(nodes), height * _rough(nodes))
    best = model.best(blur_px)
    if best is None or model.misfit(best.system.cost) > GOOD_MISFIT or best.is_narrow:
        mirror = replace(model, lamp=True)
        image = mirror.likeliest(blur_px)
        if image is not None and (best is None or image.likelier_than(best)):
            model, best = mirror, image
    if best is None:
        return None
    for _ in range(HEIGHT_ROUNDS):
        model = replace(model, rough=model.rough * model.height(best.system))
        again = model.followed(model.started(best.parameters), ITERATIONS)
        best = again if again.done else best
    covariance = np.asarray(np.linalg.inv(best.system.information)[:5, :5], dtype=np.float64)
    covariance *= max(1.0, best.system.cost / model.freedom)
    moved = model.moved_by_rim(best)[:5]
    covariance += np.outer(moved, moved)
    return Glossy(best.parameters[:5], covariance, model.misfit(best.system.cost))


def _applied(kernels: Floats, *shadings: Floats) -> Floats:
    """Return what each part's bins see of its shadings, shape (shadings, parts, p)."""
    return np.moveaxis(kernels @ np.stack(shadings, axis=-1), -1, 0)


def _angles(nodes: int) -> Floats:
    """Return the middles of equal parts of the half circle."""
    return np.asarray((np.arange(nodes) + 0.5) * np.pi / nodes - np.pi / 2)


@lru_cache(maxsize=16)
def _rough(nodes: int) -> Floats:
    """Return functions of the angle that sum up to a Gaussian process of unit height, (n, k)."""
    grid = np.linspace(-np.pi / 2, np.pi / 2, ROUGHNESS_GRID)

    def alike(angles: Floats) -> Floats:
        square = ((angles[:, None] - grid) / ROUGHNESS_RAD) ** 2
        return np.asarray((1 + square / 4) ** -2)

    size, vectors = np.linalg.eigh(alike(grid))
    kept = size > 1e-6 * size[-1]
    return np.asarray(alike(_angles(nodes)) @ vectors[:, kept] / np.sqrt(size[kept]))
