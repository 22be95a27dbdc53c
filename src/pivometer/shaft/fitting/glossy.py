"""Both edges of a shaft with a highlight, fitted at once to the shading of its whole width.

The model (`glossy_model`) is fitted from several starts, first with a Gaussian highlight. Where
that is narrow, or does not fit, the image of a lamp or window is tried in its place, and counts if
it is clearly likelier.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pivometer._arrays import Floats
from pivometer.shaft.fitting.glossy_model import Lobe, Model, Profile, System
from pivometer.shaft.fitting.rungs import Blur

PLACES_RAD = np.arange(-1.4, 1.41, 0.1)
WIDTHS_RAD = np.array([0.05, 0.08, 0.13, 0.2, 0.3, 0.5])
SOFTNESS_RAD = 0.04
"""Where highlights are looked for first, and the width of a lamp's edges at first."""

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

HEIGHT_ROUNDS = 2
ITERATIONS = 25
DONE_PX = 0.001
DONE_CHI2 = 0.02
"""A step that promises less moves no estimate by more than a seventh of its uncertainty. Around
edges sharper than the blur steps go to and fro for long."""

COST_NOISE = 1e-3
BLUR_RANGE_PX = (0.3, 4.0)


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


class Found(NamedTuple):
    """Where steps led, how much the next one is damped, and whether there is none to come."""

    parameters: Floats
    system: System
    damping: float = 1e-3
    done: bool = False

    @classmethod
    def first(cls, model: Model, parameters: Floats) -> Found:
        """Return what there is before any step."""
        return cls(parameters, model.system(parameters))

    @property
    def at_limb(self) -> bool:
        """Whether the highlight lies where it is much like a shift of the edge."""
        return bool(abs(self.parameters[5]) > LIMB_RAD)

    @property
    def is_narrow(self) -> bool:
        """Whether the highlight is so narrow that it may be the edge of a lamp's image."""
        return bool(self.parameters[6] < np.log(NARROW_RAD))

    def likelier_than(self, other: Found) -> bool:
        """Tell whether it is likelier than another, clearly."""
        return self.system.improbability + LIKELIER < other.system.improbability


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
    model = Model.of(profile, noise, blur, blur_px)
    best = _best(model, blur_px)
    if best is None or model.misfit(best.system.cost) > GOOD_MISFIT or best.is_narrow:
        mirror = replace(model, lamp=True)
        image = _likeliest(mirror, blur_px)
        if image is not None and (best is None or image.likelier_than(best)):
            model, best = mirror, image
    if best is None:
        return None
    for _ in range(HEIGHT_ROUNDS):
        model = model.with_height(best.system)
        again = followed(model, Found.first(model, best.parameters), ITERATIONS)
        best = again if again.done else best
    covariance = np.asarray(np.linalg.inv(best.system.information)[:5, :5], dtype=np.float64)
    covariance *= max(1.0, best.system.cost / model.freedom)
    moved = model.moved_by_rim(best.parameters, best.system)[:5]
    covariance += np.outer(moved, moved)
    return Glossy(best.parameters[:5], covariance, model.misfit(best.system.cost))


def _promising(model: Model, blur_px: float) -> Iterator[Found]:
    """Yield starts from which two steps, as good as the first promises, leave little but noise."""
    for parameters in _starts(model, blur_px):
        start = Found.first(model, parameters)
        if model.misfit(2 * start.system.least - start.system.cost) <= HOPELESS_MISFIT:
            yield start


def _starts(model: Model, blur_px: float) -> list[Floats]:
    """Return parameters with different highlights, that which explains most first."""
    still = np.concatenate([np.zeros(4), [blur_px], model.likely[0]])
    seen = model.seen(still)
    outside = model.outside(seen, blur_px)
    none = np.zeros((len(model.root), len(model.angles)))
    terms = model.terms(seen, outside.values, none)
    _, levels, _ = model.solved(terms)
    dark = Lobe(none, none, (none,) * (len(still) - 7))
    moves = model.jacobian(still, seen, outside, dark, levels)[:, [0, 2, 4]]
    terms = np.hstack([terms, moves])
    tried = [(place, width) for place in PLACES_RAD for width in WIDTHS_RAD]
    places, widths = np.transpose(tried)
    away = model.angles[:, None] - places
    sizes = (np.array(SOFTNESS_RAD), widths) if model.lamp else (widths,)
    lobes = model.lobe(away, *sizes).values
    columns = (seen.kernels @ lobes).reshape(len(terms), -1)
    columns = np.hstack([columns, (model.profile.grey * model.root).reshape(-1, 1)])
    gram = terms.T @ terms
    gram.flat[:: len(gram) + 1] += np.append(model.precision()[0], np.full(3, SHIFT_PX**-2))
    mixed = terms.T @ columns
    free = np.linalg.solve(gram, mixed)
    size = np.einsum("nk,nk->k", columns, columns) - np.einsum("nk,nk->k", mixed, free)
    along = columns.T @ columns[:, -1] - mixed.T @ free[:, -1]
    gain = along[:-1] ** 2 / (size[:-1] + 1e-6)
    found: list[Floats] = []
    for best in np.argsort(-gain):
        place, width = tried[int(best)]
        shape = np.array([place, np.log(width), 0.0])
        if model.lamp:
            shape = np.array([place, np.log(SOFTNESS_RAD), 0.0, np.log(width)])
        if all(np.abs(shape - other[5:]).max() > APART for other in found):
            found.append(np.concatenate([still[:5], shape]))
        if len(found) == STARTS:
            break
    return found


def followed(model: Model, found: Found, steps: int) -> Found:
    """Return where up to so many of Levenberg's and Marquardt's steps lead."""
    parameters, system, damping, done = found
    if done:
        return found
    for _ in range(steps):
        step = system.step(damping)
        after = parameters + step
        after[4] = np.clip(after[4], *BLUR_RANGE_PX)
        if np.abs(step[:5]).max() < DONE_PX or system.cost - system.least < DONE_CHI2:
            return Found(after, system, damping, done=True)
        tried = model.system(after)
        if tried.cost > system.cost + COST_NOISE:
            damping *= 10
        else:
            parameters, system, damping = after, tried, damping / 10
    return Found(parameters, system, damping)


def _best(model: Model, blur_px: float) -> Found | None:
    """Return the best fit from all starts, or None where no fit converges."""
    trials: list[Found] = []
    for start in _promising(model, blur_px):
        trial = followed(model, start, TRIAL_STEPS)
        if model.misfit(trial.system.cost) < GOOD_MISFIT:
            trial = followed(model, trial, ITERATIONS)
            if trial.done and not trial.at_limb:
                return trial
        trials.append(trial)
    trials.sort(key=lambda trial: trial.system.cost)
    hopeful = [t for t in trials if model.misfit(t.system.least) < HOPELESS_MISFIT]
    ends: list[Found] = []
    for end in (followed(model, trial, ITERATIONS) for trial in hopeful):
        if end.done:
            ends.append(end)
        if end.done and not end.at_limb:
            break
    return min(ends, key=lambda end: end.system.improbability, default=None)


def _likeliest(model: Model, blur_px: float) -> Found | None:
    """Return the likeliest fit from all starts, or None where no fit converges.

    A misfit of noise is no sign that no other is far likelier: at the limb any end of a lamp's
    image passes for the shaft's edge.
    """
    ends = [followed(model, start, ITERATIONS) for start in _promising(model, blur_px)]
    done = (end for end in ends if end.done)
    return min(done, key=lambda end: end.system.improbability, default=None)
