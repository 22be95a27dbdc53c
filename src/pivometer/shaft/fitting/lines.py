"""The two straight edges of a shaft in undistorted pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pivometer._arrays import Floats
from pivometer.cameras.model import Camera


@dataclass(frozen=True, slots=True, eq=False)
class EdgeLine:
    """A straight edge in undistorted pixels: from one end to the other.

    Parameters
    ----------
    start_px, end_px
        The ends, shape (2,), undistorted px.
    outward
        Unit normal pointing away from the shaft, shape (2,).
    """

    start_px: Floats
    end_px: Floats
    outward: Floats

    @property
    def middle_px(self) -> Floats:
        """Middle of the edge, shape (2,), undistorted px."""
        return np.asarray((self.start_px + self.end_px) / 2)

    @property
    def half_px(self) -> Floats:
        """Vector from the middle to the end, shape (2,), undistorted px."""
        return np.asarray((self.end_px - self.start_px) / 2)

    def moved(self, offset_px: float, tilt_px: float) -> EdgeLine:
        """Return the edge moved outward by offset − tilt at its start and offset + tilt at its end.

        The points move along the old normal; the new one follows the new direction.
        """
        start = self.start_px + (offset_px - tilt_px) * self.outward
        end = self.end_px + (offset_px + tilt_px) * self.outward
        direction = end - start
        normal = np.array([-direction[1], direction[0]]) / np.hypot(*direction)
        return EdgeLine(start, end, normal if normal @ self.outward > 0 else -normal)

    def at(self, lever: Floats) -> Floats:
        """Return points at −1 (start) … +1 (end), shape (..., 2), undistorted px."""
        return np.asarray(self.middle_px + lever[..., None] * self.half_px)


Lines = tuple[EdgeLine, EdgeLine]


def edge_lines(edges_px: Floats, camera: Camera) -> Lines:
    """Return both edges as straight lines from raw end points of shape (2, 2, 2)."""
    ends = camera.undistorted_pixels(edges_px)
    middles = ends.mean(axis=1)
    lines = []
    for own, other in ((0, 1), (1, 0)):
        direction = ends[own, 1] - ends[own, 0]
        normal = np.array([-direction[1], direction[0]]) / np.hypot(*direction)
        away = middles[own] - middles[other]
        lines.append(EdgeLine(ends[own, 0], ends[own, 1], normal if normal @ away > 0 else -normal))
    return lines[0], lines[1]


def moved_lines(lines: Lines, moves_px: Floats) -> Lines:
    """Return both edges moved by an offset and a tilt each, the first four numbers, px."""
    return lines[0].moved(*moves_px[:2]), lines[1].moved(*moves_px[2:4])


def width_px(lines: Lines) -> float:
    """Return the distance between two edges half-way along, undistorted px."""
    return float(abs((lines[0].middle_px - lines[1].middle_px) @ lines[0].outward))


def is_upright(edges_px: Floats) -> bool:
    """Return whether the edges run more along image columns than along rows."""
    span = np.abs(edges_px[:, 1] - edges_px[:, 0]).sum(axis=0)
    return bool(span[1] >= span[0])


def tapers_px(lines: Lines) -> Floats:
    """Return how much half the width grows from each edge's middle to its end, (2, 1, 1, 1)."""
    tapers = []
    for own, other in ((0, 1), (1, 0)):
        ends = lines[own].at(np.array([-1.0, 1.0])) - lines[other].middle_px
        near, far = np.abs(ends @ lines[other].outward)
        tapers.append((far - near) / 4)
    return np.reshape(tapers, (2, 1, 1, 1))


def halves_px(lines: Lines, lever: Floats) -> Floats:
    """Return half the shaft's width at places along each edge, shape (2, rows, 1).

    Parameters
    ----------
    lines
        The edges, undistorted px. Their middles may stand at different places along the shaft.
    lever
        Places along each edge, −1 … 1, shape (2, rows, 1).
    """
    middles = [
        abs(float((own.middle_px - other.middle_px) @ other.outward)) / 2
        for own, other in (lines, lines[::-1])
    ]
    halves = np.reshape(middles, (2, 1, 1)) + tapers_px(lines)[..., 0] * lever
    return np.asarray(np.maximum(halves, 1.0))
