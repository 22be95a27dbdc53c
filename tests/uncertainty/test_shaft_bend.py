"""A bow that all poses share is told from bows that point anywhere."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from pivometer.cameras import Camera, Rig
from pivometer.geometry import RigidTransform
from pivometer.uncertainty.shaft_bend import shaft_bend

RCM_MM = np.array([6.0, 65.0, 478.0])
LENGTH_MM, SIGMA_PX = 150.0, 0.02


def looking_at(centre):
    z = (RCM_MM - centre) / np.linalg.norm(RCM_MM - centre)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    return RigidTransform(np.stack([x, np.cross(z, x), z], axis=1), centre)


RIG = Rig(
    [Camera(name, 640, 480, [1000, 1000], [320, 240], [0, 0]) for name in ("left", "right")],
    [RigidTransform.identity(), looking_at([420.0, 10.0, 320.0])],
)


def directions(rng, count):
    tilt, turn = np.radians(28) * np.sqrt(rng.random(count)), 2 * np.pi * rng.random(count)
    return np.stack(
        [np.sin(tilt) * np.cos(turn), -np.cos(tilt), np.sin(tilt) * np.sin(turn)], axis=1
    )


def pose(rng, axis, bow_mm):
    """What both cameras state of a thin shaft of that bow in the sense of the frame's x axis."""
    across = np.array([1.0, 0.0, 0.0]) - axis[0] * axis
    bow = bow_mm * across / np.linalg.norm(across)
    middle = RCM_MM + axis * LENGTH_MM / 2
    seen = []
    for camera, transform in zip(RIG.cameras, RIG.reference_from_camera, strict=True):
        back = transform.inverse()
        ends = np.stack([back @ (middle + s * axis * LENGTH_MM / 2) for s in (-1, 1)])
        along = np.linspace(0, 1, 9)[:, None]
        track = camera.project(ends[0] + along * (ends[1] - ends[0]))
        straight = camera.project((ends[0] + ends[1])[None] / 2)[0]
        off = camera.project((back @ (middle + bow))[None])[0] - straight
        plane = np.cross(ends[0], ends[1])
        plane /= np.linalg.norm(plane)
        outward = plane[:2] / np.linalg.norm(plane[:2])
        size = off @ outward + SIGMA_PX * rng.normal()
        seen.append(
            SimpleNamespace(
                camera=camera.name,
                points_px=np.stack([track + 10 * outward, track - 10 * outward]),
                normals=np.stack([plane, -plane]),
                curvature_px=np.array([size, -size]),
                curvature_sigma_px=np.full(2, SIGMA_PX),
            )
        )
    return seen


def found(rng, bow_mm, count=20, **options):
    axes = directions(rng, count)
    fits = SimpleNamespace(directions=axes, points_mm=np.tile(RCM_MM, (count, 1)))
    edges = [pose(rng, axis, bow_mm) for axis in axes]
    return shaft_bend(edges, RIG, SimpleNamespace(fits=fits), **options)


def test_a_bent_shaft_is_told_with_its_bow():
    bend = found(np.random.default_rng(1), 0.2)
    assert bend.significant
    # The roll of the made-up shaft differs from the least turn by up to 2 % of the bow.
    assert bend.sagitta_mm == pytest.approx(0.2, abs=0.01 + 4 * bend.u_mm)
    assert bend.length_mm == pytest.approx(LENGTH_MM, rel=0.05)


def test_chance_tells_a_bend_as_often_as_stated():
    rng = np.random.default_rng(2)
    told = sum(found(rng, 0.0, 10, chance=0.05).significant for _ in range(80))
    low, high = stats.binom(80, 0.05).ppf([1e-4, 1 - 1e-4])
    assert low <= told <= high


def test_of_few_poses_nothing_is_said():
    assert found(np.random.default_rng(3), 0.2, 4) is None
