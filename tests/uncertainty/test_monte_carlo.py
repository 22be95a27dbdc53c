"""Drawing the whole chain, against the linear propagation where that must hold."""

from dataclasses import dataclass

import numpy as np
import pytest

from pivometer.uncertainty import LineErrors, location_uncertainty
from pivometer.uncertainty.carried_edges import lines_of, thinned_points
from pivometer.uncertainty.monte_carlo import chain, summary

RCM_MM = np.array([6.4, 65.7, 478.3])
DRAWS = 300


@dataclass
class Edges:
    camera: str
    points_px: np.ndarray
    normals_covariance: np.ndarray


def chained(view, rig, covariance, *, normals_rad=0.0, miss_mm=0.05, floor_mm=0.0):
    edges = [
        [Edges(e.camera, e.points_px, normals_rad**2 * np.eye(6)) for e in pose]
        for pose in view(20, miss_mm=miss_mm)
    ]
    linear = location_uncertainty(edges, rig, covariance)
    _, axes = lines_of(thinned_points(edges, [c.name for c in rig.cameras]), rig)
    none = np.zeros((20, 3, 0))
    errors = LineErrors(axes, np.zeros((20, 3, 3)), none, none, floor_mm2=np.full(3, floor_mm**2))
    return chain(edges, rig, covariance, linear, errors), linear


def test_small_errors_spread_as_the_linear_propagation_says(view, rig, rig_covariance):
    way, linear = chained(view, rig, 0.01 * rig_covariance)
    found = summary(way.drawn(DRAWS, np.random.default_rng(1)), linear, seed=1)
    assert found.linear_holds
    np.testing.assert_allclose(found.linear_ratio, 1, atol=4 / np.sqrt(2 * DRAWS))
    u = np.sqrt(linear.total_mm2.diagonal())
    means = np.array([found.x.mean_mm, found.y.mean_mm, found.z.mean_mm])
    # 20 poses that miss by 0.05 mm: the point itself is off by its scatter
    assert (np.abs(means - RCM_MM) < 4 * u).all()
    assert found.x.interval_mm[0] < found.x.mean_mm < found.x.interval_mm[1]
    assert np.diff(found.x.interval_mm)[0] == pytest.approx(2 * 1.96 * u[0], rel=0.15)


def test_noise_of_the_edges_pushes_the_misses_up(view, rig, rig_covariance):
    way, linear = chained(view, rig, 1e-6 * rig_covariance, normals_rad=5e-5, miss_mm=0.0)
    found = summary(way.drawn(200, np.random.default_rng(2)), linear, seed=2)
    assert found.rms.mean_mm > 0.005
    assert found.max.mean_mm > found.rms.mean_mm


def test_the_floor_is_in_the_misses_and_only_once_in_the_location(view, rig, rig_covariance):
    way, linear = chained(view, rig, 1e-6 * rig_covariance, miss_mm=0.0, floor_mm=0.01)
    found = summary(way.drawn(200, np.random.default_rng(5)), linear, seed=5)
    expected = 0.01 * np.sqrt(37 / 20)  # of 2n components, 3 go into the point
    assert found.rms.mean_mm == pytest.approx(expected, rel=4 / np.sqrt(2 * 37 * 200))


def test_draws_that_spread_otherwise_than_the_linear_propagation_are_told(
    view, rig, rig_covariance
):
    _, linear = chained(view, rig, rig_covariance)
    u = np.sqrt(linear.total_mm2.diagonal())
    for factor, holds in ((1.0, True), (1.3, False), (0.7, False)):
        draws = np.random.default_rng(3).normal(1.0, 0.1, (5000, 5))
        draws[:, :3] = RCM_MM + factor * u * np.random.default_rng(4).standard_normal((5000, 3))
        assert summary(draws, linear, seed=3).linear_holds == holds


def test_draws_depend_on_the_seed_only(view, rig, rig_covariance):
    way, _ = chained(view, rig, rig_covariance)
    a, b = (way.drawn(5, np.random.default_rng(4)) for _ in range(2))
    np.testing.assert_array_equal(a, b)
