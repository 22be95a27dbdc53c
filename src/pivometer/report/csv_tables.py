"""The tables of a report as CSV: the poses with full precision, the others as they are printed."""

import csv
import io
from collections.abc import Iterable

import numpy as np

from pivometer.calibration.result import Calibration
from pivometer.measurement import Measurement, RejectedPose, UsedPose
from pivometer.report import setup_tables, tables
from pivometer.report.points import all_points_table
from pivometer.report.shaft_tables import shaft_table
from pivometer.report.structure_tables import component_table, pattern_table
from pivometer.report.tables import Table
from pivometer.report.uncertainty_tables import budget_table, floor_table, monte_carlo_table


def csv_files(measurement: Measurement) -> dict[str, str]:
    """Return all tables that a measurement has something to say for, as files by name."""
    calibration, structure = measurement.calibration, measurement.structure
    known = isinstance(calibration, Calibration)
    printed: dict[str, Table | None] = {
        "location": tables.location_table(measurement),
        "location-board-frame": tables.board_location_table(measurement),
        "misses": tables.miss_table(measurement),
        "own-error": tables.own_error_table(measurement),
        "points": all_points_table(measurement),
        "paper-table-1": tables.paper_table(measurement),
        "shaft": shaft_table(measurement),
        "budget": budget_table(measurement),
        "floor": floor_table(measurement),
        "monte-carlo": monte_carlo_table(measurement),
        "components": None if structure is None else component_table(structure),
        "patterns": pattern_table(structure) if structure and structure.patterns else None,
        "cameras": setup_tables.camera_table(measurement),
        "relative-pose": setup_tables.relative_pose_table(measurement),
        "board-edges": setup_tables.length_table(calibration) if known else None,  # type: ignore[arg-type]
        "set-up": setup_tables.setup_table(measurement),
        "inputs": tables.input_table(measurement.inputs),
    }
    files = {
        f"{name}.csv": _csv([table.columns, *table.rows])
        for name, table in printed.items()
        if table is not None
    }
    return files | {"poses.csv": poses_csv(measurement)}


def poses_csv(measurement: Measurement) -> str:
    """Return every pose, used or rejected, with all its figures in full precision.

    Names are those of ``result.json``; lengths in mm, angles in degrees.
    """
    cameras = [camera.name for camera in measurement.calibration.rig.cameras]
    heading = [
        *("pose", "status", "distance_minimax_mm", "low_95_mm", "high_95_mm"),
        *("distance_least_squares_mm", "miss_x_mm", "miss_y_mm", "miss_z_mm"),
        *("tilt_deg", "azimuth_deg", "dihedral_deg"),
        *(f"diameter_{name}_mm" for name in cameras),
        "reason",
    ]
    used = iter(_used_rows(measurement, cameras))
    rows = [
        next(used)
        if isinstance(pose, UsedPose)
        else [pose.pose, pose.status, *[""] * (len(heading) - 3), _reason(pose)]
        for pose in measurement.poses
    ]
    return _csv([heading, *rows])


def _used_rows(measurement: Measurement, cameras: list[str]) -> Iterable[list[str]]:
    structure, intervals = measurement.structure, tables.miss_intervals(measurement)
    for i, pose in enumerate(measurement.used):
        seen = dict(zip((one.camera for one in pose.edges), pose.diameters_mm, strict=True))
        told = (
            [*structure.misses_mm[i], structure.tilts_deg[i], structure.azimuths_deg[i]]
            if structure is not None
            else [np.nan] * 5
        )
        numbers = [
            pose.distance_mm.minimax,
            *intervals[i],
            pose.distance_mm.least_squares,
            *told,
            pose.dihedral_deg,
            *(seen.get(name, np.nan) for name in cameras),
        ]
        cells = ("" if np.isnan(number) else repr(float(number)) for number in numbers)
        yield [pose.pose, pose.status, *cells, ""]


def _reason(pose: RejectedPose) -> str:
    return pose.reason


def _csv(rows: Iterable[Iterable[str]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()
