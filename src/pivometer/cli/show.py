"""Results on the terminal: short, with units; nothing in them is read as markup."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table as TerminalTable
from rich.text import Text

from pivometer.calibration import Board, Calibration
from pivometer.calibration.advice import advice
from pivometer.measurement import Measurement
from pivometer.rcm.geometry_check import FEWEST_POSES_ADVISED
from pivometer.report.digits import error_decimals, fixed, uncertainty_text, with_uncertainty
from pivometer.report.points import all_points_table, points_table
from pivometer.report.setup_tables import parameter_rows
from pivometer.report.shaft_tables import shaft_sentence
from pivometer.report.structure_tables import structure_sentences
from pivometer.report.tables import (
    Table,
    board_location_table,
    location_table,
    miss_table,
    rejected_table,
)
from pivometer.report.uncertainty_tables import (
    budget_sentences,
    floor_sentence,
    monte_carlo_table,
)
from pivometer.report.verdict import verdict

if TYPE_CHECKING:
    from pivometer.pipeline import CheckOutcome, DemoOutcome, Plan, SolvedLines, SolvedPoses
    from pivometer.rcm import InstrumentAxis


def say(*lines: str) -> None:
    """Print lines as they are: paths are not broken, so they can be copied."""
    console = Console()
    for line in lines:
        console.print(Text(line), soft_wrap=True)


def show_table(table: Table) -> None:
    """Print a table of the report."""
    shown = TerminalTable(
        title=Text(table.caption), title_justify="left", title_style="bold", box=SIMPLE_HEAD
    )
    for number, column in enumerate(table.columns):
        numeric = number > 0 and all(
            row[number][:1].isdigit() or row[number][:1] in "-–" for row in table.rows
        )
        shown.add_column(Text(column), justify="right" if numeric else "left")
    for row in table.rows:
        shown.add_row(*(Text(cell) for cell in row))
    Console().print(shown)


def show_measurement(
    measurement: Measurement, files: Mapping[str, Path], *, ignored: Sequence[str] = ()
) -> None:
    """Print the verdict, both points, what was rejected and where the files are."""
    told = verdict(measurement)
    say(told.sentence, *([told.decision] if told.decision else []), told.rejected, "")
    board = board_location_table(measurement)
    if board is not None:
        show_table(board)
    show_table(location_table(measurement))
    show_table(miss_table(measurement))
    show_table(all_points_table(measurement))
    if measurement.shaft is not None:
        say(shaft_sentence(measurement))
    if measurement.structure is not None:
        say(*structure_sentences(measurement.structure))
    say(*budget_sentences(measurement))
    drawn = monte_carlo_table(measurement)
    if drawn is not None:
        show_table(drawn)
    if measurement.gold_standard is not None:
        say(floor_sentence(measurement))
    if measurement.rejected:
        show_table(rejected_table(measurement))
    for finding in measurement.findings:
        say(f"{finding.severity}: {finding.text}; next: {finding.next_step}")
    _say_ignored(ignored)
    width = max(map(len, files), default=0) + 2
    say(*(f"{name + ':':{width}}{path}" for name, path in files.items()))


def show_calibration(calibration: Calibration, path: Path, *, ignored: Sequence[str] = ()) -> None:
    """Print the cameras, the rig's quality, what was rejected and where the file is."""
    show_table(_camera_table(calibration))
    show_table(_length_table(calibration))
    rig = calibration.rig
    for camera, baseline in zip(rig.cameras[1:], rig.baselines_mm, strict=True):
        say(f"Camera {camera.name} stands {baseline:.2f} mm from camera {rig.reference}.")
    if calibration.rejected:
        rows = tuple((view.camera, view.view, view.reason) for view in calibration.rejected)
        show_table(Table("Rejected board views", ("camera", "view", "reason"), rows))
    told = advice(calibration)
    say(told.verdict, f"What matters most is {told.cause}.", f"next: {told.next_step}", "")
    say(*(f"note: {note}" for note in calibration.notes))
    _say_ignored(ignored)
    say(f"rig: {path}")


