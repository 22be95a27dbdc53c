"""Step 5: the report, written into the session and downloaded."""

from __future__ import annotations

import asyncio
from pathlib import Path

from nicegui import ui

from pivometer import pipeline
from pivometer.app.shell import Tell, ask_for_description, button, enable, keys, page_frame, tag
from pivometer.app.watcher import Watcher
from pivometer.app.work import Work, fault_text
from pivometer.errors import PivometerError
from pivometer.report.pdf import pdf_extra_is_there

_LEAD = (
    "The report holds everything a reader needs to judge the result, asks no host for anything, "
    "and can be verified by anyone with “pivometer verify”."
)
FILES = {
    "report.html": ("Report", "text/html; charset=utf-8"),
    "report.pdf": ("Report as PDF", "application/pdf"),
    "result.json": ("Result, JSON", "application/json"),
    "centerlines.csv": ("Centerlines, CSV", "text/csv; charset=utf-8"),
    "rig.json": ("Calibration, JSON", "application/json"),
}
"""The files that can be downloaded, all of them in the session's results."""


async def report_page(work: Work, watcher: Watcher) -> None:
    """Draw the page."""
    watcher.set_task(None)
    with page_frame(work, "/report", _LEAD):
        if work.session is None:
            ask_for_description()
            return
        await _ReportPage(work).draw()


class _ReportPage:
    def __init__(self, work: Work) -> None:
        self._work = work
        self._progress = ""
        self._busy = False
        self._told = Tell()
        with ui.element("div").classes("actions"):
            self._go = button("Write the report", self._write, key="W", main=True)
        self._card = ui.element("section").classes("card")
        keys({"W": self._write})
        ui.timer(0.3, lambda: self._told.say(self._progress) if self._busy else None)

    async def draw(self) -> None:
        """Draw what is there."""
        known = await asyncio.to_thread(self._work.result)
        self._show(current=known is not None)

    def _heard(self, stage: str, done: int, total: int) -> None:
        self._progress = f"{stage[:1].upper()}{stage[1:]}: {done} of {total}"

    async def _write(self) -> None:
        """Measure what the folder holds now, unless that is done, and write the files."""
        if self._busy:
            return
        self._busy, self._progress = True, "Writing …"
        enable(self._go, on=False)
        try:
            await asyncio.to_thread(self._written)
        except PivometerError as error:
            self._told.say(fault_text(error), "bad")
        else:
            self._told.say(f"Written into {self._work.folder / 'results'}.", "good")
            self._show(current=True)
        finally:
            self._busy = False
        enable(self._go, on=True)

    def _written(self) -> None:
        measured = self._work.measure(self._heard)
        session = self._work.session
        if session is not None:
            pipeline.write_measurement(
                measured,
                session,
                self._work.folder / "results",
                command="pivometer app",
                progress=self._heard,
            )

    def _show(self, *, current: bool) -> None:
        """Show the downloads and the report itself."""
        self._card.clear()
        results = self._work.folder / "results"
        there = [name for name in FILES if (results / name).is_file()]
        with self._card:
            tag("h2", "Files")
            if "report.html" not in there:
                tag("p", "No report is written yet.")
                return
            if not current:
                tag(
                    "p", "The report is of other pictures than the session has now: write it anew."
                ).classes("tell warn")
            with ui.element("ul"):
                for name in there:
                    with ui.element("li"):
                        link = tag("a", f"{FILES[name][0]} ({_size(results / name)})")
                        link.props(f'href="/files/{name}" download="{name}"')
            if not pdf_extra_is_there():
                tag("p", 'For a PDF, too: pip install "pivometer[pdf]"')
            frame = ui.element("iframe").props(
                'title="The report" sandbox="allow-scripts allow-downloads"'
            )
            stamp = (results / "report.html").stat().st_mtime_ns
            frame.props(f'src="/files/report.html?shown={stamp}"')


def _size(path: Path) -> str:
    size = path.stat().st_size
    return f"{size / 1e6:.1f} MB" if size > 1e5 else f"{size / 1e3:.0f} kB"
