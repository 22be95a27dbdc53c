"""Small JPEG pictures of the images, so that a report of 70 poses stays a file one can mail."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pivometer.errors import ShapeError

Image = NDArray[np.uint8] | NDArray[np.uint16]
"""A grey image of any bit depth, indexed [row, column]."""

_WIDTH_PX = 480
"""Width of a thumbnail: two stand side by side on a page of A4 at 150 dots per inch."""

_BUDGET_BYTES = 18_000
"""Bytes per thumbnail. 140 of them in base64 (4/3) are 3.4 MB; the page itself, with 70 poses and
their plots, measures under 1.5 MB (tests/report/test_html.py), and what it carries to be verified
0.7 MB: a report stays below 6 MB."""

_STEPS = ((75, 1.0), (60, 1.0), (45, 1.0), (60, 0.7), (45, 0.7), (30, 0.7), (30, 0.5))
"""JPEG quality and scale, tried in turn. Only images full of texture or noise need the second."""


@dataclass(frozen=True, slots=True, eq=False)
class Thumbnail:
    """A small picture of an image.

    Parameters
    ----------
    jpeg
        The encoded picture.
    width, height
        Its size, px.
    scale
        Thumbnail pixels per image pixel.
    """

    jpeg: bytes
    width: int
    height: int
    scale: float


def make_thumbnail(image: Image) -> Thumbnail:
    """Shrink an image to at most 480 px across, stretch its contrast and encode it.

    Parameters
    ----------
    image
        Grey image, shape (height, width), any bit depth.

    Returns
    -------
    Thumbnail
        At most 18 kB: noise and texture lower the JPEG quality from 75, then the size.

    Raises
    ------
    ShapeError
        If `image` is not two-dimensional or is empty.

    Examples
    --------
    >>> ramp = np.tile(np.arange(960, dtype=np.uint16), (540, 1))
    >>> thumbnail = make_thumbnail(ramp)
    >>> thumbnail.width, thumbnail.height, thumbnail.scale
    (480, 270, 0.5)
    """
    if image.ndim != 2 or image.size == 0:
        raise ShapeError(
            f"an image of shape {image.shape}", next_step="pass a grey image (height, width)"
        )
    thumbnail = _encoded(image, *_STEPS[0])
    for quality, shrink in _STEPS[1:]:
        if len(thumbnail.jpeg) <= _BUDGET_BYTES:
            break
        thumbnail = _encoded(image, quality, shrink)
    return thumbnail


def _stretched(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Map the darkest to the brightest 0.2 % of the pixels to 0…255."""
    low, high = np.percentile(image, [0.2, 99.8])
    grey = (image.astype(np.float64) - low) * (255 / max(high - low, 1.0))
    stretched: NDArray[np.uint8] = np.clip(grey, 0, 255).astype(np.uint8)
    return stretched


def _encoded(image: Image, quality: int, shrink: float) -> Thumbnail:
    import cv2

    rows, columns = image.shape
    width = max(1, round(min(_WIDTH_PX, columns) * shrink))
    height = max(1, round(rows * width / columns))
    small = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    _, jpeg = cv2.imencode(".jpg", _stretched(small), [cv2.IMWRITE_JPEG_QUALITY, quality])
    return Thumbnail(jpeg.tobytes(), width, height, width / columns)
