"""Rigid transforms named by the frames they connect: ``x_left = left_from_right @ x_right``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import overload

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats, checked, read_only
from pivometer.errors import ShapeError


@dataclass(frozen=True, slots=True, eq=False)
class RigidTransform:
    """A rotation followed by a translation.

    A variable is named after the frames it connects, target first: with ``left_from_right``,
    ``x_left = left_from_right @ x_right``, so adjacent frames match in a chain. The paper's
    ``(R, t)`` of eq. (13) is ``left_from_right``; OpenCV's and Bouguet's stereo ``R, T`` is
    ``right_from_left``, its inverse.

    Parameters
    ----------
    rotation
        Rotation matrix, shape (3, 3).
    translation_mm
        Translation, shape (3,), mm.

    Raises
    ------
    ShapeError
        If the matrix is not a rotation to 1e-6.

    Examples
    --------
    >>> a_from_b = RigidTransform.from_rotation_vector([0, 0, np.pi / 2], [1, 0, 0])
    >>> np.round(a_from_b @ [1.0, 0.0, 0.0], 12)
    array([1., 1., 0.])
    >>> np.round(a_from_b.inverse() @ (a_from_b @ [1.0, 2.0, 3.0]), 12)
    array([1., 2., 3.])
    """

    rotation: Floats
    translation_mm: Floats

    def __post_init__(self) -> None:
        rotation = checked(self.rotation, (3, 3), "rotation")
        translation = checked(self.translation_mm, (3,), "translation_mm")
        defect = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
        if defect > 1e-6 or np.linalg.det(rotation) < 0:
            raise ShapeError(
                f"rotation is not a rotation matrix: |R Rᵀ − 1| is {defect:.1e}, its determinant "
                f"{np.linalg.det(rotation):+.3f}",
                next_step="pass an orthonormal matrix with determinant +1",
            )
        object.__setattr__(self, "rotation", read_only(rotation))
        object.__setattr__(self, "translation_mm", read_only(translation))

    @classmethod
    def identity(cls) -> RigidTransform:
        """Return the transform that changes nothing."""
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def from_rotation_vector(
        cls, rotation_vector_rad: ArrayLike, translation_mm: ArrayLike
    ) -> RigidTransform:
        """Build a transform from a rotation vector (axis times angle, rad) and a translation (mm).

        References
        ----------
        Rodrigues' formula; the paper's reference [14], section 2.3.
        """
        vector = checked(rotation_vector_rad, (3,), "rotation_vector_rad")
        return cls(rotation_from_vector(vector), checked(translation_mm, (3,), "translation_mm"))

    def rotation_vector_rad(self) -> Floats:
        """Return axis times angle, shape (3,), rad, the angle in [0, π]."""
        return vector_from_rotation(self.rotation)

    def inverse(self) -> RigidTransform:
        """Return the transform that undoes this one."""
        return RigidTransform(self.rotation.T, -self.rotation.T @ self.translation_mm)

    def rotate(self, vectors: ArrayLike) -> Floats:
        """Rotate directions or normals, shape (..., 3), without translating them."""
        rotated: Floats = checked(vectors, (-1, 3), "vectors") @ self.rotation.T
        return rotated

    @overload
    def __matmul__(self, other: RigidTransform) -> RigidTransform: ...
    @overload
    def __matmul__(self, other: ArrayLike) -> Floats: ...
    def __matmul__(self, other: RigidTransform | ArrayLike) -> RigidTransform | Floats:
        """Compose with another transform, or map points of shape (..., 3), mm."""
        if isinstance(other, RigidTransform):
            return RigidTransform(
                self.rotation @ other.rotation,
                self.rotation @ other.translation_mm + self.translation_mm,
            )
        points: Floats = checked(other, (-1, 3), "points") @ self.rotation.T + self.translation_mm
        return points


def rotation_from_vector(rotation_vector_rad: ArrayLike) -> Floats:
    """Return the rotation matrices, shape (..., 3, 3), of rotation vectors of shape (..., 3), rad.

    References
    ----------
    Rodrigues' formula, in the form that stays exact for small angles.

    Examples
    --------
    >>> np.round(rotation_from_vector([0.0, 0.0, np.pi / 2]), 12)
    array([[ 0., -1.,  0.],
           [ 1.,  0.,  0.],
           [ 0.,  0.,  1.]])
    """
    vector = checked(rotation_vector_rad, (-1, 3), "rotation_vector_rad")
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    cross = cross_matrix(vector)
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    rotation: Floats = np.eye(3) + first * cross + second * (cross @ cross)
    return rotation


def vector_from_rotation(rotation: ArrayLike) -> Floats:
    """Return the rotation vector, shape (3,), rad, of one rotation matrix of shape (3, 3).

    Works through the unit quaternion, so it is exact near 0 and near π.

    Examples
    --------
    >>> np.round(vector_from_rotation(np.diag([1.0, -1.0, -1.0])), 12)
    array([3.14159265, 0.        , 0.        ])
    """
    R = checked(rotation, (3, 3), "rotation")
    squares = np.array([1 + R.trace(), *(1 + 2 * np.diag(R) - R.trace())])
    largest = int(np.argmax(squares))
    skew = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    if largest == 0:
        quaternion = np.array([squares[0], *skew])
    else:
        axis = largest - 1
        quaternion = np.array([skew[axis], *(R[axis] + R[:, axis])])
        quaternion[largest] = squares[largest]
    quaternion /= np.linalg.norm(quaternion)
    if quaternion[0] < 0:
        quaternion = -quaternion
    sine = float(np.linalg.norm(quaternion[1:]))
    scale = 2.0 if sine < 1e-12 else 2 * np.arctan2(sine, quaternion[0]) / sine
    vector: Floats = scale * quaternion[1:]
    return vector


def cross_matrix(vectors: ArrayLike) -> Floats:
    """Return the matrices, shape (..., 3, 3), with ``cross_matrix(a) @ b == np.cross(a, b)``.

    Examples
    --------
    >>> cross_matrix([1.0, 2.0, 3.0]) @ [0.0, 0.0, 1.0]
    array([ 2., -1.,  0.])
    """
    x, y, z = np.moveaxis(checked(vectors, (-1, 3), "vectors"), -1, 0)
    matrices = np.zeros((*x.shape, 3, 3))
    matrices[..., 2, 1], matrices[..., 0, 2], matrices[..., 1, 0] = x, y, z
    matrices[..., 1, 2], matrices[..., 2, 0], matrices[..., 0, 1] = -x, -y, -z
    return matrices
