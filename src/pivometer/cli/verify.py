"""``pivometer verify``: whether a report still says what its inputs say."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def verify(
    file: Annotated[Path, Parameter(name="FILE")],
    session: Annotated[Path | None, Parameter(name="SESSION")] = None,
    /,
    *,
    rig: Path | None = None,
    file_only: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Verify that a report says what its inputs say.

    Looks at the file's own bytes, compares the SHA-256 of every input, measures the session again
    and compares every figure. A digit changed in a report is found and named.

    Parameters
    ----------
    file
        A report.html, report.pdf or result.json that Pivometer wrote.
    session
        The session folder; the one in whose results the file lies where none is given.
    rig
        The --rig that measure was given, if any; without it the calibration is not checked.
    file_only
        Look at the file only, not at the session: finds what was changed by accident, but whoever
        can write a whole new result can write a new SHA-256 into it.
    """
    from pivometer import pipeline
    from pivometer.cli.progress import progress_bar
    from pivometer.cli.show import say, show_table
    from pivometer.io.formats import read_any_rig
    from pivometer.report import Table

    known = None if rig is None else read_any_rig(rig)
    with progress_bar() as progress:
        found = pipeline.verify(file, session, rig=known, file_only=file_only, progress=progress)
    rows = tuple((one.name, one.status, one.text) for one in found.examined)
    show_table(Table(f"{file}", ("what", "", "found"), rows))
    say(found.sentence)
    return found.exit_code
