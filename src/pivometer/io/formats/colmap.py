"""COLMAP's text model: cameras.txt, and images.txt with one image, a pose, for each camera.

The centre of the first pixel is (0.5, 0.5) there; x_camera = R(q) x_world + t. The scale of a
COLMAP model is arbitrary, so the unit must be told; our own files state mm in a comment.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import PurePosixPath

import numpy as np

from pivometer.cameras import Camera, Rig
from pivometer.geometry.rigid import RigidTransform
from pivometer.io.formats.conventions import (
    Told,
    calibration_matrix,
    camera_from,
    padded,
    rig_from,
    transform_from,
    unit_in_mm,
    unreadable,
)

_PARAMETERS = {
    "SIMPLE_PINHOLE": "f cx cy",
    "PINHOLE": "fx fy cx cy",
    "SIMPLE_RADIAL": "f cx cy k1",
    "RADIAL": "f cx cy k1 k2",
    "OPENCV": "fx fy cx cy k1 k2 p1 p2",
    "FULL_OPENCV": "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6",
}
_CAMERA = re.compile(r"^\s*\d+ [A-Z][A-Z_0-9]* \d+ \d+( [-+.\deE]+){3,}\s*$", re.MULTILINE)
_IMAGE = re.compile(r"^\s*\d+( [-+.\deE]+){7} \d+ \S.*$", re.MULTILINE)
_UNIT = re.compile(r"^#\s*unit:\s*(\w+)", re.MULTILINE)
_SUFFIXES = {".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp"}


def recognise(content: bytes) -> bool:
    """Say whether a file is a cameras.txt or an images.txt."""
    text = content[:100_000].decode("utf-8", errors="replace")
    return bool(_CAMERA.search(text) or _IMAGE.search(text))


def read(files: Mapping[str, bytes], told: Told) -> Rig:
    """Read a rig from both files."""
    texts = [content.decode("utf-8", errors="replace") for content in files.values()]
    text = "\n".join(texts)
    lenses = {line.split()[0]: line.split()[1:] for line in _matches(_CAMERA, text)}
    images = [line for each in texts if not _CAMERA.search(each) for line in _images(each)]
    if not lenses or not images:
        raise unreadable(
            f"describes {len(lenses)} cameras and the poses of {len(images)} images",
            next_step="name the folder that holds both cameras.txt and images.txt",
        )
    unit = _UNIT.search(text)
    scale = unit_in_mm(unit.group(1) if unit else None, told)
    cameras, poses = {}, []
    for _, *numbers, lens, name in sorted(images, key=lambda image: int(image[0])):
        camera = _camera_name(name)
        if camera in cameras or lens not in lenses:
            raise unreadable(
                f"image {name} is one of several of camera {camera}, or has no camera {lens}: "
                "poses of a moving camera are no rig",
                next_step="export a model with one image for each camera",
            )
        cameras[camera] = _camera(camera, lenses[lens])
        poses.append(_pose([float(number) for number in numbers], scale))
    return rig_from(list(cameras.values()), poses)


def _matches(pattern: re.Pattern[str], text: str) -> list[str]:
    return [match.group(0).strip() for match in pattern.finditer(text)]


def _images(text: str) -> list[list[str]]:
    """Return the fields of every image; the line after each holds its points, or nothing."""
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    first = next((i for i, line in enumerate(lines) if line.strip()), len(lines))
    return [line.split() for line in lines[first::2] if line.strip()]


def _camera_name(image: str) -> str:
    """Return the folder of an image, which is the camera's in a COLMAP rig, or its stem."""
    path = PurePosixPath(image)
    if len(path.parts) > 1:
        return path.parts[-2]
    return path.stem if path.suffix.lower() in _SUFFIXES else path.name


def _camera(name: str, fields: list[str]) -> Camera:
    model, width, height, *values = fields
    if model not in _PARAMETERS:
        raise unreadable(
            f"camera {name}: model {model}; Pivometer reads {', '.join(_PARAMETERS)}",
            next_step="run COLMAP with one of these",
        )
    names = _PARAMETERS[model].split()
    if len(names) != len(values):
        raise unreadable(f"camera {name}: {len(values)} parameters, {model} has {len(names)}")
    given = dict(zip(names, map(float, values), strict=True))
    fx, fy = given.get("fx", given.get("f", 0.0)), given.get("fy", given.get("f", 0.0))
    K = calibration_matrix(fx, fy, given["cx"] - 0.5, given["cy"] - 0.5)
    lens = [given.get(k, 0.0) for k in ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")]
    return camera_from(name, (int(width), int(height)), K, lens)


def _pose(numbers: list[float], scale: float) -> RigidTransform:
    from scipy.spatial.transform import Rotation

    w, x, y, z, *shift = numbers
    if abs(w * w + x * x + y * y + z * z - 1) > 1e-3:
        raise unreadable("a quaternion of images.txt does not have length 1")
    return transform_from(Rotation.from_quat([x, y, z, w]).as_matrix(), shift, scale)


def write(rig: Rig, name: str) -> dict[str, bytes]:  # noqa: ARG001 - the folder's
    """Return cameras.txt, images.txt and an empty points3D.txt, which COLMAP wants to see."""
    from scipy.spatial.transform import Rotation

    cameras = ["# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"]
    images = ["# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME", "# unit: mm"]
    for i, (camera, pose) in enumerate(zip(rig.cameras, rig.reference_from_camera, strict=True), 1):
        model = _narrowest(camera)
        lens = padded(camera, 8)[: len(_PARAMETERS[model].split()) - 4]
        numbers = [*camera.focal_px, *(camera.principal_point_px + 0.5), *lens]
        cameras.append(f"{i} {model} {camera.width} {camera.height} {_line(numbers)}")
        camera_from_world = pose.inverse()
        x, y, z, w = Rotation.from_matrix(camera_from_world.rotation).as_quat()
        numbers = [w, x, y, z, *camera_from_world.translation_mm]
        images += [f"{i} {_line(numbers)} {i} {camera.name}/rig.png", ""]
    return {
        "cameras.txt": ("\n".join(cameras) + "\n").encode("utf-8"),
        "images.txt": ("\n".join(images) + "\n").encode("utf-8"),
        "points3D.txt": b"# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[]\n",
    }


def _narrowest(camera: Camera) -> str:
    lens = padded(camera, 8)
    if not lens.any():
        return "PINHOLE"
    return "FULL_OPENCV" if lens[4:].any() else "OPENCV"


def _line(numbers: list[float]) -> str:
    return " ".join(repr(float(number)) for number in np.asarray(numbers, dtype=np.float64))
