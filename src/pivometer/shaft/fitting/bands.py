"""The raw pixels beside a shaft's two edges, with their distances in undistorted coordinates.

The image is never resampled. Rows run along the shaft (image rows for an upright shaft, image
columns for a lying one), columns across it; every pixel keeps its grey level and learns how far
it is from the first guess of its edge in the plane where the edge is straight.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.cameras.model import Camera
from pivometer.shaft.fitting.lines import EdgeLine, Lines, is_upright, tapers_px
from pivometer.shaft.fitting.profile import Bands

SAMPLES = 33
"""Points along an edge where the distortion is evaluated; between them it is interpolated."""


def gather(
    image: NDArray[np.generic],
    camera: Camera,
    lines: Lines,
    *,
    inner_px: float,
    outer_px: float,
    half_width_px: float,
    chunk_rows: int,
) -> Bands:
    """Return the pixels within `inner_px` and `outer_px` of both edges, in chunks of rows.

    Parameters
    ----------
    image
        The raw image, shape (height, width), any type.
    camera
        Its camera.
    lines
        The edges as first guessed, undistorted px.
    inner_px, outer_px
        Reach of the band towards and away from the axis, raw px across the edge.
    half_width_px
        Half the shaft's width, raw px.
    chunk_rows
        Rows in a chunk.
    """
    upright = is_upright(np.stack([[line.start_px, line.end_px] for line in lines]))
    turned = image if upright else image.T
    parts = [_band(turned, camera, line, upright, inner_px, outer_px) for line in lines]
    first = min(int(part[0][0]) for part in parts)
    last = max(int(part[0][-1]) for part in parts)
    chunks = -(-(last + 1 - first) // chunk_rows)
    columns = max(part[1].shape[1] for part in parts)
    stacked = []
    for field, fill in ((1, 0.0), (2, outer_px), (3, 0.0), (4, 1.0), (5, 0.0)):
        whole = np.full((2, chunks * chunk_rows, columns), fill)
        for edge, part in enumerate(parts):
            rows = part[0] - first
            whole[edge, rows[0] : rows[-1] + 1, : part[field].shape[1]] = part[field]
        stacked.append(whole.reshape(2, chunks, chunk_rows, columns))
    grey, distance, lever, scale, valid = stacked
    halves = half_width_px + tapers_px(lines) * lever[..., lever.shape[-1] // 2, None]
    return Bands(grey, distance, lever, scale[..., :1], valid, np.maximum(halves, 1.0))


def _band(
    turned: NDArray[np.generic],
    camera: Camera,
    line: EdgeLine,
    upright: bool,
    inner_px: float,
    outer_px: float,
) -> tuple[Floats, Floats, Floats, Floats, Floats, Floats]:
    """Return rows, grey, distance, lever, scale and validity of one edge's pixels."""
    lever = np.linspace(-1, 1, SAMPLES)
    normalized = (line.at(lever) - camera.principal_point_px) / camera.focal_px
    raw = camera.pixels_from_normalized(normalized)
    across, along = (raw[:, 0], raw[:, 1]) if upright else (raw[:, 1], raw[:, 0])
    covector = np.linalg.solve(
        np.swapaxes(camera.pixels_jacobian(normalized) / camera.focal_px, -1, -2),
        np.broadcast_to(line.outward[:, None], (SAMPLES, 2, 1)),
    )[..., 0]
    order = np.argsort(along)
    height, width = turned.shape
    low = max(0, int(np.ceil(along.min())))
    high = min(height - 1, int(np.floor(along.max())))
    rows = np.arange(low, max(high, low) + 1)
    centre = np.interp(rows, along[order], across[order])
    slant = np.hypot(*covector.T) / np.abs(covector[:, 0 if upright else 1])
    reach = int(np.ceil(max(inner_px, outer_px) * float(slant.max())))
    base = np.rint(centre).astype(np.intp)
    offsets = np.arange(-reach, reach + 1)
    columns = base[:, None] + offsets
    nodes = _nodes(camera, line, rows, base, reach, upright)
    u = offsets / reach
    distance, position = (
        node[:, 1:2]
        + u * (node[:, 2:] - node[:, :1]) / 2
        + u**2 * (node[:, 2:] + node[:, :1] - 2 * node[:, 1:2]) / 2
        for node in nodes
    )
    scale = np.interp(rows, along[order], (1 / np.hypot(*covector.T))[order])[:, None]
    distance = distance * scale
    inside = (columns >= 0) & (columns < width)
    near = (distance >= -inner_px) & (distance <= outer_px)
    grey = turned[rows[:, None], np.clip(columns, 0, width - 1)]
    return rows, grey, distance, position, scale, (inside & near).astype(np.float64)


def _nodes(
    camera: Camera, line: EdgeLine, rows: Floats, base: Floats, reach: int, upright: bool
) -> tuple[Floats, Floats]:
    """Return distance and lever, shape (rows, 3), at the band's left, middle and right pixels.

    A parabola through the three is exact to 1e-5 px over ±10 px at β₁ = −0.28 and f = 1000 px.
    """
    columns = base[:, None] + np.array([-reach, 0, reach])
    row = np.broadcast_to(rows[:, None], columns.shape)
    pixels = np.stack([columns, row] if upright else [row, columns], axis=-1)
    away = camera.undistorted_pixels(pixels) - line.middle_px
    half = line.half_px
    return away @ line.outward, away @ half / (half @ half)
