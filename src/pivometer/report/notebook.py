"""What a notebook shows of a result: the verdict, the tables that matter and two drawings.

Drawings are pictures of their own, so that their styles stay theirs, and the notebook's its own.
"""

import base64

from markupsafe import Markup, escape

from pivometer.calibration.advice import advice
from pivometer.calibration.result import Calibration
from pivometer.measurement import Measurement, UsedPose
from pivometer.rcm.result import RcmSolution
from pivometer.report import setup_tables, tables
from pivometer.report.chart import pose_chart
from pivometer.report.points import all_points_table, points_table
from pivometer.report.shaft_tables import shaft_sentence
from pivometer.report.structure_tables import structure_sentences
from pivometer.report.svg_style import standalone
from pivometer.report.tables import Table
from pivometer.report.target import target_plot
from pivometer.report.verdict import verdict


def measurement_html(measurement: Measurement) -> str:
    """Show a measurement: verdict, findings, location, misses, and where the lines pass."""
    told = verdict(measurement)
    numbered = enumerate(measurement.poses, start=1)
    numbers = [n for n, pose in numbered if isinstance(pose, UsedPose)]
    findings = [
        f"{one.severity}: {one.text}; next: {one.next_step}" for one in measurement.findings
    ]
    structure = [] if measurement.structure is None else structure_sentences(measurement.structure)
    shown = [
        tables.board_location_table(measurement) or tables.location_table(measurement),
        tables.miss_table(measurement),
        all_points_table(measurement),
    ]
    return _page(
        Markup("<p><strong>{}</strong></p><p>{}</p>").format(told.sentence, told.rejected),
        _items([*findings, *structure, shaft_sentence(measurement)]),
        Markup('<div style="display:flex;flex-wrap:wrap;gap:1em;align-items:flex-start">')
        + _picture(target_plot(measurement, numbers), "24em", "target plot, mm")
        + _picture(pose_chart(measurement), "44em", "misses pose by pose, mm")
        + Markup("</div>"),
        *(_table(table) for table in shown),
    )


def calibration_html(calibration: Calibration) -> str:
    """Show a calibration: what it is good for, and its quality in mm."""
    told = advice(calibration)
    return _page(
        Markup(
            "<p><strong>{}</strong> What matters most is {}. What would improve it most: {}.</p>"
        ).format(told.verdict, told.cause, told.next_step),
        _table(setup_tables.length_table(calibration)),
        _items([*calibration.notes]),
    )


def solution_html(solution: RcmSolution) -> str:
    """Show all points of a solution."""
    count = len(solution.least_squares.distances_mm)
    names = tuple(f"line {i}" for i in range(count))
    return _page(_table(points_table(solution, names, frame="the frame of the lines")))


def _page(*parts: Markup) -> str:
    return str(Markup('<div class="pivometer">') + Markup("").join(parts) + Markup("</div>"))


def _items(texts: list[str]) -> Markup:
    items = Markup("").join(Markup("<li>{}</li>").format(text) for text in texts if text)
    return Markup("<ul>{}</ul>").format(items) if items else Markup()


def _picture(drawing: Markup, width: str, description: str) -> Markup:
    encoded = base64.b64encode(standalone(drawing).encode()).decode("ascii")
    return Markup(
        '<img alt="{}" style="width:{};max-width:100%;background:#fff" '
        'src="data:image/svg+xml;base64,{}">'
    ).format(description, width, encoded)


def _table(table: Table) -> Markup:
    head = Markup("").join(Markup("<th>{}</th>").format(name) for name in table.columns)
    rows = Markup("").join(
        Markup("<tr>")
        + Markup("<th>{}</th>").format(row[0])
        + Markup("").join(Markup("<td>{}</td>").format(cell) for cell in row[1:])
        + Markup("</tr>")
        for row in table.rows
    )
    note = Markup("<p><small>{}</small></p>").format(table.note) if table.note else Markup()
    return (
        Markup("<table><caption>{}</caption><thead><tr>").format(escape(table.caption))
        + head
        + Markup("</tr></thead><tbody>")
        + rows
        + Markup("</tbody></table>")
        + note
    )
