"""Whether a report or a result still says what its inputs say."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

from pivometer._version import SOFTWARE
from pivometer.errors import PivometerError, UsageError
from pivometer.io.result import (
    RESULT_SCHEMA,
    SEAL,
    measurement_in,
    result_content,
    seal_of,
    text_of,
)
from pivometer.io.session import load
from pivometer.measurement import Measurement, Options, Provenance
from pivometer.pipeline.differences import differences
from pivometer.pipeline.measuring import measure
from pivometer.pipeline.provenance import SETTINGS
from pivometer.pipeline.reading import Progress
from pivometer.pipeline.reporting import Report, page_of, record_in
from pivometer.pipeline.tampering import page_changes
from pivometer.report.embedding import (
    RECORD,
    RESULT,
    blocks_of_page,
    pictures_of_page,
    unpacked,
)

Status = Literal["holds", "changed", "not checked"]

NAMED = 8
"""So many changed files or figures are named; of more, the number is given."""


@dataclass(frozen=True, slots=True, eq=False)
class Examined:
    """One thing that was verified.

    Parameters
    ----------
    name
        What.
    status
        ``"holds"``, ``"changed"``, or ``"not checked"`` where that was not possible.
    text
        What was found.
    """

    name: str
    status: Status
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class Verification:
    """What was verified of a file.

    Parameters
    ----------
    file
        The file.
    examined
        Everything that was looked at, in order.
    """

    file: Path
    examined: tuple[Examined, ...]

    @property
    def exit_code(self) -> int:
        """0 all holds, 4 something changed, 5 something could not be checked."""
        statuses = {one.status for one in self.examined}
        return 4 if "changed" in statuses else 5 if "not checked" in statuses else 0

    @property
    def sentence(self) -> str:
        """The outcome in one sentence."""
        changed, unchecked = (
            [one.name for one in self.examined if one.status == status]
            for status in ("changed", "not checked")
        )
        if changed:
            return f"Changed: {', '.join(changed)}."
        if unchecked:
            return f"Nothing found changed, but not all could be checked: {', '.join(unchecked)}."
        return "Verified: everything is as it was when the report was made."


@dataclass(frozen=True, slots=True, eq=False)
class _Opened:
    """A file with the result in it, and what its own bytes say."""

    content: dict[str, Any]
    measurement: Measurement
    examined: tuple[Examined, ...]


def verify(
    file: Path | str,
    session: Path | str | None = None,
    *,
    file_only: bool = False,
    progress: Progress | None = None,
) -> Verification:
    """Verify a report or a result: its own bytes, its inputs, and every figure.

    Parameters
    ----------
    file
        A ``result.json`` or a ``report.html`` that Pivometer wrote.
    session
        The session folder; the one the file lies in, or in whose ``results`` it lies, where none
        is given.
    file_only
        Whether to leave the session alone, and look at the file only.
    progress
        Called as ``progress(stage, done, total)``.

    Raises
    ------
    UsageError
        If the file cannot be read or is none of Pivometer's, or `session` is no session.
    """
    path = Path(file)
    opened = _opened(path)
    if isinstance(opened, Examined):
        return Verification(path, (opened,))
    found = [*opened.examined, *_seal(opened)]
    if not file_only:
        folder = _session_of(path) if session is None else Path(session)
        found += _against_session(opened, folder, progress)
    return Verification(path, tuple(found))


def _session_of(path: Path) -> Path | None:
    """Return the session that a file lies in."""
    near = path.resolve().parents[:2]
    return next((folder for folder in near if (folder / SETTINGS).is_file()), None)


# --- The file itself ---


def _opened(path: Path) -> _Opened | Examined:
    """Read a file, by what it holds."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UsageError(
            f"cannot be read: {error.strerror}", next_step="check the path", path=path
        ) from error
    reader = next((reader for mark, reader in _READERS.items() if mark in data), None)
    if reader is None:
        raise UsageError(
            "holds no result of Pivometer",
            next_step="name a result.json or a report.html",
            path=path,
        )
    try:
        return reader(data)
    except (UsageError, ValueError, RecursionError) as error:
        what = error.what if isinstance(error, PivometerError) else str(error)
        return Examined("the file", "changed", f"it is damaged and states no result: {what}")


def _opened_json(data: bytes) -> _Opened:
    content = json.loads(data)
    measurement = measurement_in(content, RESULT)
    return _Opened(content, measurement, (_bytes("the bytes", text_of(content).encode(), data),))


def _opened_page(data: bytes) -> _Opened:
    page = data.decode()
    blocks = blocks_of_page(page)
    result, record = (unpacked(blocks.get(name, "")) for name in (RESULT, RECORD))
    if result is None or record is None:
        raise UsageError("what it carries cannot be unpacked", next_step="take the report anew")
    report = Report(result, record, pictures_of_page(page))
    content = json.loads(result)
    examined = (
        _bytes("the carried result", text_of(content).encode(), result.encode()),
        _pictures(report),
        _drawn(content, partial(_redrawn, page, report, blocks)),
    )
    return _Opened(content, measurement_in(content, RESULT), examined)


