"""Factors against scipy's distributions, ellipsoids against drawing."""

import numpy as np
import pytest
from scipy import stats

from pivometer.errors import DegenerateGeometryError
from pivometer.uncertainty import (
    confidence_radius,
    coverage_factor,
    effective_degrees_of_freedom,
    lies_within,
    mahalanobis,
)

INFINITE = float("inf")


@pytest.mark.parametrize("degrees", [3, 37, 137, 1e4])
@pytest.mark.parametrize("coverage", [0.68, 0.95, 0.999])
def test_factors_are_the_quantiles(degrees, coverage):
    student = stats.t(degrees).ppf((1 + coverage) / 2)
    assert coverage_factor(degrees, coverage=coverage) == pytest.approx(student, rel=1e-9)
    fisher = np.sqrt(3 * stats.f(3, degrees).ppf(coverage))
    assert confidence_radius(degrees, coverage=coverage) == pytest.approx(fisher, rel=1e-9)


def test_known_covariances_have_normal_factors():
    assert coverage_factor(INFINITE) == pytest.approx(1.959964, abs=1e-6)
    assert confidence_radius(INFINITE) == pytest.approx(np.sqrt(stats.chi2(3).ppf(0.95)))
    assert confidence_radius(INFINITE, dimensions=1) == pytest.approx(coverage_factor(INFINITE))
    assert confidence_radius(1e9) == pytest.approx(confidence_radius(INFINITE), rel=1e-6)


def test_ellipsoid_holds_the_stated_part():
    random = np.random.default_rng(0)
    root = random.standard_normal((3, 3))
    points = random.standard_normal((2000, 3)) @ root.T
    inside = [
        lies_within(point, np.zeros(3), root @ root.T, degrees_of_freedom=INFINITE)
        for point in points
    ]
    low, high = stats.binom(2000, 0.95).ppf([1e-5, 1 - 1e-5])
    assert low <= sum(inside) <= high


def test_mahalanobis_does_not_depend_on_the_frame():
    random = np.random.default_rng(1)
    change, root = random.standard_normal((2, 3, 3))
    covariance, offset = root @ root.T, random.standard_normal(3)
    there = mahalanobis(change @ offset, np.zeros(3), change @ covariance @ change.T)
    assert mahalanobis(offset, np.zeros(3), covariance) == pytest.approx(there, rel=1e-9)


def test_a_flat_covariance_is_refused():
    with pytest.raises(DegenerateGeometryError, match="not positive definite"):
        mahalanobis([0, 0, 1], [0, 0, 0], np.diag([1.0, 1.0, 0.0]))


def test_degrees_of_freedom_lie_between_the_least_and_the_sum():
    assert effective_degrees_of_freedom([2.0, 0.0], [7, 3]) == pytest.approx(7)
    assert effective_degrees_of_freedom([0.0, 2.0], [7, INFINITE]) == INFINITE
    assert 7 < effective_degrees_of_freedom([1.0, 1.5], [7, 9]) <= 16
