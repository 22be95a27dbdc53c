"""Rows of text files that people and instruments write: CSV with any usual separator."""

import csv
import io
import math
from collections.abc import Iterator
from pathlib import Path

from pivometer.errors import UsageError


def file_bytes(file: Path) -> bytes:
    """Return what a file holds.

    Raises
    ------
    UsageError
        If it cannot be read.
    """
    try:
        return file.read_bytes()
    except OSError as error:
        raise UsageError(
            f"cannot be read: {error.strerror}", next_step="check the path", path=file
        ) from error


def decoded(content: bytes, file: Path) -> str:
    """Return UTF-8 text, without a byte order mark.

    Raises
    ------
    UsageError
        If it is not UTF-8; the message gives the line number.
    """
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content[: error.start].count(b"\n") + 1
        raise UsageError(
            f"line {line}: is not UTF-8 text", next_step="save it as CSV in UTF-8", path=file
        ) from error


def numbered_rows(text: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the rows that hold something, with their line numbers."""
    first = next((line for line in text.splitlines() if line.strip()[:1] not in ("", "#")), "")
    separator = max(",;\t", key=first.count)
    reader = csv.reader(io.StringIO(text), delimiter=separator)
    for row in reader:
        cells = [cell.strip() for cell in row]
        if any(cells) and not cells[0].startswith("#"):
            yield reader.line_num, cells


def finite_or_nan(cell: str) -> float:
    """Return a finite number, or NaN for whatever else a cell holds."""
    try:
        value = float(cell)
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan
