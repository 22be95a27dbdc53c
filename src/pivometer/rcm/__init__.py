"""The remote center of motion of lines: minimax (2)–(3), least squares, weighted, and robust."""

from pivometer.rcm.cone import cone_deg
from pivometer.rcm.geometry_check import geometry_findings, refuse_geometry
from pivometer.rcm.instrument_axis import InstrumentAxis, estimate_axis, with_recording
from pivometer.rcm.least_squares import least_squares_rcm
from pivometer.rcm.minimax import minimax_rcm
from pivometer.rcm.pivot import PivotCalibration, calibrate_pivot, pivot_findings
from pivometer.rcm.result import (
    Finding,
    LeastDistanceRcm,
    LeastSquaresRcm,
    MinimaxRcm,
    RcmSolution,
    TrimmedRcm,
    WeightedRcm,
)
from pivometer.rcm.robust import least_distance_rcm, outlier_findings
from pivometer.rcm.solution import solve, with_other_points
from pivometer.rcm.trimmed import trimmed_rcm
from pivometer.rcm.weighted import weighted_rcm, weighting_findings

__all__ = [
    "Finding",
    "InstrumentAxis",
    "LeastDistanceRcm",
    "LeastSquaresRcm",
    "MinimaxRcm",
    "PivotCalibration",
    "RcmSolution",
    "TrimmedRcm",
    "WeightedRcm",
    "calibrate_pivot",
    "cone_deg",
    "estimate_axis",
    "geometry_findings",
    "least_distance_rcm",
    "least_squares_rcm",
    "minimax_rcm",
    "outlier_findings",
    "pivot_findings",
    "refuse_geometry",
    "solve",
    "trimmed_rcm",
    "weighted_rcm",
    "weighting_findings",
    "with_other_points",
    "with_recording",
]
