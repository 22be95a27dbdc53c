"""How far the RCM's location can be trusted: propagation and coverage."""

from pivometer.uncertainty.coverage import (
    confidence_radius,
    coverage_factor,
    effective_degrees_of_freedom,
    lies_within,
    mahalanobis,
)
from pivometer.uncertainty.decision import Decision, guarded_decision, variance_ratio_limit
from pivometer.uncertainty.intrinsic import IntrinsicError, intrinsic_error
from pivometer.uncertainty.line_errors import LineErrors, Noise
from pivometer.uncertainty.propagation import (
    LinesUncertainty,
    LocationUncertainty,
    calibration_displacements,
    jacobian_by_differences,
    lines_uncertainty,
    location_uncertainty,
)

__all__ = [
    "Decision",
    "IntrinsicError",
    "LineErrors",
    "LinesUncertainty",
    "LocationUncertainty",
    "Noise",
    "calibration_displacements",
    "confidence_radius",
    "coverage_factor",
    "effective_degrees_of_freedom",
    "guarded_decision",
    "intrinsic_error",
    "jacobian_by_differences",
    "lies_within",
    "lines_uncertainty",
    "location_uncertainty",
    "mahalanobis",
    "variance_ratio_limit",
]
