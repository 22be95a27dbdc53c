"""`check`: every decision, every condition of validity, the baseline, and what CI reads."""

import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pivometer.calibration.result import LengthError
from pivometer.cli import main
from pivometer.errors import DataError, UsageError
from pivometer.io.result import result_text
from pivometer.measurement import Measurement, ShaftAgreement, UsedPose
from pivometer.pipeline import check
from pivometer.pipeline.diagnosing import movement_findings
from pivometer.pipeline.junit import junit_text
from pivometer.pipeline.line_errors import line_errors
from pivometer.pipeline.own_error import own_error, with_own_error
from pivometer.pipeline.structuring import structure_of
from pivometer.rcm import Finding, solve
from pivometer.shaft.stillness import CameraMovement
from pivometer.uncertainty.shaft_check import MoveTest, ShaftDiameter

Make = Callable[..., Measurement]


def good(make: Make, **options: object) -> Measurement:
    """A measurement whose calibration suits small limits."""
    measurement = make(**options)
    calibration = replace(
        measurement.calibration,
        held_out=LengthError(0.01, 0.004, 100),
        covariance=1e-4 * measurement.calibration.covariance,  # made up without correlations
    )
    return replace(measurement, calibration=calibration)


def test_the_interval_decides(make_measurement: Make) -> None:
    measurement = with_own_error(good(make_measurement))
    assert measurement.intrinsic is not None
    low, high = measurement.intrinsic.max_interval_mm
    assert 0 < low < measurement.rcm.minimax.max_mm < high
    for limit, decision, code in (
        (1.001 * high, "pass", 0),
        (0.999 * high, "inconclusive", 5),
        (1.001 * low, "inconclusive", 5),
        (0.999 * low, "over", 1),
    ):
        outcome = check(measurement, limit)
        assert (outcome.decision, outcome.exit_code) == (decision, code)
        assert outcome.interval_mm == (low, high)


def test_an_older_result_without_the_robots_own_error_is_decided_alike(
    make_measurement: Make,
) -> None:
    measurement = good(make_measurement)
    assert measurement.intrinsic is None
    assert (
        check(measurement, 0.5).interval_mm == check(with_own_error(measurement), 0.5).interval_mm
    )


def test_a_guard_band_is_put_about_what_was_seen(make_measurement: Make) -> None:
    measurement = good(make_measurement, u_mm=0.0)
    largest = measurement.rcm.minimax.max_mm
    assert check(measurement, largest + 0.05, guard_mm=0.04).decision == "pass"
    assert check(measurement, largest + 0.05, guard_mm=0.06).decision == "inconclusive"
    assert check(measurement, largest - 0.05, guard_mm=0.06).decision == "inconclusive"
    assert check(measurement, largest - 0.05, guard_mm=0.04).decision == "over"
    assert check(measurement, largest, guard_mm=0).decision == "pass"
    with pytest.raises(DataError, match="no uncertainty"):
        check(measurement, 0.5)


@pytest.mark.parametrize(("limit", "guard"), [(0.0, None), (-1, 0), (np.nan, 0), (1, -0.1)])
def test_what_is_no_length_is_refused(
    limit: float, guard: float | None, make_measurement: Make
) -> None:
    with pytest.raises(UsageError):
        check(good(make_measurement), limit, guard_mm=guard)


def agreement() -> ShaftAgreement:
    """What is stated where edges and cameras fit together."""
    diameter = ShaftDiameter(10.0, 0.01, 0.001, 0.01, 0.0001, 1.96, 0.02)
    still = MoveTest("", 0, 9.0, 28.0)
    return ShaftAgreement("paper", diameter, 1.0, still, still, "000")


def broken(measurement: Measurement, condition: str, make: Make) -> Measurement:
    """Break one condition of validity."""
    if condition == "geometry":
        return replace(measurement, findings=(Finding("refusal", "too narrow", "tilt"),))
    if condition == "poses":
        return good(make, count=19)
    if condition == "calibration":
        worse = replace(measurement.calibration, held_out=LengthError(0.3, 0.126, 100))
        return replace(measurement, calibration=worse)
    if condition == "diameter":
        return replace(measurement, setup=replace(measurement.setup, diameter_mm=9.6))
    if condition == "agreement":
        return replace(measurement, shaft=replace(agreement(), moved=MoveTest("", 0, 40.0, 28.0)))
    if condition == "stillness":
        moved = measurement.structure
        patterns = [replace(p, found=p.kind == "order", text="jumps") for p in moved.patterns]
        return replace(measurement, structure=replace(moved, patterns=tuple(patterns)))
    return with_own_error(good(make, u_mm=1.0))


@pytest.mark.parametrize(
    "condition", ["geometry", "poses", "calibration", "diameter", "agreement", "noise", "stillness"]
)
def test_a_condition_that_is_not_met_forbids_a_decision(
    condition: str, make_measurement: Make
) -> None:
    measurement = with_own_error(good(make_measurement))
    measurement = replace(
        measurement,
        structure=structure_of(measurement, line_errors(measurement)),
        shaft=agreement(),
    )
    assert all(one.status == "met" for one in check(measurement, 0.5).validity)
    outcome = check(broken(measurement, condition, make_measurement), 0.5)
    assert (outcome.decision, outcome.exit_code) == ("invalid", 4)
    assert [one.name for one in outcome.validity if one.status == "not met"] == [condition]
    assert outcome.text == next(one.text for one in outcome.validity if one.status == "not met")


