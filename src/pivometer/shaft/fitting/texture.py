"""What lanes of a brushed shaft may move an edge by, though every model of its shading fits.

Brushing runs along a shaft, so its lanes are alike in all rows: no number of rows averages out a
lane at the edge, nor can one be told from a shift of the edge by its grey level over the contrast.
But lanes farther inside tell how large such shifts are. An edge is moved by what a narrow window
would be moved by if the lanes inside, one place after another, lay at it.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.shaft.fitting.fitted import FittedEdges
from pivometer.shaft.fitting.lines import width_px
from pivometer.shaft.fitting.profile import normal_cdf
from pivometer.shaft.fitting.samples import Samples, pixels
from pivometer.shaft.fitting.strip import strip
from pivometer.shaft.fitting.view import ShaftView

WINDOW_PX = 3.0
"""Reach to both sides of the narrow window: wider ones do not fit an edge with lanes. All lengths
times the blur where that is over 1 px."""

CLEAR_PX = 1.5
"""Nearer to an edge blur mixes both sides."""

REACH_PX = 12.0
"""So far inside, as the widest window, or half-way to the other edge, lanes are looked at."""

SMOOTH_PX = 4.0
"""Shading less its parabola within so many px to both sides is that of lanes: that of bright, dark
and glossy shafts without lanes came to 0.003 to 0.011 px, of brushed ones to 0.06 to 0.22 px."""

BIN_PX = 0.25
QUARTILE, QUARTILE_CHI2 = 25.0, 0.1015
"""Per cent, and that quantile of a square of unit variance. Lanes are everywhere; a highlight is on
one side, so that no more than half of the places see it: it does not count as lanes."""


def with_texture(view: ShaftView, fitted: FittedEdges) -> FittedEdges:
    """Return fitted edges less certain by what the shaft's lanes may move them by.

    Parameters
    ----------
    view
        The image.
    fitted
        The edges; only its rows count.
    """
    blur = float(fitted.parameters[4])
    widen, width = max(1.0, blur), width_px(fitted.lines)
    inner = min(REACH_PX * widen, width / 2)
    weights, depths = _weights(blur, widen), np.arange(-inner, -CLEAR_PX * widen, BIN_PX)
    if len(depths) < len(weights):
        return fitted
    reach = max(inner, WINDOW_PX * widen), WINDOW_PX * widen
    bands = strip(view.about(fitted.lines), near_px=reach)
    rows = bands.valid * fitted.accepted_at(bands.lever.mean(axis=-1))
    half = np.full_like(bands.scale, width / 2)
    samples = pixels(bands, half, rows, None, slice(None))
    sides = samples.of_edge(0), samples.of_edge(1)
    squares = [_squares(side, depths, weights, widen, fitted.noise_grey) for side in sides]
    variance = max(float(np.percentile(np.concatenate(squares), QUARTILE)), 0.0)
    covariance = fitted.covariance.copy()
    for edge, side in enumerate(sides):
        at, moved = slice(2 * edge, 2 * edge + 2), _moved(side, widen)
        covariance[at, at] += variance * np.outer(moved, moved)
    return replace(fitted, covariance=covariance)


def _weights(blur: float, widen: float) -> Floats:
    """Return what grey levels beside an edge of unit contrast move it by, per bin from the inside.

    Levels of both sides and a ramp inside are solved for. Lanes end at the edge.
    """
    x = np.arange(-WINDOW_PX * widen, WINDOW_PX * widen, BIN_PX) + BIN_PX / 2
    bell = np.exp(-0.5 * (x / blur) ** 2) / np.sqrt(2 * np.pi)
    outside = normal_cdf(x / blur, bell)
    terms = np.stack([outside, 1 - outside, x * (1 - outside)])
    left = bell - np.linalg.lstsq(terms.T, bell, rcond=None)[0] @ terms
    weights = left / (left @ bell) * blur * (1 - outside)
    return np.asarray(weights[x < CLEAR_PX * widen])


def _squares(
    side: Samples, depths_px: Floats, weights: Floats, widen: float, noise: float
) -> Floats:
    """Return squares of what lanes inside would move an edge of unit contrast by, noise taken off.

    One for each place inside, over the quartile of a square of unit variance, grey levels² px².
    """
    profile, pixels = _profile(side, depths_px)
    rough = profile - _smoothing(len(profile), round(SMOOTH_PX * widen / BIN_PX)) @ profile
    moves = np.lib.stride_tricks.sliding_window_view(rough, len(weights)) @ weights
    return np.asarray(moves**2 / QUARTILE_CHI2 - noise**2 * (weights @ weights) / max(pixels, 1.0))


def _profile(side: Samples, depths_px: Floats) -> tuple[Floats, float]:
    """Return the mean grey level along the shaft at depths, and how many pixels each is of."""
    index = np.floor((side.x_px - depths_px[0]) / BIN_PX).astype(np.intp)
    used = side.count * ((index >= 0) & (index < len(depths_px)))
    usual = (used * side.grey).sum(axis=1) / np.maximum(used.sum(axis=1), 1)
    place = np.clip(index, 0, len(depths_px) - 1).ravel()

    def summed(values: Floats) -> Floats:
        sums = np.bincount(place, (used * values).ravel(), len(depths_px))
        return np.asarray(sums, dtype=np.float64)

    count = summed(np.ones_like(side.grey))
    seen = count > 0
    if not seen.any():
        return np.zeros(len(depths_px)), 0.0
    x, grey = (summed(v)[seen] / count[seen] for v in (side.x_px, side.grey - usual[:, None]))
    # An upright shaft's pixels may all lie at whole distances.
    return np.interp(depths_px + BIN_PX / 2, x, grey), float(count.mean())


@lru_cache(maxsize=64)
def _smoothing(count: int, reach: int) -> Floats:
    """Return the matrix of parabolas through values within reach of each of a row of them."""
    matrix = np.zeros((count, count))
    for k in range(count):
        near = slice(max(k - reach, 0), min(k + reach + 1, count))
        x = np.arange(count)[near] - k
        matrix[k, near] = np.linalg.pinv(np.stack([np.ones_like(x), x, x * x], axis=1))[0]
    return matrix


def _moved(side: Samples, widen: float) -> Floats:
    """Return by what offset and tilt lanes of unit effect move an edge, by the contrasts.

    Where the background is darker in one place and brighter in another, lanes move the edge in and
    out, and their effects cancel in part.
    """
    x, near, far = side.x_px, CLEAR_PX * widen, WINDOW_PX * widen

    def mean(there: NDArray[np.bool_]) -> tuple[Floats, Floats]:
        count = (side.count * there).sum(axis=1)
        return (side.count * there * side.grey).sum(axis=1) / np.maximum(count, 1), count

    (outer, beyond), (inner, within) = mean((x > near) & (x < far)), mean((x < -near) & (x > -far))
    step, weight = outer - inner, np.minimum(beyond, within)
    lever = np.stack([np.ones_like(step), side.lever.mean(axis=1)])
    normal = (lever * weight * step**2) @ lever.T
    normal[range(2), range(2)] += 1e-9 * normal.diagonal() + 1e-9
    return np.asarray(np.linalg.solve(normal, lever @ (weight * step)))
