"""Generalized least squares: against dense algebra, against the truth, and what it cannot hide."""

import numpy as np
import pytest
from scipy import stats
from scipy.linalg import block_diag

from pivometer.errors import ShapeError
from pivometer.geometry import distances_to_lines
from pivometer.rcm import least_squares_rcm, weighted_rcm

RCM_MM = np.array([6.4, 65.7, 478.3])


def known_lines(random, count, *, own=0.0, stretched=0.0, common=None):
    """Lines through the RCM but for the stated errors; a part of them is known badly one way."""
    axes = random.normal([0, 0, 2], 0.6, (count, 3))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    roots = 0.02 * random.uniform(0.5, 2, (count, 3))[:, :, None] * np.eye(3)
    bad = random.random(count) < 0.3
    roots[bad, 0, 0] += stretched
    shared = np.zeros((count, 3, 0)) if common is None else common(axes)
    errors = (roots @ random.standard_normal((count, 3, 1)))[..., 0]
    errors = errors + own * random.standard_normal((count, 3))
    errors = errors + shared @ random.standard_normal(shared.shape[2])
    points = RCM_MM + errors + random.uniform(-100, 100, (count, 1)) * axes
    return points, axes, roots @ np.swapaxes(roots, 1, 2), shared


def turning(axes):
    """A common shift in all directions, and a common turn of the rig about each axis."""
    turn = np.cross(np.eye(3)[:, None], 50 * axes).transpose(1, 2, 0)
    return np.concatenate([np.tile(0.3 * np.eye(3), (len(axes), 1, 1)), 1e-3 * turn], axis=2)


def dense(points, axes, covariances, shared, own):
    """The textbook's formula with the whole covariance matrix."""
    bases = [np.linalg.svd(axis[None])[2][1:] for axis in axes]
    rows = np.concatenate(bases)
    values = np.concatenate([b @ p for b, p in zip(bases, points, strict=True)])
    along = np.concatenate([b @ k for b, k in zip(bases, shared, strict=True)])
    whole = block_diag(*(b @ s @ b.T for b, s in zip(bases, covariances, strict=True)))
    whole = whole + own**2 * np.eye(len(rows)) + along @ along.T
    inverse = np.linalg.inv(whole)
    covariance = np.linalg.inv(rows.T @ inverse @ rows)
    point = covariance @ rows.T @ inverse @ values
    misses = values - rows @ point
    plain = np.linalg.inv(rows.T @ rows) @ rows.T
    difference = covariance @ rows.T @ inverse - plain
    return point, covariance, misses @ inverse @ misses, difference @ whole @ difference.T


@pytest.mark.parametrize("common", [None, turning])
@pytest.mark.parametrize("own", [0.0, 0.1])
def test_agrees_with_dense_algebra(common, own):
    random = np.random.default_rng(1)
    for count in (4, 9, 30):
        points, axes, covariances, shared = known_lines(
            random, count, own=own, stretched=0.5, common=common
        )
        found = weighted_rcm(points, axes, covariances, common_mm=shared)
        point, covariance, squares, shift = dense(points, axes, covariances, shared, found.own_mm)
        np.testing.assert_allclose(found.point_mm, point, atol=1e-9)
        np.testing.assert_allclose(found.covariance_mm2, covariance, rtol=1e-6, atol=1e-12)
        np.testing.assert_allclose(found.shift_covariance_mm2, shift, rtol=1e-5, atol=1e-12)
        freedom = 2 * count - 3
        assert squares == pytest.approx(freedom, rel=1e-6) if found.own_mm else squares <= freedom
        np.testing.assert_allclose(
            found.distances_mm, distances_to_lines(found.point_mm, points, axes), atol=1e-9
        )
        plain = least_squares_rcm(points, axes)
        np.testing.assert_allclose(found.shift_mm, found.point_mm - plain.point_mm, atol=1e-9)


def test_equal_covariances_give_least_squares():
    random = np.random.default_rng(2)
    points, axes, _, _ = known_lines(random, 20, own=0.1)
    found = weighted_rcm(points, axes, np.tile(0.01 * np.eye(3), (20, 1, 1)))
    plain = least_squares_rcm(points, axes)
    np.testing.assert_allclose(found.point_mm, plain.point_mm, atol=1e-11)
    # s² is instrument plus own, whatever their parts are.
    np.testing.assert_allclose(found.covariance_mm2, plain.covariance_mm2, rtol=1e-9)
    np.testing.assert_allclose(found.shares, 1 / 20)


def test_lines_that_are_known_badly_hardly_count():
    """With 30 % of the lines 2 mm off in one direction the weights gain an order of magnitude."""
    random = np.random.default_rng(3)
    off = []
    for _ in range(60):
        points, axes, covariances, _ = known_lines(random, 70, stretched=2.0)
        off.append(
            (
                weighted_rcm(points, axes, covariances).point_mm - RCM_MM,
                least_squares_rcm(points, axes).point_mm - RCM_MM,
            )
        )
    weighted, plain = np.sqrt(np.mean(np.square(off), axis=(0, 2)))
    assert weighted < plain / 6


@pytest.mark.parametrize(
    ("own", "stretched", "common"), [(0.0, 1.0, None), (0.1, 1.0, None), (0.05, 0.5, turning)]
)
def test_stated_covariances_are_the_scatter(own, stretched, common):
    """Of the point and of its shift: normalized squares over 300 sessions have χ²'s mean."""
    random = np.random.default_rng(4)
    trials = 300
    point, shift, owns = [], [], []
    for _ in range(trials):
        points, axes, covariances, shared = known_lines(
            random, 40, own=own, stretched=stretched, common=common
        )
        found = weighted_rcm(points, axes, covariances, common_mm=shared)
        error = found.point_mm - RCM_MM
        point.append(error @ np.linalg.solve(found.covariance_mm2, error))
        moved = np.linalg.solve(found.shift_covariance_mm2, found.shift_mm)
        shift.append(found.shift_mm @ moved)
        owns.append(found.own_mm**2)
    # Of 77 degrees of freedom s² scatters, so F with 3 and 77, whose mean is 77/75; four standard
    # deviations of the mean of 300.
    law = stats.f(3, 77)
    for squares in (point, shift):
        mean = np.mean(squares) / 3
        assert abs(mean - law.mean()) < 4 * law.std() / np.sqrt(trials)
    if own:
        assert np.mean(owns) == pytest.approx(own**2, abs=4 * np.std(owns) / np.sqrt(trials))


def test_weights_hide_no_error():
    """A line that counts for nothing misses by all it misses."""
    random = np.random.default_rng(5)
    points, axes, covariances, _ = known_lines(random, 20)
    points[7] += [3.0, 0, 0]
    covariances[7] = 100.0**2 * np.eye(3)
    found = weighted_rcm(points, axes, covariances)
    assert found.shares[7] < 1e-4
    assert found.max_mm == found.distances_mm[7]
    assert found.max_mm > 2.0


def test_lines_without_uncertainty_are_refused():
    random = np.random.default_rng(6)
    points, axes, covariances, _ = known_lines(random, 8)
    covariances[5] = np.outer(axes[5], axes[5])  # known but along the line
    with pytest.raises(ShapeError, match=r"1 of 8 lines have no uncertainty.*line 5"):
        weighted_rcm(points, axes, covariances)
    with pytest.raises(ShapeError, match="covariances_mm2"):
        weighted_rcm(points, axes, covariances[:7])
