"""Both edges of a shaft as one raw image shows them: what every fit starts from."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.cameras.model import Camera
from pivometer.shaft.fitting.band_map import BandMap, band_map
from pivometer.shaft.fitting.lines import Lines, is_upright, moved_lines

REACH_PX = 22.0
"""Where undistorted coordinates are known: 4 blurs of 4 px, and the search's 4 px."""


@dataclass(frozen=True, slots=True, eq=False)
class ShaftView:
    """A raw image, turned so that the shaft is upright in it, and where the shaft's edges are.

    Parameters
    ----------
    pixels
        The turned image, any type.
    lines
        The edges as they are known so far, undistorted px.
    maps
        The rows and columns beside each of them, and where these pixels really are.
    upright
        Whether the image is as the camera took it, not transposed.
    """

    pixels: NDArray[np.generic]
    lines: Lines
    maps: tuple[BandMap, BandMap]
    upright: bool

    @classmethod
    def of(cls, image: NDArray[np.generic], camera: Camera, lines: Lines) -> ShaftView:
        """Return the view of an image as the camera took it."""
        upright = is_upright(np.stack([[line.start_px, line.end_px] for line in lines]))
        pixels = image if upright else image.T
        one, other = (
            band_map(camera, line, pixels.shape, upright=upright, reach_px=REACH_PX)
            for line in lines
        )
        return cls(pixels, lines, (one, other), upright)

    @property
    def slant(self) -> float:
        """Columns per raw px across the edges, the largest along them."""
        return max(m.slant for m in self.maps)

    @property
    def depth(self) -> np.dtype[np.generic]:
        """Type of the grey levels."""
        return self.pixels.dtype

    def about(self, lines: Lines) -> ShaftView:
        """Return the view of the same image with the edges at other lines near by."""
        one, other = (m.towards(line) for m, line in zip(self.maps, lines, strict=True))
        return replace(self, lines=lines, maps=(one, other))

    def moved(self, moves_px: Floats) -> ShaftView:
        """Return the view with each edge moved by an offset and a tilt, the first four numbers."""
        return self.about(moved_lines(self.lines, moves_px))

    def every(self, step: int) -> ShaftView:
        """Return the view of every `step`-th row."""
        one, other = (m.every(step) for m in self.maps)
        return replace(self, maps=(one, other))

    def turned(self, picture: Floats) -> Floats:
        """Return another picture that the camera took, turned like this one."""
        return picture if self.upright else picture.T
