"""Views that are good for each camera alone, and fit no rig: the cause is named."""

import re
from dataclasses import replace

import numpy as np
import pytest

from pivometer.calibration import calibrate_rig
from pivometer.calibration.board import BoardView
from pivometer.calibration.diagnosis import diagnosed
from pivometer.errors import CalibrationError


def failure(views, scene) -> CalibrationError:
    with pytest.raises(CalibrationError) as caught:
        calibrate_rig(views, scene.board, scene.sizes, reference="left")
    return diagnosed(caught.value, views, scene.board, scene.sizes)


def mirrored(view: BoardView, board, width=640) -> BoardView:
    """What a detector makes of the mirrored picture: corners numbered right-handed again."""
    across, down = board.inner_corners
    ids = np.arange(board.corner_count).reshape(down, across)[:, ::-1].ravel()
    order = np.argsort(ids)
    pixels = view.pixels * [-1, 1] + [width - 1, 0]
    return BoardView(view.camera, view.view, ids[order], pixels[order], view.sigma_px[order])


@pytest.mark.parametrize("squares", [(9, 7), (8, 7)])
@pytest.mark.parametrize("camera", ["left", "right"])
def test_mirrored_images_of_one_camera_are_told(build_scene, squares, camera):
    scene = build_scene(squares=squares)
    views = [mirrored(v, scene.board) if v.camera == camera else v for v in scene.views(0.05)]
    told = failure(views, scene)
    assert "mirrored" in told.what
    assert camera in told.what
    assert "board/000" in told.what


@pytest.mark.parametrize("late", [1, -2])
def test_files_one_or_two_moments_off_are_told(build_scene, late):
    scene = build_scene(squares=(8, 7))
    names = [m for m in scene.moments if m.startswith("board/")]
    other = dict(zip(names, names[-late:] + names[:-late], strict=True))
    views = [
        replace(v, view=other.get(v.view, v.view)) if v.camera == "right" else v
        for v in scene.views(0.05)
    ]
    told = failure(views, scene)
    assert re.search(f"only {abs(late)} moments? apart", told.what)


def test_views_of_different_moments_keep_the_first_reason(build_scene):
    scene = build_scene(squares=(8, 7))
    stranger = build_scene(squares=(8, 7), seed=9)
    views = [v for v in scene.views(0.05) if v.camera == "left"]
    views += [v for v in stranger.views(0.05) if v.camera == "right"]
    told = failure(views, scene)
    assert "moments agree" in told.what


def moved_in_one_camera(scene, moments, shift_mm, seed=3):
    """Views of a board that moved by `shift_mm` before camera right saw it at some moments."""
    random = np.random.default_rng(seed)
    views = []
    for view in scene.views(0.05):
        if view.camera == "right" and view.view in moments:
            pose = scene.camera_from_board("right", view.view)
            step = random.standard_normal(3)
            pose = replace(
                pose, translation_mm=pose.translation_mm + shift_mm * step / np.linalg.norm(step)
            )
            moved = scene.view("right", view.view, pose)
            view = replace(view, pixels=moved.pixels)
        views.append(view)
    return views


def test_cameras_that_agree_at_some_moments_only_are_not_averaged(scene):
    moments = [f"board/{number:03d}" for number in (1, 3, 4, 8, 10)]
    told = failure(moved_in_one_camera(scene, moments, 3.0), scene)
    assert "not synchronised" in told.what
    named = set(re.findall(r"board/\d+", told.what))
    assert named <= set(moments)
    assert len(named) >= 4  # a board that moved along the sight of a camera is hard to tell
    assert "filmed" not in told.what  # these pictures are far apart


def test_one_moment_at_which_the_board_moved_is_left_out(scene):
    views = moved_in_one_camera(scene, ["board/003"], 3.0)
    found = calibrate_rig(views, scene.board, scene.sizes, reference="left")
    assert {(r.camera, r.view) for r in found.rejected} == {
        ("left", "board/003"),
        ("right", "board/003"),
    }
