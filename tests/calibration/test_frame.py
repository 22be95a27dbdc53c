"""The pose of a board that stands still, from all cameras and views."""

from dataclasses import replace

import numpy as np
import pytest

from pivometer.calibration.board import BoardView
from pivometer.calibration.frame import board_pose, fixed_board, moved
from pivometer.errors import CalibrationError
from pivometer.geometry.rigid import RigidTransform

POSE = RigidTransform.from_rotation_vector([0.05, -0.75, 0.06], [-30.0, 0.0, 460.0])


def standing(scene, pose=POSE, *, count=3, noise_px=0.0, seed=0) -> list[BoardView]:
    moments = {f"reference/{i:03d}": pose for i in range(count)}
    return replace(scene, moments=moments).views(noise_px, seed)


def test_without_noise_the_pose_is_exact(scene):
    found = fixed_board(standing(scene), scene.board, scene.rig, noise_px=0.02)
    assert np.abs(found.reference_from_board.rotation - POSE.rotation).max() < 1e-9
    assert np.abs(found.reference_from_board.translation_mm - POSE.translation_mm).max() < 1e-6
    assert found.rms_px < 1e-6
    assert found.views == ("reference/000", "reference/001", "reference/002")


def test_three_cameras_of_which_one_does_not_see_the_board(three_cameras):
    views = [v for v in standing(three_cameras) if v.camera != "left"]
    found = fixed_board(views, three_cameras.board, three_cameras.rig, noise_px=0.02)
    assert np.abs(found.reference_from_board.translation_mm - POSE.translation_mm).max() < 1e-6


@pytest.mark.parametrize("turned", range(4))
def test_a_board_that_looks_the_same_turned_is_numbered_alike(scene, turned):
    turn = scene.board.symmetries[1]
    views = standing(scene)
    views = [
        v.renumbered(turn) if (i + turned) % 4 in (0, turned % 3) else v
        for i, v in enumerate(views)
    ]
    found = fixed_board(views, scene.board, scene.rig, noise_px=0.02)
    assert np.abs(found.reference_from_board.rotation - POSE.rotation).max() < 1e-9
    assert "x axis points right in the image of camera left" in found.note


def test_a_board_with_one_frame_needs_no_note(build_scene):
    scene = build_scene(squares=(8, 7), pairs=1, singles=0)
    upside_down = POSE @ RigidTransform.from_rotation_vector([0, 0, np.pi], [60, 60, 0])
    views = standing(scene, upside_down)
    found = fixed_board(views, scene.board, scene.rig, noise_px=0.02)
    assert found.note == ""
    assert np.abs(found.reference_from_board.rotation - upside_down.rotation).max() < 1e-9


def test_the_covariance_is_that_of_repeated_noise(scene):
    deltas, stated = [], []
    for seed in range(200):
        views = standing(scene, count=2, noise_px=0.1, seed=seed)
        found = fixed_board(views, scene.board, scene.rig, noise_px=0.1)
        turn = RigidTransform(found.reference_from_board.rotation @ POSE.rotation.T, np.zeros(3))
        shift = found.reference_from_board.translation_mm - POSE.translation_mm
        deltas.append([*turn.rotation_vector_rad(), *shift])
        stated.append(found.covariance)
    squares = [d @ np.linalg.solve(c, d) for d, c in zip(np.array(deltas), stated, strict=True)]
    # the mean of 200 χ² of 6 degrees of freedom: 6 ± 0.25 (and 3 % for the estimated variance)
    assert np.mean(squares) == pytest.approx(6.2, abs=0.9)


def test_a_board_that_moved_is_refused_with_its_view(scene):
    views = standing(scene, noise_px=0.02)
    nudged = moved(POSE, np.array([0, 0, 0, 0.3, 0, 0]))
    other = replace(scene, moments={"reference/007": nudged}).views(0.02, 5)
    with pytest.raises(CalibrationError, match="moved") as caught:
        fixed_board(views + other, scene.board, scene.rig, noise_px=0.02)
    assert "reference/007" in caught.value.what
    assert "reference/001" not in caught.value.what


def test_a_nudge_in_the_noise_is_not_a_movement(scene):
    views = standing(scene, noise_px=0.1)
    fixed_board(views, scene.board, scene.rig, noise_px=0.1)


def test_cameras_that_disagree_are_refused(scene):
    nudged = moved(POSE, np.array([0, 0, 0, 0, 3.0, 0]))
    views = [v for v in standing(scene) if v.camera == "left"]
    views += [v for v in standing(scene, nudged) if v.camera == "right"]
    with pytest.raises(CalibrationError, match="do not agree"):
        fixed_board(views, scene.board, scene.rig, noise_px=0.02)


def test_no_view_at_all_is_said(scene):
    with pytest.raises(CalibrationError, match="no camera saw"):
        fixed_board([], scene.board, scene.rig, noise_px=0.02)


def test_the_pose_of_a_changed_rig_follows_it(scene):
    found = fixed_board(standing(scene), scene.board, scene.rig, noise_px=0.02)
    step = np.zeros(len(scene.rig.parameter_names))
    other = scene.rig.perturbed(step)
    again = board_pose(found.means, scene.board.corners_mm, other, found.reference_from_board)
    assert np.allclose(again.translation_mm, POSE.translation_mm, atol=1e-6)
