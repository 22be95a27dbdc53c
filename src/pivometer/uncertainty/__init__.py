"""How far the RCM's location can be trusted: propagation and coverage."""

from pivometer.uncertainty.coverage import (
    confidence_radius,
    coverage_factor,
    effective_degrees_of_freedom,
    lies_within,
    mahalanobis,
)
from pivometer.uncertainty.propagation import (
    LocationUncertainty,
    jacobian_by_differences,
    location_uncertainty,
)

__all__ = [
    "LocationUncertainty",
    "confidence_radius",
    "coverage_factor",
    "effective_degrees_of_freedom",
    "jacobian_by_differences",
    "lies_within",
    "location_uncertainty",
    "mahalanobis",
]
