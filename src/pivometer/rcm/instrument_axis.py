"""The axis of a tracked instrument: given, or found from how it slides through the RCM.

Seen from the instrument, the RCM moves along the axis as the instrument is pushed in and out. So
the axis is the line, fixed in the instrument, that a point fixed in the tracker's frame keeps to.
An instrument that only pivots about its tip does not slide, and any line through the tip would do.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats, checked, read_only
from pivometer.errors import DegenerateGeometryError, ShapeError, TooFewPosesError
from pivometer.geometry.line import projectors, unit
from pivometer.rcm.blocks import ALIKE, block_covariance, halves_apart, lag_one, worth
from pivometer.rcm.pivot import FEWEST_POSES
from pivometer.rcm.result import Finding, RcmSolution

LEAST_SLIDE = 10.0
"""How many times the rms miss the instrument must slide along its axis, rms. The direction is then
known to 0.1/√n rad; where an instrument only pivots, the misses themselves look like a slide of one
to three times the rest (a real recording: 1.9)."""

TRIED = 2000
"""Directions tried before the best is refined, 3° apart."""

REFINEMENTS = 30
"""Gauss–Newton steps; from the nearest tried direction 4 to 6 are usual."""


@dataclass(frozen=True, slots=True, eq=False)
class InstrumentAxis:
    """The instrument's axis in the instrument's frame.

    Parameters
    ----------
    point_mm
        A point on the axis, shape (3,), mm.
    direction
        Its unit direction, shape (3,).
    slide_mm
        How far the RCM moved along it, rms, mm; `None` where the axis was given.
    direction_u_deg
        Standard uncertainty of the direction, deg; `None` where the axis was given.
    """

    point_mm: Floats
    direction: Floats
    slide_mm: float | None = None
    direction_u_deg: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "point_mm", read_only(checked(self.point_mm, (3,), "point_mm")))
        object.__setattr__(self, "direction", read_only(unit(self.direction, "direction")))

    def lines(self, rotations: ArrayLike, translations_mm: ArrayLike) -> tuple[Floats, Floats]:
        """Return the axis in the tracker's frame: points (mm) and directions, shape (n, 3) each.

        Parameters
        ----------
        rotations
            From the instrument's frame to the tracker's, shape (n, 3, 3).
        translations_mm
            The instrument's origin in the tracker's frame, shape (n, 3), mm.

        Examples
        --------
        >>> axis = InstrumentAxis([0, 0, 5], [0, 0, 1])
        >>> points, directions = axis.lines([np.eye(3)] * 2, [[1, 2, 3], [0, 0, 0]])
        >>> points
        array([[1., 2., 8.],
               [0., 0., 5.]])
        """
        R, origins = _checked(rotations, translations_mm)
        return R @ self.point_mm + origins, R @ self.direction


def estimate_axis(rotations: ArrayLike, translations_mm: ArrayLike) -> InstrumentAxis:
    """Return the axis, fixed in the instrument, that keeps nearest to one point of the tracker.

    For a given direction the point and the axis' place follow from a linear system. Directions all
    over the half sphere are tried, and the best is refined, so that the answer does not depend on
    a first guess.

    Parameters
    ----------
    rotations, translations_mm
        As `InstrumentAxis.lines`, in the order of time.

    Raises
    ------
    ShapeError
        If the shapes differ.
    TooFewPosesError
        If there are fewer than eight poses.
    DegenerateGeometryError
        If the instrument slid too little along any axis, or turned too little.

    Examples
    --------
    >>> from pivometer.geometry import RigidTransform
    >>> turns = [[0.3, 0, 0], [-0.3, 0, 0], [0, 0.3, 0], [0, -0.3, 0]] * 2
    >>> R = np.stack([RigidTransform.from_rotation_vector(v, [0, 0, 0]).rotation for v in turns])
    >>> depths = np.arange(8)[:, None] * [0.0, 0, 10]
    >>> axis = estimate_axis(R, [1, 2, 3] - (R @ depths[..., None])[..., 0])
    >>> axis.direction.round(6) + 0.0, round(axis.slide_mm, 1)
    (array([0., 0., 1.]), 22.9)
    """
    R, origins = _checked(rotations, translations_mm)
    if len(R) < FEWEST_POSES:
        raise TooFewPosesError(
            f"{len(R)} poses, {FEWEST_POSES} are the least", next_step="record more poses"
        )
    middle = origins.mean(axis=0)
    inside = np.swapaxes(R, 1, 2)  # from the tracker's frame to the instrument's
    start = _best_tried(inside, (inside @ (origins - middle)[..., None])[..., 0])
    fit = _refined(inside, origins - middle, start)
    slide = float(fit.along.std())
    miss = float(np.sqrt(np.vecdot(fit.misses, fit.misses).mean()))
    if not slide > LEAST_SLIDE * max(miss, 1e-12 * slide):
        raise DegenerateGeometryError(
            f"the axis of the instrument is not determined: along the best one it slid by "
            f"{slide:.2g} mm rms, only {slide / max(miss, 1e-300):.1f} times the misses across it; "
            f"{LEAST_SLIDE:g} are the least",
            next_step="push the instrument in and out while it pivots, or state its axis",
        )
    covariance = block_covariance(fit.rows(inside), fit.misses)
    return InstrumentAxis(
        point_mm=fit.place,
        direction=fit.direction,
        slide_mm=slide,
        direction_u_deg=float(np.degrees(np.sqrt(np.trace(covariance[5:, 5:]) / 2))),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """A point p of the tracker, and a line of the instrument that keeps near it."""

    point: Floats
    place: Floats
    direction: Floats
    along: Floats
    across: Floats
    misses: Floats

    def rows(self, inside: Floats) -> Floats:
        """Return how the misses depend on p, on the place (2) and on the slope (2), (n, 2, 7)."""
        eye = np.broadcast_to(np.eye(2), (len(inside), 2, 2))
        return np.concatenate(
            [self.across @ inside, -eye, -self.along[:, None, None] * eye], axis=2
        )


def _fit(inside: Floats, origins: Floats, point: Floats, place: Floats, direction: Floats) -> _Fit:
    """Return the fit with its misses, shape (n, 2): those of p, seen from the instrument."""
    across = np.linalg.svd(direction[None])[2][1:]
    seen = (inside @ (point - origins)[..., None])[..., 0] - place
    return _Fit(point, place, direction, seen @ direction, across, seen @ across.T)


def _best_tried(inside: Floats, seen: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the best of directions spread over the half sphere, with its p and place."""
    rows, values = inside - inside.mean(axis=0), seen - seen.mean(axis=0)
    squares = np.einsum("naj,nbk->abjk", rows, rows)
    cross = np.einsum("naj,nb->abj", rows, values)
    index = np.arange(TRIED) + 0.5
    turn, height = np.pi * (1 + np.sqrt(5)) * index, index / TRIED
    flat = np.sqrt(1 - height**2)
    directions = np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1)
    kept = projectors(directions)
    normal = np.einsum("abjk,mab->mjk", squares, kept)
    if not (np.linalg.eigvalsh(normal)[:, 0] > 1e-9 * len(rows)).any():
        raise DegenerateGeometryError(
            "the instrument hardly turned, or turned about one axis only",
            next_step="tilt it in all directions, as in a cone of at least 20°, better 57°",
        )
    right = np.einsum("abj,mab->mj", cross, kept)
    points = np.linalg.solve(normal + 1e-12 * len(rows) * np.eye(3), right[..., None])[..., 0]
    sums = np.einsum("ab,mab->m", values.T @ values, kept) - np.vecdot(points, right)
    best = int(np.argmin(sums))
    place = inside.mean(axis=0) @ points[best] - seen.mean(axis=0)
    return points[best], place, directions[best]


