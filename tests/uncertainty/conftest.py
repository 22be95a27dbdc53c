"""The paper's rig and gold standard, as exact edge points in raw pixels."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from pivometer.cameras import Camera, Rig
from pivometer.geometry import RigidTransform, tangent_plane_normals

RCM_MM = np.array([6.4, 65.7, 478.3])
RADIUS_MM = 5.0


@dataclass
class Edges:
    camera: str
    points_px: np.ndarray


@pytest.fixture
def rig() -> Rig:
    """Two cameras 90° apart with a baseline of 525.65 mm."""
    left = Camera("left", 640, 480, [1000, 1000], [320, 240], [-0.2, 0.1])
    right = Camera("right", 640, 480, [1010, 1008], [318, 243], [-0.18, 0.08])
    turn = RigidTransform.from_rotation_vector([0, -np.pi / 2, 0], [0, 0, 0]).rotation
    centre = 525.65 * np.array([np.sqrt(0.5), 0, np.sqrt(0.5)])
    return Rig([left, right], [RigidTransform.identity(), RigidTransform(turn, centre)])


@pytest.fixture
def rig_covariance(rig) -> np.ndarray:
    """A plausible calibration: 0.5 px, 0.01, 0.1 mrad and 0.05 mm, correlated at random."""
    sigma = np.array([0.5, 0.5, 0.5, 0.5, 0.002, 0.005] * 2 + [1e-4] * 3 + [0.05] * 3)
    mix = np.random.default_rng(0).standard_normal((18, 40))
    correlation = np.corrcoef(mix)
    return sigma[:, None] * correlation * sigma


@pytest.fixture
def view(rig) -> Callable[..., list[list[Edges]]]:
    """Edges of a shaft at many poses, as a rig sees them."""

    def make(count=20, *, miss_mm=0.0, noise_px=0.0, seed=0, points=40, rig=rig):
        random = np.random.default_rng(seed)
        tilt = np.radians(28.5) * np.sqrt(random.random(count))
        turn = 2 * np.pi * random.random(count)
        axes = np.stack(
            [np.sin(tilt) * np.cos(turn), -np.cos(tilt), np.sin(tilt) * np.sin(turn)], axis=1
        )
        through = RCM_MM + miss_mm * random.standard_normal((count, 3))
        along = np.linspace(60, 120, points)[:, None]
        return [
            [
                Edges(
                    camera.name,
                    edge_points(camera, to.inverse(), point, axis, along)
                    + noise_px * random.standard_normal((2, points, 2)),
                )
                for camera, to in zip(rig.cameras, rig.reference_from_camera, strict=True)
            ]
            for point, axis in zip(through, axes, strict=True)
        ]

    return make


def edge_points(camera, camera_from_reference, point, axis, along):
    """Where the tangent planes touch the cylinder: the axis moved by r along each normal."""
    base, direction = camera_from_reference @ point, camera_from_reference.rotate(axis)
    normals = tangent_plane_normals(base, direction, RADIUS_MM)
    return np.stack([camera.project(base + RADIUS_MM * n + along * direction) for n in normals])
