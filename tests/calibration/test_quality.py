import numpy as np
import pytest

from pivometer.calibration.quality import (
    camera_quality,
    epipolar_rms,
    filled_fraction,
    held_out_lengths,
    matched_points,
    quality_notes,
    shared_moments,
    tilt_range_deg,
)
from pivometer.cameras import Camera
from pivometer.geometry.rigid import RigidTransform


def test_shared_moments_are_those_of_two_cameras(scene):
    assert shared_moments(scene.views()) == tuple(f"board/{i:03d}" for i in range(12))


def test_held_out_pairs_are_kept_from_the_estimate(scene):
    asked = []

    def estimate(moments):
        asked.append(set(moments))
        return scene.rig

    error = held_out_lengths(scene.views(), scene.board, estimate, folds=5).error(15.0)
    assert error.count == 12 * len(scene.board.edges)
    assert error.max_mm < 1e-9
    assert len(asked) == 5
    everything = set(scene.moments)
    left_out = [everything - moments for moments in asked]
    assert sorted(m for out in left_out for m in out) == list(shared_moments(scene.views()))


def test_held_out_error_sees_a_wrong_rig(scene):
    delta = np.zeros(18)
    delta[15] = 0.01 * 470  # baseline 1 % too long in x
    moved = scene.rig.perturbed(delta)
    error = held_out_lengths(scene.views(), scene.board, lambda _: moved).error(15.0)
    assert 0.02 < error.rms_mm < 0.2


def test_epipolar_rms_equals_the_noise(three_cameras):
    assert epipolar_rms(three_cameras.views(), three_cameras.rig) < 1e-9
    noisy = epipolar_rms(three_cameras.views(0.2, 1), three_cameras.rig)
    assert noisy == pytest.approx(0.2, rel=0.1)


def test_matched_points_are_of_the_same_corner(scene):
    views = scene.views()
    first, second = matched_points(views, *scene.rig.cameras)
    assert len(first) == len(second) == 12 * 48
    pose = scene.camera_from_board("left", "board/000")
    local = pose @ scene.board.corners_mm
    np.testing.assert_allclose(first[:48], local[:, :2] / local[:, 2:], atol=1e-9)


def test_coverage_counts_cells(scene):
    camera = Camera("left", 640, 480, [1000, 1000], [320, 240], [0, 0])
    grid = np.stack(np.meshgrid(np.linspace(0, 639, 64), np.linspace(0, 479, 48)), -1)
    assert filled_fraction(grid.reshape(-1, 2), camera) == 1.0
    assert filled_fraction(np.array([[-0.4, -0.4], [639.4, 479.4]]), camera) == pytest.approx(
        2 / 48
    )


def test_tilt_range_is_the_largest_angle_between_normals():
    poses = [RigidTransform.from_rotation_vector([a, 0, 0], [0, 0, 500]) for a in (-0.3, 0.1, 0.4)]
    assert tilt_range_deg(poses) == pytest.approx(np.degrees(0.7))


def quality_of(scene, moments, u=0.1):
    views = [scene.view("left", m) for m in moments]
    return camera_quality(
        scene.rig.cameras[0],
        views,
        [scene.camera_from_board("left", m) for m in moments],
        [np.full((48, 2), 0.1 * (i + 1)) for i in range(len(moments))],
        np.diag(np.full(6, u**2)),
    )


def test_camera_quality_sums_up(scene):
    quality = quality_of(scene, ["board/000", "board/001", "board/002"])
    assert quality.view_count == 3
    assert quality.corner_count == 144
    assert quality.rms_px == pytest.approx(np.sqrt(2 * (0.01 + 0.04 + 0.09) / 3))
    assert quality.worst_view == "board/002"
    assert quality.worst_rms_px == pytest.approx(0.3 * np.sqrt(2))
    assert (quality.parameters_u == 0.1).all()


def test_good_calibrations_get_no_warnings(scene):
    moments = [m for m in scene.moments if "left" in scene.who(m)]
    good = quality_of(scene, moments)
    notes = quality_notes([good, good], scene.rig, {("left", "right"): 20})
    assert notes == ()


def test_weak_calibrations_get_plain_words(scene):
    weak = quality_of(scene, ["board/000"], u=5.0)
    notes = "\n".join(quality_notes([weak, weak], scene.rig, {("left", "right"): 4}))
    assert "camera left: only 1 board images" in notes
    assert "tilt varies by only 0°" in notes
    assert "% of the image" in notes
    assert "principal point is uncertain by 5.0 px" in notes
    assert "cameras left and right share only 4 board images" in notes
