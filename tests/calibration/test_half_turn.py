import numpy as np
import pytest

from pivometer.calibration.board import Board
from pivometer.calibration.half_turn import (
    PosedView,
    board_turns,
    camera_tree,
    numbered_alike,
    relative_pose_by_vote,
)
from pivometer.errors import CalibrationError
from pivometer.geometry.rigid import RigidTransform, rotation_from_vector


def posed_views(scene, turned=(), noise=None):
    """Return views with poses as each camera alone finds them, some numbered from another end."""
    turns = board_turns(scene.board)
    result = []
    for view in scene.views():
        pose = scene.camera_from_board(view.camera, view.view)
        if noise is not None:
            tilt = rotation_from_vector(noise.normal(0, 0.01, 3))
            pose = RigidTransform(tilt @ pose.rotation, pose.translation_mm + noise.normal(0, 1, 3))
        choice = dict(turned).get((view.camera, view.view), 0)
        view = view.renumbered(scene.board.symmetries[choice])
        result.append(PosedView(view, pose @ turns[choice]))
    return result


def split(posed):
    pairs = [p for p in posed if p.view.view.startswith("board")]
    return [p for p in pairs if p.view.camera == "left"], [
        p for p in pairs if p.view.camera == "right"
    ]


def some_turned(scene, rng, count=2):
    return {
        (c, m): int(rng.integers(count))
        for m in scene.moments
        for c in scene.who(m)
        if m.startswith("board")
    }


@pytest.mark.parametrize("squares", [(9, 7), (7, 7), (10, 7)])
def test_turns_bring_renumbered_corners_back(squares):
    board = Board("checkerboard", squares, 15.0)
    for turn, symmetry in zip(board_turns(board), board.symmetries, strict=True):
        X = board.corners_mm
        np.testing.assert_allclose(turn @ X[symmetry], X, atol=1e-9)


@pytest.mark.parametrize(("squares", "count"), [((9, 7), 2), ((7, 7), 4), ((10, 7), 1)])
def test_numbering_is_found_whatever_end_each_camera_began_at(build_scene, squares, count):
    scene = build_scene(squares=squares, singles=0, pairs=8)
    for seed in range(3):
        rng = np.random.default_rng(seed)
        posed = posed_views(scene, some_turned(scene, rng, count), rng)
        cameras = scene.rig.cameras
        pose = relative_pose_by_vote(*split(posed), scene.board, cameras)
        truth = scene.rig.reference_from_camera[1]
        turn = pose.rotation @ truth.rotation.T
        assert np.degrees(np.arccos((np.trace(turn) - 1) / 2)) < 5  # a wrong one is 90° or 180° off
        numbering = numbered_alike(posed, scene.board, replace_pose(scene.rig, pose))
        assert numbering.rejected == ()
        assert_alike(scene, numbering.views)


def replace_pose(rig, pose):
    return type(rig)(rig.cameras, [rig.reference_from_camera[0], pose])


def assert_alike(scene, posed):
    """Check that corresponding corners are images of one and the same point of the board."""
    by_moment = {}
    for p in posed:
        by_moment.setdefault(p.view.view, []).append(p)
    for moment, together in by_moment.items():
        choices = {
            next(
                k
                for k, symmetry in enumerate(scene.board.symmetries)
                if np.allclose(
                    scene.view(p.view.camera, moment).renumbered(symmetry).pixels, p.view.pixels
                )
            )
            for p in together
        }
        assert len(choices) == 1


def test_renumbered_poses_follow_their_corners(scene):
    rng = np.random.default_rng(1)
    numbering = numbered_alike(posed_views(scene, some_turned(scene, rng)), scene.board, scene.rig)
    assert 0 < len(numbering.turned) < 12
    for p in numbering.views:
        camera = scene.rig.cameras[scene.rig.index(p.view.camera)]
        pixels = camera.project(p.camera_from_board @ scene.board.corners_mm)
        np.testing.assert_allclose(pixels[p.view.ids], p.view.pixels, atol=1e-6)


def test_three_cameras_are_numbered_alike(three_cameras):
    scene = three_cameras
    posed = posed_views(scene, some_turned(scene, np.random.default_rng(2)))
    numbering = numbered_alike(posed, scene.board, scene.rig)
    assert_alike(scene, numbering.views)


def test_one_pair_of_a_symmetric_board_is_ambiguous(scene):
    one = scene.only(lambda m: m == "board/003")
    with pytest.raises(CalibrationError, match="looks the same after a turn and 1 moments fit two"):
        relative_pose_by_vote(*split(posed_views(one)), scene.board, scene.rig.cameras)


def test_one_pair_of_an_asymmetric_board_is_not(build_scene):
    scene = build_scene(squares=(10, 7), pairs=1, singles=0)
    pose = relative_pose_by_vote(*split(posed_views(scene)), scene.board, scene.rig.cameras)
    np.testing.assert_allclose(
        pose.rotation, scene.rig.reference_from_camera[1].rotation, atol=1e-9
    )


def test_a_board_moved_between_the_exposures_is_rejected_with_its_reason(scene):
    posed = posed_views(scene)
    at = next(
        i for i, p in enumerate(posed) if p.view.view == "board/002" and p.view.camera == "right"
    )
    moved = RigidTransform(rotation_from_vector([0, 0, 0.9]), np.array([5.0, -10, 20]))
    pose = posed[at].camera_from_board @ moved
    posed[at] = PosedView(scene.view("right", "board/002", pose), pose)
    pose = relative_pose_by_vote(*split(posed), scene.board, scene.rig.cameras)
    numbering = numbered_alike(posed, scene.board, replace_pose(scene.rig, pose))
    assert [(r.camera, r.view) for r in numbering.rejected] == [("right", "board/002")]
    assert "camera left" in numbering.rejected[0].reason
    assert "board moved" in numbering.rejected[0].reason


def test_moments_that_never_agree_are_refused(scene):
    """Every file name matched to another moment."""
    first, second = split(posed_views(scene))
    shifted = [
        PosedView(replace_name(q.view, p.view.view), q.camera_from_board)
        for p, q in zip(first, second[1:] + second[:1], strict=True)
    ]
    with pytest.raises(CalibrationError, match=r"cameras left and right: only \d+ of 12 moments"):
        relative_pose_by_vote(first, shifted, scene.board, scene.rig.cameras)


def replace_name(view, name):
    return type(view)(view.camera, name, view.ids, view.pixels, view.sigma_px)


def test_tree_follows_most_shared_moments(three_cameras):
    views = three_cameras.views()
    few = [v for v in views if not (v.camera == "top" and v.view < "board/008")]
    # top shares only two moments with either camera
    tree = camera_tree(few, ["left", "right", "top"])
    assert tree[0] == ("left", "right")
    assert tree[1][1] == "top"


def test_a_camera_without_shared_moments_is_named(three_cameras):
    views = [
        v for v in three_cameras.views() if v.camera != "top" or v.view.startswith("intrinsics")
    ]
    with pytest.raises(CalibrationError, match="camera top at the same moment"):
        camera_tree(views, ["left", "right", "top"])
