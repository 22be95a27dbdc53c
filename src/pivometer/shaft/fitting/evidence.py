"""What tells how far an edge can be trusted: straightness, contrast, saturation, blur."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.shaft.fitting.fitted import FittedEdges

DEVIATIONS = 16
"""Sections of an edge whose own offsets are stated."""

LOW_CONTRAST_NOISES = 5.0
"""Below, the error of one row is over half a pixel's blur, and rows can no longer be told apart."""

LARGE_BLUR_PX = 2.0
BLURS_ACROSS = 10.0
"""Windows of five blurs to each side of both edges meet in a shaft so many blurs wide."""

SATURATED_PART = 0.02
RESPONSE_PX = 0.02
"""Below, point spreads that are not quite Gaussian look like a response that is not linear."""

BENT_SIGMAS = 4.0
BENT_PX = 0.1
"""A bend is named where both edges' bows together are significant and each is half as much so, and
larger than what shading alone has moved rows by."""


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """Fields of `ShaftEdges` of the same names."""

    curvature_px: Floats
    curvature_sigma_px: Floats
    deviation_px: Floats
    deviation_sigma_px: Floats
    warnings: tuple[str, ...]


def blurs_meet(width_px: float, blur_px: float) -> bool:
    """Tell whether edges are so blurred and so near each other that one reaches the other's window.

    Examples
    --------
    >>> blurs_meet(20.0, 3.0), blurs_meet(40.0, 3.0), blurs_meet(7.0, 0.8)
    (True, False, False)
    """
    return blur_px > LARGE_BLUR_PX and width_px < BLURS_ACROSS * blur_px


def evidence(fitted: FittedEdges) -> Evidence:
    """Return how straight fitted edges are, and what to warn of."""
    weight = fitted.weight * fitted.accepted
    bends = [
        bend(*rows)
        for rows in zip(fitted.lever, fitted.offset_px, weight, fitted.accepted, strict=True)
    ]
    curvature, sigma = np.array(bends).T
    sections = [
        _sections(*rows)
        for rows in zip(fitted.lever, fitted.offset_px, weight, fitted.accepted, strict=True)
    ]
    deviation, deviation_sigma = np.moveaxis(np.array(sections), 1, 0)
    warnings = _warnings(fitted, curvature, sigma)
    return Evidence(curvature, sigma, deviation, deviation_sigma, warnings)


def saturated_part(grey: Floats, used: NDArray[np.bool_], depth: np.dtype[np.generic]) -> Floats:
    """Return the part of the pixels (2, rows, k) of used rows that a sensor's limit clips, (2,).

    The limits are 255 of 8 bits, and of 16 bits those of 10, 12, 14 and 16, at either end.
    """
    if depth.kind not in "ui":
        return np.zeros(2)
    bits = (8,) if depth.itemsize == 1 else (10, 12, 14, 16)
    top = float(grey.max(initial=0.0))
    if top not in {float(s) for b in bits for s in (2**b - 1, (2**b - 1) << (bits[-1] - b))}:
        return np.zeros(2)
    clipped = ((grey == top).mean(axis=-1) * used).sum(axis=1)
    part: Floats = clipped / np.maximum(used.sum(axis=1), 1)
    return part


def bend(
    lever: Floats, offset: Floats, weight: Floats, used: NDArray[np.bool_]
) -> tuple[float, float]:
    """Return the sagitta of a parabola through rows' offsets, px, and its standard uncertainty.

    Parameters
    ----------
    lever, offset, weight
        Place along the edge, offset (px) and inverse variance (1/px²) of rows, shape (n,).
    used
        Which rows count.

    Examples
    --------
    >>> t = np.linspace(-1, 1, 201)
    >>> sagitta, _ = bend(t, 0.3 * (1 - t**2), np.ones(201), np.ones(201, bool))
    >>> round(sagitta, 9)
    0.3
    """
    t, y, w = lever[used], offset[used], weight[used]
    if t.size < 4 or t.max() <= t.min():
        return 0.0, 0.0
    t = (2 * t - t.max() - t.min()) / (t.max() - t.min())
    design = np.stack([np.ones_like(t), t, t * t], axis=1)
    normal = (design * w[:, None]).T @ design
    inverse = np.linalg.inv(normal + 1e-12 * np.trace(normal) * np.eye(3))
    fit = inverse @ ((design * w[:, None]).T @ y)
    scatter = float((w * (y - design @ fit) ** 2).sum()) / max(t.size - 3, 1)
    return -float(fit[2]), float(np.sqrt(inverse[2, 2] * max(scatter, 1.0)))


def _sections(
    lever: Floats, offset: Floats, weight: Floats, used: NDArray[np.bool_]
) -> tuple[Floats, Floats]:
    """Return the weighted mean offset of the rows in each section and its sigma; 0, 0 if none."""
    t, y, w = lever[used], offset[used], weight[used]
    place = (t - t.min()) / max(float(np.ptp(t)), 1e-12) * DEVIATIONS
    index = np.minimum(place.astype(np.intp), DEVIATIONS - 1)
    total = np.bincount(index, w, DEVIATIONS)
    mean = np.bincount(index, w * y, DEVIATIONS) / np.where(total > 0, total, 1)
    sigma = np.where(total > 0, 1 / np.sqrt(np.where(total > 0, total, 1)), 0.0)
    return mean, sigma


def _warnings(fitted: FittedEdges, curvature: Floats, sigma: Floats) -> tuple[str, ...]:
    found, saturated = [], float(fitted.saturated_part.max())
    weakest = float(fitted.contrast.min())
    if weakest < LOW_CONTRAST_NOISES * fitted.noise_grey:
        found.append(
            f"low contrast: {weakest:.0f} grey levels at a noise of {fitted.noise_grey:.1f}; "
            "a background unlike the shaft would make the edges more certain"
        )
    if saturated > SATURATED_PART:
        found.append(
            f"saturated: {100 * saturated:.0f} % of the pixels beside an edge are at the "
            "sensor's limit, which moves each edge by 0.1 px and more; expose for less"
        )
    if abs(fitted.response_px) > RESPONSE_PX:
        found.append(
            "not linear: the grey levels across both edges rise as those of a sensor with gamma, "
            f"which moves each edge {'outward' if fitted.response_px > 0 else 'inward'} by about "
            f"{abs(fitted.response_px):.2f} px, so the shaft measures too "
            f"{'thick' if fitted.response_px > 0 else 'thin'}; the centerline stays. Record with "
            "gamma 1, as PNG or TIFF"
        )
    if fitted.parameters[4] > LARGE_BLUR_PX:
        found.append(
            f"blurred: the edges are {fitted.parameters[4]:.1f} px wide (standard deviation); "
            "focus on the shaft or expose for less long"
        )
    each = np.abs(curvature) > np.maximum(BENT_SIGMAS / 2 * sigma, BENT_PX)
    together = np.abs(curvature[1] - curvature[0]) > BENT_SIGMAS * np.hypot(*sigma)
    # A bent shaft bends both edges the same way; outward is opposite for the two.
    if each.all() and together and curvature[0] * curvature[1] < 0:
        found.append(
            f"bent: both edges bow by {np.abs(curvature).mean():.2f} px over their length; the "
            "shaft is not straight, or the lens is not as calibrated"
        )
    return tuple(found)
