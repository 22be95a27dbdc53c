"""mrcal's .cameramodel, one text file a camera; by mrcal's convention lengths are metres.

``extrinsics``, called ``rt_cam_ref`` by later versions, is a rotation vector and a translation with
x_camera = R x_reference + t. Pixels count as ours do. ``rt_ref_cam`` is the inverse.
"""

from __future__ import annotations

import ast
from collections.abc import Mapping
from pathlib import PurePath
from typing import Any

import numpy as np

from pivometer.cameras import Camera, Rig
from pivometer.geometry.rigid import RigidTransform
from pivometer.io.formats.conventions import (
    Told,
    calibration_matrix,
    camera_from,
    padded,
    rig_from,
    unit_in_mm,
    unreadable,
)

_COUNTS = {
    "LENSMODEL_PINHOLE": 0,
    "LENSMODEL_OPENCV4": 4,
    "LENSMODEL_OPENCV5": 5,
    "LENSMODEL_OPENCV8": 8,
    "LENSMODEL_OPENCV12": 12,
}
_FROM_REFERENCE = ("extrinsics", "rt_cam_ref", "rt_fromref")
_TO_REFERENCE = ("rt_ref_cam", "rt_toref")


def recognise(content: bytes) -> bool:
    """Say whether a file is a .cameramodel."""
    return b"LENSMODEL_" in content and b"imagersize" in content


def read(files: Mapping[str, bytes], told: Told) -> Rig:
    """Read a rig from the files of its cameras, which name them; one at the reference is first."""
    unit = unit_in_mm("m", told)
    models = [_model(name, content, unit) for name, content in sorted(files.items())]
    models.sort(key=lambda model: bool(np.abs(model[1].translation_mm).max() > 0))
    return rig_from([camera for camera, _ in models], [pose for _, pose in models])


def _model(file: str, content: bytes, unit: float) -> tuple[Camera, RigidTransform]:
    name = PurePath(file).stem
    try:
        model: dict[str, Any] = dict(ast.literal_eval(content.decode("utf-8").strip()))
        lens, size = str(model["lensmodel"]), model["imagersize"]
        values = np.array(model["intrinsics"], dtype=np.float64)
        if lens not in _COUNTS:
            raise unreadable(
                f"camera {name}: {lens}; Pivometer reads {', '.join(_COUNTS)}",
                next_step="convert it with mrcal-convert-lensmodel",
            )
        fx, fy, ox, oy = values[:4]
        if len(values) != 4 + _COUNTS[lens]:
            raise unreadable(f"camera {name}: {len(values)} intrinsics do not make a {lens}")
        K = calibration_matrix(fx, fy, ox, oy)
        camera = camera_from(name, (int(size[0]), int(size[1])), K, values[4:])
        return camera, _pose(model, unit, name)
    except (SyntaxError, ValueError, TypeError, KeyError, IndexError) as error:
        if isinstance(error, KeyError):
            raise unreadable(f"camera {name} has no {error.args[0]}") from error
        raise unreadable(f"{file} is a damaged .cameramodel: {error}") from error


def _pose(model: Mapping[str, Any], unit: float, name: str) -> RigidTransform:
    """Return ``camera_from_reference``."""
    for key in (*_FROM_REFERENCE, *_TO_REFERENCE):
        if key in model:
            rt = np.array(model[key], dtype=np.float64)
            pose = RigidTransform.from_rotation_vector(rt[:3], rt[3:] * unit)
            return pose.inverse() if key in _TO_REFERENCE else pose
    raise unreadable(f"camera {name} has no extrinsics")


def write(rig: Rig, name: str) -> dict[str, bytes]:  # noqa: ARG001 - the folder's
    """Return one file for each camera."""
    files = {}
    for camera, pose in zip(rig.cameras, rig.reference_from_camera, strict=True):
        count = next(n for n in (0, 5, 8) if n >= len(camera.distortion))
        lens = next(model for model, n in _COUNTS.items() if n == count)
        camera_from_reference = pose.inverse()
        rt = [
            *camera_from_reference.rotation_vector_rad(),
            *(camera_from_reference.translation_mm / 1000),
        ]
        numbers = [*camera.focal_px, *camera.principal_point_px, *padded(camera, count)]
        lines = [
            f"    'lensmodel':  '{lens}',",
            f"    'intrinsics': [ {_line(numbers)} ],",
            f"    'extrinsics': [ {_line(rt)} ],",
            f"    'imagersize': [ {camera.width}, {camera.height} ],",
        ]
        files[f"{camera.name}.cameramodel"] = "\n".join(["{", *lines, "}", ""]).encode("utf-8")
    return files


def _line(numbers: list[float]) -> str:
    return ", ".join(repr(float(number)) for number in numbers)
