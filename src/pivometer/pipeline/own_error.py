"""The robot's own error, from everything that a measurement rests on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pivometer.errors import DataError
from pivometer.measurement import ImportedRig, Measurement
from pivometer.pipeline.displacements import displacements_mm
from pivometer.rcm import Finding
from pivometer.uncertainty import IntrinsicError, intrinsic_error


def own_error(measurement: Measurement) -> IntrinsicError:
    """Return the robot's own error of a measurement, as measured now or read from a file.

    The instrument's part comes from the fitted edges of each pose, each independent of the others,
    and from the calibration, which all poses share.

    Raises
    ------
    ShapeError
        If no centerline has an uncertainty.
    DataError
        If the rig was imported: then the calibration's part is unknown.
    """
    used, common = measurement.used, displacements_mm(measurement)
    if common is None:
        raise DataError(
            "the rig was imported without its uncertainty, so the instrument's part of the misses "
            "is unknown",
            next_step="calibrate with board images of this session, or give a guard band",
        )
    point = measurement.rcm.least_squares.point_mm
    return intrinsic_error(
        np.stack([pose.centerline.point_mm for pose in used]),
        np.stack([pose.centerline.direction for pose in used]),
        np.stack([pose.centerline.position_covariance_mm2(point) for pose in used]),
        common_mm=common,
    )


def with_own_error(measurement: Measurement) -> Measurement:
    """Return a measurement that states the robot's own error, if its lines have an uncertainty.

    With an imported rig it is not stated: what the instrument adds is unknown.
    """
    if isinstance(measurement.calibration, ImportedRig) or not any(
        pose.centerline.covariance.any() for pose in measurement.used
    ):
        return measurement
    intrinsic = own_error(measurement)
    findings = measurement.findings
    if intrinsic.noise_overstated:
        findings += (
            Finding(
                "warning",
                f"the lines miss the RCM by less ({measurement.rcm.least_squares.rms_mm:.2g} mm "
                "rms) than the noise stated for their edges explains "
                f"({intrinsic.instrument_rms_mm:.2g} mm)",
                "do not rely on the robot's own error here: its noise is overstated",
            ),
        )
    return replace(measurement, intrinsic=intrinsic, findings=findings)
