"""The RCM points beside the paper's two, from everything that a measurement rests on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pivometer.measurement import Measurement
from pivometer.pipeline.displacements import displacements_mm
from pivometer.rcm import weighting_findings, with_other_points


def with_all_points(measurement: Measurement) -> Measurement:
    """Return a measurement that states the robust points and, if it can, the weighted one.

    The weighted point needs the covariance of every line. The calibration's part is in it unless
    the rig was imported, which leaves that part unknown.
    """
    used = measurement.used
    point = measurement.rcm.least_squares.point_mm
    covariances, common = None, None
    if all(pose.centerline.covariance.any() for pose in used):
        covariances = [pose.centerline.position_covariance_mm2(point) for pose in used]
        common = displacements_mm(measurement)
    rcm = with_other_points(
        measurement.rcm,
        np.stack([pose.centerline.point_mm for pose in used]),
        np.stack([pose.centerline.direction for pose in used]),
        covariances_mm2=covariances,
        common_mm=common,
    )
    findings = () if rcm.weighted is None else weighting_findings(rcm.weighted)
    return replace(measurement, rcm=rcm, findings=measurement.findings + findings)
