"""What every fit of two edges gives."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.shaft.fitting.lines import Lines, moved_lines

Bools = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class FittedEdges:
    """Two fitted edges with the rows that they rest on.

    Parameters
    ----------
    start
        The edges that offsets and tilts are from, undistorted px.
    parameters, covariance
        Offset and tilt of both edges and the blur, shapes (5,) and (5, 5), px.
    contrast
        Mean grey step across each edge, without sign, shape (2,).
    noise_grey
        Standard deviation of a pixel, grey levels.
    lever, offset_px, weight, accepted, counted
        Of every row, shape (2, rows): where along the edge (−1 … 1); its own offset outward from
        the fit, raw px; that offset's inverse variance, 1/px²; whether it agrees with the model;
        whether it could have.
    saturated_part, shading
        As in `ShaftEdges`.
    response_px
        How far outward a response that is not linear seems to have moved both edges, px.
    overshoot
        Grey step across each edge over the range of grey levels seen in the same rows, shape (2,);
        0 where a model cannot extrapolate.
    shown_part
        Part of the chunks beside each edge in which what is known to stand behind the shaft shows,
        shape (2,); NaN where they do not tell.
    together
        Whether shading and both edges are one model, in which their blurs may meet.
    """

    start: Lines
    parameters: Floats
    covariance: Floats
    contrast: Floats
    noise_grey: float
    lever: Floats
    offset_px: Floats
    weight: Floats
    accepted: Bools
    counted: Bools
    saturated_part: Floats
    shading: str
    response_px: float = 0.0
    overshoot: Floats = field(default_factory=lambda: np.zeros(2))
    shown_part: Floats = field(default_factory=lambda: np.full(2, np.nan))
    together: bool = False

    @property
    def lines(self) -> Lines:
        """The fitted edges, undistorted px."""
        return moved_lines(self.start, self.parameters)

    def accepted_at(self, lever: Floats) -> Floats:
        """Return 1 for rows at places along the edges, shape (2, rows), that were accepted."""
        found = []
        for at, own, accepted, counted in zip(
            lever, self.lever, self.accepted, self.counted, strict=True
        ):
            places = own[counted]
            order = np.argsort(places)
            found.append(np.interp(at, places[order], accepted[counted][order]) >= 0.5)
        return np.stack(found).astype(np.float64)

    def sigmas(self) -> tuple[Floats, Floats]:
        """Return the sigma of each edge's offset at its smallest (px) and of its angle (rad)."""
        offset, angle = [], []
        for edge, line in enumerate(self.start):
            (pp, pq), (_, qq) = self.covariance[2 * edge : 2 * edge + 2, 2 * edge : 2 * edge + 2]
            offset.append(np.sqrt(max(pp - pq * pq / qq, 0.0)))
            angle.append(np.sqrt(qq) / np.hypot(*line.half_px))
        return np.array(offset), np.array(angle)
