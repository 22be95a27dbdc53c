"""A session whose cameras have gamma is told by its board, and keeps its scale."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import pivometer
from pivometer import pipeline
from pivometer.calibration.response import CameraResponse
from pivometer.errors import CalibrationError
from pivometer.io.result import read_rig, rig_text
from pivometer.pipeline.diagnosing import refuse_other_scale, scale_finding
from pivometer.pipeline.responding import bent_cameras, moved_outward_px, response_findings

GAMMA = 2.2


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("linear") / "session"
    return pipeline.simulate("gold", folder, poses=3, board_pairs=6, single_views=0)


@pytest.fixture(scope="module")
def straight(folder):
    return pivometer.calibrate(pivometer.load(folder))


@pytest.fixture(scope="module")
def bent(folder, tmp_path_factory):
    """The calibration from the same pictures as cameras with gamma take them."""
    copy = tmp_path_factory.mktemp("bent") / "session"
    shutil.copytree(folder, copy)
    for path in [*copy.glob("board/*/*.png"), *copy.glob("intrinsics/*/*.png")]:
        grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        cv2.imwrite(str(path), np.rint(255 * (grey / 255) ** (1 / GAMMA)).astype(np.uint8))
    return pivometer.calibrate(pivometer.load(copy))


def test_linear_cameras_are_told_to_be_linear(straight):
    assert all(camera.response.view_count == 6 for camera in straight.cameras)
    assert bent_cameras(straight) == {}
    assert "linear" not in " ".join(straight.notes)


def test_cameras_with_gamma_are_named_with_about_their_exponent(bent):
    assert list(bent_cameras(bent)) == ["left", "right"]
    assert [c.response.gamma for c in bent.cameras] == pytest.approx([GAMMA, GAMMA], rel=0.15)
    notes = [note for note in bent.notes if "does not record light linearly" in note]
    assert [note.split()[1] for note in notes] == ["left", "right"]


def test_a_rig_keeps_its_cameras_responses_and_older_files_have_none(bent, tmp_path):
    path = tmp_path / "rig.json"
    path.write_text(rig_text(bent, software="test"), encoding="utf-8")
    assert bent_cameras(read_rig(path)).keys() == bent_cameras(bent).keys()
    content = json.loads(path.read_text(encoding="utf-8"))
    for camera in content["calibration"]["cameras"]:
        del camera["response"]
    path.write_text(json.dumps(content), encoding="utf-8")
    assert bent_cameras(read_rig(path)) == {}


def with_response(measurement, response: CameraResponse):
    first, *rest = measurement.calibration.cameras
    cameras = (replace(first, response=response), *rest)
    return replace(measurement, calibration=replace(measurement.calibration, cameras=cameras))


def off_by(measurement, part: float):
    median = np.median([d for pose in measurement.used for d in pose.diameters_mm])
    setup = replace(measurement.setup, diameter_mm=float(median) / (1 + part))
    return replace(measurement, setup=setup, shaft=None)


def test_a_diameter_that_gamma_makes_wrong_is_not_called_the_scale(make_measurement):
    plain = off_by(make_measurement(), -0.05)
    assert "square_mm would have to be" in scale_finding(plain).text
    measurement = with_response(plain, CameraResponse(0.6, 0.01, 2.2, 0.03, 12))
    finding = scale_finding(measurement)
    assert "says nothing of the scale" in finding.text
    assert "square_mm" not in finding.text
    assert "do not correct square_mm" in finding.next_step
    (told,) = response_findings(measurement)
    assert "gamma of about 2.2" in told.text
    assert "dark shaft before something bright measures too thin" in told.text


def test_the_board_tells_how_far_the_shafts_edges_are_moved(make_measurement):
    measurement = make_measurement()
    edges = [pose.edges for pose in measurement.used]
    assert moved_outward_px(measurement.calibration, edges) == [0.0, 0.0]
    response = CameraResponse(0.6, 0.01, 2.2, 0.03, 12)
    bent = with_response(measurement, response).calibration
    names = [camera.name for camera in bent.rig.cameras]
    blurs = [
        np.median([one.blur_px for pose in edges for one in pose if one.camera == name])
        for name in names
    ]
    # What Φ (1 − Φ) of 0.6 parts of a step does to a fit of Φ: 0.59 blurs each.
    wanted = [
        0.6 * 0.591 * blur if name in bent_cameras(bent) else 0.0
        for name, blur in zip(names, blurs, strict=True)
    ]
    assert moved_outward_px(bent, edges) == pytest.approx(wanted)
    assert max(wanted) > 0.1


def test_a_response_the_other_way_round_makes_dark_shafts_thick(make_measurement):
    measurement = with_response(make_measurement(), CameraResponse(-0.2, 0.01, 1.0, 0.03, 12))
    (told,) = response_findings(measurement)
    assert "gamma below 1" in told.text
    assert "dark shaft before something bright measures too thick" in told.text


@pytest.mark.parametrize(
    ("bend", "bend_u"), [(0.6, 0.15), (0.07, 0.001), (-0.07, 0.001), (0.0, 0.01)]
)
def test_what_is_uncertain_or_matters_little_is_not_told(make_measurement, bend, bend_u):
    measurement = with_response(make_measurement(), CameraResponse(bend, bend_u, 1.0, 0.1, 12))
    assert response_findings(measurement) == []
    plain = off_by(measurement, -0.05)
    assert "square_mm would have to be" in scale_finding(plain).text


def test_a_refusal_for_the_diameter_does_not_name_a_square_either():
    diameters = [[8.0, 8.0]] * 6
    with pytest.raises(CalibrationError, match="square_mm would have to be"):
        refuse_other_scale(diameters, 10.0, 15.0)
    with pytest.raises(CalibrationError, match="nothing of the scale") as caught:
        refuse_other_scale(diameters, 10.0, 15.0, ["left"])
    assert "square_mm" not in caught.value.what
