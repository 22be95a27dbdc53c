"""Step 3: poses of the robot, with the RCM of those taken so far."""

from __future__ import annotations

import asyncio
from functools import partial

from nicegui import ui

from pivometer import pipeline
from pivometer.app.capture_controls import CaptureControls
from pivometer.app.shaft_task import ShaftTask
from pivometer.app.shell import (
    Tell,
    add_pictures,
    ask_for_description,
    button,
    drawing,
    keys,
    page_frame,
    tag,
    text,
)
from pivometer.app.watcher import Watcher
from pivometer.app.work import Work, fault_text
from pivometer.errors import PivometerError
from pivometer.measurement import Measurement
from pivometer.pipeline.live_shaft import LiveShaft
from pivometer.rcm.cone import cone_deg
from pivometer.rcm.pose_advice import WANTED_CONE_DEG, advice_text
from pivometer.report.digits import with_uncertainty
from pivometer.report.pose_map import pose_map, shrinking_chart

_LEAD = (
    "Move the tool about the RCM through a wide cone and let it rest: a pose that is unlike those "
    "before takes itself. 20 to 70 poses; the more directions, the better."
)
ENOUGH_POSES = 20
_OTHERS: tuple[tuple[pipeline.Group, str, str], ...] = (
    ("background", "Empty scene", "without the tool: makes edges before clutter far more certain"),
    ("reference", "Board beside the RCM", "which stays there: results in its frame, too"),
    ("closing", "Board at the end", "tells whether a camera was bumped meanwhile"),
)


async def poses_page(work: Work, watcher: Watcher) -> None:
    """Draw the page."""
    with page_frame(work, "/poses", _LEAD):
        session = work.session
        if session is None:
            ask_for_description()
            return
        if any(
            file.frame is not None for files in session.shaft.values() for file in files.values()
        ):
            watcher.set_task(None)
            tag("p", "The poses of this session are videos: go on to step 4.")
            return
        shaft = await asyncio.to_thread(work.shaft)
        if shaft is None:
            watcher.set_task(None)
            tag("p", "Calibrate the cameras in step 2 first, with the board views there are.")
            return
        _PosesPage(work, watcher, shaft)


class _PosesPage:
    def __init__(self, work: Work, watcher: Watcher, shaft: LiveShaft) -> None:
        self._work, self._watcher = work, watcher
        self._task = ShaftTask(work, watcher, shaft)
        self._version = -1
        self._advice = Tell()
        with ui.element("div").classes("side"):
            with ui.element("section").classes("card"):
                self._cameras()
            with ui.element("section").classes("card"):
                tag("h2", "Directions")
                self._map = ui.element("div")
                self._cone = tag("p")
        self._added = work.added
        self._told = Tell()
        with ui.element("section").classes("card"):
            tag("h2", "The RCM of the poses so far")
            self._numbers = ui.element("div").classes("two")
        self._others()
        add_pictures("shaft", work.session.cameras if work.session else ())
        keys({"C": self._capture, "U": self._undo, "A": self._controls.toggle})
        client = ui.context.client
        client.on_connect(lambda: watcher.set_task(self._task))
        client.on_disconnect(lambda: watcher.drop_task(self._task))
        ui.timer(0.3, self._refresh)

    def _cameras(self) -> None:
        self._controls = CaptureControls(
            self._task,
            self._work.feeds,
            without="No camera is open: open them in step 1, or use the pictures there are.",
            take=self._capture,
            undo=self._undo,
            label="Take pose",
            main=True,
        )

    def _others(self) -> None:
        """Offer the pictures that are no poses."""
        with ui.element("details").classes("card"):
            tag("summary", "Other pictures, all of them optional")
            for group, label, use in _OTHERS:
                with ui.element("p"):
                    button(label, partial(self._ask, group))
                    text(use)
            self._taken = Tell()

    def _ask(self, group: pipeline.Group) -> None:
        self._task.asked = group

    def _capture(self) -> None:
        self._task.asked = "shaft"

    async def _undo(self) -> None:
        """Take the newest pose out again; its pictures stay on the disk."""
        session = self._work.session
        out = {} if session is None else session.excluded
        kept = [s for s in (session.shaft if session else {}) if f"shaft/{s}" not in out]
        if session is None or not kept:
            self._told.say("There is no pose to undo.", "warn")
            return
        view = f"shaft/{kept[-1]}"
        try:
            await asyncio.to_thread(pipeline.exclude, session, view, "undone while taking poses")
        except PivometerError as error:
            self._told.say(fault_text(error), "bad")
            return
        self._told.say(f"{view} is taken out; step 4 can take it back.")
        await asyncio.to_thread(self._task.count)

    async def _refresh(self) -> None:
        self._controls.seen.set(self._work.lost() or self._watcher.told() or self._task.told)
        if self._added != self._work.added:
            self._added = self._work.added
            await asyncio.to_thread(self._task.count)
        self._taken.say(self._task.taken, "good")
        if self._version != self._task.version:
            self._version = self._task.version
            self._draw_numbers()
        await self._draw_map()

    async def _draw_map(self) -> None:
        directions, now = self._task.directions, self._task.now
        shown = (len(directions), None if now is None else tuple(now.round(2)))
        if getattr(self, "_shown", None) == shown or not len(directions):
            return
        self._shown = shown
        svg = await asyncio.to_thread(pose_map, directions, now=now)
        self._map.clear()
        with self._map:
            drawing(svg)

    def _draw_numbers(self) -> None:
        directions = self._task.directions
        count = len(directions)
        wide = cone_deg(directions) if count > 1 else 0.0
        self._cone.set(
            f"{count} poses count; cone {wide:.0f}° of {WANTED_CONE_DEG:.0f}°. Open circles are "
            "poses to add, the cross is the shaft now."
        )
        camera = self._work.session.reference if self._work.session else None
        advice = advice_text(directions, camera=camera) if count else ""
        enough = count >= ENOUGH_POSES and wide >= 0.9 * WANTED_CONE_DEG
        if enough:
            self._advice.say("Enough for a result; more poses narrow it.", "good")
        else:
            self._advice.say(_sentence(advice) or "Take the first poses in all directions.")
        self._numbers.clear()
        with self._numbers:
            if self._task.measured is None:
                tag("p", self._task.refused or "Not known yet.")
            else:
                _numbers(self._task.measured)
                if len(self._task.history) > 1:
                    with ui.element("div"):
                        tag("h3", "Expanded uncertainty of the location, mm")
                        counts, expanded = zip(*self._task.history, strict=True)
                        drawing(shrinking_chart(counts, expanded))


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:] + "." if text else ""


def _numbers(measured: Measurement) -> None:
    rcm, uncertainty = measured.rcm, measured.uncertainty
    with ui.element("div"):
        values = zip(rcm.least_squares.point_mm, uncertainty.expanded_mm, strict=True)
        place = ", ".join(with_uncertainty(float(v), float(u)) for v, u in values)
        tag("p", f"({place}) mm").classes("number")
        tag(
            "p",
            f"location in the frame of camera {measured.reference_camera}, "
            f"{100 * uncertainty.coverage:.0f} % intervals, {len(measured.used)} poses",
        )
        tag("p", f"{rcm.minimax.max_mm:.3f} mm").classes("number")
        tag("p", f"largest miss; rms {rcm.least_squares.rms_mm:.3f} mm")
        own = measured.intrinsic
        if own is not None:
            low, high = own.max_interval_mm
            tag("p", f"of it the robot's own, at most: {low:.3f} to {high:.3f} mm")
