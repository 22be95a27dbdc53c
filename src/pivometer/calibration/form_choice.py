"""Whether the board is what it was drawn as, or its own shape explains why corners miss."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pivometer.calibration.board import Board, BoardForm
from pivometer.calibration.board_shape import FEWEST_IMAGES, BoardShape, require_seen
from pivometer.calibration.bundle import adjust, jacobian
from pivometer.calibration.half_turn import PosedView
from pivometer.calibration.joint_route import JointFit, laid_out
from pivometer.errors import DataError

LEAST_GAIN = 0.15
"""A form that lowers the held-out sum of squares by less is not worth a note: by as much does the
uncertainty of any estimate from few views fall."""
WORTH_A_LOOK = 1e-3
"""Chance that independent errors alone make the corners of a perfect board seem to miss alike."""


def other_form_note(joint: JointFit, board: Board, *, weighted: bool) -> tuple[str, ...]:
    """Say so if another form of the board describes images better that it was not estimated from.

    The shape is estimated from every other moment and held fixed in the adjustment of the rest, and
    the other way round.

    Parameters
    ----------
    joint
        The joint adjustment.
    board
        The board, with the form that the adjustment took it for.
    weighted
        Whether corners count by their ``sigma_px``.

    References
    ----------
    Strobl and Hirzinger, doi:10.1109/ICCVW.2011.6130369.
    """
    form: BoardForm = "bowed" if board.looks_same_turned else "free"
    if board.form in ("free", form) or not _corners_miss_alike(joint):
        return ()
    other = replace(board, form=form)
    try:
        now, then = (_held_out_squares(joint, one, weighted) for one in (board, other))
        shape = _shape(joint, joint.posed, other, weighted)
    except DataError:  # half of the views do not determine it
        return ()
    if then > (1 - LEAST_GAIN) * now:
        return ()
    less = 100 * (1 - np.sqrt(then / now))
    note = (
        f"the board is not as drawn: its corners stand {shape.aside_rms_mm:.2g} mm rms aside and "
        f"are bowed by {shape.bow_mm:.2g} mm, the same in all images; taking them so lowers the "
        f"misses in images that this was not estimated from by {less:.0f} %: write "
        f'form = "{form}" under [board] in session.toml, or use a better board'
    )
    return (note,)


def _corners_miss_alike(joint: JointFit) -> bool:
    """Whether each corner misses alike in all images, by more than chance: an F-test.

    To first order, with the cameras where they are. It only decides whether a closer look is worth
    its time.
    """
    from scipy.stats import f as f_distribution

    problem, solution = joint.problem, joint.solution
    turn = solution.state.board_rotations[problem.moment][:, None]
    J = jacobian(problem, solution.state)[..., -3:] @ turn * problem.weights[..., None, None]
    r = solution.residuals_px * problem.weights[..., None]
    often = (problem.weights > 0).sum(axis=0) >= FEWEST_IMAGES
    normal = np.einsum("gnij,gnik->njk", J, J)[often]
    gradient = np.einsum("gnij,gni->nj", J, r)[often, :, None]
    explained = float(np.sum(gradient * np.linalg.solve(normal, gradient)))
    more = 3 * len(normal) - 7
    freedom = solution.degrees_of_freedom - more
    left = float(np.sum(r**2)) - explained
    if min(more, freedom) < 1 or left <= 0:
        return False
    return bool(
        f_distribution.sf(explained / more / (left / freedom), more, freedom) < WORTH_A_LOOK
    )


def _held_out_squares(joint: JointFit, board: Board, weighted: bool) -> float:
    """Return the sum of squares of each half of the moments with the other half's shape."""
    moments = list(dict.fromkeys(p.view.view for p in joint.posed))
    halves = [set(moments[::2]), set(moments[1::2])]
    total = 0.0
    for half, rest in (halves, halves[::-1]):
        shape = _shape(joint, [p for p in joint.posed if p.view.view in half], board, weighted)
        held = [p for p in joint.posed if p.view.view in rest]
        problem, start = laid_out(held, replace(board, form="flat"), joint.rig, weighted)
        problem = replace(problem, corners_mm=problem.corners_mm + shape.displacements_mm)
        residuals = adjust(problem, start, tolerance=1e-4).residuals_px
        total += float(np.sum((residuals * problem.weights[..., None]) ** 2))
    return total


def _shape(joint: JointFit, posed: Sequence[PosedView], board: Board, weighted: bool) -> BoardShape:
    require_seen([p.view for p in posed], board)
    problem, start = laid_out(posed, board, joint.rig, weighted)
    state = adjust(problem, start, tolerance=1e-4).state
    return BoardShape(problem.shape_modes @ state.shape_mm)
