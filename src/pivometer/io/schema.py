"""The JSON Schema of ``result.json``, from the annotations and docstrings of `Measurement`."""

import dataclasses
import re
from collections.abc import Callable, Mapping
from typing import Any, Literal, get_args, get_origin

import numpy as np

from pivometer.io.codec import UNLIMITED, alternatives_of, annotations_of, status_of
from pivometer.io.result import POSE_NAMES, RESULT_SCHEMA, SEAL
from pivometer.measurement import Measurement

_SHAPES = {
    "point_mm": (3,),
    "direction": (3,),
    "translation_mm": (3,),
    "expanded_mm": (3,),
    "shift_mm": (3,),
    "shift_covariance_mm2": (3, 3),
    "interval_mm": (2,),
    "rms_interval_mm": (2,),
    "max_interval_mm": (2,),
    "rotation": (3, 3),
    "focal_px": (2,),
    "principal_point_px": (2,),
    "covariance_mm2": (3, 3),
    "minimax_point_mm": (3,),
    "least_squares_point_mm": (3,),
    "board_mm2": (3, 3),
    "lines_mm2": (3, 3),
    "calibration_mm2": (3, 3),
    "total_mm2": (3, 3),
    "axis": (3,),
    "shift_u_mm": (3,),
    "shading_mm2": (3, 3),
    "location_u_mm": (3,),
    "board_u_mm": (3,),
    "excess_mm2": (3,),
    "linear_ratio": (3,),
}
"""Arrays whose shape is the same wherever the name occurs; others are arrays of numbers."""


def schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of ``result.json``.

    Names that it does not list are allowed: later versions may add some.

    Examples
    --------
    >>> schema()["properties"]["schema"]
    {'const': 'pivometer/result/1'}
    """
    definitions: dict[str, Any] = {
        "numbers": {
            "type": "array",
            "items": {"anyOf": [{"type": "number"}, {"$ref": "#/$defs/numbers"}]},
        }
    }
    _of(Measurement, "", definitions)
    _complete_poses(definitions)
    whole = definitions.pop("Measurement")
    whole["properties"] = {
        "schema": {"const": RESULT_SCHEMA},
        "reference_camera": {"type": "string", "description": "whose frame everything is in, mm"},
        **whole["properties"],
        SEAL: {"type": "string", "description": "SHA-256 of the text without this name"},
    }
    whole["required"] = ["schema", "reference_camera", *whole["required"]]
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"urn:{RESULT_SCHEMA.replace('/', ':')}",
        "title": "result.json of Pivometer",
        **whole,
        "$defs": definitions,
    }


def _complete_poses(definitions: dict[str, Any]) -> None:
    """Add to both kinds of pose the names that only the other has: `null` in the file."""
    for kind in ("UsedPose", "RejectedPose"):
        for name in POSE_NAMES:
            definitions[kind]["properties"].setdefault(name, {"type": "null"})
        definitions[kind]["required"] = sorted({*definitions[kind]["required"], *POSE_NAMES})


def _of(kind: Any, name: str, definitions: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a type; `name` is the attribute that holds it."""
    members = alternatives_of(kind)
    if members:
        return {"anyOf": [_of(member, name, definitions) for member in members]}
    if dataclasses.is_dataclass(kind) and isinstance(kind, type):
        return _reference(kind, definitions)
    return _WRITERS.get(get_origin(kind) or kind, _anything)(kind, name, definitions)


def _reference(kind: type, definitions: dict[str, Any]) -> dict[str, Any]:
    """Describe a dataclass once, under its name, and refer to it."""
    if kind.__name__ not in definitions:
        hints, meanings = annotations_of(kind), _meanings(kind)
        properties: dict[str, Any] = {}
        definitions[kind.__name__] = {
            "type": "object",
            "description": _sentence(kind),
            "properties": properties,
            "required": list(hints),
        }
        for name, hint in hints.items():
            meaning = {"description": meanings[name]} if name in meanings else {}
            properties[name] = _of(hint, name, definitions) | meaning
        if isinstance(status_of(kind), str):
            properties["status"] = {"const": status_of(kind)}
    return {"$ref": f"#/$defs/{kind.__name__}"}


def _array(_: Any, name: str, __: dict[str, Any]) -> dict[str, Any]:
    described: dict[str, Any] = {"type": "number"}
    if name not in _SHAPES:
        return {"$ref": "#/$defs/numbers"}
    for length in reversed(_SHAPES[name]):
        described = {"type": "array", "items": described, "minItems": length, "maxItems": length}
    return described


def _tuple(kind: Any, name: str, definitions: dict[str, Any]) -> dict[str, Any]:
    members = get_args(kind)
    described: dict[str, Any] = {"type": "array", "items": _of(members[0], name, definitions)}
    if members[1:] != (...,):
        described |= {"minItems": len(members), "maxItems": len(members)}
    return described


def _mapping(kind: Any, name: str, definitions: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "additionalProperties": _of(get_args(kind)[1], name, definitions)}


def _number(_: Any, name: str, __: dict[str, Any]) -> dict[str, Any]:
    return {"type": ["number", "null"] if name == UNLIMITED else "number"}


def _literal(kind: Any, _: str, __: dict[str, Any]) -> dict[str, Any]:
    return {"enum": list(get_args(kind))}


def _anything(_: Any, __: str, ___: dict[str, Any]) -> dict[str, Any]:
    return {}


def _plain(name: str) -> Callable[[Any, str, dict[str, Any]], dict[str, Any]]:
    return lambda *_: {"type": name}


_WRITERS: dict[object, Callable[[Any, str, dict[str, Any]], dict[str, Any]]] = {
    np.ndarray: _array,
    tuple: _tuple,
    Mapping: _mapping,
    dict: _mapping,
    Literal: _literal,
    float: _number,
    int: _plain("integer"),
    str: _plain("string"),
    bool: _plain("boolean"),
    type(None): _plain("null"),
}


# --- What the docstrings say ---


def _sentence(kind: type) -> str:
    return (kind.__doc__ or "").partition("\n")[0]


def _meanings(kind: type) -> dict[str, str]:
    """Return what the Parameters section of a NumPy docstring says of each attribute."""
    section = (kind.__doc__ or "").partition("Parameters\n    ----------\n")[2]
    section = re.split(r"\n    \w+\n    -{3,}", section)[0]
    entries = re.findall(r"^    (\w[\w, ]*)\n((?:        .*\n?|\n)+)", section, re.MULTILINE)
    return {name: " ".join(text.split()) for names, text in entries for name in names.split(", ")}
