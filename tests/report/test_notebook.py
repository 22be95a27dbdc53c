"""What a notebook shows."""

import re
import subprocess
import sys

from pivometer.rcm import Finding
from pivometer.report.notebook import calibration_html, measurement_html, solution_html

HOSTILE = "<script>alert('x')</script>"


def test_a_measurement_opens_with_its_verdict_and_shows_two_drawings(measurement):
    view = measurement_html(measurement)
    assert view.startswith('<div class="pivometer"><p><strong>Over 70 poses')
    assert len(re.findall(r'src="data:image/svg\+xml;base64,', view)) == 2
    assert "RCM error at both points, mm" in view


def test_nothing_of_it_reaches_the_rest_of_the_notebook(make_measurement):
    view = measurement_html(
        make_measurement(count=5, findings=(Finding("warning", HOSTILE, HOSTILE),))
    )
    assert HOSTILE not in view
    assert "<style" not in view
    assert "<script" not in view
    assert "://" not in view


def test_calibration_and_solution_have_a_view(measurement):
    assert "Error of reconstructed board edges" in calibration_html(measurement.calibration)
    assert "All RCM points" in solution_html(measurement.rcm)


def test_results_of_the_public_functions_answer_a_notebook():
    code = (
        "import sys, types; sys.modules['IPython'] = types.ModuleType('IPython');"
        "import pivometer;"
        "rcm = pivometer.solve([[0,0,1],[0,0,-1],[1,0,0]], [[1,0,0],[0,1,0],[0,0,1]]);"
        "assert 'All RCM points' in rcm._repr_html_();"
        "assert hasattr(pivometer.Measurement, '_repr_html_')"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)  # noqa: S603 – our own
