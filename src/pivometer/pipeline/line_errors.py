"""What the instrument does to the centerlines of a measurement."""

from __future__ import annotations

import numpy as np

from pivometer._arrays import Floats
from pivometer.measurement import ImportedRig, Measurement
from pivometer.uncertainty import LineErrors, calibration_displacements
from pivometer.uncertainty.shading import shading_displacements


def line_errors(measurement: Measurement) -> LineErrors:
    """Return the errors of the centerlines near the least-squares point, source by source.

    Of an imported rig nothing is known of the calibration: its part is empty.
    """
    used, calibration = measurement.used, measurement.calibration
    point, edges = measurement.rcm.least_squares.point_mm, [pose.edges for pose in used]
    known: Floats = np.zeros((len(used), 3, 0))
    if not isinstance(calibration, ImportedRig):
        known = calibration_displacements(edges, calibration.rig, calibration.covariance, point)
    shaft, floor = measurement.shaft, measurement.floor
    return LineErrors(
        directions=np.stack([pose.centerline.direction for pose in used]),
        edges_mm2=np.stack([pose.centerline.position_covariance_mm2(point) for pose in used]),
        calibration_mm=known,
        shading_mm=shading_displacements(edges, calibration.rig, point),
        scatter=1.0 if shaft is None else shaft.scatter,
        floor_mm2=np.zeros(3) if floor is None else floor.at(calibration.rig, point),
    )


def line_points(measurement: Measurement) -> Floats:
    """Return a point on each centerline, shape (n, 3), mm, reference camera's frame."""
    return np.stack([pose.centerline.point_mm for pose in measurement.used])
