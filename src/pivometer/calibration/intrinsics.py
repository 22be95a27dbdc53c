"""One camera's calibration matrix (17) and distortion (18) from views of a board, after Zhang."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from pivometer._arrays import Floats
from pivometer.calibration.board import Board, BoardView
from pivometer.calibration.bundle import (
    GROSS_RATIO,
    BundleProblem,
    BundleSolution,
    BundleState,
    adjust,
    adjust_wary,
    bundle_problem,
    inverse_information,
    residual_variance,
)
from pivometer.calibration.homography import homography
from pivometer.calibration.result import RejectedView
from pivometer.cameras import Camera
from pivometer.cameras.distortion import MODELS, DistortionModel, fold_radius, image_reach
from pivometer.errors import CalibrationError
from pivometer.geometry.rigid import RigidTransform

T = TypeVar("T")
NOMINAL_PX = 0.1
"""Corner noise for which the geometry of the views must suffice: the paper's detector."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraCalibration:
    """One calibrated camera and the board poses in its frame.

    Parameters
    ----------
    camera
        The camera.
    views
        The views used.
    camera_from_board
        Pose of the board in each of them.
    residuals_px
        Projected minus found corners of each, shape (k, 2), px.
    covariance
        Covariance of ``camera.parameters``, shape (4+m, 4+m).
    rejected
        The views that did not fit.
    """

    camera: Camera
    views: tuple[BoardView, ...]
    camera_from_board: tuple[RigidTransform, ...]
    residuals_px: tuple[Floats, ...]
    covariance: Floats
    rejected: tuple[RejectedView, ...]

    @property
    def rms_px(self) -> float:
        """Root-mean-square distance between corners found and projected, px."""
        return rms(np.concatenate(self.residuals_px))


def rms(residuals_px: Floats) -> float:
    """Return the root-mean-square length of residuals of shape (k, 2).

    Examples
    --------
    >>> rms(np.array([[3.0, 4.0], [0.0, 5.0]]))
    5.0
    """
    return float(np.sqrt(np.mean(np.sum(residuals_px**2, axis=-1))))


def calibration_matrix_from_homographies(
    homographies: Sequence[Floats], width: int, height: int
) -> Floats:
    """Return K of (17) in closed form from the image of the absolute conic, shape (3, 3), px.

    Every homography H gives h₁ᵀ B h₂ = 0 and h₁ᵀ B h₁ = h₂ᵀ B h₂ with B ~ K⁻ᵀ K⁻¹ and no skew.
    Where the views are tilted too little for all four parameters, the principal point is put at
    the centre of the image and only the focal lengths are solved for; failing that, the focal
    length is put at the width of the image. The adjustment that follows corrects all of them.

    References
    ----------
    Zhang, section 3.1 (the paper's reference [16]).
    """
    centre = np.array([(width - 1) / 2, (height - 1) / 2])
    to_unit = np.array(
        [[1 / width, 0, -centre[0] / width], [0, 1 / width, -centre[1] / width], [0, 0, 1]]
    )
    rows = _conic_rows([to_unit @ H for H in homographies])
    guesses = (_conic_null_vector(rows), _conic_centred(rows), np.array([1.0, 1, 0, 0, 1]))
    for b in guesses:
        K = _matrix_from_conic(b)
        if K is not None:
            break
    else:
        K = np.eye(3)
    result: Floats = np.linalg.inv(to_unit) @ K
    return result


def _conic_rows(homographies: Sequence[Floats]) -> Floats:
    """Zhang's V without skew: rows over (B₁₁, B₂₂, B₁₃, B₂₃, B₃₃)."""

    def row(h: Floats, g: Floats) -> Floats:
        return np.array(
            [h[0] * g[0], h[1] * g[1], h[0] * g[2] + h[2] * g[0], h[1] * g[2] + h[2] * g[1],
             h[2] * g[2]]
        )  # fmt: skip

    rows = []
    for H in homographies:
        h, g = (H / np.linalg.norm(H[:, :2])).T[:2]
        rows += [row(h, g), row(h, h) - row(g, g)]
    return np.array(rows)


def _conic_null_vector(rows: Floats) -> Floats:
    vector: Floats = np.linalg.svd(rows)[2][-1]
    return vector


