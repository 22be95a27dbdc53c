"""The remote center of motion of a set of lines: minimax (2)–(3), least squares, and robust."""

from pivometer.rcm.cone import cone_deg
from pivometer.rcm.geometry_check import geometry_findings, refuse_geometry
from pivometer.rcm.least_squares import least_squares_rcm
from pivometer.rcm.minimax import minimax_rcm
from pivometer.rcm.pivot import PivotCalibration, calibrate_pivot, pivot_findings
from pivometer.rcm.result import Finding, LeastSquaresRcm, MinimaxRcm, RcmSolution
from pivometer.rcm.robust import (
    LeastDistanceRcm,
    TrimmedRcm,
    least_distance_rcm,
    outlier_findings,
    trimmed_rcm,
)
from pivometer.rcm.solution import solve

__all__ = [
    "Finding",
    "LeastDistanceRcm",
    "LeastSquaresRcm",
    "MinimaxRcm",
    "PivotCalibration",
    "RcmSolution",
    "TrimmedRcm",
    "calibrate_pivot",
    "cone_deg",
    "geometry_findings",
    "least_distance_rcm",
    "least_squares_rcm",
    "minimax_rcm",
    "outlier_findings",
    "pivot_findings",
    "refuse_geometry",
    "solve",
    "trimmed_rcm",
]
