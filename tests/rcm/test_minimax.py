"""The minimax point against proofs in exact arithmetic, an independent solver and symmetry."""

from fractions import Fraction

import numpy as np
import pytest

from pivometer.errors import DegenerateGeometryError, ShapeError, TooFewPosesError
from pivometer.geometry import distances_to_lines
from pivometer.rcm import minimax_rcm, solve


def test_hard_sets_are_solved_to_rounding(hard_sets):
    for points, axes in hard_sets:
        rcm = minimax_rcm(points, axes)
        assert rcm.certificate_gap <= 1e-12
        assert rcm.weights.min() >= 0
        assert rcm.weights.sum() == pytest.approx(1, abs=1e-12)


def test_no_point_nearby_is_better(gold, hard_sets):
    random = np.random.default_rng(1)
    for points, axes in [gold(), gold(6), *hard_sets[:5]]:
        rcm = minimax_rcm(points, axes)
        # Coordinates are stored to rounding: 1e-15 of their size is the most a point can err.
        allowed = rcm.max_mm + 1e-14 * (np.abs(points).max() + np.abs(rcm.point_mm).max())
        assert distances_to_lines(rcm.point_mm, points, axes).max() <= allowed
        for size in (1e-6, 1e-3, 1e-1):
            moved = rcm.point_mm + size * rcm.max_mm * random.standard_normal((20, 3))
            for point in moved:
                assert distances_to_lines(point, points, axes).max() >= rcm.max_mm - (
                    allowed - rcm.max_mm
                )


def exact_square(point, base, axis):
    """The squared distance of a point from a line, in exact arithmetic."""
    offset = [p - b for p, b in zip(point, base, strict=True)]
    along = sum(o * a for o, a in zip(offset, axis, strict=True))
    return sum(o * o for o in offset) - along * along / sum(a * a for a in axis)


def determinant(m):
    (a, b, c), (d, e, f), (g, h, i) = m
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)


def exact_bound(points, axes, weights):
    """The least value of Σ wᵢ dᵢ² over all points, by Cramer's rule in exact arithmetic."""
    total = sum(weights)
    matrix = [[Fraction(0)] * 3 for _ in range(3)]
    right = [Fraction(0)] * 3
    for base, axis, weight in zip(points, axes, weights, strict=True):
        square = sum(a * a for a in axis)
        for j in range(3):
            for k in range(3):
                entry = weight / total * ((j == k) - axis[j] * axis[k] / square)
                matrix[j][k] += entry
                right[j] += entry * base[k]
    whole = determinant(matrix)
    lowest = []
    for column in range(3):
        swapped = [row[:] for row in matrix]
        for row in range(3):
            swapped[row][column] = right[row]
        lowest.append(determinant(swapped) / whole)
    squares = [exact_square(lowest, b, a) for b, a in zip(points, axes, strict=True)]
    return sum(w / total * s for w, s in zip(weights, squares, strict=True))


@pytest.mark.parametrize("count", [3, 10, 70])
@pytest.mark.parametrize("seed", range(4))
def test_exact_arithmetic_confirms_radius_and_certificate(gold, count, seed):
    points, axes = gold(count, seed=seed)
    points = points - [6.4, 65.7, 478.3]  # near the origin, where the stored point is sharpest
    rcm = minimax_rcm(points, axes)
    exact_points = [[Fraction(float(x)) for x in row] for row in points]
    exact_axes = [[Fraction(float(x)) for x in row] for row in axes]
    point = [Fraction(float(x)) for x in rcm.point_mm]
    largest = max(map(exact_square, [point] * count, exact_points, exact_axes))
    bound = exact_bound(
        [exact_points[i] for i in rcm.active],
        [exact_axes[i] for i in rcm.active],
        [Fraction(float(w)) for w in rcm.weights],
    )
    assert float((largest - bound) / largest) / 2 < 1e-12  # of the radius
    assert float(largest) ** 0.5 == pytest.approx(rcm.max_mm, rel=1e-12)


