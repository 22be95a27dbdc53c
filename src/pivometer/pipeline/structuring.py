"""What the misses of a measurement follow, and the warnings that come of it."""

from __future__ import annotations

from dataclasses import replace

from pivometer.io.joints import FILE_NAME, PoseTable
from pivometer.io.session import Session
from pivometer.measurement import ImportedRig, Measurement
from pivometer.pipeline.line_errors import line_points
from pivometer.rcm import Finding, outlier_findings
from pivometer.rcm.structure import ErrorStructure, Pattern, error_structure
from pivometer.uncertainty import LineErrors

REGULAR = 0.9
"""Part of the misses' variance that follows direction or joints smoothly, from which large misses
are no mistakes of single poses: such a mistake would not follow, and would lower this part."""


def with_structure(measurement: Measurement, session: Session, errors: LineErrors) -> Measurement:
    """Return a measurement that states the structure of its misses.

    A drift or a jump in the course of the session is a warning: then the robot, a camera or the
    reference moved, and one point does not describe what was measured.
    """
    table = session.pose_table
    structure = structure_of(measurement, errors, table)
    inputs = {**measurement.inputs} | ({FILE_NAME: table.sha256} if table is not None else {})
    findings = [_moved(pattern) for pattern in structure.found if pattern.kind == "order"]
    findings += _outliers(measurement, structure, errors)
    return replace(
        measurement,
        structure=structure,
        inputs=inputs,
        findings=(*measurement.findings, *findings),
    )


def structure_of(
    measurement: Measurement, errors: LineErrors, table: PoseTable | None = None
) -> ErrorStructure:
    """Return the structure of the misses of a measurement.

    Parameters
    ----------
    measurement
        What was measured.
    errors
        What the instrument does to its lines.
    table
        What is known of the poses besides their images.
    """
    names = [pose.pose for pose in measurement.used]
    imported = isinstance(measurement.calibration, ImportedRig)
    rows = None if table is None else table.rows_of(names)
    structure = error_structure(
        line_points(measurement),
        errors.directions,
        poses=names,
        covariances_mm2=errors.stated().alone_mm2,
        common_mm=None if imported else errors.common_mm,
        times_s=None if rows is None else rows.times_s,
        approach=() if rows is None else rows.approach,
        joints={} if rows is None else rows.joints,
    )
    if measurement.board_frame is None:
        return structure
    board_from_reference = measurement.board_frame.reference_from_board.inverse()
    return replace(structure, board_misses_mm=board_from_reference.rotate(structure.misses_mm))


def _outliers(
    measurement: Measurement, structure: ErrorStructure, errors: LineErrors
) -> tuple[Finding, ...]:
    """Name single poses that miss by far more than the rest, unless the rest foretells it."""
    regular = [p.share for p in structure.found if p.kind in ("direction", "joint")]
    if max(regular, default=0.0) >= REGULAR:
        return ()
    names = [pose.pose for pose in measurement.used]
    return outlier_findings(names, line_points(measurement), errors.directions)


def _moved(pattern: Pattern) -> Finding:
    return Finding(
        "warning",
        f"something moved during the session: {pattern.text}",
        "find out what moved (a camera, the robot's base, the reference), fix it and measure "
        "again; or measure the parts before and after on their own",
    )
