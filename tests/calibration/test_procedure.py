import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from pivometer.calibration.board import Board, BoardView
from pivometer.calibration.metric_scale import triangulate_points
from pivometer.calibration.procedure import calibrate_rig
from pivometer.cameras import Rig
from pivometer.errors import BoardNotFoundError, CalibrationError, UsageError
from pivometer.geometry.rigid import RigidTransform

NEAR_RCM_MM = np.array([[0.0, 50.0, 475.0]])


def calibrate(scene, views, **options):
    return calibrate_rig(views, scene.board, scene.sizes, reference="left", **options)


def location_error(truth, rig):
    """Reconstruct a point near the RCM with `rig` from its two true images; error in mm."""
    images = [
        mine.normalized_from_pixels(camera.project(pose.inverse() @ NEAR_RCM_MM))
        for camera, pose, mine in zip(
            truth.cameras, truth.reference_from_camera, rig.cameras, strict=True
        )
    ]
    return triangulate_points(images, rig.reference_from_camera)[0] - NEAR_RCM_MM[0]


def half_turned(view, board):
    return view.renumbered(board.symmetries[1])


@pytest.fixture(scope="module")
def noisy_calibration(scene):
    """At 0.1 px, with some views numbered from the other end."""
    views = [
        half_turned(v, scene.board) if v.camera == "right" and v.view[-1] in "258" else v
        for v in scene.views(0.1, 7)
    ]
    return calibrate(scene, views)


def test_exact_corners_give_the_exact_rig_by_both_routes(scene):
    result = calibrate(scene, scene.views())
    assert np.linalg.norm(location_error(scene.rig, result.rig)) < 1e-6
    assert np.linalg.norm(location_error(scene.rig, result.paper.rig)) < 1e-6
    assert result.edge_length_error.max_mm < 1e-8
    assert result.held_out.max_mm < 1e-8
    assert result.epipolar_rms_px < 1e-9
    assert result.rejected == ()


def test_errors_are_within_the_stated_uncertainty(scene, noisy_calibration):
    delta = scene.rig.difference(noisy_calibration.rig)
    squared = float(delta @ np.linalg.solve(noisy_calibration.covariance, delta))
    assert squared < 42.3  # 99.9 % of χ² with 18 degrees of freedom
    assert noisy_calibration.noise_px == pytest.approx(0.1, rel=0.05)
    assert noisy_calibration.epipolar_rms_px == pytest.approx(0.1, rel=0.1)


def test_half_turned_views_are_put_right_and_said(noisy_calibration):
    note = [n for n in noisy_calibration.notes if "numbered from the other end" in n]
    assert len(note) == 1
    assert "right in board/002" in note[0]


def test_quality_is_told_for_each_camera(noisy_calibration):
    assert [q.name for q in noisy_calibration.cameras] == ["left", "right"]
    for quality in noisy_calibration.cameras:
        assert quality.rms_px == pytest.approx(0.1 * np.sqrt(2), rel=0.1)
        assert quality.view_count == 18
    assert noisy_calibration.held_out.rms_mm >= 0.95 * noisy_calibration.edge_length_error.rms_mm
    assert noisy_calibration.edge_length_error.count == 12 * 82


def test_joint_route_locates_better_than_the_papers(scene):
    """The default's reason: rms location error over four sets at 0.1 px."""
    errors = []
    for seed in range(4):
        result = calibrate(scene, scene.views(0.1, 40 + seed))
        errors.append(
            [np.linalg.norm(location_error(scene.rig, r)) for r in (result.rig, result.paper.rig)]
        )
    joint, paper = np.sqrt(np.mean(np.square(errors), axis=0))
    assert joint < 0.85 * paper


def test_paper_route_is_selectable_and_states_its_own_uncertainty(build_scene):
    scene = build_scene(pairs=8, singles=3)
    views = scene.views(0.1, 9)
    result = calibrate(scene, views, method="paper")
    assert result.method == "paper"
    assert (scene.rig.difference(result.rig) == scene.rig.difference(result.paper.rig)).all()
    assert result.edge_length_error.rms_mm == result.paper.edge_length_error.rms_mm
    delta = scene.rig.difference(result.rig)
    assert float(delta @ np.linalg.solve(result.covariance, delta)) < 60
    assert (np.linalg.eigvalsh(result.covariance) > 0).all()


