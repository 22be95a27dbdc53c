"""How well the RCM is known in the frame of a board that stands still near it.

A wrong camera parameter shifts the board and the RCM alike, so most of the calibration's
uncertainty drops out: at 0.1 px the location is known to 0.28–0.38 mm in the camera's frame and
to 0.01–0.03 mm in the board's. So the rig's parameters are moved together, and the board's pose
**and** the centerlines are estimated again with the same moved rig.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats, checked, read_only
from pivometer.calibration.board import Board
from pivometer.calibration.frame import FixedBoard, board_pose
from pivometer.cameras.rig import Rig
from pivometer.errors import ShapeError
from pivometer.geometry.rigid import RigidTransform, cross_matrix
from pivometer.rcm.least_squares import least_squares_rcm
from pivometer.uncertainty.carried_edges import (
    EdgePoints,
    lines_of,
    rcm_of_points,
    thinned_points,
)
from pivometer.uncertainty.coverage import (
    COVERAGE,
    coverage_factor,
    fewest_degrees_of_freedom,
)
from pivometer.uncertainty.propagation import (
    common_location,
    jacobian_by_differences,
    square_root,
)
from pivometer.uncertainty.sequence import scatter
from pivometer.uncertainty.shading import displacements_of


@dataclass(frozen=True, slots=True, eq=False)
class BoardFrameUncertainty:
    """How well the least-squares RCM point is known in the frame of the reference board.

    Parameters
    ----------
    lines_mm2
        Covariance from the scatter of the lines, shape (3, 3), mm².
    calibration_mm2
        Covariance from the calibration: what a wrong rig does to the RCM and not to the board
        beside it, and the uncertainty of the square's size, shape (3, 3), mm².
    board_mm2
        Covariance from the corners of the reference board, shape (3, 3), mm².
    total_mm2
        The sum of these and of `shading_mm2`, shape (3, 3), mm².
    degrees_of_freedom
        Effective degrees of freedom of the total: the least of the three axes.
    coverage
        Coverage probability of `expanded_mm`, for each axis by itself.
    coverage_factor
        k of that coverage, from Student's t distribution.
    expanded_mm
        Expanded uncertainty U = k u along the board's x, y and z, shape (3,), mm.
    shading_mm2
        Covariance from light that comes from one side, shape (3, 3), mm²; zero in files of versions
        that did not count it.
    """

    lines_mm2: Floats
    calibration_mm2: Floats
    board_mm2: Floats
    total_mm2: Floats
    degrees_of_freedom: float
    coverage: float
    coverage_factor: float
    expanded_mm: Floats
    shading_mm2: Floats = field(default_factory=lambda: np.zeros((3, 3)))

    def __post_init__(self) -> None:
        for name in ("lines_mm2", "calibration_mm2", "board_mm2", "total_mm2", "shading_mm2"):
            values = read_only(checked(getattr(self, name), (3, 3), name))
            object.__setattr__(self, name, values)
        values = read_only(checked(self.expanded_mm, (3,), "expanded_mm"))
        object.__setattr__(self, "expanded_mm", values)


def board_frame_uncertainty(
    edges: Sequence[Sequence[EdgePoints]],
    rig: Rig,
    rig_covariance: ArrayLike,
    fixed: FixedBoard,
    board: Board,
    *,
    coverage: float = COVERAGE,
) -> tuple[BoardFrameUncertainty, Floats]:
    """Return the covariance of the RCM in the board's frame, and that of the board's pose.

    Parameters
    ----------
    edges
        For each pose, the edges that each camera of the rig saw, in the rig's order.
    rig
        The calibrated cameras.
    rig_covariance
        Covariance of the entries of `rig.parameter_names`, shape (d, d).
    fixed
        The board that stood still.
    board
        The board; the uncertainty of its squares is a scale common to it and to the rig.
    coverage
        Coverage probability of the expanded uncertainty.

    Returns
    -------
    BoardFrameUncertainty
        Of the least-squares point.
    Floats
        Covariance of ``reference_from_board``: rotation vector applied on the left (rad), then
        translation (mm), from corners and calibration, shape (6, 6).

    References
    ----------
    GUM (JCGM 100:2008), 5.1.3 and 5.2.
    """
    size = len(rig.parameter_names)
    covariance = checked(rig_covariance, (size, size), "rig_covariance")
    points = thinned_points(edges, [camera.name for camera in rig.cameras])
    root, scales = _independent(covariance, rig, board)
    pose = fixed.reference_from_board

    def outcome(independent: Floats) -> Floats:
        other = rig.perturbed(root @ independent)
        corners = board.corners_mm * (1 + float(scales @ independent))
        again = board_pose(fixed.means, corners, other, pose)
        location = again.inverse() @ rcm_of_points(points, other).point_mm
        turn = RigidTransform(again.rotation @ pose.rotation.T, np.zeros(3))
        return np.concatenate([location, turn.rotation_vector_rad(), again.translation_mm])

    count = root.shape[1]
    jacobian = jacobian_by_differences(outcome, np.zeros(count), np.ones(count))
    shared = jacobian @ jacobian.T
    lines = lines_of(points, rig)
    rcm = least_squares_rcm(*lines)
    turned = pose.rotation.T
    arm = rcm.point_mm - pose.translation_mm
    lever = turned @ np.concatenate([cross_matrix(arm), -np.eye(3)], axis=1)
    told = scatter(rcm, *lines)
    shading = turned @ common_location(lines[1], displacements_of(points, rig, rcm.point_mm))
    uncertainty = _combined(
        (
            turned @ told.covariance_mm2 @ turned.T,
            shared[:3, :3],
            lever @ fixed.covariance @ lever.T,
            shading @ shading.T,
        ),
        own=(told.degrees_of_freedom, _freedom(fixed)),
        coverage=coverage,
    )
    return uncertainty, fixed.covariance + shared[3:, 3:]


def _freedom(fixed: FixedBoard) -> int:
    return 2 * sum(len(view.ids) for view in fixed.means) - 6


def _combined(
    parts: tuple[Floats, Floats, Floats, Floats], *, own: tuple[float, int], coverage: float
) -> BoardFrameUncertainty:
    lines, calibration, corners, shading = ((part + part.T) / 2 for part in parts)
    total = lines + calibration + corners + shading
    degrees = fewest_degrees_of_freedom(
        [lines, calibration + shading, corners], [own[0], np.inf, own[1]]
    )
    factor = coverage_factor(degrees, coverage=coverage)
    return BoardFrameUncertainty(
        lines_mm2=lines,
        calibration_mm2=calibration,
        board_mm2=corners,
        total_mm2=total,
        degrees_of_freedom=degrees,
        coverage=coverage,
        coverage_factor=factor,
        expanded_mm=factor * np.sqrt(total.diagonal()),
        shading_mm2=shading,
    )


def _independent(covariance: Floats, rig: Rig, board: Board) -> tuple[Floats, Floats]:
    """Return independent directions of the rig's errors (d, r), and the board's scale in each.

    The calibration's covariance holds the uncertainty of the square's size as one scale of all
    baselines. The board beside the RCM has the same squares, so that direction is taken out, and
    put back as one that scales both.
    """
    relative = (board.square_u_mm or 0.0) / board.square_mm
    effect = np.zeros(len(rig.parameter_names))
    for camera, transform in zip(rig.cameras[1:], rig.reference_from_camera[1:], strict=True):
        for axis, value in zip("xyz", transform.translation_mm, strict=True):
            effect[rig.parameter_names.index(f"{camera.name}.t{axis}_mm")] = relative * value
    if not effect.any():
        root = square_root(covariance)
        return root, np.zeros(root.shape[1])
    try:
        root = square_root(covariance - np.outer(effect, effect))
    except ShapeError:  # a covariance made elsewhere, which does not hold the squares' part
        root = square_root(covariance)
    scales = np.zeros(root.shape[1] + 1)
    scales[-1] = relative
    return np.concatenate([root, effect[:, None]], axis=1), scales
