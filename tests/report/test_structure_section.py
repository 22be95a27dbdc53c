"""The section on the structure of the error: its words, tables and pictures."""

from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from pivometer.io.joints import PoseTable
from pivometer.pipeline.line_errors import line_errors
from pivometer.pipeline.structuring import structure_of
from pivometer.report import render_html
from pivometer.report.structure_figures import direction_map, order_chart
from pivometer.report.structure_tables import (
    component_table,
    pattern_table,
    structure_sentences,
)


@pytest.fixture(scope="module")
def structured(measurement):
    names = tuple(pose.pose for pose in measurement.poses)
    times = np.arange(len(names)) * 20.0
    table = PoseTable(names, times, (), {"q1_deg": np.linspace(-30, 30, len(names))}, "0" * 64)
    return replace(
        measurement, structure=structure_of(measurement, line_errors(measurement), table)
    )


def test_the_report_has_the_section_only_where_it_is_stated(measurement, structured, thumbnails):
    given = {"thumbnails": thumbnails}
    assert "Structure of the error" in render_html(structured, **given)
    assert "Structure of the error" not in render_html(measurement, **given)


@pytest.mark.parametrize("draw", [direction_map, order_chart])
def test_pictures_show_every_pose(structured, draw):
    drawn = ET.fromstring(str(draw(structured.structure)))  # noqa: S314 - our own
    dots = [e for e in drawn.iter() if e.get("class") == "dot"]
    assert len(dots) == len(structured.used) * (3 if draw is order_chart else 1)
    box = float(drawn.get("viewBox").split()[2])
    assert all(0 <= float(dot.get("cx")) + box / 2 * (draw is direction_map) <= box for dot in dots)
    assert "nan" not in str(draw(structured.structure))


def test_tables_say_what_was_tested(structured):
    patterns = pattern_table(structured.structure)
    assert [row[0] for row in patterns.rows] == [
        "direction of the shaft",
        "order of the poses",
        "joint q1_deg",
    ]
    rows = component_table(structured.structure).rows
    squares = sum(part.rms_mm**2 for part in structured.structure.components)
    assert np.sqrt(squares) == pytest.approx(structured.rcm.least_squares.rms_mm)
    assert rows[0][0] == "along the mean shaft"


def test_pure_noise_reads_as_nothing(structured):
    told = " ".join(structure_sentences(structured.structure))
    assert "Nothing beyond chance was found" in told
    assert "order of the poses" in told
