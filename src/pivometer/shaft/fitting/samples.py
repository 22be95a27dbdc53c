"""The grey levels beside both edges of a shaft, in chunks of rows: as pixels, or averaged in bins.

Across a straight edge only the distance from it counts, so a chunk's pixels of nearly the same
distance can be averaged: a third of the numbers tells the same. Averaging over 0.125 px blurs by
0.036 px, which the free blur takes up (by 0.001 px), and what is measured at a bin's own mean
distance is true to first order.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.shaft.fitting.strip import CHUNK_ROWS, Strip

Indices = NDArray[np.intp]

BIN_PX = 0.125
"""Bins of 0.25 px took a tenth less time, and their curvature looked like a misfit of windows: the
centre's intervals held the truth in 83 instead of 95 of 100 striped shafts."""


@dataclass(frozen=True, slots=True, eq=False)
class Behind:
    """What an empty frame shows at the pixels of a `Strip`, or in bins of them; any shape.

    Parameters
    ----------
    grey
        Its grey levels.
    slope
        Their derivative outward, grey levels per px.
    """

    grey: Floats
    slope: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Grey levels beside both edges: chunks of p pixels or bins, those of the first edge first.

    Parameters
    ----------
    grey, x_px, lever
        Mean grey level, distance from the first guess of the edge (raw px, positive outside) and
        position along it (−1 … 1), shape (chunks, p).
    count
        Number of pixels in each, shape (chunks, p).
    scale, half_px
        Raw px per undistorted px, and half the shaft's width (raw px), shape (chunks, 1).
    edge
        0 or 1, shape (chunks,).
    behind
        What an empty frame shows there.
    sorted
        Whether samples come in the order of their distances, as bins do.
    """

    grey: Floats
    x_px: Floats
    lever: Floats
    count: Floats
    scale: Floats
    half_px: Floats
    edge: Indices
    behind: Behind | None = None
    sorted: bool = False

    def of_edge(self, edge: int) -> Samples:
        """Return the chunks of one edge."""
        n = len(self.grey) // 2
        at = slice(edge * n, (edge + 1) * n)
        behind = self.behind and Behind(self.behind.grey[at], self.behind.slope[at])
        return replace(
            self,
            grey=self.grey[at],
            x_px=self.x_px[at],
            lever=self.lever[at],
            count=self.count[at],
            scale=self.scale[at],
            half_px=self.half_px[at],
            edge=self.edge[at],
            behind=behind,
        )

    def moved(self, parameters: Floats) -> Floats:
        """Return the distances from edges moved by offset and tilt each, raw px."""
        offset, tilt = (parameters[k:4:2][self.edge][:, None] for k in (0, 1))
        distances: Floats = self.x_px - self.scale * (offset + tilt * self.lever)
        return distances


def pixels(
    bands: Strip,
    half_px: Floats,
    rows: Floats,
    behind: Behind | None,
    columns: slice,
) -> Samples:
    """Return the single pixels of some columns.

    Parameters
    ----------
    bands
        The pixels of both edges.
    half_px
        Half the shaft's width in every row, raw px, shape (2, rows, 1).
    rows
        Which rows count, 0 or 1, shape (2, rows).
    behind
        What an empty frame shows at these pixels.
    columns
        Which columns of `bands`.
    """
    chunks = 2 * bands.near.shape[1] // CHUNK_ROWS
    shape = (chunks, -1)
    used = rows.reshape(shape)
    share = np.where(used.any(axis=1, keepdims=True), used, 1.0)
    share = share / share.sum(axis=1, keepdims=True)

    def mean(values: Floats) -> Floats:
        return np.asarray((values.reshape(shape) * share).sum(axis=1, keepdims=True))

    def flat(values: Floats) -> Floats:
        return values[..., columns].reshape(shape)

    grey = flat(bands.near)
    return Samples(
        grey=grey,
        x_px=flat(bands.x_px),
        lever=flat(bands.lever),
        count=flat(np.broadcast_to(rows[..., None], bands.near.shape)),
        scale=mean(bands.scale),
        half_px=mean(half_px),
        edge=np.repeat([0, 1], chunks // 2),
        behind=behind and Behind(flat(behind.grey), flat(behind.slope)),
    )


def binned(samples: Samples, parameters: Floats, reach_px: tuple[float, float]) -> Samples:
    """Return the means of pixels over bins of their distance from edges at `parameters`.

    Parameters
    ----------
    samples
        The pixels.
    parameters
        Offset and tilt of both edges, undistorted px, to a few tenths of a pixel.
    reach_px
        The least and the largest distance of bins, raw px.
    """
    chunks = len(samples.grey)
    bins = int(np.ceil((reach_px[1] - reach_px[0]) / BIN_PX))
    place = np.floor((samples.moved(parameters) - reach_px[0]) / BIN_PX).astype(np.intp)
    used = (samples.count > 0) & (place >= 0) & (place < bins)
    index = (place + bins * np.arange(chunks)[:, None])[used]
    count = np.bincount(index, minlength=chunks * bins).astype(np.float64)
    share = 1 / np.maximum(count, 1)

    def mean(values: Floats) -> Floats:
        sums = np.bincount(index, values[used], chunks * bins)
        return np.asarray(sums * share).reshape(chunks, bins)

    seen = samples.behind
    return Samples(
        grey=mean(samples.grey),
        x_px=mean(samples.x_px),
        lever=mean(samples.lever),
        count=count.reshape(chunks, bins),
        scale=samples.scale,
        half_px=samples.half_px,
        edge=samples.edge,
        behind=seen and Behind(mean(seen.grey), mean(seen.slope)),
        sorted=True,
    )
