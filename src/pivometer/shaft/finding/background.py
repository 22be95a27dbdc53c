"""What stands still in one camera's frames, and the edges that do not.

The cameras stand still, so whatever is the same in most frames is background. Asking this of the
image gradient instead of the grey level makes it work with few poses: a shaft 20 px wide hides a
pixel near the pivot in most frames, and its grey level passes for background there, but its edges,
2 px wide, hardly ever cross the same pixel twice.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats

Image = NDArray[np.uint8] | NDArray[np.uint16]

WORKING_SIDE_PX = 1280
"""Longest side of the copy that is searched; larger images are averaged down by a whole factor."""

SAMPLED_FRAMES = 25
"""Frames that give the median: bounds memory and time. Of 36 drawn frames 1.5 % more are found than
with 15."""

GREY_UNITS = 4080
"""Full scale of the working copy: 16 units a grey level of an 8-bit image, so that blurring does
not round, and a Sobel sum still fits 16 bits."""

FLOOR = 160.0
"""Least gradient of an edge: a step of about 4 of 255 grey levels at the usual blur."""

NOISE_FACTOR = 4.0
"""An edge's gradient stands out of the gradient's noise by this factor."""

MOVED_FRACTION = 0.4
"""An edge has moved where the gradient differs from the median's by this share of itself. A
static edge that flickers by 5 % differs by 0.05; two frames alone differ from their mean by
0.5."""

LIT = GREY_UNITS // 16
"""Darker pixels do not tell of a flicker of the light, nor does a picture most of which is darker:
what is lit there moves."""

CLOSED_PX = 7
BESIDE_PX = 9
UNCHANGED = 4.5
OUTLINE_SLOPES = (2500.0, 4000.0)
"""Before an empty frame a shaft's outline is where the grey levels begin to differ from it. Gaps of
up to 7 px, where a lane of brushed metal is as bright as what it hides, are closed; the difference
is taken in parts of the greatest within 4 px, or of 4.5 times the usual one, which is noise; and
these are Canny's thresholds, where a sharp edge has 9200. Chosen in sessions drawn for it."""


@dataclass(frozen=True, slots=True)
class WorkingScale:
    """How raw frames become working copies: a whole shrinking factor and a grey-level range."""

    factor: int
    low: float
    high: float

    def copy(self, image: Image) -> NDArray[np.uint16]:
        """Return the image averaged down by the factor, grey levels stretched to GREY_UNITS."""
        return self.stretched(averaged(image, self.factor))

    def stretched(self, small: Image) -> NDArray[np.uint16]:
        """Return an averaged image with its grey levels stretched to GREY_UNITS."""
        gain = GREY_UNITS / (self.high - self.low)
        levels = np.arange(256 if small.dtype == np.uint8 else 65536)
        table = np.clip((levels - self.low) * gain, 0, GREY_UNITS).astype(np.uint16)
        if small.dtype == np.uint8:  # ten times as fast as indexing
            return np.asarray(cv2.LUT(small, table), dtype=np.uint16)
        copy: NDArray[np.uint16] = table[small]
        return copy

    def raw_pixels(self, points_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points (..., 2) of the working copy in pixels of the raw image."""
        return (points_px + 0.5) * self.factor - 0.5

    def working_pixels(self, points_px: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points (..., 2) of the raw image in pixels of the working copy."""
        return (points_px + 0.5) / self.factor - 0.5


def shrinking(image: Image) -> int:
    """Return the whole factor that brings an image to WORKING_SIDE_PX or below."""
    return math.ceil(int(max(image.shape)) / WORKING_SIDE_PX)


def averaged(image: Image, factor: int) -> Image:
    """Return an image averaged down by a whole factor."""
    height, width = (size // factor for size in image.shape)
    whole = image[: height * factor, : width * factor]
    small = np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA))
    return small.astype(np.uint8) if image.dtype == np.uint8 else small.astype(np.uint16)


def working_scale(smalls: Sequence[Image], factor: int) -> WorkingScale:
    """Choose the grey-level range for one camera's frames from some averaged ones."""
    samples = [smalls[i][::7, ::7] for i in sampled(len(smalls), 5)]
    low, high = np.percentile(np.concatenate([s.ravel() for s in samples]), (0.2, 99.8))
    least = 48.0 if smalls[0].dtype == np.uint8 else 64.0
    return WorkingScale(factor, float(low), float(max(high, low + least)))


def sampled(count: int, most: int) -> list[int]:
    """Return at most `most` indices spread evenly over `count` frames.

    Examples
    --------
    >>> sampled(3, 25), sampled(9, 3)
    ([0, 1, 2], [0, 4, 8])
    """
    if count <= most:
        return list(range(count))
    return sorted({round(i * (count - 1) / (most - 1)) for i in range(most)})


def gradient(copy: NDArray[np.uint16]) -> NDArray[np.int16]:
    """Return the Sobel gradient (2, height, width) of a working copy after a blur of 1 px."""
    smooth = cv2.GaussianBlur(copy, (0, 0), 1.0)
    slopes = np.empty((2, *copy.shape), dtype=np.int16)
    for along, part in zip(((1, 0), (0, 1)), slopes, strict=True):
        cv2.Sobel(smooth, cv2.CV_16S, *along, dst=part)
    return slopes


@dataclass(frozen=True, slots=True, eq=False)
class StaticScene:
    """The median over the frames: gradient (2, h, w), grey level (h, w), and the edge threshold."""

    gradient: NDArray[np.int16]
    grey: NDArray[np.uint16]
    threshold: float


