"""The centerline in space from the edges that several cameras see, eqs. (12)–(16)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats, checked, read_only
from pivometer.errors import DegenerateGeometryError, ShapeError
from pivometer.geometry.line import cross, unit
from pivometer.geometry.plane import angle_between_planes
from pivometer.geometry.rigid import RigidTransform
from pivometer.shaft.silhouette import centerline_normal_average

REFUSE_DIHEDRAL_RAD = float(np.radians(5.0))
"""Under 5° between the centerline planes a pose is refused: sin φ < 0.09 makes every pixel of
edge error eleven times as harmful as at 90°, and the error is no longer first order."""

WARN_DIHEDRAL_RAD = float(np.radians(20.0))
"""Under 20° between the centerline planes a pose is used with a warning: errors triple."""

_STEP_RAD = 1e-5
"""Step of the central differences: truncation and rounding are then both under 1e-9 relative."""


@dataclass(frozen=True, slots=True, eq=False)
class Centerline:
    """One triangulated centerline, in the reference camera's frame: the paper's a τ + b.

    Parameters
    ----------
    point_mm
        Foot of the perpendicular from the reference camera's centre, shape (3,), mm: b of (12).
    direction
        Unit direction, shape (3,), in the sense of n_l × n_r of the reference camera, (8).
    dihedral_rad
        Largest angle φ between two cameras' centerline planes, rad, in [0, π/2].
    diameters_mm
        The shaft's diameter as each camera sees it, shape (c,), mm: the sum of the distances of
        its two tangent planes from the triangulated axis, at the foot of the perpendicular from
        that camera's centre.
    covariance
        Covariance, shape (4, 4), of the line's offsets (mm) along the two rows of `basis` at
        `point_mm`, then of its slopes along them (rad). Zero where no covariance was given.
    basis
        Two unit vectors perpendicular to the direction and to each other, shape (2, 3).
    """

    point_mm: Floats
    direction: Floats
    dihedral_rad: float
    diameters_mm: Floats
    covariance: Floats
    basis: Floats

    def __post_init__(self) -> None:
        shapes: dict[str, tuple[int | None, ...]] = {
            "point_mm": (3,),
            "direction": (3,),
            "diameters_mm": (None,),
            "covariance": (4, 4),
            "basis": (2, 3),
        }
        for name, shape in shapes.items():
            object.__setattr__(self, name, read_only(checked(getattr(self, name), shape, name)))

    def position_covariance_mm2(self, point_mm: ArrayLike) -> Floats:
        """Return the covariance of the line where it passes nearest to a point.

        Parameters
        ----------
        point_mm
            Any point, shape (3,), mm, reference camera's frame.

        Returns
        -------
        numpy.ndarray
            Shape (3, 3), mm², of rank 2: perpendicular to the direction.
        """
        tau = float((checked(point_mm, (3,), "point_mm") - self.point_mm) @ self.direction)
        at = np.hstack([np.eye(2), tau * np.eye(2)])
        covariance: Floats = self.basis.T @ at @ self.covariance @ at.T @ self.basis
        return covariance


def triangulate_two_view(
    left_normal: ArrayLike, right_normal: ArrayLike, left_from_right: RigidTransform
) -> tuple[Floats, Floats]:
    """Return (b, a) of the line where two centerline planes meet, exactly as the paper prints it.

    Parameters
    ----------
    left_normal, right_normal
        Normals n_l^c and n_r^c of the centerline planes, shape (3,), each in its camera's frame.
    left_from_right
        The paper's (R, t) of (13), mm.

    Returns
    -------
    tuple of numpy.ndarray
        b (mm), the point nearest to the left camera's centre, and the unit direction a, shape
        (3,) each, left camera's frame.

    Raises
    ------
    DegenerateGeometryError
        If the planes are under 5° apart.

    References
    ----------
    Wilson et al., eqs. (13)–(16) and (12).

    Examples
    --------
    >>> left_from_right = RigidTransform([[0, 0, -1], [0, 1, 0], [1, 0, 0]], [500, 0, 500])
    >>> b, a = triangulate_two_view([1, 0, 0], [1, 0, 0], left_from_right)
    >>> b, a
    (array([  0.,   0., 500.]), array([ 0., -1.,  0.]))
    """
    n_l, n_r = unit(left_normal, "left_normal"), unit(right_normal, "right_normal")
    R, t = left_from_right.rotation, left_from_right.translation_mm
    _refuse_degenerate(float(angle_between_planes(n_l, R @ n_r)))
    a = unit(cross(n_l, R @ n_r))  # (14)
    matrix = np.stack([n_l, R @ n_r, a])  # rows of (15), (16), (12)
    b = np.linalg.solve(matrix, np.array([0.0, n_r @ R.T @ t, 0.0]))
    return b + 0.0, a + 0.0


def lines_from_edge_normals(
    edge_normals: ArrayLike, reference_from_camera: Sequence[RigidTransform]
) -> tuple[Floats, Floats, Floats]:
    """Return points, directions and dihedral angles of many centerlines at once, without refusal.

    Parameters
    ----------
    edge_normals
        Coimage normals of the edges pointing away from the shaft, shape (..., c, 2, 3), each in
        its camera's frame.
    reference_from_camera
        The c transforms of the rig, the identity first.

    Returns
    -------
    tuple of numpy.ndarray
        Points (..., 3), mm, nearest to the reference camera's centre; unit directions (..., 3);
        largest dihedral angles (...), rad. The line minimizes the squared distances of its points
        from the c centerline planes; for two planes it is their intersection, as in the paper.

    References
    ----------
    Wilson et al., eqs. (12)–(16), in least squares for c > 2.
    """
    edges = checked(edge_normals, (-1, len(reference_from_camera), 2, 3), "edge_normals")
    rotations = np.stack([x.rotation for x in reference_from_camera])
    centres = np.stack([x.translation_mm for x in reference_from_camera])
    planes = np.einsum("cij,...cj->...ci", rotations, centerline_normal_average(edges))
    directions = _common_direction(planes)
    sense = np.einsum(
        "ij,...j->...i", rotations[0], cross(edges[..., 0, 0, :], edges[..., 0, 1, :])
    )
    flip = np.where(np.sum(sense * directions, axis=-1, keepdims=True) < 0, -1.0, 1.0)
    directions = directions * flip
    matrix = np.concatenate([planes, directions[..., None, :]], axis=-2)
    offsets = np.einsum("...ci,ci->...c", planes, centres)  # n · (b − centre) = 0, (15) and (16)
    right = np.concatenate([offsets, np.zeros_like(offsets[..., :1])], axis=-1)  # (12)
    square = np.einsum("...ki,...kj->...ij", matrix, matrix)
    vector = np.einsum("...ki,...k->...i", matrix, right)
    points = _solve_least_squares(matrix, right, square, vector)
    return points, directions, _largest_dihedral(planes)


def triangulate_centerline(
    edge_normals: ArrayLike,
    reference_from_camera: Sequence[RigidTransform],
    *,
    covariances: ArrayLike | None = None,
) -> Centerline:
    """Triangulate one centerline from the edges that two or more cameras see.

    Parameters
    ----------
    edge_normals
        Coimage normals of the edges pointing away from the shaft, shape (c, 2, 3), each in its
        camera's frame.
    reference_from_camera
        The c transforms of the rig, the identity first (13).
    covariances
        Covariance of each camera's two normals as one vector of six, shape (c, 6, 6), as
        `ShaftEdges.normals_covariance`; none if not given.

    Returns
    -------
    Centerline
        The line with its dihedral angle, the diameter from each camera and its covariance.

    Raises
    ------
    DegenerateGeometryError
        If the centerline planes are under 5° apart.
    ShapeError
        If the cameras and normals do not match in number.

    References
    ----------
    Wilson et al., eqs. (7)–(16).

    Examples
    --------
    >>> from pivometer.geometry import tangent_plane_normals
    >>> left_from_right = RigidTransform([[0, 0, -1], [0, 1, 0], [1, 0, 0]], [500, 0, 500])
    >>> right_from_left = left_from_right.inverse()
    >>> left = tangent_plane_normals([0, 0, 500], [0, -1, 0], 5.0)
    >>> right = tangent_plane_normals(right_from_left @ [0, 0, 500], [0, -1, 0], 5.0)
    >>> line = triangulate_centerline([left, right], [RigidTransform.identity(), left_from_right])
    >>> line.point_mm.round(9) + 0.0, line.diameters_mm.round(9)
    (array([  0.,   0., 500.]), array([10., 10.]))
    """
    count = len(reference_from_camera)
    if count < 2:
        raise ShapeError(
            f"{count} camera cannot triangulate a line",
            next_step="pass the edges of at least two cameras",
        )
    edges = checked(edge_normals, (count, 2, 3), "edge_normals")
    point, direction, dihedral = lines_from_edge_normals(edges, reference_from_camera)
    _refuse_degenerate(float(dihedral))
    basis = _perpendicular_basis(direction)
    if covariances is None:
        covariance = np.zeros((4, 4))
    else:
        given = checked(covariances, (count, 6, 6), "covariances")
        covariance = _line_covariance(edges, reference_from_camera, given, direction, basis)
    diameters = _diameters_mm(edges, reference_from_camera, point, direction)
    return Centerline(point, direction, float(dihedral), diameters, covariance, basis)


def _refuse_degenerate(dihedral_rad: float) -> None:
    if dihedral_rad < REFUSE_DIHEDRAL_RAD:
        raise DegenerateGeometryError(
            f"the cameras' planes through the centerline are {np.degrees(dihedral_rad):.2f}° "
            f"apart, under {np.degrees(REFUSE_DIHEDRAL_RAD):.0f}°: the plane of the centerline and "
            "a camera contains the baseline, so its depth is not determined",
            next_step="leave this pose out, or place the cameras so that no pose of the shaft "
            "points along the line between them or lies in a plane with it",
        )


def _common_direction(planes: Floats) -> Floats:
    """Return the unit direction most nearly in all planes (..., c, 3); (14) for two."""
    if planes.shape[-2] == 2:
        common = cross(planes[..., 0, :], planes[..., 1, :])
        length = np.linalg.norm(common, axis=-1, keepdims=True)
        if (length > 0).all():
            return np.asarray(common / length)
    gram = np.einsum("...ci,...cj->...ij", planes, planes)
    return np.asarray(np.linalg.eigh(gram)[1][..., 0])


def _solve_least_squares(matrix: Floats, right: Floats, square: Floats, vector: Floats) -> Floats:
    """Solve the stacked plane equations; directly where they are three, else by normal equations.

    The rows are unit vectors, so the normal equations lose no more than 1 / sin² φ < 132.
    """
    if matrix.shape[-2] == 3:
        return np.asarray(np.linalg.solve(matrix, right[..., None])[..., 0])
    return np.asarray(np.linalg.solve(square, vector[..., None])[..., 0])


def _largest_dihedral(planes: Floats) -> Floats:
    pairs = np.triu_indices(planes.shape[-2], 1)
    angles = angle_between_planes(planes[..., pairs[0], :], planes[..., pairs[1], :])
    return np.asarray(angles.max(axis=-1))


def _perpendicular_basis(direction: Floats) -> Floats:
    seed = np.eye(3)[int(np.argmin(np.abs(direction)))]
    first = unit(cross(direction, seed))
    return np.stack([first, cross(direction, first)])


def _diameters_mm(
    edges: Floats, transforms: Sequence[RigidTransform], point: Floats, direction: Floats
) -> Floats:
    """Return −(ñ_l + ñ_r) · b per camera: the sum of (10) and (11) solved for 2 r."""
    diameters = []
    for normals, reference_from_camera in zip(edges, transforms, strict=True):
        start = point - reference_from_camera.translation_mm
        foot = start - (start @ direction) * direction
        both = reference_from_camera.rotate(unit(normals).sum(axis=0))
        diameters.append(-float(both @ foot))
    return np.array(diameters)


def _line_covariance(
    edges: Floats,
    transforms: Sequence[RigidTransform],
    covariances: Floats,
    direction: Floats,
    basis: Floats,
) -> Floats:
    """Propagate the edges' covariance to offsets and slopes along `basis`, by central differences.

    To first order this is S = Ñ⁻¹ diag(s²) Ñ⁻ᵀ of the plane normals, at every point of the line.
    """
    size = edges.size
    steps = np.concatenate([np.eye(size), -np.eye(size)]) * _STEP_RAD
    moved = edges + steps.reshape(-1, *edges.shape)
    points, directions, _ = lines_from_edge_normals(moved, transforms)
    points = points - (points @ direction / (directions @ direction))[:, None] * directions
    slopes = directions / (directions @ direction)[:, None]
    values = np.hstack([points @ basis.T, slopes @ basis.T])
    jacobian = (values[:size] - values[size:]).T / (2 * _STEP_RAD)
    whole = np.zeros((size, size))
    for camera, covariance in enumerate(covariances):
        at = slice(6 * camera, 6 * camera + 6)
        whole[at, at] = covariance
    covariance = jacobian @ whole @ jacobian.T
    return np.asarray((covariance + covariance.T) / 2)
