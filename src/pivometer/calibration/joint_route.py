"""The joint route: cameras, rig and board poses adjusted to all views together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from pivometer._arrays import Floats
from pivometer.calibration.board import Board, BoardView
from pivometer.calibration.board_shape import BoardShape, require_seen
from pivometer.calibration.bundle import (
    BundleProblem,
    BundleSolution,
    BundleState,
    adjust,
    adjust_wary,
    bundle_problem,
    bundle_state,
    rig_from_state,
)
from pivometer.calibration.half_turn import PosedView, Tree, require_pairs
from pivometer.calibration.intrinsics import CameraCalibration, rms
from pivometer.calibration.quality import undetermined
from pivometer.calibration.result import RejectedView
from pivometer.cameras import Rig
from pivometer.errors import CalibrationError, DataError
from pivometer.geometry.rigid import RigidTransform

FEWEST_MISFITS = 3
LARGEST_MISFIT_PART = 1 / 3
"""So many moments, and such a part of all, at which two cameras do not fit together are no
accident: of the real pairs of the OpenCV set none is, of a filmed board's 14 of 20."""
FILMED = 0.1
"""Successive pictures in which the board moved by less than a tenth of its size are a film."""
LARGEST_JOINT_PX = 0.2
"""Below this a joint fit is not refused, however well each camera fits by itself."""


@dataclass(frozen=True, slots=True, eq=False)
class JointFit:
    """The joint adjustment and the views it rests on."""

    rig: Rig
    posed: tuple[PosedView, ...]
    problem: BundleProblem
    solution: BundleSolution
    rejected: tuple[RejectedView, ...]

    @property
    def residuals_px(self) -> list[Floats]:
        """Residuals of each view, shape (k, 2), px."""
        rows = zip(self.solution.residuals_px, self.problem.weights > 0, strict=True)
        return [errors[found] for errors, found in rows]

    @property
    def board_shape(self) -> BoardShape:
        """The board as estimated; as drawn where it was taken for flat."""
        return BoardShape(self.problem.shape_modes @ self.solution.state.shape_mm)

    def rig_from(self, moments: Sequence[str], board: Board, *, weighted: bool) -> Rig:
        """Return the rig adjusted again to the named moments only."""
        kept = set(moments)
        posed = [p for p in self.posed if p.view.view in kept]
        problem, start = laid_out(posed, board, self.rig, weighted)
        # a millionth of the cost is 0.05 of a standard uncertainty at most
        return rig_from_state(adjust(problem, start, tolerance=1e-6).state, self.rig.cameras)


def joint_fit(
    posed: Sequence[PosedView], board: Board, rig: Rig, weighted: bool, tree: Tree
) -> JointFit:
    """Adjust everything together; reject moments whose images fit no common board position."""
    require_seen([p.view for p in posed], board)
    rejected: list[RejectedView] = []
    while True:
        fit, worst = _adjusted(posed, board, rig, weighted)
        if worst is None:
            return JointFit(fit.rig, fit.posed, fit.problem, fit.solution, tuple(rejected))
        moment = fit.posed[worst].view.view
        rejected += _misfits(fit, moment)
        posed, rig = [p for p in fit.posed if p.view.view != moment], fit.rig
        require_pairs(posed, tree, rejected)


def laid_out(
    posed: Sequence[PosedView], board: Board, rig: Rig, weighted: bool
) -> tuple[BundleProblem, BundleState]:
    """Return the joint problem of all views and where to begin."""
    names = [camera.name for camera in rig.cameras]
    problem = bundle_problem([p.view for p in posed], board, names, weighted=weighted, shaped=True)
    return problem, bundle_state(problem, rig, [p.camera_from_board for p in posed])


def _adjusted(
    posed: Sequence[PosedView], board: Board, rig: Rig, weighted: bool
) -> tuple[JointFit, int | None]:
    """Adjust everything together once; say which view is wrong, if one is."""
    problem, start = laid_out(posed, board, rig, weighted)
    solution, worst = adjust_wary(problem, start)
    adjusted = rig_from_state(solution.state, rig.cameras)
    poses = _reposed(posed, problem, solution, adjusted)
    return JointFit(adjusted, poses, problem, solution, ()), worst


def _reposed(
    posed: Sequence[PosedView], problem: BundleProblem, solution: BundleSolution, rig: Rig
) -> tuple[PosedView, ...]:
    """Return the views with the adjusted pose of the board in each camera's frame."""
    state = solution.state
    moments = [
        RigidTransform(R, t)
        for R, t in zip(state.board_rotations, state.board_translations_mm, strict=True)
    ]
    result = []
    for row, p in enumerate(posed):
        pose = moments[problem.moment[row]]
        if not problem.alone[row]:
            pose = rig.reference_from_camera[problem.camera[row]].inverse() @ pose
        result.append(PosedView(p.view, pose))
    return tuple(result)


