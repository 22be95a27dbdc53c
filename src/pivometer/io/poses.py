"""Tracked poses of an instrument from a CSV file: one 4×4 matrix a row."""

import hashlib
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pivometer._arrays import Floats, checked, read_only
from pivometer.errors import UsageError
from pivometer.io.rows import decoded, file_bytes, finite_or_nan, numbered_rows

ROTATION_TOLERANCE = 1e-3
"""A matrix further from a rotation is none, such as one in another order; trackers write 1e-7."""

_TITLES = tuple(f"t{row}{column}" for row in range(3) for column in range(4))
_STEP = "give one 4×4 matrix a row, row by row (16 numbers), in mm; or head the columns t00 … t23"


@dataclass(frozen=True, slots=True, eq=False)
class TrackedPoses:
    """Poses in the order in which they were taken.

    Parameters
    ----------
    rotations
        From the instrument's frame to the tracker's, shape (n, 3, 3).
    translations_mm
        The instrument's origin in the tracker's frame, shape (n, 3), mm.
    source
        The file's name.
    sha256
        Of the file.
    """

    rotations: Floats
    translations_mm: Floats
    source: str
    sha256: str

    def __post_init__(self) -> None:
        for name, shape in (("rotations", (None, 3, 3)), ("translations_mm", (None, 3))):
            object.__setattr__(self, name, read_only(checked(getattr(self, name), shape, name)))


def read_poses(path: Path | str, *, unit_mm: float = 1.0) -> TrackedPoses:
    """Read poses from CSV, in the order of time.

    With a heading, columns ``t00`` … ``t23`` may stand beside others; without one, each row holds
    the 16 numbers of a 4×4 matrix, row by row.

    Parameters
    ----------
    path
        The file.
    unit_mm
        Length of its unit, mm: 1000 for a file in metres.

    Raises
    ------
    UsageError
        If the file cannot be read or a row is no pose; the message gives the line number.
    """
    file = Path(path)
    content = file_bytes(file)
    rows = list(numbered_rows(decoded(content, file)))
    columns = list(range(12))
    if rows and all(math.isnan(finite_or_nan(cell)) for cell in rows[0][1]):
        number, titles = rows.pop(0)
        known = [title.lower() for title in titles]
        missing = [title for title in _TITLES if title not in known]
        if missing:
            raise _wrong(number, f"has no column {missing[0]}", file)
        columns = [known.index(title) for title in _TITLES]
    elif rows and len(rows[0][1]) != 16:
        raise _wrong(rows[0][0], f"has no heading and {len(rows[0][1])} columns, not 16", file)
    if not rows:
        raise UsageError("holds no poses", next_step=_STEP, path=file)
    matrices = np.stack([_matrix(number, row, columns, file) for number, row in rows])
    return TrackedPoses(
        rotations=matrices[:, :, :3],
        translations_mm=unit_mm * matrices[:, :, 3],
        source=file.name,
        sha256=hashlib.sha256(content).hexdigest(),
    )


def _matrix(number: int, row: list[str], columns: list[int], file: Path) -> Floats:
    """Return the upper three rows of a matrix, shape (3, 4)."""
    values = [finite_or_nan(row[column]) if column < len(row) else math.nan for column in columns]
    if any(map(math.isnan, values)):
        raise _wrong(number, "holds fewer finite numbers than a pose needs", file)
    matrix = np.reshape(values, (3, 4))
    rotation = matrix[:, :3]
    off = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if off > ROTATION_TOLERANCE or np.linalg.det(rotation) < 0:
        raise _wrong(number, f"is no rotation: R Rᵀ is off the identity by {off:.2g}", file)
    return matrix


def _wrong(number: int, what: str, file: Path) -> UsageError:
    return UsageError(f"line {number}: {what}", next_step=_STEP, path=file)
