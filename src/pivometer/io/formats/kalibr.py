"""Kalibr's camchain: one YAML file, lengths in metres, x_n = T_cn_cnm1 x_(n−1) along the chain."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import yaml

from pivometer.cameras import Camera, Rig
from pivometer.geometry.rigid import RigidTransform
from pivometer.io.formats.conventions import (
    Told,
    brown_coefficients,
    calibration_matrix,
    camera_from,
    inexpressible,
    rig_from,
    transform_from,
    unit_in_mm,
    unreadable,
)


def recognise(content: bytes) -> bool:
    """Say whether a file is a camchain."""
    return b"cam0:" in content and b"camera_model:" in content and b"intrinsics:" in content


def read(files: Mapping[str, bytes], told: Told) -> Rig:
    """Read a rig; cameras are named after their ROS topics, where those differ."""
    unit = unit_in_mm("m", told)
    (content,) = list(files.values())[:1]
    try:
        chain = {key: entry for key, entry in yaml.safe_load(content).items() if key[:3] == "cam"}
        chain = dict(sorted(chain.items(), key=lambda item: int(item[0][3:])))
        names = _names(chain)
        cameras = [_camera(n, entry) for n, entry in zip(names, chain.values(), strict=True)]
        poses = [RigidTransform.identity()]
        for entry in list(chain.values())[1:]:
            T = np.array(entry["T_cn_cnm1"], dtype=np.float64).reshape(4, 4)
            poses.append(transform_from(T[:3, :3], T[:3, 3], unit) @ poses[-1])
    except (yaml.YAMLError, AttributeError, KeyError, TypeError, ValueError) as error:
        if isinstance(error, KeyError):
            raise unreadable(f"a camera has no {error.args[0]}") from error
        raise unreadable(f"is a damaged camchain: {error}") from error
    return rig_from(cameras, poses)


def _names(chain: Mapping[str, Any]) -> list[str]:
    """Return the first words of the topics, such as /left/image_raw, or else cam0, cam1 and on."""
    topics = [str(entry.get("rostopic", "")).strip("/").split("/")[0] for entry in chain.values()]
    return topics if all(topics) and len(set(topics)) == len(topics) else list(chain)


def _camera(name: str, entry: Mapping[str, Any]) -> Camera:
    kind, lens = entry["camera_model"], entry["distortion_model"]
    if kind != "pinhole" or lens not in ("radtan", "none"):
        raise unreadable(
            f"camera {name}: model {kind}-{lens}; Pivometer reads pinhole-radtan",
            next_step="calibrate with --models pinhole-radtan",
        )
    fx, fy, ox, oy = map(float, entry["intrinsics"])
    size = int(entry["resolution"][0]), int(entry["resolution"][1])
    coefficients = entry["distortion_coeffs"] if lens == "radtan" else []
    return camera_from(name, size, calibration_matrix(fx, fy, ox, oy), coefficients)


def write(rig: Rig, name: str) -> dict[str, bytes]:
    """Return the file's content."""
    chain: dict[str, Any] = {}
    for i, (camera, pose) in enumerate(zip(rig.cameras, rig.reference_from_camera, strict=True)):
        lens = brown_coefficients(camera, "kalibr")
        if lens[4] != 0:
            raise inexpressible(
                "kalibr", f"k3 of camera {camera.name}", "opencv, ros, matlab, colmap or mrcal"
            )
        entry: dict[str, Any] = {}
        if i > 0:
            now_from_before = pose.inverse() @ rig.reference_from_camera[i - 1]
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = now_from_before.rotation, now_from_before.translation_mm / 1000
            entry["T_cn_cnm1"] = T.tolist()
        entry |= {
            "cam_overlaps": [j for j in range(len(rig.cameras)) if j != i],
            "camera_model": "pinhole",
            "distortion_coeffs": lens[:4].tolist(),
            "distortion_model": "radtan",
            "intrinsics": [*camera.focal_px.tolist(), *camera.principal_point_px.tolist()],
            "resolution": [camera.width, camera.height],
            "rostopic": f"/{camera.name}/image_raw",
        }
        chain[f"cam{i}"] = entry
    text: str = yaml.safe_dump(chain, sort_keys=False, default_flow_style=None, width=1000)
    return {name: text.encode("utf-8")}
