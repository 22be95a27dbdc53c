"""The sum of distances proved least, trimming, and poses that stick out."""

from itertools import combinations

import cvxpy
import numpy as np
import pytest

from pivometer.errors import DegenerateGeometryError
from pivometer.geometry import distances_to_lines
from pivometer.rcm import (
    least_distance_rcm,
    least_squares_rcm,
    outlier_findings,
    solve,
    trimmed_rcm,
    with_other_points,
)


def test_hard_sets_are_proved_to_rounding(hard_sets):
    for points, axes in hard_sets:
        assert least_distance_rcm(points, axes).certificate_gap <= 1e-12


def random_sets(count):
    random = np.random.default_rng(4)
    for _ in range(count):
        n = int(random.integers(3, 60))
        axes = random.normal([0, 0, random.choice([0.5, 2, 20])], 1, (n, 3))
        misses = random.standard_normal((n, 3)), random.standard_t(1, (n, 3))
        points = random.choice([1e-6, 0.1, 1e4]) * misses[random.integers(2)]
        yield points + [6, 65, 478] + random.uniform(50, 100, (n, 1)) * axes, axes


def test_random_sets_are_proved_to_rounding():
    for points, axes in random_sets(150):
        assert least_distance_rcm(points, axes).certificate_gap <= 1e-12


def test_agrees_with_an_independent_solver():
    for points, axes in random_sets(6):
        found = least_distance_rcm(points, axes)
        scale = found.mean_mm
        units = axes / np.linalg.norm(axes, axis=1)[:, None]
        point = cvxpy.Variable(3)
        offsets = (points - found.point_mm) / scale
        terms = [
            cvxpy.norm((np.eye(3) - np.outer(a, a)) @ (point - b))
            for a, b in zip(units, offsets, strict=True)
        ]
        least = cvxpy.Problem(cvxpy.Minimize(cvxpy.sum(terms))).solve(solver="CLARABEL")
        # Clarabel is 1e-9 to 2e-8 above the optimum; `offsets` are rounded to 1e-13 mm.
        assert found.distances_mm.sum() / scale == pytest.approx(least, rel=1e-6)
        assert found.distances_mm.sum() / scale <= least * (1 + 1e-9) + 60 * 1e-13 / scale


def test_no_point_nearby_is_better(gold):
    random = np.random.default_rng(2)
    points, axes = gold()
    found = least_distance_rcm(points, axes)
    for size in (1e-6, 1e-3, 0.1):
        for step in size * random.standard_normal((20, 3)):
            total = distances_to_lines(found.point_mm + step, points, axes).sum()
            assert total >= found.distances_mm.sum() * (1 - 1e-14)


def test_the_point_may_lie_on_a_line():
    """Three lines through a point, pulling no more than the fourth holds: it passes through."""
    turn = 2 * np.pi * np.arange(3) / 3
    across = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    axes = np.vstack([np.cross(across, [0, 0, 1.0]) + np.array([0, 0, 0.3]), [[0, 0, 1]]])
    points = np.vstack([2 * across, [[0.01, 0, 0]]])
    found = least_distance_rcm(points, axes)
    assert found.certificate_gap <= 1e-12
    assert found.distances_mm[3] < 1e-12


def test_lines_through_one_point():
    axes = np.random.default_rng(3).normal([0, 0, 2], 1, (9, 3))
    found = least_distance_rcm(np.zeros((9, 3)), axes)
    assert (found.mean_mm, found.certificate_gap) == (0.0, 0.0)
    np.testing.assert_array_equal(found.point_mm, np.zeros(3))


def test_wrong_lines_move_the_robust_points_little(gold):
    points, axes = gold()
    clean = least_squares_rcm(points, axes)
    allowed = 5 * np.sqrt(np.trace(clean.covariance_mm2))
    wrong = points.copy()
    wrong[:3] += [[30, 0, 0], [20, 20, 0], [25, -10, 5]]
    shift = {
        "least squares": least_squares_rcm(wrong, axes).point_mm,
        "sum": least_distance_rcm(wrong, axes).point_mm,
        "trimmed": trimmed_rcm(wrong, axes).point_mm,
    }
    far = {name: np.linalg.norm(point - clean.point_mm) for name, point in shift.items()}
    assert far["least squares"] > 5 * allowed
    assert far["sum"] < allowed
    assert far["trimmed"] < allowed


