import cv2
import numpy as np
import pytest
from scipy.stats import chi2

from pivometer.calibration.board import BoardView
from pivometer.calibration.homography import homography
from pivometer.calibration.intrinsics import (
    calibrate_camera,
    calibration_matrix_from_homographies,
    camera_from_board_pose,
    recalibrated,
    rms,
)
from pivometer.cameras import Camera
from pivometer.errors import CalibrationError
from pivometer.geometry.rigid import RigidTransform, rotation_from_vector

PINHOLE = Camera("left", 640, 480, [980, 984], [314, 245], [0, 0])


def left(scene, noise_px=0.0, seed=0):
    return [v for v in scene.views(noise_px, seed) if v.camera == "left"]


def project(camera, board, pose, name):
    ids = np.arange(board.corner_count)
    pixels = camera.project(pose @ board.corners_mm)
    return BoardView(camera.name, name, ids, pixels, np.full(len(ids), 0.1))


def test_closed_form_is_exact_without_distortion_and_noise(scene):
    homographies = []
    for moment in scene.moments:
        if "left" in scene.who(moment):
            pose = scene.camera_from_board("left", moment)
            pixels = PINHOLE.project(pose @ scene.board.corners_mm)
            homographies.append(homography(scene.board.corners_mm[:, :2], pixels))
    K = calibration_matrix_from_homographies(homographies, 640, 480)
    np.testing.assert_allclose(K, PINHOLE.calibration_matrix, rtol=0, atol=1e-6)
    pose = scene.camera_from_board("left", "board/000")
    found = camera_from_board_pose(K, homographies[0], scene.board.corners_mm)
    np.testing.assert_allclose(found.rotation, pose.rotation, atol=1e-8)
    np.testing.assert_allclose(found.translation_mm, pose.translation_mm, atol=1e-5)


def test_closed_form_falls_back_where_views_hardly_tilt(scene):
    """Frontal views say nothing of the focal length; a usable start is returned all the same."""
    H = [
        homography(
            scene.board.corners_mm[:, :2],
            PINHOLE.project(scene.board.corners_mm + np.array([x, -40, 500])),
        )
        for x in (-90.0, -50.0, 0.0)
    ]
    K = calibration_matrix_from_homographies(H, 640, 480)
    assert np.isfinite(K).all()
    assert 64 < K[0, 0] < 640 * 50


def test_exact_corners_give_the_exact_camera(scene):
    fit = calibrate_camera(left(scene), scene.board, (640, 480), camera="left")
    # relative to what 1 px of noise would do, rounding of 1e-13 px over 1000 px shows as 1e-9
    np.testing.assert_allclose(fit.camera.parameters, scene.rig.cameras[0].parameters, atol=1e-6)
    assert fit.rms_px < 1e-9
    assert fit.rejected == ()


def test_noisy_errors_follow_the_stated_covariance(scene):
    total, trials = 0.0, 12
    for seed in range(trials):
        fit = calibrate_camera(left(scene, 0.1, seed), scene.board, (640, 480), camera="left")
        delta = fit.camera.parameters - scene.rig.cameras[0].parameters
        total += float(delta @ np.linalg.solve(fit.covariance, delta))
        assert fit.rms_px == pytest.approx(0.1 * np.sqrt(2), rel=0.1)
    assert chi2.ppf(1e-4, 6 * trials) < total < chi2.ppf(1 - 1e-4, 6 * trials)


def test_agrees_with_opencv_on_the_same_corners(scene):
    views = left(scene, 0.1, 3)
    fit = calibrate_camera(views, scene.board, (640, 480), camera="left")
    flags = cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-14)
    value, K, dist, *_ = cv2.calibrateCamera(
        [scene.board.corners_mm.astype(np.float32)] * len(views),
        [v.pixels.astype(np.float32) for v in views],
        (640, 480),
        np.eye(3),
        np.zeros(5),
        flags=flags,
        criteria=criteria,
    )
    theirs = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], dist.ravel()[0], dist.ravel()[1]])
    # both stop at the same minimum, OpenCV's input being rounded to float32 (3e-5 px)
    assert fit.rms_px == pytest.approx(value, abs=1e-5)
    u = np.sqrt(np.diag(fit.covariance))
    assert (np.abs(fit.camera.parameters - theirs) < 0.01 * u).all()


