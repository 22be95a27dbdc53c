"""The plots of the edges' straightness, and the table of the shaft."""

import re
from dataclasses import replace

import numpy as np

from pivometer.measurement import PoseCylinder, ShaftAgreement
from pivometer.report.edge_plots import edge_plot
from pivometer.report.shaft_tables import shaft_sentence, shaft_table
from pivometer.uncertainty.shaft_check import MoveTest, ShaftDiameter


def test_an_edge_is_drawn_where_its_rows_lie(measurement):
    edges = measurement.used[0].edges[0]
    assert edge_plot(edges) is None  # no sections are stated
    deviation = np.zeros((2, 16))
    deviation[0, 4] = 0.5
    sigma = np.full((2, 16), 0.02)
    sigma[1, 9] = 0.0  # no row counts there
    sigma[1, 10] = 3.0  # hardly known: does not set the scale
    drawn = edge_plot(replace(edges, deviation_px=deviation, deviation_sigma_px=sigma))
    assert drawn.count("± 0.54") == 2
    first, second = re.findall(r'<polyline points="([^"]*)"', drawn)
    heights = [float(pair.split(",")[1]) for pair in first.split()]
    assert int(np.argmin(heights)) == 4  # outward is upwards
    assert len(second.split()) == 15


def with_shaft(measurement):
    diameter = ShaftDiameter(9.99512, 0.0101, 0.0009, 0.01, 0.0001, 1.96, 0.0198)
    agreement = ShaftAgreement(
        "paper", diameter, 1.0, MoveTest("", 0, 9.0, 28.0), MoveTest("", 3, 20.0, 35.0), "003"
    )
    line = measurement.used[0].centerline
    cylinder = PoseCylinder(line.point_mm, line.direction, 0.0294, 29.2, 30.3)
    poses = tuple(
        replace(pose, cylinder=cylinder) if pose in measurement.used else pose
        for pose in measurement.poses
    )
    return replace(measurement, shaft=agreement, poses=poses)


def test_the_shaft_is_stated_with_its_uncertainty_beside_the_nominal(measurement):
    stated = with_shaft(measurement)
    nominal = f"stated {measurement.setup.diameter_mm:g} mm"
    assert shaft_sentence(stated).startswith("The shaft's diameter is 9.995 ± 0.020 mm")
    assert nominal in shaft_sentence(stated)
    rows = dict(shaft_table(stated).rows)
    assert rows["diameter measured ± U, mm"] == "9.995 ± 0.020"
    assert rows["a camera moved during the session: χ² / limit"] == "20 / 35"
    assert rows["the two centerlines of a pose apart by at most, mm"] == "0.0294"


def test_without_a_fitted_cylinder_nothing_is_stated(measurement):
    bare = replace(measurement, shaft=None)
    assert shaft_table(bare) is None
    assert shaft_sentence(bare) == ""
