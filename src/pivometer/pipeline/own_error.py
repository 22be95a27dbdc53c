"""The robot's own error, from everything that a measurement rests on."""

from __future__ import annotations

from dataclasses import replace

from pivometer.errors import DataError
from pivometer.measurement import ImportedRig, Measurement
from pivometer.pipeline.line_errors import line_errors, line_points
from pivometer.rcm import Finding
from pivometer.uncertainty import IntrinsicError, LineErrors, intrinsic_error


def own_error(measurement: Measurement, errors: LineErrors | None = None) -> IntrinsicError:
    """Return the robot's own error of a measurement, as measured now or read from a file.

    The instrument's part comes from the fitted edges of each pose, each independent of the others,
    and from the calibration, which all poses share; and from a gold standard, if there is one.

    Parameters
    ----------
    measurement
        What was measured.
    errors
        What the instrument does to its lines, where that is known already.

    Raises
    ------
    ShapeError
        If no centerline has an uncertainty.
    DataError
        If the rig was imported: then the calibration's part is unknown.
    """
    if isinstance(measurement.calibration, ImportedRig):
        raise DataError(
            "the rig was imported without its uncertainty, so the instrument's part of the misses "
            "is unknown",
            next_step="calibrate with board images of this session, or give a guard band",
        )
    errors = errors or line_errors(measurement)
    stated = errors.stated()
    return intrinsic_error(
        line_points(measurement),
        errors.directions,
        stated.alone_mm2,
        common_mm=stated.common_mm,
        possible=errors.possible(),
    )


def with_own_error(measurement: Measurement, errors: LineErrors | None = None) -> Measurement:
    """Return a measurement that states the robot's own error, if its lines have an uncertainty.

    With an imported rig it is not stated: what the instrument adds is unknown.
    """
    if isinstance(measurement.calibration, ImportedRig) or not any(
        pose.centerline.covariance.any() for pose in measurement.used
    ):
        return measurement
    intrinsic = own_error(measurement, errors)
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
