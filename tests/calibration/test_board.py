"""The board's geometry, numbering and symmetries."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pivometer.calibration.board import Board, BoardView
from pivometer.errors import ShapeError, UsageError

SIZES = st.tuples(st.integers(4, 12), st.integers(4, 12))


def colours_around(board: Board) -> np.ndarray:
    """Colour of the square across and down of each corner (0: that of the first square)."""
    return board.columns_rows.sum(axis=1) % 2


@given(SIZES)
def test_corners_lie_row_by_row_one_square_apart(squares):
    board = Board("checkerboard", squares, 12.5)
    corners = board.corners_mm.reshape(squares[1] - 1, squares[0] - 1, 3)
    assert np.allclose(np.diff(corners, axis=1), [12.5, 0, 0])
    assert np.allclose(np.diff(corners, axis=0), [0, 12.5, 0])
    assert not corners[0, 0].any()


@given(SIZES)
def test_every_edge_is_one_square_long_and_occurs_once(squares):
    board = Board("checkerboard", squares, 2.0)
    across, down = board.inner_corners
    first, second = board.corners_mm[board.edges].transpose(1, 0, 2)
    assert np.allclose(np.linalg.norm(first - second, axis=1), 2.0)
    assert len(np.unique(np.sort(board.edges, axis=1), axis=0)) == len(board.edges)
    assert len(board.edges) == (across - 1) * down + across * (down - 1)


@given(SIZES)
def test_a_symmetry_is_a_turn_that_keeps_lengths_handedness_and_colours(squares):
    board = Board("checkerboard", squares, 1.0)
    flat = board.corners_mm[:, :2]
    assert (board.symmetries[0] == np.arange(board.corner_count)).all()
    for permutation in board.symmetries:
        assert (np.sort(permutation) == np.arange(board.corner_count)).all()
        centred, turned = flat - flat.mean(axis=0), flat[permutation] - flat.mean(axis=0)
        turn = np.linalg.lstsq(centred, turned, rcond=None)[0]
        assert np.allclose(centred @ turn, turned)
        assert np.linalg.det(turn) == pytest.approx(1)
        # the four squares around a corner keep their colours: a quarter-turn moves the
        # across-and-down square to a neighbour of the other colour
        quarter = abs(turn[0, 0]) < 0.5
        same = colours_around(board)[permutation] == colours_around(board)
        assert same.all() != quarter or not same.any()
        assert (~same).all() if quarter else same.all()


@pytest.mark.parametrize(
    ("squares", "count"), [((9, 7), 2), ((8, 6), 2), ((10, 7), 1), ((7, 7), 4), ((8, 8), 2)]
)
def test_number_of_symmetries(squares, count):
    assert len(Board("checkerboard", squares, 1.0).symmetries) == count


def test_markers_break_every_symmetry():
    board = Board("charuco", (9, 7), 1.0, dictionary="DICT_4X4_50", marker_mm=0.7)
    assert len(board.symmetries) == 1


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("dots", (9, 7), 1.0), "neither"),
        (("checkerboard", (3, 7), 1.0), "3×7"),
        (("checkerboard", (9, 7), 0.0), "square size is 0"),
        (("checkerboard", (9, 7), 1.0, 1.5), "uncertainty"),
        (("charuco", (9, 7), 1.0), "dictionary"),
        (("charuco", (9, 7), 1.0, None, "DICT_4X4_50", 1.2), "marker size is 1.2"),
    ],
)
def test_a_wrong_description_is_refused(arguments, text):
    with pytest.raises(UsageError, match=text):
        Board(*arguments)


def test_renumbering_by_a_symmetry_moves_corners_with_their_values():
    board = Board("checkerboard", (5, 5), 1.0)
    ids = np.array([0, 3, 7, 10])
    view = BoardView("left", "board/000", ids, np.stack([ids, 2 * ids], axis=1), ids + 1.0)
    for permutation in board.symmetries:
        turned = view.renumbered(permutation)
        assert (np.diff(turned.ids) > 0).all()
        origin = np.argsort(permutation)[turned.ids]
        assert (turned.pixels[:, 0] == origin).all()
        assert (turned.sigma_px == origin + 1).all()


@pytest.mark.parametrize("ids", [[1, 0], [0, 0], [-1, 2]])
def test_corner_numbers_must_increase(ids):
    with pytest.raises(ShapeError, match="increasing"):
        BoardView("left", "board/000", ids, np.zeros((2, 2)), np.ones(2))


def test_arrays_of_a_view_are_read_only():
    view = BoardView("left", "board/000", [0, 1], np.zeros((2, 2)), np.ones(2))
    for array in (view.ids, view.pixels, view.sigma_px):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
