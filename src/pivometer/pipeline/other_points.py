"""The RCM points beside the paper's two, from everything that a measurement rests on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pivometer._arrays import Floats
from pivometer.measurement import ImportedRig, Measurement
from pivometer.pipeline.line_errors import line_points
from pivometer.rcm import weighting_findings, with_other_points
from pivometer.uncertainty import LineErrors, calibration_displacements


def with_all_points(measurement: Measurement, errors: LineErrors) -> Measurement:
    """Return a measurement that states the robust points and, if it can, the weighted one.

    The weighted point needs the covariance of every line. The calibration's part is in it unless
    the rig was imported, which leaves that part unknown.
    """
    weighable = bool(errors.edges_mm2.any(axis=(1, 2)).all())
    rcm = with_other_points(
        measurement.rcm,
        line_points(measurement),
        errors.directions,
        covariances_mm2=errors.stated().alone_mm2 if weighable else None,
        common_mm=_common(measurement, errors) if weighable else None,
    )
    findings = () if rcm.weighted is None else weighting_findings(rcm.weighted)
    return replace(measurement, rcm=rcm, findings=measurement.findings + findings)


def _common(measurement: Measurement, errors: LineErrors) -> Floats | None:
    """Return what moves all lines alike, free of what they miss; nothing is known if imported."""
    calibration = measurement.calibration
    if isinstance(calibration, ImportedRig):
        return None
    known = calibration_displacements(
        [pose.edges for pose in measurement.used],
        calibration.rig,
        calibration.covariance,
        measurement.rcm.least_squares.point_mm,
        of_misses=False,
    )
    return np.concatenate([known, errors.shading_mm], axis=2)
