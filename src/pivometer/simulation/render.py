"""The renderer: paints shapes back to front with exact area coverage, then exposes the sensor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.cameras import Camera
from pivometer.simulation.optics import (
    CELLS,
    MARGIN_PX,
    Rays,
    Sensor,
    blurred,
    camera_rays,
)

TILE = 8
"""Side of the tiles, px, that are tried first, to leave out those a shape does not touch."""


class Shape(Protocol):
    """Something to paint, in the camera's frame."""

    def outline_mm(self) -> Floats:
        """Return points (n, 3), mm, in front of the camera, whose hull holds the shape."""
        ...

    def paint(self, rays: Rays, cell: float) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Return coverage (0 to 1), radiance, and whether more than one value meets in the cell.

        `rays` go through the centres of square cells of side `cell`, px; all shape (n,).
        """
        ...


class Renderer:
    """Images shapes in front of a standing background with one camera.

    Pixels that hold no edge take one ray; those that do are divided into 4 × 4 cells, each with
    its exact area coverage. The cells are blurred and integrated over the pixel (`optics`).

    Parameters
    ----------
    camera
        The camera; its rays are undistorted once, here.
    sensor
        Point spread, noise and quantisation.
    background
        Standing shapes in the camera's frame, back to front; painted once.
    dark
        Radiance where there is nothing.
    """

    def __init__(
        self, camera: Camera, sensor: Sensor, background: Sequence[Shape] = (), dark: float = 0.01
    ) -> None:
        self.camera = camera
        self.sensor = sensor
        self._rays = camera_rays(camera)
        shape = (*self._rays.x.shape, CELLS, CELLS)
        self._cells = np.full(shape, dark, dtype=np.float32)
        for item in background:
            self._paint(self._cells, item)
        self._blurred = blurred(_as_grid(self._cells), sensor.psf_sigma_px)

    def radiance(self, shapes: Sequence[Shape]) -> NDArray[np.float32]:
        """Return the blurred radiance, shape (height, width), of shapes painted back to front."""
        boxes = [box for box in map(self._box, shapes) if box is not None]
        image = self._blurred.copy()
        if not boxes:
            return image
        corners = np.array(boxes)
        top, left = corners[:, :2].min(axis=0) - MARGIN_PX
        bottom, right = corners[:, 2:].max(axis=0) + MARGIN_PX
        height, width = image.shape
        top, left = max(top, MARGIN_PX), max(left, MARGIN_PX)
        bottom, right = min(bottom, height + MARGIN_PX), min(right, width + MARGIN_PX)
        if top >= bottom or left >= right:
            return image
        m = MARGIN_PX
        cells = self._cells[top - m : bottom + m, left - m : right + m].copy()
        for item in shapes:
            self._paint(cells, item, top - m, left - m)
        image[top - m : bottom - m, left - m : right - m] = blurred(
            _as_grid(cells), self.sensor.psf_sigma_px
        )
        return image

    def image(self, shapes: Sequence[Shape], rng: np.random.Generator) -> NDArray[Any]:
        """Return the image, uint8 or uint16, shape (height, width), of shapes back to front."""
        return self.sensor.expose(self.radiance(shapes), rng)

    def _box(self, shape: Shape) -> tuple[int, int, int, int] | None:
        """Return rows and columns (top, left, bottom, right) of the margined grid to paint."""
        points = shape.outline_mm()
        pixels = self.camera.pixels_from_normalized(points[:, :2] / points[:, 2:])
        rows, columns = self._rays.x.shape
        # A straight edge across the image bows by up to 4.2 px at the presets' distortion.
        low = np.floor(pixels.min(axis=0)) + MARGIN_PX - 6
        high = np.ceil(pixels.max(axis=0)) + MARGIN_PX + 7
        left, top = low.clip(0, (columns, rows)).astype(int)
        right, bottom = high.clip(0, (columns, rows)).astype(int)
        return None if left >= right or top >= bottom else (top, left, bottom, right)

    def _paint(self, cells: NDArray[np.float32], shape: Shape, top: int = 0, left: int = 0) -> None:
        """Paint over `cells`, a part of the grid that starts at row `top` and column `left`."""
        box = self._box(shape)
        if box is None:
            return
        row, column = self._touched(shape, box)
        rays = self._rays.select((row, column))
        share, value, edge = shape.paint(rays, 1.0)
        row, column = row - top, column - left
        full = ~edge & (share > 0)
        cells[row[full], column[full]] = value[full, None, None]
        share, value, _ = shape.paint(rays.select(edge).divided(), 1.0 / CELLS)
        share, value = share.reshape(-1, CELLS, CELLS), value.reshape(-1, CELLS, CELLS)
        at = (row[edge], column[edge])
        cells[at] = cells[at] * (1 - share) + value * share

    def _touched(
        self, shape: Shape, box: tuple[int, int, int, int]
    ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return rows and columns of the pixels in tiles that the shape may touch."""
        top, left, bottom, right = box
        rows, columns = np.arange(top, bottom, TILE), np.arange(left, right, TILE)
        last = (self._rays.x.shape[0] - 1, self._rays.x.shape[1] - 1)
        middle = np.ix_(
            np.minimum(rows + TILE // 2, last[0]), np.minimum(columns + TILE // 2, last[1])
        )
        # Twice the tile's side: the outline is straight to a fraction of that.
        share, _, edge = shape.paint(self._rays.select(middle), 2.0 * TILE)
        kept = ((share > 0) | edge).reshape(len(rows), len(columns))
        inside = kept.repeat(TILE, axis=0)[: bottom - top].repeat(TILE, axis=1)[:, : right - left]
        row, column = np.nonzero(inside)
        return row + top, column + left


def _as_grid(cells: NDArray[np.float32]) -> NDArray[np.float32]:
    """Arrange cells (rows, columns, CELLS, CELLS) as one fine image."""
    rows, columns = cells.shape[:2]
    return cells.transpose(0, 2, 1, 3).reshape(rows * CELLS, columns * CELLS)
