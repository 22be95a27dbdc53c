"""The board views of a session, the worst first, to be looked at, taken out and taken back."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from urllib.parse import quote

from markupsafe import Markup
from nicegui import ui

from pivometer import pipeline
from pivometer.app.shell import Field, Tell, attribute, button, drawing, tag
from pivometer.app.work import Work, fault_text
from pivometer.calibration import Calibration
from pivometer.errors import PivometerError
from pivometer.io.session import Session

ViewRow = tuple[str, str, str, str, str, bool]
"""View, three more cells, state, and whether a person took it out."""

Changed = Callable[[], Awaitable[None]]


class ViewList:
    """A table of views with a reason field.

    Parameters
    ----------
    work
        The session in work.
    titles
        Of the list, and of its columns before the state.
    changed
        Called after one was taken out or back.
    overlay
        What to draw over a camera's picture of a view; nothing where none is given.
    """

    def __init__(
        self,
        work: Work,
        titles: tuple[str, ...],
        changed: Changed,
        overlay: Callable[[str, str], Markup] | None = None,
    ) -> None:
        self._work, self._changed, self._overlay = work, changed, overlay
        self._titles = titles
        self._shown: list[ViewRow] | None = None
        with ui.element("section").classes("card"):
            tag("h2", titles[0])
            self._told = Tell()
            self._pictures = ui.element("div").classes("two figures")
            with ui.element("div").classes("fields"):
                self._reason = Field("Reason for taking one out", wide=True)
            self._box = ui.element("div").classes("scroll").props('tabindex="0" role="region"')
            self._box.props(f'aria-label="{titles[0]}"')

    def draw(self, rows: list[ViewRow]) -> None:
        """Draw the table anew, if anything changed."""
        if rows == self._shown:
            return
        self._shown = rows
        self._box.clear()
        with self._box, ui.element("table"):
            tag("caption", "The worst first")
            with ui.element("thead"), ui.element("tr"):
                for title in (*self._titles[1:], "State", "", ""):
                    cell = tag("th" if title else "td", title)
                    if title:
                        cell.props('scope="col"')
            with ui.element("tbody"):
                for row in rows:
                    self._row(row)

    def _row(self, row: ViewRow) -> None:
        view, cameras, rms, largest, state, out = row
        with ui.element("tr"):
            tag("th", view).props('scope="row"')
            for content in (cameras, rms, largest, state):
                tag("td", content)
            with ui.element("td"):
                look = button("Look", lambda: self._look(view)).classes("small")
                look.props(f'aria-label="{attribute(f"Look at {view}")}"')
            with ui.element("td"):
                label = "Take back" if out else "Take out"
                act = button(label, lambda: self._switch(view, out)).classes("small")
                act.props(f'aria-label="{attribute(f"{label}: {view}")}"')

    def _look(self, view: str) -> None:
        """Show what every camera saw of a view."""
        session = self._work.session
        self._pictures.clear()
        if session is None:
            return
        with self._pictures:
            for camera in session.cameras:
                if pipeline.file_of(session, view, camera) is not None:
                    self._picture(view, camera)

    def _picture(self, view: str, camera: str) -> None:
        address = f"/pictures/{quote(camera)}/{quote(view)}"
        with ui.element("figure").classes("view"):
            with ui.element("div").classes("photo"):
                ui.element("img").props(
                    f'src="{address}" alt="{attribute(f"View {view}, camera {camera}")}"'
                )
                if self._overlay is not None:
                    drawing(self._overlay(view, camera))
            tag("figcaption", f"{view}, camera {camera}")

    async def _switch(self, view: str, out: bool) -> None:
        session = self._work.session
        if session is None:
            return
        try:
            reason = None if out else self._reason.value
            await asyncio.to_thread(pipeline.exclude, session, view, reason)
        except PivometerError as error:
            self._told.say(fault_text(error), "bad")
            return
        self._reason.show("")
        await self._changed()
        self._told.say(f"{view} is {'taken back' if out else 'taken out'}.", "good")


def view_rows(session: Session, made: Calibration | None) -> list[ViewRow]:
    """Return what the table shows: the views that count, those not used, those taken out."""
    rows: list[ViewRow] = []
    if made is not None:
        for one in pipeline.view_qualities(made):
            misses = f"{one.rms_mm:.3f}", f"{one.max_mm:.3f}"
            rows.append((one.view, ", ".join(one.cameras), *misses, "used", False))
    done = {row[0] for row in rows}
    files: dict[str, list[str]] = {}
    for file in session.board_images():
        files.setdefault(file.view, []).append(file.camera)
    reasons = {} if made is None else {one.view: one.reason for one in made.rejected}
    for view, cameras in files.items():
        if view not in done:
            out = session.excluded.get(view)
            state = f"not used: {reasons[view]}" if view in reasons else "taken"
            state = state if out is None else f"out: {out}"
            rows.append((view, ", ".join(cameras), "–", "–", state, out is not None))
    return rows