def test_agrees_with_opencv_on_the_same_corners(scene, noisy_calibration):
    """OpenCV's stereo calibration minimises the same cost, over the pairs only."""
    views = [v for v in noisy_calibration.views if v.view.startswith("board")]
    scene = replace(scene, board=replace(scene.board, form="flat"))  # OpenCV knows no other
    result = calibrate(scene, views)
    board = [scene.board.corners_mm.astype(np.float32)] * 12
    images = [
        [v.pixels.astype(np.float32) for v in result.views if v.camera == name]
        for name in ("left", "right")
    ]
    start = [c.calibration_matrix.copy() for c in scene.rig.cameras]
    dist = [np.array([*c.distortion, 0, 0, 0]) for c in scene.rig.cameras]
    flags = cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_USE_INTRINSIC_GUESS
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-14)
    value, K1, _, K2, _, R, T, *_ = cv2.stereoCalibrate(
        board, *images, start[0], dist[0], start[1], dist[1], (640, 480),
        flags=flags, criteria=criteria,
    )  # fmt: skip
    # OpenCV starts the pose from a median and may stop early; ours must not be worse
    ours = np.sqrt(np.mean([q.rms_px**2 for q in result.cameras]))
    assert ours < value * 1.001
    pose = RigidTransform(R, T.ravel()).inverse()
    other = Rig(
        [
            c.with_parameters([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *c.distortion])
            for c, K in zip(result.rig.cameras, (K1, K2), strict=True)
        ],
        [RigidTransform.identity(), pose],
    )
    u = np.sqrt(np.diag(result.covariance))
    names = result.rig.parameter_names
    same = [i for i, name in enumerate(names) if not name.endswith((".k1", ".k2"))]
    assert (np.abs(result.rig.difference(other))[same] < 0.2 * u[same]).all()


def test_three_cameras_are_calibrated_together(three_cameras):
    scene = three_cameras
    views = [
        half_turned(v, scene.board) if v.camera == "top" and v.view[-1] in "36" else v
        for v in scene.views(0.1, 3)
    ]
    result = calibrate(scene, views)
    assert [c.name for c in result.rig.cameras] == ["left", "right", "top"]
    delta = scene.rig.difference(result.rig)
    squared = float(delta @ np.linalg.solve(result.covariance, delta))
    assert squared < 59.7  # 99.9 % of χ² with 30 degrees of freedom


def test_any_camera_can_be_the_reference(scene):
    result = calibrate_rig(scene.views(), scene.board, scene.sizes, reference="right")
    assert result.rig.reference == "right"
    truth = scene.rig.reference_from_camera[1].inverse()
    np.testing.assert_allclose(
        result.rig.reference_from_camera[1].translation_mm, truth.translation_mm, atol=1e-6
    )


def test_uncertainty_of_the_square_size_scales_the_baseline(scene):
    views = scene.views(0.1, 7)
    board = Board("checkerboard", (9, 7), 15.0, square_u_mm=0.015)
    plain = calibrate(scene, views)
    scaled = calibrate_rig(views, board, scene.sizes, reference="left")
    names = plain.rig.parameter_names
    x = names.index("right.tx_mm")
    added = scaled.covariance[x, x] - plain.covariance[x, x]
    baseline_x = plain.rig.reference_from_camera[1].translation_mm[0]
    assert np.sqrt(added) == pytest.approx(1e-3 * baseline_x, rel=1e-6)
    assert scaled.covariance[0, 0] == plain.covariance[0, 0]


@pytest.mark.parametrize("shift_mm", [(3.0, 0, 0), (0, 3.0, 0), (0, 0, 3.0), (0, 1.0, 0)])
def test_a_pair_with_a_slightly_moved_board_is_rejected(scene, shift_mm):
    """A few mm between the exposures: too little to confuse the numbering."""
    views = scene.views(0.05, 2)
    at = next(i for i, v in enumerate(views) if (v.camera, v.view) == ("right", "board/004"))
    pose = scene.camera_from_board("right", "board/004")
    moved = RigidTransform(pose.rotation, pose.translation_mm + np.array(shift_mm))
    views[at] = scene.view("right", "board/004", moved)
    result = calibrate(scene, views)
    assert {(r.camera, r.view) for r in result.rejected} == {
        ("left", "board/004"),
        ("right", "board/004"),
    }
    assert "board moved" in result.rejected[0].reason
    assert np.linalg.norm(location_error(scene.rig, result.rig)) < 1.0


def test_cameras_that_never_agree_are_refused(scene):
    """Every pair out of step by 0.5 to 2 mm, as unsynchronised cameras are."""
    rng = np.random.default_rng(0)
    views = []
    for view in scene.views(0.05, 2):
        if view.camera == "right" and view.view.startswith("board"):
            pose = scene.camera_from_board("right", view.view)
            shift = rng.uniform(0.5, 2, 3) * rng.choice([-1, 1], 3)
            view = scene.view(
                "right", view.view, RigidTransform(pose.rotation, pose.translation_mm + shift)
            )
        views.append(view)
    with pytest.raises(CalibrationError, match="no common rig fits") as info:
        calibrate(scene, views)
    assert "hold the board still" in info.value.next_step


