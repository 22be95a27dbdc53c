"""Step 4: the result, live: pick a pose, take it out with a reason, see the result change."""

from __future__ import annotations

import asyncio
import math

from markupsafe import Markup
from nicegui import ui

from pivometer.app.result_figures import Drawn, drawn, show_figures, show_tables
from pivometer.app.shell import (
    Field,
    Tell,
    ask_for_description,
    button,
    enable,
    keys,
    page_frame,
    tag,
)
from pivometer.app.view_list import ViewList, ViewRow
from pivometer.app.watcher import Watcher
from pivometer.app.work import Work, fault_text
from pivometer.errors import PivometerError
from pivometer.io.session import Session
from pivometer.measurement import Measurement, UsedPose
from pivometer.report.overlays import photo_overlay
from pivometer.report.verdict import verdict

_LEAD = (
    "Look at the poses that miss most. One whose picture is spoilt may be taken out with a reason, "
    "which stands in the report; everything can be taken back."
)
_TITLES = ("Poses", "Pose", "Dihedral angle, °", "from the minimax point, mm", "least squares, mm")


async def result_page(work: Work, watcher: Watcher) -> None:
    """Draw the page."""
    watcher.set_task(None)
    with page_frame(work, "/result", _LEAD):
        if work.session is None:
            ask_for_description()
            return
        await _ResultPage(work).draw()


class _ResultPage:
    def __init__(self, work: Work) -> None:
        self._work = work
        self._progress = ""
        self._busy = False
        self._told = Tell()
        with ui.element("div").classes("actions"):
            self._go = button("Measure", self._measure, key="M", main=True)
        with ui.element("section").classes("card"):
            tag("h2", "The answer")
            self._answer = ui.element("div")
            with ui.element("div").classes("fields"):
                self._limit = Field("Limit of the largest miss, mm", kind="number")
            button("Check the limit", self._check)
        self._views = ViewList(work, _TITLES, self._measure, self._overlay)
        self._figures = ui.element("section").classes("card figures")
        self._tables = ui.element("section").classes("card")
        keys({"M": self._measure})
        ui.timer(0.3, self._tell)

    async def draw(self) -> None:
        """Draw what holds now."""
        measured = await asyncio.to_thread(self._work.result)
        await self._show(measured)
        if self._work.limit_mm is not None:
            self._limit.show(f"{self._work.limit_mm:g}")

    def _tell(self) -> None:
        if self._busy:
            self._told.say(self._progress)

    def _heard(self, stage: str, done: int, total: int) -> None:
        self._progress = f"{stage[:1].upper()}{stage[1:]}: {done} of {total}"

    async def _measure(self) -> None:
        """Measure what the folder holds now."""
        if self._busy:
            return
        self._busy, self._progress = True, "Measuring …"
        enable(self._go, on=False)
        measured, said, kind = None, "Measured.", "good"
        try:
            measured = await asyncio.to_thread(self._work.measure, self._heard)
        except PivometerError as error:
            said, kind = fault_text(error), "bad"
        finally:
            self._busy = False
        self._told.say(said, kind)
        await self._show(measured)
        enable(self._go, on=True)

    async def _show(self, measured: Measurement | None) -> None:
        made: Drawn | None = None
        if measured is not None:
            made = await asyncio.to_thread(drawn, measured)
        self._answer.clear()
        self._figures.clear()
        self._tables.clear()
        if self._work.session is not None:
            self._views.draw(_rows(measured, self._work.session))
        if measured is None or made is None:
            with self._answer:
                tag("p", "There is no result of the poses there are.")
            return
        with self._answer:
            _say(measured)
        with self._figures:
            show_figures(made)
        with self._tables:
            show_tables(made)

    def _overlay(self, view: str, camera: str) -> Markup:
        measured = self._work.measured
        stem = view.rpartition("/")[2]
        found = [pose for pose in (measured.poses if measured else ()) if pose.pose == stem]
        if measured is None or not found:
            return Markup("")
        rig = measured.calibration.rig
        return photo_overlay(found[0], rig.cameras[rig.index(camera)], measured)

    async def _check(self) -> None:
        """Hold the robot's own largest miss against the limit; the report then says so, too."""
        try:
            limit = float(self._limit.value)
        except ValueError:
            limit = 0.0
        if self._work.measured is None or not 0 < limit < math.inf:
            self._told.say("Measure first, and give a limit above 0 mm.", "warn")
            return
        try:
            measured = await asyncio.to_thread(self._work.decide, limit)
        except PivometerError as error:
            self._told.say(fault_text(error), "bad")
            return
        self._told.say("Decided.", "good")
        await self._show(measured)


def _say(measured: Measurement) -> None:
    told = verdict(measured)
    tag("p", told.sentence).classes("say" if told.usable else "say tell bad")
    tag("p", told.rejected)
    if measured.decision is not None:
        kind = {"pass": "good", "over": "bad"}.get(measured.decision.decision, "warn")
        tag("p", told.decision).classes(f"tell {kind}")
    tag("p", told.rule)
    for finding in measured.findings:
        kind = "bad" if finding.severity == "refusal" else "warn"
        tag("p", f"{finding.text}; {finding.next_step}").classes(f"tell {kind}")


def _rows(measured: Measurement | None, session: Session) -> list[ViewRow]:
    """Return the poses: used ones, the farthest first, then those rejected and taken out."""
    rows: list[ViewRow] = []
    used = [pose for pose in measured.poses if isinstance(pose, UsedPose)] if measured else []
    for pose in sorted(used, key=lambda pose: -pose.distance_mm.minimax):
        misses = f"{pose.distance_mm.minimax:.3f}", f"{pose.distance_mm.least_squares:.3f}"
        rows.append((f"shaft/{pose.pose}", f"{pose.dihedral_deg:.0f}", *misses, "used", False))
    reasons = {pose.pose: pose.reason for pose in measured.rejected} if measured else {}
    done = {pose.pose for pose in used}
    for stem in (stem for stem in session.shaft if stem not in done):
        out = session.excluded.get(f"shaft/{stem}")
        state = reasons.get(stem, "taken" if out is None else f"out: {out}")
        rows.append((f"shaft/{stem}", "–", "–", "–", state, out is not None))
    return rows