def static_scene(
    copies: Sequence[NDArray[np.uint16]],
    slopes: Sequence[NDArray[np.int16]],
    other: NDArray[np.int16] | None = None,
) -> StaticScene:
    """Return what stands still in the working copies of a sequence, or in one empty frame.

    The noise is that of the gradient `other` about the median of `slopes`, the copies' gradients;
    by default the middle one's.
    """
    still = layered_median(np.stack(slopes)).astype(np.int16)
    grey = layered_median(np.stack(copies)).astype(np.uint16)
    other = slopes[len(copies) // 2] if other is None else other
    noise = 1.4826 * float(np.median(np.abs(other.astype(np.int32) - still)))
    return StaticScene(still, grey, max(FLOOR, NOISE_FACTOR * noise))


def unknown_scene(copy: NDArray[np.uint16], slopes: NDArray[np.int16]) -> StaticScene:
    """Return a scene of which nothing is known to stand still, for too few frames of a camera."""
    noise = 1.4826 * float(np.median(np.abs(slopes)))
    threshold = float(np.clip(NOISE_FACTOR * noise, FLOOR, 4 * FLOOR))
    return StaticScene(np.zeros_like(slopes), np.zeros_like(copy), threshold)


def layered_median(stack: NDArray[np.int16] | NDArray[np.uint16]) -> Floats:
    """Return the median over the first axis, a strip of rows at a time."""
    rows = stack.shape[-2]
    strips = [_strip_median(stack[..., k : k + 16, :]) for k in range(0, rows, 16)]
    return np.concatenate(strips, axis=-2)


def _strip_median(stack: NDArray[np.int16] | NDArray[np.uint16]) -> Floats:
    """Median over the first axis, layer by layer: in well under half of the time that numpy takes.

    The least and the greatest of a little over half of the layers cannot be the median, nor can
    those of what is left and one more layer, and so on.
    """
    count = len(stack)
    layers, later = list(stack[: count // 2 + 2]), list(stack[count // 2 + 2 :])
    for _ in range((count - 1) // 2):
        for k in range(len(layers) - 1):  # the greatest goes up
            low, high = layers[k], layers[k + 1]
            layers[k], layers[k + 1] = np.minimum(low, high), np.maximum(low, high)
        for k in range(len(layers) - 2, 0, -1):  # the least comes down
            low, high = layers[k - 1], layers[k]
            layers[k - 1], layers[k] = np.minimum(low, high), np.maximum(low, high)
        layers = layers[1:-1] + later[:1]
        later = later[1:]
    middle: Floats = np.mean(layers, axis=0, dtype=np.float64)
    return middle


@dataclass(frozen=True, slots=True, eq=False)
class MovingEdges:
    """Edge pixels that are not background: positions (n, 2), the gradient's unit vectors (n, 2)."""

    points_px: NDArray[np.float64]
    directions: NDArray[np.float64]

    def joined(self, other: MovingEdges) -> MovingEdges:
        """Return the edge pixels of both."""
        return MovingEdges(
            np.concatenate([self.points_px, other.points_px]),
            np.concatenate([self.directions, other.directions]),
        )


def moving_edges(slopes: NDArray[np.int16], scene: StaticScene) -> MovingEdges:
    """Return the thinned edge pixels in a gradient (2, h, w) that is not the background's."""
    points, here = _thinned(slopes, scene.threshold, 2 * scene.threshold)
    at = points[:, 1] * slopes.shape[2] + points[:, 0]
    change = here - scene.gradient.reshape(2, -1).take(at, axis=1)
    square = (here * here).sum(axis=0)
    moved = (change * change).sum(axis=0) > np.maximum(
        scene.threshold**2, MOVED_FRACTION**2 * square
    )
    return _edges(points[moved], here[:, moved])


def outline_edges(copy: NDArray[np.uint16], scene: StaticScene) -> MovingEdges:
    """Return the thinned edge pixels around all that an empty frame does not show."""
    difference = copy * np.float32(_flicker_gain(copy, scene)) - scene.grey
    change = np.abs(cv2.GaussianBlur(difference, (0, 0), 1.0))
    change = cv2.morphologyEx(change, cv2.MORPH_CLOSE, np.ones((CLOSED_PX, CLOSED_PX)))
    noise = max(UNCHANGED * float(np.median(change[::3, ::3])), 1.0)
    greatest = cv2.dilate(change, np.ones((BESIDE_PX, BESIDE_PX)))
    part = GREY_UNITS * change / np.maximum(greatest, noise)
    return _edges(*_thinned(gradient(part.astype(np.uint16)), *OUTLINE_SLOPES))


def _flicker_gain(copy: NDArray[np.uint16], scene: StaticScene) -> float:
    """Return the factor that undoes a flicker of the light: that of most pixels that are lit."""
    now, before = copy[::8, ::8], scene.grey[::8, ::8]
    lit = np.minimum(now, before) > LIT
    if lit.mean() < 0.5:
        return 1.0
    return float(np.clip(np.median(before[lit] / now[lit]), 0.8, 1.25))


def _thinned(
    slopes: NDArray[np.int16], low: float, high: float
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Return the edge pixels (n, 2) in a gradient (2, h, w), and the gradient there (2, n)."""
    thin = cv2.Canny(slopes[0], slopes[1], low, high, L2gradient=True)
    places = cv2.findNonZero(thin)  # thrice as fast as np.nonzero
    points = np.zeros((0, 2), dtype=np.int32) if places is None else places.reshape(-1, 2)
    at = points[:, 1] * slopes.shape[2] + points[:, 0]
    return points, slopes.reshape(2, -1).take(at, axis=1).astype(np.float32)


def _edges(points: NDArray[np.int32], slopes: NDArray[np.float32]) -> MovingEdges:
    directions = (slopes / np.hypot(*slopes)).T
    return MovingEdges(points.astype(np.float64), directions.astype(np.float64))