def test_two_pairs_are_refused(scene):
    few = scene.only(lambda m: not m.startswith("board") or m < "board/002")
    # two moments of a symmetric board may also be ambiguous; either way both cameras are named
    with pytest.raises(CalibrationError, match="cameras left and right"):
        calibrate(few, few.views())


def test_cameras_without_shared_moments_are_named(scene):
    views = [
        BoardView(v.camera, f"{v.camera}/{v.view}", v.ids, v.pixels, v.sigma_px)
        for v in scene.views()
    ]
    with pytest.raises(CalibrationError, match="camera right at the same moment as by left"):
        calibrate(scene, views)


def test_a_camera_without_views_is_named(scene):
    with pytest.raises(CalibrationError, match="camera right: 0 usable board views"):
        calibrate(scene, [v for v in scene.views() if v.camera == "left"])


@pytest.mark.parametrize(
    ("sizes", "reference", "method"),
    [
        ({"left": (640, 480), "right": (640, 480)}, "middle", "joint"),
        ({"left": (640, 480), "top": (640, 480)}, "left", "joint"),
        ({"left": (640, 480)}, "left", "joint"),
        ({"left": (640, 480), "right": (640, 480)}, "left", "guess"),
    ],
)
def test_impossible_requests_are_refused(scene, sizes, reference, method):
    with pytest.raises(UsageError):
        calibrate_rig(scene.views(), scene.board, sizes, reference=reference, method=method)


def found_views(folder, board, names):
    from pivometer.calibration.corners import find_corners

    views = []
    for camera, view, path in names:
        image = cv2.imread(str(folder / path), cv2.IMREAD_GRAYSCALE)
        try:
            views.append(find_corners(image, board, camera=camera, view=view))
        except BoardNotFoundError:
            continue
    return views


def test_real_pairs_give_the_known_baseline(shared_data):
    """OpenCV's sample pairs: ‖T‖ = 99.808 mm by Bouguet's toolbox."""
    folder = shared_data / "opencv_stereo"
    board = Board("checkerboard", (10, 7), 30.0)
    names = [
        (camera, f"board/{i:02d}", f"{camera}{i:02d}.jpg")
        for camera in ("left", "right")
        for i in range(1, 15)
        if i != 10
    ]
    views = found_views(folder, board, names)
    sizes = {"left": (640, 480), "right": (640, 480)}
    result = calibrate_rig(views, board, sizes, reference="left")
    assert len(views) == 26
    assert result.rig.baselines_mm[0] == pytest.approx(99.808, abs=0.5)
    assert result.paper.rig.baselines_mm[0] == pytest.approx(99.808, abs=0.5)
    assert result.held_out.rms_mm < 0.13
    assert result.held_out.max_mm < 0.65


@pytest.mark.parametrize("name", ["bearing_white", "arm_black_clutter"])
def test_rendered_boards_locate_the_rcm(shared_data, name):
    folder = shared_data / "rendered" / name
    truth = json.loads((folder / "truth.json").read_text())
    board = Board("checkerboard", (9, 7), 15.0)
    names = [
        (camera, f"{kind}/{stem}" if kind == "board" else f"{kind}/{camera}/{stem}", path)
        for camera in ("left", "right")
        for kind in ("board", "intrinsics")
        for stem, path in (
            (f.stem, f"{kind}/{camera}/{f.name}")
            for f in sorted((folder / kind / camera).iterdir())
        )
    ]
    views = found_views(folder, board, names)
    sizes = {"left": (640, 480), "right": (640, 480)}
    result = calibrate_rig(views, board, sizes, reference="left")
    pose = truth["stereo"]["paper_p_l_eq_R_p_r_plus_t"]
    cameras = []
    for camera in result.rig.cameras:
        known = truth["cameras"][camera.name]
        K, beta = np.array(known["K"]), known["dist_k1k2p1p2k3"][:2]
        cameras.append(camera.with_parameters([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *beta]))
    true_rig = Rig(cameras, [RigidTransform.identity(), RigidTransform(pose["R"], pose["t_mm"])])
    # 16 views a camera at 0.008 px: the stated standard uncertainty there is about 0.07 mm
    assert np.linalg.norm(location_error(true_rig, result.rig)) < 0.25
    assert result.held_out.rms_mm < 0.01
