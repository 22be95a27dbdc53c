"""What a session says of its poses reaches the result; a jump half-way is a warning."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from pivometer.io.joints import PoseTable
from pivometer.measurement import UsedPose
from pivometer.pipeline.line_errors import line_errors
from pivometer.pipeline.structuring import with_structure
from pivometer.rcm import outlier_findings


def moved_on(pose, shift):
    if not isinstance(pose, UsedPose):
        return pose
    line = replace(pose.centerline, point_mm=np.add(pose.centerline.point_mm, shift))
    return replace(pose, centerline=line)


def test_a_jump_half_way_is_a_warning(make_measurement):
    measurement, shift = make_measurement(miss_mm=0.05), np.array([0.6, 0, 0])
    half = len(measurement.poses) // 2
    after = [moved_on(pose, shift) for pose in measurement.poses[half:]]
    jumped = replace(measurement, poses=(*measurement.poses[:half], *after))
    told = with_structure(jumped, SimpleNamespace(pose_table=None), line_errors(jumped))
    (finding,) = (f for f in told.findings if "moved during the session" in f.text)
    assert finding.severity == "warning"
    assert "jumps by" in finding.text
    (pattern,) = (p for p in told.structure.found if p.kind == "order")
    assert (np.abs(pattern.shift_mm - shift) < 4 * pattern.shift_u_mm).all()
    before = with_structure(measurement, SimpleNamespace(pose_table=None), line_errors(measurement))
    assert before.findings == measurement.findings


def test_what_the_session_says_of_its_poses_is_in_the_result(make_measurement):
    measurement = make_measurement()
    names = [pose.pose for pose in measurement.poses]
    rows = np.random.default_rng(0).permutation(len(names))
    shuffled = tuple(names[k] for k in rows)
    table = PoseTable(shuffled, rows * 10.0, ("+",) * len(rows), {"q1_deg": 1.0 * rows}, "ab")
    told = with_structure(measurement, SimpleNamespace(pose_table=table), line_errors(measurement))
    assert told.inputs["poses.csv"] == "ab"
    place = [names.index(pose) for pose in told.structure.poses]
    np.testing.assert_array_equal(told.structure.times_s, np.multiply(place, 10.0))
    np.testing.assert_array_equal(told.structure.joints["q1_deg"], place)
    kinds = {pattern.kind for pattern in told.structure.patterns}
    assert kinds == {"direction", "order", "joint"}  # one side of approach is none to compare


def test_a_wrong_edge_is_named_but_not_an_error_that_follows_the_direction(make_measurement):
    """Both make a few poses miss by far more than the rest; only one is a mistake."""
    measurement = make_measurement(miss_mm=0.02)

    def told(poses):
        changed = replace(measurement, poses=poses)
        after = with_structure(changed, SimpleNamespace(pose_table=None), line_errors(changed))
        return [f.text for f in after.findings if "far more than the rest" in f.text]

    poses = measurement.poses
    number = next(i for i, pose in enumerate(poses) if isinstance(pose, UsedPose))
    wrong = moved_on(poses[number], np.array([3.0, 0, 0]))
    (text,) = told((*poses[:number], wrong, *poses[number + 1 :]))
    assert poses[number].pose in text

    directions = np.stack([pose.centerline.direction for pose in measurement.used])
    mean = directions.mean(axis=0)
    x = np.cross(mean, [0.0, 0.0, 1.0])
    y = np.cross(mean, x)

    def bent(pose, size=60.0):  # nearly nothing but where the shaft is tilted far to one side
        if not isinstance(pose, UsedPose):
            return pose
        tilted = pose.centerline.direction
        return moved_on(pose, size * (tilted @ x) ** 3 * y)

    regular = tuple(map(bent, poses))
    lines = [pose.centerline for pose in regular if isinstance(pose, UsedPose)]
    points = [line.point_mm for line in lines]
    assert outlier_findings([str(i) for i in range(len(lines))], points, directions)
    assert told(regular) == []
