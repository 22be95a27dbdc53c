"""What all formats share: lengths in mm, rotations that are rotations, models, refusals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats
from pivometer.cameras import Camera, Rig
from pivometer.cameras.distortion import COEFFICIENTS, MODELS
from pivometer.errors import UsageError
from pivometer.geometry.rigid import RigidTransform

MM_PER_UNIT = {
    "mm": 1.0, "millimeters": 1.0, "millimetres": 1.0, "m": 1000.0, "meters": 1000.0,
    "metres": 1000.0, "cm": 10.0, "centimeters": 10.0, "inches": 25.4, "in": 25.4,
}  # fmt: skip
ROUNDED = 1e-3
"""Rotation matrices printed with six digits are orthonormal to 1e-6; ten times three digits."""


@dataclass(frozen=True, slots=True)
class Told:
    """What the user says of a file that does not say it itself.

    Parameters
    ----------
    unit_mm
        Length of the file's unit, mm: 1000 for metres, or the side of a square, mm, where the
        calibration counted squares; `None` where it was not told.
    image_size
        Width and height, px; `None` where it was not told.
    """

    unit_mm: float | None = None
    image_size: tuple[int, int] | None = None


def unreadable(what: str, *, next_step: str = "name a whole, undamaged file") -> UsageError:
    """Return the error of a file that is not a rig; who calls adds the path."""
    return UsageError(what, next_step=next_step)


def inexpressible(file_format: str, what: str, others: str) -> UsageError:
    """Return the error of a rig that a format cannot carry."""
    return UsageError(f"{file_format} cannot carry {what}", next_step=f"export to {others}")


def unit_in_mm(stated: str | None, told: Told) -> float:
    """Return the length of a file's unit, mm: as stated in it, or as the user told."""
    if stated is None and told.unit_mm is None:
        raise unreadable(
            "states no unit of length",
            next_step="add --unit-mm: 1 for mm, 1000 for metres, or the side of a square in mm "
            "where the calibration counted squares",
        )
    if stated is None:
        return float(told.unit_mm or 0.0)
    if stated.lower() not in MM_PER_UNIT:
        raise unreadable(f"states lengths in {stated!r}", next_step="use mm or m")
    if told.unit_mm is not None and told.unit_mm != MM_PER_UNIT[stated.lower()]:
        raise unreadable(
            f"states lengths in {stated}, not in units of {told.unit_mm:g} mm",
            next_step="leave out --unit-mm",
        )
    return MM_PER_UNIT[stated.lower()]


def size_in_px(stated: Sequence[float] | None, told: Told) -> tuple[int, int]:
    """Return width and height, px: as stated in the file, or as the user told."""
    if stated is not None:
        return int(stated[0]), int(stated[1])
    if told.image_size is None:
        raise unreadable(
            "states no image size",
            next_step="add --image-size WIDTH HEIGHT",
        )
    return told.image_size


def calibration_matrix(fx: float, fy: float, ox: float, oy: float) -> Floats:
    """Return K of (17), shape (3, 3), px."""
    return np.array([[fx, 0.0, ox], [0.0, fy, oy], [0.0, 0.0, 1.0]])


def camera_from(
    name: str, size: tuple[int, int], matrix: ArrayLike, coefficients: ArrayLike
) -> Camera:
    """Return a camera from K, shape (3, 3), px, and coefficients in OpenCV's order.

    The model is the narrowest that has all coefficients that are not zero.

    Raises
    ------
    UsageError
        If K has a skew, or coefficients beyond the eighth (thin prism, tilt) are not zero.
    """
    K = np.asarray(matrix, dtype=np.float64)
    if K.shape != (3, 3) or np.abs(K[[0, 1, 2, 2], [1, 0, 0, 1]]).max() > 0 or K[2, 2] != 1:
        raise unreadable(
            f"camera {name}: its calibration matrix {K.round(3).tolist()} is not one of "
            "rectangular pixels",
            next_step="calibrate without skew",
        )
    values = np.trim_zeros(np.ravel(np.asarray(coefficients, dtype=np.float64)), "b")
    if len(values) > len(COEFFICIENTS):
        raise unreadable(
            f"camera {name}: it has thin prism or tilt coefficients, {len(values)} in all; "
            f"Pivometer knows the {len(COEFFICIENTS)} of the rational model",
            next_step="calibrate with the rational model or a narrower one",
        )
    count = min(length for length in MODELS.values() if length >= len(values))
    lens = np.concatenate([values, np.zeros(count - len(values))])
    return Camera(name, *size, K[[0, 1], [0, 1]], K[:2, 2], lens)


def transform_from(rotation: ArrayLike, translation: ArrayLike, unit_mm: float) -> RigidTransform:
    """Return a transform from a rotation matrix as printed and a translation in a file's unit."""
    R = np.asarray(rotation, dtype=np.float64).reshape(3, 3)
    defect = float(np.abs(R @ R.T - np.eye(3)).max())
    if not (np.linalg.det(R) > 0 and defect < ROUNDED):
        raise unreadable(f"a rotation matrix is none: |R Rᵀ − 1| is {defect:.1e}")
    if defect > 1e-9:
        left, _, right = np.linalg.svd(R)
        R = left @ right
    return RigidTransform(R, np.ravel(np.asarray(translation, dtype=np.float64)) * unit_mm)


def rig_from(cameras: Sequence[Camera], camera_from_world: Sequence[RigidTransform]) -> Rig:
    """Return the rig of cameras whose poses are given in any common frame, the first as reference.

    Raises
    ------
    UsageError
        If there are fewer than two cameras.
    """
    if len(cameras) < 2:
        raise unreadable(
            f"holds {len(cameras)} camera, a rig needs two with their poses",
            next_step="name a calibration of all cameras, or the folder with the files of all",
        )
    first = camera_from_world[0]
    others = [first @ pose.inverse() for pose in camera_from_world[1:]]
    return Rig(cameras, [RigidTransform.identity(), *others])


def require_two(rig: Rig, file_format: str) -> RigidTransform:
    """Return OpenCV's R, T of a rig of two cameras: ``right_from_left``."""
    if len(rig.cameras) != 2:
        raise inexpressible(
            file_format, f"{len(rig.cameras)} cameras, only two", "kalibr, colmap or mrcal"
        )
    return rig.reference_from_camera[1].inverse()


def brown_coefficients(camera: Camera, file_format: str) -> Floats:
    """Return k₁ k₂ p₁ p₂ k₃ of a camera, for formats that have no more.

    Raises
    ------
    UsageError
        If the camera has the rational model.
    """
    if len(camera.distortion) > MODELS["brown5"] and camera.distortion[5:].any():
        raise inexpressible(
            file_format,
            f"the rational distortion of camera {camera.name}",
            "opencv, ros, colmap or mrcal",
        )
    return padded(camera, MODELS["brown5"])


def padded(camera: Camera, count: int) -> Floats:
    """Return the first `count` coefficients of a camera, those it lacks being zero."""
    lens = np.zeros(max(count, len(camera.distortion)))
    lens[: len(camera.distortion)] = camera.distortion
    return lens[:count]
