"""The report on paper."""

import importlib.util
import json
import re
from dataclasses import replace

import pytest

from pivometer.errors import UsageError
from pivometer.report.embedding import RECORD, RESULT
from pivometer.report.pdf import render_pdf
from pivometer.report.pdf_reading import attachments_of_pdf, pdf_difference, pictures_of_pdf

pytest.importorskip("typst", reason="the extra pdf is not installed")

ATTACHED = {RESULT: json.dumps({"schema": "pivometer/result/1", "long": [*range(200)]})}
ATTACHED |= {RECORD: "{}\n"}
SEAL = "0123456789abcdef" * 4


@pytest.fixture(scope="module")
def small(make_measurement):
    return make_measurement(count=5)


@pytest.fixture(scope="module")
def pdf(small, thumbnails):
    return render_pdf(small, thumbnails=thumbnails, attached=ATTACHED, seal=SEAL)


def test_the_same_input_gives_the_same_bytes(pdf, small, thumbnails):
    again = render_pdf(small, thumbnails=thumbnails, attached=ATTACHED, seal=SEAL)
    assert again == pdf
    assert pdf_difference(again, pdf) == ""


def test_it_is_tagged_for_archives_and_for_those_who_cannot_see_it(pdf):
    assert b"/StructTreeRoot" in pdf
    assert b"/MarkInfo<</Marked true" in pdf
    assert b"pdfaid:part>3<" in pdf
    assert b"pdfaid:conformance>A<" in pdf
    assert b"pdfuaid:part>1<" in pdf


def test_the_result_is_attached_and_the_pictures_are_those_of_the_page(pdf, small, thumbnails):
    assert attachments_of_pdf(pdf) == [ATTACHED[RESULT], ATTACHED[RECORD]]
    shown = {one.jpeg for (pose, _), one in thumbnails.items() if pose in "000 001 002 003"}
    assert shown <= {*pictures_of_pdf(pdf).values()}


def test_it_asks_no_host_and_holds_no_moment_but_the_measurements(pdf):
    assert not re.search(rb"/URI\b", pdf)
    assert {*re.findall(rb"D:(\d{8})", pdf)} == {b"20261122"}


def test_sections_come_in_the_order_of_the_page(pdf):
    titles = re.findall(rb"/Title\(([^)]*)\)/Dest", pdf)
    assert titles[:2] == [b"Verdict", b"Result"]
    assert titles[-2:] == [b"Signatures", b"gold-standard"]  # the whole is written last


def test_text_is_never_markup(make_measurement):
    hostile = '#panic("x") $ * _ [ ] @me <label> = \\ // /* `raw`'
    measurement = make_measurement(count=4, notes=hostile, names=lambda i: f"{hostile}{i}")
    assert render_pdf(measurement, thumbnails={}, attached=ATTACHED, seal=SEAL).startswith(b"%PDF-")


def test_letters_that_the_fonts_lack_do_not_end_in_an_error(small):
    setup = replace(small.setup, notes="测量室二")
    pdf = render_pdf(replace(small, setup=setup), thumbnails={}, attached=ATTACHED, seal=SEAL)
    assert pdf.startswith(b"%PDF-")


def test_without_a_moment_it_is_still_made(small):
    pdf = render_pdf(replace(small, provenance=None), thumbnails={}, attached=ATTACHED, seal=SEAL)
    assert b"D:19700101" in pdf


def test_without_the_extra_one_sentence_names_it(small, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    with pytest.raises(UsageError, match=re.escape('pip install "pivometer[pdf]"')):
        render_pdf(small, thumbnails={}, attached=ATTACHED, seal=SEAL)


def test_a_damaged_attachment_is_left_out(pdf):
    at = pdf.index(b"/EmbeddedFile")
    start = pdf.index(b"stream\n", at) + 7
    assert attachments_of_pdf(pdf[:start] + b"\0" + pdf[start + 1 :]) == [ATTACHED[RECORD]]


def test_drawings_use_no_colour_that_is_only_named():
    from markupsafe import Markup

    from pivometer.report.svg_style import standalone

    drawing = standalone(Markup('<svg><circle class="dot worst"></circle></svg>'))
    assert "var(" not in drawing
    assert "svg .dot.worst{fill: #8f1a16;}" in drawing


def test_every_kind_of_measurement_can_be_typeset(make_measurement, with_board_frame):
    from pivometer.measurement import ImportedRig
    from pivometer.report.csv_tables import csv_files
    from pivometer.report.notebook import measurement_html
    from pivometer.uncertainty.propagation import LinesUncertainty

    three = make_measurement(count=4, cameras=("left", "right", "middle"))
    lines = LinesUncertainty(three.uncertainty.lines_mm2, 5.0, 0.95, 2.57, [0.1, 0.1, 0.1])
    imported = ImportedRig(three.calibration.rig, "opencv", {"rig.yaml": "0" * 64})
    unknown = replace(three, calibration=imported, uncertainty=lines)
    few = make_measurement(count=4)
    board = replace(with_board_frame, poses=few.poses, rcm=few.rcm)
    for measurement in (three, unknown, board, replace(few, poses=few.used)):
        pdf = render_pdf(measurement, thumbnails={}, attached=ATTACHED, seal=SEAL)
        assert b"pdfuaid:part>1<" in pdf
        assert csv_files(measurement)["location.csv"]
        assert measurement_html(measurement)
