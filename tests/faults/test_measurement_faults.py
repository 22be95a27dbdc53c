"""What bad pictures get: the bad pose or view is thrown out with its reason, and the rest go on."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

import pivometer
from pivometer import pipeline
from pivometer.cli import main
from pivometer.errors import (
    CalibrationError,
    DataError,
    DegenerateGeometryError,
    SessionError,
    TooFewPosesError,
    UsageError,
)

POSES = 6


@pytest.fixture(scope="module")
def good(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("good") / "session"
    return pipeline.simulate("gold", folder, poses=POSES, board_pairs=6, single_views=2)


@pytest.fixture(scope="module")
def rig(good):
    return pivometer.calibrate(pivometer.load(good))


@pytest.fixture
def session(good, tmp_path) -> Path:
    copy = tmp_path / "session"
    shutil.copytree(good, copy)
    return copy


def rejected(session, rig) -> dict[str, str]:
    result = pivometer.measure(pivometer.load(session), rig=rig)
    assert len(result.used) + len(result.rejected) == POSES
    assert all(pose.next_step for pose in result.rejected)
    return {pose.pose: pose.reason for pose in result.rejected}


def blank(path: Path, *, grey: int = 10) -> None:
    noise = np.random.default_rng(0).normal(grey, 2, size=(480, 640))
    cv2.imwrite(str(path), np.clip(noise, 0, 255).astype(np.uint8))


def test_a_good_session_rejects_nothing(session, rig):
    assert rejected(session, rig) == {}


def test_a_missing_partner_rejects_its_pose(session, rig):
    (session / "shaft/right/002.png").unlink()
    assert rejected(session, rig) == {"002": "camera right has no image of this pose"}


def test_a_truncated_image_rejects_its_pose_and_is_named(session, rig):
    path = session / "shaft/left/001.png"
    path.write_bytes(path.read_bytes()[:-5000])
    reasons = rejected(session, rig)
    assert list(reasons) == ["001"]
    assert "001.png" in reasons["001"]


def test_another_size_rejects_its_pose(session, rig):
    path = session / "shaft/left/003.png"
    cv2.imwrite(str(path), cv2.imread(str(path))[::2, ::2])
    reasons = rejected(session, rig)
    assert list(reasons) == ["003"]
    assert "320×240 px" in reasons["003"]


def test_a_picture_given_twice_counts_once(session, rig):
    for camera in ("left", "right"):
        shutil.copy(session / f"shaft/{camera}/001.png", session / f"shaft/{camera}/004.png")
    reasons = rejected(session, rig)
    assert list(reasons) == ["004"]
    assert "that of pose 001, to the byte" in reasons["004"]


def test_an_image_without_the_shaft_rejects_its_pose(session, rig):
    blank(session / "shaft/right/004.png")
    reasons = rejected(session, rig)
    assert list(reasons) == ["004"]
    assert "camera right" in reasons["004"]


def test_no_shaft_anywhere_is_refused(session, rig):
    for path in session.glob("shaft/*/*.png"):
        blank(path)
    with pytest.raises(TooFewPosesError, match=f"0 of {POSES} poses are usable") as caught:
        pivometer.measure(pivometer.load(session), rig=rig)
    assert caught.value.exit_code == 3


def test_a_session_without_shaft_images_is_refused_before_it_is_calibrated(session):
    shutil.rmtree(session / "shaft")
    told = []
    with pytest.raises(SessionError, match="no shaft images"):
        pivometer.measure(pivometer.load(session), progress=lambda *stage: told.append(stage))
    assert told == []


def test_fewer_than_three_poses_are_refused(session, rig):
    for path in session.glob("shaft/*/*.png"):
        if path.stem not in ("000", "001"):
            path.unlink()
    with pytest.raises(TooFewPosesError, match="of 2 poses are usable"):
        pivometer.measure(pivometer.load(session), rig=rig)


def test_a_static_tool_is_refused(session, rig):
    for camera in ("left", "right"):
        for pose in range(1, POSES):
            target = session / f"shaft/{camera}/{pose:03}.png"
            shutil.copy(session / f"shaft/{camera}/000.png", target)
    with pytest.raises(DegenerateGeometryError) as caught:
        pivometer.measure(pivometer.load(session), rig=rig)
    assert caught.value.exit_code == 3
    assert caught.value.next_step


def test_poses_of_swapped_cameras_are_not_measured(session, rig):
    for path in (session / "shaft/left").glob("*.png"):
        other = session / "shaft/right" / path.name
        left, right = path.read_bytes(), other.read_bytes()
        path.write_bytes(right)
        other.write_bytes(left)
    with pytest.raises(DataError):
        pivometer.measure(pivometer.load(session), rig=rig)


def test_a_bad_board_view_is_rejected_and_the_rest_go_on(session):
    blank(session / "board/left/002.png")
    path = session / "board/right/003.png"
    path.write_bytes(path.read_bytes()[:-5000])
    cv2.imwrite(str(session / "intrinsics/left/000.png"), np.zeros((100, 100), np.uint8))
    calibration = pivometer.calibrate(pivometer.load(session))
    named = {(view.camera, view.view) for view in calibration.rejected}
    assert {("left", "board/002"), ("right", "board/003"), ("left", "intrinsics/left/000")} <= named
    assert all(view.reason for view in calibration.rejected)


@pytest.mark.parametrize("squares", ["[8, 7]", "[9, 8]"])
def test_a_wrong_board_is_refused_with_the_right_one(session, squares):
    keep_moments(session, ["000", "001", "002"])
    text = (session / "session.toml").read_text(encoding="utf-8")
    (session / "session.toml").write_text(text.replace("[9, 7]", squares), encoding="utf-8")
    with pytest.raises(CalibrationError, match=r"image shows one of 9×7|goes on beyond"):
        pivometer.calibrate(pivometer.load(session))


def test_no_board_anywhere_is_refused(session):
    keep_moments(session, ["000", "001", "002"])
    for path in session.glob("board/*/*.png"):
        blank(path)
    with pytest.raises(CalibrationError, match="6 of them: no checkerboard of 9×7"):
        pivometer.calibrate(pivometer.load(session))


def keep_moments(session, moments) -> None:
    shutil.rmtree(session / "intrinsics")
    for path in session.glob("board/*/*.png"):
        if path.stem not in moments:
            path.unlink()


def test_the_rig_of_other_cameras_is_refused(session, rig):
    text = (session / "session.toml").read_text(encoding="utf-8")
    (session / "session.toml").write_text(
        text.replace('reference = "left"', 'reference = "right"'), encoding="utf-8"
    )
    with pytest.raises(UsageError, match="calibration is of cameras left, right"):
        pivometer.measure(pivometer.load(session), rig=rig)


def test_the_command_line_says_the_same_and_keeps_old_results(session, capsys):
    assert main(["measure", str(session)]) == 0
    before = (session / "results/result.json").read_bytes()
    for path in session.glob("shaft/*/*.png"):
        blank(path)
    assert main(["measure", str(session), "--rig", str(session / "results/rig.json")]) == 3
    shown = capsys.readouterr().err
    assert "poses are usable" in shown
    assert "Traceback" not in shown
    assert (session / "results/result.json").read_bytes() == before