def movement(shift_px: float) -> CameraMovement:
    return CameraMovement("right", 20, "board/004", "shaft/000", shift_px, 0.01, 0.15)


def test_a_camera_that_moved_forbids_a_decision(make_measurement: Make) -> None:
    measurement = with_own_error(good(make_measurement))
    still = replace(measurement, camera_movements=(movement(0.1),))
    assert check(still, 0.5).decision == "pass"
    assert not movement_findings(still)
    moved = replace(measurement, camera_movements=(movement(0.6),))
    outcome = check(moved, 0.5)
    assert outcome.decision == "invalid"
    assert [one.name for one in outcome.validity if one.status == "not met"] == ["stillness"]
    assert "camera right moved by 0.60 px between board/004 and shaft/000" in outcome.text


def test_what_a_camera_moved_by_is_told_in_mm_at_the_rcm(make_measurement: Make) -> None:
    measurement = replace(good(make_measurement), camera_movements=(movement(0.6),))
    rig, point = measurement.calibration.rig, measurement.rcm.least_squares.point_mm
    number = [camera.name for camera in rig.cameras].index("right")
    seen = rig.reference_from_camera[number].inverse() @ point
    # A point that is shifted by so much, at that depth, is seen 0.6 px away; distortion aside.
    (finding,) = movement_findings(measurement)
    told = float(finding.text.partition(" mm at the RCM")[0].rpartition(" ")[2])
    camera = rig.cameras[number]
    apart = camera.project(seen + np.array([told, 0, 0])) - camera.project(seen)
    assert np.hypot(*apart) == pytest.approx(0.6, rel=0.05)


def test_without_a_nominal_diameter_the_scale_is_not_checked(make_measurement: Make) -> None:
    measurement = good(make_measurement)
    unknown = replace(measurement, setup=replace(measurement.setup, diameter_mm=None))
    outcome = check(unknown, 0.5)
    assert {one.status for one in outcome.validity if one.name == "diameter"} == {"not checked"}
    assert outcome.decision == "pass"


def grown(measurement: Measurement, factor: float) -> Measurement:
    """The same poses with every miss of the least-squares point larger by a factor."""
    point = measurement.rcm.least_squares.point_mm
    poses = []
    for pose in measurement.poses:
        if isinstance(pose, UsedPose):
            axis = pose.centerline.direction
            offset = pose.centerline.point_mm - point
            moved = pose.centerline.point_mm + (factor - 1) * (offset - (offset @ axis) * axis)
            pose = replace(pose, centerline=replace(pose.centerline, point_mm=moved))
        poses.append(pose)
    lines = [pose.centerline for pose in poses if isinstance(pose, UsedPose)]
    rcm = solve([line.point_mm for line in lines], [line.direction for line in lines])
    return replace(measurement, poses=tuple(poses), rcm=rcm)


def test_a_robot_that_got_worse_is_not_passed(make_measurement: Make) -> None:
    before = good(make_measurement)
    # The same misses, larger: F(137, 137) exceeds 1.326 = 1.151² in 5 % of cases by chance.
    for growth, decision in ((1.14, "pass"), (1.17, "over"), (0.5, "pass")):
        outcome = check(grown(before, growth), 0.5, baseline=before)
        assert outcome.decision == decision
        assert outcome.baseline is not None


def test_own_error_is_near_what_the_lines_were_made_with(make_measurement: Make) -> None:
    """With 0.1 mm a component, of which the instrument's 0.02 mm is known."""
    found = own_error(good(make_measurement))
    freedom = 2 * 70 - 3
    wanted = np.sqrt((0.1**2 - 0.02**2) * freedom / 70)
    assert abs(found.rms_mm - wanted) < 4 * wanted / np.sqrt(2 * freedom)
    assert 0.02 < found.instrument_rms_mm < 0.04  # √(2 · 0.02²) and what the calibration adds


def cases(text: str) -> dict[str, str]:
    suite = ET.fromstring(text)  # noqa: S314 - our own text
    found = {case.get("name", ""): case[0].tag for case in suite}
    kinds = [suite.get(name) for name in ("tests", "failures", "errors", "skipped")]
    tags = list(found.values())
    counted = [len(tags), *(tags.count(tag) for tag in ("failure", "error", "skipped"))]
    assert kinds == [str(count) for count in counted]
    return found


