"""From lines or poses that somebody else measured to the RCM."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pivometer._version import SOFTWARE
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


def solve_lines(path: Path | str) -> SolvedLines:
    """Solve for the RCM of the lines in a CSV file: see `read_lines` for its columns.

    Raises
    ------
    UsageError
        If the file is not what it should be; the message gives the line number.
    DegenerateGeometryError
        If the lines cannot support an answer.
    """
    lines = read_lines(path)
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


def solve_axis(path: Path | str, axis: InstrumentAxis | None) -> SolvedLines:
    """Solve for the RCM of the axis of a tracked instrument: see `read_poses` for the file.

    Parameters
    ----------
    path
        The poses, in the order of time.
    axis
        The instrument's axis in its own frame; estimated from the motion if `None`.

    Raises
    ------
    UsageError
        If the file is not what it should be; the message gives the line number.
    DegenerateGeometryError
        If the poses cannot support an answer, or do not tell the axis.
    """
    poses = read_poses(path)
    motion = poses.rotations, poses.translations_mm
    axis = axis or estimate_axis(*motion)
    points, directions = axis.lines(*motion)
    rcm, findings = with_recording(solve(points, directions), axis, *motion)
    findings = geometry_findings(points, directions, rcm) + findings
    refuse_geometry(findings, path=path)
    names = tuple(str(number) for number in range(1, len(points) + 1))
    return SolvedLines(
        Lines(names, points, directions, poses.source, poses.sha256),
        with_other_points(rcm, points, directions),
        findings + outlier_findings(names, points, directions),
        axis,
    )


def write_solution(solved: SolvedLines, folder: Path | str) -> Path:
    """Write ``rcm.json`` into a folder, whole or not at all, and return its path.

    Its ``rcm`` and ``findings`` have the names and meaning of those in ``result.json``.
    """
    content = {
        "schema": RCM_SCHEMA,
        "software": SOFTWARE,
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


def solve_poses(path: Path | str) -> SolvedPoses:
    """Calibrate the pivot of the tracked poses in a CSV file: see `read_poses` for its columns.

    Raises
    ------
    UsageError
        If the file is not what it should be; the message gives the line number.
    DegenerateGeometryError
        If the poses cannot support an answer.
    """
    poses = read_poses(path)
    pivot = calibrate_pivot(poses.rotations, poses.translations_mm)
    return SolvedPoses(poses, pivot, pivot_findings(pivot))


def write_pivot(solved: SolvedPoses, folder: Path | str) -> Path:
    """Write ``pivot.json`` into a folder, whole or not at all, and return its path."""
    content = {
        "schema": PIVOT_SCHEMA,
        "software": SOFTWARE,
        "inputs": {solved.poses.source: solved.poses.sha256},
        "pivot": jsonable(solved.pivot),
        "findings": jsonable(solved.findings),
    }
    return write_files(folder, {"pivot.json": json_text(content) + "\n"})["pivot.json"]
