"""A camera that was moved after the calibration is noticed in board views at the end."""

from dataclasses import replace

import numpy as np
import pytest

from pivometer.calibration import calibrate_rig
from pivometer.calibration.drift import drift, moved_rig

AT_MM = np.array([0.0, 60.0, 470.0])
BUMP = np.array([0.0, 0.002, 0.001, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def calibrated(scene):
    return calibrate_rig(scene.views(0.03), scene.board, scene.sizes, reference="left")


def closing(build_scene, bump=None, camera="right", *, third=False, noise_px=0.03):
    scene = build_scene(pairs=2, singles=0, seed=77, third=third)
    if bump is not None:
        scene = replace(scene, rig=moved_rig(scene.rig, camera, bump))
    views = scene.views(noise_px, 5)
    return [replace(v, view=v.view.replace("board", "closing")) for v in views]


def seen(views, calibration, *, earlier=True):
    return drift(
        views,
        calibration.board,
        calibration.rig,
        calibration.covariance,
        at_mm=AT_MM,
        noise_px=calibration.noise_px,
        earlier=calibration.views if earlier else (),
    )


def test_cameras_that_stood_still_show_no_drift(build_scene, calibrated):
    found = seen(closing(build_scene), calibrated)
    assert not found.significant
    assert found.views == ("closing/000", "closing/001")


def test_a_bumped_camera_is_found_with_its_angle_and_its_effect(build_scene, calibrated):
    found = seen(closing(build_scene, BUMP), calibrated)
    centre = calibrated.rig.reference_from_camera[1].translation_mm
    effect = np.linalg.norm(np.cross(BUMP[:3], AT_MM - centre))
    assert found.significant
    assert found.angle_rad == pytest.approx(np.linalg.norm(BUMP[:3]), rel=0.25)
    assert found.shift_mm == pytest.approx(effect, rel=0.25)
    assert found.cameras == ("left", "right")  # two cameras cannot tell


def test_a_board_left_where_it_was_tells_which_camera_moved(build_scene, calibrated):
    views = closing(build_scene, BUMP)
    before = [replace(v, view="reference/000") for v in closing(build_scene)[:1]]
    before += [
        replace(v, view="reference/000")
        for v in closing(build_scene)
        if v.camera == "right" and v.view == before[0].view.replace("reference", "closing")
    ]
    found = drift(
        views,
        calibrated.board,
        calibrated.rig,
        calibrated.covariance,
        at_mm=AT_MM,
        noise_px=calibrated.noise_px,
        earlier=[*calibrated.views, *before],
    )
    assert found.cameras == ("right",)


@pytest.mark.parametrize("camera", ["left", "right", "top"])
def test_of_three_cameras_the_one_that_moved_is_named(build_scene, three_cameras, camera):
    calibration = calibrate_rig(
        three_cameras.views(0.03), three_cameras.board, three_cameras.sizes, reference="left"
    )
    found = seen(closing(build_scene, BUMP, camera, third=True), calibration)
    assert found.significant
    assert found.cameras == (camera,)


def test_views_of_one_camera_alone_say_nothing(build_scene, calibrated):
    views = [v for v in closing(build_scene) if v.camera == "left"]
    assert seen(views, calibrated) is None
