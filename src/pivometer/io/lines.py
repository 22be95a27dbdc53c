"""Lines in space from a CSV file: ``centerlines.csv``, or one that somebody else wrote."""

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pivometer._arrays import Floats, checked, read_only
from pivometer.errors import UsageError
from pivometer.io.rows import decoded, file_bytes, finite_or_nan, numbered_rows

_POINT = tuple((f"point_{axis}", f"p{axis}", axis) for axis in "xyz")
_DIRECTION = tuple((f"direction_{axis}", f"d{axis}", f"dir_{axis}") for axis in "xyz")
_COVARIANCE = tuple(f"cov_{pair}" for pair in ("xx", "xy", "xz", "yy", "yz", "zz"))
_NAME = ("pose", "name", "line", "id")

_COLUMNS_HELP = (
    "head the columns point_x_mm, point_y_mm, point_z_mm, direction_x, direction_y, direction_z, "
    "or leave the heading out and give these six in this order"
)


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """Lines as read from a file.

    Parameters
    ----------
    names
        What the file calls each line; its line number in the file where it has no names.
    points_mm, directions
        A point on each line, mm, and its direction, shape (n, 3) each.
    source
        The file's name.
    sha256
        Of the file.
    covariances_mm2
        Covariance of each line's position near the RCM, shape (n, 3, 3), mm²; `None` where the file
        has none.
    """

    names: tuple[str, ...]
    points_mm: Floats
    directions: Floats
    source: str
    sha256: str
    covariances_mm2: Floats | None = None

    def __post_init__(self) -> None:
        for name in ("points_mm", "directions"):
            object.__setattr__(self, name, read_only(checked(getattr(self, name), (None, 3), name)))
        if self.covariances_mm2 is not None:
            covariances = checked(self.covariances_mm2, (None, 3, 3), "covariances_mm2")
            object.__setattr__(self, "covariances_mm2", read_only(covariances))


def read_lines(path: Path | str, *, unit_mm: float = 1.0) -> Lines:
    """Read lines from CSV, separated by commas, semicolons or tabs.

    With a heading the columns may stand in any order beside others: ``point_x_mm`` … and
    ``direction_x`` …, with or without ``_mm``; ``px`` … or ``x`` … and ``dx`` … do as well, and
    ``pose`` names the lines. Without a heading the columns are point x, y, z (mm) and direction
    x, y, z. With a heading there may be the covariance of each line's position where it passes the
    RCM, mm²: ``cov_xx_mm2``, ``cov_xy_mm2``, ``cov_xz_mm2``, ``cov_yy_mm2``, ``cov_yz_mm2`` and
    ``cov_zz_mm2``; what is in it along the line does not count. Empty lines and those that begin
    with ``#`` are passed over.

    Parameters
    ----------
    path
        The file.
    unit_mm
        Length of its unit, mm: 1000 for a file in metres, whose covariances are then in m².

    Raises
    ------
    UsageError
        If the file cannot be read or something in it is no line; the message gives the line number.
    """
    file = Path(path)
    content = file_bytes(file)
    rows = list(numbered_rows(decoded(content, file)))
    if not rows:
        raise UsageError("holds no lines", next_step=_COLUMNS_HELP, path=file)
    heading = None if _is_numeric(rows[0][1]) else rows.pop(0)
    columns = _columns(heading, rows, file)
    spread = _covariance_columns(heading, file)
    if not rows:
        raise UsageError("holds a heading but no lines", next_step="add the lines", path=file)
    values = [_numbers(number, row, columns, file) for number, row in rows]
    return Lines(
        names=_names(heading, rows),
        points_mm=unit_mm * checked([row[:3] for row in values], (None, 3), "points_mm"),
        directions=checked([row[3:] for row in values], (None, 3), "directions"),
        source=file.name,
        sha256=hashlib.sha256(content).hexdigest(),
        covariances_mm2=unit_mm**2 * _covariances(rows, spread, file) if spread else None,
    )


