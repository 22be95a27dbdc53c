"""Results on disk: all files of a run, or none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from pivometer._version import software
from pivometer.calibration import Board, Calibration
from pivometer.io.atomic import write_file, write_files
from pivometer.io.result import centerlines_csv, rig_text
from pivometer.io.session import Session
from pivometer.io.sheet import sheet_content
from pivometer.io.target import Paper, target_sheet
from pivometer.measurement import Measurement
from pivometer.pipeline.picturing import shaft_pictures
from pivometer.pipeline.provenance import provenance_now
from pivometer.pipeline.reading import Progress
from pivometer.pipeline.reporting import page_of, pdf_of, report_of
from pivometer.report.csv_tables import csv_files
from pivometer.report.embedding import RESULT, SimulatedTruth, record_of
from pivometer.report.pdf import pdf_extra_is_there
from pivometer.report.plots import figure_files


def write_calibration(calibration: Calibration, folder: Path | str) -> Path:
    """Write ``rig.json`` into a folder, whole or not at all, and return its path."""
    text = rig_text(calibration, software=software())
    return write_files(folder, {"rig.json": text})["rig.json"]


def write_measurement(
    measurement: Measurement,
    session: Session,
    folder: Path | str,
    *,
    command: str = "pivometer.measure",
    truth: SimulatedTruth | None = None,
    progress: Progress | None = None,
) -> dict[str, Path]:
    """Write a measurement's files: all of them, or none.

    Parameters
    ----------
    measurement
        What `measure` returned for `session`.
    session
        The session, whose images the report shows.
    folder
        Where to; made where it does not exist.
    command
        How it was made, for the report's provenance.
    truth
        What is known of a simulated session.
    progress
        Called as ``progress(stage, done, total)``.

    Returns
    -------
    dict
        Paths of ``result.json``, ``centerlines.csv``, ``rig.json``, ``report.html`` and, where the
        extra ``pdf`` is installed, ``report.pdf``, by name.
    """
    provenance = measurement.provenance or provenance_now(command=command)
    measurement = replace(measurement, provenance=replace(provenance, command=command))
    thumbnails, profiles = shaft_pictures(measurement, session, progress)
    report = report_of(measurement, record_of(thumbnails, profiles, truth), thumbnails.values())
    return write_files(
        folder,
        {
            "result.json": report.texts[RESULT],
            "centerlines.csv": centerlines_csv(measurement),
            "rig.json": rig_text(measurement.calibration, software=software()),
            "report.html": page_of(report),
            **({"report.pdf": pdf_of(report)} if pdf_extra_is_there() else {}),
        },
    )


def write_figures(measurement: Measurement, folder: Path | str) -> dict[str, Path]:
    """Write a measurement's figures as SVG and PNG into a folder, and return their paths by name.

    Raises
    ------
    UsageError
        If the extra ``figures`` is not installed, or nothing can be written there.
    """
    return write_files(folder, figure_files(measurement))


def write_tables(measurement: Measurement, folder: Path | str) -> dict[str, Path]:
    """Write a measurement's tables as CSV into a folder, and return their paths by name."""
    return write_files(folder, csv_files(measurement))


def write_target(board: Board, file: Path | str, *, paper: Paper = "A4") -> Path:
    """Write a board to print, true to scale, and return the file's path.

    Parameters
    ----------
    board
        The board, with its nominal sizes.
    file
        Where to; the format is what its ending says, ``.pdf`` or ``.svg``.
    paper
        ``"A4"``, ``"A3"`` or ``"Letter"``; which way it lies follows from the board.

    Raises
    ------
    UsageError
        If the board does not fit on the paper, its markers do not exist, or the file cannot be
        written or has another ending.
    """
    return write_file(file, sheet_content(target_sheet(board, paper=paper), file))
