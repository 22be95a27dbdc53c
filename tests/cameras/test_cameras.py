import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pivometer.cameras import Camera, Rig
from pivometer.cameras.distortion import (
    coefficient_jacobian,
    distort,
    distort_jacobian,
    fold_radius,
    image_reach,
    undistort,
)
from pivometer.errors import DataError, ShapeError
from pivometer.geometry import RigidTransform

# From strong barrel to strong pincushion, as lenses have them.
betas = st.tuples(st.floats(-0.4, 0.3), st.floats(-0.1, 0.3))
seeds = st.integers(0, 2**32 - 1)


WIDE = {
    "none": [],
    "radial2": [-0.28, 0.1],
    "brown5": [-0.33, 0.15, 8e-4, -1.2e-3, -0.04],
    "rational8": [0.4, -0.1, 8e-4, -1.2e-3, 0.02, 0.72, -0.2, 0.05],
}
"""One lens of each model, bent as far as real ones are."""


def camera(name="left", beta=(-0.28, 0.1)):
    return Camera(name, 640, 480, [1000, 990], [321.5, 238.25], beta)


def rig(seed=0):
    rng = np.random.default_rng(seed)
    poses = [RigidTransform.identity()] + [
        RigidTransform.from_rotation_vector(rng.normal(size=3), 100 * rng.normal(size=3))
        for _ in range(2)
    ]
    return Rig([camera("a"), camera("b"), camera("c")], poses)


@given(betas, seeds)
def test_undistortion_undoes_distortion_to_rounding(beta, seed):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1, 1, size=(50, 2)) * min(0.9 * fold_radius(beta), 1.5) / np.sqrt(2)
    again = distort(undistort(distort(points, beta), beta), beta)
    np.testing.assert_allclose(again, distort(points, beta), atol=4e-15)
    np.testing.assert_allclose(undistort(distort(points, beta), beta), points, atol=1e-13)


def test_undistortion_beyond_the_fold_is_refused():
    with pytest.raises(DataError, match="folds"):
        undistort([[0.7, 0.0]], [-1 / 3, 0.0])  # the fold images at 2/3


def test_undistortion_next_to_the_fold_converges():
    radius = (1 - 1e-6) * 2 / 3
    found = undistort([[radius, 0.0]], [-1 / 3, 0.0])
    np.testing.assert_allclose(distort(found, [-1 / 3, 0.0]), [[radius, 0.0]], atol=1e-14)


@given(betas, seeds)
def test_distortion_jacobian_is_the_derivative(beta, seed):
    point = np.random.default_rng(seed).uniform(-0.5, 0.5, size=2)
    step = 1e-6
    numeric = np.stack(
        [
            (distort(point + d, beta) - distort(point - d, beta)) / (2 * step)
            for d in step * np.eye(2)
        ],
        axis=1,
    )
    np.testing.assert_allclose(distort_jacobian(point, beta), numeric, atol=1e-9)


@given(betas, seeds)
def test_projection_agrees_with_opencv(beta, seed):
    points = np.random.default_rng(seed).uniform([-80, -60, 400], [80, 60, 600], size=(20, 3))
    ours = camera(beta=beta)
    oracle = cv2.projectPoints(
        points, np.zeros(3), np.zeros(3), ours.calibration_matrix, np.array([*beta, 0, 0])
    )[0][:, 0]
    np.testing.assert_allclose(ours.project(points), oracle, atol=1e-9)
    np.testing.assert_allclose(
        ours.normalized_from_pixels(ours.project(points)), points[:, :2] / points[:, 2:], atol=1e-12
    )


def test_pixel_jacobian_is_the_derivative():
    point, step = np.array([0.21, -0.17]), 1e-6
    numeric = np.stack(
        [
            (
                camera().pixels_from_normalized(point + d)
                - camera().pixels_from_normalized(point - d)
            )
            / (2 * step)
            for d in step * np.eye(2)
        ],
        axis=1,
    )
    np.testing.assert_allclose(camera().pixels_jacobian(point), numeric, atol=1e-6)


def test_points_behind_the_camera_are_refused():
    with pytest.raises(ShapeError, match="in front"):
        camera().project([[0, 0, -1]])


