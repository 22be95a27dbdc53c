"""What the residuals do not show: narrow cones, one joint, static and repeated poses."""

import numpy as np
import pytest

from pivometer.rcm import cone_deg, geometry_findings, solve
from pivometer.rcm.geometry_check import equivalent_cone_deg
from pivometer.simulation.robots import cone_directions


def findings(points, axes):
    return geometry_findings(points, axes, solve(points, axes))


def texts(points, axes, severity=None):
    return [
        finding.text
        for finding in findings(points, axes)
        if severity is None or finding.severity == severity
    ]


def test_the_paper_geometry_has_no_findings(gold):
    assert findings(*gold()) == ()


def test_a_two_degree_cone_is_refused_a_fifteen_degree_cone_flagged(gold):
    refused = findings(*gold(apex_deg=2.0))[0]
    assert refused.severity == "refusal"
    assert "cone of only" in refused.text
    assert "20°" in refused.next_step
    flagged = findings(*gold(apex_deg=15.0))
    assert [finding.severity for finding in flagged] == ["warning"]
    assert texts(*gold(apex_deg=25.0)) == []


def test_a_static_tool_is_refused(gold):
    points, axes = gold(apex_deg=0.2)
    assert texts(points, axes, "refusal")


@pytest.mark.parametrize("tilt_deg", [90.0, 60.0, 35.0])
@pytest.mark.parametrize("sweep_deg", [30.0, 60.0, 120.0])
def test_a_sweep_of_one_joint_is_flagged_though_its_residual_is_small(tilt_deg, sweep_deg):
    random = np.random.default_rng(4)
    turn = np.radians(np.linspace(0, sweep_deg, 70))
    tilt = np.radians(tilt_deg) + np.radians(0.05) * random.standard_normal(70)
    axes = np.stack(
        [np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)], axis=1
    )
    points = [0, 0, 104] + 0.1 * random.standard_normal((70, 3))  # 104 mm from where it should be
    rcm = solve(points, axes)
    assert rcm.least_squares.rms_mm < 0.2
    assert any("only one joint moves" in text for text in texts(points, axes))


def test_two_joints_are_not_taken_for_one(gold):
    first, second = np.meshgrid(np.radians(np.linspace(-30, 30, 9)), np.radians([-5, 0, 5]))
    axes = np.stack(
        [np.sin(first), np.sin(second) * np.cos(first), np.cos(second) * np.cos(first)], axis=-1
    ).reshape(-1, 3)
    points = 0.1 * np.random.default_rng(0).standard_normal(axes.shape)
    assert texts(points, axes) == []


def test_repeated_poses_are_counted(gold):
    points, axes = gold(30)
    doubled = np.vstack([points, points + 5 * axes]), np.vstack([axes, -axes])
    assert any("30 of 60 poses repeat" in text for text in texts(*doubled))


def test_few_poses_are_mentioned(gold):
    assert texts(*gold(12)) == ["only 12 poses"]


@pytest.mark.parametrize("apex_deg", [0.1, 5.0, 57.0, 90.0])
def test_cone_of_a_ring_is_its_apex_angle_whatever_signs_and_lengths(apex_deg):
    random = np.random.default_rng(2)
    turn = np.arange(9) * 2 * np.pi / 9
    ring = np.stack(
        [np.cos(turn), np.sin(turn), np.full(9, 1 / np.tan(np.radians(apex_deg / 2)))], axis=1
    )
    ring = np.vstack([ring, [[0.0, 0.0, 1.0]] * 40])
    ring *= random.choice([-1, 1], (49, 1)) * random.uniform(0.1, 10, (49, 1))
    rotation = np.linalg.qr(random.standard_normal((3, 3)))[0]
    assert cone_deg(ring @ rotation.T) == pytest.approx(apex_deg, rel=1e-9)


def test_cone_of_lines_in_all_directions_is_at_most_a_half_space():
    axes = np.random.default_rng(0).standard_normal((500, 3))
    assert 150 < cone_deg(axes) <= 180
    assert cone_deg(np.eye(3)) == pytest.approx(2 * np.degrees(np.arccos(np.sqrt(1 / 3))))


def test_cone_holds_all_directions_of_large_sets():
    random = np.random.default_rng(1)
    axes = random.standard_normal((100_000, 3)) * [0.1, 0.1, 0] + [0, 0, 1]
    assert cone_deg(axes) >= 2 * np.degrees(np.arctan(np.hypot(axes[:, 0], axes[:, 1]).max())) * 0.9


def test_a_cone_that_one_pose_alone_makes_wide_is_named():
    tilts = np.radians([15.0, -15.0] + [0.3] * 38)
    turns = np.where(np.arange(40) < 2, 0.0, np.arange(40) * 2.4)
    axes = np.stack(
        [np.sin(tilts) * np.cos(turns), np.sin(tilts) * np.sin(turns), np.cos(tilts)], axis=1
    )
    finding = findings(np.random.default_rng(0).normal(0, 0.01, (40, 3)), axes)[0]
    assert finding.severity == "warning"
    assert finding.text.startswith("only few poses tilt the shaft")
    assert "poses to add" in finding.next_step


def test_the_equivalent_cone_of_a_filled_cone_is_that_cone():
    for apex in (5.0, 20.0, 57.0, 90.0):
        axes = cone_directions(4000, apex)
        assert equivalent_cone_deg(axes) == pytest.approx(apex, rel=1e-3)
