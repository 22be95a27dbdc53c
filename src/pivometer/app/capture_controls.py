"""The cameras and the buttons by which pictures are taken, alike for board views and poses."""

from __future__ import annotations

from collections.abc import Collection
from typing import Protocol

from nicegui import ui

from pivometer.app.shell import Handler, Tag, button, live_view, tag, text


class Gathers(Protocol):
    """What is needed of a task: whether pictures take themselves."""

    automatic: bool


class CaptureControls:
    """The live pictures, what they show, and the buttons to take, to undo and to leave it alone.

    Parameters
    ----------
    task
        What takes the pictures.
    cameras
        Names of the open cameras.
    without
        What to say where there is none.
    take, undo
        What the buttons do.
    label, main
        Of the button that takes a picture, and whether it is the page's first one.
    """

    def __init__(
        self,
        task: Gathers,
        cameras: Collection[str],
        *,
        without: str,
        take: Handler,
        undo: Handler,
        label: str,
        main: bool = False,
    ) -> None:
        self._task = task
        with ui.element("div").classes("two"):
            for name in cameras:
                live_view(name)
        if not cameras:
            tag("p", without)
        self.seen: Tag = tag("p", "")
        self.seen.props('role="status"')
        button(label, take, key="C", main=main)
        button("Undo last", undo, key="U")
        self._auto = button("Automatic: on", self.toggle, key="A")
        self._auto.props('aria-pressed="true"')

    def toggle(self) -> None:
        """Let pictures take themselves, or not."""
        self.set_automatic(not self._task.automatic)

    def set_automatic(self, on: bool) -> None:
        """Say whether pictures take themselves."""
        self._task.automatic = on
        self._auto.props(f'aria-pressed="{str(on).lower()}"')
        self._auto.clear()
        with self._auto:
            text(f"Automatic: {'on' if on else 'off'}")
            tag("kbd", "A")
