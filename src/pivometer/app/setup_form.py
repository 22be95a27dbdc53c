"""The form that describes a session."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from nicegui import ui

from pivometer import pipeline
from pivometer.app.shell import Field, button, tag
from pivometer.app.work import Work
from pivometer.calibration import Board
from pivometer.errors import UsageError
from pivometer.io.settings import Settings
from pivometer.io.sources import USUAL_RATE_HZ, found_devices

_KINDS = {"checkerboard": "Checkerboard", "charuco": "ChArUco, with markers"}
_FORMS = {"bowed": "Paper or print: may bow", "flat": "Glass: flat", "free": "Printed unevenly"}


@dataclass(frozen=True, slots=True)
class CameraRow:
    """The two fields of one camera."""

    name: Field
    source: Field


class SetupForm:
    """The fields, filled from the session where there is one.

    Parameters
    ----------
    work
        The session in work.
    """

    def __init__(self, work: Work) -> None:
        self._session = work.session
        self._saved, rate = pipeline.saved_sources(work.folder)
        self.rows: list[CameraRow] = []
        self._board_fields()
        self._camera_fields(rate or USUAL_RATE_HZ)
        self._other_fields()

    def _board_fields(self) -> None:
        board = None if self._session is None else self._session.board
        tag("h2", "Board and shaft")
        with ui.element("div").classes("fields"):
            self._kind = Field("Board", board.kind if board else "checkerboard", options=_KINDS)
            across, down = board.squares if board else (9, 7)
            self._across = Field("Squares across", str(across), kind="number")
            self._down = Field("Squares down", str(down), kind="number")
            self._square = Field(
                "Side of a square, measured, mm",
                _shown(board.square_mm if board else None),
                kind="number",
            )
            self._square_u = Field(
                "Standard uncertainty of that side, mm (optional)",
                _shown(board.square_u_mm if board else None),
                kind="number",
            )
            self._form = Field("Its form", board.form if board else "bowed", options=_FORMS)
            self._dictionary = Field(
                "Dictionary (ChArUco)",
                (board and board.dictionary) or "",
                suggestions=_DICTIONARIES,
            )
            self._marker = Field(
                "Side of a marker (ChArUco), mm",
                _shown(board.marker_mm if board else None),
                kind="number",
            )
            known = self._session.diameter_mm if self._session else None
            self._diameter = Field("Diameter of the shaft, mm", _shown(known), kind="number")

    def _camera_fields(self, rate_hz: float) -> None:
        tag("h2", "Cameras")
        tag(
            "p",
            "A camera is a capture device (device 0), a folder of images, a video file, a topic of "
            "a ROS bag (run.bag#/left/image_raw) or a GenICam camera (genicam producer.cti 0). The "
            "first one is the reference: results are in its frame.",
        ).classes("lead")
        self._box = ui.element("div").classes("pairs")
        names = list(self._session.cameras) if self._session else ["left", "right"]
        for name in names:
            self._add_row(name)
        if self._session is None:
            button("Add a camera", lambda: self._add_row(f"camera{len(self.rows) + 1}"))
        with ui.element("div").classes("fields"):
            self._rate = Field(
                "Pictures a second of folders, videos", _shown(rate_hz), kind="number"
            )

    def _add_row(self, name: str) -> None:
        with self._box:
            row = CameraRow(
                Field(f"Name of camera {len(self.rows) + 1}", name),
                Field(
                    f"Source of camera {len(self.rows) + 1}",
                    self._saved.get(name, ""),
                    suggestions=found_devices(),
                ),
            )
        self.rows.append(row)

    def _other_fields(self) -> None:
        session = self._session
        tag("h2", "For the report")
        with ui.element("div").classes("fields"):
            self._device = Field("Robot", _free(session.device if session else {}))
            self._operator = Field("Operator", _free(session.operator if session else {}))
            self._notes = Field("Notes", session.notes if session else "", wide=True)

    def rate_hz(self) -> float:
        """Return the rate of folders and videos, 1/s."""
        return _number(self._rate, "the rate")

    def sources(self) -> dict[str, str]:
        """Return what plays each camera; those left empty are not there."""
        rows = ((row.name.value.strip(), row.source.value.strip()) for row in self.rows)
        return {name: source for name, source in rows if source}

    def settings(self) -> Settings:
        """Return what the form says.

        Raises
        ------
        UsageError
            If a number is missing, or the board is none.
        """
        charuco = self._kind.value == "charuco"
        board = Board(
            kind="charuco" if charuco else "checkerboard",
            squares=(
                round(_number(self._across, "squares across")),
                round(_number(self._down, "squares down")),
            ),
            square_mm=_number(self._square, "the side of a square"),
            square_u_mm=_optional(self._square_u, "the uncertainty of a square's side"),
            dictionary=(self._dictionary.value or "DICT_4X4_50") if charuco else None,
            marker_mm=_number(self._marker, "the side of a marker") if charuco else None,
            form=self._form.value,  # type: ignore[arg-type]
        )
        names = tuple(row.name.value.strip() for row in self.rows)
        known = self._session
        return Settings(
            board=board,
            diameter_mm=_optional(self._diameter, "the diameter"),
            camera_names=names,
            reference=names[0],
            device=_named(known.device if known else {}, self._device.value),
            operator=_named(known.operator if known else {}, self._operator.value),
            notes=self._notes.value,
            hints=known.hints if known else {},
        )


_DICTIONARIES = ("DICT_4X4_50", "DICT_4X4_100", "DICT_5X5_100", "DICT_6X6_250")


def _shown(value: float | None) -> str:
    """Return a number as it was typed: what is saved again must not lose digits."""
    return "" if value is None else f"{value:.12g}"


def _number(field: Field, what: str) -> float:
    try:
        value = float(field.value)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UsageError(f"{what} is {field.value!r}, no number", next_step="correct it")
    return value


def _optional(field: Field, what: str) -> float | None:
    return _number(field, what) if field.value.strip() else None


def _free(table: Mapping[str, object]) -> str:
    """Return the name in a free-form table, or nothing."""
    return str(table.get("name", ""))


def _named(table: Mapping[str, object], name: str) -> dict[str, object]:
    """Return a free-form table with another name in it; its other entries stay."""
    kept = {key: value for key, value in table.items() if key != "name"}
    return {"name": name, **kept} if name else kept