def test_junit_tells_every_condition(make_measurement: Make) -> None:
    measurement = good(make_measurement)
    passed = cases(junit_text(check(measurement, 0.5, baseline=measurement), name="a<&\x07b"))
    conditions = {"record", "geometry", "joints", "stillness", "poses", "calibration", "diameter"}
    assert set(passed) == conditions | {"baseline", "limit"}
    assert passed.pop("stillness") == "skipped"  # the made-up result does not state it
    assert set(passed.values()) == {"system-out"}
    assert cases(junit_text(check(measurement, 0.05), name="x"))["limit"] == "failure"
    invalid = cases(junit_text(check(good(make_measurement, count=19), 0.5), name="x"))
    assert (invalid["poses"], invalid["limit"]) == ("failure", "skipped")
    error = DataError("<nothing> there", next_step="look")
    assert cases(junit_text(error, name="x")) == {"measurement": "error"}


def write(measurement: Measurement, path: Path) -> str:
    path.write_text(result_text(measurement), encoding="utf-8")
    return str(path)


def test_the_command_on_a_result_file(
    make_measurement: Make, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = write(with_own_error(good(make_measurement)), tmp_path / "result.json")
    junit = tmp_path / "out" / "check.xml"
    for limit, code, word in (("0.5", 0, "pass:"), ("0.05", 1, "over:")):
        assert main(["check", result, "--limit", limit, "--junit", str(junit)]) == code
        assert f"\n{word} " in capsys.readouterr().out
        assert (cases(junit.read_text(encoding="utf-8"))["limit"] == "failure") == (code > 0)
    assert main(["check", result, "--limit", "0.5", "--baseline", result]) == 0
    few = write(good(make_measurement, count=19), tmp_path / "few.json")
    assert main(["check", few, "--limit", "0.5"]) == 4
    vague = write(good(make_measurement, u_mm=0.08), tmp_path / "vague.json")
    assert main(["check", vague, "--limit", "0.26"]) == 5


def test_wrong_usage_and_unfit_data_of_the_command(
    make_measurement: Make, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = write(good(make_measurement, u_mm=0.0), tmp_path / "result.json")
    junit = tmp_path / "check.xml"
    assert main(["check", result]) == 2
    assert main(["check", result, "--limit", "0"]) == 2
    assert main(["check", result, "--limit", "0.5", "--output", str(tmp_path)]) == 2
    assert main(["check", str(tmp_path / "none"), "--limit", "0.5"]) == 2
    assert not junit.exists()
    assert main(["check", result, "--limit", "0.5", "--junit", str(junit)]) == 3
    assert cases(junit.read_text(encoding="utf-8")) == {"measurement": "error"}
    assert "no uncertainty" in capsys.readouterr().err
    assert main(["check", str(tmp_path / "none"), "--limit", "0.5", "--junit", str(junit)]) == 2
    assert "none: no such folder" in junit.read_text(encoding="utf-8")  # not that of the last run


def spoiled(make: Make, change: str) -> Measurement:
    """A result that was edited by hand, or put together from two."""
    measurement = good(make)
    rcm = measurement.rcm
    if change == "largest miss":
        return replace(measurement, rcm=replace(rcm, minimax=replace(rcm.minimax, max_mm=0.01)))
    if change == "misses":
        fewer = replace(rcm.least_squares, distances_mm=rcm.least_squares.distances_mm[1:])
        return replace(measurement, rcm=replace(rcm, least_squares=fewer))
    if change == "point":
        moved = replace(rcm.least_squares, point_mm=rcm.least_squares.point_mm + 0.01)
        return replace(measurement, rcm=replace(rcm, least_squares=moved))
    return replace(measurement, poses=measurement.poses[:2])


@pytest.mark.parametrize("change", ["largest miss", "misses", "point", "poses"])
def test_a_result_that_does_not_agree_with_itself_decides_nothing(
    change: str, make_measurement: Make
) -> None:
    outcome = check(spoiled(make_measurement, change), 0.5, guard_mm=0.1)
    assert outcome.exit_code == 4
    assert "record" in [one.name for one in outcome.validity if one.status == "not met"]
    with pytest.raises(UsageError, match="baseline does not agree with itself"):
        check(good(make_measurement), 0.5, baseline=spoiled(make_measurement, change))


def test_a_baseline_in_another_unit_is_refused(make_measurement: Make) -> None:
    """As if it were in metres."""
    measurement = good(make_measurement)
    with pytest.raises(UsageError, match="no robot changes by a factor of 100"):
        check(measurement, 0.5, baseline=grown(measurement, 1e-3))


def test_a_baseline_of_fewer_poses_is_compared_by_its_degrees_of_freedom(
    make_measurement: Make,
) -> None:
    compared = check(
        good(make_measurement), 0.5, baseline=good(make_measurement, count=25)
    ).baseline
    assert compared is not None
    assert "(70 poses now, 25 then)" in compared.text


@pytest.mark.parametrize("text", ["", "{", "[1]", "[" * 100_000, '{"schema": NaN}', "\x00\xff"])
def test_no_file_makes_a_traceback(text: str, make_measurement: Make, tmp_path: Path) -> None:
    hostile = tmp_path / "hostile.json"
    hostile.write_bytes(text.encode("latin-1"))
    result = write(good(make_measurement), tmp_path / "result.json")
    assert main(["check", str(hostile), "--limit", "0.5"]) == 2
    assert main(["check", result, "--limit", "0.5", "--baseline", str(hostile)]) == 2
