"""The text of a ``session.toml``, which `pivometer.io.settings` reads."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping

from pivometer.io.settings import Settings

_BARE = re.compile(r"[A-Za-z0-9_-]+")


def settings_text(settings: Settings) -> str:
    """Return the text of a ``session.toml`` that says what `settings` says.

    Examples
    --------
    >>> from pivometer.calibration.board import Board
    >>> board = Board("checkerboard", (9, 7), 15.02)
    >>> print(settings_text(Settings(board, 8.0, ("left", "right"), "left", {}, {}, "")))
    [board]
    kind = "checkerboard"
    squares = [9, 7]
    square_mm = 15.02
    form = "bowed"
    <BLANKLINE>
    [shaft]
    diameter_mm = 8.0
    <BLANKLINE>
    [cameras]
    names = ["left", "right"]
    reference = "left"
    <BLANKLINE>
    """
    board = settings.board
    shaft: dict[str, object] = {"diameter_mm": settings.diameter_mm}
    if settings.hints:
        shaft["hint"] = {
            name: [v for v in (hint.x_px, hint.y_px, hint.width_px) if v is not None]
            for name, hint in settings.hints.items()
        }
    tables: dict[str, Mapping[str, object]] = {
        "board": {
            "kind": board.kind,
            "squares": board.squares,
            "square_mm": board.square_mm,
            "square_u_mm": board.square_u_mm,
            "dictionary": board.dictionary,
            "marker_mm": board.marker_mm,
            "form": board.form,
        },
        "shaft": shaft,
        "cameras": {"names": settings.camera_names, "reference": settings.reference},
        "device": settings.device,
        "operator": settings.operator,
    }
    notes = f"notes = {_value(settings.notes)}\n\n" if settings.notes else ""
    return notes + "\n".join(
        _table(name, table) for name, table in tables.items() if _says_anything(table)
    )


def _says_anything(table: Mapping[str, object]) -> bool:
    """Tell whether a table says anything."""
    return any(value is not None for value in table.values())


def _table(name: str, table: Mapping[str, object]) -> str:
    rows = [f"{_key(k)} = {_value(v)}" for k, v in table.items() if v is not None]
    return "\n".join([f"[{_key(name)}]", *rows, ""])


def _key(key: str) -> str:
    return key if _BARE.fullmatch(key) else _value(key)


def _value(value: object) -> str:
    """Return a value as TOML: text is quoted as in JSON, whose escapes are TOML's too."""
    if isinstance(value, Mapping):
        inside = ", ".join(f"{_key(str(k))} = {_value(v)}" for k, v in value.items())
        return f"{{ {inside} }}" if inside else "{}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(_value(entry) for entry in value)}]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return json.dumps(value) if isinstance(value, bool) else repr(value)
