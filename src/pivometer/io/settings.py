"""``session.toml``: what a session says of itself, checked key by key.

Every problem is reported at once, each with its line, the key, what the key means and what it
wants; an unknown key with the nearest one that exists.
"""

import datetime as dt
import difflib
import math
import re
import sys
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, get_args

from pivometer.calibration.board import Board, BoardForm
from pivometer.errors import SessionError
from pivometer.shaft.hint import ShaftHint

MOST_BYTES = 1_000_000
"""Of a ``session.toml``: a session's description is a page."""

EXAMPLE = '[board] kind = "checkerboard", squares = [9, 7], square_mm = 15.0'


@dataclass(frozen=True, slots=True, eq=False)
class Settings:
    """The content of a ``session.toml``.

    Parameters
    ----------
    board
        The calibration board.
    diameter_mm
        The shaft's nominal diameter, mm, if stated.
    camera_names
        The cameras in the order listed; `None` where the folders decide.
    reference
        The reference camera; `None` where the alphabet decides.
    device, operator
        Free-form tables.
    notes
        Free text.
    hints
        By camera, where its shaft is.
    """

    board: Board
    diameter_mm: float | None
    camera_names: tuple[str, ...] | None
    reference: str | None
    device: Mapping[str, object]
    operator: Mapping[str, object]
    notes: str
    hints: Mapping[str, ShaftHint] = field(default_factory=dict)


def _is_text(value: object) -> bool:
    return isinstance(value, str) and value.strip() != ""


def _is_length(value: object) -> bool:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and 0 < value <= sys.float_info.max  # type: ignore[operator]


def _is_squares(value: object) -> bool:
    return isinstance(value, list) and len(value) == 2 and all(type(n) is int for n in value)


def _is_names(value: object) -> bool:
    return isinstance(value, list) and len(value) > 0 and all(_is_text(name) for name in value)


def _is_hints(value: object) -> bool:
    return isinstance(value, dict) and all(_is_hint(entry) for entry in value.values())


def _is_hint(value: object) -> bool:
    if not isinstance(value, list) or len(value) not in (2, 3):
        return False
    if not all(type(n) in (int, float) and abs(n) < 1e6 for n in value):
        return False
    return len(value) == 2 or value[2] > 0


@dataclass(frozen=True, slots=True, eq=False)
class Key:
    """What one key means, and which values it takes."""

    meaning: str
    wants: str
    fits: Callable[[object], bool]
    required: bool = False


_LENGTH = "a number above 0"
KEYS: dict[str, Key] = {
    "board.kind": Key(
        "kind of calibration board", '"checkerboard" or "charuco"', _is_text, required=True
    ),
    "board.squares": Key(
        "number of squares across and down, counting the outer ones",
        "two whole numbers of 3 or more, as in [9, 7]",
        lambda value: _is_squares(value) and 3 <= min(value) <= max(value) <= 1000,  # type: ignore[call-overload]
        required=True,
    ),
    "board.square_mm": Key("edge length of one square, mm", _LENGTH, _is_length, required=True),
    "board.square_u_mm": Key(
        "standard uncertainty of square_mm, mm", "a number above 0, below square_mm", _is_length
    ),
    "board.dictionary": Key(
        "ArUco dictionary of a ChArUco board", 'a name such as "DICT_4X4_50"', _is_text
    ),
    "board.marker_mm": Key(
        "edge length of one ChArUco marker, mm", "a number above 0, below square_mm", _is_length
    ),
    "board.form": Key(
        "what the board is taken for",
        '"flat", "bowed" or "free"',
        lambda value: value in get_args(BoardForm),
    ),
    "shaft.diameter_mm": Key("nominal diameter of the shaft, mm", _LENGTH, _is_length),
    "shaft.hint": Key(
        "for each camera the pixel about which the shaft turns, and its width there",
        "[x, y] or [x, y, width] in pixels for each camera, as in left = [412, 300, 22]",
        _is_hints,
    ),
    "cameras.names": Key(
        "folder names of the cameras", 'a list such as ["left", "right"]', _is_names
    ),
    "cameras.reference": Key(
        "camera whose frame all results are in", 'the name of one camera, as in "left"', _is_text
    ),
    "notes": Key("free text", "text", lambda value: isinstance(value, str)),
}
TABLES = {
    "board": "the calibration board",
    "shaft": "the instrument's shaft",
    "cameras": "the cameras",
    "device": "free-form facts about the robot",
    "operator": "free-form facts about who measured",
}
FREE_TABLES = ("device", "operator")