@given(seeds)
def test_a_rig_moves_by_what_it_is_perturbed_by(seed):
    delta = 1e-3 * np.random.default_rng(seed).normal(size=30)
    moved = rig().perturbed(delta)
    np.testing.assert_allclose(rig().difference(moved), delta, atol=1e-12)
    assert len(rig().parameter_names) == delta.size


@pytest.mark.parametrize(
    ("cameras", "poses"),
    [
        ([camera()], [RigidTransform.identity()]),
        ([camera(), camera()], [RigidTransform.identity()] * 2),
        ([camera("a"), camera("b")], [RigidTransform(np.eye(3), [1, 0, 0])] * 2),
    ],
)
def test_what_is_not_a_rig_is_refused(cameras, poses):
    with pytest.raises(ShapeError):
        Rig(cameras, poses)


@pytest.mark.parametrize("model", WIDE)
def test_every_model_agrees_with_opencv_and_comes_back(model):
    rng = np.random.default_rng(4)
    points = np.column_stack([rng.uniform(-0.6, 0.6, (200, 2)), np.ones(200)])
    ours = camera(beta=WIDE[model])
    assert ours.model == model
    k = np.array([*WIDE[model], *np.zeros(8 - len(WIDE[model]))])
    oracle = cv2.projectPoints(points, np.zeros(3), np.zeros(3), ours.calibration_matrix, k)[0]
    np.testing.assert_allclose(ours.project(points), oracle[:, 0], atol=1e-9)
    back = ours.normalized_from_pixels(ours.project(points))
    np.testing.assert_allclose(back, points[:, :2], atol=4e-15)


@pytest.mark.parametrize("model", WIDE)
def test_jacobians_of_every_model_are_derivatives(model):
    k = np.array(WIDE[model])
    points = np.random.default_rng(5).uniform(-0.6, 0.6, (20, 2))
    step = 1e-6
    by_point = [(distort(points + d, k) - distort(points - d, k)) / (2 * step)
                for d in step * np.eye(2)]  # fmt: skip
    np.testing.assert_allclose(distort_jacobian(points, k), np.stack(by_point, axis=-1), atol=1e-9)
    found = coefficient_jacobian(points, k)
    assert found.shape == (20, 2, len(k))
    for i, d in enumerate(step * np.eye(len(k))):
        numeric = (distort(points, k + d) - distort(points, k - d)) / (2 * step)
        np.testing.assert_allclose(found[..., i], numeric, atol=1e-9)


@pytest.mark.parametrize("k", [WIDE["brown5"], WIDE["rational8"], [0, 0, 0, 0, -1.0]])
def test_beyond_the_fold_of_any_model_is_refused_and_inside_is_not(k):
    k = np.array([0.2, 0, *k[2:4], 0, 0.9, 0.4, 0.3]) if len(k) == 8 else np.array(k)
    assert np.isfinite(fold_radius(k))
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    rim = image_reach(k) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    np.testing.assert_allclose(distort(undistort(0.97 * rim, k), k), 0.97 * rim, atol=1e-13)
    for point in 1.03 * rim:
        with pytest.raises(DataError, match="folds"):
            undistort(point[None], k)


def test_a_pole_of_the_rational_model_ends_the_lens():
    assert fold_radius([0, 0, 0, 0, 0, -1.0, 0, 0]) == pytest.approx(1.0, abs=1e-8)


def test_a_number_of_coefficients_that_no_model_has_is_refused():
    with pytest.raises(ShapeError, match="3 distortion coefficients"):
        camera(beta=[0.1, 0.2, 0.3])


def test_a_rig_of_cameras_of_different_models_moves_by_what_it_is_perturbed_by():
    cameras = [camera(name, beta) for name, beta in WIDE.items()]
    poses = [RigidTransform.identity()] + [
        RigidTransform.from_rotation_vector([0.1 * i, 0.2, 0], [100.0 * i, 0, 0]) for i in (1, 2, 3)
    ]
    mixed = Rig(cameras, poses)
    assert mixed.parameter_names[:6] == (
        "none.fx_px", "none.fy_px", "none.ox_px", "none.oy_px", "radial2.fx_px", "radial2.fy_px",
    )  # fmt: skip
    delta = 1e-3 * np.random.default_rng(1).normal(size=len(mixed.parameter_names))
    np.testing.assert_allclose(mixed.difference(mixed.perturbed(delta)), delta, atol=1e-12)
