"""The raw pixels beside both edges of an upright shaft, with their distances and far sums."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.shaft.fitting.band_map import BandMap, picked
from pivometer.shaft.fitting.view import ShaftView

CHUNK_ROWS = 24
"""Rows that share grey levels."""


@dataclass(frozen=True, slots=True, eq=False)
class Strip:
    """The columns beside both edges, inside first, for rows along the shaft.

    Parameters
    ----------
    near
        Grey levels of the columns where the profile changes, shape (2, rows, k).
    x_px, lever
        Their distance from the first guess of the edge (raw px, positive outside), and their
        position along it (−1 … 1); same shape.
    scale
        Raw px per undistorted px, shape (2, rows, 1).
    counts, sums
        Number and sum of the far columns inside and outside, shape (2, rows, 2).
    trends
        Sums of the far grey levels times their column's offset from the window's middle,
        shape (2, rows, 2); those of the offsets' squares are `spread`, shape (2,).
    squares
        Sums of the squares of the far grey levels, shape (2, rows, 2).
    valid
        1 for a row that counts, shape (2, rows).
    """

    near: Floats
    x_px: Floats
    lever: Floats
    scale: Floats
    counts: Floats
    sums: Floats
    trends: Floats
    squares: Floats
    spread: Floats
    valid: Floats


def strip(
    view: ShaftView,
    *,
    near_px: tuple[float, float],
    inner_px: float = 0.0,
    outer_px: float = 0.0,
) -> Strip:
    """Gather both edges' columns.

    Parameters
    ----------
    view
        The image, and the edges that distances are from.
    near_px
        Reach of the near columns inside and outside, raw px.
    inner_px, outer_px
        Reach of the far ones, raw px; by default there are none to speak of.
    """
    near, beyond = _columns(view, near_px)
    inner = max(near + 2, int(inner_px * view.slant))
    outer = max(beyond + 2, int(outer_px * view.slant))
    begin, count = _rows(view.maps)
    j = np.arange(-inner, outer + 1)
    grey, inside = _gathered(view, j)
    x, lever = np.zeros((2, 2, count, near + beyond + 1))
    scale = np.ones((2, count, 1))
    middle = np.arange(-near, beyond + 1)
    for edge, (m, line) in enumerate(zip(view.maps, view.lines, strict=True)):
        at = slice(begin[edge], begin[edge] + len(m.rows))
        columns = m.columns(middle)
        x[edge, at] = m.coordinate(line.outward, -float(line.outward @ line.middle_px), columns)
        half = line.half_px / (line.half_px @ line.half_px)
        lever[edge, at] = m.coordinate(half, -float(half @ line.middle_px), columns)
        scale[edge, at, 0] = m.scale
    x *= scale
    place = slice(inner - near, inner + beyond + 1)
    valid = inside[..., place].all(axis=-1)
    weights = np.zeros((len(j), 4))
    weights[: inner - near, 0] = weights[inner + beyond + 1 :, 1] = 1.0
    for side, far in enumerate((slice(0, inner - near), slice(inner + beyond + 1, len(j)))):
        weights[far, 2 + side] = j[far] - j[far].mean()
    sums = grey @ weights
    if inside.all():
        counts = np.broadcast_to(weights[:, :2].sum(axis=0), sums[..., :2].shape)
    else:
        counts = inside.astype(np.float64) @ weights[:, :2]
    return Strip(
        near=grey[..., place],
        x_px=x,
        lever=lever,
        scale=scale,
        counts=counts,
        sums=sums[..., :2],
        trends=sums[..., 2:],
        squares=(grey * grey) @ weights[:, :2],
        spread=(weights[:, 2:] ** 2).sum(axis=0),
        valid=np.asarray(valid, dtype=np.float64),
    )


def mean_beside(
    view: ShaftView, between_px: tuple[float, float]
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return each row's mean grey level between two distances, and which rows lie in the image.

    Parameters
    ----------
    view
        As of a strip, whose rows these are.
    between_px
        The distances outward from both edges, to a pixel.
    """
    first, last = (round(view.slant * distance) for distance in between_px)
    grey, inside = _gathered(view, np.arange(first, last + 1))
    return np.asarray(grey.mean(axis=-1)), np.asarray(inside.all(axis=-1))


def seen_beside(
    view: ShaftView, picture: NDArray[np.generic], near_px: tuple[float, float]
) -> Floats:
    """Return what another picture shows at the near pixels of a `strip`, and how it changes there.

    Parameters
    ----------
    view, near_px
        As of the strip.
    picture
        The other picture, turned like the view's.

    Returns
    -------
    numpy.ndarray
        Grey levels, and their derivatives by column and by row, shape (3, 2, rows, k).
    """
    near, beyond = _columns(view, near_px)
    begin, count = _rows(view.maps)
    height, width = picture.shape
    planes = np.zeros((3, 2, count, near + beyond + 1))
    for edge, m in enumerate(view.maps):
        at = slice(begin[edge], begin[edge] + len(m.rows))
        columns = np.clip(m.columns(np.arange(-near - 1, beyond + 2)), 0, width - 1)
        above, here, below = (
            picked(picture, np.clip(m.rows + k, 0, height - 1), columns).astype(np.float64)
            for k in (-1, 0, 1)
        )
        planes[0, edge, at] = here[:, 1:-1]
        planes[1, edge, at] = (here[:, 2:] - here[:, :-2]) * (m.outward / 2)
        planes[2, edge, at] = (below - above)[:, 1:-1] / 2
    return planes


def _columns(view: ShaftView, near_px: tuple[float, float]) -> tuple[int, int]:
    """Return how many columns the near ones are inside and outside."""
    inside, outside = (int(np.ceil(reach * view.slant)) + 1 for reach in near_px)
    return inside, outside


def _rows(maps: tuple[BandMap, BandMap]) -> tuple[list[int], int]:
    """Return where each edge's rows begin among the rows of both, and how many these are."""
    first = min(int(m.rows[0]) for m in maps)
    every = int(np.diff(maps[0].rows[:2]).sum())
    begin = [(int(m.rows[0]) - first) // every for m in maps]
    total = max(at + len(m.rows) for at, m in zip(begin, maps, strict=True))
    return begin, -(-total // CHUNK_ROWS) * CHUNK_ROWS


def _gathered(view: ShaftView, j: NDArray[np.intp]) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the pixels of columns j outward of both edges, and which lie in the image."""
    begin, count = _rows(view.maps)
    width = view.pixels.shape[1]
    grey = np.zeros((2, count, len(j)))
    inside = np.zeros((2, count, len(j)), dtype=bool)
    for edge, m in enumerate(view.maps):
        at = slice(begin[edge], begin[edge] + len(m.rows))
        columns = m.columns(j)
        within = (columns >= 0) & (columns < width)
        if within.all():
            grey[edge, at] = picked(view.pixels, m.rows, columns)
        else:
            clipped = np.clip(columns, 0, width - 1)
            grey[edge, at] = np.where(within, picked(view.pixels, m.rows, clipped), 0)
        inside[edge, at] = within
    return grey, inside