def show_demo(outcome: "DemoOutcome") -> None:
    """Print the demo's answer beside the truth that only a simulation knows."""
    told = verdict(outcome.measurement)
    place = "inside" if outcome.inside_95 else "outside"
    say(
        told.sentence,
        told.rejected,
        "",
        f"The truth is known here: the stated RCM is {outcome.location_error_mm:.3f} mm from it, "
        f"{place} its 95 % uncertainty region.",
        f"report: {outcome.report}",
    )


def show_target(board: Board, path: Path) -> None:
    """Print where the page is and what to do with it."""
    say(
        f"Target: {path} ({board})",
        "Next:   print it at 100 %, measure its 100 mm line, glue it to something flat, and write",
        "        the measured square into session.toml; the page has the lines to copy.",
    )
    if len(board.symmetries) > 1:
        say(
            "Note:   this board looks the same after a turn. That is put right from all views "
            "together;",
            "        with an odd and an even number of squares, every single view is clear.",
        )


def show_check(outcome: "CheckOutcome") -> None:
    """Print the conditions, the decision and its rule."""
    conditions = [*outcome.validity, *([outcome.baseline] if outcome.baseline else [])]
    rows = tuple((one.name, one.status, one.text) for one in conditions)
    show_table(Table("What must be so", ("condition", "", "found"), rows))
    say(f"rule: {outcome.rule}", f"{outcome.decision}: {outcome.text}")


def show_solution(solved: "SolvedLines", path: Path | None) -> None:
    """Print both points of lines from a file, the lines farthest from them, and the findings."""
    rcm = solved.rcm
    if solved.axis is not None:
        _say_axis(solved.axis)
    say(
        f"{len(solved.lines.names)} lines of {solved.lines.source} fill a cone of "
        f"{rcm.cone_deg:.0f}°.",
        "",
    )
    table = points_table(rcm, solved.lines.names, frame="the frame of the lines")
    show_table(table)
    say(table.note)
    for finding in solved.findings:
        say(f"{finding.severity}: {finding.text}; next: {finding.next_step}")
    if path is not None:
        say(f"rcm.json: {path}")


def _say_axis(axis: "InstrumentAxis") -> None:
    """Print the instrument's axis, and how it was found."""
    place = ", ".join(fixed(float(x), 2) for x in axis.point_mm)
    towards = ", ".join(fixed(float(x), 5) for x in axis.direction)
    found = "as given"
    if axis.slide_mm is not None and axis.direction_u_deg is not None:
        found = (
            f"from the motion: it slid by {axis.slide_mm:.3g} mm rms, and its direction has a "
            f"standard uncertainty of {axis.direction_u_deg:.2g}°"
        )
    say(f"Instrument's axis through ({place}) mm along ({towards}), {found}.")


def show_plan(planned: "Plan") -> None:
    """Print what a planned measurement will be good for, and what limits it."""
    seen = planned.foresight
    u = seen.uncertainty
    lines, calibration, light = (
        np.sqrt(part.diagonal()) for part in (u.lines_mm2, u.calibration_mm2, u.shading_mm2)
    )
    say(
        f"{seen.poses} poses in a cone of {planned.cone_deg:g}° about a point "
        f"{np.linalg.norm(planned.point_mm):.0f} mm from camera {planned.rig.reference}.",
        "",
    )
    rows = tuple(
        (
            axis,
            uncertainty_text(float(u.expanded_mm[i])),
            uncertainty_text(float(lines[i])),
            uncertainty_text(float(calibration[i])),
            uncertainty_text(float(light[i])),
        )
        for i, axis in enumerate("xyz")
    )
    factor = f"U (k = {u.coverage_factor:.2f})"
    columns = (
        "axis",
        factor,
        "u from the centerlines",
        "u from the calibration",
        "u from light",
    )
    show_table(Table("Expected uncertainty of the location, mm", columns, rows))
    say(
        f"A perfect robot will read {uncertainty_text(seen.instrument_rms_mm)} mm rms and "
        f"{uncertainty_text(seen.instrument_max_mm)} mm at most.",
        f"What limits the location: {_LIMITS[planned.limit]}.",
    )
    if planned.wanted_mm is None:
        return
    if planned.fewest is None:
        from pivometer.pipeline.planning import MOST_POSES

        say(f"No number of poses up to {MOST_POSES} reaches U = {planned.wanted_mm:g} mm.")
        return
    say(
        f"{planned.fewest.poses} poses reach U = {planned.wanted_mm:g} mm"
        + (
            f"; take at least {FEWEST_POSES_ADVISED} all the same: the largest miss of fewer says "
            "little"
            if planned.fewest.poses < FEWEST_POSES_ADVISED
            else ""
        )
        + "."
    )