def _refined(inside: Floats, origins: Floats, start: tuple[Floats, Floats, Floats]) -> _Fit:
    """Return the least sum of squares near a start, by Gauss–Newton steps while they lessen it."""
    fit = _fit(inside, origins, *start)
    for _ in range(REFINEMENTS):
        rows = fit.rows(inside).reshape(-1, 7)
        scale = np.sqrt(np.square(rows).sum(axis=0))
        step = -np.linalg.lstsq(rows / scale, fit.misses.ravel(), rcond=1e-12)[0] / scale
        after = _fit(
            inside,
            origins,
            fit.point + step[:3],
            fit.place + step[3:5] @ fit.across,
            unit(fit.direction + step[5:] @ fit.across),
        )
        if not np.square(after.misses).sum() < np.square(fit.misses).sum():
            break
        fit = after
    return fit


def with_recording(
    rcm: RcmSolution, axis: InstrumentAxis, rotations: ArrayLike, translations_mm: ArrayLike
) -> tuple[RcmSolution, tuple[Finding, ...]]:
    """Return a solution for the lines of a recording with a covariance that knows it is one.

    Parameters
    ----------
    rcm
        What `solve` returned for `InstrumentAxis.lines`.
    axis
        The axis; if it was estimated, its uncertainty is in the covariance, too.
    rotations, translations_mm
        The poses, in the order of time.

    Returns
    -------
    tuple
        The solution with the covariance of the least-squares point from blocks of the recording,
        and a warning if successive poses are alike.
    """
    R, origins = _checked(rotations, translations_mm)
    inside, squares = np.swapaxes(R, 1, 2), rcm.least_squares
    fit = _fit(inside, origins, squares.point_mm, axis.point_mm, axis.direction)
    unknowns = 3 if axis.slide_mm is None else 7
    rows = fit.rows(inside)[:, :, :unknowns]
    covariance = block_covariance(rows, fit.misses)[:3, :3]
    found = replace(rcm, least_squares=replace(squares, covariance_mm2=covariance))
    alike = lag_one(fit.misses)
    if alike <= ALIKE:
        return found, ()
    text = (
        f"successive misses are alike (autocorrelation {alike:.2f}): {len(R)} poses tell as much "
        f"as {len(R) * worth(alike):.0f} independent ones, and the least-squares points of its "
        f"two halves are {np.linalg.norm(halves_apart(rows, fit.misses)[:3]):.1f} mm apart; the "
        "stated uncertainty takes it into account, the misses do not show it"
    )
    step = "spread the poses: pause, and take single ones in all directions"
    return found, (Finding("warning", text, step),)


def _checked(rotations: ArrayLike, translations_mm: ArrayLike) -> tuple[Floats, Floats]:
    R = checked(rotations, (None, 3, 3), "rotations")
    origins = checked(translations_mm, (None, 3), "translations_mm")
    if len(R) != len(origins):
        raise ShapeError(
            f"{len(R)} rotations for {len(origins)} translations",
            next_step="pass one of each for every pose",
        )
    return R, origins
