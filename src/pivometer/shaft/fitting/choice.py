"""Which of several windows an edge takes, and what the others say differently.

Lepskii's rule: the most certain of those that fit and agree with all less certain ones that fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from pivometer.shaft.fitting.rungs import LIMB, Rung

LARGEST_MISFIT = 3.0
AGREEING_SIGMAS = 3.5
"""A window holds if its mean residual is within three standard deviations of noise, and if no less
certain one differs by 3.5. Over 40 scenes each, 2 and 3.0, 3 and 3.0, 3 and 3.5, 4 and 4.0 gave
Lambert-shaded edges 0.0078, 0.0056, 0.0048, 0.0048 px rms, oblique metal's centre 0.029, 0.031,
0.032, 0.038 px."""

COMPLEX_PX = 5.0
"""Where no window over 5 px holds, shading is not simple, and the narrowest window's answer
counts as another opinion: on oblique metal the others' stated errors are a half of the real."""

NARROW_PX = 3.5
"""Where no window fits, those within this count."""


class Said(NamedTuple):
    """What a window says of one edge: its offset, how certain that is, and how it fits."""

    offset_px: float
    sigma_px: float
    misfit: float


def chosen_rung(rungs: Sequence[Rung], said: Callable[[Rung], Said]) -> tuple[Rung, float]:
    """Return the best rung, and what others say differently, px.

    A ramp alone bends near the edge of a round shaft, so it is the last resort. The rungs that fit
    differ by their noise and by what their terms do not hold; the second is the systematic error.

    Parameters
    ----------
    rungs
        The windows, widest first.
    said
        What each says.

    References
    ----------
    Lepskii (1991), "On a problem of adaptive estimation in Gaussian white noise", Theory Probab.
    Appl. 35, 454.
    """
    limbs = {rung: said(rung) for rung in rungs if LIMB in rung.terms}
    fitting = [rung for rung in limbs if limbs[rung].misfit < LARGEST_MISFIT]
    if not fitting:
        narrow = {rung: said(rung) for rung in rungs if rung.inner_px <= NARROW_PX}
        best = min(narrow, key=lambda rung: narrow[rung].misfit)
        return best, float(np.ptp([one.offset_px for one in narrow.values()]) / 2)
    fitting.sort(key=lambda rung: limbs[rung].sigma_px)
    best = fitting[-1]
    for place, rung in enumerate(fitting):
        if all(_agrees(limbs[rung], limbs[r]) for r in fitting[place + 1 :]):
            best = rung
            break
    own = limbs[best]
    excess = [_excess(own, limbs[rung]) for rung in fitting if rung is not best]
    if best.inner_px <= COMPLEX_PX:
        excess.append((said(rungs[-1]).offset_px - own.offset_px) ** 2 / 4)
        return best, float(np.sqrt(np.max(excess)))
    return best, _spread(excess) if excess else 0.0


def spread_if_holds(own: Said, others: Sequence[Said]) -> float | None:
    """Return what less certain windows say differently, px, or None where an answer does not hold.

    Parameters
    ----------
    own
        The most certain answer.
    others
        Those of windows, of which the ones that fit count.
    """
    fitting = [other for other in others if other.misfit < LARGEST_MISFIT]
    holds = bool(fitting) and own.misfit < LARGEST_MISFIT
    if not (holds and all(_agrees(own, other) for other in fitting)):
        return None
    return _spread([_excess(own, other) for other in fitting])


def _spread(excess: Sequence[float]) -> float:
    """Return the root of a mean excess that may be negative by chance, px."""
    return float(np.sqrt(max(float(np.mean(excess)), 0.0)))


def _agrees(one: Said, other: Said) -> bool:
    """Tell whether two nested estimates differ by no more than their noise may."""
    variance = max(other.sigma_px**2 - one.sigma_px**2, 1e-8)
    return abs(one.offset_px - other.offset_px) / float(np.sqrt(variance)) < AGREEING_SIGMAS


def _excess(own: Said, other: Said) -> float:
    """Return the square of a difference less what noise explains of it, px²."""
    noise = abs(other.sigma_px**2 - own.sigma_px**2)
    return float((other.offset_px - own.offset_px) ** 2 - noise)
