"""The maximum-likelihood cylinder behind all edges of a pose, for any number of cameras.

Where the paper intersects the planes midway between the edges (14)–(16), this fits the axis and the
radius so that the planes that touch the cylinder (10)–(11) meet the measured edges, each weighted
by its covariance. Two cameras give eight numbers for four or five unknowns: what is left over tells
whether the edges, the cameras' poses and the radius belong together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pivometer._arrays import Floats, checked, read_only
from pivometer.errors import DegenerateGeometryError, ShapeError
from pivometer.geometry.cylinder import tangent_planes
from pivometer.geometry.line import unit
from pivometer.geometry.rigid import RigidTransform
from pivometer.shaft.triangulation import Centerline

ITERATIONS = 20
CONVERGED = 1e-6
"""A step that moves every edge by less than this part of its uncertainty is the last."""

LEAST_DISTANCE_RADII = 1.001
"""A fit that comes nearer than this to a camera's centre stops: inside there are no edges."""

LEAST_SHARE = 1e-12
"""Smallest part of the normal equations' diagonal that the other unknowns leave of it; 1e-16 is
rounding, 1e-7 the share of the depth at 0.02° between the centerline planes."""


@dataclass(frozen=True, slots=True, eq=False)
class CylinderFits:
    """Cylinders fitted to the edges of n poses, in the reference camera's frame.

    Parameters
    ----------
    points_mm
        Foot of the perpendicular from the reference camera's centre on each axis, (n, 3), mm.
    directions
        Unit directions of the axes, shape (n, 3), in the sense of n_l × n_r of the first camera
        that saw the pose, (8).
    bases
        Two unit vectors perpendicular to each direction and to each other, shape (n, 2, 3).
    covariances
        Covariance of each axis, shape (n, 4, 4), as `Centerline.covariance`; a fitted radius adds
        its own uncertainty.
    radii_mm
        The radius of each cylinder, shape (n,), mm.
    radii_u_mm
        Standard uncertainty of each radius by the edges alone, shape (n,), mm; zero where known.
    whitening
        What turns both normals of a camera, as one vector of six in its frame, into four numbers of
        unit variance, shape (n, c, 4, 6); zero where the camera did not see the pose.
    residuals
        These four numbers for the difference between touching and measured normals, (n, c, 4).
    slopes
        Derivatives of `residuals` by the axis as in `covariances`, and by the radius, shape
        (n, c, 4, 5).
    converged
        Which fits converged, shape (n,).
    """

    points_mm: Floats
    directions: Floats
    bases: Floats
    covariances: Floats
    radii_mm: Floats
    radii_u_mm: Floats
    whitening: Floats
    residuals: Floats
    slopes: Floats
    converged: NDArray[np.bool_]

    def __post_init__(self) -> None:
        for name in (
            "points_mm",
            "directions",
            "bases",
            "covariances",
            "radii_mm",
            "radii_u_mm",
            "whitening",
            "residuals",
            "slopes",
        ):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    def centerline(self, pose: int, dihedral_rad: float, diameters_mm: ArrayLike) -> Centerline:
        """Return one of the axes as a centerline, with what triangulation says of that pose."""
        return Centerline(
            self.points_mm[pose],
            self.directions[pose],
            dihedral_rad,
            checked(diameters_mm, (None,), "diameters_mm"),
            self.covariances[pose],
            self.bases[pose],
        )

    @property
    def chi_squares(self) -> Floats:
        """Sum of each pose's squared residuals, shape (n,)."""
        total: Floats = np.square(self.residuals).sum(axis=(1, 2))
        return total


