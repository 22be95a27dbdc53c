"""The frames of a video do not pretend to be as many poses."""

import numpy as np
from scipy.stats import binom

from pivometer.rcm import least_squares_rcm
from pivometer.uncertainty import lies_within
from pivometer.uncertainty.sequence import scatter, sequence_findings


def lines(random, count, alike):
    """A tool that wanders through a cone and misses the origin alike from frame to frame."""
    misses, tilts = np.zeros((count, 3)), np.zeros((count, 2))
    for values, step in ((misses, 0.1), (tilts, 0.3)):
        noise = step * random.standard_normal(values.shape)
        values[0] = noise[0]
        for i in range(1, count):
            values[i] = alike * values[i - 1] + np.sqrt(1 - alike**2) * noise[i]
    axes = np.column_stack([tilts, np.ones(count)])
    return misses, axes / np.linalg.norm(axes, axis=1)[:, None]


def test_a_video_states_an_uncertainty_that_holds():
    """Of 95 % regions at least 88 % must hold; those of s² N⁻¹ hold in under half of the cases."""
    random, trials = np.random.default_rng(4), 200
    held, naive = 0, 0
    for _ in range(trials):
        points, axes = lines(random, 400, 0.9)
        rcm = least_squares_rcm(points, axes)
        told = scatter(rcm, points, axes)
        assert told.independent_poses < 60  # (1 − ρ)/(1 + ρ) of 400 are 21
        held += lies_within(
            np.zeros(3),
            rcm.point_mm,
            told.covariance_mm2,
            degrees_of_freedom=told.degrees_of_freedom,
        )
        naive += lies_within(np.zeros(3), rcm.point_mm, rcm.covariance_mm2, degrees_of_freedom=797)
    assert held >= binom.ppf(1e-3, trials, 0.88)
    assert naive < trials / 2


def test_independent_poses_keep_all_their_worth():
    random, trials, alarms = np.random.default_rng(5), 400, 0
    for _ in range(trials):
        points, axes = lines(random, 40, 0.0)
        rcm = least_squares_rcm(points, axes)
        told = scatter(rcm, points, axes)
        if told.independent_poses < 40:
            alarms += 1
        else:
            np.testing.assert_array_equal(told.covariance_mm2, rcm.covariance_mm2)
            assert told.degrees_of_freedom == 77
    assert alarms <= binom.ppf(1 - 1e-4, trials, 5e-4)


def test_a_few_poses_are_not_judged():
    points, axes = lines(np.random.default_rng(6), 12, 0.95)
    assert scatter(least_squares_rcm(points, axes), points, axes).independent_poses == 12


def test_the_finding_says_what_to_do():
    (finding,) = sequence_findings(900, 31.4)
    assert "900 poses tell as much as 31 independent ones" in finding.text
    assert "not along a path" in finding.next_step
    assert sequence_findings(70, None) == ()
