"""What a measurement does where edges, cameras and one cylinder do not fit together."""

from dataclasses import replace

import numpy as np
import pytest

from pivometer.cameras import Camera, Rig
from pivometer.errors import CalibrationError
from pivometer.geometry import RigidTransform, tangent_plane_normals
from pivometer.measurement import ImportedRig, PoseCylinder, RejectedPose, ShaftAgreement
from pivometer.pipeline.shaft_checking import (
    Triangulated,
    checked_poses,
    shaft_findings,
    with_shaft,
)
from pivometer.shaft.edges import ShaftEdges
from pivometer.shaft.fitting.mosaic_edges import ADVICE, WARNING
from pivometer.shaft.triangulation import triangulate_centerline
from pivometer.uncertainty.shaft_bend import ShaftBend
from pivometer.uncertainty.shaft_check import MoveTest, ShaftDiameter

RCM_MM = np.array([6.0, 65.0, 478.0])
SIGMA_PX, FOCAL_PX, LENGTH_MM = 0.02, 1000.0, 160.0


def looking_at(centre):
    z = (RCM_MM - centre) / np.linalg.norm(RCM_MM - centre)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    return RigidTransform(np.stack([x, np.cross(z, x), z], axis=1), centre)


NAMES = ("left", "right", "third")
RIG = Rig(
    [Camera(name, 640, 480, [FOCAL_PX] * 2, [320, 240], [0, 0]) for name in NAMES],
    [
        RigidTransform.identity(),
        looking_at([420.0, 10.0, 320.0]),
        looking_at([50.0, -390.0, 400.0]),
    ],
)


def edges(rng, camera, transform, axis, diameter_mm):
    """The edges that a camera sees of a shaft through the RCM, with noise and its covariance."""
    back = transform.inverse()
    point, seen = back @ RCM_MM, back.rotate(axis)
    planes = tangent_plane_normals(point, seen, diameter_mm / 2)
    normals, tracks, covariance = np.zeros((2, 3)), np.zeros((2, 9, 2)), np.zeros((6, 6))
    for e, plane in enumerate(planes):
        feet = np.stack([x - (x @ plane) * plane for x in (point, point + seen * LENGTH_MM)])
        ray = feet.mean(axis=0) / np.linalg.norm(feet.mean(axis=0))
        roots = np.stack([ray, np.sqrt(12) * np.cross(plane, ray) / 0.35], axis=1)
        roots = roots * SIGMA_PX / FOCAL_PX
        normal = plane + roots @ rng.normal(size=2)
        normals[e] = normal / np.linalg.norm(normal)
        ends = np.stack([x - (x @ normals[e]) * normals[e] for x in feet])
        along = np.linspace(0, 1, 9)[:, None]
        tracks[e] = camera.project(ends[0] + along * (ends[1] - ends[0]))
        covariance[3 * e : 3 * e + 3, 3 * e : 3 * e + 3] = roots @ roots.T
    return ShaftEdges(
        camera.name, tracks, normals, covariance, [SIGMA_PX] * 2, [1e-4] * 2, 20.0, [100.0] * 2,
        0.8, 0.1, [1.0, 1.0],
    )  # fmt: skip


def poses(rng, true, *, diameters=None, seen=None):
    """One pose for each rig of `true`; `diameters` and `seen` by (pose, camera) where unusual."""
    lines = []
    for number, rig in enumerate(true):
        tilt, turn = np.radians(28) * np.sqrt(rng.random()), 2 * np.pi * rng.random()
        axis = [np.sin(tilt) * np.cos(turn), -np.cos(tilt), np.sin(tilt) * np.sin(turn)]
        found = tuple(
            edges(rng, camera, transform, np.array(axis), (diameters or {}).get((number, k), 10.0))
            for k, (camera, transform) in enumerate(
                zip(rig.cameras, rig.reference_from_camera, strict=True)
            )
            if (number, k) not in (seen or ())
        )
        line = triangulate_centerline(
            np.stack([one.normals for one in found]),
            [RIG.reference_from_camera[NAMES.index(one.camera)] for one in found],
            covariances=np.stack([one.normals_covariance for one in found]),
        )
        lines.append(Triangulated(f"{number:03d}", line, found))
    return lines


def rig_of(count):
    return Rig(RIG.cameras[:count], RIG.reference_from_camera[:count])


def imported(count):
    return ImportedRig(rig_of(count), "opencv", {})


@pytest.mark.parametrize("cameras", [2, 3])
def test_another_rod_in_one_camera_rejects_that_pose_alone(cameras):
    lines = poses(
        np.random.default_rng(1),
        [rig_of(cameras)] * 14,
        diameters={(6, 1): 9.5},
        seen=() if cameras == 2 else {(3, 0), (9, 2)},
    )
    kept, check = checked_poses([*lines], imported(cameras), "paper")
    wrong = [pose.pose for pose in kept if isinstance(pose, RejectedPose)]
    assert wrong == ["006"]
    assert "do not belong to one cylinder" in kept[6].reason
    assert len(check.chi_squares) == 13
    assert kept[5] is lines[5]


