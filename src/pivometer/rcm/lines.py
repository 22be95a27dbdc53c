"""The lines as the solvers want them: unit directions, centred, turned to their principal axes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pivometer._arrays import Floats, checked
from pivometer.errors import DegenerateGeometryError, ShapeError, TooFewPosesError
from pivometer.geometry.line import across, unit
from pivometer.rcm.lapack import lapack

FEWEST_LINES = 3
"""Two lines have no error: one point is as near as can be to both, and 2n − 3 = 1."""

LEAST_SPREAD_RAD = 1e-4
"""Smallest rms angle of the lines to their common axis that double precision can work with.

The position along the axis moves by the lines' errors divided by this angle: at 1e-4 rad the
rounding of the directions alone (1e-16 of the distance to the given points) is magnified to 1e-12
of it. Physically useful cones are two to three decades wider (`geometry_check`).
"""


@dataclass(frozen=True, slots=True, eq=False)
class CentredLines:
    """Lines relative to their least-squares point, in the principal axes of Σ Pᵢ.

    With Pᵢ = I − aᵢaᵢᵀ, the distance of a point q from line i is ‖Pᵢ q − rᵢ‖: τ of (3) is gone.

    Parameters
    ----------
    centre
        The least-squares point, shape (3,), mm.
    turn
        The principal axes as columns, shape (3, 3): ``x = centre + turn @ q``.
    information
        The eigenvalues of N = Σ Pᵢ, ascending, shape (3,).
    axes
        Unit directions, shape (n, 3).
    offsets
        rᵢ, the foot of the perpendicular from the centre on each line, shape (n, 3), mm.
    """

    centre: Floats
    turn: Floats
    information: Floats
    axes: Floats
    offsets: Floats

    def subset(self, chosen: NDArray[np.intp]) -> CentredLines:
        """Return some of the lines, centred as before."""
        return replace(self, axes=self.axes[chosen], offsets=self.offsets[chosen])

    def radii(self) -> Floats:
        """Return the distance of the centre from each line, shape (n,), mm."""
        return np.asarray(np.sqrt(np.vecdot(self.offsets, self.offsets)))

    def distances(self, point: Floats) -> Floats:
        """Return the distance of a point q, shape (3,), from each line, shape (n,), mm."""
        moved = point - self.offsets
        x, y, z = moved[:, 0], moved[:, 1], moved[:, 2]
        a, b, c = self.axes[:, 0], self.axes[:, 1], self.axes[:, 2]
        across = np.empty_like(moved)  # moved × axes, which loses nothing however far q is
        across[:, 0] = y * c - z * b
        across[:, 1] = z * a - x * c
        across[:, 2] = x * b - y * a
        return np.asarray(np.sqrt(np.vecdot(across, across)))

    def projectors(self) -> Floats:
        """Return all Pᵢ, shape (n, 3, 3).

        The diagonal is summed from squares, so that lines nearly along an axis lose no digits.
        """
        projectors = -self.axes[:, :, None] * self.axes[:, None, :]
        squares = self.axes * self.axes
        for k in range(3):
            projectors[:, k, k] = squares[:, k - 2] + squares[:, k - 1]
        return projectors


def checked_lines(points_mm: ArrayLike, directions: ArrayLike) -> tuple[Floats, Floats]:
    """Return the lines' points and unit directions, both of shape (n, 3), after checking them.

    Raises
    ------
    ShapeError
        If the shapes differ from (n, 3) or from each other, or a value is not finite.
    TooFewPosesError
        If there are fewer than three lines.
    """
    points = checked(points_mm, (None, 3), "points_mm")
    axes = unit(directions)
    if points.shape != axes.shape:
        raise ShapeError(
            f"points_mm has shape {points.shape} but directions {axes.shape}",
            next_step="pass one point and one direction for each line",
        )
    if len(points) < FEWEST_LINES:
        raise TooFewPosesError(
            f"{len(points)} usable poses, but an RCM with its error needs at least {FEWEST_LINES}",
            next_step="add poses, spread over as wide a cone as the robot reaches",
        )
    return points, axes


def centred_lines(points_mm: ArrayLike, directions: ArrayLike) -> CentredLines:
    """Solve N p = Σ Pᵢ bᵢ for the least-squares point and return the lines relative to it.

    Parameters
    ----------
    points_mm, directions
        A point on each line (mm) and its direction, of any length, shape (n, 3), same frame.

    Raises
    ------
    ShapeError, TooFewPosesError
        As `checked_lines`.
    DegenerateGeometryError
        If the lines are parallel to within `LEAST_SPREAD_RAD`.
    """
    points, axes = checked_lines(points_mm, directions)
    information, turn, axes = _principal_axes(axes)
    ones = np.ones(len(points))  # ones @ x: sum(axis=0) in a seventh of the time
    centre = ones @ points / len(points)
    # The second round removes what the first loses when the given points lie far along the lines.
    for _ in range(2):
        offsets = across((points - centre) @ turn, axes)
        shift = ones @ offsets / information
        centre = centre + turn @ shift
    # The second rejection makes the offsets orthogonal to the axes relative to their own length.
    return CentredLines(centre, turn, information, axes, across(offsets - shift, axes))


def _principal_axes(axes: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the eigenvalues of N = Σ (I − aᵢaᵢᵀ), ascending, its eigenvectors, and the axes there.

    The eigenvalues are summed from squares, so that the least keeps its digits.
    """
    turn = lapack().dsyev(axes.T @ axes)[1][:, ::-1]
    turned = axes @ turn
    x, y, z = np.ones(len(axes)) @ (turned * turned)
    information = np.array([y + z, x + z, x + y])
    spread = float(np.sqrt(information[0] / len(axes)))
    if spread < LEAST_SPREAD_RAD:
        raise DegenerateGeometryError(
            f"the {len(axes)} centerlines are parallel: their directions spread by only "
            f"{spread:.1e} rad, less than the {LEAST_SPREAD_RAD:.0e} rad that fix a point along "
            "them",
            next_step="tilt the shaft between poses; a cone of at least 20° is advised",
        )
    return information, turn, turned
