"""A rig of another program measures the same, and nothing claims to know how good it is."""

import json
from dataclasses import replace

import jsonschema
import numpy as np
import pytest

import pivometer
from pivometer import pipeline
from pivometer.cameras import Rig
from pivometer.cli import main
from pivometer.errors import DataError, UsageError
from pivometer.io.formats import read_any_rig, write_rig
from pivometer.io.result import read_result, read_rig
from pivometer.io.schema import schema
from pivometer.measurement import ImportedRig


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    folder = tmp_path_factory.mktemp("simulated") / "session"
    return pipeline.simulate("gold", folder, poses=8, board_pairs=6, single_views=2)


@pytest.fixture(scope="module")
def calibration(session):
    return pivometer.calibrate(pivometer.load(session))


@pytest.fixture(scope="module")
def own(session, calibration):
    return pivometer.measure(pivometer.load(session), rig=calibration)


@pytest.fixture(scope="module")
def chain(calibration, tmp_path_factory):
    path = tmp_path_factory.mktemp("kalibr") / "camchain.yaml"
    write_rig(calibration.rig, "kalibr", path)
    return path


@pytest.fixture(scope="module")
def imported(session, chain):
    return pivometer.measure(pivometer.load(session), rig=read_any_rig(chain))


def test_the_same_cameras_measure_the_same(own, imported):
    np.testing.assert_allclose(
        imported.rcm.least_squares.point_mm, own.rcm.least_squares.point_mm, atol=1e-9
    )
    assert imported.rcm.minimax.max_mm == pytest.approx(own.rcm.minimax.max_mm, abs=1e-9)


def test_the_uncertainty_is_that_of_the_lines_and_says_so(own, imported):
    found = imported.uncertainty
    assert found.status == "calibration unknown"
    assert not hasattr(found, "calibration_mm2")
    assert not hasattr(found, "total_mm2")
    np.testing.assert_allclose(found.lines_mm2, own.uncertainty.lines_mm2, rtol=1e-6)
    np.testing.assert_array_equal(imported.rcm.least_squares.covariance_mm2, found.lines_mm2)
    warnings = [f.text for f in imported.findings if f.severity == "warning"]
    assert any(
        "calibration uncertainty unknown: the rig was imported (kalibr)" in w for w in warnings
    )
    assert not any("imported" in f.text for f in own.findings)


def test_the_command_line_measures_with_it_and_every_file_says_so(session, chain, tmp_path, capsys):
    out = tmp_path / "results"
    assert main(["measure", str(session), "--rig", str(chain), "--output", str(out)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "calibration uncertainty unknown" in said
    assert "what the imported calibration adds is unknown" in said
    content = json.loads((out / "result.json").read_text())
    jsonschema.validate(content, schema())
    assert content["calibration"]["status"] == "imported"
    assert "covariance" not in content["calibration"]
    assert list(content["calibration"]["inputs"]) == ["camchain.yaml"]
    assert content["intrinsic"] is None
    report = (out / "report.html").read_text()
    assert "their uncertainty is unknown" in report
    assert "too small by an unknown amount" in report
    assert "± U, centerlines only" in report
    again = read_result(out / "result.json")
    assert isinstance(again.calibration, ImportedRig)
    rig = read_rig(out / "rig.json")
    assert isinstance(rig, ImportedRig)
    np.testing.assert_array_equal(
        rig.rig.cameras[1].parameters, again.calibration.rig.cameras[1].parameters
    )


def test_the_sessions_reference_camera_becomes_the_rigs(session, calibration, imported):
    left_from_right = calibration.rig.reference_from_camera[1]
    swapped = Rig(
        calibration.rig.cameras[::-1],
        [calibration.rig.reference_from_camera[0], left_from_right.inverse()],
    )
    result = pivometer.measure(pivometer.load(session), rig=ImportedRig(swapped, "kalibr", {}))
    np.testing.assert_allclose(
        result.rcm.least_squares.point_mm, imported.rcm.least_squares.point_mm, atol=1e-9
    )


def test_cameras_of_other_names_are_refused(session, calibration):
    other = Rig(
        [replace(c, name=f"cam{i}") for i, c in enumerate(calibration.rig.cameras)],
        calibration.rig.reference_from_camera,
    )
    with pytest.raises(UsageError, match="cam0, cam1"):
        pivometer.measure(pivometer.load(session), rig=ImportedRig(other, "kalibr", {}))


def test_the_robots_own_error_is_not_stated_and_not_checked_without_a_guard_band(imported):
    assert imported.intrinsic is None
    with pytest.raises(DataError, match="imported without its uncertainty"):
        pipeline.check(imported, limit_mm=1.0)
    outcome = pipeline.check(imported, limit_mm=1.0, guard_mm=0.1)
    statuses = {condition.name: condition.status for condition in outcome.validity}
    assert statuses["calibration"] == "not checked"


def test_export_converts_between_formats(calibration, chain, tmp_path, capsys):
    assert main(["export", str(chain), str(tmp_path / "model"), "--to", "colmap"]) == 0
    assert str(tmp_path / "model" / "cameras.txt") in capsys.readouterr().out
    assert (
        main(["export", str(tmp_path / "model"), str(tmp_path / "rig.xml"), "--to", "opencv"]) == 0
    )
    found = read_any_rig(tmp_path / "rig.xml").rig
    assert found.baselines_mm[0] == pytest.approx(calibration.rig.baselines_mm[0], abs=1e-9)
    assert main(["export", str(chain), str(tmp_path / "x"), "--to", "bundler"]) == 2


def test_export_reads_our_own_rig(session, calibration, tmp_path):
    path = pipeline.write_calibration(calibration, tmp_path)
    assert main(["export", str(path), str(tmp_path / "ros"), "--to", "ros"]) == 0
    assert sorted(p.name for p in (tmp_path / "ros").iterdir()) == ["left.yaml", "right.yaml"]
