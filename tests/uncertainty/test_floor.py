"""The instrument's floor: it holds what was put in, and is refused where it does not belong."""

import numpy as np
import pytest
from scipy import stats

from pivometer.cameras import Camera, Rig
from pivometer.errors import TooFewPosesError, UsageError
from pivometer.rcm import solve
from pivometer.uncertainty import LineErrors, intrinsic_error
from pivometer.uncertainty.floor import instrument_floor, pixel_mm

RCM_MM = np.array([6.4, 65.7, 478.3])
EDGES_MM, EXCESS_MM = 0.010, 0.015


def lines(random, count):
    tilt, turn = np.radians(28.5) * np.sqrt(random.random(count)), 2 * np.pi * random.random(count)
    axes = np.stack(
        [np.sin(tilt) * np.cos(turn), -np.cos(tilt), np.sin(tilt) * np.sin(turn)], axis=1
    )
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    none = np.zeros((count, 3, 0))
    return axes, LineErrors(axes, EDGES_MM**2 * across, none, none)


def seen(random, errors, extra_mm=EXCESS_MM):
    noise = np.hypot(EDGES_MM, extra_mm) * random.standard_normal(errors.directions.shape)
    return RCM_MM + noise


def floor(points, errors, rig, **options):
    return instrument_floor(points, errors, rig, max_mm=0.05, session="bearing", **options)


def test_its_interval_holds_the_excess(rig):
    random, held, trials = np.random.default_rng(3), 0, 400
    estimates = []
    for _ in range(trials):
        _, errors = lines(random, 30)
        found = floor(seen(random, errors), errors, rig)
        estimates.append(found.excess_mm2[0])
        held += found.excess_mm2[1] <= EXCESS_MM**2 <= found.excess_mm2[2]
    fewest, most = stats.binom(trials, 0.95).ppf([2.5e-5, 1 - 2.5e-5])
    assert fewest <= held <= most
    spread = np.hypot(EDGES_MM, EXCESS_MM) ** 2 * np.sqrt(2 / 57)
    assert abs(np.mean(estimates) - EXCESS_MM**2) < 4 * spread / np.sqrt(trials)


def test_with_it_the_intervals_of_a_robot_hold_where_without_it_they_fail(rig):
    """Noise that nobody stated reads as the robot's; a gold standard tells it from that."""
    random, trials, robot_mm = np.random.default_rng(4), 120, 0.02
    held = {"without": 0, "with": 0}
    for _ in range(trials):
        _, errors = lines(random, 40)
        gold = floor(seen(random, errors), errors, rig)
        axes, errors = lines(random, 60)
        own = robot_mm * random.standard_normal(axes.shape)
        truth = solve(RCM_MM + own, axes).least_squares.rms_mm
        points = seen(random, errors) + own
        known = LineErrors(
            axes,
            errors.edges_mm2,
            errors.calibration_mm,
            errors.shading_mm,
            floor_mm2=gold.at(rig, RCM_MM),
        )
        for name, one in (("without", errors), ("with", known)):
            found = intrinsic_error(points, axes, one.stated().alone_mm2, possible=one.possible())
            low, high = found.rms_interval_mm
            held[name] += low <= truth <= high
    fewest = stats.binom(trials, 0.95).ppf(2.5e-5)
    assert held["with"] >= fewest
    assert held["without"] < 0.5 * trials


def test_the_joints_own_error_is_not_the_instruments(rig):
    random = np.random.default_rng(5)
    _, errors = lines(random, 60)
    points = seen(random, errors)
    perfect, stated = (floor(points, errors, rig, bearing_rms_mm=b) for b in (0.0, 0.01))
    taken = perfect.excess_mm2[0] - stated.excess_mm2[0]
    assert taken == pytest.approx(0.01**2 * 60 / 117)
    assert stated.excess_mm2[2] == perfect.excess_mm2[2]  # it may be perfect all the same
    with pytest.raises(UsageError, match=r"said to miss by 1 mm rms, but 0\.0\d+ mm were seen"):
        floor(points, errors, rig, bearing_rms_mm=1.0)


def test_nothing_left_over_is_no_floor(rig):
    random = np.random.default_rng(6)
    _, errors = lines(random, 60)
    found = floor(seen(random, errors, extra_mm=0.0) * 0.1 + 0.9 * RCM_MM, errors, rig)
    np.testing.assert_array_equal(found.excess_mm2[:2], 0)


def test_few_poses_are_refused(rig):
    _, errors = lines(np.random.default_rng(0), 9)
    with pytest.raises(TooFewPosesError, match="9 usable poses"):
        floor(seen(np.random.default_rng(0), errors), errors, rig)


def test_it_goes_with_the_size_of_a_pixel_and_with_the_cameras(rig):
    random = np.random.default_rng(7)
    _, errors = lines(random, 40)
    found = floor(seen(random, errors), errors, rig)
    farther = RCM_MM * 1.1
    ratio = pixel_mm(rig, farther) / pixel_mm(rig, RCM_MM)
    np.testing.assert_allclose(found.at(rig, farther), found.excess_mm2 * ratio**2, rtol=1e-3)
    with pytest.raises(UsageError, match="a pixel at the RCM is"):
        found.at(rig, RCM_MM * 3)
    left, right = rig.cameras
    larger = Camera("left", 1280, 960, left.focal_px, left.principal_point_px, [0, 0])
    with pytest.raises(UsageError, match=r"this session has left \(1280×960\)"):
        found.at(Rig([larger, right], rig.reference_from_camera), RCM_MM)
