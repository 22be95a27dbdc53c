"""``pivometer history``: results over time."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def history(
    folder: Annotated[Path, Parameter(name="DIR")], /, *, output: Path | None = None
) -> int:
    """Show how results change over time, with limits.

    Every result.json in DIR and the folders in it counts, by the robot that [device] of
    session.toml names. The robot's rms miss is followed, and the instrument's noise, calibration
    and measured diameter beside it, so that a change of the instrument is not taken for one of
    the robot. An index in DIR saves reading all again; it can be deleted.

    Parameters
    ----------
    folder
        The folder of all sessions.
    output
        Folder to write history.html and history.json into; nothing is written where none is given.
    """
    from pivometer import pipeline
    from pivometer.cli.show import say, show_table
    from pivometer.report.history import series_table

    followed = pipeline.history(folder)
    for series in followed.series:
        show_table(series_table(series))
    say(*(f"- {text}" for series in followed.series for text in series.findings))
    say(*(f"skipped: {path} {reason}" for path, reason in followed.skipped))
    if output is not None:
        files = pipeline.write_history(followed, output)
        say(*(f"{name}: {path}" for name, path in files.items()))
    return 0 if followed.newest_in_line else 1