@pytest.mark.parametrize("count", [3, 10, 70])
def test_agrees_with_the_paper_program_in_cvxpy(gold, count):
    cvxpy = pytest.importorskip("cvxpy", reason="the oracle CVXPY is not installed")
    points, axes = gold(count, seed=count)
    alpha, tau, p = cvxpy.Variable(), cvxpy.Variable(count), cvxpy.Variable(3)
    constraints = [cvxpy.norm(axes[i] * tau[i] + points[i] - p) <= alpha for i in range(count)]
    cvxpy.Problem(cvxpy.Minimize(alpha), constraints).solve(solver="CLARABEL")
    rcm = minimax_rcm(points, axes)
    # Clarabel stops at a gap of 1e-8, absolute or relative.
    assert rcm.max_mm == pytest.approx(float(alpha.value), abs=1e-6 * rcm.max_mm)
    assert rcm.max_mm <= float(alpha.value) + 1e-7
    # About a radius R a point is only fixed to √(2 gap) R where few lines decide.
    assert np.linalg.norm(rcm.point_mm - p.value) < 1e-3 * rcm.max_mm


def test_lines_through_one_point_have_no_error(gold):
    points, axes = gold(noise=0.0)
    rcm = minimax_rcm(points, axes)
    assert rcm.max_mm < 1e-12
    np.testing.assert_allclose(rcm.point_mm, [6.4, 65.7, 478.3], atol=1e-11)
    exact = minimax_rcm(np.zeros((3, 3)), np.eye(3))
    assert (exact.max_mm, exact.certificate_gap) == (0.0, 0.0)


def test_two_families_meet_halfway():
    # Lines along x at heights ±1, along y at heights 0: every optimal point has height 0.
    rcm = minimax_rcm(
        [[0, 0, 1], [5, 0, -1], [0, 7, 0], [0.5, 9, 0]],
        [[1, 0, 0], [1, 0, 0], [0, 1, 0], [0, 1, 0]],
    )
    assert rcm.max_mm == pytest.approx(1.0, rel=1e-14)
    assert rcm.active == (0, 1)
    np.testing.assert_allclose(rcm.point_mm[1:], 0, atol=1e-14)


@pytest.mark.parametrize("count", [151, 5000])
def test_many_lines_with_pruning_agree_with_all_at_once(gold, count, monkeypatch):
    import sys

    points, axes = gold(count, seed=3)
    pruned = minimax_rcm(points, axes)
    monkeypatch.setattr(sys.modules["pivometer.rcm.minimax"], "ALL_AT_ONCE", count)
    whole = minimax_rcm(points, axes)
    assert pruned.max_mm == pytest.approx(whole.max_mm, rel=1e-14)
    assert set(pruned.active) == set(whole.active)
    np.testing.assert_allclose(pruned.point_mm, whole.point_mm, atol=1e-12)


@pytest.mark.parametrize("axes", [np.tile([1.0, 2.0, 2.0], (5, 1)), [[0, 0, 1]] * 4 + [[0, 0, -1]]])
def test_parallel_lines_are_refused(axes):
    points = np.random.default_rng(0).standard_normal((5, 3))
    with pytest.raises(DegenerateGeometryError, match=r"parallel.*rad.*next: tilt"):
        solve(points, axes)


@pytest.mark.parametrize("angle", [1e-3, 1e-2])
def test_nearly_parallel_lines_are_solved_exactly(gold, angle):
    points, axes = gold(20, apex_deg=float(np.degrees(angle)))
    assert minimax_rcm(points, axes).certificate_gap < 1e-14


def test_lines_too_parallel_for_arithmetic_are_refused(gold):
    points, axes = gold(20, apex_deg=0.003)
    with pytest.raises(DegenerateGeometryError, match="parallel"):
        minimax_rcm(points, axes)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_fewer_than_three_lines_are_refused(count):
    with pytest.raises(TooFewPosesError, match=f"{count} usable poses"):
        solve(np.zeros((count, 3)), np.eye(3)[:count])


def test_wrong_input_is_refused():
    with pytest.raises(ShapeError, match="points_mm"):
        solve(np.zeros((4, 2)), np.eye(3))
    with pytest.raises(ShapeError, match=r"\(4, 3\) but directions \(3, 3\)"):
        solve(np.zeros((4, 3)), np.eye(3))
    with pytest.raises(ShapeError, match="not finite"):
        solve(np.full((3, 3), np.nan), np.eye(3))
    with pytest.raises(ShapeError, match="zero length"):
        solve(np.zeros((3, 3)), np.zeros((3, 3)))


def test_input_and_result_cannot_be_changed_by_accident(gold):
    points, axes = gold(10)
    before = points.copy(), axes.copy()
    rcm = minimax_rcm(points, axes)
    np.testing.assert_array_equal(points, before[0])
    np.testing.assert_array_equal(axes, before[1])
    with pytest.raises(ValueError, match="read-only"):
        rcm.point_mm[0] = 0
