"""What the bytes of a result, a page or a PDF say of themselves."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pivometer._version import software
from pivometer.errors import PivometerError, UsageError
from pivometer.io.result import RESULT_SCHEMA, SEAL, measurement_in, seal_of, text_of
from pivometer.measurement import Measurement
from pivometer.pipeline.reporting import Report, page_of, pdf_of, report_in
from pivometer.pipeline.tampering import page_changes
from pivometer.report.embedding import RECORD, RESULT, blocks_of_page, pictures_of_page, unpacked
from pivometer.report.pdf import pdf_extra_is_there
from pivometer.report.pdf_reading import (
    attachments_of_pdf,
    creator_of_pdf,
    pdf_difference,
    pictures_of_pdf,
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
class Opened:
    """A file with the result in it.

    Parameters
    ----------
    content, measurement
        The result.
    examined
        What the file's own bytes say.
    report
        What a page or PDF is drawn from; `None` of a result.
    """

    content: Mapping[str, Any]
    measurement: Measurement
    examined: tuple[Examined, ...]
    report: Report | None = None


def opened_file(path: Path) -> Opened | Examined:
    """Read a file by what it holds; one that is damaged is itself a finding.

    Raises
    ------
    UsageError
        If it cannot be read, or is none of Pivometer's.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UsageError(
            f"cannot be read: {error.strerror}", next_step="check the path", path=path
        ) from error
    reader = next((reader for is_it, reader in _READERS if is_it(data)), None)
    if reader is None:
        raise UsageError(
            "holds no result of Pivometer",
            next_step="name a result.json, a report.html or a report.pdf",
            path=path,
        )
    try:
        return reader(data)
    except (UsageError, ValueError, RecursionError) as error:
        what = error.what if isinstance(error, PivometerError) else str(error)
        return Examined("the file", "changed", f"it is damaged and states no result: {what}")


def seal_examined(content: Mapping[str, Any]) -> Examined:
    """Compare the SHA-256 that a result states of itself."""
    name, stated, found = "the result’s own SHA-256", content.get(SEAL), seal_of(content)
    if stated is None:
        return Examined(name, "not checked", "this file is of a version that stated none")
    if stated == found:
        return Examined(name, "holds", found)
    return Examined(name, "changed", f"states {stated}, is {found}")


# --- By kind of file ---


def _opened_json(data: bytes) -> Opened:
    content = json.loads(data)
    measurement = measurement_in(content, RESULT)
    return Opened(content, measurement, (_bytes("the bytes", content, data.decode()),))


def _opened_page(data: bytes) -> Opened:
    page = data.decode()
    blocks = blocks_of_page(page)
    texts = [unpacked(blocks.get(name, "")) for name in (RESULT, RECORD)]
    report = _report([text for text in texts if text is not None], pictures_of_page(page))

    def redrawn() -> Examined:
        changes = page_changes(page, page_of(report, blocks), limit=NAMED)
        return _drawn("; ".join(changes), "the page drawn anew from what it carries is the same")

    return _opened_report(report, redrawn)


def _opened_pdf(data: bytes) -> Opened:
    report = _report(attachments_of_pdf(data), pictures_of_pdf(data))

    def redrawn() -> Examined:
        if not pdf_extra_is_there():
            text = 'typesetting it anew needs typst: pip install "pivometer[pdf]"'
            return Examined(_DRAWN, "not checked", text)
        again = pdf_of(report)
        ours, theirs = creator_of_pdf(again), creator_of_pdf(data)
        if ours != theirs:
            text = f"typeset by {theirs}, and this is {ours}: install that to compare them"
            return Examined(_DRAWN, "not checked", text)
        same = "the PDF typeset anew from what it carries is the same"
        return _drawn(pdf_difference(data, again), same)

    return _opened_report(report, redrawn)


def _is_page(data: bytes) -> bool:
    return data.startswith(b"<!DOCTYPE html>") and b'content="pivometer ' in data


def _is_pdf(data: bytes) -> bool:
    return data.startswith(b"%PDF-") and b"result.json" in data


def _is_result(data: bytes) -> bool:
    return RESULT_SCHEMA.rpartition("/")[0].encode() in data and not data.startswith(b"%PDF")


_READERS: tuple[tuple[Callable[[bytes], bool], Callable[[bytes], Opened]], ...] = (
    (_is_page, _opened_page),
    (_is_pdf, _opened_pdf),
    (_is_result, _opened_json),
)


def _report(texts: list[str], pictures: Mapping[str, bytes]) -> Report:
    if len(texts) != 2:
        raise UsageError("what it carries cannot be unpacked", next_step="take the report anew")
    return report_in(texts[0], texts[1], pictures)


# --- What is looked at ---

_DRAWN = "the displayed figures"


def _opened_report(report: Report, redrawn: Callable[[], Examined]) -> Opened:
    examined = (
        _bytes("the carried result", report.content, report.texts[RESULT]),
        _pictures(report),
        redrawn() if report.measurement.software == software() else _other_version(report),
    )
    return Opened(report.content, report.measurement, examined, report)


def _bytes(name: str, content: Mapping[str, Any], text: str) -> Examined:
    if text_of(content) == text:
        return Examined(name, "holds", "written as Pivometer writes it")
    return Examined(name, "changed", "the text is not as Pivometer writes this content")


def _pictures(report: Report) -> Examined:
    if report.lost:
        return Examined("the pictures", "changed", f"not those recorded: {named(report.lost)}")
    return Examined("the pictures", "holds", f"{len(report.record.pictures)} as recorded")


def _drawn(difference: str, same: str) -> Examined:
    return Examined(_DRAWN, "changed" if difference else "holds", difference or same)


def _other_version(report: Report) -> Examined:
    stated = report.measurement.software
    text = f"drawn by {stated}, and this is {software()}: install that version to compare them"
    return Examined(_DRAWN, "not checked", text)


def named(names: list[str]) -> str:
    """List names, and of many only some."""
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(names[:NAMED]) + more
