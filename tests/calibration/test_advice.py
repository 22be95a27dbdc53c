"""What a calibration is good for, and the one thing that would improve it."""

from dataclasses import replace

import numpy as np
import pytest

from pivometer.calibration import calibrate_rig
from pivometer.calibration.advice import (
    advice,
    corner_residuals,
    emptiest_part,
    middle_of_boards,
)
from pivometer.calibration.metric_scale import triangulate_points
from pivometer.geometry.rigid import RigidTransform

NOISE_PX = 0.05


def calibrated(scene, seed=0):
    return calibrate_rig(scene.views(NOISE_PX, seed), scene.board, scene.sizes, reference="left")


@pytest.fixture(scope="module")
def calibration(scene):
    return calibrated(scene)


def test_the_stated_uncertainty_is_the_scatter_of_the_point(scene, calibration):
    at = np.array([0.0, 10.0, 470.0])
    stated = advice(calibration, at_mm=at).covariance_mm2
    squares = []
    for seed in range(1, 25):
        rig = calibrated(scene, seed).rig
        images = [
            own.normalized_from_pixels(true.project(pose.inverse() @ at))[None]
            for own, true, pose in zip(
                rig.cameras, scene.rig.cameras, scene.rig.reference_from_camera, strict=True
            )
        ]
        error = triangulate_points(np.stack(images), rig.reference_from_camera)[0] - at
        squares.append(error @ np.linalg.solve(stated, error))
    # the mean of 24 χ² of 3 degrees of freedom: 3 ± 0.5; one rig's covariance is itself uncertain
    assert 1.4 < np.mean(squares) < 5.0


def test_the_verdict_holds_the_numbers(calibration):
    told = advice(calibration)
    assert told.verdict.startswith("The calibration is ")
    assert f"±{told.expanded_mm:.2g} mm" in told.verdict
    assert f"{calibration.held_out.rms_mm:.2g} mm rms" in told.verdict
    assert np.allclose(told.at_mm, middle_of_boards(calibration))


def test_few_pairs_are_what_to_add_to(build_scene):
    told = advice(calibrated(build_scene(pairs=6, singles=8)))
    assert told.next_step.startswith("add 14 pictures of the board taken by all cameras at once")


def test_an_uncertain_camera_with_an_empty_part_gets_views_there(calibration):
    """As if all of the uncertainty were the left camera's principal point."""
    names = calibration.rig.parameter_names
    spread = np.array([1.0 if n in ("left.ox_px", "left.oy_px") else 1e-9 for n in names])
    views = []
    for view in calibration.views:
        keep = (view.camera != "left") | (view.pixels[:, 0] > 242) | (view.pixels[:, 1] > 162)
        if np.sum(keep) > 5:
            rows = np.flatnonzero(np.broadcast_to(keep, len(view.ids)))
            arrays = (view.ids[rows], view.pixels[rows], view.sigma_px[rows])
            views.append(replace(view, ids=arrays[0], pixels=arrays[1], sigma_px=arrays[2]))
    worse = replace(calibration, views=tuple(views), covariance=np.diag(spread**2))
    told = advice(worse)
    assert "principal point of camera left" in told.cause
    assert emptiest_part(worse, worse.rig.cameras[0])[0] == "upper left"
    assert (
        told.next_step == "add 6 tilted views of the board in the upper left of camera left's image"
    )


def test_an_uncertain_pose_asks_for_pairs(calibration):
    names = calibration.rig.parameter_names
    spread = np.array([1e-3 if n.startswith("right.r") else 1e-9 for n in names])
    told = advice(replace(calibration, covariance=np.diag(spread**2)))
    assert "pose of camera right" in told.cause
    assert "all cameras at once" in told.next_step


def test_residuals_are_the_noise_of_the_corners(calibration):
    corners, residuals = corner_residuals(calibration)["right"]
    assert len(corners) == sum(len(v.ids) for v in calibration.views if v.camera == "right")
    assert np.sqrt(np.mean(residuals**2)) == pytest.approx(NOISE_PX, rel=0.1)


def test_boards_shared_by_no_two_cameras_leave_a_guess_of_the_place(calibration):
    alone = tuple(v for v in calibration.views if v.view.startswith("intrinsics"))
    place = middle_of_boards(replace(calibration, views=alone))
    assert isinstance(place, np.ndarray)
    assert RigidTransform.identity().inverse() @ place == pytest.approx(place)
