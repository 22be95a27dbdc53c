"""Step 2: board views, the calibration, and what it is good for."""

from __future__ import annotations

import asyncio

from nicegui import ui

from pivometer import pipeline
from pivometer.app.board_task import BoardTask
from pivometer.app.capture_controls import CaptureControls
from pivometer.app.shell import (
    Tell,
    add_pictures,
    ask_for_description,
    button,
    enable,
    keys,
    page_frame,
    tag,
    text,
)
from pivometer.app.view_list import ViewList, ViewRow, view_rows
from pivometer.app.watcher import Watcher
from pivometer.app.work import Work, fault_text
from pivometer.calibration import Calibration
from pivometer.calibration.advice import Advice, advice
from pivometer.calibration.gathering import Coverage, Gathering
from pivometer.errors import PivometerError
from pivometer.io.session import Session

_LEAD = (
    "Hold the board where the tool will be, tilt it in all directions, and rest for half a second: "
    "the picture takes itself once it is on the disk."
)


def calibrate_page(work: Work, watcher: Watcher) -> None:
    """Draw the page."""
    with page_frame(work, "/calibrate", _LEAD):
        if work.session is None:
            ask_for_description()
            return
        _CalibratePage(work, watcher)


class _CalibratePage:
    def __init__(self, work: Work, watcher: Watcher) -> None:
        self._work, self._watcher = work, watcher
        self._task = BoardTask(work, watcher)
        self._version = -1
        self._progress = ""
        self._busy = False
        self._advice = Tell()
        with ui.element("div").classes("side"):
            with ui.element("section").classes("card"):
                self._cameras()
            with ui.element("section").classes("card"):
                tag("h2", "Coverage")
                self._gauges = ui.element("div")
        self._added = work.added
        self._told = Tell()
        self._result = ui.element("section").classes("card")
        self._views = ViewList(
            work, ("Views", "View", "Cameras", "rms, mm", "largest, mm"), self._changed
        )
        add_pictures("board", work.session.cameras if work.session else ())
        keys(
            {
                "C": self._capture,
                "U": self._undo,
                "A": self._controls.toggle,
                "K": self._calibrate,
            }
        )
        self._tend()
        ui.timer(0.25, self._refresh)

    def _tend(self) -> None:
        """Gather while the page is open; without cameras, count what the folder holds."""
        client = ui.context.client
        client.on_connect(lambda: self._watcher.set_task(self._task))
        client.on_disconnect(lambda: self._watcher.drop_task(self._task))

    def _cameras(self) -> None:
        self._controls = CaptureControls(
            self._task,
            self._work.feeds,
            without="No camera is open; open them in step 1, or go on with the pictures there are.",
            take=self._capture,
            undo=self._undo,
            label="Take picture",
        )
        self._go = button("Calibrate", self._calibrate, key="K")

    def _capture(self) -> None:
        self._task.asked = True

    async def _undo(self) -> None:
        """Take the newest view out again; its pictures stay on the disk."""
        session = self._work.session
        view = None if session is None else await asyncio.to_thread(_newest, session)
        if session is None or view is None:
            self._told.say("There is no view to undo.", "warn")
            return
        await asyncio.to_thread(pipeline.exclude, session, view, "undone while gathering")
        self._told.say(f"{view} is taken out; it can be taken back below.")
        await self._changed()

    async def _changed(self) -> None:
        await asyncio.to_thread(self._task.count)

    async def _refresh(self) -> None:
        self._controls.seen.set(self._work.lost() or self._watcher.told() or self._task.told)
        if self._busy:
            self._told.say(self._progress)
        if self._added != self._work.added:
            self._added = self._work.added
            await self._changed()
        if self._version == self._task.version:
            return
        self._version = self._task.version
        known = self._task.gathering
        if known is not None:
            self._advice.say(known.advice, "good" if known.enough else "")
            self._draw_gauges(known)
            self._go.classes(add="main" if known.enough else None, remove="main")
            enable(self._go, known.possible and not self._busy)
        await self._draw_result()

    def _draw_gauges(self, known: Gathering) -> None:
        self._gauges.clear()
        with self._gauges:
            for cover in (known.shared, *known.cameras):
                _gauges(cover)

    async def _calibrate(self) -> None:
        session = self._work.session
        known = self._task.gathering
        if session is None or known is None or not known.possible or self._busy:
            return
        self._busy, self._progress = True, "Calibrating …"
        self._controls.set_automatic(False)  # a view that came now would not be in it
        enable(self._go, on=False)
        try:
            made = await asyncio.to_thread(pipeline.calibrate, session, progress=self._tell)
            await asyncio.to_thread(pipeline.write_calibration, made, self._work.folder / "results")
            self._told.say("Calibrated; the calibration is in results/rig.json.", "good")
        except PivometerError as error:
            self._told.say(fault_text(error), "bad")
        finally:
            self._busy = False
        enable(self._go, on=True)
        await self._draw_result()

    def _tell(self, stage: str, done: int, total: int) -> None:
        self._progress = f"Calibrating: {stage}, {done} of {total}"

    async def _draw_result(self) -> None:
        session = self._work.session
        if session is None:
            return
        made, rows, told = await asyncio.to_thread(_looked_up, self._work, session)
        self._result.clear()
        with self._result:
            tag("h2", "Calibration")
            if made is None or told is None:
                tag("p", "Not calibrated yet with the views there are.")
            else:
                _quality(made, told)
        self._views.draw(rows)


def _looked_up(
    work: Work, session: Session
) -> tuple[Calibration | None, list[ViewRow], Advice | None]:
    """Read the calibration that holds, and what to say of it and of the views."""
    made = work.calibration()
    return made, view_rows(session, made), None if made is None else advice(made)


def _newest(session: Session) -> str | None:
    """Return the view of the newest picture that counts."""
    kept = [file for file in session.board_images() if file.view not in session.excluded]
    return max(kept, key=lambda file: file.path.stat().st_mtime_ns).view if kept else None


def _gauges(cover: Coverage) -> None:
    title = "All cameras at once" if cover.name == "shared" else f"Camera {cover.name}"
    tag("h3", f"{title}: {cover.views} views")
    with ui.element("div").classes("gauge"):
        for label, part in (
            ("across", cover.x),
            ("down", cover.y),
            ("size", cover.size),
            ("tilt", cover.tilt),
        ):
            text(label)
            with ui.element("i").props('aria-hidden="true"'):
                ui.element("b").style(f"width: {100 * part:.0f}%")
            text(f"{100 * part:.0f} %")


def _quality(made: Calibration, told: Advice) -> None:
    tag("p", told.verdict).classes("say")
    tag("p", f"What would improve it most: {told.next_step}. It is limited by {told.cause}.")
    tag(
        "p",
        f"Board edges reconstructed from all views: {made.edge_length_error.rms_mm:.3f} mm rms, "
        f"{made.edge_length_error.max_mm:.3f} mm at most; held out: {made.held_out.rms_mm:.3f} and "
        f"{made.held_out.max_mm:.3f} mm.",
    )
    for note in made.notes:
        tag("p", note).classes("tell warn")