def test_partial_views_count(scene):
    rng = np.random.default_rng(0)
    views = []
    for view in left(scene):
        keep = np.sort(rng.choice(48, 25, replace=False))
        views.append(
            BoardView("left", view.view, view.ids[keep], view.pixels[keep], view.sigma_px[keep])
        )
    fit = calibrate_camera(views, scene.board, (640, 480), camera="left")
    np.testing.assert_allclose(fit.camera.parameters, scene.rig.cameras[0].parameters, atol=1e-6)


def test_two_views_are_refused(scene):
    with pytest.raises(CalibrationError, match="camera left: 2 usable board views, at least 3"):
        calibrate_camera(left(scene)[:2], scene.board, (640, 480), camera="left")


def test_no_views_are_refused(scene):
    with pytest.raises(CalibrationError, match="camera left: 0 usable board views"):
        calibrate_camera([], scene.board, (640, 480), camera="left")


@pytest.mark.parametrize("tilt_rad", [0.0, 0.4])
@pytest.mark.parametrize("noise_px", [0.0, 0.05])
def test_parallel_views_are_refused(scene, add_noise, tilt_rad, noise_px):
    """Boards that only move but never turn leave the focal length undetermined."""
    rng = np.random.default_rng(0)
    turn = rotation_from_vector([tilt_rad, tilt_rad / 2, 0])
    views = [
        add_noise(
            project(PINHOLE, scene.board, RigidTransform(turn, [x, y, 500]), f"board/{x}{y}"),
            noise_px,
            rng,
        )
        for x in (-90, -50, -20)
        for y in (-60, -30)
    ]
    with pytest.raises(
        CalibrationError, match=r"camera left: .*(determine|ran away|principal|settle)"
    ):
        calibrate_camera(views, scene.board, (640, 480), camera="left")


def test_a_view_with_displaced_corners_is_rejected_with_its_reason(scene):
    views = left(scene, 0.05, 1)
    pixels = views[4].pixels.copy()
    pixels[[3, 20, 21]] += 8  # seen from OpenCV's detector on clean images
    views[4] = BoardView("left", views[4].view, views[4].ids, pixels, views[4].sigma_px)
    fit = calibrate_camera(views, scene.board, (640, 480), camera="left")
    assert [r.view for r in fit.rejected] == [views[4].view]
    assert "px rms" in fit.rejected[0].reason
    clean = calibrate_camera(
        [v for i, v in enumerate(views) if i != 4], scene.board, (640, 480), camera="left"
    )
    u = np.sqrt(np.diag(clean.covariance))
    assert (np.abs(fit.camera.parameters - clean.camera.parameters) < 0.01 * u).all()


def test_corners_that_are_no_plane_are_rejected_before_the_fit(scene):
    views = left(scene, 0.05, 1)
    scrambled = np.random.default_rng(0).permutation(views[2].pixels)
    views[2] = BoardView("left", views[2].view, views[2].ids, scrambled, views[2].sigma_px)
    fit = calibrate_camera(views, scene.board, (640, 480), camera="left")
    assert [r.view for r in fit.rejected] == [views[2].view]
    assert "no image of a flat board" in fit.rejected[0].reason


def test_views_of_too_few_corners_are_rejected(scene):
    views = left(scene, 0.05, 1)
    views[0] = BoardView("left", "short", [0, 1, 2, 3, 4, 5], views[0].pixels[:6], np.ones(6))
    views[1] = BoardView("left", "few", [0, 1, 9], views[1].pixels[[0, 1, 9]], np.ones(3))
    fit = calibrate_camera(views, scene.board, (640, 480), camera="left")
    assert [r.view for r in fit.rejected] == ["short", "few"]


def test_random_corners_are_refused(scene):
    rng = np.random.default_rng(0)
    views = [
        BoardView("left", f"{i}", np.arange(48), rng.uniform(0, 480, (48, 2)), np.ones(48))
        for i in range(6)
    ]
    with pytest.raises(CalibrationError, match="camera left"):
        calibrate_camera(views, scene.board, (640, 480), camera="left")


def test_recalibrated_on_all_views_changes_nothing(scene):
    fit = calibrate_camera(left(scene, 0.1, 2), scene.board, (640, 480), camera="left")
    again = recalibrated(fit, scene.board, [v.view for v in fit.views])
    u = np.sqrt(np.diag(fit.covariance))
    assert (np.abs(again.parameters - fit.camera.parameters) < 0.01 * u).all()


def test_rms_counts_points_not_coordinates():
    assert rms(np.array([[1.0, 1.0]])) == pytest.approx(np.sqrt(2))
