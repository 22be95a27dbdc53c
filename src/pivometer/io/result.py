"""The files Pivometer writes: ``rig.json``, ``result.json``, ``centerlines.csv``; and reads again.

The names in the files are those of `Calibration` and `Measurement`.
"""

import csv
import hashlib
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pivometer.calibration import Calibration
from pivometer.errors import UsageError
from pivometer.io.codec import json_text, jsonable, read_json, typed
from pivometer.measurement import ImportedRig, Measurement
from pivometer.uncertainty.floor import InstrumentFloor

RESULT_SCHEMA = "pivometer/result/1"
RIG_SCHEMA = "pivometer/rig/1"

POSE_NAMES = ("pose", "status", "reason", "next_step", "centerline", "distance_mm", "dihedral_deg")
"""What every pose states, used or rejected, in this order; `null` where it has none."""

_COLUMNS = (
    "pose",
    *(f"point_{axis}_mm" for axis in "xyz"),
    *(f"direction_{axis}" for axis in "xyz"),
    "distance_minimax_mm",
    "distance_least_squares_mm",
    "dihedral_deg",
    *(f"cov_{pair}_mm2" for pair in ("xx", "xy", "xz", "yy", "yz", "zz")),
)


SEAL = "sha256"
"""Last name of a ``result.json``: SHA-256 of its text as it is without this name."""


def result_content(measurement: Measurement) -> dict[str, Any]:
    """Return the content of ``result.json``: what `Measurement` holds, under the same names.

    Raises
    ------
    DataError
        If a number is not finite.
    """
    content = jsonable(measurement)
    content["poses"] = [dict.fromkeys(POSE_NAMES) | pose for pose in content["poses"]]
    stated = {
        "schema": RESULT_SCHEMA,
        "software": content.pop("software"),
        "reference_camera": measurement.reference_camera,
        **content,
    }
    return stated | {SEAL: seal_of(stated)}


def seal_of(content: Mapping[str, Any]) -> str:
    """Return the SHA-256 that a result with this content states, whatever it does state.

    Examples
    --------
    >>> seal_of({"a": 0.1, "sha256": "anything"}) == seal_of({"a": 0.1})
    True
    """
    stated = {name: entry for name, entry in content.items() if name != SEAL}
    return hashlib.sha256(text_of(stated).encode()).hexdigest()


def text_of(content: Mapping[str, Any]) -> str:
    """Return the text of a file with this content: the same content is always the same bytes."""
    return json_text(dict(content)) + "\n"


def result_text(measurement: Measurement) -> str:
    """Return the text of ``result.json``."""
    return text_of(result_content(measurement))


def rig_text(calibration: Calibration | ImportedRig, *, software: str) -> str:
    """Return the text of ``rig.json``: a calibration with the observations behind it."""
    content = {
        "schema": RIG_SCHEMA,
        "software": software,
        "reference_camera": calibration.rig.reference,
        "calibration": jsonable(calibration),
    }
    return json_text(content) + "\n"


def centerlines_csv(measurement: Measurement) -> str:
    """Return the centerlines of the used poses as CSV with a heading, mm, reference camera's frame.

    The point is the foot of the perpendicular from the reference camera's centre; the covariance is
    that of the line's position where it passes the least-squares point, from its edges alone. Every
    number has its full precision.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_COLUMNS)
    upper = np.triu_indices(3)
    for pose in measurement.used:
        covariance = pose.centerline.position_covariance_mm2(measurement.rcm.least_squares.point_mm)
        numbers = [
            *pose.centerline.point_mm.tolist(),
            *pose.centerline.direction.tolist(),
            pose.distance_mm.minimax,
            pose.distance_mm.least_squares,
            pose.dihedral_deg,
            *covariance[upper].tolist(),
        ]
        writer.writerow([pose.pose, *(repr(float(number)) for number in numbers)])
    return text.getvalue()


def read_rig(path: Path | str) -> Calibration | ImportedRig:
    """Read the calibration, or the imported rig, in a ``rig.json`` or a ``result.json``.

    Parameters
    ----------
    path
        A file that ``pivometer calibrate`` or ``pivometer measure`` wrote.

    Raises
    ------
    UsageError
        If the file is not one of them, or is damaged; the message says where.
    """
    content = _content(Path(path), (RIG_SCHEMA, RESULT_SCHEMA))
    kind = Calibration | ImportedRig
    calibration: Calibration | ImportedRig = _typed(
        kind, content.get("calibration"), "calibration", path
    )
    return calibration


def read_result(path: Path | str) -> Measurement:
    """Read a ``result.json``.

    Raises
    ------
    UsageError
        If the file is not a result, or is damaged; the message says where.
    """
    return measurement_in(_content(Path(path), (RESULT_SCHEMA,)), path)


def read_floor(path: Path | str) -> InstrumentFloor:
    """Read the instrument's floor in the ``result.json`` of a gold standard.

    Raises
    ------
    UsageError
        If the file is not a result, is damaged, or is not of a gold standard.
    """
    floor = read_result(path).gold_standard
    if floor is None:
        raise UsageError(
            "is the result of a session that was not measured as a gold standard",
            next_step="measure it with pivometer measure --gold-standard",
            path=Path(path),
        )
    return floor


def measurement_in(content: object, path: Path | str) -> Measurement:
    """Return the measurement that the content of a ``result.json`` states.

    Raises
    ------
    UsageError
        If it states none; the message names `path`.
    """
    measurement: Measurement = _typed(Measurement, content, "", path)
    return measurement


def _content(path: Path, schemas: tuple[str, ...]) -> dict[str, Any]:
    """Return the content of a JSON file that states one of `schemas`."""
    content = read_json(path)
    stated = content.get("schema") if isinstance(content, dict) else None
    if stated in schemas:
        return dict(content)
    family, _, version = str(stated).rpartition("/")
    if any(family == known.rpartition("/")[0] for known in schemas):
        raise UsageError(
            f"has version {version} of its format; this Pivometer reads version 1",
            next_step="update Pivometer",
            path=path,
        )
    name = schemas[0].split("/")[1]
    raise UsageError(
        f"is not a {name} file: its schema is {stated!r}, not {schemas[0]!r}",
        next_step=f"name the {name}.json that Pivometer wrote into SESSION/results",
        path=path,
    )


def _typed(kind: Any, content: object, where: str, path: Path | str) -> Any:
    """Return typed content; what is wrong with it names the file."""
    try:
        return typed(kind, content, where)
    except UsageError as error:
        raise UsageError(error.what, next_step=error.next_step, path=path) from error
