import csv
import io
import json
import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import jsonschema
import numpy as np
import pytest

from pivometer.calibration.board import Board, BoardView
from pivometer.calibration.result import Calibration
from pivometer.cameras import Camera, Rig
from pivometer.errors import DataError, UsageError
from pivometer.geometry import RigidTransform
from pivometer.io.codec import alternatives_of, annotations_of, json_text, jsonable
from pivometer.io.result import (
    centerlines_csv,
    read_result,
    read_rig,
    result_content,
    result_text,
    rig_text,
)
from pivometer.io.schema import schema
from pivometer.measurement import BoardFrame, Measurement, RejectedPose, UsedPose

SHAPES = {
    "point_mm": (3,),
    "direction": (3,),
    "expanded_mm": (3,),
    **dict.fromkeys(("interval_mm", "rms_interval_mm", "max_interval_mm"), (2,)),
    "covariance": (4, 4),
    "basis": (2, 3),
    "points_px": (2, 5, 2),
    "normals": (2, 3),
    "normals_covariance": (6, 6),
    **dict.fromkeys(("sigma_px", "angle_sigma_rad", "contrast", "used_part"), (2,)),
    **dict.fromkeys(("saturated_part", "curvature_px", "curvature_sigma_px"), (2,)),
    **dict.fromkeys(("deviation_px", "deviation_sigma_px"), (2, 16)),
    **dict.fromkeys(("covariance_mm2", "lines_mm2", "calibration_mm2", "shading_mm2"), (3, 3)),
    "total_mm2": (3, 3),
    **dict.fromkeys(("location_u_mm", "board_u_mm", "excess_mm2", "linear_ratio"), (3,)),
    **dict.fromkeys(("minimax_point_mm", "least_squares_point_mm"), (3,)),
    "board_mm2": (3, 3),
    **dict.fromkeys(("shift_mm", "shift_u_mm", "axis"), (3,)),
    **dict.fromkeys(("misses_mm", "board_misses_mm"), (2, 3)),
    **dict.fromkeys(("tilts_deg", "azimuths_deg", "times_s", "joints"), (2,)),
    "displacements_mm": (4, 3),
    "shift_covariance_mm2": (3, 3),
}
RNG = np.random.default_rng(11)


def rig() -> Rig:
    cameras = [
        Camera(name, 640, 480, 1000 + RNG.random(2), 300 + RNG.random(2), RNG.random(2))
        for name in ("left", "right")
    ]
    turn = RigidTransform.from_rotation_vector(RNG.random(3), RNG.random(3))
    return Rig(cameras, [RigidTransform.identity(), turn])


def example(kind: Any, name: str = "") -> Any:
    """Return some value of a type: every number different, every digit of it in use."""
    made_by_hand = {
        Rig: rig,
        RigidTransform: lambda: RigidTransform.from_rotation_vector(RNG.random(3), RNG.random(3)),
        Board: lambda: Board("charuco", (9, 7), 15.1, 0.01, "DICT_4X4_50", 11.3),
        BoardView: lambda: BoardView("left", "board/é", [0, 3], RNG.random((2, 2)), RNG.random(2)),
        float: lambda: float(RNG.random() * 10.0 ** RNG.integers(-9, 9)),
        bool: lambda: True,
        int: lambda: int(RNG.integers(1, 99)),
        str: lambda: f"“{name}”\n<b>",
        object: lambda: {"serial": ["A", 1, 2.5, True], "ø": {}},
    }
    if kind in made_by_hand:
        return made_by_hand[kind]()
    if alternatives_of(kind):
        return example(alternatives_of(kind)[0], name)
    if is_dataclass(kind) and isinstance(kind, type):
        return example_dataclass(kind)
    if get_origin(kind) is np.ndarray:
        return RNG.random(SHAPES.get(name, (4,)))
    if get_origin(kind) is Literal:
        return get_args(kind)[0]
    if get_origin(kind) is Mapping:
        return {"a/b.png": example(get_args(kind)[1], name)}
    return tuple(example(member, name) for member in get_args(kind) if member is not ...) * 2


def example_dataclass(kind: type) -> Any:
    values = {name: example(hint, name) for name, hint in annotations_of(kind).items()}
    if kind is Calibration:
        size = len(values["rig"].parameter_names)
        values["covariance"] = RNG.random((size, size))
    if kind is BoardFrame:
        values["covariance"] = RNG.random((6, 6))
    defaults = {field.name: field.default for field in fields(kind) if field.name == "status"}
    return kind(**values | defaults)


