"""Robots: exact when free of errors, and as wrong as their errors say."""

from dataclasses import replace

import numpy as np
import pytest

from pivometer.errors import UsageError
from pivometer.simulation.presets import davinci, micro, small_arm
from pivometer.simulation.robots import DoubleParallelogram, SphericalBearing, cone_directions

DIRECTIONS = cone_directions(70, 57.0)


def misses(motion):
    """Distances of the lines from their least-squares point, mm."""
    across = np.eye(3) - motion.directions[:, :, None] * motion.directions[:, None, :]
    point = np.linalg.solve(across.sum(0), np.einsum("nij,nj->i", across, motion.points_mm))
    return np.linalg.norm(np.einsum("nij,nj->ni", across, motion.points_mm - point), axis=1)


def test_cone_is_evenly_filled_and_exactly_as_wide():
    angle = np.degrees(np.arccos(DIRECTIONS[:, 2]))
    assert angle[0] == 0
    assert angle[-1] == pytest.approx(28.5)
    assert np.allclose(np.linalg.norm(DIRECTIONS, axis=1), 1)
    # Equal solid angles: heights are evenly spaced.
    assert np.allclose(np.diff(DIRECTIONS[:, 2], 2), 0)
    gaps = np.arccos((DIRECTIONS @ DIRECTIONS.T - 2 * np.eye(70)).max(axis=1).clip(-1, 1))
    assert gaps.max() < 2.0 * gaps.min()


@pytest.mark.parametrize(
    "robot", [SphericalBearing(0.0), DoubleParallelogram(), small_arm(1.0, 100.0, np.zeros(6))]
)
def test_perfect_robots_pivot_exactly(robot):
    motion = robot.move(DIRECTIONS, np.random.default_rng(0))
    assert np.abs(motion.points_mm).max() < 1e-9
    assert np.allclose(motion.directions, DIRECTIONS, atol=1e-9)
    assert len(motion.joint_names) == motion.joints.shape[1]


def test_bearing_offsets_have_the_stated_size():
    directions = cone_directions(4000, 57.0)
    motion = SphericalBearing(0.02).move(directions, np.random.default_rng(3))
    distance = np.linalg.norm(motion.points_mm, axis=1)
    # Two directions of 0.02 mm each; the relative error of the mean square is 1/sqrt(n).
    assert (distance**2).mean() == pytest.approx(2 * 0.02**2, rel=4 / np.sqrt(4000))


def test_davinci_like_arm_misses_as_the_paper_measured():
    distance = misses(davinci().robot.move(DIRECTIONS, np.random.default_rng(0)))
    assert np.sqrt((distance**2).mean()) == pytest.approx(3.0, abs=0.05)
    assert distance.max() == pytest.approx(7.0, abs=0.15)


def test_small_errors_act_in_proportion():
    errors = np.array([0.3, -0.2, 0.1, 0.4, -0.3, 0.2, 0.1, -0.2])
    rms = [
        np.sqrt(
            (
                misses(DoubleParallelogram(length_errors_mm=s * errors).move(DIRECTIONS, None)) ** 2
            ).mean()
        )
        for s in (0.01, 0.02)
    ]
    assert rms[1] / rms[0] == pytest.approx(2, rel=1e-3)


def test_software_rcm_commands_the_design_and_misses_by_its_joint_offsets():
    setup = micro()
    arm = setup.robot
    motion = arm.move(DIRECTIONS, np.random.default_rng(0))
    nominal = [replace(arm, joint_offsets_rad=np.zeros(6)).flange(q) for q in motion.joints]
    for flange, direction in zip(nominal, DIRECTIONS, strict=True):
        assert np.allclose(flange @ [0, 0, arm.insertion_mm], 0, atol=1e-9)
        assert np.allclose(-flange.rotation[:, 2], direction, atol=1e-9)
    distance = misses(motion)
    assert 0.01 < np.sqrt((distance**2).mean()) < 0.06


def test_arm_says_what_it_cannot_reach():
    with pytest.raises(UsageError, match="does not reach"):
        small_arm(0.05, 300.0, np.zeros(6)).joints_for([0, 0, 1])


def test_empty_cone_is_refused():
    with pytest.raises(UsageError, match="0 poses"):
        cone_directions(0, 57.0)
