"""``pivometer export``, ``target`` and ``schema``: what other programs and printers take."""

import json
import sys
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter
from cyclopts.validators import Number

from pivometer.errors import UsageError

Format = Literal["opencv", "ros", "kalibr", "matlab", "colmap", "mrcal"]
Kind = Literal["checkerboard", "charuco"]
Paper = Literal["A4", "A3", "Letter"]
UnitMm = Annotated[float | None, Parameter(validator=Number(gt=0))]
ImageSize = Annotated[tuple[int, int] | None, Parameter(negative="")]


def export(
    rig: Annotated[Path, Parameter(name="RIG")],
    path: Annotated[Path, Parameter(name="PATH")],
    /,
    *,
    to: Format,
    unit_mm: UnitMm = None,
    image_size: ImageSize = None,
) -> None:
    """Write a calibrated rig in the format of another program.

    Parameters
    ----------
    rig
        A rig.json or result.json, or a calibration of another program.
    path
        File to write; for ros, colmap and mrcal the folder.
    to
        The format. What it cannot carry is refused, not dropped; no format carries the covariance.
    unit_mm
        Length of the unit of RIG, mm, where it states none.
    image_size
        Width and height of the images, px, where RIG states none.
    """
    from pivometer.cli.show import say
    from pivometer.io.formats import read_any_rig, write_rig

    known = read_any_rig(rig, unit_mm=unit_mm, image_size=image_size)
    say(*map(str, write_rig(known.rig, to, path)))


def target(
    file: Annotated[Path, Parameter(name="FILE")] = Path("target.pdf"),
    /,
    *,
    kind: Kind = "checkerboard",
    squares: Annotated[tuple[int, int], Parameter(negative="")] = (9, 7),
    square_mm: float = 15.0,
    paper: Paper = "A4",
    dictionary: str | None = None,
    marker_mm: float | None = None,
) -> None:
    """Draw a calibration board to print, as PDF or SVG.

    Parameters
    ----------
    file
        File to write; a name that ends in .pdf or .svg says which.
    kind
        checkerboard, or charuco: with markers, so that a part of it will do.
    squares
        Squares across and down, 9 7 or 9x7, counting the outer ones.
    square_mm
        Side of a square, mm.
    paper
        Paper to print on; which way it lies follows from the board.
    dictionary
        ArUco dictionary of a charuco board; DICT_4X4_50 where none is given.
    marker_mm
        Side of a charuco board's markers, mm; 11/15 of a square where none is given.
    """
    from pivometer import pipeline
    from pivometer.calibration import Board
    from pivometer.cli.show import show_target

    if kind == "charuco":
        dictionary = dictionary or "DICT_4X4_50"
        marker_mm = round(square_mm * 11 / 15, 1) if marker_mm is None else marker_mm
    elif dictionary is not None or marker_mm is not None:
        raise UsageError(
            "a checkerboard has no markers, but --dictionary or --marker-mm is given",
            next_step="add --kind charuco, or leave them out",
        )
    try:
        board = Board(kind, squares, square_mm, None, dictionary, marker_mm)
    except UsageError as error:
        raise UsageError(error.what, next_step="see pivometer target --help") from error
    show_target(board, pipeline.write_target(board, file, paper=paper))


def schema() -> None:
    """Print the JSON Schema of result.json."""
    from pivometer.io.schema import schema as result_schema

    sys.stdout.write(json.dumps(result_schema(), indent=2, ensure_ascii=False) + "\n")
