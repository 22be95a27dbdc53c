"""The report as a PDF: the same content as the page, typeset, with the result attached."""

import json
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from pivometer.errors import UsageError
from pivometer.measurement import Measurement
from pivometer.report.embedding import RECORD, RESULT, Carried, Key, SimulatedTruth
from pivometer.report.paper_sections import Paper
from pivometer.report.setup_tables import moment_text
from pivometer.report.signatures import roles
from pivometer.report.thumbnails import Thumbnail
from pivometer.shaft.across import EdgeProfiles

_ATTACHED = {RESULT: "The result", RECORD: "What else the report shows"}


def pdf_extra_is_there() -> bool:
    """Tell whether the typesetter is installed."""
    from importlib.util import find_spec

    return find_spec("typst") is not None


def render_pdf(
    measurement: Measurement,
    *,
    thumbnails: Mapping[Key, Thumbnail],
    attached: Mapping[str, str],
    seal: str,
    profiles: Mapping[Key, EdgeProfiles] | None = None,
    simulated_truth: SimulatedTruth | None = None,
) -> bytes:
    """Return the report of a measurement as a PDF.

    It is tagged, and with the same input and typesetter it is the same to the last byte: it holds
    no moment but the measurement's, and only fonts that the typesetter brings along.

    Parameters
    ----------
    measurement
        What to report. Nothing is computed here that it does not hold.
    thumbnails, profiles, simulated_truth
        As in `render_html`.
    attached
        Texts of the files to attach, ``result.json`` and ``record.json``.
    seal
        The SHA-256 that the result states of itself.

    Raises
    ------
    UsageError
        If the extra ``pdf`` is not installed.
    """
    if not pdf_extra_is_there():
        raise UsageError(
            "a PDF needs the typesetter typst, which is not installed",
            next_step='run: pip install "pivometer[pdf]"',
        )
    paper = Paper(measurement, thumbnails, profiles or {}, simulated_truth, Carried({}, seal))
    content = _content(measurement, paper, attached)
    texts = {name: text.encode() for name, text in attached.items()}
    return _typeset(
        {**paper.photos, **texts, "data.json": json.dumps(content).encode()}, _moment(measurement)
    )


def _content(measurement: Measurement, paper: Paper, attached: Mapping[str, str]) -> dict[str, Any]:
    session, moment = measurement.setup.session, moment_text(measurement)
    when = _moment(measurement)
    return {
        "title": f"RCM measurement: {session}",
        "authors": [name for _, name in roles(measurement)[:1] if name],
        "date": [list(when.timetuple()[:6])],
        "session": session,
        "created": moment,
        "subtitle": " · ".join(text for text in (moment, measurement.software) if text),
        "seal": paper.carried.seal,
        "attached": [{"name": name, "description": _ATTACHED.get(name, name)} for name in attached],
        "sections": paper.sections(),
        "drawings": paper.drawings,  # filled now; hundreds of files would take longer to read
    }


def _moment(measurement: Measurement) -> datetime:
    """Return when the measurement was made; the beginning of time where that is not recorded."""
    provenance = measurement.provenance
    try:
        return datetime.fromisoformat(provenance.created if provenance else "").astimezone(UTC)
    except ValueError:
        return datetime.fromtimestamp(0, UTC)


def _typeset(contents: Mapping[str, bytes], moment: datetime) -> bytes:
    """Typeset with the typesetter's own fonts; a text they lack is set with what the machine has.

    PDF/A-3a keeps attached data readable for decades, PDF/UA-1 is for those who cannot see it. Both
    refuse letters without a font, such as Chinese ones in a note.
    """
    from typst import TypstError, compile  # noqa: A004 – its name

    template = files("pivometer.report").joinpath("templates", "report.typ")
    with TemporaryDirectory() as folder:
        root = Path(folder)
        for name, content in contents.items():
            (root / name).write_bytes(content)
        (root / "report.typ").write_bytes(template.read_bytes())
        source = str(root / "report.typ")
        try:
            return compile(
                source,
                root=folder,
                ignore_system_fonts=True,
                pdf_standards=["a-3a", "ua-1"],
                timestamp=moment,
            )
        except TypstError as error:
            if "could not be displayed" not in error.message:
                raise
        return compile(source, root=folder, timestamp=moment)