def test_the_axes_of_the_cylinders_can_be_the_centerlines():
    lines = poses(np.random.default_rng(2), [rig_of(2)] * 8)
    kept, check = checked_poses([*lines], imported(2), "cylinder")
    for number, (pose, line) in enumerate(zip(kept, lines, strict=True)):
        assert np.allclose(pose.centerline.point_mm, check.fits.points_mm[number])
        assert pose.centerline.dihedral_rad == line.centerline.dihedral_rad
        # Both are good to a few hundredths of a millimetre.
        assert 0 < np.abs(pose.centerline.point_mm - line.centerline.point_mm).max() < 0.2


def test_more_poses_that_disagree_than_a_tenth_are_kept():
    diameters = {(number, 1): 9.3 for number in range(3, 30, 6)}
    lines = poses(np.random.default_rng(5), [rig_of(2)] * 30, diameters=diameters)
    kept, check = checked_poses([*lines], imported(2), "paper")
    assert (check.chi_squares > check.limits).sum() > 2
    assert not any(isinstance(pose, RejectedPose) for pose in kept)


def test_edges_of_no_common_cylinder_are_refused():
    rng = np.random.default_rng(6)
    diameters = {(number, 1): rng.uniform(9.0, 11.0) for number in range(20)}
    lines = poses(rng, [rig_of(2)] * 20, diameters=diameters)
    with pytest.raises(CalibrationError, match="not those of one cylinder") as caught:
        checked_poses([*lines], imported(2), "paper")
    assert "mirrored" in caught.value.next_step


def test_of_few_poses_nothing_is_judged():
    lines = poses(np.random.default_rng(3), [rig_of(2)] * 4)
    assert checked_poses([*lines], imported(2), "paper") == (lines, None)


def test_a_camera_that_moves_during_the_session_costs_no_pose_and_is_told():
    moved = rig_of(3).perturbed([0.0] * (len(rig_of(3).parameter_names) - 6) + [0.001] + [0] * 5)
    lines = poses(np.random.default_rng(4), [rig_of(3)] * 9 + [moved] * 9)
    kept, check = checked_poses([*lines], imported(3), "paper")
    assert not any(isinstance(pose, RejectedPose) for pose in kept)
    assert check.change.significant
    assert (check.change.camera, check.change.pose) == ("third", 9)


def agreement(**changes):
    still = MoveTest("", 0, 9.0, 28.0)
    diameter = ShaftDiameter(10.0, 0.01, 0.001, 0.01, 0.0001, 1.96, 0.02)
    return replace(ShaftAgreement("paper", diameter, 1.0, still, still, "000"), **changes)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({}, ""),
        ({"moved": MoveTest("", 0, 40.0, 28.0)}, "the cameras do not stand"),
        (
            {
                "moved": MoveTest("", 0, 40.0, 28.0),
                "change": MoveTest("third", 9, 90.0, 44.0),
                "change_from": "009",
            },
            "camera third moved during the session, near pose 009",
        ),
        ({"scatter": 2.5}, "2.5 times as far as their stated uncertainty"),
        ({"bend": ShaftBend(0.2, 0.01, 150.0, 90.0, 15.0)}, "over 150 mm it bows by 0.200 mm"),
        ({"bend": ShaftBend(0.01, 0.01, 150.0, 2.0, 15.0)}, ""),
    ],
)
def test_each_fault_is_told_in_its_own_words(make_measurement, changes, told):
    measurement = replace(make_measurement(count=8), shaft=agreement(**changes))
    findings = shaft_findings(measurement)
    assert len(findings) == bool(told)
    assert told in "".join(finding.text for finding in findings)


def test_inconsistent_poses_that_stay_are_named(make_measurement):
    measurement = make_measurement(count=8)
    wrong, *rest = measurement.used
    line = wrong.centerline
    cylinder = PoseCylinder(line.point_mm, line.direction, 0.5, 80.0, 30.0)
    poses = (replace(wrong, cylinder=cylinder), *rest)
    (finding,) = shaft_findings(replace(measurement, poses=poses, shaft=agreement()))
    assert "in 1 of 8 poses" in finding.text
    assert f"({wrong.pose})" in finding.text


def test_a_camera_of_raw_mosaics_is_named(make_measurement):
    measurement = make_measurement(count=8)
    first, *rest = measurement.used
    warned = (replace(first.edges[0], warnings=(f"{WARNING}; {ADVICE}",)), *first.edges[1:])
    poses = (replace(first, edges=warned), *rest)
    measurement = with_shaft(replace(measurement, poses=poses, findings=()), None, "paper")
    told = [finding.text for finding in measurement.findings if "mosaic" in finding.text]
    assert told == [f"camera {first.edges[0].camera}: {WARNING}"]
