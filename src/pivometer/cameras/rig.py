"""Several cameras that stand still, in the frame of one of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats, checked
from pivometer.cameras.model import Camera
from pivometer.errors import ShapeError
from pivometer.geometry.rigid import RigidTransform, rotation_from_vector


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """N ≥ 2 calibrated cameras; the first is the reference, whose frame all results are in.

    Parameters
    ----------
    cameras
        The cameras, the reference first.
    reference_from_camera
        For each camera ``x_reference = reference_from_camera[i] @ x_camera``; the first is the
        identity. For two cameras the second is the paper's (R, t) of eq. (13).

    Raises
    ------
    ShapeError
        If there are fewer than two cameras, names repeat, or the first is not the reference.
    """

    cameras: tuple[Camera, ...]
    reference_from_camera: tuple[RigidTransform, ...]

    def __init__(
        self, cameras: Sequence[Camera], reference_from_camera: Sequence[RigidTransform]
    ) -> None:
        object.__setattr__(self, "cameras", tuple(cameras))
        object.__setattr__(self, "reference_from_camera", tuple(reference_from_camera))
        names = {camera.name for camera in cameras}
        counts = {len(names), len(cameras), len(reference_from_camera)}
        if len(cameras) < 2 or len(counts) > 1:
            raise ShapeError(
                f"a rig of {len(cameras)} cameras, {len(names)} names and "
                f"{len(reference_from_camera)} transforms",
                next_step="pass at least two cameras of different names, a transform for each",
            )
        first = self.reference_from_camera[0]
        if np.abs(first.rotation - np.eye(3)).max() + np.abs(first.translation_mm).max() > 0:
            raise ShapeError(
                "the first camera's transform is not the identity",
                next_step="put the reference camera first",
            )

    @property
    def reference(self) -> str:
        """The name of the reference camera."""
        return self.cameras[0].name

    @property
    def baselines_mm(self) -> Floats:
        """Distance of each further camera from the reference, ‖t‖, shape (n − 1,), mm."""
        centres = [transform.translation_mm for transform in self.reference_from_camera[1:]]
        distance: Floats = np.linalg.norm(np.array(centres), axis=1)
        return distance

    def index(self, name: str) -> int:
        """Return the position of the camera called `name`."""
        return [camera.name for camera in self.cameras].index(name)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the entries that `perturbed` takes and that a rig's covariance refers to.

        For each camera its `Camera.parameter_names`; then for each further camera a rotation
        vector (rad, applied on the left of its rotation) and a translation (mm) of
        ``reference_from_camera``.
        """
        pose = ("rx_rad", "ry_rad", "rz_rad", "tx_mm", "ty_mm", "tz_mm")
        return tuple(f"{c.name}.{p}" for c in self.cameras for p in c.parameter_names) + tuple(
            f"{c.name}.{p}" for c in self.cameras[1:] for p in pose
        )

    def perturbed(self, delta: ArrayLike) -> Rig:
        """Return the rig with `delta` added to its parameters, in `parameter_names`' order.

        Rotations are perturbed on the left: R ← exp([δ]×) R.
        """
        values = checked(delta, (len(self.parameter_names),), "delta")
        ends = np.cumsum([len(camera.parameters) for camera in self.cameras])
        *intrinsics, poses = np.split(values, ends)
        cameras = [
            camera.with_parameters(camera.parameters + step)
            for camera, step in zip(self.cameras, intrinsics, strict=True)
        ]
        transforms = [self.reference_from_camera[0]] + [
            RigidTransform(
                rotation_from_vector(step[:3]) @ transform.rotation,
                transform.translation_mm + step[3:],
            )
            for transform, step in zip(
                self.reference_from_camera[1:], poses.reshape(-1, 6), strict=True
            )
        ]
        return Rig(cameras, transforms)

    def difference(self, other: Rig) -> Floats:
        """Return the delta with ``self.perturbed(delta)`` equal to `other`."""
        intrinsics = [
            b.parameters - a.parameters for a, b in zip(self.cameras, other.cameras, strict=True)
        ]
        poses = []
        for a, b in zip(
            self.reference_from_camera[1:], other.reference_from_camera[1:], strict=True
        ):
            turn = RigidTransform(b.rotation @ a.rotation.T, np.zeros(3))
            poses += [turn.rotation_vector_rad(), b.translation_mm - a.translation_mm]
        return np.concatenate(intrinsics + poses)
