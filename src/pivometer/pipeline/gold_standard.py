"""The instrument's own floor: a measurement of a joint that is known to turn about one point."""

from __future__ import annotations

from dataclasses import replace

from pivometer.errors import UsageError
from pivometer.measurement import ImportedRig, Measurement
from pivometer.pipeline.line_errors import line_points
from pivometer.rcm import Finding
from pivometer.uncertainty import LineErrors
from pivometer.uncertainty.floor import instrument_floor


def with_gold_standard(
    measurement: Measurement, errors: LineErrors, bearing_rms_mm: float
) -> Measurement:
    """Return a measurement of a gold standard that states the instrument's floor.

    Parameters
    ----------
    measurement
        Of a spherical bearing, or another joint that turns about one point.
    errors
        What the instrument is stated to do to the lines.
    bearing_rms_mm
        Rms miss of the joint itself, mm; 0 if it is taken for perfect.

    Raises
    ------
    UsageError
        If the rig was imported, so that what the calibration explains is unknown; or the joint is
        said to miss by more than was seen.
    TooFewPosesError
        If there are fewer than ten poses.
    """
    if isinstance(measurement.calibration, ImportedRig):
        raise UsageError(
            "the rig was imported without its uncertainty, so what of the misses it explains is "
            "unknown",
            next_step="calibrate with board images of this session",
        )
    floor = instrument_floor(
        line_points(measurement),
        errors,
        measurement.calibration.rig,
        max_mm=measurement.rcm.minimax.max_mm,
        session=measurement.setup.session,
        bearing_rms_mm=bearing_rms_mm,
    )
    findings = measurement.findings
    if bearing_rms_mm == 0:
        findings += (_TAKEN_FOR_PERFECT,)
    return replace(measurement, gold_standard=floor, findings=findings)


_TAKEN_FOR_PERFECT = Finding(
    "warning",
    "the gold standard is taken for perfect: what the joint itself misses by counts as the "
    "instrument's, and will be taken off the error of robots",
    "state what it misses by itself, from its data sheet: --bearing-rms-mm",
)
