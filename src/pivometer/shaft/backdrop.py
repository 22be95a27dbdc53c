"""What stands behind the shaft, as the session's own frames tell.

The cameras stand still, so every pixel that the shaft hides in one frame shows the background in
others. Before clutter an edge is where the picture turns from that background to something else,
whatever the shading of the shaft: so no lane of brushed metal passes for its edge.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.shaft.finding.background import Image, layered_median

BESIDE_PX = 4.0
"""The shaft may reach so far beyond its seed, which is good to 2 px, and blur."""

LEAST_SHOWN = 3
"""Frames of each half that must show a pixel: the median of three bears one that is wrong."""

LEAST_FRAMES = 2 * (LEAST_SHOWN + 1)
"""The shaft hides every pixel beside it in one frame at least: the one that is fitted."""

AGREEING_TIMES = 8.0
LEAST_APART_GREY = 1.0
"""The halves agree where they differ by less than eight times what half of the pixels do, for the
noise's five standard deviations are 7.4 times that, or by no more than quantization."""


def backdrop_of(frames: Sequence[Image], shafts_px: Sequence[Floats]) -> Floats | None:
    """Return the median of what frames show where the shaft is not, NaN where that is unknown.

    The first half of the frames and the second give a median each, and the mean of both counts
    where they agree: something else that stood there in half of the session is not background.

    Parameters
    ----------
    frames
        Frames of one camera that stands still, 2-D, of one shape and depth.
    shafts_px
        The shaft's two edges in each, as `ShaftSeed.edges_px`, shape (2, 2, 2), raw px.

    Returns
    -------
    numpy.ndarray or None
        Grey levels, the frames' shape; None from under `LEAST_FRAMES` frames.

    Examples
    --------
    >>> frames = [np.full((60, 80), 50, dtype=np.uint8) for _ in range(8)]
    >>> for x, frame in enumerate(frames):
    ...     frame[:, 8 * x : 8 * x + 6] = 200
    >>> edges = [
    ...     np.array([[[x, 0], [x, 59]], [[x + 6, 0], [x + 6, 59]]]) for x in range(0, 64, 8)
    ... ]
    >>> float(np.nanmax(backdrop_of(frames, edges)))
    50.0
    """
    if len(frames) < LEAST_FRAMES:
        return None
    middle = len(frames) // 2
    one, other = (
        _shown(frames[half], shafts_px[half]) for half in (slice(middle), slice(middle, None))
    )
    told = (one + other) / 2
    # Shot noise grows as the root of the grey level.
    apart = np.abs(one - other) / np.sqrt(np.maximum(told, 1.0))
    usual = float(np.nanmedian(apart)) if np.isfinite(apart).any() else 0.0
    allowed = np.maximum(LEAST_APART_GREY, AGREEING_TIMES * usual * np.sqrt(np.maximum(told, 1.0)))
    return np.where(np.abs(one - other) <= allowed, told, np.nan)


def filled(told: Floats | None, empty: NDArray[np.generic]) -> Floats:
    """Return what frames tell, and where they do not, what an empty frame shows."""
    shown = np.asarray(empty, dtype=np.float64)
    return shown if told is None else np.where(np.isfinite(told), told, shown)


def _shown(frames: Sequence[Image], shafts_px: Sequence[Floats]) -> Floats:
    """Return the median of what frames show beside the shaft, NaN where too few do.

    Hidden pixels become the least and the greatest level in turns, which leaves the median.
    """
    ends = np.iinfo(frames[0].dtype)
    hidden = np.zeros(frames[0].shape, dtype=np.uint8)
    layers: NDArray[Any] = np.array(frames)
    for layer, edges in zip(layers, shafts_px, strict=True):
        shaft = _covered(edges, layer.shape)
        layer[shaft] = np.where(hidden[shaft] % 2 == 0, ends.min, ends.max)
        hidden += shaft
    told = layered_median(layers)
    return np.where(len(frames) - hidden.astype(int) >= LEAST_SHOWN, told, np.nan)


def _covered(edges_px: Floats, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return where the shaft is, seen on to the borders of the image."""
    rows, columns = np.ogrid[: shape[0], : shape[1]]
    middle = edges_px.mean(axis=(0, 1))
    covered = np.ones(shape, dtype=bool)
    for start, end in edges_px:
        along = (end - start) / np.hypot(*(end - start))
        across = np.array([-along[1], along[0]])
        across = across * np.sign(across @ (middle - start))
        covered &= across[0] * columns > across @ start - BESIDE_PX - across[1] * rows
    return covered