_LIMITS = {
    "calibration": "the calibration; more board views help, and in the frame of a board fixed near "
    "the RCM (reference/) most of it drops out",
    "poses": "the centerlines; more poses, a wider cone or a longer visible shaft help",
}


def show_pivot(solved: "SolvedPoses", path: Path | None) -> None:
    """Print the pivot and the tip with their uncertainty, and the findings."""
    pivot = solved.pivot
    u = np.sqrt(pivot.covariance_mm2.diagonal())
    rows = tuple(
        (
            axis,
            with_uncertainty(float(pivot.pivot_mm[i]), float(u[i])),
            with_uncertainty(float(pivot.tip_mm[i]), float(u[3 + i])),
        )
        for i, axis in enumerate("xyz")
    )
    columns = ("", "pivot, tracker's frame", "tip, instrument's frame")
    show_table(Table("Pivot calibration, mm (± standard uncertainty)", columns, rows))
    decimals = error_decimals([pivot.max_mm, pivot.rms_mm])
    say(
        f"Over {len(pivot.misses_mm)} poses of {solved.poses.source} the tip misses the pivot by "
        f"at most {fixed(pivot.max_mm, decimals)} mm ({fixed(pivot.rms_mm, decimals)} mm rms).",
        f"The pivots of its two halves are {fixed(pivot.halves_mm, decimals)} mm apart; by its "
        f"uncertainty, about {fixed(2 * float(np.sqrt((u[:3] ** 2).sum())), decimals)} mm are "
        "expected.",
    )
    for finding in solved.findings:
        say(f"{finding.severity}: {finding.text}; next: {finding.next_step}")
    if path is not None:
        say(f"pivot.json: {path}")


def _say_ignored(ignored: Sequence[str]) -> None:
    if ignored:
        more = f" and {len(ignored) - 5} more" if len(ignored) > 5 else ""
        say(f"not images, left alone: {', '.join(ignored[:5])}{more}")


def _camera_table(calibration: Calibration) -> Table:
    """Tabulate each camera's parameters with their standard uncertainties, and its fit."""
    quality = {camera.name: camera for camera in calibration.cameras}
    cameras = [(camera, quality[camera.name]) for camera in calibration.rig.cameras]
    rows = [
        *parameter_rows(calibration),
        ("rms, px", *(f"{fit.rms_px:.3f}" for _, fit in cameras)),
        ("board views", *(str(fit.view_count) for _, fit in cameras)),
    ]
    return Table(
        "Cameras (value ± standard uncertainty)",
        ("", *(camera.name for camera, _ in cameras)),
        tuple(rows),
    )


def _length_table(calibration: Calibration) -> Table:
    """Tabulate the error of reconstructed board edges: Table I, first column."""
    errors = {"all pairs": calibration.edge_length_error, "held out": calibration.held_out}
    decimals = error_decimals([error.rms_mm for error in errors.values()])
    return Table(
        f"Reconstructed board edges of {calibration.board.square_mm:g} mm, error",
        ("", "max, mm", "rms, mm", "edges"),
        tuple(
            (name, fixed(error.max_mm, decimals), fixed(error.rms_mm, decimals), str(error.count))
            for name, error in errors.items()
        ),
    )
