"""What the misses follow is found when it is there, and hardly ever when it is not."""

import numpy as np
import pytest
from scipy.stats import binom

from pivometer.geometry import RigidTransform
from pivometer.rcm import patterns
from pivometer.rcm.structure import ErrorStructure, error_structure
from pivometer.simulation.presets import preset_named
from pivometer.simulation.robots import SphericalBearing, cone_directions

SIGMA_MM = 0.02


@pytest.fixture(autouse=True)
def fewer_draws(monkeypatch):
    """The least p-value is then 1/2000: enough for ten tests at a level of 0.005."""
    monkeypatch.setattr(patterns, "DRAWS", 1999)


def noise(axes, rng) -> tuple[np.ndarray, np.ndarray]:
    """Return displacements of lines seen by two cameras 66° apart, and their covariances."""
    sight = np.array([[0.0, 0.3, 1.0], [-0.9, 0.3, 0.4]])
    normals = np.cross(axes[:, None], sight / np.linalg.norm(sight, axis=1, keepdims=True))
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    inverse = np.linalg.inv(np.concatenate([normals, axes[:, None]], axis=1))[:, :, :2]
    moved = np.einsum("nij,nj->ni", inverse, SIGMA_MM * rng.standard_normal((len(axes), 2)))
    return moved, SIGMA_MM**2 * inverse @ np.swapaxes(inverse, 1, 2)


def directions(count, rng) -> np.ndarray:
    """Return directions that fill a cone of 57° about y, in an order that follows nothing."""
    return rng.permutation(cone_directions(count, 57.0))[:, [0, 2, 1]]


def kinds(structure: ErrorStructure) -> set[str]:
    return {pattern.kind for pattern in structure.found}


def test_in_pure_noise_nothing_is_found_beyond_the_stated_rate():
    sessions, false = 200, 0
    rng = np.random.default_rng(1)
    for _ in range(sessions):
        axes = directions(20, rng)
        tilts = np.degrees(np.arctan2(axes[:, [0, 2]], axes[:, 1:2]))
        found = error_structure(
            noise(axes, rng)[0],
            axes,
            approach=[str(label) for label in rng.choice(["+", "-"], 20)],
            joints={"q1_deg": tilts[:, 0], "q2_deg": tilts[:, 1], "d3_mm": rng.uniform(0, 9, 20)},
        )
        assert len(found.patterns) == 6
        false += bool(found.found)
    assert false <= binom.ppf(0.999, sessions, 0.01)


@pytest.mark.parametrize("change", ["drift", "jump"])
def test_a_change_in_time_is_found_and_measured(change):
    rng, count, way = np.random.default_rng(2), 40, np.array([0.2, 0.0, -0.2])
    axes = directions(count, rng)
    when = np.arange(count) / (count - 1) if change == "drift" else np.arange(count) >= 20
    moved, covariances = noise(axes, rng)
    found = error_structure(moved + np.outer(when, way), axes, covariances_mm2=covariances)
    (pattern,) = (p for p in found.patterns if p.kind == "order")
    assert pattern.found
    assert (np.abs(pattern.shift_mm - way) < 4 * pattern.shift_u_mm).all()
    assert {"drift": "drifts by 0.2", "jump": "between poses 19 and 20"}[change] in pattern.text


def test_times_set_the_order():
    rng, count = np.random.default_rng(3), 40
    axes = directions(count, rng)
    times = rng.permutation(count) * 30.0
    points = noise(axes, rng)[0] + np.outer(times / times.max(), [0.2, 0, 0])
    (pattern,) = (p for p in error_structure(points, axes, times_s=times).found)
    assert "drifts by 0.2 mm over 40 poses and 19.5 min" in pattern.text
    assert kinds(error_structure(points, axes)) == set()


def test_hysteresis_is_found_beside_what_follows_the_direction():
    rng, count, way = np.random.default_rng(4), 40, np.array([0.12, 0, 0])
    axes = directions(count, rng)
    labels = rng.choice(["down", "up"], count)
    field = 0.5 * axes[:, [2, 0, 1]] * axes[:, :1]
    points = field + noise(axes, rng)[0] + np.outer(labels == "up", way)
    found = error_structure(points, axes, approach=list(labels))
    (pattern,) = (p for p in found.found if p.kind == "approach")
    assert (np.abs(pattern.shift_mm - way) < 4 * pattern.shift_u_mm).all()
    assert kinds(found) == {"direction", "approach"}


