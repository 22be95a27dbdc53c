"""Typed values to JSON and back, by the annotations of their dataclasses.

A JSON name is always the attribute's name, so a result file and a result in Python read alike.
Numbers keep their full precision; one that is not finite is refused, never written.
"""

import dataclasses
import json
import math
import types
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from pivometer.errors import DataError, PivometerError, UsageError

UNLIMITED = "degrees_of_freedom"
"""The one number that may be infinite; JSON knows no infinity, so the file has `null` there."""


@cache
def annotations_of(kind: type) -> dict[str, Any]:
    """Return the types of the fields that a dataclass is built from, by name."""
    hints = get_type_hints(kind)
    return {field.name: hints[field.name] for field in dataclasses.fields(kind) if field.init}


def alternatives_of(kind: object) -> tuple[Any, ...]:
    """Return the members of a union of types, or an empty tuple."""
    return get_args(kind) if get_origin(kind) in (Union, types.UnionType) else ()


_RENAMED = {"beta": "distortion"}
"""Names that early files have, and what they are called now."""


# --- Out ---


def jsonable(value: object, where: str = "") -> Any:
    """Return a value of our types as what `json` writes.

    Raises
    ------
    DataError
        If a number is not finite; the message says which.

    Examples
    --------
    >>> jsonable({"point_mm": np.array([1.0, 2.0])})
    {'point_mm': [1.0, 2.0]}
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        names = annotations_of(type(value))
        return {name: jsonable(getattr(value, name), _inside(where, name)) for name in names}
    if isinstance(value, Mapping):
        return {str(key): jsonable(entry, _inside(where, key)) for key, entry in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return jsonable(value.tolist(), where)
    if isinstance(value, list | tuple):
        return [jsonable(entry, f"{where}[{i}]") for i, entry in enumerate(value)]
    return _plain(value, where)


def _plain(value: object, where: str) -> object:
    if isinstance(value, Path):
        return value.as_posix()
    if isinstance(value, float) and not math.isfinite(value):
        if value > 0 and where.endswith(UNLIMITED):
            return None
        raise DataError(
            f"{where} is {value}, not a number that a result may state",
            next_step="report this, with the session if you can: it should not happen",
        )
    return value


def json_text(content: object, indent: str = "") -> str:
    """Return JSON text with a line for each name, and lists of numbers on one line.

    Examples
    --------
    >>> print(json_text({"point_mm": [1.0, 2.0], "views": []}))
    {
     "point_mm": [1.0, 2.0],
     "views": []
    }
    """
    deeper = indent + " "
    if isinstance(content, dict) and content:
        lines = [
            f"{deeper}{json.dumps(key, ensure_ascii=False)}: {json_text(entry, deeper)}"
            for key, entry in content.items()
        ]
        return "{\n" + ",\n".join(lines) + f"\n{indent}}}"
    if isinstance(content, list) and any(isinstance(entry, dict) for entry in content):
        lines = [deeper + json_text(entry, deeper) for entry in content]
        return "[\n" + ",\n".join(lines) + f"\n{indent}]"
    return json.dumps(content, ensure_ascii=False, allow_nan=False)


# --- In ---


def read_json(path: Path) -> Any:
    """Read a JSON file.

    Raises
    ------
    UsageError
        If it cannot be read, or is not JSON.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        what, step = f"cannot be read: {error.strerror}", "check the path"
    except UnicodeDecodeError as error:
        what, step = f"is not UTF-8 text (byte {error.start})", "name a file Pivometer wrote"
    except json.JSONDecodeError as error:
        what, step = f"is not JSON: {error}", "write the file anew: it is damaged or cut off"
    except RecursionError:
        what, step = "is nested too deeply to be read", "name a file Pivometer wrote"
    raise UsageError(what, next_step=step, path=path)


def typed(kind: Any, value: Any, where: str = "") -> Any:
    """Return JSON content as a value of type `kind`: a dataclass, an array, a container of such.

    Names that the type does not have are passed over, so files of later versions can be read.

    Raises
    ------
    UsageError
        If a name is missing, or a value has the wrong type or shape; the message says where.

    Examples
    --------
    >>> typed(tuple[int, int], [9, 7])
    (9, 7)
    """
    members = alternatives_of(kind)
    if members:
        return _one_of(members, value, where)
    if dataclasses.is_dataclass(kind):
        return _dataclass(kind, value, where)
    origin = get_origin(kind)
    if origin is np.ndarray:
        return _array(kind, value, where)
    reader = _READERS.get(origin or kind)
    return value if reader is None else reader(kind, value, where)


