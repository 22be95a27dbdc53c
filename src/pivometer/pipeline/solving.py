"""From lines or poses that somebody else measured to the RCM."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pivometer._version import software
from pivometer.io.atomic import write_files
from pivometer.io.codec import json_text, jsonable
from pivometer.io.lines import Lines, read_lines
from pivometer.io.poses import TrackedPoses, read_poses
from pivometer.rcm import (
    Finding,
    InstrumentAxis,
    PivotCalibration,
    RcmSolution,
    calibrate_pivot,
    estimate_axis,
    geometry_findings,
    outlier_findings,
    pivot_findings,
    refuse_geometry,
    solve,
    weighting_findings,
    with_other_points,
    with_recording,
)

RCM_SCHEMA = "pivometer/rcm/1"
PIVOT_SCHEMA = "pivometer/pivot/1"

NEAREST_MM = 20.0
"""No tracker works nearer than this to its origin; few work farther than as many metres."""


@dataclass(frozen=True, slots=True, eq=False)
class SolvedLines:
    """The RCM of lines from a file.

    Parameters
    ----------
    lines
        The lines, in their own frame.
    rcm
        All RCM points; the weighted one if the file has covariances. The covariances hold the
        scatter of the lines only: what all lines have in common, such as the calibration of the
        instrument they come from, is not in them.
    findings
        What weakens the answer, in plain words.
    axis
        The axis of the tracked instrument that the lines are, in the instrument's frame; `None`
        for lines as they stand.
    """

    lines: Lines
    rcm: RcmSolution
    findings: tuple[Finding, ...]
    axis: InstrumentAxis | None = None


def solve_lines(path: Path | str, *, unit_mm: float = 1.0) -> SolvedLines:
    """Solve for the RCM of the lines in a CSV file: see `read_lines` for its columns and unit.

    Raises
    ------
    UsageError
        If the file is not what it should be; the message gives the line number.
    DegenerateGeometryError
        If the lines cannot support an answer.
    """
    lines = read_lines(path, unit_mm=unit_mm)
    rcm = solve(lines.points_mm, lines.directions)
    findings = geometry_findings(lines.points_mm, lines.directions, rcm)
    refuse_geometry(findings, path=path)
    rcm = with_other_points(
        rcm, lines.points_mm, lines.directions, covariances_mm2=lines.covariances_mm2
    )
    findings += outlier_findings(lines.names, lines.points_mm, lines.directions)
    if rcm.weighted is not None:
        findings += weighting_findings(rcm.weighted)
    return SolvedLines(lines, rcm, findings)


def solve_axis(
    path: Path | str, axis: InstrumentAxis | None, *, unit_mm: float = 1.0
) -> SolvedLines:
    """Solve for the RCM of the axis of a tracked instrument: see `read_poses` for the file.

    Parameters
    ----------
    path
        The poses, in the order of time.
    axis
        The instrument's axis in its own frame; estimated from the motion if `None`.
    unit_mm
        Length of the file's unit, mm.

    Raises
    ------
    UsageError
        If the file is not what it should be; the message gives the line number.
    DegenerateGeometryError
        If the poses cannot support an answer, or do not tell the axis.
    """
    poses = read_poses(path, unit_mm=unit_mm)
    motion = poses.rotations, poses.translations_mm
    axis = axis or estimate_axis(*motion)
    points, directions = axis.lines(*motion)
    rcm, findings = with_recording(solve(points, directions), axis, *motion)
    findings = geometry_findings(points, directions, rcm) + _unit_findings(poses) + findings
    refuse_geometry(findings, path=path)
    names = tuple(str(number) for number in range(1, len(points) + 1))
    return SolvedLines(
        Lines(names, points, directions, poses.source, poses.sha256),
        with_other_points(rcm, points, directions),
        findings + outlier_findings(names, points, directions),
        axis,
    )


def _unit_findings(poses: TrackedPoses) -> tuple[Finding, ...]:
    """Warn of poses that are so near the tracker that their file may be in metres."""
    farthest = float(np.abs(poses.translations_mm).max())
    if farthest >= NEAREST_MM:
        return ()
    text = f"no coordinate of the poses is larger than {farthest:.3g} mm: the file may be in metres"
    return (Finding("warning", text, "add --unit-mm 1000 if it is"),)


def write_solution(solved: SolvedLines, folder: Path | str) -> Path:
    """Write ``rcm.json`` into a folder, whole or not at all, and return its path.

    Its ``rcm`` and ``findings`` have the names and meaning of those in ``result.json``.
    """
    content = {
        "schema": RCM_SCHEMA,
        "software": software(),
        "inputs": {solved.lines.source: solved.lines.sha256},
        "lines": list(solved.lines.names),
        "rcm": jsonable(solved.rcm),
        **({} if solved.axis is None else {"axis": jsonable(solved.axis)}),
        "findings": jsonable(solved.findings),
    }
    return write_files(folder, {"rcm.json": json_text(content) + "\n"})["rcm.json"]


@dataclass(frozen=True, slots=True, eq=False)
class SolvedPoses:
    """Where a tracked instrument pivots.

    Parameters
    ----------
    poses
        The poses.
    pivot
        The pivot, the tip, and their covariance.
    findings
        What weakens the answer, in plain words.
    """

    poses: TrackedPoses
    pivot: PivotCalibration
    findings: tuple[Finding, ...]


def solve_poses(path: Path | str, *, unit_mm: float = 1.0) -> SolvedPoses:
    """Calibrate the pivot of the tracked poses in a CSV file: see `read_poses` for what it holds.

    Raises
    ------
    UsageError
        If the file is not what it should be; the message gives the line number.
    DegenerateGeometryError
        If the poses cannot support an answer.
    """
    poses = read_poses(path, unit_mm=unit_mm)
    pivot = calibrate_pivot(poses.rotations, poses.translations_mm)
    return SolvedPoses(poses, pivot, _unit_findings(poses) + pivot_findings(pivot))


def write_pivot(solved: SolvedPoses, folder: Path | str) -> Path:
    """Write ``pivot.json`` into a folder, whole or not at all, and return its path."""
    content = {
        "schema": PIVOT_SCHEMA,
        "software": software(),
        "inputs": {solved.poses.source: solved.poses.sha256},
        "pivot": jsonable(solved.pivot),
        "findings": jsonable(solved.findings),
    }
    return write_files(folder, {"pivot.json": json_text(content) + "\n"})["pivot.json"]
