"""The index of all results under a folder: a cache that can be deleted at any moment.

The results themselves are the record. The index, an SQLite file, only saves reading them again; it
is brought up to date from them each time, and made anew where it is missing or damaged.
"""

from __future__ import annotations

import hashlib
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from dataclasses import astuple, dataclass, fields
from datetime import UTC, datetime
from pathlib import Path

from pivometer.calibration import Calibration
from pivometer.errors import UsageError
from pivometer.io.result import read_result
from pivometer.measurement import Measurement

FILE_NAME = ".pivometer-history.sqlite"
_VERSION = 1
_WAIT_S = 30.0
"""How long to wait for another run that writes the index."""


@dataclass(frozen=True, slots=True)
class Entry:
    """What the history keeps of a result; lengths in mm.

    Parameters
    ----------
    path
        The file, in the folder.
    stamp
        Its size and time of change, which tell whether it must be read again.
    sha256
        Of its bytes: a copy counts once.
    made
        When it was measured, ISO 8601; when the file was written, where it does not say.
    device
        The robot, as ``session.toml`` names it.
    session
        The session's name.
    problem
        Why the file is no result; empty where it is one.
    poses
        How many poses were used.
    rms_mm, max_mm
        Of the misses from the least-squares and the minimax point.
    own_low_mm, own_high_mm
        Interval of the robot's own rms.
    noise_mm
        Rms that the instrument alone would show.
    held_out_mm
        Rms error of held-out board edges.
    diameter_mm
        Measured diameter of the shaft.
    """

    path: str
    stamp: str
    sha256: str
    made: str = ""
    device: str = ""
    session: str = ""
    problem: str = ""
    poses: int = 0
    rms_mm: float | None = None
    max_mm: float | None = None
    own_low_mm: float | None = None
    own_high_mm: float | None = None
    noise_mm: float | None = None
    held_out_mm: float | None = None
    diameter_mm: float | None = None


def indexed_results(folder: Path | str) -> list[Entry]:
    """Return all results under a folder, in the order in which they were measured.

    Several runs at once are safe: each brings the index up to date in one transaction. In a folder
    that cannot be written nothing is stored.

    Raises
    ------
    UsageError
        If there is no such folder.
    """
    root = Path(folder)
    if not root.is_dir():
        raise UsageError("is no folder", next_step="name the folder of all sessions", path=root)
    files = {path.relative_to(root).as_posix(): path for path in sorted(_result_files(root))}
    try:
        with _opened(root / FILE_NAME) as index:
            entries = _brought_up_to_date(index, files)
    except sqlite3.OperationalError:  # cannot be written, or is locked for long: read all
        entries = [_entry(name, path) for name, path in files.items()]
    except sqlite3.DatabaseError:  # damaged
        (root / FILE_NAME).unlink(missing_ok=True)
        with _opened(root / FILE_NAME) as index:
            entries = _brought_up_to_date(index, files)
    return sorted(_once(entries), key=lambda one: (one.made, one.path))


def _result_files(root: Path) -> Iterator[Path]:
    """Find every ``result.json``, ``arm-2-result.json``, …; hidden folders are left out."""
    for path in root.rglob("*result.json"):
        if not any(part.startswith(".") for part in path.relative_to(root).parts):
            yield path


@contextmanager
def _opened(path: Path) -> Iterator[sqlite3.Connection]:
    with closing(sqlite3.connect(path, timeout=_WAIT_S, isolation_level=None)) as index:
        index.execute("BEGIN IMMEDIATE")
        if index.execute("PRAGMA user_version").fetchone()[0] != _VERSION:
            index.execute("DROP TABLE IF EXISTS results")
        index.execute(f"PRAGMA user_version = {_VERSION}")
        columns = ", ".join(f"{field.name} " for field in fields(Entry))
        index.execute(f"CREATE TABLE IF NOT EXISTS results ({columns}, PRIMARY KEY (path))")
        yield index
        index.execute("COMMIT")


def _brought_up_to_date(index: sqlite3.Connection, files: Mapping[str, Path]) -> list[Entry]:
    """Read what is new or changed, forget what is gone."""
    known = {row[0]: Entry(*row) for row in index.execute("SELECT * FROM results")}
    entries = [
        known[name] if name in known and known[name].stamp == _stamp(path) else _entry(name, path)
        for name, path in files.items()
    ]
    marks = ", ".join("?" for _ in fields(Entry))
    index.execute("DELETE FROM results")
    index.executemany(f"INSERT INTO results VALUES ({marks})", map(astuple, entries))  # noqa: S608 – no text of users
    return entries


def _stamp(path: Path) -> str:
    with suppress(OSError):
        about = path.stat()
        return f"{about.st_size} {about.st_mtime_ns}"
    return ""


def _entry(name: str, path: Path) -> Entry:
    """Read a file."""
    stamp = _stamp(path)
    try:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        measurement = read_result(path)
    except OSError as error:
        return Entry(name, stamp, "", problem=f"cannot be read: {error.strerror}")
    except UsageError as error:
        return Entry(name, stamp, digest, problem=error.what)
    return _summary(name, stamp, digest, measurement, path)


def _summary(name: str, stamp: str, digest: str, m: Measurement, path: Path) -> Entry:
    written = datetime.fromtimestamp(path.stat().st_mtime, UTC).isoformat(timespec="seconds")
    own, calibration = m.intrinsic, m.calibration
    return Entry(
        path=name,
        stamp=stamp,
        sha256=digest,
        made=m.provenance.created if m.provenance else written,
        device=device_name(m.setup.device),
        session=m.setup.session,
        poses=len(m.used),
        rms_mm=m.rcm.least_squares.rms_mm,
        max_mm=m.rcm.minimax.max_mm,
        own_low_mm=None if own is None else float(own.rms_interval_mm[0]),
        own_high_mm=None if own is None else float(own.rms_interval_mm[1]),
        noise_mm=None if own is None else own.instrument_rms_mm,
        held_out_mm=calibration.held_out.rms_mm if isinstance(calibration, Calibration) else None,
        diameter_mm=None if m.shaft is None else m.shaft.diameter.value_mm,
    )


def device_name(device: Mapping[str, object]) -> str:
    """Name a robot by what ``[device]`` of a session says.

    Examples
    --------
    >>> device_name({"name": "arm 2", "serial": "K-17", "tool": {"number": 4}}), device_name({})
    ('arm 2 K-17', '')
    """
    return " ".join(str(value) for value in device.values() if not isinstance(value, Mapping))


def _once(entries: list[Entry]) -> list[Entry]:
    """Leave out copies of a file."""
    first = {one.sha256 or one.path: one for one in reversed(entries)}
    return [one for one in entries if first[one.sha256 or one.path] is one]
