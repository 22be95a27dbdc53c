"""What a session says of its poses: ``poses.csv`` with joints, time and side of approach."""

from __future__ import annotations

import difflib
import hashlib
import math
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from pivometer._arrays import Floats, checked, read_only
from pivometer.errors import SessionError
from pivometer.io.images import EXTENSIONS
from pivometer.io.rows import decoded, file_bytes, finite_or_nan, numbered_rows

FILE_NAME = "poses.csv"

UNITS = ("_deg", "_rad", "_mm")

_STEP = (
    "head the columns pose, then time_s, approach and joints with their unit such as joint1_deg, "
    "q2_rad or d3_mm; give one row for each pose under shaft/"
)


@dataclass(frozen=True, slots=True, eq=False)
class PoseTable:
    """What is known of each pose of a session besides its images.

    Parameters
    ----------
    poses
        The poses' file stems, in the order of the file.
    times_s
        When each was taken, shape (n,), s; `None` where the file has no column ``time_s``.
    approach
        From where each was approached; empty where the file has no column ``approach``.
    joints
        Joint values by column name, shape (n,) each, in the unit that ends the name.
    sha256
        Of the file.
    """

    poses: tuple[str, ...]
    times_s: Floats | None
    approach: tuple[str, ...]
    joints: Mapping[str, Floats]
    sha256: str

    def __post_init__(self) -> None:
        count = len(self.poses)
        columns = {
            name: read_only(checked(column, (count,), name)) for name, column in self.joints.items()
        }
        object.__setattr__(self, "joints", MappingProxyType(columns))
        if self.times_s is not None:
            object.__setattr__(self, "times_s", read_only(checked(self.times_s, (count,), "time")))

    def rows_of(self, poses: Sequence[str]) -> PoseTable:
        """Return the rows of some poses, in their order."""
        rows = [self.poses.index(pose) for pose in poses]
        return PoseTable(
            poses=tuple(poses),
            times_s=None if self.times_s is None else self.times_s[rows],
            approach=tuple(self.approach[row] for row in rows) if self.approach else (),
            joints={name: column[rows] for name, column in self.joints.items()},
            sha256=self.sha256,
        )


def read_pose_table(path: Path | str, poses: Iterable[str]) -> PoseTable:
    """Read ``poses.csv``.

    Parameters
    ----------
    path
        The file: CSV with a heading, any usual separator.
    poses
        The file stems of the session's poses. A spreadsheet's 7 or 007.png is taken for pose 007.
        Rows of other poses, such as those whose pictures were thrown away, are passed over.

    Raises
    ------
    SessionError
        If the file is no such table, or does not have exactly one row for each pose; the message
        gives the line number.
    UsageError
        If it cannot be read or is not UTF-8.
    """
    file, known = Path(path), tuple(poses)
    content = file_bytes(file)
    rows = list(numbered_rows(decoded(content, file)))
    if not rows:
        raise SessionError("is empty", next_step=_STEP, path=file)
    titles = _titles(*rows[0], file)
    cells = [(number, _complete(number, row, titles, file)) for number, row in rows[1:]]
    at = titles.index("pose")
    names = [_pose(row[at], known) for _, row in cells]
    _refuse_repeated(names, [number for number, _ in cells], file)
    _refuse_missing(names, known, file)
    cells = [cell for cell, name in zip(cells, names, strict=True) if name in known]
    names = [name for name in names if name in known]
    numbers = {
        title: [_number(number, title, row[column], file) for number, row in cells]
        for column, title in enumerate(titles)
        if title not in ("pose", "approach")
    }
    times = numbers.pop("time_s", None)
    return PoseTable(
        poses=tuple(names),
        times_s=None if times is None else read_only(times),
        approach=_labels(titles, cells, file),
        joints={title: read_only(column) for title, column in numbers.items()},
        sha256=hashlib.sha256(content).hexdigest(),
    )


def _titles(number: int, row: list[str], file: Path) -> list[str]:
    """Check the heading."""
    lowered = ["pose", "time_s", "approach"]
    titles = [title.lower() if title.lower() in lowered else title for title in row]
    if "pose" not in titles:
        raise _wrong(number, f"the heading has no column pose: {', '.join(row)}", file)
    for title in titles:
        if titles.count(title) > 1:
            raise _wrong(number, f"two columns are called {title!r}", file)
        if title not in lowered and not title.endswith(UNITS):
            raise _wrong(
                number,
                f"column {title!r} does not end in a unit: {', '.join(UNITS)}",
                file,
            )
    return titles


def _complete(number: int, row: list[str], titles: list[str], file: Path) -> list[str]:
    """Check that a row has a cell in every column, and no more."""
    while len(row) > len(titles) and not row[-1]:
        row = row[:-1]
    if len(row) != len(titles):
        raise _wrong(number, f"has {len(row)} cells, but the heading has {len(titles)}", file)
    return row


def _pose(cell: str, known: tuple[str, ...]) -> str:
    """Return the pose that a cell names, or the cell where it names none."""
    name = unicodedata.normalize("NFC", cell)
    if Path(name).suffix.lower() in EXTENSIONS and name not in known:
        name = Path(name).stem
    if name in known:
        return name
    if name.isdigit():
        same = [stem for stem in known if stem.isdigit() and int(stem) == int(name)]
        if len(same) == 1:
            return same[0]
    return name


def _refuse_repeated(names: Sequence[str], numbers: Sequence[int], file: Path) -> None:
    first: dict[str, int] = {}
    for name, number in zip(names, numbers, strict=True):
        if name in first:
            raise _wrong(number, f"pose {name!r} has a row already, in line {first[name]}", file)
        first[name] = number


def _refuse_missing(names: Sequence[str], known: Sequence[str], file: Path) -> None:
    missing = [pose for pose in known if pose not in set(names)]
    if missing:
        shown = ", ".join(missing[:5]) + (f" and {len(missing) - 5} more" * (len(missing) > 5))
        other = [name for name in names if name not in set(known)]
        near = difflib.get_close_matches(missing[0], other, n=1)
        hint = f"; its row {near[0]!r} names no pose" if near else ""
        raise SessionError(f"has no row for pose {shown}{hint}", next_step=_STEP, path=file)


def _number(number: int, title: str, cell: str, file: Path) -> float:
    value = finite_or_nan(cell)
    if math.isnan(value):
        what = "is empty" if not cell else f"is {cell!r}, not a finite number"
        raise _wrong(number, f"{title} {what}", file)
    return value


def _labels(
    titles: list[str], cells: Sequence[tuple[int, list[str]]], file: Path
) -> tuple[str, ...]:
    if "approach" not in titles:
        return ()
    at = titles.index("approach")
    for number, row in cells:
        if not row[at]:
            raise _wrong(number, "approach is empty", file)
    return tuple(row[at] for _, row in cells)


def _wrong(number: int, what: str, file: Path) -> SessionError:
    return SessionError(f"line {number}: {what}", next_step=_STEP, path=file)
