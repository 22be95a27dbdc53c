"""``pivometer solve`` and ``pivometer pivot``: the RCM of lines and poses from elsewhere."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from pivometer.errors import UsageError

if TYPE_CHECKING:
    from pivometer._arrays import Floats

FileUnitMm = Annotated[float, Parameter(validator=Number(gt=0, lt=float("inf")))]


def solve(
    lines: Annotated[Path, Parameter(name="LINES.csv")],
    /,
    *,
    unit_mm: FileUnitMm = 1.0,
    output: Path | None = None,
) -> None:
    """Solve for the RCM of lines from a CSV file.

    Parameters
    ----------
    lines
        Columns point_x_mm, point_y_mm, point_z_mm, direction_x, direction_y, direction_z, and pose
        if you like; without a heading the six in this order. With cov_xx_mm2, cov_xy_mm2,
        cov_xz_mm2, cov_yy_mm2, cov_yz_mm2 and cov_zz_mm2 the lines are weighted, too.
    unit_mm
        Length of the file's unit, mm: 1000 for metres.
    output
        Folder to write rcm.json into; nothing is written where none is given.
    """
    from pivometer import pipeline
    from pivometer.cli.show import show_solution

    solved = pipeline.solve_lines(lines, unit_mm=unit_mm)
    path = None if output is None else pipeline.write_solution(solved, output)
    show_solution(solved, path)


def pivot(
    poses: Annotated[Path, Parameter(name="POSES.csv")],
    /,
    *,
    axis: str | None = None,
    axis_point: str | None = None,
    unit_mm: FileUnitMm = 1.0,
    output: Path | None = None,
) -> None:
    """Find the pivot of a tracked instrument: of its tip, or of its axis.

    Parameters
    ----------
    poses
        One 4×4 matrix a row, in mm and in the order of time: 16 numbers, or columns t00 to t23.
    axis
        Direction of the instrument's axis in its own frame, x,y,z; or estimate, which finds it from
        how the instrument slides along it. Without it, its tip is taken for what stays in place.
    axis_point
        A point on that axis, x,y,z in mm; the instrument's origin where none is given.
    unit_mm
        Length of the file's unit, mm: 1000 for metres.
    output
        Folder to write pivot.json into, or rcm.json with --axis; nothing is written where none is
        given.
    """
    from pivometer import pipeline
    from pivometer.cli.show import show_pivot, show_solution
    from pivometer.rcm import InstrumentAxis

    if axis_point is not None and axis in (None, "estimate"):
        raise UsageError(
            "--axis-point is a point on a known axis, but --axis states none",
            next_step="give --axis x,y,z, or leave it out",
        )
    if axis is None:
        pivoted = pipeline.solve_poses(poses, unit_mm=unit_mm)
        show_pivot(pivoted, None if output is None else pipeline.write_pivot(pivoted, output))
        return
    known = None
    if axis != "estimate":
        through = _three(axis_point or "0,0,0", "--axis-point")
        known = InstrumentAxis(through, _three(axis, "--axis"))
    solved = pipeline.solve_axis(poses, known, unit_mm=unit_mm)
    show_solution(solved, None if output is None else pipeline.write_solution(solved, output))


def _three(text: str, option: str) -> "Floats":
    """Return three numbers that are not all zero unless they are a point."""
    import numpy as np

    from pivometer.io.rows import finite_or_nan

    numbers = [finite_or_nan(word) for word in text.split(",")]
    if (
        len(numbers) != 3
        or any(x != x for x in numbers)
        or (option == "--axis" and not any(numbers))
    ):
        raise UsageError(
            f"{option} is {text!r}, not three numbers x,y,z",
            next_step="write for example --axis 0,0,1",
        )
    return np.array(numbers)
