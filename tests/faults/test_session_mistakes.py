"""Mistakes in a session that no single picture shows are named with their files."""

import re
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import pivometer
from pivometer import pipeline
from pivometer.errors import CalibrationError
from pivometer.pipeline.diagnosing import flat_poses_finding, scale_finding

POSES = 7


@pytest.fixture(scope="module")
def good(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("good") / "session"
    counts = {"poses": POSES, "board_pairs": 6, "single_views": 2, "reference_views": 1}
    return pipeline.simulate("gold", folder, **counts)


@pytest.fixture(scope="module")
def rig(good):
    return pivometer.calibrate(pivometer.load(good))


@pytest.fixture
def session(good, tmp_path) -> Path:
    copy = tmp_path / "session"
    shutil.copytree(good, copy)
    return copy


def exchange(one: Path, other: Path) -> None:
    one.rename(one.parent / "kept")
    other.rename(one)
    (one.parent / "kept").rename(other)


def edit(session: Path, old: str, new: str) -> None:
    path = session / "session.toml"
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


def warnings_of(session: Path, rig) -> str:
    return " ".join(f.text for f in pivometer.measure(pivometer.load(session), rig=rig).findings)


def test_a_good_session_has_none_of_these(session, rig):
    shutil.move(session / "reference", session / "closing")
    told = warnings_of(session, rig)
    assert "moved" not in told
    assert "square_mm" not in told


def test_cameras_exchanged_between_board_and_shaft_are_refused(session, rig):
    exchange(session / "shaft/left", session / "shaft/right")
    with pytest.raises(CalibrationError, match="cameras exchanged") as caught:
        pivometer.measure(pivometer.load(session), rig=rig)
    assert "shaft/left was taken by camera right" in caught.value.what


def test_files_of_the_shaft_one_pose_off_are_refused(session, rig):
    folder = session / "shaft/right"
    (folder / f"{POSES - 1:03d}.png").unlink()
    for number in reversed(range(POSES - 1)):
        (folder / f"{number:03d}.png").rename(folder / f"{number + 1:03d}.png")
    with pytest.raises(CalibrationError, match="1 pose off") as caught:
        pivometer.measure(pivometer.load(session), rig=rig)
    assert "shaft/right" in caught.value.next_step


def test_a_shaft_of_quite_another_diameter_names_the_square_that_would_explain_it(session, rig):
    edit(session, "diameter_mm = 10.0", "diameter_mm = 8.0")
    with pytest.raises(CalibrationError, match=r"square_mm would have to be 1[12]\.\d+ instead of"):
        pivometer.measure(pivometer.load(session), rig=rig)


def test_a_diameter_somewhat_off_is_a_warning_with_the_square(session, rig):
    edit(session, "diameter_mm = 10.0", "diameter_mm = 10.5")
    result = pivometer.measure(pivometer.load(session), rig=rig)
    finding = scale_finding(result)
    assert finding.text in [f.text for f in result.findings]
    assert "square_mm would have to be 15.7" in finding.text


def test_without_a_stated_diameter_nothing_says_that_it_is_the_shaft(session, rig):
    edit(session, "diameter_mm = 10.0", "")
    result = pivometer.measure(pivometer.load(session), rig=rig)
    finding = scale_finding(result)
    assert finding.text in [f.text for f in result.findings]
    assert re.search(r"is (9\.9|10\.0)\d mm thick", finding.text)


def test_poses_with_nearly_one_centerline_plane_are_named(session, rig):
    result = pivometer.measure(pivometer.load(session), rig=rig)
    assert flat_poses_finding(result) is None
    first, *rest = result.used
    flat = replace(result, poses=(replace(first, dihedral_deg=19.9), *rest))
    assert f"({first.pose})" in flat_poses_finding(flat).text


def test_a_camera_bumped_before_the_closing_views_is_found(session, rig):
    shutil.copytree(session / "reference", session / "closing")
    path = session / "closing/right/000.png"
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    # 1.5 px down is a nod of 1.5 mrad
    moved = cv2.warpAffine(
        image, np.array([[1, 0, 0], [0, 1, 1.5]]), (640, 480), borderMode=cv2.BORDER_REPLICATE
    )
    cv2.imwrite(str(path), moved)
    told = warnings_of(session, rig)
    assert "moved between the calibration and the closing images (closing/000)" in told
    assert "mm" in told


def test_closing_pictures_without_the_board_are_told(session, rig):
    shutil.move(session / "reference", session / "closing")
    (session / "closing/left/000.png").unlink()
    assert "cannot be ruled out" in warnings_of(session, rig)