def read_settings(path: Path) -> Settings:
    """Read and check a ``session.toml``.

    Raises
    ------
    SessionError
        If the file is missing, is not TOML, or any key or value is wrong; all that is wrong is in
        one message.
    """
    text = _text(path)
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise SessionError(
            f"is not valid TOML: {error}",
            next_step='correct that line; text stands in quotes, as in kind = "checkerboard"',
            path=path,
        ) from error
    except RecursionError:
        raise SessionError(
            "nests brackets deeper than any description does",
            next_step=f"write it: {EXAMPLE}",
            path=path,
        ) from None
    problems = [f"{_line(text, key)}{key}: {problem}" for key, problem in _problems(content)]
    if problems:
        several = "" if len(problems) == 1 else f"{len(problems)} problems\n  "
        raise SessionError(
            several + "\n  ".join(problems), next_step="correct session.toml", path=path
        )
    return _settings(content)


def _text(path: Path) -> str:
    """Return the file's text; a byte-order mark, which some editors put first, is dropped."""
    try:
        if path.stat().st_size > MOST_BYTES:
            raise SessionError(
                f"is {path.stat().st_size / 1e6:.0f} MB, more than any session's description",
                next_step=f"write it: {EXAMPLE}",
                path=path,
            )
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise SessionError(
            f"cannot be read: {error.strerror}", next_step=f"write it: {EXAMPLE}", path=path
        ) from error
    except UnicodeDecodeError as error:
        raise SessionError(
            f"is not UTF-8 text (byte {error.start})", next_step="save it as UTF-8", path=path
        ) from error


def _settings(content: Mapping[str, Any]) -> Settings:
    """Build the typed settings from checked content."""
    board = dict(content["board"])
    cameras = content.get("cameras", {})
    names = cameras.get("names")
    hints = content.get("shaft", {}).get("hint", {})
    return Settings(
        board=Board(**{**board, "squares": tuple(board["squares"])}),
        diameter_mm=content.get("shaft", {}).get("diameter_mm"),
        camera_names=None if names is None else tuple(names),
        reference=cameras.get("reference"),
        device=_plain(content.get("device", {})),
        operator=_plain(content.get("operator", {})),
        notes=content.get("notes", ""),
        hints={name: ShaftHint(*hint) for name, hint in hints.items()},
    )


def _problems(content: Mapping[str, object]) -> Iterator[tuple[str, str]]:
    """Yield (key, what is wrong with it) for everything that is wrong."""
    meant: set[str] = set()
    for name, value in content.items():
        if name in FREE_TABLES and isinstance(value, dict):
            yield from _unwritable(name, value)
        elif name in TABLES and isinstance(value, dict):
            for key, entry in value.items():
                yield from _entry_problems(f"{name}.{key}", entry, value, meant)
        elif name in TABLES:
            yield name, f"is {_shown(value)}, not a table ({TABLES[name]}); write [{name}]"
        else:
            yield from _entry_problems(name, value, content, meant)
    yield from ((name, what) for name, what in _missing(content) if name not in meant)
    board, cameras = content.get("board"), content.get("cameras")
    if isinstance(board, dict):
        yield from _board_problems(board)
    if isinstance(cameras, dict):
        yield from _camera_problems(cameras)


def _entry_problems(
    name: str, value: object, beside: Mapping[str, object], meant: set[str]
) -> Iterator[tuple[str, str]]:
    """Yield what is wrong with one key: unknown, or a value it does not take.

    The key that an unknown one stands for goes to `meant`, so that it is not reported as missing.
    """
    key = KEYS.get(name)
    if key is None:
        near = _nearest(name, beside)
        meant.update(near)
        yield name, f"unknown key. {_hint(name, near)}"
    elif not key.fits(value):
        yield name, f"is {_shown(value)}, but wants {key.wants} ({key.meaning})"


def _nearest(name: str, beside: Mapping[str, object]) -> list[str]:
    """Return the key that an unknown one most likely stands for, with its table, if any does.

    A key of the same name in another table; then the nearest one that this table still lacks, with
    or without its unit; then the nearest anywhere.
    """
    table, _, key = name.casefold().rpartition(".")
    short = {known.rpartition(".")[2]: known for known in (*TABLES, *KEYS)}
    if key in short:
        return [short[key]]
    own = {k: known for k, known in short.items() if known.rpartition(".")[0] == table}
    lacking = {k: known for k, known in own.items() if k not in beside}
    unitless = {k.removesuffix("_mm"): known for k, known in lacking.items()}
    for candidates, cutoff in ((unitless | lacking, 0.5), (short, 0.6)):
        if near := difflib.get_close_matches(key, candidates, n=1, cutoff=cutoff):
            return [candidates[near[0]]]
    return []


def _hint(name: str, near: Sequence[str]) -> str:
    """Say which key was meant, or which there are."""
    table = name.rpartition(".")[0]
    for known in near:
        meaning = TABLES.get(known) or KEYS[known].meaning
        shown = known.removeprefix(f"{table}.") if table else known
        return f"Did you mean '{shown}' ({meaning})?"
    here = [known.rpartition(".")[2] for known in KEYS if known.rpartition(".")[0] == table]
    return f"Known here: {', '.join(here if table else [*(f'[{t}]' for t in TABLES), *here])}"