_READERS: Mapping[bytes, Callable[[bytes], _Opened]] = {
    b"<!DOCTYPE html>": _opened_page,
    RESULT_SCHEMA.rpartition("/")[0].encode(): _opened_json,
}


def _bytes(name: str, expected: bytes, found: bytes) -> Examined:
    if expected == found:
        return Examined(name, "holds", "as Pivometer writes them")
    return Examined(name, "changed", "the text is not as Pivometer writes this content")


def _pictures(report: Report) -> Examined:
    recorded = record_in(report.record).pictures
    missing = [name for name, one in recorded.items() if one.sha256 not in report.pictures]
    if missing:
        return Examined("the pictures", "changed", f"not those recorded: {_named(missing)}")
    return Examined("the pictures", "holds", f"{len(recorded)} as recorded")


def _drawn(content: Mapping[str, Any], redraw: Callable[[], list[str]]) -> Examined:
    """Compare the page with one drawn anew, if this is the version that drew it."""
    name, stated = "the displayed figures", str(content.get("software"))
    if stated != SOFTWARE:
        text = f"drawn by {stated}, and this is {SOFTWARE}: install that version to compare them"
        return Examined(name, "not checked", text)
    changes = redraw()
    if changes:
        return Examined(name, "changed", "; ".join(changes))
    return Examined(name, "holds", "the page drawn anew from what it carries is the same")


def _redrawn(page: str, report: Report, blocks: Mapping[str, str]) -> list[str]:
    return page_changes(page, page_of(report, blocks), limit=NAMED)


def _seal(opened: _Opened) -> Iterator[Examined]:
    name, stated = "the result’s own SHA-256", opened.content.get(SEAL)
    if stated is None:
        yield Examined(name, "not checked", "this file is of a version that stated none")
    elif stated == seal_of(opened.content):
        yield Examined(name, "holds", str(stated))
    else:
        yield Examined(name, "changed", f"states {stated}, is {seal_of(opened.content)}")


# --- Its inputs ---


def _against_session(
    opened: _Opened, folder: Path | None, progress: Progress | None
) -> Iterator[Examined]:
    if folder is None:
        text = "the file lies in no session: name the session's folder, too"
        yield Examined("the inputs", "not checked", text)
        yield Examined("the figures", "not checked", "without inputs nothing can be measured again")
        return
    inputs = _inputs(opened.measurement.inputs, folder)
    yield inputs
    yield _figures(opened, folder, inputs, progress)


def _inputs(stated: Mapping[str, str], folder: Path) -> Examined:
    """Compare the hashes of all files."""
    changed = []
    for name, digest in stated.items():
        found = _digest(folder / name) if _is_inside(name) else None
        if found != digest:
            changed.append(name if found else f"{name} (missing)")
    if changed:
        return Examined("the inputs", "changed", _named(changed))
    if SETTINGS not in stated:
        text = f"{len(stated)} files are unchanged, but {SETTINGS} was not recorded then"
        return Examined("the inputs", "not checked", text)
    return Examined("the inputs", "holds", f"{len(stated)} files, byte for byte")


def _is_inside(name: str) -> bool:
    """Tell whether a name stays in the session: a file from elsewhere is not to be trusted."""
    path = Path(name)
    return not path.is_absolute() and ".." not in path.parts


def _digest(path: Path) -> str | None:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return None


# --- Its figures ---


def _figures(
    opened: _Opened, folder: Path, inputs: Examined, progress: Progress | None
) -> Examined:
    """Measure again and compare."""
    name, provenance = "the figures", opened.measurement.provenance
    if inputs.status == "changed":
        return Examined(name, "not checked", "the inputs are not those they were measured from")
    if provenance is None or provenance.options is None:
        return Examined(name, "not checked", "the file does not state how it was measured")
    try:
        again = _measured_again(opened.measurement, provenance.options, folder, progress)
    except PivometerError as error:
        return Examined(name, "changed", f"measured again, the session is refused: {error.what}")
    found = differences(opened.content, result_content(again))
    if found.beyond:
        other = _other_versions(provenance, again)
        return Examined(name, "changed", f"{_named(found.beyond)}{other}")
    how = "to the last bit"
    if not found.identical:
        how = f"within {found.largest:.0e} of their size; rounding may make {found.TOLERANCE:g}"
    return Examined(name, "holds", f"{found.count} measured again are the same {how}")


def _other_versions(provenance: Provenance, again: Measurement) -> str:
    """Name the software that differs from what the file was made with."""
    now = again.provenance.versions if again.provenance else {}
    others = [
        f"{name} {version}, now {now[name]}"
        for name, version in provenance.versions.items()
        if now.get(name, version) != version
    ]
    return f" (made with {', '.join(others)})" if others else ""


def _measured_again(
    measurement: Measurement, options: Options, folder: Path, progress: Progress | None
) -> Measurement:
    return measure(
        load(folder),
        rig=measurement.calibration if options.rig_given else None,
        method=options.method,  # type: ignore[arg-type]
        distortion=options.distortion,  # type: ignore[arg-type]
        hints=options.hints,
        centerline=options.centerline,  # type: ignore[arg-type]
        progress=progress,
    )


def _named(names: list[str]) -> str:
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(names[:NAMED]) + more