def _is_numeric(row: Sequence[str]) -> bool:
    """Tell a row of numbers from a heading: a heading holds no number at all."""
    return any(not math.isnan(finite_or_nan(cell)) for cell in row)


def _columns(
    heading: tuple[int, list[str]] | None, rows: Sequence[tuple[int, list[str]]], file: Path
) -> list[int]:
    """Return where the six numbers stand in each row."""
    if heading is None:
        number, row = rows[0]
        if len(row) != 6:
            raise UsageError(
                f"line {number}: has no heading and {len(row)} columns, not 6",
                next_step=_COLUMNS_HELP,
                path=file,
            )
        return list(range(6))
    number, titles = heading
    known = [title.lower().removesuffix("_mm") for title in titles]
    columns = []
    for names in (*_POINT, *_DIRECTION):
        found = next((known.index(name) for name in names if name in known), None)
        if found is None:
            raise UsageError(
                f"line {number}: has no column {names[0]}; its columns are {', '.join(titles)}",
                next_step=_COLUMNS_HELP,
                path=file,
            )
        columns.append(found)
    return columns


def _numbers(number: int, row: Sequence[str], columns: Sequence[int], file: Path) -> list[float]:
    """Return the six numbers of a row: a point, and a direction that has a length."""
    values = _finite(number, row, columns, file)
    if not any(values[3:]):
        raise UsageError(
            f"line {number}: its direction is zero",
            next_step="correct the line or remove it",
            path=file,
        )
    return values


def _finite(number: int, row: Sequence[str], columns: Sequence[int], file: Path) -> list[float]:
    """Return the numbers that stand in some columns of a row."""
    if len(row) <= max(columns):
        raise UsageError(
            f"line {number}: has {len(row)} cells, but {max(columns) + 1} are needed",
            next_step="complete the line or remove it",
            path=file,
        )
    values = [finite_or_nan(row[column]) for column in columns]
    for value, column in zip(values, columns, strict=True):
        if math.isnan(value):
            raise UsageError(
                f"line {number}, column {column + 1}: {row[column]!r} is not a finite number",
                next_step="correct the line or remove it",
                path=file,
            )
    return values


def _covariance_columns(heading: tuple[int, list[str]] | None, file: Path) -> list[int]:
    """Return where the six numbers of the covariance stand; empty where there are none."""
    if heading is None:
        return []
    number, titles = heading
    known = [title.lower().removesuffix("_mm2") for title in titles]
    missing = [name for name in _COVARIANCE if name not in known]
    if missing and len(missing) < len(_COVARIANCE):
        raise UsageError(
            f"line {number}: has a covariance without {missing[0]}_mm2",
            next_step=f"head all of {', '.join(name + '_mm2' for name in _COVARIANCE)}, or none",
            path=file,
        )
    return [] if missing else [known.index(name) for name in _COVARIANCE]


def _covariances(
    rows: Sequence[tuple[int, list[str]]], columns: Sequence[int], file: Path
) -> Floats:
    """Return the covariances, shape (n, 3, 3), mm²."""
    values = np.array([_finite(number, row, columns, file) for number, row in rows])
    covariances: Floats = values[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
    eigenvalues = np.linalg.eigvalsh(covariances)
    negative = eigenvalues[:, 0] < -1e-9 * np.abs(eigenvalues[:, 2])
    if negative.any():
        number = rows[int(np.argmax(negative))][0]
        raise UsageError(
            f"line {number}: its covariance has a negative eigenvalue",
            next_step="correct the line or leave the covariance out",
            path=file,
        )
    return covariances


def _names(
    heading: tuple[int, list[str]] | None, rows: Sequence[tuple[int, list[str]]]
) -> tuple[str, ...]:
    titles = [] if heading is None else [title.lower() for title in heading[1]]
    column = next((titles.index(name) for name in _NAME if name in titles), None)
    return tuple(
        str(number) if column is None or column >= len(row) else row[column] for number, row in rows
    )
