from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pivometer.calibration.board import Board
from pivometer.report import setup_tables, tables
from pivometer.report.digits import decimals_of, uncertainty_text, with_uncertainty


@given(st.floats(1e-9, 99), st.floats(-1e4, 1e4))
def test_uncertainty_has_two_digits_and_value_the_same_place(uncertainty, value):
    shown, _, u = with_uncertainty(value, uncertainty).partition(" ± ")
    assert float(u) == pytest.approx(uncertainty, rel=0.051)
    assert len(u.replace(".", "").lstrip("0")) == 2
    assert len(shown.partition(".")[2]) == len(u.partition(".")[2]) == decimals_of(uncertainty)
    assert float(shown) == pytest.approx(value, abs=0.51 * 10.0 ** -decimals_of(uncertainty))


def test_an_uncertainty_that_is_not_finite_is_said_in_words():
    assert with_uncertainty(1.0, float("nan")) == "1.000 (uncertainty not determined)"
    assert uncertainty_text(float("inf")) == "not determined"


def test_location_table_matches_the_measurement(measurement):
    table = tables.location_table(measurement)
    for i, row in enumerate(table.rows):
        u = measurement.uncertainty.expanded_mm[i]
        tolerance = 0.51 * 10.0 ** -decimals_of(u)
        assert float(row[1]) == pytest.approx(
            measurement.rcm.least_squares.point_mm[i], abs=tolerance
        )
        assert float(row[2]) == pytest.approx(u, rel=0.05)
        assert float(row[3]) == pytest.approx(
            np.sqrt(measurement.uncertainty.lines_mm2[i, i]), rel=0.05
        )
        assert float(row[4]) == pytest.approx(
            np.sqrt(measurement.uncertainty.calibration_mm2[i, i]), rel=0.05
        )
        assert float(row[6]) == pytest.approx(measurement.rcm.minimax.point_mm[i], abs=tolerance)


def test_paper_table_keeps_the_papers_figures_apart(measurement):
    table = tables.paper_table(measurement)
    rcm, lengths = measurement.rcm, measurement.calibration.edge_length_error
    assert table.rows[0][0] == "error (max)"
    assert [float(cell) for cell in table.rows[0][1:4]] == [
        round(value, 3) for value in (lengths.max_mm, rcm.minimax.max_mm, rcm.least_squares.max_mm)
    ]
    assert table.rows[0][4:] == ("0.253", "0.391", "7.086")
    assert table.rows[1][4:] == ("0.130", "0.145", "3.010")
    assert all(name.startswith("paper: ") for name in table.columns[4:])


def test_pose_table_is_worst_first_and_complete(measurement):
    numbers = {pose.pose: n for n, pose in enumerate(measurement.poses, start=1)}
    rows = tables.pose_table(measurement, numbers).rows
    distances = [float(row[2]) for row in rows]
    assert distances == sorted(distances, reverse=True)
    assert {row[0] for row in rows} == {pose.pose for pose in measurement.used}
    by_name = {pose.pose: pose for pose in measurement.used}
    for row in rows:
        pose = by_name[row[0]]
        assert float(row[2]) == pytest.approx(pose.distance_mm.minimax, abs=5.1e-4)
        assert float(row[3]) == pytest.approx(pose.distance_mm.least_squares, abs=5.1e-4)
        assert float(row[4]) == pytest.approx(pose.dihedral_deg, abs=0.051)
    marked = [row for row in rows if row[-1]]
    assert 2 <= len(marked) <= 4
    assert rows[: len(marked)] == tuple(marked)


def test_micrometres_are_not_rounded_away(make_measurement):
    measurement = make_measurement(count=12, miss_mm=0.0005)
    row = tables.miss_table(measurement).rows[1]
    assert float(row[1]) == pytest.approx(measurement.rcm.minimax.rms_mm, rel=0.05)


def test_camera_table_gives_every_parameter_with_its_uncertainty(measurement):
    table = setup_tables.camera_table(measurement)
    assert table.columns == ("", "left", "right")
    assert table.rows[0][1:] == ("1002.40 ± 0.80", "998.10 ± 0.80")
    assert table.rows[5][1:] == ("0.120 ± 0.011", "0.090 ± 0.011")


def test_relative_pose_table_takes_its_uncertainties_from_the_covariance(measurement):
    table = setup_tables.relative_pose_table(measurement)
    cells = dict(row[:2] for row in table.rows)
    assert cells["rotation vector y, °"] == "-86.000 ± 0.017"
    assert cells["position z, mm"].endswith("± 0.15")
    assert cells["baseline, mm"] == f"{measurement.calibration.rig.baselines_mm[0]:.2f}"
    assert cells["angle between optical axes, °"] == "86.00"


def test_length_table_shows_all_held_out_and_the_papers_route(measurement):
    rows = setup_tables.length_table(measurement.calibration).rows
    assert [row[1:] for row in rows] == [
        ("0.241", "0.097", "1640"),
        ("0.263", "0.112", "1640"),
        ("0.252", "0.131", "1640"),
    ]


def test_setup_table_flattens_free_form_tables(measurement):
    rows = dict(setup_tables.setup_table(measurement).rows)
    assert rows["device, serial"] == "GS-01"
    assert rows["device, arm, number"] == "2"
    assert rows["operator, name"] == "A. Engineer"
    assert (
        rows["calibration board"]
        == "checkerboard of 9 × 7 squares of (15.000 ± 0.010) mm, its bow estimated"
    )
    unknown = replace(measurement, setup=replace(measurement.setup, diameter_mm=None))
    assert dict(setup_tables.setup_table(unknown).rows)["shaft diameter, nominal"] == "not stated"


def test_charuco_markers_are_described():
    board = Board("charuco", (9, 7), 15.0, None, "DICT_4X4_50", 11.0)
    assert "markers DICT_4X4_50 of 11 mm" in setup_tables.board_text(board)


def test_the_robots_own_error_stands_beside_the_instruments(measurement):
    from dataclasses import replace

    from pivometer.uncertainty.intrinsic import IntrinsicError

    assert tables.own_error_table(measurement) is None
    own = IntrinsicError(0.1, [0.09, 0.11], [0.15, 0.25], 0.012, 0.95, 0.9, 0.95)
    table = tables.own_error_table(replace(measurement, intrinsic=own))
    assert table.rows[0][2:] == ("0.012", "0.090 to 0.110")
    assert table.rows[1][2:] == ("–", "0.150 to 0.250")
    assert table.columns[-1] == "own, 95 % interval"