def test_trimming_leaves_out_a_quarter_and_the_wrong_ones_first(gold):
    points, axes = gold(40)
    points[[5, 17]] += [40.0, 0, 0]
    found = trimmed_rcm(points, axes)
    assert len(found.left_out) == 10
    assert {5, 17} <= set(found.left_out)
    kept = np.delete(np.arange(40), found.left_out)
    assert found.distances_mm[kept].max() <= found.distances_mm[list(found.left_out)].min()
    assert found.rms_mm == pytest.approx(np.sqrt(np.mean(found.distances_mm[kept] ** 2)))
    again = least_squares_rcm(points[kept], axes[kept])
    np.testing.assert_allclose(found.point_mm, again.point_mm, atol=1e-11)


def test_nothing_trimmed_is_least_squares(gold):
    points, axes = gold(12)
    found = trimmed_rcm(points, axes, trimmed=0)
    assert found.left_out == ()
    np.testing.assert_allclose(found.point_mm, least_squares_rcm(points, axes).point_mm, atol=1e-11)


def squares_of(points, axes, chosen):
    rcm = least_squares_rcm(points[list(chosen)], axes[list(chosen)])
    return rcm.rms_mm**2 * len(chosen)


def test_no_choice_of_lines_is_better():
    """All choices of 6 of 8 and 8 of 10 lines, with and without gross errors."""
    random = np.random.default_rng(9)
    for count in [8] * 20 + [10] * 20:
        axes = random.normal([0, 0, 2], 1, (count, 3))
        points = random.standard_normal((count, 3))
        points[: random.integers(3)] *= 20
        found = trimmed_rcm(points, axes)
        kept = count - len(found.left_out)
        least = min(squares_of(points, axes, c) for c in combinations(range(count), kept))
        assert found.rms_mm**2 * kept == pytest.approx(least, rel=1e-9)
        assert found.certificate_gap < 1e-8


def test_concentration_alone_would_not_find_it(gold, monkeypatch):
    """The search is what makes it global: without it some answers are worse, and say so."""
    searched = [trimmed_rcm(*gold(20, seed=seed)) for seed in range(12)]
    assert all(found.certificate_gap < 1e-8 for found in searched)
    monkeypatch.setattr("pivometer.rcm.trimmed.MOST_WORK", 0)
    local = [trimmed_rcm(*gold(20, seed=seed)) for seed in range(12)]
    assert all(found.certificate_gap == 1 for found in local)
    assert all(a.rms_mm <= b.rms_mm * (1 + 1e-12) for a, b in zip(searched, local, strict=True))
    assert any(a.rms_mm < 0.999 * b.rms_mm for a, b in zip(searched, local, strict=True))


def test_a_thousand_lines_and_more_are_not_searched_and_say_so(gold):
    assert trimmed_rcm(*gold(1001)).certificate_gap == 1


def test_lines_without_a_trimmed_point_keep_the_others(gold):
    points, axes = gold(12)
    axes[:10] = axes[0]
    points[:10] = points[0] + 0.1 * np.random.default_rng(10).standard_normal((10, 3))
    points[10:] += [5.0, 0, 0]
    with pytest.raises(DegenerateGeometryError, match="parallel"):
        trimmed_rcm(points, axes)
    rcm = with_other_points(solve(points, axes), points, axes)
    assert rcm.trimmed is None
    assert rcm.least_distance is not None


def test_outlying_poses_are_named(gold):
    points, axes = gold()
    names = [f"p{i}" for i in range(70)]
    points[[3, 9]] += [[9.0, 0, 0], [0, 4.0, 0]]
    (finding,) = outlier_findings(names, points, axes)
    assert finding.severity == "warning"
    assert finding.text.startswith("2 of 70 poses (p3, p9) miss the RCM by far more than the rest")


def test_false_alarms_are_as_rare_as_stated(gold):
    """In 1 % of Gaussian sessions: of 150, 9 or more by chance once in 30 000."""
    names = [str(i) for i in range(40)]
    alarms = sum(len(outlier_findings(names, *gold(40, seed=seed))) for seed in range(150))
    assert alarms <= 8
