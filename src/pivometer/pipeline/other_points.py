"""The RCM points beside the paper's two, from everything that a measurement rests on."""

from __future__ import annotations

from dataclasses import replace

from pivometer.measurement import ImportedRig, Measurement
from pivometer.pipeline.line_errors import line_points
from pivometer.rcm import weighting_findings, with_other_points
from pivometer.uncertainty import LineErrors


def with_all_points(measurement: Measurement, errors: LineErrors) -> Measurement:
    """Return a measurement that states the robust points and, if it can, the weighted one.

    The weighted point needs the covariance of every line. The calibration's part is in it unless
    the rig was imported, which leaves that part unknown.
    """
    weighable = errors.edges_mm2.any(axis=(1, 2)).all()
    imported = isinstance(measurement.calibration, ImportedRig)
    rcm = with_other_points(
        measurement.rcm,
        line_points(measurement),
        errors.directions,
        covariances_mm2=errors.stated().alone_mm2 if weighable else None,
        common_mm=errors.common_mm if weighable and not imported else None,
    )
    findings = () if rcm.weighted is None else weighting_findings(rcm.weighted)
    return replace(measurement, rcm=rcm, findings=measurement.findings + findings)
