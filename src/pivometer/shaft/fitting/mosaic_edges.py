"""A shaft before a raw mosaic of colour filters (`cameras.mosaic`): what its edges need of that."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.cameras.mosaic import Grey, evened
from pivometer.shaft.fitting.evidence import saturated_part

MARGIN_PX = 128
"""A picture is evened so far beside the shaft: twice what the fits look at where it is blurred."""

NEAR_PX = 3
"""Saturated pixels count so near an edge, as in sharp images."""

WARNING = (
    "a mosaic of colour filters: the pictures are raw from a colour camera; beside the shaft the "
    "filters were brought to one scale, which holds where two colours meet, not more"
)
ADVICE = "use a monochrome camera, or a background and light of one colour"


def evened_beside(image: NDArray[np.generic], edges_px: Floats) -> Grey:
    """Return a mosaic that is evened about a shaft's edges, of shape (2, 2, 2), raw px."""
    found = np.asarray(image, dtype=np.float32)
    low = np.maximum(edges_px.min(axis=(0, 1)) - MARGIN_PX, 0).astype(np.intp)
    high = np.maximum(edges_px.max(axis=(0, 1)) + MARGIN_PX, 0).astype(np.intp)
    part = slice(low[1], high[1] + 1), slice(low[0], high[0] + 1)
    found[part] = evened(found[part])
    return found


def clipped_part(image: NDArray[np.generic], points_px: Floats) -> Floats:
    """Return the part of the raw pixels beside each edge at the sensor's limit, shape (2,).

    Parameters
    ----------
    image
        Raw grey levels, shape (height, width).
    points_px
        Points along both edges, shape (2, m, 2), raw px.
    """
    ahead = points_px[:, -1] - points_px[:, 0]
    across = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1) / np.hypot(*ahead.T)[:, None]
    steps = np.arange(-NEAR_PX, NEAR_PX + 1)[:, None]
    places = np.rint(points_px[:, :, None] + steps * across[:, None, None]).astype(np.intp)
    columns, rows = np.moveaxis(np.clip(places, 0, np.array(image.shape)[::-1] - 1), -1, 0)
    grey = image[rows, columns]
    return saturated_part(grey, np.ones(grey.shape[:2], dtype=bool), image.dtype)
