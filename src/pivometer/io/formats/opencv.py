"""OpenCV's FileStorage, YAML, XML or JSON, as its stereo calibration sample writes it.

K as ``M1``, ``M2`` (or ``K1``, ``cameraMatrix1``), coefficients as ``D1``, ``D2`` (or
``distCoeffs1``), and ``R``, ``T`` with x_right = R x_left + T; in one file, or intrinsics and
extrinsics in two. The sample states neither the unit of T nor the image size. Our own files do, and
the cameras' names, under names that OpenCV passes over.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any
from xml.etree import ElementTree as ET

import cv2
import numpy as np
import yaml

from pivometer._arrays import Floats
from pivometer.cameras import Rig
from pivometer.geometry.rigid import RigidTransform
from pivometer.io.formats.conventions import (
    Told,
    camera_from,
    padded,
    require_two,
    rig_from,
    size_in_px,
    transform_from,
    unit_in_mm,
    unreadable,
)

_NAMES = (("M", "D"), ("K", "D"), ("cameraMatrix", "distCoeffs"), ("camera_matrix_", "dist_"))


def recognise(content: bytes) -> bool:
    """Say whether a file is a FileStorage."""
    start = content[:4096].lstrip()
    json = start.startswith(b"{") and b'"opencv-matrix"' in start
    return json or start.startswith(b"%YAML") or b"\n<opencv_storage>" in start


def read(files: Mapping[str, bytes], told: Told) -> Rig:
    """Read a rig of two cameras."""
    nodes: dict[str, Any] = {}
    for content in files.values():
        nodes |= _nodes(content)
    found = [pair for pair in _NAMES if {f"{pair[0]}1", f"{pair[0]}2", "R", "T"} <= nodes.keys()]
    if not found:
        raise unreadable(
            f"holds {', '.join(nodes) or 'nothing'}, not two cameras (M1, D1, M2, D2) with their "
            "pose (R, T)",
            next_step="name the folder that holds both intrinsics and extrinsics",
        )
    matrix, lens = found[0]
    cameras = [
        camera_from(
            str(nodes.get(f"name{i}", ("left", "right")[i - 1])),
            size_in_px(_size(nodes, i), told),
            nodes[f"{matrix}{i}"],
            nodes.get(f"{lens}{i}", np.zeros(0)),
        )
        for i in (1, 2)
    ]
    unit = unit_in_mm(nodes.get("length_unit"), told)
    right_from_left = transform_from(nodes["R"], nodes["T"], unit)
    return rig_from(cameras, [RigidTransform.identity(), right_from_left])


# --- Reading, without OpenCV: its parser ends the whole program on some damaged files ---


class _Loader(yaml.SafeLoader):
    """YAML as OpenCV writes it, with its own tag for matrices."""


def _matrix_node(loader: _Loader, node: yaml.MappingNode) -> Floats:
    return _matrix({str(k): v for k, v in loader.construct_mapping(node, deep=True).items()})


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _matrix_node)


def _nodes(content: bytes) -> dict[str, Any]:
    """Return matrices, numbers and strings by name."""
    text = content.decode("utf-8").lstrip()
    try:
        if text.startswith("{"):
            return {name: _plain(value) for name, value in json.loads(text).items()}
        if text.startswith("%YAML"):
            return dict(yaml.load(text.partition("\n")[2], Loader=_Loader))  # noqa: S506 - a safe one
        return {node.tag: _element(node) for node in ET.fromstring(text)}  # noqa: S314
    except (yaml.YAMLError, ET.ParseError, KeyError) as error:
        raise unreadable(f"is a damaged FileStorage: {error}") from error


def _matrix(fields: Mapping[str, Any]) -> Floats:
    """Return a matrix from its ``rows``, ``cols`` and ``data``."""
    numbers = [float(number) for number in fields["data"]]
    return np.array(numbers).reshape(int(fields["rows"]), int(fields["cols"]))


def _plain(value: Any) -> Any:
    return _matrix(value) if isinstance(value, dict) and "data" in value else value


def _element(node: ET.Element) -> Any:
    fields = {child.tag: (child.text or "") for child in node}
    if "data" in fields:
        return _matrix({**fields, "data": fields["data"].split()})
    text = (node.text or "").strip()
    return text.strip('"')


def _size(nodes: Mapping[str, Any], number: int) -> tuple[float, float] | None:
    for suffix in (str(number), ""):
        if f"image_width{suffix}" in nodes and f"image_height{suffix}" in nodes:
            return float(nodes[f"image_width{suffix}"]), float(nodes[f"image_height{suffix}"])
    return None


def write(rig: Rig, name: str) -> dict[str, bytes]:
    """Return the file's content; a name that ends in .xml or .json is written as such."""
    right_from_left = require_two(rig, "opencv")
    ending = next((e for e in (".xml", ".json") if name.lower().endswith(e)), ".yml")
    storage = cv2.FileStorage(ending, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    for i, camera in enumerate(rig.cameras, start=1):
        storage.write(f"name{i}", camera.name)
        storage.write(f"image_width{i}", camera.width)
        storage.write(f"image_height{i}", camera.height)
        storage.write(f"M{i}", np.array(camera.calibration_matrix))
        storage.write(f"D{i}", padded(camera, max(5, len(camera.distortion)))[None])
    storage.write("length_unit", "mm")
    storage.write("R", np.array(right_from_left.rotation))
    storage.write("T", np.array(right_from_left.translation_mm)[:, None])
    return {name: storage.releaseAndGetString().encode("utf-8")}