def _conic_centred(rows: Floats) -> Floats:
    focal = np.linalg.lstsq(rows[:, :2], -rows[:, 4], rcond=None)[0]
    return np.array([*focal, 0.0, 0.0, 1.0])


def _matrix_from_conic(b: Floats) -> Floats | None:
    """Return K in units of the image width, or `None` where the conic is not that of a camera."""
    b11, b22, b13, b23, b33 = b if b[0] > 0 else -b
    if b11 <= 0 or b22 <= 0:
        return None
    centre = np.array([-b13 / b11, -b23 / b22])
    size = b33 - b13**2 / b11 - b23**2 / b22
    focal2 = np.array([size / b11, size / b22])
    if not ((focal2 > 0.1**2) & (focal2 < 50.0**2)).all() or np.abs(centre).max() > 0.5:
        return None
    fx, fy = np.sqrt(focal2)
    return np.array([[fx, 0, centre[0]], [0, fy, centre[1]], [0, 0, 1]])


def camera_from_board_pose(K: Floats, H: Floats, corners_mm: Floats) -> RigidTransform:
    """Return ``camera_from_board`` of one view from H ~ K [r₁ r₂ t], the board in front.

    References
    ----------
    Zhang, section 3.1.
    """
    columns = np.linalg.solve(K, H)
    columns = columns / np.sqrt(np.linalg.norm(columns[:, 0]) * np.linalg.norm(columns[:, 1]))
    if columns[2] @ [*corners_mm[:, :2].mean(axis=0), 1.0] < 0:
        columns = -columns
    left, _, right = np.linalg.svd(
        np.stack([*columns.T[:2], np.cross(columns[:, 0], columns[:, 1])], axis=1)
    )
    return RigidTransform(left @ right, columns[:, 2])


def calibrate_camera(
    views: Sequence[BoardView],
    board: Board,
    size: tuple[int, int],
    *,
    camera: str,
    weighted: bool = False,
    distortion: DistortionModel = "radial2",
) -> CameraCalibration:
    """Calibrate one camera from all its views of the board.

    Homographies, closed-form K (Zhang), then Levenberg–Marquardt over K, the distortion and all
    board poses. A view that does not fit (more than 5 times the median view's rms, and more than
    1 px) is rejected and the rest fitted again.

    Parameters
    ----------
    views
        Its views, at least three, tilted in several directions.
    board
        The board.
    size
        Width and height of its images, px.
    camera
        Its name.
    weighted
        Weight corners by their ``sigma_px``.
    distortion
        The distortion model.

    Raises
    ------
    CalibrationError
        If there are too few views, they are tilted too little, or the result is absurd.

    References
    ----------
    Wilson et al., eqs. (17), (18); Zhang (the paper's reference [16]).
    """
    kept, rejected = usable_views(views, board)
    pixels_from_board = [homography(board.corners_mm[v.ids, :2], v.pixels) for v in kept]
    kept, flat, bad = _reject_non_planar(kept, pixels_from_board, board)
    rejected += bad
    _require_views(kept, rejected, camera)
    K = calibration_matrix_from_homographies(flat, *size)
    start = Camera(camera, *size, K[[0, 1], [0, 1]], K[:2, 2], np.zeros(MODELS[distortion]))
    poses = [
        camera_from_board_pose(K, H, board.corners_mm[v.ids])
        for v, H in zip(kept, flat, strict=True)
    ]
    while True:
        fit, worst = _adjusted(kept, board, start, poses, weighted)
        if worst is None:
            break
        rejected.append(_misfit(fit, worst))
        start, kept, poses = (
            fit.camera,
            _without(kept, worst),
            _without(fit.camera_from_board, worst),
        )
        _require_views(kept, rejected, camera)
    check_plausible(fit)
    return CameraCalibration(
        fit.camera, fit.views, fit.camera_from_board, fit.residuals_px, fit.covariance,
        tuple(rejected),
    )  # fmt: skip


