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
from pivometer.report.thumbnails import Thumbnail


@dataclass(frozen=True, slots=True, eq=False)
class Report:
    """What a report is drawn from.

    Parameters
    ----------
    result, record
        The texts it carries: ``result.json``, and what else it shows.
    pictures
        Its encoded pictures by their SHA-256.
    """

    result: str
    record: str
    pictures: Mapping[str, bytes]


def report_of(
    measurement: Measurement, record: ReportRecord, thumbnails: Iterable[Thumbnail]
) -> Report:
    """Gather what a report is drawn from."""
    pictures = {hashlib.sha256(one.jpeg).hexdigest(): one.jpeg for one in thumbnails}
    return Report(result_text(measurement), text_of(jsonable(record)), pictures)


def page_of(report: Report, blocks: Mapping[str, str] | None = None) -> str:
    """Draw the page of a report from the texts that it carries.

    Parameters
    ----------
    report
        What it is drawn from.
    blocks
        The texts as they were compressed before, since libraries compress differently; compressed
        anew where none are given.

    Raises
    ------
    UsageError
        If a text does not state what it should.
    """
    content: dict[str, Any] = json.loads(report.result)
    record = record_in(report.record)
    texts = {RESULT: report.result, RECORD: report.record}
    blocks = blocks or {name: packed(text) for name, text in texts.items()}
    return render_html(
        measurement_in(content, RESULT),
        thumbnails=record.thumbnails(report.pictures),
        profiles=record.profiles_by_pose(),
        simulated_truth=record.truth,
        carried=Carried(blocks, str(content.get(SEAL))),
    )


def record_in(text: str) -> ReportRecord:
    """Read the record of a report.

    Raises
    ------
    UsageError
        If it is damaged.
    """
    try:
        record: ReportRecord = typed(ReportRecord, json.loads(text))
    except (ValueError, RecursionError) as error:
        raise UsageError(f"is not JSON: {error}", next_step="take the report anew") from error
    return record
