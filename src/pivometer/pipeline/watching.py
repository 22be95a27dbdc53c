"""What live pictures tell before anything is measured: stillness, focus, light, time."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.errors import PivometerError
from pivometer.io.images import Image
from pivometer.io.sources import open_source
from pivometer.report.thumbnails import make_thumbnail

Small = NDArray[np.float32]

BLOCK_PX = 8
"""Pixels that are averaged before pictures are compared: an eighth of a pixel's noise is left, and
an edge of 100 grey levels that moves by a quarter of a pixel changes its block by 3."""
CHANGED = 3.0
"""Grey levels of 255 by which a block has changed."""
CHANGED_PART = 0.002
"""Part of the blocks that must: single ones are dust, hot pixels and reflections."""


def reduced(image: Image) -> Small:
    """Return a picture's block means in levels of 255, its common brightness taken off."""
    height, width = image.shape
    size = max(1, width // BLOCK_PX), max(1, height // BLOCK_PX)
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    levels: Small = small * np.float32(1 / 257 if image.dtype == np.uint16 else 1)
    return levels


def differ(a: Small, b: Small) -> bool:
    """Tell whether something moved between two reduced pictures, not counting their brightness.

    Examples
    --------
    >>> still = np.full((60, 80), 100, dtype=np.float32)
    >>> moved = still.copy()
    >>> moved[20:24, 30:35] += 30
    >>> differ(still, still + 8), differ(still, moved)
    (False, True)
    """
    if a.shape != b.shape:
        return True
    change = a - b
    change -= np.median(change)
    return bool(np.mean(np.abs(change) > CHANGED) > CHANGED_PART)


class Stillness:
    """For how long a camera has seen nothing move."""

    def __init__(self) -> None:
        self._since: tuple[Small, float] | None = None

    def update(self, small: Small, time_s: float) -> float:
        """Take the next reduced picture and return for how long it has looked the same, s."""
        if self._since is None or differ(self._since[0], small):
            self._since = small, time_s
        return time_s - self._since[1]


@dataclass(frozen=True, slots=True)
class CameraCheck:
    """What is good or bad about a camera's pictures, before anything starts.

    Parameters
    ----------
    name
        The camera.
    size
        Width and height, px.
    rate_hz
        Frames per second.
    blur_px
        Standard deviation of the blur of its sharpest edges, px; `None` without any edge.
    saturated, black
        Part of its pixels at the largest value, and at 0.
    faults
        What to mend, in plain words; empty where all is well.
    """

    name: str
    size: tuple[int, int]
    rate_hz: float
    blur_px: float | None
    saturated: float
    black: float
    faults: tuple[str, ...]


MOST_BLUR_PX = 2.5
"""Edges and corners are fitted at usual accuracy up to this blur (`benchmarks/edges.py`)."""
MOST_SATURATED = 0.02
LEAST_RATE_HZ = 5.0
"""Below this a live view no longer tells what the hand does."""


def check_camera(name: str, image: Image, rate_hz: float) -> CameraCheck:
    """Check one picture of a camera.

    Parameters
    ----------
    name
        The camera.
    image
        A picture.
    rate_hz
        Frames per second.
    """
    height, width = image.shape
    full = float(np.mean(image == np.iinfo(image.dtype).max))
    black = float(np.mean(image == 0))
    blur = blur_px(image)
    faults = []
    if blur is None:
        faults.append("shows no edge at all: is the lens cap on, is there light?")
    elif blur > MOST_BLUR_PX:
        faults.append(f"is out of focus: its sharpest edges are blurred by {blur:.1f} px; focus it")
    if full > MOST_SATURATED:
        faults.append(
            f"is overexposed: {100 * full:.0f} % of its pixels are white; shorten the exposure"
        )
    if black > 0.5:
        faults.append(f"is dark: {100 * black:.0f} % of its pixels are black; add light")
    if rate_hz < LEAST_RATE_HZ:
        faults.append(f"gives only {rate_hz:.1f} pictures a second; choose a smaller format")
    return CameraCheck(name, (width, height), rate_hz, blur, full, black, tuple(faults))


_AGAIN_PX = 1.5


def blur_px(image: Image) -> float | None:
    """Estimate how much a picture's sharpest edges are blurred, as a Gaussian's σ, px.

    The picture is blurred once more by a known σ₀: at an edge of blur σ the gradient falls by
    √(σ² + σ₀²)/σ.

    References
    ----------
    Zhuo and Sim, doi:10.1016/j.patcog.2011.03.009, eqs. (3)–(5).

    Examples
    --------
    >>> step = np.repeat([[50, 200]], 120, axis=0).repeat(80, axis=1).astype(np.uint8)
    >>> 2.8 < blur_px(cv2.GaussianBlur(step, None, 3.0)) < 3.2
    True
    >>> blur_px(np.zeros((100, 100), dtype=np.uint8)) is None
    True
    """
    grey = image.astype(np.float32)
    first = _gradient(grey)
    strongest = np.quantile(first, 0.995)
    if strongest < 0.01 * np.iinfo(image.dtype).max:
        return None
    edges = first >= strongest
    again = _gradient(np.asarray(cv2.GaussianBlur(grey, (0, 0), _AGAIN_PX), dtype=np.float32))
    ratio = float(np.median(first[edges] / np.maximum(again[edges], 1e-6)))
    return float(_AGAIN_PX / np.sqrt(max(ratio**2 - 1, 1e-6)))


def _gradient(grey: NDArray[np.float32]) -> Floats:
    """Return the gradient's length by central differences."""
    along = np.gradient(grey)
    size: Floats = np.hypot(along[0], along[1]).astype(np.float64)
    return size


def motion(small: Small, before: Small) -> float:
    """Return how much moved between two reduced pictures, mean grey levels."""
    change = small - before
    return float(np.mean(np.abs(change - np.median(change))))


LEAST_CORRELATION = 0.6
"""Two cameras that see one hand wave correlate by 0.8 and more."""


RIVAL, WIDEST_S = 0.9, 0.3
"""Lags that match nine tenths as well must lie within 0.3 s: a regular swing fits many lags."""


def offset_s(
    first: Sequence[tuple[float, float]], second: Sequence[tuple[float, float]]
) -> float | None:
    """Estimate by how much a second camera's clock is late, from what both saw move, s.

    Parameters
    ----------
    first, second
        For each camera (time in s, what moved), in order.

    Returns
    -------
    float or None
        The lag at the largest correlation of both, at most 1 s; `None` where too little moved to
        tell: wave the board.

    Examples
    --------
    >>> t = np.arange(0, 6, 0.04)
    >>> waving = lambda at: np.maximum(0, np.sin(3 * at) + np.sin(7.3 * at))
    >>> late = offset_s(list(zip(t, waving(t))), list(zip(t, waving(t - 0.2))))
    >>> round(late, 2)
    0.2
    >>> beat = np.maximum(0, np.sin(2 * np.pi * t) - 0.8)  # each second: which one is which?
    >>> offset_s(list(zip(t, beat)), list(zip(t, beat))) is None
    True
    """
    if min(len(first), len(second)) < 20:
        return None
    a, b = np.array(first), np.array(second)
    start, end = max(a[0, 0], b[0, 0]), min(a[-1, 0], b[-1, 0])
    if end - start < 3.0:
        return None
    step = 0.01
    times = np.arange(start + 1.0, end - 1.0, step)
    if len(times) < 100:
        return None
    base = _normalised(np.interp(times, a[:, 0], a[:, 1]))
    lags = np.arange(-1.0, 1.0 + step / 2, step)
    matches = [base @ _normalised(np.interp(times + lag, b[:, 0], b[:, 1])) for lag in lags]
    best = int(np.argmax(matches))
    rivals = lags[np.array(matches) >= RIVAL * matches[best]]
    told = matches[best] >= LEAST_CORRELATION and np.ptp(rivals) <= WIDEST_S
    return float(lags[best]) if told else None


def _normalised(values: Floats) -> Floats:
    centred: Floats = values - values.mean()
    length = float(np.linalg.norm(centred))
    return centred / length if length > 0 else centred


def device_thumbnails(devices: Sequence[str]) -> dict[str, str]:
    """Return one small picture of every capture device that gives one, as a data URI."""
    pictures = {}
    for device in devices:
        try:
            source = open_source(device)
        except PivometerError:
            continue
        try:
            jpeg = make_thumbnail(source.read().image).jpeg
            pictures[device] = f"data:image/jpeg;base64,{base64.b64encode(jpeg).decode('ascii')}"
        except PivometerError:
            continue
        finally:
            source.close()
    return pictures