def usable_views(
    views: Sequence[BoardView], board: Board
) -> tuple[list[BoardView], list[RejectedView]]:
    """Split off views with fewer than six corners or with all of them near one line."""
    kept, rejected = [], []
    for view in views:
        grid = board.corners_mm[view.ids, :2] / board.square_mm
        spread = np.linalg.svd(grid - grid.mean(axis=0))[1] if len(grid) else np.zeros(2)
        if len(grid) < 6 or spread[1] < 1.0:
            reason = f"only {len(grid)} corners, or all near one line"
            rejected.append(RejectedView(view.camera, view.view, reason))
        else:
            kept.append(view)
    return kept, rejected


def _reject_non_planar(
    views: Sequence[BoardView], homographies: Sequence[Floats], board: Board
) -> tuple[list[BoardView], list[Floats], list[RejectedView]]:
    """Reject views whose corners are no image of a plane: the detector was wrong."""
    misfits = []
    for view, H in zip(views, homographies, strict=True):
        flat = board.corners_mm[view.ids, :2] @ H[:, :2].T + H[:, 2]
        misfits.append(rms(flat[:, :2] / flat[:, 2:] - view.pixels))
    # distortion alone makes homographies miss by up to 1–3 px, unequally: hence the wider limit
    limit = max(3.0, GROSS_RATIO * float(np.median(misfits))) if misfits else 0.0
    good = [i for i, misfit in enumerate(misfits) if misfit <= limit]
    rejected = [
        RejectedView(
            views[i].camera,
            views[i].view,
            f"its corners are no image of a flat board: they miss one by {misfits[i]:.1f} px rms",
        )
        for i in range(len(views))
        if i not in good
    ]
    return [views[i] for i in good], [homographies[i] for i in good], rejected


def _require_views(views: Sequence[object], rejected: Sequence[RejectedView], camera: str) -> None:
    if len(views) >= 3:
        return
    also = "".join(f"; {r.view}: {r.reason}" for r in rejected)
    raise CalibrationError(
        f"camera {camera}: {len(views)} usable board views, at least 3 are needed{also}",
        next_step="add images of the board, tilted by 20° to 45° in several directions",
    )


def _adjusted(
    views: Sequence[BoardView],
    board: Board,
    start: Camera,
    poses: Sequence[RigidTransform],
    weighted: bool,
) -> tuple[CameraCalibration, int | None]:
    """Adjust one camera and its board poses; say which view is wrong, if one is."""
    problem, state = _laid_out(views, board, start, poses, weighted)
    try:
        solution, worst = adjust_wary(problem, state)
    except CalibrationError as error:
        what = f"camera {start.name}: {error.what}"
        raise CalibrationError(what, next_step=_advice(error.next_step, start)) from error
    found = problem.weights > 0
    errors = [r[f] for r, f in zip(solution.residuals_px, found, strict=True)]
    spread = residual_variance(problem, solution) * _determined(solution, start)
    poses = [
        RigidTransform(R, t)
        for R, t in zip(
            solution.state.board_rotations, solution.state.board_translations_mm, strict=True
        )
    ]
    camera = start.with_parameters(_finite_parameters(solution, start.name))
    fit = CameraCalibration(camera, tuple(views), tuple(poses), tuple(errors), spread, ())
    return fit, worst


def _laid_out(
    views: Sequence[BoardView],
    board: Board,
    start: Camera,
    poses: Sequence[RigidTransform],
    weighted: bool,
) -> tuple[BundleProblem, BundleState]:
    """Return the adjustment of one camera and where it begins."""
    problem = bundle_problem(_each_alone(views), board, [start.name], weighted=weighted)
    state = BundleState(
        start.parameters[None],
        np.eye(3)[None],
        np.zeros((1, 3)),
        np.array([pose.rotation for pose in poses]),
        np.array([pose.translation_mm for pose in poses]),
    )
    return problem, state


def _each_alone(views: Sequence[BoardView]) -> list[BoardView]:
    """Give every view a moment of its own: a camera calibrated alone shares none."""
    return [BoardView(v.camera, f"{i}", v.ids, v.pixels, v.sigma_px) for i, v in enumerate(views)]


def _finite_parameters(solution: BundleSolution, name: str) -> Floats:
    values: Floats = solution.state.intrinsics[0]
    if np.isfinite(values).all() and (values[:2] > 0).all():
        return values
    raise CalibrationError(
        f"camera {name}: the fit of the board views ran away (focal lengths {values[:2]} px)",
        next_step="add board views tilted by 20° to 45° in several directions",
    )


