"""Figures and tables as files."""

import csv
import importlib.util
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from io import StringIO

import numpy as np
import pytest

from pivometer.errors import UsageError
from pivometer.io.joints import PoseTable
from pivometer.pipeline.line_errors import line_errors
from pivometer.pipeline.structuring import structure_of
from pivometer.report.csv_tables import csv_files
from pivometer.report.plots import figure_files


@pytest.fixture(scope="module")
def structured(make_measurement):
    measurement = make_measurement(count=12)
    names = tuple(pose.pose for pose in measurement.poses)
    table = PoseTable(names, np.arange(len(names)) * 20.0, (), {}, "0" * 64)
    return replace(
        measurement, structure=structure_of(measurement, line_errors(measurement), table)
    )


@pytest.fixture(scope="module")
def figures(structured):
    pytest.importorskip("matplotlib", reason="the extra figures is not installed")
    return figure_files(structured)


def test_every_figure_is_there_as_svg_and_png(figures):
    names = {"target", "misses", "directions", "order", "distribution"}
    assert set(figures) == {f"{name}.{kind}" for name in names for kind in ("svg", "png")}
    assert all(figures[f"{name}.png"].startswith(b"\x89PNG") for name in names)


def test_text_in_svg_is_text_and_nothing_dates_it(figures):
    for name, content in figures.items():
        if name.endswith(".svg"):
            ET.fromstring(content)  # noqa: S314 - our own
            assert re.search(rb"<text[^>]*>[^<]*mm", content), name
            assert b"<dc:date>" not in content


def test_the_same_measurement_gives_the_same_bytes(figures, structured):
    assert figure_files(structured) == figures


def test_without_a_structure_its_figures_are_left_out(structured):
    pytest.importorskip("matplotlib", reason="the extra figures is not installed")
    assert "order.svg" not in figure_files(replace(structured, structure=None))


def test_without_the_extra_one_sentence_names_it(structured, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    with pytest.raises(UsageError, match=re.escape('pip install "pivometer[figures]"')):
        figure_files(structured)


def test_poses_are_written_with_all_digits_and_the_rejected_with_their_reason(structured):
    rows = list(csv.DictReader(StringIO(csv_files(structured)["poses.csv"])))
    assert [row["pose"] for row in rows] == [pose.pose for pose in structured.poses]
    for row, pose in zip(rows, structured.poses, strict=True):
        if row["status"] == "rejected":
            assert row["reason"] == pose.reason
            continue
        assert float(row["distance_minimax_mm"]) == pose.distance_mm.minimax
        ends = float(row["low_95_mm"]), float(row["high_95_mm"])
        assert ends[0] - 1e-12 <= pose.distance_mm.minimax <= ends[1] + 1e-12  # rounding
    misses = np.array([[float(r[f"miss_{a}_mm"]) for a in "xyz"] for r in rows if not r["reason"]])
    np.testing.assert_array_equal(misses, structured.structure.misses_mm)


def test_tables_are_rectangular_and_hold_every_row(structured):
    files = csv_files(structured)
    assert {"location.csv", "paper-table-1.csv", "cameras.csv", "inputs.csv"} <= set(files)
    for name, text in files.items():
        rows = list(csv.reader(StringIO(text)))
        assert len({len(row) for row in rows}) == 1, name
        assert len(rows) > 1, name