def _misfits(fit: JointFit, moment: str) -> list[RejectedView]:
    each = [rms(r) for r in fit.residuals_px]
    median = float(np.median(each))
    return [
        RejectedView(
            p.view.camera,
            moment,
            f"the cameras' images of this moment fit no common position of the board: {value:.2f} "
            f"px rms where half of the views miss by less than {median:.2f} px; the board moved "
            "between the exposures or the file names do not match",
        )
        for p, value in zip(fit.posed, each, strict=True)
        if p.view.view == moment
    ]


def require_invertible(joint: JointFit) -> None:
    """Refuse a distortion that was fitted so freely that it folds among the corners.

    Raises
    ------
    CalibrationError
        If a corner found has no inverse.
    """
    for camera in joint.rig.cameras:
        pixels = np.concatenate(
            [p.view.pixels for p in joint.posed if p.view.camera == camera.name]
        )
        try:
            camera.normalized_from_pixels(pixels)
        except DataError as error:
            raise undetermined(error) from error


def require_common_moments(joint: JointFit, posed: Sequence[PosedView]) -> None:
    """Refuse cameras that fit together only at some of their moments.

    A moment or two at which the board moved can be left out. Where it is a third, those that are
    left merely happened to be near enough, and what they say of the rig is an accident.

    Parameters
    ----------
    joint
        The joint adjustment.
    posed
        The views it began with.

    Raises
    ------
    CalibrationError
        With the moments, and how far the board moved from one picture to the next if it was filmed.
    """
    count: dict[str, int] = {}
    for p in posed:
        count[p.view.view] = count.get(p.view.view, 0) + 1
    shared = [moment for moment, cameras in count.items() if cameras > 1]
    wrong = list(dict.fromkeys(r.view for r in joint.rejected if count.get(r.view, 0) > 1))
    if len(wrong) < FEWEST_MISFITS or len(wrong) < LARGEST_MISFIT_PART * len(shared):
        return
    single = rms(np.concatenate(joint.residuals_px))
    more = f" and {len(wrong) - 6} more" if len(wrong) > 6 else ""
    raise CalibrationError(
        f"the cameras are not synchronised, or the board was moving: at {len(wrong)} of "
        f"{len(shared)} moments their images fit no common position of the board "
        f"({', '.join(wrong[:6])}{more}), although the others fit to {single:.2f} px rms"
        f"{_filmed([p.view for p in posed])}",
        next_step="hold the board still on a stand for each pair of images, or trigger all cameras "
        "at once and expose briefly, and take the board images again",
    )


def _filmed(views: Sequence[BoardView]) -> str:
    """Say how far the board moved between successive pictures, if that is little: it was filmed."""
    steps, reach = [], 0.0
    for name in sorted({view.camera for view in views}):
        mine = sorted((v for v in views if v.camera == name), key=lambda view: view.view)
        reach = max(reach, *(float(np.ptp(v.pixels, axis=0).max()) for v in mine))
        for before, after in pairwise(mine):
            _, a, b = np.intersect1d(before.ids, after.ids, return_indices=True)
            if len(a):
                moved = np.linalg.norm(after.pixels[b] - before.pixels[a], axis=1)
                steps.append(float(moved.mean()))
    step = float(np.median(steps)) if steps else np.inf
    if step > FILMED * reach:
        return ""
    return (
        f". From each picture to the next the board moved by {step:.0f} px: it was filmed in motion"
    )


def require_agreement(joint: JointFit, alone: Mapping[str, CameraCalibration]) -> None:
    """Refuse cameras that fit alone but not together: then no rig explains the images.

    Raises
    ------
    CalibrationError
        If the corners miss by more than three times as much, and 0.2 px, in the joint fit. Good
        sets keep this ratio under 1.2; a webcam pair filmed in motion had 3.6 to 8.
    """
    single = rms(np.concatenate([r for c in alone.values() for r in c.residuals_px]))
    together = rms(np.concatenate(joint.residuals_px))
    if together > max(LARGEST_JOINT_PX, 3 * single):
        raise CalibrationError(
            f"each camera fits its own board images to {single:.2f} px rms, but no common rig fits "
            f"them better than to {together:.2f} px: the images of a pair were not taken at the "
            "same moment, or a camera moved",
            next_step="hold the board still on a stand for each pair, fix the cameras, and take "
            "the board images again",
        )