@pytest.mark.parametrize("name", ["davinci", "micro"])
def test_a_robots_own_error_follows_its_joints(name):
    preset, rng = preset_named(name), np.random.default_rng(5)
    motion = preset.robot.move(rng.permutation(cone_directions(40, 57.0)), rng)
    motion = motion.moved(preset.reference_from_robot)
    joints = dict(zip(motion.joint_names, motion.joints.T, strict=True))
    joints["idle_deg"] = rng.uniform(0, 90, 40)
    scale = 0.1 if name == "micro" else 1.0
    points = motion.points_mm - preset.reference_from_robot.translation_mm
    points = points + scale * noise(motion.directions, rng)[0]
    found = error_structure(points, motion.directions, joints=joints)
    (first, *_) = (p for p in found.found if p.kind == "joint")
    assert first.share > 0.6
    assert f"{100 * first.share:.0f} % of the variance of the misses" in first.text
    assert "idle_deg" not in {p.name for p in found.found}
    assert kinds(found) == {"direction", "joint"}


def test_a_joint_that_alone_is_wrong_is_told_from_the_others():
    rng, count = np.random.default_rng(6), 40
    axes = directions(count, rng)
    turn = rng.uniform(-180, 180, count)
    wobble = 0.06 * np.stack([np.cos(np.radians(turn)), 0 * turn, np.sin(np.radians(turn))], axis=1)
    joints = {"tilt_deg": np.degrees(axes[:, 0]), "roll_deg": turn}
    found = error_structure(wobble + noise(axes, rng)[0], axes, joints=joints)
    assert [(p.kind, p.name) for p in found.found] == [("joint", "roll_deg")]


def test_the_instruments_part_is_what_noise_alone_would_show():
    rng, shares = np.random.default_rng(7), []
    for _ in range(40):
        axes = SphericalBearing(0.0).move(directions(30, rng), rng).directions
        points, covariances = noise(axes, rng)
        found = error_structure(points, axes, covariances_mm2=covariances)
        squares = np.square(found.misses_mm).sum()
        parts = sum(part.instrument_rms_mm**2 for part in found.components)
        shares.append(30 * parts / squares)
    # The mean of SSR over its expectation has a standard deviation below √(2/57/40) · 1.6.
    assert np.mean(1 / np.array(shares)) == pytest.approx(1.0, abs=4 * 1.6 * np.sqrt(2 / 57 / 40))


def test_what_the_calibration_explains_is_not_said_of_the_robot():
    rng, count = np.random.default_rng(8), 40
    axes = directions(count, rng)
    common = 0.1 * axes[:, [2, 0, 1], None] * axes[:, :1, None]
    points = common[:, :, 0] + 0.1 * noise(axes, rng)[0]
    assert kinds(error_structure(points, axes)) == {"direction"}
    found = error_structure(points, axes, common_mm=common)
    assert kinds(found) == set()
    assert "no more than errors of the calibration explain" in found.patterns[0].text


def test_another_frame_turns_the_answer_with_it():
    rng, count = np.random.default_rng(9), 30
    axes = directions(count, rng)
    points = noise(axes, rng)[0] + np.outer(np.arange(count) >= 15, [0.2, 0.1, 0])
    move = RigidTransform.from_rotation_vector([0.4, -1.1, 0.7], [50, 60, 700])
    here = error_structure(points, axes)
    there = error_structure(move @ points, -move.rotate(axes))
    np.testing.assert_allclose(there.misses_mm, move.rotate(here.misses_mm), atol=1e-10)
    np.testing.assert_allclose(there.tilts_deg, here.tilts_deg, atol=1e-6)
    (a,), (b,) = ([p for p in s.found if p.kind == "order"] for s in (here, there))
    np.testing.assert_allclose(b.shift_mm, move.rotate(a.shift_mm), atol=1e-9)


@pytest.mark.parametrize("count", [3, 9])
def test_few_poses_say_nothing(count):
    rng = np.random.default_rng(10)
    assert error_structure(rng.normal(size=(count, 3)), directions(count, rng)).patterns == ()


def test_lines_that_meet_exactly_follow_nothing():
    rng = np.random.default_rng(11)
    axes = directions(30, rng)
    found = error_structure(np.outer(rng.uniform(-80, 80, 30), [1, 1, 1]) * 0, axes)
    assert found.patterns == ()
    assert found.instrument_share == 0


def test_successive_poses_that_are_alike_do_not_count_as_many():
    rng, count, false = np.random.default_rng(12), 60, 0
    for _ in range(40):
        axes = directions(count, rng)
        steps = rng.standard_normal((count, 3))
        for i in range(1, count):  # an AR(1) walk with a correlation of 0.8
            steps[i] = 0.8 * steps[i - 1] + 0.6 * steps[i]
        false += "order" in kinds(error_structure(0.05 * steps, axes))
    assert false <= binom.ppf(0.999, 40, 0.05)
