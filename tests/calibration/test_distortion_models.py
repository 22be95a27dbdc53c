"""Every distortion model by both routes, and when more coefficients are called justified."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from pivometer.calibration.board import Board
from pivometer.calibration.bundle import bundle_problem, bundle_state, jacobian, residuals
from pivometer.calibration.procedure import calibrate_rig
from pivometer.cameras import Rig
from pivometer.cameras.distortion import MODELS
from pivometer.errors import CalibrationError, UsageError

LENSES = {
    "none": [],
    "radial2": [-0.2, 0.1],
    "brown5": [-0.33, 0.15, 2e-3, -1.5e-3, -0.04],
    "rational8": [0.4, -0.1, 8e-4, -1.2e-3, 0.02, 0.72, -0.2, 0.05],
}


def with_lenses(scene, model):
    cameras = [replace(camera, distortion=LENSES[model]) for camera in scene.rig.cameras]
    return replace(scene, rig=Rig(cameras, scene.rig.reference_from_camera))


def wide(scene):
    """Return the scene at half the distance and focal length: eight coefficients need the angle."""
    cameras = [replace(camera, focal_px=camera.focal_px / 2) for camera in scene.rig.cameras]
    near = [
        replace(t, translation_mm=t.translation_mm / 2) for t in scene.rig.reference_from_camera
    ]
    middle = scene.board.corners_mm.mean(axis=0)
    moments = {
        name: replace(pose, translation_mm=(pose.translation_mm - pose.rotate(middle)) / 2)
        for name, pose in scene.moments.items()
    }
    return replace(scene, rig=Rig(cameras, near), moments=moments)


def calibrate(scene, views, **options):
    return calibrate_rig(views, scene.board, scene.sizes, reference="left", **options)


def justified(calibration):
    return [note for note in calibration.notes if "justified" in note]


@pytest.mark.parametrize("model", LENSES)
def test_bundle_jacobian_of_every_model_agrees_with_central_differences(scene, model):
    scene = with_lenses(scene, model)
    views = scene.views(0.3, 0)
    problem = bundle_problem(views, scene.board, ["left", "right"])
    poses = [scene.camera_from_board(v.camera, v.view) for v in views]
    state = bundle_state(problem, scene.rig, poses)
    J = jacobian(problem, state)
    inner = 4 + MODELS[model]
    assert J.shape[-1] == inner + 12
    for camera in range(2):
        mine = problem.camera == camera
        for column in range(inner + 6):
            shared = np.zeros(2 * inner + 6)
            step = 1e-3 if column < 4 or column > inner + 2 else 1e-6
            if column < inner:
                shared[inner * camera + column] = step
            elif camera:
                shared[inner + column] = step
            local = np.zeros((problem.moment_count, 6))
            plus, minus = (residuals(problem, state.moved(s * shared, local)) for s in (1, -1))
            numeric, got = ((plus - minus) / (2 * step))[mine], J[mine][..., column]
            # central differences: rounding of 1e-13 px over a step of 1e-6
            np.testing.assert_allclose(got, numeric, atol=3e-7 * max(1, np.abs(got).max()))


@pytest.mark.parametrize("method", ["joint", "paper"])
@pytest.mark.parametrize("model", LENSES)
def test_exact_corners_give_the_exact_rig_in_every_model(scene, model, method):
    scene = with_lenses(wide(scene) if model == "rational8" else scene, model)
    result = calibrate(scene, scene.views(), distortion=model, method=method)
    assert [camera.model for camera in result.rig.cameras] == [model, model]
    points = [[0.0, 0, 450], [60, -40, 500], [-50, 50, 520]]
    for ours, true in zip(result.rig.cameras, scene.rig.cameras, strict=True):
        np.testing.assert_allclose(ours.project(points), true.project(points), atol=1e-5)
    assert result.rig.baselines_mm[0] == pytest.approx(scene.rig.baselines_mm[0], rel=1e-6)
    assert justified(result) == []


def test_errors_in_a_wider_model_follow_the_stated_covariance(scene):
    scene = with_lenses(scene, "brown5")
    result = calibrate(scene, scene.views(0.1, 3), distortion="brown5")
    delta = scene.rig.difference(result.rig)
    assert len(delta) == 24
    assert delta @ np.linalg.solve(result.covariance, delta) < chi2.ppf(1 - 1e-4, 24)


def test_more_coefficients_are_called_justified_where_the_lens_has_them(scene):
    scene = with_lenses(scene, "brown5")
    views = scene.views(0.03, 0)
    few = calibrate(scene, views)
    (note,) = justified(few)
    enough = calibrate(scene, views, distortion="brown5")
    assert (
        f"brown5 distortion model reconstructs held-out boards to {enough.held_out.rms_mm:.3f}"
        in note
    )
    assert f"radial2 to {few.held_out.rms_mm:.3f} mm" in note
    assert "--distortion brown5" in note
    assert justified(enough) == []


def test_more_coefficients_are_not_called_justified_by_noise(scene):
    for seed in range(5):
        assert justified(calibrate(scene, scene.views(0.1, seed))) == []


def test_a_model_that_does_not_exist_is_refused(scene):
    with pytest.raises(UsageError, match="no distortion model 'fisheye'"):
        calibrate(scene, scene.views(), distortion="fisheye")


def test_real_pairs_do_not_justify_more_than_the_papers_two(shared_data):
    """OpenCV's sample: five coefficients fit better (0.068 for 0.099 px) but measure the same."""
    import cv2

    from pivometer.calibration.corners import find_corners

    board = Board("checkerboard", (10, 7), 30.0)
    views = []
    for camera in ("left", "right"):
        for file in sorted((shared_data / "opencv_stereo").glob(f"{camera}*.jpg")):
            image = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
            views.append(find_corners(image, board, camera=camera, view=f"board/{file.stem[-2:]}"))
    sizes = {"left": (640, 480), "right": (640, 480)}
    two = calibrate_rig(views, board, sizes, reference="left")
    five = calibrate_rig(views, board, sizes, reference="left", distortion="brown5")
    assert five.epipolar_rms_px < 0.8 * two.epipolar_rms_px
    assert five.held_out.rms_mm < 0.13
    assert justified(two) == []


def test_a_narrow_lens_does_not_determine_eight_coefficients(scene):
    with pytest.raises(CalibrationError) as refusal:
        calibrate(scene, scene.views(0.1, 0), distortion="rational8")
    assert "fewer coefficients" in refusal.value.next_step
