"""OpenCV's FileStorage, YAML, XML or JSON, as its stereo calibration sample writes it.

K as ``M1``, ``M2`` (or ``K1``, ``cameraMatrix1``), coefficients as ``D1``, ``D2`` (or
``distCoeffs1``), and ``R``, ``T`` with x_right = R x_left + T; in one file, or intrinsics and
extrinsics in two. The sample states neither the unit of T nor the image size. Our own files do, and
the cameras' names, under names that OpenCV passes over.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np

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
            nodes.get(f"name{i}", ("left", "right")[i - 1]),
            size_in_px(_size(nodes, i), told),
            nodes[f"{matrix}{i}"],
            nodes.get(f"{lens}{i}", np.zeros(0)),
        )
        for i in (1, 2)
    ]
    unit = unit_in_mm(nodes.get("length_unit"), told)
    right_from_left = transform_from(nodes["R"], nodes["T"], unit)
    return rig_from(cameras, [RigidTransform.identity(), right_from_left])


def _nodes(content: bytes) -> dict[str, Any]:
    """Return matrices, numbers and strings by name."""
    try:
        flags = cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY
        storage = cv2.FileStorage(content.decode("utf-8"), flags)
        names = storage.root().keys()
    except (cv2.error, UnicodeDecodeError, SystemError) as error:
        raise unreadable(f"is a damaged FileStorage ({type(error).__name__})") from error
    return {name: _value(storage.getNode(name)) for name in names}


def _value(node: cv2.FileNode) -> Any:
    if node.isString():
        return node.string()
    if node.isInt() or node.isReal():
        return node.real()
    return node.mat() if node.isMap() else None


def _size(nodes: Mapping[str, Any], number: int) -> tuple[float, float] | None:
    for suffix in (str(number), ""):
        if f"image_width{suffix}" in nodes and f"image_height{suffix}" in nodes:
            return nodes[f"image_width{suffix}"], nodes[f"image_height{suffix}"]
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
