"""Which of two things that turn side by side pivots, from silhouettes of cylinders in space."""

import numpy as np
import pytest
from tests.shaft.turning import PIVOT, POSES, RIG, ROD_PIVOT, seen, together

from pivometer.shaft.finding.agreement import agreeing
from pivometer.shaft.finding.side_by_side import (
    PIVOT_SIGMAS,
    alongside,
    is_rail_of,
    pivots_rather,
)


def agreed(*things):
    """Return what cameras agree on of each thing."""
    return [agreeing(together(thing), POSES, RIG)[0] for thing in things]


@pytest.mark.parametrize("beside_mm", [-45.0, 30.0, 45.0])
@pytest.mark.parametrize("seed", range(4))
def test_the_shaft_pivots_rather_than_a_rail_beside_it_though_the_robot_misses(seed, beside_mm):
    kind = {"seed": seed, "noise_px": 0.2, "miss_mm": 0.3}
    shaft = seen(PIVOT, 10.0, thing=0, **kind)
    rail = seen(PIVOT, 14.0, thing=1, beside_mm=beside_mm, **kind)
    one, other = agreed(shaft, rail)
    assert alongside(one, other)
    assert alongside(other, one)
    told = pivots_rather(one, other)
    assert told > 2
    assert pivots_rather(other, one) == pytest.approx(-told, rel=0.3)
    assert is_rail_of(other, one) == (told > PIVOT_SIGMAS)
    assert not is_rail_of(one, other)


def test_how_clearly_one_pivots_is_what_noise_makes_uncertain():
    # Of two lines at the same distance from what pivots neither does rather, to their noise.
    told = []
    for seed in range(60):
        kind = {"seed": seed, "noise_px": 0.3, "miss_mm": 0.3}
        left = seen(PIVOT, 10.0, thing=0, beside_mm=-15.0, **kind)
        right = seen(PIVOT, 10.0, thing=1, beside_mm=15.0, **kind)
        one, other = agreed(left, right)
        told.append(pivots_rather(one, other))
    # Of 60 normal numbers the median is normal, too, with 1.25 / √60; that of their absolutes is
    # 0.6745, with 1 / (2 · 0.6356 √60) = 0.1; 3.5 of these.
    assert np.abs(np.median(told)) < 3.5 * 1.25 / np.sqrt(60)
    assert np.median(np.abs(told)) == pytest.approx(0.6745, abs=0.35)


def test_without_any_noise_it_is_quite_clear():
    shaft = seen(PIVOT, 10.0, thing=0, seed=1, noise_px=0.0)
    rail = seen(PIVOT, 14.0, thing=1, seed=1, noise_px=0.0, beside_mm=30.0)
    one, other = agreed(shaft, rail)
    assert 1e3 < pivots_rather(one, other) < np.inf


def test_another_rod_and_a_lane_of_the_shaft_are_not_beside_it():
    shaft = seen(PIVOT, 10.0, thing=0, seed=1)
    rod = seen(ROD_PIVOT, 5.0, thing=1, seed=2)
    lane = seen(PIVOT, 4.0, thing=1, seed=1, beside_mm=3.0)
    whole, other, inside = agreed(shaft, rod, lane)
    assert not alongside(whole, other)
    assert not alongside(whole, inside)


def test_few_poses_tell_nothing():
    shaft = seen(PIVOT, 10.0, thing=0, seed=1, noise_px=0.2)
    rail = seen(PIVOT, 14.0, thing=1, seed=1, noise_px=0.2, beside_mm=30.0)
    for one in (*shaft, *rail):
        for sample in range(4, 12):
            del one.edges_px[sample]
    assert not alongside(*agreed(shaft, rail))
