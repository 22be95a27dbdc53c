"""Calibrate a rig: from board corners to cameras, their poses, and how far to trust them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from pivometer._arrays import Floats
from pivometer.calibration.board import Board, BoardView
from pivometer.calibration.bundle import covariance, residual_variance, view_inflation
from pivometer.calibration.distortion_choice import wider_model_note
from pivometer.calibration.form_choice import other_form_note
from pivometer.calibration.half_turn import (
    Numbering,
    PosedView,
    Tree,
    camera_tree,
    numbered_alike,
    pair_counts,
    relative_pose_by_vote,
    require_pairs,
)
from pivometer.calibration.intrinsics import CameraCalibration, calibrate_camera
from pivometer.calibration.joint_route import (
    JointFit,
    joint_fit,
    require_agreement,
    require_common_moments,
    require_invertible,
)
from pivometer.calibration.metric_scale import length_error, reconstructed_edges
from pivometer.calibration.paper_route import (
    UsedViews,
    chained_rig,
    jackknife_covariance,
    shrunk_covariance,
)
from pivometer.calibration.quality import (
    HeldOut,
    camera_quality,
    epipolar_rms,
    held_out_lengths,
    quality_notes,
)
from pivometer.calibration.result import (
    Calibration,
    CameraQuality,
    LengthError,
    PaperRoute,
    RejectedView,
)
from pivometer.cameras import Rig
from pivometer.cameras.distortion import MODELS, DistortionModel
from pivometer.errors import UsageError
from pivometer.geometry.rigid import RigidTransform

__all__ = [
    "Calibration",
    "CameraQuality",
    "LengthError",
    "PaperRoute",
    "RejectedView",
    "calibrate_rig",
]

Method = Literal["joint", "paper"]
INFLATION_TOLD = 4.0
"""Real boards, bowed or unevenly printed, reach this factor of the variance; pure noise 1.5."""


def calibrate_rig(
    views: Sequence[BoardView],
    board: Board,
    image_sizes: Mapping[str, tuple[int, int]],
    *,
    reference: str,
    method: Method = "joint",
    distortion: DistortionModel = "radial2",
    weighted: bool = False,
) -> Calibration:
    """Calibrate all cameras and their relative poses from views of one board.

    Each camera alone (Zhang), corners numbered alike in all cameras, relative pose by the paper's
    two steps (eight-point and bundle adjustment of (19) under (20), then the metric upgrade (21)),
    and the joint bundle adjustment of everything. Both rigs are kept; `method` says which one the
    result is. At 0.1 px of corner noise the joint rig locates a point near the RCM two to three
    times better, which is why it is the default.

    Parameters
    ----------
    views
        Corners found. Views of the same ``view`` name by several cameras are of one moment.
    board
        The board.
    image_sizes
        Width and height of each camera's images, px.
    reference
        The camera whose frame the results are in.
    method
        ``"joint"`` or ``"paper"``.
    distortion
        The distortion model of all cameras: ``"none"``, ``"radial2"`` (the paper's),
        ``"brown5"`` or ``"rational8"``. A note says so where held-out edges show that the next
        wider one is better.
    weighted
        Weight corners by their ``sigma_px`` instead of alike.

    Raises
    ------
    UsageError
        If the method or the distortion model does not exist, or the reference or the camera of a
        view is not one of the cameras.
    CalibrationError
        If the views do not determine the rig; the message names the camera and what to add.

    References
    ----------
    Wilson et al., section IV and eq. (21).
    """
    _require_known(method, distortion)
    names = _names(views, image_sizes, reference)
    alone = {
        n: calibrate_camera(
            [v for v in views if v.camera == n],
            board,
            image_sizes[n],
            camera=n,
            weighted=weighted,
            distortion=distortion,
        )
        for n in names
    }
    posed = [PosedView(v, t) for c in alone.values() for v, t in _views_and_poses(c)]
    tree = camera_tree([p.view for p in posed], names)
    rig = _voted_rig(posed, board, alone, tree)
    numbering = numbered_alike(posed, board, rig)
    require_pairs(numbering.views, tree, numbering.rejected)
    joint = joint_fit(numbering.views, board, rig, weighted, tree)
    used = UsedViews(tuple(p.view for p in joint.posed), board, alone, tree, weighted)
    require_common_moments(joint, numbering.views)
    require_agreement(joint, alone)
    require_invertible(joint)
    paper = used.paper_route()
    rejected = tuple(r for c in alone.values() for r in c.rejected)
    rejected += numbering.rejected + joint.rejected
    parts = _finish_joint(joint, used)
    remarks = _remarks(numbering, parts.inflation)
    remarks += other_form_note(joint, board, weighted=weighted)
    remarks += wider_model_note(joint, used, parts.held_out)
    if method == "paper":
        parts = _finish_paper(paper, used, parts)
    made = _assembled(parts, used, paper, rejected, remarks, method)
    return made if board.form == "flat" else replace(made, board_shape=joint.board_shape)


def _require_known(method: str, distortion: str) -> None:
    """Refuse a method or a distortion model that does not exist."""
    if method not in get_args(Method):
        raise UsageError(
            f"calibration method {method!r} is neither 'joint' nor 'paper'",
            next_step="choose one of the two",
        )
    if distortion not in MODELS:
        raise UsageError(
            f"there is no distortion model {distortion!r}",
            next_step=f"choose one of {', '.join(MODELS)}",
        )


def _names(
    views: Sequence[BoardView], image_sizes: Mapping[str, tuple[int, int]], reference: str
) -> tuple[str, ...]:
    """Return the names of the cameras, the reference first, after checking them."""
    strange = sorted({v.camera for v in views} - set(image_sizes))
    if reference not in image_sizes or strange or len(image_sizes) < 2:
        raise UsageError(
            f"the cameras are {', '.join(sorted(image_sizes)) or 'none'}; the reference is "
            f"{reference!r}, and there are views of {', '.join(strange) or 'no other camera'}",
            next_step="name at least two cameras, among them the reference and those of all views",
        )
    return (reference, *(n for n in image_sizes if n != reference))


def _views_and_poses(
    calibration: CameraCalibration,
) -> list[tuple[BoardView, RigidTransform]]:
    return list(zip(calibration.views, calibration.camera_from_board, strict=True))


def _voted_rig(
    posed: Sequence[PosedView],
    board: Board,
    alone: Mapping[str, CameraCalibration],
    tree: Tree,
) -> Rig:
    """Put the cameras together from the relative poses that most moments agree on."""
    relative = {}
    for a, b in tree:
        mine = {p.view.view: p for p in posed if p.view.camera == a}
        theirs = {p.view.view: p for p in posed if p.view.camera == b}
        both = [moment for moment in mine if moment in theirs]
        relative[a, b] = relative_pose_by_vote(
            [mine[m] for m in both],
            [theirs[m] for m in both],
            board,
            (alone[a].camera, alone[b].camera),
        )
    return chained_rig(relative, {name: c.camera for name, c in alone.items()})


@dataclass(frozen=True, slots=True, eq=False)
class _Parts:
    """What the two methods deliver in their own ways."""

    rig: Rig
    covariance: Floats
    held_out: HeldOut
    poses: Mapping[tuple[str, str], RigidTransform]
    residuals_px: Mapping[tuple[str, str], Floats]
    noise_px: float
    inflation: float


def _key(view: BoardView) -> tuple[str, str]:
    return view.camera, view.view


def _finish_joint(joint: JointFit, used: UsedViews) -> _Parts:
    """Covariance and held-out error of the joint rig."""

    def estimate(moments: Sequence[str]) -> Rig:
        return joint.rig_from(moments, used.board, weighted=used.weighted)

    return _Parts(
        joint.rig,
        covariance(joint.problem, joint.solution),
        held_out_lengths(used.views, used.board, estimate),
        {_key(p.view): p.camera_from_board for p in joint.posed},
        {_key(p.view): r for p, r in zip(joint.posed, joint.residuals_px, strict=True)},
        float(np.sqrt(residual_variance(joint.problem, joint.solution))),
        view_inflation(joint.problem, joint.solution),
    )


def _finish_paper(paper: PaperRoute, used: UsedViews, joint: _Parts) -> _Parts:
    """Covariance (delete-one-moment jackknife) and held-out error of the paper's rig."""

    def estimate(moments: Sequence[str]) -> Rig:
        return used.paper_rig(moments, paper.rig)

    poses = {_key(v): t for c in used.alone.values() for v, t in _views_and_poses(c)}
    residuals = {
        _key(v): r
        for c in used.alone.values()
        for v, r in zip(c.views, c.residuals_px, strict=True)
    }
    jackknife, rank = jackknife_covariance(used, paper.rig)
    counted = [residuals[_key(view)] for view in used.views]
    squares = sum(float(np.sum(r**2)) for r in counted)
    unknowns = sum(len(c.camera.parameters) for c in used.alone.values())
    redundancy = sum(r.size - 6 for r in counted) - unknowns
    return _Parts(
        paper.rig,
        shrunk_covariance(jackknife, rank, joint.covariance),
        held_out_lengths(used.views, used.board, estimate),
        poses,
        residuals,
        float(np.sqrt(squares / max(1, redundancy))),
        joint.inflation,
    )


def _scale_covariance(rig: Rig, board: Board) -> Floats:
    """Return what the uncertainty of the square size adds: one scale for all baselines."""
    effect = np.zeros(len(rig.parameter_names))
    relative = (board.square_u_mm or 0.0) / board.square_mm
    poses = effect[-6 * (len(rig.cameras) - 1) :].reshape(-1, 6)
    poses[:, 3:] = [relative * t.translation_mm for t in rig.reference_from_camera[1:]]
    return np.outer(effect, effect)


def _assembled(
    parts: _Parts,
    used: UsedViews,
    paper: PaperRoute,
    rejected: tuple[RejectedView, ...],
    remarks: tuple[str, ...],
    method: Method,
) -> Calibration:
    rig, board = parts.rig, used.board
    total = parts.covariance + _scale_covariance(rig, board)
    cameras, end = [], 0
    for camera in rig.cameras:
        views = [v for v in used.views if v.camera == camera.name]
        own = slice(end, end := end + len(camera.parameters))
        cameras.append(
            camera_quality(
                camera,
                views,
                [parts.poses[_key(v)] for v in views],
                [parts.residuals_px[_key(v)] for v in views],
                total[own, own],
            )
        )
    notes = quality_notes(cameras, rig, pair_counts(used.views, used.tree))
    notes += remarks
    return Calibration(
        rig=rig,
        covariance=total,
        edge_length_error=length_error(
            reconstructed_edges(used.views, board, rig), board.square_mm
        ),
        held_out=parts.held_out.error(board.square_mm),
        cameras=tuple(cameras),
        epipolar_rms_px=epipolar_rms(used.views, rig),
        board=board,
        views=used.views,
        rejected=rejected,
        notes=notes,
        method=method,
        paper=paper,
        noise_px=parts.noise_px,
    )


def _remarks(numbering: Numbering, inflation: float) -> tuple[str, ...]:
    """Say what was done to the views and what the residuals give away."""
    notes = []
    if numbering.turned:
        notes.append(
            f"{len(numbering.turned)} board images were numbered from the other end, because the "
            f"board looks the same after a turn: {', '.join(numbering.turned)}"
        )
    if inflation > INFLATION_TOLD:
        notes.append(
            "the corners of an image miss together rather than each at random, as with an "
            "unevenly printed board, unsharp images or distortion that the chosen model cannot "
            f"describe; the stated uncertainty is {np.sqrt(inflation):.1f} times larger for it"
        )
    return tuple(notes)
