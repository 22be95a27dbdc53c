"""What all pages share: the frame with the five steps, and a few plain elements."""

from __future__ import annotations

import json
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from functools import cache
from importlib.resources import files
from typing import Any

from markupsafe import Markup
from nicegui import ui

from pivometer.app.work import Work
from pivometer.report.drawing_rules import drawing_rules

STEPS = (
    ("/", "Set up"),
    ("/calibrate", "Calibrate"),
    ("/poses", "Poses"),
    ("/result", "Result"),
    ("/report", "Report"),
)

Handler = Callable[[], Awaitable[None] | None]


@cache
def asset(name: str) -> str:
    """Return one of the app's own text files."""
    return files("pivometer.app").joinpath(name).read_text(encoding="utf-8")


@contextmanager
def page_frame(work: Work, path: str, lead: str) -> Iterator[None]:
    """Draw the frame of one step; what is made inside stands in its main part."""
    title = dict(STEPS)[path]
    ui.page_title(f"{title} – {work.folder.name} – Pivometer")
    style = asset("style.css") + drawing_rules(".figures")
    ui.add_head_html(f"<style>{style}</style><script>{asset('pages.js')}</script>")
    with ui.element("a").classes("skip").props('href="#main"'):
        text("Skip to the content")
    with ui.element("header").classes("bar"):
        with ui.element("div").classes("brand"):
            tag("strong", "Pivometer")
            text(str(work.folder.name))
        with ui.element("nav").props('aria-label="Steps"'), ui.element("ol").classes("steps"):
            for number, (address, name) in enumerate(STEPS, start=1):
                note = work.notes.get(address, "")
                _step(address, f"{number} {name}", current=address == path, note=note)
    with ui.element("div").classes("content").props('id="main" tabindex="-1"'):
        tag("h1", title)
        tag("p", lead).classes("lead")
        yield


def _step(address: str, name: str, *, current: bool, note: str) -> None:
    with ui.element("li"), ui.element("a").props(f'href="{address}"') as link:
        text(f"{name} " if note else name)
        if note:
            tag("small", note)
    if current:
        link.props('aria-current="step"')


class Tag(ui.element):
    """An element of plain HTML with a text that can change; never markup."""

    def __init__(self, name: str, content: str = "") -> None:
        super().__init__(name)
        self.set(content)

    def set(self, content: str) -> None:
        """Show another text."""
        if getattr(self, "_shown", None) != content:
            self._shown = content
            self._text = content
            self.update()


def tag(name: str, content: str = "") -> Tag:
    """Return an element of plain HTML that holds a text."""
    return Tag(name, content)


def text(content: str) -> Tag:
    """Return a span."""
    return Tag("span", content)


def drawing(svg: Markup) -> None:
    """Show one of the report's drawings, all of whose texts are escaped."""
    ui.html(str(svg), sanitize=False)


def button(label: str, act: Handler, *, key: str = "", main: bool = False) -> ui.element:
    """Return a button; `key` is the letter that presses it, which the page listens for."""
    made = ui.element("button").classes("act main" if main else "act").props('type="button"')
    with made:
        text(label)
        if key:
            tag("kbd", key)
            made.props(f'aria-keyshortcuts="{key}"')
    made.on("click", lambda _: act())
    return made


def enable(element: ui.element, on: bool) -> None:
    """Make a button work, or not."""
    if on:
        element.props(remove="disabled")
    else:
        element.props("disabled")


def keys(handlers: dict[str, Handler]) -> None:
    """Let letters press buttons, except while one types."""

    async def pressed(event: Any) -> None:
        handler = handlers.get(event.key.name.upper())
        plain = not (event.modifiers.ctrl or event.modifiers.meta or event.modifiers.alt)
        if handler is not None and event.action.keydown and not event.action.repeat and plain:
            outcome = handler()
            if outcome is not None:
                await outcome

    ui.keyboard(on_key=pressed, ignore=["input", "select", "textarea"])


class Tell(Tag):
    """A message that screen readers say when it changes."""

    def __init__(self, content: str = "", kind: str = "") -> None:
        super().__init__("p", content)
        self.classes("tell").props('role="status" aria-live="polite"')
        self._kind = ""
        self.say(content, kind)

    def say(self, content: str, kind: str = "") -> None:
        """Show a message of a kind: ``""``, ``"good"``, ``"warn"`` or ``"bad"``."""
        if kind != self._kind:
            self.classes(remove=self._kind or None, add=kind or None)
            self._kind = kind
        self.set(content)


def ask_for_description() -> None:
    """Say what every later step needs first."""
    tag("p", "Describe the session in step 1 first.")


def live_view(name: str) -> ui.element:
    """Return a camera's live picture with its name."""
    with ui.element("figure").classes("view") as figure:
        ui.element("img").props(f'data-live="{attribute(name)}"').props(
            f'alt="Camera {attribute(name)}, live"'
        )
        tag("figcaption", f"Camera {name}")
    return figure


def attribute(value: str) -> str:
    """Return a text that may stand between quotes in an element's properties."""
    return value.replace("\\", "").replace('"', "'")


def add_pictures(group: str, cameras: tuple[str, ...]) -> None:
    """Draw an input for each camera that takes picture files into a group of the session."""
    with ui.element("details").classes("card"):
        tag("summary", "Add pictures from files (the same file name is the same moment)")
        with ui.element("div").classes("fields"):
            for camera in cameras:
                with ui.element("label").classes("field"):
                    text(f"Pictures of camera {camera}")
                    place = f'data-add="{group}/{attribute(camera)}"'
                    ui.element("input").props(f'type="file" multiple accept="image/*" {place}')
                    tag("output")


def select(options: dict[str, str], value: str) -> ui.element:
    """Return a plain drop-down list."""
    chosen = ui.element("select")
    with chosen:
        for key, label in options.items():
            option = tag("option", label).props(f'value="{attribute(key)}"')
            if key == value:
                option.props("selected")
    return chosen


class Field:
    """A labelled input of plain HTML, whose value is known here after every change.

    Parameters
    ----------
    label
        What it asks for.
    value
        Its value at first.
    options
        For a drop-down list: values and what is shown of them.
    kind
        ``"text"`` or ``"number"``.
    wide
        Whether it takes a whole row.
    suggestions
        Values that the browser offers.
    """

    def __init__(
        self,
        label: str,
        value: str = "",
        *,
        options: dict[str, str] | None = None,
        kind: str = "text",
        wide: bool = False,
        suggestions: tuple[str, ...] = (),
    ) -> None:
        self.value = value
        with ui.element("label").classes("field wide" if wide else "field"):
            text(label)
            if options is not None:
                self.element = select(options, value)
            else:
                self.element = ui.element("input").props(f'type="{kind}"')
                # As an attribute: as a property, every update of the page would undo the typing.
                self.element.props["^value"] = value
                self.element.props["step"] = "any"
                self._suggest(suggestions)
        self.element.on("change", self._changed, js_handler="(e) => emit(e.target.value)")

    def _changed(self, event: Any) -> None:
        self.value = str(event.args)

    def _suggest(self, suggestions: tuple[str, ...]) -> None:
        if not suggestions:
            return
        with ui.element("datalist") as offered:
            for entry in suggestions:
                ui.element("option").props(f'value="{attribute(entry)}"')
        offered.props(f'id="offer-{offered.id}"')
        self.element.props(f'list="offer-{offered.id}"')

    def show(self, value: str) -> None:
        """Show another value."""
        self.value = value
        place = json.dumps(self.element.html_id)
        ui.run_javascript(f"document.getElementById({place}).value = {json.dumps(value)}")
