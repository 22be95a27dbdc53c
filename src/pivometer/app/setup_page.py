"""Step 1: what is measured with, and are the cameras fit for it."""

from __future__ import annotations

import asyncio

from nicegui import ui

from pivometer import pipeline
from pivometer.app.setup_form import SetupForm
from pivometer.app.shell import Tell, button, live_view, page_frame, tag, text
from pivometer.app.watcher import Watcher
from pivometer.app.work import Work, fault_text
from pivometer.errors import PivometerError
from pivometer.io.sources import found_devices
from pivometer.pipeline.watching import CameraCheck, check_camera

_LEAD = (
    "Say what you measure with. Everything is kept in the session folder, which the command line "
    "uses, too; you can leave at any time and go on later."
)
SYNCHRONOUS_S = 0.02
"""Lag between cameras that a hand that holds still makes harmless, but a moving one not."""


def setup_page(work: Work, watcher: Watcher) -> None:
    """Draw the page."""
    watcher.set_task(None)
    with page_frame(work, "/", _LEAD):
        if work.fault:  # what a person wrote is never written over
            tag("p", f"The session cannot be read. {work.fault}.").classes("tell bad")
            tag("p", "Mend the file, then load this page again.")
            return
        told = Tell()
        with ui.element("section").classes("card"):
            form = SetupForm(work)
            button("Save and open the cameras", lambda: save(), main=True)
            text(f"writes {work.folder / 'session.toml'}")
        cameras = _Cameras(work, watcher)
        _found(form)

        async def save() -> None:
            try:
                await asyncio.to_thread(_saved, work, form)
            except PivometerError as error:
                told.say(fault_text(error), "bad")
                return
            told.say("Saved. Look at the checks below, then go on to Calibrate.", "good")
            cameras.draw()


def _saved(work: Work, form: SetupForm) -> None:
    """Write the description, then open the cameras; what can be kept is kept."""
    settings = form.settings()
    pipeline.describe(work.folder, settings)
    work.reload()
    sources = form.sources()
    pipeline.save_sources(work.folder, sources, rate_hz=form.rate_hz())
    work.open_cameras(sources, form.rate_hz())


def _found(form: SetupForm) -> None:
    """List the capture devices of this computer with a picture each."""
    with ui.element("section").classes("card"):
        tag("h2", "Cameras of this computer")
        told = Tell()
        shown = ui.element("div").classes("two")

        async def look() -> None:
            devices = await asyncio.to_thread(found_devices)
            pictures = await asyncio.to_thread(pipeline.device_thumbnails, devices)
            shown.clear()
            told.say(
                f"{len(devices)} found."
                if devices
                else "None found. A folder of images or a video file can play a camera: type its "
                "path above.",
                "" if devices else "warn",
            )
            with shown:
                for device in devices:
                    _device(device, pictures.get(device), form)

        button("Look for cameras", look)


def _device(device: str, picture: str | None, form: SetupForm) -> None:
    with ui.element("figure").classes("view"):
        if picture is None:
            tag("p", "gives no picture; another program may use it, or it may not be readable")
        else:
            ui.element("img").props(f'src="{picture}" alt="What {device} sees"')
        with ui.element("figcaption"):
            text(f"{device} ")
            for row in form.rows:
                name = row.name.value or "a camera"
                button(f"Use as {name}", lambda row=row: row.source.show(device))  # type: ignore[misc]


class _Cameras:
    """The live pictures and the checks."""

    def __init__(self, work: Work, watcher: Watcher) -> None:
        self._work, self._watcher = work, watcher
        self._card = ui.element("section").classes("card")
        self.draw()
        ui.timer(1.0, self._check)

    def draw(self) -> None:
        """Draw the cameras that are open."""
        self._card.clear()
        with self._card:
            tag("h2", "Checks before you start")
            self._told = Tell()
            self._lines = tag("p")
            with ui.element("div").classes("two"):
                for name in self._work.feeds:
                    live_view(name)
            if not self._work.feeds:
                tag("p", "No camera is open yet.")

    async def _check(self) -> None:
        if not self._work.feeds:
            return
        checks, lags = await asyncio.to_thread(self._look)
        faults = [f"Camera {one.name} {fault}." for one in checks for fault in one.faults]
        faults += [lost] if (lost := self._work.lost()) else []
        for name, lag in lags.items():
            if lag is not None and abs(lag) > SYNCHRONOUS_S:
                faults.append(
                    f"Camera {name} is {1000 * abs(lag):.0f} ms {'late' if lag > 0 else 'early'}: "
                    "hold everything still for each picture, which the app waits for."
                )
        self._told.say(" ".join(faults) or "All checks pass.", "warn" if faults else "good")
        self._lines.set("; ".join([*map(_line, checks), *(_lag(n, v) for n, v in lags.items())]))

    def _look(self) -> tuple[list[CameraCheck], dict[str, float | None]]:
        checks = [
            check_camera(name, feed.frames[-1].image, feed.rate_hz)
            for name, feed in self._work.feeds.items()
            if feed.frames and feed.fault is None
        ]
        return checks, self._watcher.offsets_s()


def _line(one: CameraCheck) -> str:
    blur = "no edges" if one.blur_px is None else f"blur {one.blur_px:.1f} px"
    return (
        f"{one.name}: {one.size[0]}×{one.size[1]} px, {one.rate_hz:.0f} pictures a second, {blur}, "
        f"{100 * one.saturated:.1f} % white"
    )


def _lag(name: str, lag: float | None) -> str:
    if lag is None:
        return f"offset of {name}: not known yet, wave something in view of all cameras"
    return f"offset of {name}: {1000 * lag:+.0f} ms"
