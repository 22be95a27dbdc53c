"""The RCM does not depend on frame, scale, order, signs, lengths or given points."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from pivometer.geometry.rigid import rotation_from_vector
from pivometer.rcm import solve

SEEDS = st.integers(0, 2**32 - 1)


def lines(seed):
    random = np.random.default_rng(seed)
    count = int(random.integers(3, 40))
    axes = random.standard_normal((count, 3)) * [1, 1, 0] + [0, 0, 2]
    return random.standard_normal((count, 3)), axes, random


def same(first, second, *, scale=1.0, place=lambda point: point, room=1e-11):
    """Both solutions agree; `room` in units of the lines' spread."""
    for one, other in (
        (first.minimax, second.minimax),
        (first.least_squares, second.least_squares),
    ):
        assert abs(one.max_mm * scale - other.max_mm) <= room * scale
        assert np.abs(place(one.point_mm) - other.point_mm).max() <= 1e3 * room * scale


@settings(max_examples=60, deadline=None)
@given(SEEDS)
def test_moves_and_scales_with_its_lines(seed):
    points, axes, random = lines(seed)
    rotation = rotation_from_vector(random.uniform(-3, 3, 3))
    shift = random.uniform(-10, 10, 3)
    scale = 10.0 ** random.uniform(-6, 6)
    moved = solve(scale * (points @ rotation.T + shift), axes @ rotation.T)

    def place(point):
        return scale * (rotation @ point + shift)

    same(solve(points, axes), moved, scale=scale, place=place)


@settings(max_examples=60, deadline=None)
@given(SEEDS)
def test_order_signs_lengths_and_given_points_do_not_matter(seed):
    points, axes, random = lines(seed)
    order = random.permutation(len(points))
    lengths = random.choice([-1, 1], (len(points), 1)) * 10.0 ** random.uniform(
        -3, 3, (len(points), 1)
    )
    elsewhere = points + random.uniform(-5, 5, (len(points), 1)) * axes
    first, second = solve(points, axes), solve(elsewhere[order], (axes * lengths)[order])
    same(first, second)
    np.testing.assert_allclose(
        first.minimax.distances_mm[order], second.minimax.distances_mm, atol=1e-8
    )
    np.testing.assert_allclose(first.cone_deg, second.cone_deg, rtol=1e-9)


@settings(max_examples=100, deadline=None)
@given(SEEDS)
def test_every_solution_carries_a_proof(seed):
    points, axes, _ = lines(seed)
    rcm = solve(points, axes)
    assert rcm.minimax.certificate_gap <= 1e-12
    assert rcm.minimax.max_mm <= rcm.least_squares.max_mm * (1 + 1e-12)
    assert rcm.least_squares.rms_mm <= rcm.minimax.rms_mm * (1 + 1e-12)
