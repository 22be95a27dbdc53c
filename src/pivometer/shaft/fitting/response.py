"""Whether a sensor's response bends: a blurred step that is not the same from both of its sides.

A response that is not linear (JPEG files, video, cameras with "gamma") lifts the middle of every
blurred step, y = Φ + κ Φ (1 − Φ) to second order, which a fit of Φ takes for a shift of the edge by
0.59 κ blurs: 0.3 px for gamma 2.2 from black to white. What no shift explains of it is a
fiftieth of the step, and over a whole edge that shows. Both edges move outward, or both inward, so
the centre stays and the width is wrong. An asymmetric blur looks alike, but opposite at the
two edges.
"""

from __future__ import annotations

import numpy as np

from pivometer._arrays import Floats

SHIFT_BLURS = 0.591
"""(∫ Φ (1 − Φ) φ) / (∫ φ²) = (1/6) / (1 / (2 √π)): the shift that explains most of Φ (1 − Φ)."""

SIGNIFICANT_SIGMAS = 5.0
MOST_UNLIKE = 0.5
"""Two edges show one response if their κ differ by less than this part of their sum: the levels at
both sides need not be quite the same. Chosen, not measured."""


def common_shift_px(rest: Floats, contrast: Floats, variance: float, blur_px: float) -> float:
    """Return how far a response that bends moves both edges outward (px), 0 if none is seen.

    Parameters
    ----------
    rest
        Of every chunk of both edges, after its levels are eliminated: the sums of products of
        the derivatives by offset, tilt and blur per unit step, of Φ (1 − Φ), and of the grey
        levels; shape (2, chunks, 5, 5).
    contrast
        Outside less inside grey level, shape (2, chunks).
    variance
        Of a pixel, grey levels².
    blur_px
        The blur's standard deviation.
    """
    information = (rest[..., :4, :4] * (contrast**2)[..., None, None]).sum(axis=1)
    gradient = (rest[..., :4, 4] * contrast[..., None]).sum(axis=1)
    covariance = np.linalg.inv(information + 1e-9 * np.eye(4)) * variance
    bent = np.einsum("ei,ei->e", covariance[:, 3], gradient) / variance
    sigma = np.sqrt(covariance[:, 3, 3])
    alike = abs(bent[0] - bent[1]) < MOST_UNLIKE * abs(bent.sum())
    if not alike or (np.abs(bent) < SIGNIFICANT_SIGMAS * sigma).any():
        return 0.0
    weight = 1 / sigma**2
    return -SHIFT_BLURS * blur_px * float((weight * bent).sum() / weight.sum())