def _dataclass(kind: Any, value: Any, where: str) -> Any:
    stated = _expect(dict, value, where)
    content = {_RENAMED.get(name, name): entry for name, entry in stated.items()}
    hints = annotations_of(kind)
    optional = {
        field.name
        for field in dataclasses.fields(kind)
        if field.default is not dataclasses.MISSING
        or field.default_factory is not dataclasses.MISSING
    }
    missing = [name for name in hints if name not in content and name not in optional]
    if missing:
        raise _wrong(_inside(where, missing[0]), "is missing")
    arguments = {
        name: typed(hint, content[name], _inside(where, name))
        for name, hint in hints.items()
        if name in content
    }
    try:
        return kind(**arguments)
    except PivometerError as error:
        raise _wrong(where, error.what) from error


def _one_of(members: Sequence[Any], value: Any, where: str) -> Any:
    """Read the member of a union that fits: none, or the dataclass with the same ``status``."""
    if value is None and type(None) in members:
        return None
    candidates = [member for member in members if member is not type(None)]
    if len(candidates) > 1 and isinstance(value, dict):
        candidates = [kind for kind in candidates if status_of(kind) == value.get("status")]
    if not candidates:
        raise _wrong(_inside(where, "status"), f"is {value.get('status')!r}")
    return typed(candidates[0], value, where)


def status_of(kind: type) -> object:
    """Return the ``status`` that tells a dataclass from the others of its union."""
    return {field.name: field.default for field in dataclasses.fields(kind)}.get("status")


def _array(kind: Any, value: Any, where: str) -> Any:
    (dtype,) = get_args(get_args(kind)[1])
    try:
        array = np.array(_expect(list, value, where), dtype=dtype)
    except (ValueError, TypeError) as error:
        raise _wrong(where, "is not an array of numbers") from error
    if not np.isfinite(array).all():
        raise _wrong(where, "holds numbers that are not finite")
    return array


def _tuple(kind: Any, value: Any, where: str) -> tuple[Any, ...]:
    entries, members = _expect(list, value, where), get_args(kind)
    if members[1:] == (...,):
        members = members[:1] * len(entries)
    if len(members) != len(entries):
        raise _wrong(where, f"has {len(entries)} entries, not {len(members)}")
    return tuple(
        typed(member, entry, f"{where}[{i}]")
        for i, (member, entry) in enumerate(zip(members, entries, strict=True))
    )


def _mapping(kind: Any, value: Any, where: str) -> dict[str, Any]:
    entries, (_, member) = _expect(dict, value, where), get_args(kind)
    return {key: typed(member, entry, _inside(where, key)) for key, entry in entries.items()}


def _number(_: Any, value: Any, where: str) -> float:
    if value is None and where.endswith(UNLIMITED):
        return math.inf
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise _wrong(where, f"is {value!r}, not a number")
    return float(value)


def _literal(kind: Any, value: Any, where: str) -> object:
    if value not in get_args(kind):
        raise _wrong(where, f"is {value!r}, none of {', '.join(map(repr, get_args(kind)))}")
    return value


def _same(kind: Any, value: Any, where: str) -> Any:
    return _expect(kind, value, where)


_READERS: dict[object, Callable[[Any, Any, str], Any]] = {
    tuple: _tuple,
    Mapping: _mapping,
    dict: _mapping,
    float: _number,
    Literal: _literal,
    int: _same,
    str: _same,
    bool: _same,
}


def _expect(kind: type, value: Any, where: str) -> Any:
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        names = {dict: "an object", list: "a list", int: "a whole number", str: "text"}
        raise _wrong(where, f"is {type(value).__name__}, not {names.get(kind, kind.__name__)}")
    return value


def _wrong(where: str, what: str) -> UsageError:
    return UsageError(f"{where or 'the content'} {what}", next_step="name a file Pivometer wrote")


def _inside(where: str, name: object) -> str:
    return f"{where}.{name}" if where else str(name)
