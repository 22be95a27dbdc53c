"""MATLAB's .mat files: stereoParameters as a struct, its OpenCV form, and Bouguet's toolbox.

``toStruct(stereoParams)`` holds K transposed, with the first pixel at (1, 1), and points as rows:
x₂ = x₁ RotationOfCamera2 + TranslationOfCamera2. ``stereoParametersToOpenCV`` (cameraMatrix1, …)
and Bouguet's toolbox (fc_left, …) count pixels from 0 and have x_right = R x_left + T.
MATLAB's own objects can only be read by MATLAB.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any, cast

import numpy as np

from pivometer.cameras import Camera, Rig
from pivometer.geometry.rigid import RigidTransform, rotation_from_vector
from pivometer.io.formats.conventions import (
    Told,
    brown_coefficients,
    camera_from,
    require_two,
    rig_from,
    size_in_px,
    transform_from,
    unit_in_mm,
    unreadable,
)


def recognise(content: bytes) -> bool:
    """Say whether a file is a .mat file."""
    return content.startswith(b"MATLAB ")


def read(files: Mapping[str, bytes], told: Told) -> Rig:
    """Read a rig of two cameras."""
    variables = _variables(next(iter(files.values())))
    structs = [v for v in variables.values() if isinstance(v, dict) and "CameraParameters1" in v]
    try:
        if structs:
            return _from_struct(structs[0], variables, told)
        if "cameraMatrix1" in variables:
            return _from_opencv(variables, told)
        if "fc_left" in variables:
            return _from_bouguet(variables, told)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise unreadable(f"its stereo parameters are incomplete: {error}") from error
    raise unreadable(
        f"holds {', '.join(list(variables)[:6]) or 'nothing that can be read'}, no stereo "
        "parameters",
        next_step="in MATLAB: s = toStruct(stereoParams); save('rig.mat', 's', '-v7')",
    )


def _variables(content: bytes) -> dict[str, Any]:
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadError

    if content.startswith(b"MATLAB 7.3"):
        raise unreadable("is of MATLAB's version 7.3", next_step="save it again with '-v7'")
    try:
        found: dict[str, Any] = loadmat(cast("Any", io.BytesIO(content)), simplify_cells=True)
    except (MatReadError, ValueError, TypeError, OSError, NotImplementedError) as error:
        raise unreadable(f"is a damaged .mat file: {error}") from error
    return {name: value for name, value in found.items() if not name.startswith("__")}


def _from_struct(struct: Mapping[str, Any], beside: Mapping[str, Any], told: Told) -> Rig:
    names = [str(name) for name in beside.get("camera_names", ("left", "right"))]
    cameras = [
        _struct_camera(name.strip(), struct[f"CameraParameters{i}"], told)
        for i, name in enumerate(names, start=1)
    ]
    stated = struct["CameraParameters1"].get("WorldUnits", struct.get("WorldUnits"))
    unit = unit_in_mm(None if stated is None else str(stated), told)
    R = np.asarray(struct["RotationOfCamera2"], dtype=np.float64).T
    pose = transform_from(R, struct["TranslationOfCamera2"], unit)
    return rig_from(cameras, [RigidTransform.identity(), pose])


def _struct_camera(name: str, parameters: Mapping[str, Any], told: Told) -> Camera:
    """K is transposed where it is called IntrinsicMatrix, not where it is called K (R2022b on)."""
    if "IntrinsicMatrix" in parameters:
        K = np.array(parameters["IntrinsicMatrix"], dtype=np.float64).T
    else:
        K = np.array(parameters["K"], dtype=np.float64)
    K[:2, 2] -= 1
    radial = np.append(np.ravel(parameters["RadialDistortion"]), [0.0, 0.0])
    p1, p2 = np.ravel(parameters["TangentialDistortion"])
    size = parameters.get("ImageSize")
    stated = None if size is None or np.size(size) != 2 else (size[1], size[0])
    lens = [radial[0], radial[1], p1, p2, radial[2]]
    return camera_from(name, size_in_px(stated, told), K, lens)


def _from_opencv(variables: Mapping[str, Any], told: Told) -> Rig:
    sizes = [variables.get("imageSize"), variables.get(f"imageSize{1}")]
    rows_columns = next((size for size in sizes if size is not None), None)
    stated = None if rows_columns is None else (rows_columns[1], rows_columns[0])
    cameras = [
        camera_from(
            name,
            size_in_px(stated, told),
            variables[f"cameraMatrix{i}"],
            variables[f"distCoeffs{i}"],
        )
        for i, name in enumerate(("left", "right"), start=1)
    ]
    units = variables.get("units")
    unit = unit_in_mm(None if units is None else str(units), told)
    shift = variables["t"] if "t" in variables else variables["T"]
    return rig_from(
        cameras, [RigidTransform.identity(), transform_from(variables["R"], shift, unit)]
    )


def _from_bouguet(variables: Mapping[str, Any], told: Told) -> Rig:
    size = size_in_px((variables["nx"], variables["ny"]), told)
    cameras = []
    for name in ("left", "right"):
        (fx, fy), (ox, oy) = variables[f"fc_{name}"], variables[f"cc_{name}"]
        K = [[fx, fx * variables.get(f"alpha_c_{name}", 0), ox], [0, fy, oy], [0, 0, 1]]
        cameras.append(camera_from(name, size, K, variables[f"kc_{name}"]))
    R = rotation_from_vector(np.asarray(variables["om"], dtype=np.float64))
    pose = transform_from(R, variables["T"], unit_in_mm("mm", told))
    return rig_from(cameras, [RigidTransform.identity(), pose])


def write(rig: Rig, name: str) -> dict[str, bytes]:
    """Return the file's content: a struct ``stereoParams``, and ``camera_names`` beside it."""
    from scipy.io import savemat

    right_from_left = require_two(rig, "matlab")
    struct: dict[str, Any] = {
        f"CameraParameters{i}": _camera_struct(camera) for i, camera in enumerate(rig.cameras, 1)
    }
    struct["RotationOfCamera2"] = right_from_left.rotation.T
    struct["TranslationOfCamera2"] = right_from_left.translation_mm[None]
    names = np.array([camera.name for camera in rig.cameras], dtype=object)
    stream = io.BytesIO()
    savemat(cast("Any", stream), {"stereoParams": struct, "camera_names": names})
    return {name: stream.getvalue()}


def _camera_struct(camera: Camera) -> dict[str, Any]:
    k1, k2, p1, p2, k3 = brown_coefficients(camera, "matlab")
    K = np.array(camera.calibration_matrix)
    K[:2, 2] += 1
    return {
        "IntrinsicMatrix": K.T,
        "RadialDistortion": np.array([[k1, k2, k3]]),
        "TangentialDistortion": np.array([[p1, p2]]),
        "ImageSize": np.array([[camera.height, camera.width]], dtype=np.float64),
        "WorldUnits": "millimeters",
    }
