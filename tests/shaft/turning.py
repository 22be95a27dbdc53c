"""What two cameras see of cylinders that turn about points in space."""

import numpy as np

from pivometer.cameras import Camera, Rig
from pivometer.geometry import RigidTransform, tangent_plane_normals
from pivometer.shaft.finding.candidates import Candidate
from pivometer.shaft.finding.motion import Motion

SIZE = (640, 480)
CAMERAS = [Camera(name, *SIZE, [900, 900], [320, 240], [-0.1, 0.0]) for name in "ab"]
TURN = RigidTransform.from_rotation_vector([0.0, -0.24, 0.0], [110.0, 0.0, 10.0])
RIG = Rig(CAMERAS, [RigidTransform.identity(), TURN])
POSES = [{k: f"{k:03}" for k in range(12)}] * 2
PIVOT, ROD_PIVOT = np.array([0.0, 60.0, 450.0]), np.array([45.0, 55.0, 470.0])


def seen(
    pivot,
    diameter_mm,
    *,
    thing,
    seed,
    noise_px=0.5,
    support=1000.0,
    shift=0,
    reach_mm=(20.0, 120.0),
    beside_mm=0.0,
    miss_mm=0.0,
):
    """Return what each camera sees of a cylinder that turns about a point, or beside one that does.

    The same seed means the same tilts, misses and noise.
    """
    rng = np.random.default_rng(seed)
    tilts = rng.uniform(-0.4, 0.4, (12, 2))
    misses = miss_mm * np.random.default_rng([seed, 1]).normal(size=(12, 3))
    both = []
    for camera, place in zip(RIG.cameras, RIG.reference_from_camera, strict=True):
        camera_from_reference = place.inverse()
        edges = {}
        for k, tilt in enumerate(tilts):
            along = np.array([tilt[0], -1.0, tilt[1]]) / np.hypot(1, np.hypot(*tilt))
            aside = beside_mm * np.array([1.0, tilt[0], 0.0]) / np.hypot(1, tilt[0])
            point = camera_from_reference @ (pivot + misses[k] + aside)
            turned = camera_from_reference.rotate(along)
            normals = tangent_plane_normals(point, turned, diameter_mm / 2)
            axis = point + np.array(reach_mm)[:, None] * turned
            ends = np.stack([camera.project(axis + n * diameter_mm / 2) for n in normals])
            edges[(k + shift) % 12] = ends + rng.normal(0, noise_px, (2, 1, 1))
        depth = float((camera_from_reference @ pivot)[2])
        width = 900 * diameter_mm / depth
        motion = Motion(np.zeros(2), width, 5.0, 0.02, 100.0, 12)
        pixel = camera.project(camera_from_reference @ pivot)
        both.append(Candidate(motion, support, thing, edges, width, pixel))
    return both


def together(*things):
    """Return each camera's candidates."""
    return [[thing[camera] for thing in things] for camera in (0, 1)]