def _missing(content: Mapping[str, object]) -> Iterator[tuple[str, str]]:
    """Yield the keys that every session needs and this one lacks."""
    if "board" not in content:
        yield "board", f"missing ({TABLES['board']}). Write {EXAMPLE}"
        return
    board = content["board"]
    for name, key in KEYS.items():
        if key.required and isinstance(board, dict) and name.rpartition(".")[2] not in board:
            yield name, f"missing ({key.meaning}; {key.wants})"


def _board_problems(board: Mapping[str, object]) -> Iterator[tuple[str, str]]:
    """Yield what is wrong with the board's values as a whole."""
    kind, square = board.get("kind"), board.get("square_mm")
    kinds = ("checkerboard", "charuco")
    if isinstance(kind, str) and kind.strip() and kind not in kinds:
        near = difflib.get_close_matches(kind.casefold(), kinds, n=1)
        hint = f"Did you mean '{near[0]}'?" if near else "Known: 'checkerboard', 'charuco'"
        yield "board.kind", f"is {_shown(kind)}. {hint}"
    for part in ("dictionary", "marker_mm"):
        meaning = KEYS[f"board.{part}"].meaning
        if kind == "charuco" and part not in board:
            yield f"board.{part}", f"missing ({meaning})"
        if kind == "checkerboard" and part in board:
            yield f"board.{part}", f'has no meaning here ({meaning}); kind is "checkerboard"'
    for part in ("square_u_mm", "marker_mm"):
        value = board.get(part)
        if _is_length(value) and _is_length(square) and not value < square:  # type: ignore[operator]
            yield (
                f"board.{part}",
                f"is {value}, not below square_mm, {square} ({KEYS[f'board.{part}'].meaning})",
            )
    yield from _dictionary_problems(board.get("dictionary"))


def _dictionary_problems(dictionary: object) -> Iterator[tuple[str, str]]:
    """Yield that a dictionary is none of OpenCV's, with the nearest of them."""
    if not _is_text(dictionary):
        return
    import cv2

    known = [name for name in dir(cv2.aruco) if name.startswith("DICT_")]
    if dictionary not in known:
        near = difflib.get_close_matches(str(dictionary).upper(), known, n=1, cutoff=0.4)
        hint = f"Did you mean '{near[0]}'?" if near else 'Write, for instance, "DICT_4X4_50"'
        yield "board.dictionary", f"is {_shown(dictionary)}, no dictionary of OpenCV's. {hint}"


def _camera_problems(cameras: Mapping[str, object]) -> Iterator[tuple[str, str]]:
    """Yield what is wrong with the list of cameras as a whole."""
    names, reference = cameras.get("names"), cameras.get("reference")
    if not _is_names(names) or not isinstance(names, list):
        return
    for name in sorted({name for name in names if names.count(name) > 1}):
        yield "cameras.names", f"lists '{name}' twice"
    if len(set(names)) < 2:
        yield "cameras.names", f"lists {len(set(names))} camera; at least two must see the shaft"
    for name in names:
        if "/" in name or "\\" in name or name in (".", ".."):
            yield "cameras.names", f"'{name}' is no folder name"
    if _is_text(reference) and reference not in names:
        yield "cameras.reference", f"is {_shown(reference)}, which is not among names, {names}"


def _unwritable(name: str, value: object) -> Iterator[tuple[str, str]]:
    """Yield the numbers of a free-form table that no result file can hold."""
    if isinstance(value, dict):
        for key, entry in value.items():
            yield from _unwritable(f"{name}.{key}", entry)
    elif isinstance(value, list):
        for entry in value:
            yield from _unwritable(name, entry)
    elif isinstance(value, float) and not math.isfinite(value):
        yield name, f"is {value}, not a number that a result can hold; put it in quotes"


def _plain(value: Any) -> Any:
    """Return a TOML value with dates and times as ISO 8601 text, as the result file has them."""
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_plain(entry) for entry in value]
    if isinstance(value, dt.date | dt.time):
        return value.isoformat()
    return value


def _shown(value: object) -> str:
    """Show a value as TOML writes it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f'"{value}"'
    return "a table" if isinstance(value, dict) else str(value)


def _line(text: str, name: str) -> str:
    """Return "line 7: " for where a key stands, or nothing where a simple search misses it."""
    table, _, key = name.rpartition(".")
    current = ""
    for number, line in enumerate(text.splitlines(), start=1):
        if header := re.match(r"\s*\[\s*([^\[\]]+?)\s*\]", line):
            current = header[1]
            if current == name:
                return f"line {number}: "
        if current == table and re.match(rf"\s*[\"']?{re.escape(key)}[\"']?\s*=", line):
            return f"line {number}: "
    return ""
