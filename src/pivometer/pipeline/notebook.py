"""Gives results the view that notebooks ask for; the measuring rooms know nothing of it."""

from __future__ import annotations

from pivometer.calibration import Calibration
from pivometer.measurement import Measurement
from pivometer.rcm import RcmSolution


def show_in_notebooks() -> None:
    """Let `Measurement`, `Calibration` and `RcmSolution` answer ``_repr_html_``.

    What draws them is imported when a notebook first shows one.

    Examples
    --------
    >>> import pivometer
    >>> show_in_notebooks()
    >>> lines = [[0, 0, 1], [0, 0, -1], [1, 0, 0]], [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    >>> pivometer.solve(*lines)._repr_html_().startswith('<div class="pivometer"><table>')
    True
    """
    views = {
        Measurement: _measurement_html,
        Calibration: _calibration_html,
        RcmSolution: _solution_html,
    }
    for kind, view in views.items():
        type.__setattr__(kind, "_repr_html_", view)


def _measurement_html(measurement: Measurement) -> str:
    from pivometer.report.notebook import measurement_html

    return measurement_html(measurement)


def _calibration_html(calibration: Calibration) -> str:
    from pivometer.report.notebook import calibration_html

    return calibration_html(calibration)


def _solution_html(solution: RcmSolution) -> str:
    from pivometer.report.notebook import solution_html

    return solution_html(solution)
