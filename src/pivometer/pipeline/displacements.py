"""What the calibration moves each line of a measurement by, which several results rest on."""

from __future__ import annotations

from functools import lru_cache

from pivometer._arrays import Floats, read_only
from pivometer.calibration import Calibration
from pivometer.measurement import ImportedRig, Measurement
from pivometer.shaft.edges import ShaftEdges
from pivometer.uncertainty import calibration_displacements


def displacements_mm(measurement: Measurement) -> Floats | None:
    """Return what `calibration_displacements` says at the least-squares point, shape (n, 3, r), mm.

    `None` with an imported rig, whose uncertainty is unknown.
    """
    calibration = measurement.calibration
    if isinstance(calibration, ImportedRig):
        return None
    point = tuple(measurement.rcm.least_squares.point_mm.tolist())
    return _displacements(tuple(pose.edges for pose in measurement.used), calibration, point)


@lru_cache(maxsize=1)
def _displacements(
    edges: tuple[tuple[ShaftEdges, ...], ...],
    calibration: Calibration,
    point_mm: tuple[float, float, float],
) -> Floats:
    """Ask only once: the weighted point, the robot's own error and the structure follow each other.

    Edges and calibration never change, so they are compared by identity.
    """
    return read_only(
        calibration_displacements(edges, calibration.rig, calibration.covariance, point_mm)
    )
