"""The robot's own error: exact traces, invariances, limits."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from pivometer.errors import ShapeError
from pivometer.geometry import RigidTransform
from pivometer.rcm import solve
from pivometer.rcm.lines import centred_lines
from pivometer.rcm.minimax import content
from pivometer.uncertainty import intrinsic_error
from pivometer.uncertainty.intrinsic import _own_squares, _traces, _turned


def lines(random, count=12, miss_mm=0.1):
    axes = random.normal([0, 0, 2], 1, (count, 3))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    return [3, -2, 400] + miss_mm * random.standard_normal((count, 3)) + 20 * axes, axes


def covariances(random, count=12):
    roots = 0.03 * random.standard_normal((count, 3, 3))
    return roots @ np.swapaxes(roots, 1, 2)


def test_traces_are_those_of_the_whole_matrices():
    random = np.random.default_rng(1)
    points, axes = lines(random)
    given_covariances = covariances(random)
    common = 0.02 * random.standard_normal((12, 3, 5))
    projectors = np.eye(3) - axes[:, :, None] * axes[:, None]
    T = projectors.reshape(-1, 3)
    whole = np.zeros((36, 36))
    across = np.zeros((36, 36))
    for i, (projector, covariance) in enumerate(zip(projectors, given_covariances, strict=True)):
        at = slice(3 * i, 3 * i + 3)
        whole[at, at] = projector @ covariance @ projector
        across[at, at] = projector
    shared = across @ common.reshape(36, 5)
    R = across - T @ np.linalg.inv(projectors.sum(axis=0)) @ T.T
    RS = R @ (whole + shared @ shared.T)
    centred = centred_lines(points, axes)
    found = _traces(centred, _turned(centred, given_covariances, common))
    assert found == pytest.approx((np.trace(RS), np.trace(RS @ RS)), rel=1e-11)


@pytest.mark.parametrize("freedom", [17.0, 137.0])
@pytest.mark.parametrize("parameter", [40.0, 3e3, 3e6])
def test_with_equal_noise_the_noncentral_distribution_is_inverted(freedom, parameter):
    """Two moments are matched; the third differs, by a fiftieth of the interval at most."""
    sigma = np.sqrt(2 * freedom + 4 * parameter)
    for probability in (0.025, 0.5, 0.975):
        value = stats.ncx2.ppf(probability, freedom, parameter)
        found = _own_squares(value, freedom, freedom, 1.0, probability)
        assert abs(found - parameter) < 4 * sigma / 50
    assert _own_squares(0.1 * freedom, freedom, freedom, 1.0, 0.025) == 0


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.floats(1e-3, 1e3))
def test_frame_order_and_scale_do_not_matter(seed, scale):
    random = np.random.default_rng(seed)
    points, axes = lines(random)
    spread, common = covariances(random), 0.02 * random.standard_normal((12, 3, 4))
    before = intrinsic_error(points, axes, spread, common_mm=common)
    motion = RigidTransform.from_rotation_vector(random.standard_normal(3), [50, -20, 7])
    R, order = motion.rotation, random.permutation(12)
    after = intrinsic_error(
        scale * (motion @ points)[order],
        -motion.rotate(axes)[order],
        scale**2 * (R @ spread @ R.T)[order],
        common_mm=scale * (R @ common)[order],
    )
    assert after.rms_mm == pytest.approx(scale * before.rms_mm, rel=1e-6, abs=1e-7 * scale)
    for name in ("rms_interval_mm", "max_interval_mm"):
        wanted = scale * getattr(before, name)
        assert getattr(after, name) == pytest.approx(wanted, rel=1e-6, abs=1e-7 * scale)


def test_a_perfect_instrument_leaves_what_was_seen():
    points, axes = lines(np.random.default_rng(2))
    seen = solve(points, axes)
    found = intrinsic_error(points, axes, np.tile(1e-14 * np.eye(3), (12, 1, 1)))
    assert found.rms_mm == pytest.approx(seen.least_squares.rms_mm, rel=1e-9)
    assert found.rms_interval_mm == pytest.approx([seen.least_squares.rms_mm] * 2, rel=1e-4)
    assert found.max_interval_mm == pytest.approx([seen.minimax.max_mm] * 2, rel=1e-4)
    assert not found.noise_overstated


def test_noise_that_is_stated_ten_times_too_large_is_noticed():
    points, axes = lines(np.random.default_rng(3))
    found = intrinsic_error(points, axes, np.tile(np.eye(3), (12, 1, 1)))
    assert found.rms_mm == 0
    assert found.noise_overstated
    assert found.max_interval_mm[0] == 0


def test_a_shift_of_all_lines_is_no_error_of_the_robot():
    points, axes = lines(np.random.default_rng(4))
    spread = np.tile(1e-4 * np.eye(3), (12, 1, 1))
    shift = np.tile(5 * np.eye(3), (12, 1, 1))
    plain, shifted = (
        intrinsic_error(points, axes, spread, common_mm=common) for common in (None, shift)
    )
    assert shifted.rms_interval_mm == pytest.approx(plain.rms_interval_mm, rel=1e-9)
    assert shifted.max_interval_mm == pytest.approx(plain.max_interval_mm, rel=1e-9)


def test_lines_without_uncertainty_are_refused():
    points, axes = lines(np.random.default_rng(5))
    with pytest.raises(ShapeError, match="no line has an uncertainty"):
        intrinsic_error(points, axes, np.zeros((12, 3, 3)))


def test_content_of_few_poses_and_many():
    assert content(3) == 0
    assert content(4) == pytest.approx(1 - 0.95**0.25)  # all four of four poses are within
    assert content(100_000) > 0.9999


def test_content_holds_for_heavy_tails():
    """Of 1000 campaigns of 20 poses at most 5 % may fall short; 6.9 % is their limit by chance."""
    random = np.random.default_rng(6)
    stated, short = content(20), 0
    trials = 300
    _, fresh_axes = lines(random, 2000)
    for _ in range(trials):
        _, axes = lines(random, 20)
        found = solve(random.standard_t(2, (20, 3)), axes).minimax
        misses = random.standard_t(2, (2000, 3)) - found.point_mm
        misses -= np.vecdot(misses, fresh_axes)[:, None] * fresh_axes
        short += np.mean(np.linalg.norm(misses, axis=1) <= found.max_mm) < stated
    assert short <= stats.binom(trials, 0.05).ppf(1 - 2.5e-5)
