"""A board fixed near the RCM: the frame users want, from images to the result."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

import pivometer
from pivometer import pipeline
from pivometer.calibration.half_turn import board_turns
from pivometer.geometry import RigidTransform
from pivometer.io.result import read_result
from pivometer.uncertainty import lies_within


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("reference") / "session"
    counts = {"poses": 8, "board_pairs": 6, "single_views": 2, "reference_views": 2}
    return pipeline.simulate("gold", root, **counts)


@pytest.fixture(scope="module")
def rig(folder):
    return pivometer.calibrate(pivometer.load(folder))


def true_location(folder: Path, like: RigidTransform, board) -> np.ndarray:
    """The true RCM in the true board's frame, of the frames the board allows the one found."""
    pose = json.loads((folder / "truth.json").read_text())["reference_from_board"]["reference"][0]
    true = RigidTransform(pose["rotation"], pose["translation_mm"])
    frames = [true @ turn for turn in board_turns(board)]
    nearest = min(frames, key=lambda frame: np.abs(frame.rotation - like.rotation).max())
    return nearest.inverse() @ pipeline.true_rcm(folder).least_squares.point_mm


def test_the_location_in_the_boards_frame_is_near_the_truth_and_covered(folder, rig, tmp_path):
    session = pivometer.load(folder)
    result = pivometer.measure(session, rig=rig)
    frame = result.board_frame
    truth = true_location(folder, frame.reference_from_board, session.board)
    assert np.linalg.norm(frame.least_squares_point_mm - truth) < 0.05
    assert lies_within(
        truth,
        frame.least_squares_point_mm,
        frame.uncertainty.total_mm2,
        degrees_of_freedom=frame.uncertainty.degrees_of_freedom,
    )
    assert np.trace(frame.uncertainty.total_mm2) < np.trace(result.uncertainty.total_mm2)
    line, camera = frame.centerlines[3], result.used[3].centerline
    assert np.allclose(frame.reference_from_board @ line.point_mm, camera.point_mm)
    assert np.allclose(frame.reference_from_board.rotate(line.direction), camera.direction)
    assert "reference/left/001.png" in result.inputs
    files = pipeline.write_measurement(result, session, tmp_path / "results")
    assert "frame of the reference board" in files["report.html"].read_text(encoding="utf-8")
    again = read_result(files["result.json"]).board_frame
    np.testing.assert_array_equal(again.least_squares_point_mm, frame.least_squares_point_mm)


def test_a_board_that_moved_gives_no_frame_but_a_finding(folder, rig, tmp_path):
    copy = tmp_path / "session"
    shutil.copytree(folder, copy)
    path = copy / "reference/right/001.png"
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    cv2.imwrite(str(path), np.roll(image, 2, axis=1))
    result = pivometer.measure(pivometer.load(copy), rig=rig)
    assert result.board_frame is None
    (finding,) = [f for f in result.findings if "reference board" in f.text]
    assert finding.severity == "warning"
    assert "reference/001" in finding.text
    assert "camera right" in finding.text


def test_pictures_without_the_board_give_no_frame_but_a_finding(folder, rig, tmp_path):
    copy = tmp_path / "session"
    shutil.copytree(folder, copy)
    for path in sorted(copy.glob("reference/*/*.png")):
        cv2.imwrite(str(path), np.full((480, 640), 90, dtype=np.uint8))
    result = pivometer.measure(pivometer.load(copy), rig=rig)
    assert result.board_frame is None
    (finding,) = [f for f in result.findings if "reference board" in f.text]
    assert "no camera saw" in finding.text
