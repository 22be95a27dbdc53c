"""A report from what its file states: the same content always gives the same bytes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from pivometer.errors import UsageError
from pivometer.io.codec import jsonable, typed
from pivometer.io.result import SEAL, measurement_in, result_text, text_of
from pivometer.measurement import Measurement
from pivometer.report.embedding import RECORD, RESULT, Carried, ReportRecord, packed
from pivometer.report.html import render_html
from pivometer.report.pdf import render_pdf
from pivometer.report.thumbnails import Thumbnail


@dataclass(frozen=True, slots=True, eq=False)
class Report:
    """What a report is drawn from: nothing but what its file carries.

    Parameters
    ----------
    texts
        What it carries: ``result.json``, and what else it shows, by name.
    pictures
        Its encoded pictures by their SHA-256.
    content
        The content of the result.
    measurement, record
        What the two texts state.
    """

    texts: Mapping[str, str]
    pictures: Mapping[str, bytes]
    content: Mapping[str, Any]
    measurement: Measurement
    record: ReportRecord

    @property
    def seal(self) -> str:
        """The SHA-256 that the result states of itself."""
        return str(self.content.get(SEAL, "not stated"))

    @property
    def lost(self) -> list[str]:
        """The recorded pictures that are not there."""
        recorded = self.record.pictures.items()
        return [name for name, one in recorded if one.sha256 not in self.pictures]


def report_of(
    measurement: Measurement, record: ReportRecord, thumbnails: Iterable[Thumbnail]
) -> Report:
    """Gather what a report is drawn from."""
    pictures = {hashlib.sha256(one.jpeg).hexdigest(): one.jpeg for one in thumbnails}
    return report_in(result_text(measurement), text_of(jsonable(record)), pictures)


def report_in(result: str, record: str, pictures: Mapping[str, bytes]) -> Report:
    """Read what a report carries.

    Raises
    ------
    UsageError
        If a text does not state what it should.
    """
    try:
        content, shown = json.loads(result), typed(ReportRecord, json.loads(record))
    except (ValueError, RecursionError) as error:
        raise UsageError(f"is not JSON: {error}", next_step="take the report anew") from error
    texts = {RESULT: result, RECORD: record}
    return Report(texts, pictures, content, measurement_in(content, RESULT), shown)


def page_of(report: Report, blocks: Mapping[str, str] | None = None) -> str:
    """Draw a report as a page.

    Parameters
    ----------
    report
        What it is drawn from.
    blocks
        The texts as they were compressed before, since libraries compress differently; compressed
        anew where none are given.
    """
    blocks = blocks or {name: packed(text) for name, text in report.texts.items()}
    return render_html(
        report.measurement,
        thumbnails=report.record.thumbnails(report.pictures),
        profiles=report.record.profiles_by_pose(),
        simulated_truth=report.record.truth,
        carried=Carried(blocks, report.seal),
    )


def pdf_of(report: Report) -> bytes:
    """Typeset a report.

    Raises
    ------
    UsageError
        If the extra ``pdf`` is not installed.
    """
    return render_pdf(
        report.measurement,
        thumbnails=report.record.thumbnails(report.pictures),
        profiles=report.record.profiles_by_pose(),
        simulated_truth=report.record.truth,
        attached=report.texts,
        seal=report.seal,
    )