def _determined(solution: BundleSolution, camera: Camera) -> Floats:
    """Return the inverse information if corners good to 0.1 px would determine the camera."""
    try:
        inverse: Floats = inverse_information(solution)
        u = NOMINAL_PX * np.sqrt(np.diag(inverse))
    except CalibrationError:
        u = np.full(solution.state.intrinsics.shape[1], np.inf)
    focal = float((u[:2] / solution.state.intrinsics[0, :2]).max())
    centre = float((u[2:4] / [camera.width, camera.height]).max())
    # measured at 0.1 px: 30 good views give 0.1 % and 0.2 %, three 0.4–1.2 % and 0.4–2 %
    if not (focal < 0.05 and centre < 0.05):
        raise CalibrationError(
            f"camera {camera.name}: the board views do not determine it: even corners good to "
            f"{NOMINAL_PX} px would leave its focal length uncertain by {100 * focal:.0f} % and "
            f"its principal point by {100 * centre:.0f} % of the image",
            next_step=_advice("add board views tilted by 20° to 45° in several directions", camera),
        )
    return inverse


def _advice(next_step: str, camera: Camera) -> str:
    """Add that fewer coefficients may do, where there are more than the paper's two."""
    more = len(camera.distortion) > MODELS["radial2"]
    return next_step + (", or choose a distortion model of fewer coefficients" if more else "")


def _misfit(fit: CameraCalibration, index: int) -> RejectedView:
    view = fit.views[index]
    others = float(np.median([rms(r) for r in fit.residuals_px]))
    return RejectedView(
        view.camera,
        view.view,
        f"its corners miss the fitted camera by {rms(fit.residuals_px[index]):.2f} px rms where "
        f"half of the views miss by less than {others:.2f} px",
    )


def _without(items: Sequence[T], index: int) -> list[T]:
    return [item for i, item in enumerate(items) if i != index]


def check_plausible(fit: CameraCalibration) -> None:
    """Refuse a fit that no real camera has.

    Raises
    ------
    CalibrationError
        If the principal point is far outside the image, the corners do not fit, or the distortion
        folds inside the region the corners cover.
    """
    camera = fit.camera
    size = np.array([camera.width, camera.height])
    off = np.abs(camera.principal_point_px / size - 0.5).max()
    beyond = np.concatenate([v.pixels for v in fit.views]) - camera.principal_point_px
    reach = float(np.linalg.norm(beyond / camera.focal_px, axis=1).max())
    folded = image_reach(camera.distortion)
    if off > 1.0:
        fault = f"its principal point is at {camera.principal_point_px.round(1)} px"
    elif fit.rms_px > max(2.0, 0.005 * float(np.hypot(*size))):
        fault = f"the corners miss the fitted camera by {fit.rms_px:.1f} px rms"
    elif np.isfinite(fold_radius(camera.distortion)) and reach > folded:
        fault = (
            f"its distortion folds at normalized radius {folded:.3f}, corners lie at {reach:.3f}"
        )
    else:
        return
    raise CalibrationError(
        f"camera {camera.name}: {fault}",
        next_step="check the number of squares of the board and that the images are of it, sharp "
        "and unscaled",
    )


def recalibrated(
    calibration: CameraCalibration, board: Board, moments: Sequence[str], *, weighted: bool = False
) -> Camera:
    """Return a camera fitted again to its views of the named moments only, from where it is.

    Parameters
    ----------
    calibration
        A finished calibration.
    board
        The board.
    moments
        Values of ``view`` to keep.
    weighted
        Weight corners by their ``sigma_px``.
    """
    wanted = set(moments)
    kept = [i for i, view in enumerate(calibration.views) if view.view in wanted]
    problem, state = _laid_out(
        [calibration.views[i] for i in kept],
        board,
        calibration.camera,
        [calibration.camera_from_board[i] for i in kept],
        weighted,
    )
    solution = adjust(problem, state)
    return calibration.camera.with_parameters(_finite_parameters(solution, calibration.camera.name))
