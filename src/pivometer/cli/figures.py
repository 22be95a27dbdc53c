"""``pivometer figures``: a result's figures and tables as files."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def figures(
    result: Annotated[Path, Parameter(name="RESULT")],
    folder: Annotated[Path, Parameter(name="DIR")],
    /,
) -> None:
    """Write a result's figures (SVG, PNG) and tables (CSV).

    Figures are one or two columns of a journal wide; text in SVG stays text. The tables are those
    of the report, and poses.csv, which has every pose with all digits.

    Parameters
    ----------
    result
        A result.json, or the session folder it lies in.
    folder
        Where to; made where it does not exist.
    """
    from pivometer import pipeline
    from pivometer.cli.show import say

    (measurement,) = pipeline.results_at([result]).values()
    written = pipeline.write_figures(measurement, folder)
    written |= pipeline.write_tables(measurement, folder)
    say(*map(str, written.values()))
