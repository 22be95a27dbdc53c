"""ROS camera_info, one YAML file a camera; two cameras, lengths in metres.

A camera_info holds no pose. With the rectifying rotations R₁, R₂ and the right camera's projection
P₂ = K′ [1 | t′] the rectified points are x′_left = R₁ x_left and x′_right = R₂ x_right, which is
x′_left + t′, so right_from_left is (R₂ᵀ R₁, R₂ᵀ t′).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import yaml

from pivometer._arrays import Floats
from pivometer.cameras import Camera, Rig
from pivometer.cameras.distortion import MODELS
from pivometer.geometry.rigid import RigidTransform
from pivometer.io.formats.conventions import (
    Told,
    calibration_matrix,
    camera_from,
    padded,
    require_two,
    rig_from,
    transform_from,
    unit_in_mm,
    unreadable,
)

_MODELS = ("plumb_bob", "rational_polynomial")
_KEYS = {
    "camera_matrix": (3, 3),
    "rectification_matrix": (3, 3),
    "projection_matrix": (3, 4),
}


def recognise(content: bytes) -> bool:
    """Say whether a file is a camera_info."""
    return b"projection_matrix:" in content and b"distortion_model:" in content


def read(files: Mapping[str, bytes], told: Told) -> Rig:
    """Read a rig from the files of its two cameras."""
    infos = [_info(content) for content in files.values()]
    if len(infos) != 2:
        raise unreadable(
            f"{len(infos)} camera_info files; a rig needs those of two cameras",
            next_step="name a folder that holds the files of the left and the right camera",
        )
    infos.sort(key=lambda info: bool(info["projection_matrix"][:, 3].any()))
    left, right = infos
    if left["projection_matrix"][:, 3].any() or not right["projection_matrix"][:, 3].any():
        raise unreadable(
            "the cameras' projection_matrix do not say how far apart they are",
            next_step="calibrate both cameras together, so that one has a baseline in "
            "projection_matrix",
        )
    unit = unit_in_mm("m", told)
    rectified = right["projection_matrix"]
    shift = np.linalg.solve(rectified[:, :3], rectified[:, 3])
    R1, R2 = left["rectification_matrix"], right["rectification_matrix"]
    first, second = transform_from(R1, np.zeros(3), 1.0), transform_from(R2, np.zeros(3), 1.0)
    right_from_left = second.inverse() @ RigidTransform(np.eye(3), shift * unit) @ first
    return rig_from([_camera(info) for info in infos], [RigidTransform.identity(), right_from_left])


def _info(content: bytes) -> dict[str, Any]:
    try:
        info = dict(yaml.safe_load(content))
        for key, shape in _KEYS.items():
            info[key] = np.array(info[key]["data"], dtype=np.float64).reshape(shape)
        info["distortion"] = np.array(info["distortion_coefficients"]["data"], dtype=np.float64)
        info["size"] = int(info["image_width"]), int(info["image_height"])
        info["camera_name"] = str(info["camera_name"])
    except (yaml.YAMLError, KeyError, TypeError, ValueError) as error:
        raise unreadable(f"is a damaged camera_info: {error}") from error
    return info


def _camera(info: Mapping[str, Any]) -> Camera:
    model = info.get("distortion_model")
    if model not in _MODELS:
        raise unreadable(
            f"camera {info['camera_name']}: distortion model {model!r} is none of "
            + ", ".join(_MODELS),
            next_step="calibrate with one of these",
        )
    return camera_from(info["camera_name"], info["size"], info["camera_matrix"], info["distortion"])


def write(rig: Rig, name: str) -> dict[str, bytes]:  # noqa: ARG001 - the folder's
    """Return two files, named after the cameras."""
    right_from_left = require_two(rig, "ros")
    rectified = _rectifying(right_from_left)
    turns = rectified, rectified @ right_from_left.rotation.T
    focal = float(np.mean([camera.focal_px.mean() for camera in rig.cameras]))
    shift_m = turns[1] @ right_from_left.translation_mm / 1000
    files = {}
    for camera, turn, along in zip(rig.cameras, turns, (0.0, shift_m[0]), strict=True):
        projection = np.zeros((3, 4))
        middle = (camera.width - 1) / 2, (camera.height - 1) / 2
        projection[:, :3] = calibration_matrix(focal, focal, *middle)
        projection[0, 3] = focal * along
        files[f"{camera.name}.yaml"] = _text(camera, turn, projection)
    return files


def _rectifying(right_from_left: RigidTransform) -> Floats:
    """Return R₁, shape (3, 3): its x axis along the baseline, z near both optical axes."""
    centre = right_from_left.inverse().translation_mm
    across = centre / np.linalg.norm(centre)
    across = across if across[np.argmax(np.abs(across))] > 0 else -across
    ahead = right_from_left.rotation[2] + np.array([0.0, 0, 1])
    down = np.cross(ahead, across)
    if np.linalg.norm(down) < 1e-3:  # one camera looks at the other: any direction across will do
        down = np.cross(np.roll(across, 1) + np.array([0.1, 0, 0]), across)
    down = down / np.linalg.norm(down)
    return np.array([across, down, np.cross(across, down)])


def _text(camera: Camera, turn: Floats, projection: Floats) -> bytes:
    rational = len(camera.distortion) > MODELS["brown5"]
    lens = padded(camera, 8 if rational else 5)
    content = {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_name": camera.name,
        "camera_matrix": _matrix(camera.calibration_matrix),
        "distortion_model": _MODELS[rational],
        "distortion_coefficients": _matrix(lens[None]),
        "rectification_matrix": _matrix(turn),
        "projection_matrix": _matrix(projection),
    }
    text: str = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=1000)
    return text.encode("utf-8")


def _matrix(values: Floats) -> dict[str, Any]:
    rows, columns = values.shape
    return {"rows": rows, "cols": columns, "data": np.ravel(values).tolist()}
