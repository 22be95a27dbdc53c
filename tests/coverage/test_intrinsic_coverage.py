"""Stated 95 % intervals of the robot's own error hold the truth in 95 % of simulated measurements.

The bounds are binomial, as in `test_rcm_coverage`. Fields: none, independent misses, a structured
one (an arm whose axes do not meet), and heavy-tailed misses; with an error that all lines share.
"""

import numpy as np
import pytest
from scipy import stats

from pivometer.rcm import solve
from pivometer.uncertainty import intrinsic_error

NOISE_MM = 0.0255
TRIALS = 500


def cone(random, count):
    tilt = np.radians(28.5) * np.sqrt(random.random(count))
    turn = 2 * np.pi * random.random(count)
    return np.stack(
        [np.sin(tilt) * np.cos(turn), -np.cos(tilt), np.sin(tilt) * np.sin(turn)], axis=1
    )


def structured(axes, _):
    """Misses that depend on the direction only: two tilt axes that pass each other."""
    x, _, z = axes.T
    return np.stack([3 * z**2 - 0.5 * x, 0 * x, x * z + 0.4 * x], axis=1)


FIELDS = {
    "none": lambda axes, _: np.zeros_like(axes),
    "independent": lambda axes, random: random.standard_normal(axes.shape),
    "structured": structured,
    "heavy tails": lambda axes, random: random.standard_t(3, axes.shape),
}


def simulated(field, rms_mm, count, random):
    """True lines of a given rms, their covariances, shared sources, and one noisy measurement."""
    axes = cone(random, count)
    misses = FIELDS[field](axes, random)
    size = solve(misses, axes).least_squares.rms_mm
    points = misses * (rms_mm / size if size > 0 else 0)
    sigma = NOISE_MM * random.uniform(0.6, 1.6, count)  # per line and component
    covariances = sigma[:, None, None] ** 2 * np.eye(3)
    # Sources that move all lines: a shift, which does no harm, and bends that vary with direction,
    # of the 0.001–0.003 mm rms that a calibration adds.
    common = np.stack([np.ones((count, 3)), 0.006 * axes**2, 0.006 * axes[:, [1, 2, 0]]], axis=2)
    return points, axes, covariances, common


def measured(points, sigma2, common, random):
    noise = np.sqrt(sigma2[:, 0, 0])[:, None] * random.standard_normal(points.shape)
    return points + noise + common @ random.standard_normal(common.shape[2])


def bounds(trials, probability=0.95):
    return stats.binom(trials, probability).ppf([2.5e-5, 1 - 2.5e-5])


@pytest.mark.parametrize("rms_mm", [0.0126, 0.0502])
@pytest.mark.parametrize("field", FIELDS)
def test_intervals_hold_the_robots_own_error(field, rms_mm):
    random = np.random.default_rng([*field.encode(), int(1e4 * rms_mm)])
    points, axes, covariances, common = simulated(field, rms_mm, 40, random)
    truth = solve(points, axes)
    in_rms = in_max = 0
    for _ in range(TRIALS):
        seen = measured(points, covariances, common, random)
        found = intrinsic_error(seen, axes, covariances, common_mm=common)
        low, high = found.rms_interval_mm
        in_rms += low <= truth.least_squares.rms_mm <= high
        low, high = found.max_interval_mm
        in_max += low <= truth.minimax.max_mm <= high
    fewest, most = bounds(TRIALS)
    if field == "none":  # the lower end is then zero or wrong, and the upper is never too low
        fewest, most = bounds(TRIALS, 0.975)
    assert fewest <= in_rms <= most
    assert in_max >= bounds(TRIALS)[0]  # conservative by construction
