"""``exclusions.csv``: the pictures a person took out of a session, each with the reason.

The log only grows, and the last row of a view decides, so that everything can be taken back and
nothing is forgotten.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from types import MappingProxyType

from pivometer.errors import SessionError, UsageError
from pivometer.io.atomic import write_file
from pivometer.io.rows import decoded, file_bytes, numbered_rows

FILE_NAME = "exclusions.csv"
COLUMNS = ("view", "state", "reason", "time")
EXCLUDED, INCLUDED = "excluded", "included"
MOST_BYTES = 4_000_000
"""A log of this size is no log that a person made: 40 000 rows."""

_STEP = (
    f"head the columns {','.join(COLUMNS)}; a row is a view such as shaft/012 or board/003, "
    f"'{EXCLUDED}' or '{INCLUDED}', the reason, and when"
)


@dataclass(frozen=True, slots=True)
class Exclusion:
    """One row of the log.

    Parameters
    ----------
    view
        ``"shaft/012"``, ``"board/003"``, ``"intrinsics/left/000"``: all cameras' pictures of it.
    state
        ``"excluded"`` or ``"included"``.
    reason
        Why; an exclusion always has one.
    time
        When, ISO 8601.
    """

    view: str
    state: str
    reason: str
    time: str


def read_exclusions(path: Path) -> tuple[Exclusion, ...]:
    """Read the log of a session; empty where there is none.

    Raises
    ------
    SessionError
        If the file is no such log; the message gives the line number.
    UsageError
        If it cannot be read or is not UTF-8.
    """
    if not path.is_file():
        return ()
    if path.stat().st_size > MOST_BYTES:
        raise SessionError(
            f"is {path.stat().st_size / 1e6:.0f} MB, more than any log of exclusions",
            next_step="look at it, and remove it",
            path=path,
        )
    try:
        rows = list(numbered_rows(decoded(file_bytes(path), path)))
    except csv.Error as error:
        raise SessionError(f"is no CSV: {error}", next_step=_STEP, path=path) from error
    if not rows or tuple(cell.strip() for cell in rows[0][1]) != COLUMNS:
        raise SessionError("has other columns than a log of exclusions", next_step=_STEP, path=path)
    return tuple(_exclusion(number, row, path) for number, row in rows[1:])


def _exclusion(number: int, row: Sequence[str], path: Path) -> Exclusion:
    cells = [cell.strip() for cell in row]
    known = len(cells) == len(COLUMNS) and cells[1] in (EXCLUDED, INCLUDED)
    if not known or not cells[0] or (cells[1] == EXCLUDED and not cells[2]):
        raise SessionError(
            f"line {number} is no exclusion with a reason, and no inclusion",
            next_step=_STEP,
            path=path,
        )
    return Exclusion(*cells)


def excluded_now(log: Sequence[Exclusion]) -> Mapping[str, str]:
    """Return the reason of every view that is excluded after the last row.

    Examples
    --------
    >>> out = Exclusion("shaft/007", "excluded", "a hand before the lens", "")
    >>> back = Exclusion("shaft/007", "included", "", "")
    >>> dict(excluded_now([out])), dict(excluded_now([out, back]))
    ({'shaft/007': 'a hand before the lens'}, {})
    """
    reasons: dict[str, str] = {}
    for row in log:
        reasons.pop(row.view, None)
        if row.state == EXCLUDED:
            reasons[row.view] = row.reason
    return MappingProxyType(reasons)


def log_exclusion(folder: Path, view: str, reason: str | None, *, when: datetime) -> Exclusion:
    """Take a view out of a session, or take it back, and return the new row of the log.

    Parameters
    ----------
    folder
        The session folder.
    view
        The view, as in `Exclusion`.
    reason
        Why it is taken out; `None` takes it back.
    when
        Now, with its time zone.

    Raises
    ------
    UsageError
        If the reason is empty, or the log cannot be written.
    """
    if reason is not None and not reason.strip():
        raise UsageError(
            f"{view} is to be excluded without a reason",
            next_step="say why: whoever reads the report must be able to judge it",
        )
    state = INCLUDED if reason is None else EXCLUDED
    text = "" if reason is None else " ".join(reason.split())
    row = Exclusion(view, state, text, when.isoformat(timespec="seconds"))
    path = folder / FILE_NAME
    write_file(path, _text([*read_exclusions(path), row]))
    return row


def _text(log: Sequence[Exclusion]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows((row.view, row.state, row.reason, row.time) for row in log)
    return text.getvalue()
