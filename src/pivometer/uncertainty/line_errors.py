"""Everything of the instrument that moves a measured centerline, near the RCM."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pivometer._arrays import Floats, checked, read_only
from pivometer.geometry.line import projectors


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """Errors of lines: some of each line's own, some that all lines share.

    Parameters
    ----------
    alone_mm2
        Covariance of each line's position, independent of the others', shape (n, 3, 3), mm².
    common_mm
        Displacements of each line by one standard uncertainty of each of r sources that all lines
        share, shape (n, 3, r), mm.
    """

    alone_mm2: Floats
    common_mm: Floats


@dataclass(frozen=True, slots=True, eq=False)
class LineErrors:
    """What the instrument does to the centerlines, source by source.

    Parameters
    ----------
    directions
        Of the lines, unit length, shape (n, 3).
    edges_mm2
        Covariance of each line near the RCM from the noise of its edges, shape (n, 3, 3), mm².
    calibration_mm
        What the calibration's uncertainty moves the lines by, shape (n, 3, r), mm.
    shading_mm
        What light from one side may move them by, shape (n, 3, c), mm.
    scatter
        How many times as far as stated the edges miss the cylinders that fit them; at least 1.
    floor_mm2
        Variance of a line a component beyond these, as seen on a gold standard, and the ends of
        its 95 % interval, shape (3,), mm²: estimate, lower, upper.
    """

    directions: Floats
    edges_mm2: Floats
    calibration_mm: Floats
    shading_mm: Floats
    scatter: float = 1.0
    floor_mm2: Floats = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        count = len(self.directions)
        for name, shape in (
            ("directions", (count, 3)),
            ("edges_mm2", (count, 3, 3)),
            ("calibration_mm", (count, 3, None)),
            ("shading_mm", (count, 3, None)),
            ("floor_mm2", (3,)),
        ):
            object.__setattr__(self, name, read_only(checked(getattr(self, name), shape, name)))

    @property
    def common_mm(self) -> Floats:
        """What calibration and shading do, shape (n, 3, r + c), mm."""
        return np.concatenate([self.calibration_mm, self.shading_mm], axis=2)

    def across(self) -> Floats:
        """Return the projectors Pᵢ across the lines, shape (n, 3, 3)."""
        return projectors(self.directions)

    def location_mm2(self, alone_mm2: Floats) -> Floats:
        """Return the least-squares point's covariance from errors of each line's own, (3, 3)."""
        across = self.across()
        inverse = np.linalg.inv(across.sum(axis=0))
        return np.asarray(inverse @ (across @ alone_mm2 @ across).sum(axis=0) @ inverse)

    def stated(self) -> Noise:
        """Return what is known to be there: noise of the edges, calibration, the measured floor."""
        return Noise(self.edges_mm2 + self.floor_mm2[0] * self.across(), self.calibration_mm)

    def possible(self) -> tuple[Noise, ...]:
        """Return noise as it may be besides: less, if the floor is lower; more, with shading."""
        least = Noise(self.edges_mm2 + self.floor_mm2[1] * self.across(), self.calibration_mm)
        more = self.scatter**2 * self.edges_mm2 + self.floor_mm2[2] * self.across()
        return least, Noise(more, self.common_mm)
