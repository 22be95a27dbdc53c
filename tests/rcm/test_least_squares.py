"""The least-squares point against its normal equations, and its covariance."""

import numpy as np
import pytest

from pivometer.errors import ShapeError
from pivometer.geometry import distances_to_lines
from pivometer.rcm import least_squares_rcm, solve


def information(axes):
    return len(axes) * np.eye(3) - axes.T @ axes


def test_solves_the_normal_equations(gold):
    points, axes = gold()
    projectors = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    expected = np.linalg.solve(projectors.sum(axis=0), np.einsum("nij,nj->i", projectors, points))
    rcm = least_squares_rcm(points, axes)
    np.testing.assert_allclose(rcm.point_mm, expected, atol=1e-11)
    distances = distances_to_lines(rcm.point_mm, points, axes)
    np.testing.assert_allclose(rcm.distances_mm, distances, atol=1e-12)
    assert rcm.rms_mm == pytest.approx(np.sqrt(np.mean(distances**2)), rel=1e-12)
    assert rcm.max_mm == pytest.approx(distances.max(), rel=1e-12)


def test_covariance_is_the_scatter_over_two_n_less_three(gold):
    points, axes = gold(10)
    rcm = least_squares_rcm(points, axes)
    variance = np.sum(rcm.distances_mm**2) / 17
    np.testing.assert_allclose(
        rcm.covariance_mm2, variance * np.linalg.inv(information(axes)), rtol=1e-12, atol=1e-16
    )


def test_given_covariances_replace_the_scatter(gold):
    points, axes = gold(10)
    same = np.tile(0.04 * np.eye(3), (10, 1, 1))
    rcm = least_squares_rcm(points, axes, covariances_mm2=same)
    expected = 0.04 * np.linalg.inv(information(axes))
    np.testing.assert_allclose(rcm.covariance_mm2, expected, rtol=1e-12, atol=1e-16)
    along = same + 9 * axes[:, :, None] * axes[:, None, :]  # along the line nothing counts
    moved = least_squares_rcm(points, axes, covariances_mm2=along)
    np.testing.assert_allclose(moved.covariance_mm2, expected, rtol=1e-9, atol=1e-12)


def test_covariances_must_match_the_lines(gold):
    with pytest.raises(ShapeError, match="9 covariances for 10 lines"):
        least_squares_rcm(*gold(10), covariances_mm2=np.zeros((9, 3, 3)))


def test_points_far_along_the_lines_change_nothing_but_rounding(gold):
    points, axes = gold()
    far = points + 1e6 * np.random.default_rng(0).uniform(-1, 1, (70, 1)) * axes
    # A direction rounded to 1e-16 moves a line by 1e-10 mm over 1e6 mm.
    difference = least_squares_rcm(far, axes).point_mm - least_squares_rcm(points, axes).point_mm
    assert np.abs(difference).max() < 1e-9


def test_symmetric_sets_have_one_point_others_two(gold):
    turn = np.arange(12) * np.pi / 6
    axes = np.stack([np.cos(turn), np.sin(turn), np.ones(12)], axis=1)
    across = np.stack([-np.sin(turn), np.cos(turn), 0 * turn], axis=1)
    assert solve(0.3 * across, axes).separation_mm < 1e-13
    usual = solve(*gold())
    assert usual.separation_mm == pytest.approx(
        np.linalg.norm(usual.minimax.point_mm - usual.least_squares.point_mm)
    )
    assert usual.separation_mm > 0.1 * usual.least_squares.rms_mm
    assert usual.minimax.max_mm < usual.least_squares.max_mm
    assert usual.minimax.rms_mm > usual.least_squares.rms_mm