def fit_cylinders(
    edge_normals: ArrayLike,
    covariances: ArrayLike,
    reference_from_camera: Sequence[RigidTransform],
    *,
    radius_mm: float | Literal["common", "free"],
    seen: ArrayLike | None = None,
) -> CylinderFits:
    """Fit a cylinder to the edges of each pose by maximum likelihood.

    Gauss–Newton on the tangent planes' normals with analytic derivatives, all poses at once.

    Parameters
    ----------
    edge_normals
        Coimage normals of the edges pointing away from the shaft, shape (n, c, 2, 3), each in its
        camera's frame; anything finite where a camera did not see the pose.
    covariances
        Covariance of each camera's two normals as one vector of six, shape (n, c, 6, 6), as
        `ShaftEdges.normals_covariance`.
    reference_from_camera
        The c transforms of the rig, the identity first.
    radius_mm
        The radius, mm, where it is known; ``"common"`` for one unknown radius of all poses,
        ``"free"`` for one in each pose.
    seen
        Which camera saw which pose, shape (n, c); all did if not given.

    Returns
    -------
    CylinderFits
        Axes, radii and what is left of the edges. With a known radius a pose is determined even
        where the cameras' planes through its axis are one plane, though badly: its depth then
        follows from the distance of the two edges alone.

    Raises
    ------
    DegenerateGeometryError
        If the edges do not determine an axis and, where unknown, the radius.
    ShapeError
        If the arrays do not match, or a covariance is not that of two unit normals.

    References
    ----------
    Wilson et al., eqs. (8) and (10)–(12), with an adjustment in place of (14)–(16).

    Examples
    --------
    >>> from pivometer.geometry import tangent_plane_normals
    >>> left_from_right = RigidTransform([[0, 0, -1], [0, 1, 0], [1, 0, 0]], [500, 0, 500])
    >>> right_from_left = left_from_right.inverse()
    >>> left = tangent_plane_normals([0, 0, 500], [0, -1, 0], 5.0)
    >>> right = tangent_plane_normals(right_from_left @ [0, 0, 500], [0, -1, 0], 5.0)
    >>> fits = fit_cylinders(
    ...     [[left, right]],
    ...     np.tile(1e-10 * np.eye(6), (1, 2, 1, 1)),
    ...     [RigidTransform.identity(), left_from_right],
    ...     radius_mm="free",
    ... )
    >>> fits.points_mm.round(6) + 0.0, fits.radii_mm.round(6)
    (array([[  0.,   0., 500.]]), array([5.]))
    """
    count = len(reference_from_camera)
    normals = unit(checked(edge_normals, (None, count, 2, 3), "edge_normals"))
    given = checked(covariances, (len(normals), count, 6, 6), "covariances")
    visible = _visible(seen, normals)
    rotations = np.stack([x.rotation for x in reference_from_camera])
    centres = np.stack([x.translation_mm for x in reference_from_camera])
    measured = np.einsum("cij,nckj->ncki", rotations, normals)
    whitening = _whitening(normals, given, visible)
    local = np.einsum("ncakj,cij->ncaki", whitening.reshape(*visible.shape, 4, 2, 3), rotations)
    known = None if isinstance(radius_mm, str) else float(radius_mm)
    points, directions, radii = _first_cylinders(measured, centres, visible, known)
    if radius_mm == "common":
        radii = np.full_like(radii, np.median(radii))
    kind = radius_mm if isinstance(radius_mm, str) else "known"
    problem = _Problem(measured, local, centres, kind)
    return problem.solved(points, directions, radii, whitening)


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """The edges of all poses in the reference frame, and their whitening, (n, c, 4, 2, 3)."""

    measured: Floats
    whitening: Floats
    centres: Floats
    radius: Literal["known", "common", "free"]

    def solved(
        self, points: Floats, directions: Floats, radii: Floats, whitening: Floats
    ) -> CylinderFits:
        """Return the fits from first values."""
        converged = np.zeros(len(points), dtype=bool)
        for _ in range(ITERATIONS):
            bases, residuals, slopes = self.linearized(points, directions, radii)
            step, size = self._step(residuals, slopes)
            converged = size < CONVERGED
            if converged.all():
                break
            points = points + np.einsum("nk,nkj->nj", step[:, :2], bases)
            directions = unit(directions + np.einsum("nk,nkj->nj", step[:, 2:4], bases))
            points = points - np.vecdot(points, directions)[:, None] * directions
            radii = radii + step[:, 4]
        bases, residuals, slopes = self.linearized(points, directions, radii)
        parts = self._eliminated(slopes.reshape(len(slopes), -1, 5))
        pull = parts.pull
        return CylinderFits(
            points,
            directions,
            bases,
            parts.inverse + pull @ np.swapaxes(pull, 1, 2) * parts.variance,
            radii,
            np.sqrt(parts.variance[:, 0, 0]),
            whitening,
            residuals,
            slopes,
            converged,
        )

    def linearized(
        self, points: Floats, directions: Floats, radii: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Return bases, whitened residuals (n, c, 4) and their derivatives (n, c, 4, 5)."""
        self._refuse_inside(points, directions, radii)
        bases = perpendicular_bases(directions)
        normals, slopes = tangent_planes(points, directions, radii, self.centres, bases)
        swapped = np.vecdot(normals[..., 1, :] - normals[..., 0, :], self.measured[..., 0, :]) > 0
        normals = np.where(swapped[..., None, None], normals[:, :, ::-1], normals)
        slopes = np.where(swapped[..., None, None, None], slopes[:, :, ::-1], slopes)
        residuals = np.einsum("ncaki,ncki->nca", self.whitening, normals - self.measured)
        return bases, residuals, np.einsum("ncaki,nckip->ncap", self.whitening, slopes)

    def _step(self, residuals: Floats, slopes: Floats) -> tuple[Floats, Floats]:
        """Return the Gauss–Newton step (n, 5) and how far it moves any edge, in uncertainties."""
        jacobian = slopes.reshape(len(slopes), -1, 5)
        parts = self._eliminated(jacobian)
        rows = -residuals.reshape(len(residuals), -1, 1)
        line = parts.inverse @ (np.swapaxes(jacobian[..., :4], 1, 2) @ rows)
        gain = np.swapaxes(parts.left, 1, 2) @ rows
        radius = self._pooled(gain) * parts.variance
        step = np.concatenate([line - parts.pull * radius, radius], axis=1)
        moved: Floats = np.abs(jacobian @ step).max(axis=(1, 2))
        return step[..., 0], moved

    def _eliminated(self, jacobian: Floats) -> _Eliminated:
        by_line, by_radius = jacobian[..., :4], jacobian[..., 4:]
        inverse = _inverse(np.swapaxes(by_line, 1, 2) @ by_line)
        pull = inverse @ (np.swapaxes(by_line, 1, 2) @ by_radius)
        left = by_radius - by_line @ pull
        if self.radius == "known":
            return _Eliminated(inverse, pull, left, np.zeros((len(jacobian), 1, 1)))
        weight, whole = (
            self._pooled(np.square(x).sum(axis=1, keepdims=True)) for x in (left, by_radius)
        )
        if not (weight > LEAST_SHARE * whole).all():
            raise _undetermined()
        return _Eliminated(inverse, pull, left, 1 / weight)

    def _pooled(self, values: Floats) -> Floats:
        """Return the sum over all poses in every pose's place, where they share the radius."""
        if self.radius != "common":
            return values
        return np.broadcast_to(values.sum(axis=0), values.shape)

    def _refuse_inside(self, points: Floats, directions: Floats, radii: Floats) -> None:
        """Refuse a step after which a camera would stand inside the cylinder: no edges there."""
        start = points[:, None] - self.centres
        foot = start - np.vecdot(start, directions[:, None])[..., None] * directions[:, None]
        seen = self.whitening.any(axis=(2, 3, 4))
        nearest = np.where(seen, np.linalg.norm(foot, axis=-1), np.inf).min(axis=1)
        if not (np.abs(radii) * LEAST_DISTANCE_RADII < nearest).all():
            raise _undetermined()


@dataclass(frozen=True, slots=True, eq=False)
class _Eliminated:
    """The normal equations with each pose's axis eliminated.

    `inverse` (n, 4, 4) is that of the axis alone, `pull` (n, 4, 1) how a radius pulls the axis,
    `left` (n, 4c, 1) what a radius does to the edges that no axis undoes, and `variance` (n, 1, 1)
    that of the radius, zero where it is known.
    """

    inverse: Floats
    pull: Floats
    left: Floats
    variance: Floats


def _inverse(square: Floats) -> Floats:
    """Invert normal matrices (n, 4, 4) by their correlations, so that units do not matter."""
    scale = np.sqrt(np.einsum("nii->ni", square))
    if not (scale > 0).all():
        raise _undetermined()
    outer = scale[:, :, None] * scale[:, None]
    values, vectors = np.linalg.eigh(square / outer)
    if not (values[:, 0] > LEAST_SHARE).all():
        raise _undetermined()
    return np.asarray((vectors / values[:, None]) @ np.swapaxes(vectors, 1, 2) / outer)


def _undetermined() -> DegenerateGeometryError:
    return DegenerateGeometryError(
        "the edges do not determine the cylinder: its axis lies in one plane with all cameras, or "
        "passes through one",
        next_step="leave this pose out, or state the shaft's diameter",
    )


def _visible(seen: ArrayLike | None, normals: Floats) -> NDArray[np.bool_]:
    visible = np.ones(normals.shape[:2], bool) if seen is None else np.asarray(seen, dtype=bool)
    if visible.shape != normals.shape[:2] or not (visible.sum(axis=1) >= 2).all():
        raise ShapeError(
            "a cylinder needs the edges of two cameras in every pose",
            next_step="leave out the poses that a single camera saw",
        )
    return visible


def perpendicular_bases(directions: Floats) -> Floats:
    """Return two unit vectors perpendicular to each direction (n, 3), shape (n, 2, 3)."""
    seeds = np.eye(3)[np.abs(directions).argmin(axis=-1)]
    first = unit(np.cross(directions, seeds))
    return np.stack([first, np.cross(directions, first)], axis=-2)


def _whitening(normals: Floats, covariances: Floats, visible: NDArray[np.bool_]) -> Floats:
    """Return what makes four independent numbers of unit variance of a camera's two normals."""
    n, c = visible.shape
    tangents = np.zeros((n, c, 2, 2, 2, 3))
    bases = perpendicular_bases(normals)
    tangents[:, :, 0, :, 0], tangents[:, :, 1, :, 1] = bases[:, :, 0], bases[:, :, 1]
    flat = tangents.reshape(n, c, 4, 6)
    spread = flat @ covariances @ np.swapaxes(flat, -1, -2)
    spread[~visible] = np.eye(4)
    try:
        whitening = np.linalg.solve(np.linalg.cholesky(spread), flat)
    except np.linalg.LinAlgError:
        raise ShapeError(
            "a covariance of two normals is not positive definite across them",
            next_step="pass the covariances that the edge fit returned",
        ) from None
    return np.asarray(np.where(visible[..., None, None], whitening, 0.0))


def _first_cylinders(
    measured: Floats, centres: Floats, visible: NDArray[np.bool_], radius_mm: float | None
) -> tuple[Floats, Floats, Floats]:
    """Return points, directions and radii by linear least squares: n · b + r = n · centre, (10).

    All planes hold the direction, so it is that in which their normals have least extent.
    """
    weight = visible[:, :, None, None].astype(float)
    gram = np.einsum("ncki,nckj->nij", weight * measured, measured)
    directions = np.asarray(np.linalg.eigh(gram)[1][..., 0])
    first = visible.argmax(axis=1)
    edges = measured[np.arange(len(measured)), first]
    sense = np.vecdot(np.cross(edges[:, 0], edges[:, 1]), directions)
    directions = directions * np.where(sense < 0, -1.0, 1.0)[:, None]
    bases = perpendicular_bases(directions)
    rows = np.einsum("nki,ncei->ncek", bases, measured) * weight
    right = np.einsum("ncei,ci->nce", measured, centres)[..., None] * weight
    if radius_mm is None:
        rows = np.concatenate([rows, weight * np.ones_like(rows[..., :1])], axis=-1)
    else:
        right = right - radius_mm * weight
    n = len(measured)
    rows, right = rows.reshape(n, -1, rows.shape[-1]), right.reshape(n, -1, 1)
    found = (np.linalg.pinv(rows) @ right)[..., 0]
    radii = found[:, 2] if radius_mm is None else np.full(n, radius_mm)
    return np.einsum("nk,nki->ni", found[:, :2], bases), directions, radii
