import numpy as np
import pytest
from scipy.optimize import minimize

from pivometer.calibration.quality import matched_points
from pivometer.calibration.two_view import (
    bundle_adjust,
    corrected_points,
    eight_point,
    pose_from_essential,
)
from pivometer.errors import CalibrationError
from pivometer.geometry.rigid import RigidTransform, cross_matrix, rotation_from_vector

FOCAL = (982.0, 1010.5)


@pytest.fixture
def truth(scene):
    pose = scene.rig.reference_from_camera[1]
    return RigidTransform(pose.rotation, pose.translation_mm / np.linalg.norm(pose.translation_mm))


def images(scene, noise_px=0.0, seed=0):
    return matched_points(scene.views(noise_px, seed), *scene.rig.cameras)


def homogeneous(points):
    return np.concatenate([points, np.ones((len(points), 1))], axis=1)


def angle(a, b):
    return float(np.arccos(np.clip(a @ b, -1, 1)))


def test_eight_point_and_decomposition_are_exact_without_noise(scene, truth):
    a, b = images(scene)
    E = eight_point(a, b)
    constraint = np.sum(homogeneous(a) * (homogeneous(b) @ E.T), axis=1)
    assert np.abs(constraint).max() < 1e-12
    pose = pose_from_essential(E, a, b)
    np.testing.assert_allclose(pose.rotation, truth.rotation, atol=1e-9)
    np.testing.assert_allclose(pose.translation_mm, truth.translation_mm, atol=1e-9)


def test_essential_matrix_has_two_equal_singular_values(scene):
    np.testing.assert_allclose(
        np.linalg.svd(eight_point(*images(scene, 0.3)))[1], [1, 1, 0], atol=1e-12
    )


def test_bundle_adjustment_improves_on_eight_point(scene, truth):
    """Averaged over ten sets: the paper's reason for (19) and (20)."""
    errors = []
    for seed in range(10):
        a, b = images(scene, 0.2, seed)
        start = pose_from_essential(eight_point(a, b), a, b)
        best = bundle_adjust(start, a, b, weights=FOCAL).first_from_second
        errors.append([angle(p.translation_mm, truth.translation_mm) for p in (start, best)])
    eight, adjusted = np.sqrt(np.mean(np.square(errors), axis=0))
    assert adjusted < 0.8 * eight


def test_corrections_have_the_size_of_the_noise(scene):
    a, b = images(scene, 0.1, 5)
    solution = bundle_adjust(pose_from_essential(eight_point(a, b), a, b), a, b, weights=FOCAL)
    # undistorting stretches the corners' noise by a few percent
    assert solution.correction == pytest.approx(0.1, rel=0.1)


def test_corrected_points_satisfy_the_constraint_exactly(scene):
    a, b = images(scene, 0.5, 1)
    solution = bundle_adjust(pose_from_essential(eight_point(a, b), a, b), a, b)
    pose = solution.first_from_second
    E = cross_matrix(pose.translation_mm) @ pose.rotation
    gap = np.sum(homogeneous(solution.first) * (homogeneous(solution.second) @ E.T), axis=1)
    assert np.abs(gap).max() < 1e-14


def test_correction_is_optimal_and_not_only_sampsons(truth):
    """Against a general constrained optimiser, with corrections large enough to tell."""
    rng = np.random.default_rng(2)
    E = cross_matrix(truth.translation_mm) @ truth.rotation
    for _ in range(5):
        a, b = rng.uniform(-0.3, 0.3, (2, 1, 2))
        x1, x2 = corrected_points(E, a, b, weights=(1.0, 1.3))

        def cost(w):
            return np.sum(w**2)

        def gap(w, a=a, b=b):
            p, q = np.array([*(a[0] + w[:2]), 1]), np.array([*(b[0] + w[2:] / 1.3), 1])
            return p @ E @ q

        reference = minimize(
            cost, np.zeros(4), constraints={"type": "eq", "fun": gap}, options={"ftol": 1e-15}
        )
        ours = np.sum((x1 - a) ** 2) + np.sum((1.3 * (x2 - b)) ** 2)
        assert ours == pytest.approx(reference.fun, rel=1e-5, abs=1e-12)


def test_the_minimum_of_19_under_20_is_a_minimum(scene):
    a, b = images(scene, 0.3, 4)
    solution = bundle_adjust(pose_from_essential(eight_point(a, b), a, b), a, b, weights=FOCAL)

    def cost(pose):
        E = cross_matrix(pose.translation_mm / np.linalg.norm(pose.translation_mm)) @ pose.rotation
        x1, x2 = corrected_points(E, a, b, weights=FOCAL)
        return np.sum((FOCAL[0] * (a - x1)) ** 2) + np.sum((FOCAL[1] * (b - x2)) ** 2)

    best = solution.first_from_second
    base = cost(best)
    rng = np.random.default_rng(0)
    for size in (1e-3, 1e-4, 1e-5):
        for _ in range(10):
            turn = rotation_from_vector(size * rng.standard_normal(3)) @ best.rotation
            moved = RigidTransform(turn, best.translation_mm + size * rng.standard_normal(3))
            assert cost(moved) >= base * (1 - 1e-9)


def test_start_does_not_matter(scene, truth):
    a, b = images(scene, 0.1, 6)
    near = bundle_adjust(truth, a, b, weights=FOCAL).first_from_second
    off = RigidTransform(
        rotation_from_vector([0.1, -0.05, 0.08]) @ truth.rotation,
        truth.translation_mm + np.array([0.1, 0.1, -0.1]),
    )
    far = bundle_adjust(off, a, b, weights=FOCAL).first_from_second
    np.testing.assert_allclose(near.rotation, far.rotation, atol=1e-6)
    np.testing.assert_allclose(near.translation_mm, far.translation_mm, atol=1e-6)


@pytest.mark.parametrize("noise_px", [0.0, 0.1])
def test_one_plane_is_refused(scene, noise_px):
    one = scene.only(lambda m: m == "board/000")
    with pytest.raises(CalibrationError, match="48 corners lie in one plane"):
        eight_point(*images(one, noise_px))


def test_too_few_points_are_refused(scene):
    a, b = images(scene)
    with pytest.raises(CalibrationError, match="7 corresponding points"):
        eight_point(a[:7], b[:7])


def test_points_behind_the_cameras_are_refused(truth):
    """Mismatched moments reconstruct on both sides of the cameras."""
    X = np.random.default_rng(0).uniform([-0.1, -0.1, 0.8], [0.1, 0.1, 1.0], (20, 3))
    X[::2] *= -1
    Y = truth.inverse() @ X
    E = cross_matrix(truth.translation_mm) @ truth.rotation
    with pytest.raises(CalibrationError, match="in front of both"):
        pose_from_essential(E, X[:, :2] / X[:, 2:], Y[:, :2] / Y[:, 2:])
