"""The mean grey levels across the whole width of a shaft, and both edges fitted to them."""

from __future__ import annotations

import numpy as np

from pivometer._arrays import Floats
from pivometer.shaft.fitting.evidence import saturated_part
from pivometer.shaft.fitting.glossy import Glossy, fit_glossy
from pivometer.shaft.fitting.glossy_model import Profile
from pivometer.shaft.fitting.lines import tapers_px, width_px
from pivometer.shaft.fitting.rungs import Blur
from pivometer.shaft.fitting.strip import Strip, strip
from pivometer.shaft.fitting.view import ShaftView

PARTS = 4
"""The shaft's length is fitted in so many parts, in each of which its width counts as constant."""

BIN_PX = 0.35
"""Averaging over a bin blurs by 0.1 px, which the free blur takes up."""

OUTER_PX = 6.0
LARGEST_HALF_PX = 60.0
"""Wider shafts take long, and in windows of 12 px their shading is simple."""

FULL_BIN = 10
"""Bins with fewer pixels do not tell of noise."""


def fit_whole_width(
    view: ShaftView,
    rows: Floats,
    *,
    noise: float,
    blur: Blur,
    blur_px: float,
) -> Glossy | None:
    """Return both edges from the shading of the whole width, or None if it is not understood.

    Parameters
    ----------
    view
        The image, and the edges to half a pixel.
    rows
        1 for the rows that count, shape (2, rows).
    noise
        Standard deviation of a pixel at most, grey levels.
    blur, blur_px
        What is known of the blur beforehand, and what was found so far.
    """
    lines, width = view.lines, width_px(view.lines)
    if width / 2 > LARGEST_HALF_PX:
        return None
    reach = float(width / 2 + np.abs(tapers_px(lines)).max() + 1)
    bands = strip(view, near_px=(reach, OUTER_PX + 1))
    middle = bands.lever[..., bands.lever.shape[2] // 2, None]
    half = np.maximum(width / 2 + tapers_px(lines)[..., 0] * middle, 1.0)
    profile = profile_across(bands, half, rows * bands.valid, view.depth)
    return fit_glossy(profile, min(noise, profile.noise), blur, blur_px)


def profile_across(
    bands: Strip, half_px: Floats, rows: Floats, depth: np.dtype[np.generic]
) -> Profile:
    """Return the mean grey levels across a shaft, without bins that the sensor's limit clips.

    Parameters
    ----------
    bands
        The pixels from beside either edge to the axis.
    half_px
        Half the width at each row of both edges, undistorted px, shape (2, rows, 1).
    rows
        1 for the rows that count, shape (2, rows).
    depth
        Type of the image's grey levels.
    """
    half = half_px * bands.scale
    columns = int(np.ceil((float(half.max()) + OUTER_PX) / BIN_PX))
    place = np.floor((OUTER_PX - bands.x_px) / BIN_PX).astype(np.intp)
    seen = np.flatnonzero(rows.any(axis=0))
    limits = np.quantile(seen, np.arange(1, PARTS) / PARTS) if seen.size else np.zeros(PARTS - 1)
    part = np.searchsorted(limits, np.arange(rows.shape[1]))[:, None]
    # A bin at the axis that only the wider rows of a part reach would tell of their shading.
    narrowest = np.full(PARTS, np.inf)
    np.minimum.at(narrowest, part[seen, 0], half[:, seen].min(axis=(0, 2)))
    within = (OUTER_PX + narrowest[part]) / BIN_PX
    used = rows[..., None] * ((place >= 0) & (place + 1 <= within))
    edge = np.arange(2)[:, None, None]
    index = ((2 * part + edge) * columns + np.clip(place, 0, columns - 1)).ravel()

    def total(values: Floats) -> Floats:
        sums = np.bincount(index, (used * values).ravel(), 2 * PARTS * columns)
        return np.asarray(sums, dtype=np.float64).reshape(PARTS, 2 * columns)

    count = total(np.ones(()))
    share = 1 / np.maximum(count, 1)
    beside = np.maximum(count.reshape(PARTS, 2, columns).sum(axis=-1), 1)

    def mean(values: Floats) -> Floats:
        return np.asarray(total(values).reshape(PARTS, 2, columns).sum(axis=-1) / beside)

    grey = total(bands.near) * share
    spread = (total(bands.near**2) * share - grey**2) * count / np.maximum(count - 1, 1)
    full = count > FULL_BIN
    noise = float(np.median(spread[full])) if full.any() else 1.0
    if saturated_part(bands.near, rows > 0, depth).any():
        clipped = np.asarray(bands.near == bands.near.max(), dtype=np.float64)
        count = count * (total(clipped) == 0)
    return Profile(
        grey=grey,
        count=count,
        x_px=total(bands.x_px) * share,
        edge=np.repeat([0, 1], columns),
        half_px=mean(half),
        lever=mean(bands.lever),
        scale=mean(bands.scale),
        noise=float(np.sqrt(max(noise, 1 / 12))),
    )
