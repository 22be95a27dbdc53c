"""The budget's parts against the whole, and against drawing each source by itself."""

import numpy as np
import pytest

from pivometer.rcm import solve
from pivometer.uncertainty import LineErrors
from pivometer.uncertainty.budget import (
    CORNERS,
    EDGES,
    FLOOR,
    REFERENCE,
    ROBOT,
    SHADING,
    SQUARES,
    LocationParts,
    uncertainty_budget,
)

POINT_MM = np.array([3.0, -2.0, 400.0])


@pytest.fixture
def errors():
    random = np.random.default_rng(5)
    axes = random.normal([0, 0, 2], 0.7, (40, 3))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    common = across @ np.stack([0.05 * np.ones((40, 3)), 0.02 * axes[:, [1, 2, 0]]], axis=2)
    return LineErrors(
        directions=axes,
        edges_mm2=0.01**2 * across,
        calibration_mm=common,
        shading_mm=0.2 * common[:, ::-1],
        floor_mm2=[0.02**2, 0.01**2, 0.03**2],
    )


def points(errors, miss_mm=0.1):
    random = np.random.default_rng(6)
    return POINT_MM + miss_mm * random.standard_normal((40, 3)) + 20 * errors.directions


def parts(errors, turn=None, **changed):
    covariance = np.diag([4.0, 1.0, 9.0])
    values = {
        "point_mm": POINT_MM,
        "lines_mm2": 1e-3 * covariance,
        "calibration_mm2": 1e-2 * covariance + np.outer(POINT_MM, POINT_MM) * 0.001**2,
        "shading_mm2": 1e-4 * covariance,
        "board_mm2": np.zeros((3, 3)),
        "turn": np.eye(3),
    }
    return LocationParts(**(values | changed))


def test_the_squares_of_all_sources_add_up_to_the_whole(errors):
    given = parts(errors)
    budget = uncertainty_budget(points(errors), errors, given, squares_relative=0.001)
    squares = sum(source.location_u_mm**2 for source in budget.sources)
    whole = given.lines_mm2 + given.calibration_mm2 + given.shading_mm2
    np.testing.assert_allclose(squares, whole.diagonal(), rtol=1e-9)
    by_name = {source.name: source for source in budget.sources}
    np.testing.assert_allclose(by_name[SQUARES].location_u_mm, np.abs(0.001 * POINT_MM))
    assert REFERENCE not in by_name  # there is none


def test_the_largest_source_is_named_with_a_remedy(errors):
    budget = uncertainty_budget(points(errors), errors, parts(errors), squares_relative=0.001)
    assert budget.largest_in_location == SQUARES
    assert budget.largest_in_error == FLOOR
    assert "square_u_mm" in budget.advice[0]
    without = uncertainty_budget(points(errors), errors, parts(errors), squares_relative=0.0)
    assert without.largest_in_location == CORNERS
    assert SQUARES not in {source.name for source in without.sources}


def test_in_the_boards_frame_the_reference_boards_corners_count(errors):
    turn = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    small = parts(errors)
    board = parts(
        errors,
        point_mm=np.array([10.0, 20.0, 30.0]),
        lines_mm2=turn @ small.lines_mm2 @ turn.T,
        calibration_mm2=1e-6 * np.eye(3),
        board_mm2=0.3**2 * np.eye(3),
        turn=turn,
    )
    budget = uncertainty_budget(points(errors), errors, small, board, squares_relative=0.0)
    assert budget.largest_in_location == REFERENCE
    by_name = {source.name: source for source in budget.sources}
    np.testing.assert_allclose(by_name[REFERENCE].board_u_mm, 0.3)
    np.testing.assert_array_equal(by_name[REFERENCE].location_u_mm, 0)
    robot = by_name[ROBOT]  # turned with the frame
    assert (robot.board_u_mm**2).sum() == pytest.approx((robot.location_u_mm**2).sum())


def drawn(errors, name, random):
    """Errors of all lines from one source."""
    count = len(errors.directions)
    if name == EDGES:
        return 0.01 * random.standard_normal((count, 3))
    if name == FLOOR:
        return 0.02 * random.standard_normal((count, 3))
    common = errors.calibration_mm if name == CORNERS else errors.shading_mm
    return common @ random.standard_normal(common.shape[2])


@pytest.mark.parametrize("name", [EDGES, FLOOR, CORNERS, SHADING])
def test_what_a_source_adds_to_the_misses_is_what_drawing_it_does(errors, name):
    """The mean square of N sums has a relative deviation under √(2/N)."""
    random = np.random.default_rng(7)
    at = points(errors)
    budget = uncertainty_budget(at, errors, parts(errors), squares_relative=0.0)
    source = next(one for one in budget.sources if one.name == name)
    trials = 200
    perfect = POINT_MM + 0 * at
    squares = [
        solve(perfect + drawn(errors, name, random), errors.directions).least_squares.rms_mm ** 2
        for _ in range(trials)
    ]
    assert np.mean(squares) == pytest.approx(source.rms_mm**2, rel=4 * np.sqrt(2 / trials))
    largest = [
        solve(at + 1e-3 * drawn(errors, name, random), errors.directions).minimax.max_mm
        for _ in range(trials)
    ]
    assert np.std(largest) == pytest.approx(1e-3 * source.max_u_mm, rel=4 / np.sqrt(2 * trials))