@pytest.fixture(scope="module")
def measurement() -> Measurement:
    poses = (example(UsedPose), example(RejectedPose), example(UsedPose))
    return replace(example(Measurement), poses=poses)


def test_a_measurement_comes_back_bit_for_bit(measurement: Measurement, tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    path.write_text(result_text(measurement), encoding="utf-8")
    again = read_result(path)
    assert result_text(again) == result_text(measurement)
    point = again.rcm.minimax.point_mm
    np.testing.assert_array_equal(point, measurement.rcm.minimax.point_mm)
    assert not point.flags.writeable
    assert [type(pose) for pose in again.poses] == [UsedPose, RejectedPose, UsedPose]
    assert again.setup.board.squares == (9, 7)


def test_a_calibration_comes_back_bit_for_bit(measurement: Measurement, tmp_path: Path) -> None:
    calibration = measurement.calibration
    path = tmp_path / "rig.json"
    path.write_text(rig_text(calibration, software="pivometer 1"), encoding="utf-8")
    again = read_rig(path)
    assert jsonable(again) == jsonable(calibration)
    np.testing.assert_array_equal(again.rig.difference(calibration.rig), 0)
    assert again.views[0].ids.dtype == np.int64


def test_a_result_serves_as_a_rig(measurement: Measurement, tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    path.write_text(result_text(measurement), encoding="utf-8")
    assert jsonable(read_rig(path)) == jsonable(measurement.calibration)


def test_names_are_those_of_the_attributes(measurement: Measurement) -> None:
    content = result_content(measurement)
    used, rejected = content["poses"][0], content["poses"][1]
    assert content["reference_camera"] == "left"
    assert content["rcm"]["minimax"]["max_mm"] == measurement.rcm.minimax.max_mm
    assert content["rcm"]["least_squares"]["covariance_mm2"] == (
        measurement.rcm.least_squares.covariance_mm2.tolist()
    )
    assert used["centerline"]["point_mm"] == measurement.used[0].centerline.point_mm.tolist()
    assert (used["status"], used["reason"]) == ("used", None)
    assert (rejected["status"], rejected["centerline"]) == ("rejected", None)
    assert rejected["reason"] == measurement.rejected[0].reason
    assert content["calibration"]["edge_length_error"]["rms_mm"] > 0
    assert content["inputs"] == dict(measurement.inputs)


def test_the_result_fits_its_schema(measurement: Measurement) -> None:
    content = json.loads(result_text(measurement))
    jsonschema.Draft202012Validator.check_schema(schema())
    validator = jsonschema.Draft202012Validator(schema())
    validator.validate(content)
    spoiled = (
        lambda c: c["rcm"]["minimax"].pop("certificate_gap"),
        lambda c: c["rcm"]["least_squares"]["point_mm"].append(0.0),
        lambda c: c["poses"][0].update(status="maybe"),
        lambda c: c["poses"][1].pop("reason"),
        lambda c: c["findings"][0].update(severity="hint"),
        lambda c: c["inputs"].update({"a.png": 7}),
        lambda c: c.update(schema="pivometer/result/0"),
    )
    for spoil in spoiled:
        wrong = json.loads(result_text(measurement))
        spoil(wrong)
        assert not validator.is_valid(wrong)


def test_the_schema_says_what_the_docstrings_say() -> None:
    definitions = schema()["$defs"]
    assert definitions["MinimaxRcm"]["properties"]["max_mm"]["description"].startswith("Largest")
    undescribed = [
        f"{kind}.{name}"
        for kind, described in definitions.items()
        if kind != "numbers" and not described["description"]
        for name in described["properties"]
    ]
    assert undescribed == []


def test_centerlines_as_csv(measurement: Measurement) -> None:
    rows = list(csv.DictReader(io.StringIO(centerlines_csv(measurement))))
    assert [row["pose"] for row in rows] == [pose.pose for pose in measurement.used]
    line = measurement.used[1].centerline
    assert [float(rows[1][f"point_{axis}_mm"]) for axis in "xyz"] == line.point_mm.tolist()
    assert [float(rows[1][f"direction_{axis}"]) for axis in "xyz"] == line.direction.tolist()
    assert float(rows[0]["distance_minimax_mm"]) == measurement.used[0].distance_mm.minimax
    covariance = line.position_covariance_mm2(measurement.rcm.least_squares.point_mm)
    assert float(rows[1]["cov_xz_mm2"]) == covariance[0, 2]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_number_that_is_not_finite_is_never_written(
    measurement: Measurement, value: float
) -> None:
    wrong = replace(measurement, rcm=replace(measurement.rcm, separation_mm=value))
    with pytest.raises(DataError, match=rf"rcm\.separation_mm is {value}, not a number"):
        result_text(wrong)


def test_unlimited_degrees_of_freedom_are_null_in_the_file(
    measurement: Measurement, tmp_path: Path
) -> None:
    unlimited = replace(measurement.uncertainty, degrees_of_freedom=math.inf)
    path = tmp_path / "result.json"
    path.write_text(result_text(replace(measurement, uncertainty=unlimited)), encoding="utf-8")
    content = json.loads(path.read_text(encoding="utf-8"))
    assert content["uncertainty"]["degrees_of_freedom"] is None
    jsonschema.Draft202012Validator(schema()).validate(content)
    assert read_result(path).uncertainty.degrees_of_freedom == math.inf


def spoiled_rig(measurement: Measurement, **changes: Any) -> str:
    content = json.loads(rig_text(measurement.calibration, software="pivometer 1"))
    content["calibration"] |= changes
    return json.dumps(content)


def test_what_is_wrong_with_a_rig_is_named(measurement: Measurement, tmp_path: Path) -> None:
    text = rig_text(measurement.calibration, software="pivometer 1")
    faults = {
        text[: len(text) // 2]: "is not JSON: ",
        "[]": "is not a rig file: its schema is None, not 'pivometer/rig/1'",
        text.replace("rig/1", "rig/2"): "has version 2 of its format; this Pivometer reads",
        spoiled_rig(measurement, method=3): "calibration.method is int, not text",
        spoiled_rig(measurement, noise_px="a"): "calibration.noise_px is 'a', not a number",
        spoiled_rig(measurement, noise_px=None): "calibration.noise_px is None, not a number",
        spoiled_rig(measurement, covariance=[[1, 2], [3]]): "calibration.covariance is not an arr",
        spoiled_rig(measurement, covariance=[[1]]): "calibration covariance has shape (1, 1), not",
        spoiled_rig(measurement, views={}): "calibration.views is dict, not a list",
        spoiled_rig(measurement, rig={"cameras": []}): "calibration.rig.reference_from_camera is m",
    }
    for content, message in faults.items():
        path = tmp_path / "rig.json"
        path.write_text(content, encoding="utf-8")
        with pytest.raises(UsageError) as caught:
            read_rig(path)
        assert caught.value.what.startswith(message)
        assert caught.value.path == path
        assert caught.value.next_step


def test_a_missing_rig_and_a_picture_instead_of_one(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="cannot be read: No such file"):
        read_rig(tmp_path / "rig.json")
    (tmp_path / "a.png").write_bytes(b"\x89PNG")
    with pytest.raises(UsageError, match="is not UTF-8 text"):
        read_rig(tmp_path / "a.png")


def test_names_of_later_versions_are_passed_over(measurement: Measurement, tmp_path: Path) -> None:
    (tmp_path / "rig.json").write_text(spoiled_rig(measurement, later=1), encoding="utf-8")
    assert read_rig(tmp_path / "rig.json").method == measurement.calibration.method


def test_json_text_is_json() -> None:
    content = {"a": [], "b": [{"c": [1, [2.5]]}, {}], "é": None, "d": {}, "e": "\n"}
    assert json.loads(json_text(content)) == content


def test_a_rig_of_the_time_when_distortion_was_called_beta_can_be_read(
    measurement: Measurement, tmp_path: Path
) -> None:
    text = rig_text(measurement.calibration, software="pivometer 0")
    path = tmp_path / "rig.json"
    path.write_text(text.replace('"distortion"', '"beta"'), encoding="utf-8")
    cameras = read_rig(path).rig.cameras
    np.testing.assert_array_equal(
        cameras[1].distortion, measurement.calibration.rig.cameras[1].distortion
    )
