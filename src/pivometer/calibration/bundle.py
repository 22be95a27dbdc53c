"""Bundle adjustment of cameras and board poses over all board views.

Minimises the squared distance in the image, px, between the corners found and the corners of the
known board projected by (4), (17) and (18) or a wider distortion model, over the intrinsics of
every camera, the pose of every further camera in the reference camera's frame, and the pose of the
board in every view; on request also over the shape of the board.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.calibration.arrowhead import NormalEquations, minimise, solve_scaled
from pivometer.calibration.board import Board, BoardView
from pivometer.calibration.board_shape import shape_modes
from pivometer.cameras import Camera, Rig
from pivometer.cameras.distortion import coefficient_jacobian, distort, distort_jacobian
from pivometer.errors import CalibrationError
from pivometer.geometry.rigid import RigidTransform, rotation_from_vector

Ints = NDArray[np.int64]

TOLERANCE = 1e-9
"""Relative fall of the cost at which a fit ends: with 3000 coordinates the step before moved the
result by 0.002 of its standard uncertainty, and the last one far less."""
GROSS_RATIO = 5.0
"""A view this many times worse than the median view is wrong, not noisy: the rms of good views of
one camera stay within a factor 3 of each other on every real set at hand."""
GROSS_PX = 0.3
"""Below this no view is called wrong, however good the others are: a board that moved by a tenth
of a millimetre between two exposures stays below it and moves the rig by less than it states."""


@dataclass(frozen=True, slots=True, eq=False)
class BundleProblem:
    """Corners found, laid out densely: one row per board view of one camera.

    Parameters
    ----------
    corners_mm
        Corners of the board, shape (n, 3), mm.
    pixels
        Image points, shape (g, n, 2), px; zero where a corner was not found.
    weights
        Weight of each corner's residual, shape (g, n); zero where it was not found.
    camera, moment
        For each row the index of its camera and of its moment (board pose), shape (g,).
    alone
        Whether only one camera saw that moment; its board pose is then kept in that camera's own
        frame and says nothing of the rig, shape (g,).
    shape_modes
        The b ways in which the corners may be displaced from the drawing, shape (n, 3, b), as
        `board_shape.shape_modes` returns them; b is 0 where the board is taken as drawn.
    """

    corners_mm: Floats
    pixels: Floats
    weights: Floats
    camera: Ints
    moment: Ints
    alone: NDArray[np.bool_]
    shape_modes: Floats

    @property
    def camera_count(self) -> int:
        """Number of cameras."""
        return int(self.camera.max()) + 1

    @property
    def moment_count(self) -> int:
        """Number of moments, each with one board pose."""
        return int(self.moment.max()) + 1


@dataclass(frozen=True, slots=True, eq=False)
class BundleState:
    """Values of all unknowns.

    Parameters
    ----------
    intrinsics
        f s_x, f s_y, o_x, o_y (px) and m distortion coefficients of every camera, all of one
        model, shape (c, 4 + m).
    rotations, translations_mm
        ``reference_from_camera``, shapes (c, 3, 3) and (c, 3).
    board_rotations, board_translations_mm
        ``reference_from_board`` of every moment (``camera_from_board`` where one camera saw it),
        shapes (m, 3, 3) and (m, 3).
    shape_mm
        How far the board's corners are displaced in each way of `BundleProblem.shape_modes`, (b,).
    """

    intrinsics: Floats
    rotations: Floats
    translations_mm: Floats
    board_rotations: Floats
    board_translations_mm: Floats
    shape_mm: Floats = field(default_factory=lambda: np.zeros(0))

    def moved(self, shared: Floats, local: Floats) -> BundleState:
        """Return the state after a step of the shared unknowns and of each board pose.

        The shared ones stand in `Rig.parameter_names`' order, the board's shape behind them.
        """
        inner, rig = self.intrinsics.size, len(shared) - len(self.shape_mm)
        turn = np.zeros((len(self.intrinsics), 6))
        turn[1:] = shared[inner:rig].reshape(-1, 6)
        return BundleState(
            self.intrinsics + shared[:inner].reshape(self.intrinsics.shape),
            rotation_from_vector(turn[:, :3]) @ self.rotations,
            self.translations_mm + turn[:, 3:],
            rotation_from_vector(local[:, :3]) @ self.board_rotations,
            self.board_translations_mm + local[:, 3:],
            self.shape_mm + shared[rig:],
        )


@dataclass(frozen=True, slots=True, eq=False)
class BundleSolution:
    """The adjusted state and what it rests on.

    Parameters
    ----------
    state
        All unknowns at the minimum.
    residuals_px
        Projected minus found, shape (g, n, 2), px; zero where a corner was not found.
    information
        Each moment's information on the shared unknowns, shape (m, d, d).
    scores
        Each moment's share of the shared gradient, shape (m, d); they sum to zero.
    degrees_of_freedom
        Measured coordinates minus unknowns.
    """

    state: BundleState
    residuals_px: Floats
    information: Floats
    scores: Floats
    degrees_of_freedom: int


def bundle_problem(
    views: Sequence[BoardView],
    board: Board,
    names: Sequence[str],
    *,
    weighted: bool = False,
    shaped: bool = False,
) -> BundleProblem:
    """Lay out board views for the adjustment, one row each, in the order given.

    Parameters
    ----------
    views
        Board views; those with the same ``view`` are of the same moment.
    board
        The board.
    names
        Names of the cameras, the reference first.
    weighted
        Weight each corner by the inverse of its ``sigma_px``, relative to the rms weight.
    shaped
        Whether the board's shape is unknown as far as its `form` says; else it is as drawn.
    """
    moments = {name: i for i, name in enumerate(dict.fromkeys(v.view for v in views))}
    moment = np.array([moments[view.view] for view in views], dtype=np.int64)
    pixels = np.zeros((len(views), board.corner_count, 2))
    weights = np.zeros((len(views), board.corner_count))
    for row, view in enumerate(views):
        pixels[row, view.ids] = view.pixels
        weights[row, view.ids] = 1 / view.sigma_px if weighted else 1.0
    if weighted:
        weights /= np.sqrt(np.mean(weights[weights > 0] ** 2))
    index = {name: i for i, name in enumerate(names)}
    camera = np.array([index[view.camera] for view in views], dtype=np.int64)
    alone = np.bincount(moment)[moment] == 1
    modes = shape_modes(board) if shaped else np.zeros((board.corner_count, 3, 0))
    return BundleProblem(board.corners_mm, pixels, weights, camera, moment, alone, modes)


def bundle_state(
    problem: BundleProblem, rig: Rig, camera_from_board: Sequence[RigidTransform]
) -> BundleState:
    """Start from a rig and each row's board pose; of several the first camera's counts."""
    own = RigidTransform.identity()
    poses: dict[int, RigidTransform] = {}
    for row, pose in enumerate(camera_from_board):
        frame = own if problem.alone[row] else rig.reference_from_camera[problem.camera[row]]
        poses.setdefault(int(problem.moment[row]), frame @ pose)
    ordered = [poses[i] for i in range(problem.moment_count)]
    return BundleState(
        np.array([camera.parameters for camera in rig.cameras]),
        np.array([t.rotation for t in rig.reference_from_camera]),
        np.array([t.translation_mm for t in rig.reference_from_camera]),
        np.array([t.rotation for t in ordered]),
        np.array([t.translation_mm for t in ordered]),
        np.zeros(problem.shape_modes.shape[2]),
    )


def rig_from_state(state: BundleState, cameras: Sequence[Camera]) -> Rig:
    """Return the rig of an adjusted state, named and sized like `cameras`."""
    adjusted = [c.with_parameters(p) for c, p in zip(cameras, state.intrinsics, strict=True)]
    poses = [
        RigidTransform(_orthonormal(rotation), translation)
        for rotation, translation in zip(state.rotations, state.translations_mm, strict=True)
    ]
    return Rig(adjusted, [RigidTransform.identity(), *poses[1:]])


def _orthonormal(rotation: Floats) -> Floats:
    """Remove the rounding that many small turns leave in a rotation."""
    left, _, right = np.linalg.svd(rotation)
    nearest: Floats = left @ right
    return nearest


@dataclass(frozen=True, slots=True, eq=False)
class _Projection:
    """Everything the residuals and their derivatives need, per row and corner."""

    turned: Floats  # board corners turned into the pose's frame, before the translation
    local: Floats  # relative to the camera's centre, in the pose's frame
    frame: Floats  # rotation of each row's camera, (g, 3, 3)
    depth: Floats
    normalized: Floats
    distorted: Floats
    pixels: Floats
    behind: bool


def _project(problem: BundleProblem, state: BundleState) -> _Projection:
    """Project the board of every row: (4), (18), then (17)."""
    corners = problem.corners_mm + problem.shape_modes @ state.shape_mm
    turned = corners @ np.swapaxes(state.board_rotations[problem.moment], 1, 2)
    frame = np.where(problem.alone[:, None, None], np.eye(3), state.rotations[problem.camera])
    centre = np.where(problem.alone[:, None], 0.0, state.translations_mm[problem.camera])
    local = turned + (state.board_translations_mm[problem.moment] - centre)[:, None]
    points = local @ frame
    found = problem.weights > 0
    behind = bool((points[..., 2][found] <= 0).any())
    depth = np.where(points[..., 2] > 0, points[..., 2], 1.0)
    normalized = points[..., :2] / depth[..., None]
    k = state.intrinsics[problem.camera][:, None]
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):  # `adjust` looks at it
        distorted = distort(normalized, k[..., 4:])
        pixels = distorted * k[..., :2] + k[..., 2:4]
    return _Projection(turned, local, frame, depth, normalized, distorted, pixels, behind)


def residuals(problem: BundleProblem, state: BundleState) -> Floats:
    """Return projected minus found corners, shape (g, n, 2), px; zero where none was found."""
    return _errors(problem, _project(problem, state))


def _errors(problem: BundleProblem, view: _Projection) -> Floats:
    return np.where(problem.weights[..., None] > 0, view.pixels - problem.pixels, 0.0)


def jacobian(problem: BundleProblem, state: BundleState) -> Floats:
    """Return the derivatives of `residuals`, shape (g, n, 2, 16 + m + b).

    By column: the camera's 4 + m intrinsics; its pose (left rotation vector, translation); the b
    coefficients of the board's shape; the board's pose (as the camera's).
    """
    columns = _derivatives(problem, state, _project(problem, state))
    return np.moveaxis(columns, (3, 2, 1), (1, 2, 3))


def _derivatives(problem: BundleProblem, state: BundleState, view: _Projection) -> Floats:
    """Return `jacobian` as (g, columns, 2, n): whole rows of numbers are quicker to work on."""
    k = state.intrinsics[problem.camera][:, None]
    inner, ways = state.intrinsics.shape[1], len(state.shape_mm)
    focal = np.swapaxes(k[..., :2], 1, 2)[:, None]
    J = np.zeros((len(k), inner + 12 + ways, 2, len(problem.corners_mm)))
    for axis in range(2):
        J[:, axis, axis] = view.distorted[..., axis]
        J[:, 2 + axis, axis] = 1.0
    by_lens = coefficient_jacobian(view.normalized, k[..., 4:])
    J[:, 4:inner] = focal * np.moveaxis(by_lens, (3, 2), (1, 2))
    by_pose = _by_point(problem, state, view)
    J[:, inner + 6 + ways : inner + 9 + ways] = _cross(_rows(view.turned), by_pose)
    J[:, inner + 9 + ways :] = by_pose
    if ways:
        turn = state.board_rotations[problem.moment]
        by_board = np.einsum("gij,gikn->gnkj", turn, by_pose) @ problem.shape_modes
        J[:, inner + 6 : inner + 6 + ways] = np.moveaxis(by_board, (3, 2), (1, 2))
    rig = ~(problem.alone | (problem.camera == 0))
    J[rig, inner : inner + 3] = _cross(by_pose[rig], _rows(view.local[rig]))
    J[rig, inner + 3 : inner + 6] = -by_pose[rig]
    return J


def _by_point(problem: BundleProblem, state: BundleState, view: _Projection) -> Floats:
    """Return ∂pixel/∂point in the pose's frame, shape (g, 3, 2, n): by coordinate, of x and y."""
    k = state.intrinsics[problem.camera][:, None]
    by_image = distort_jacobian(view.normalized, k[..., 4:])
    x, y = view.normalized[..., 0], view.normalized[..., 1]
    by_point = np.empty((len(k), 2, 3, len(problem.corners_mm)))
    for axis in range(2):
        scale = k[..., axis] / view.depth
        by_x, by_y = scale * by_image[..., axis, 0], scale * by_image[..., axis, 1]
        by_point[:, axis, 0], by_point[:, axis, 1] = by_x, by_y
        by_point[:, axis, 2] = -(by_x * x + by_y * y)
    return np.swapaxes(view.frame[:, None] @ by_point, 1, 2)


def _rows(points: Floats) -> Floats:
    """Return points (g, n, 3) by coordinate, as in `_by_point`: shape (g, 3, 1, n)."""
    return np.swapaxes(points, 1, 2)[:, :, None]


def _cross(a: Floats, b: Floats) -> Floats:
    """Return a × b over the second axis; several times quicker than `numpy.cross` on many rows."""
    (ax, ay, az), (bx, by, bz) = np.moveaxis(a, 1, 0), np.moveaxis(b, 1, 0)
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=1)


def _loss(problem: BundleProblem, errors: Floats, huber_px: float | None) -> tuple[float, Floats]:
    """Return the cost of `errors` and the weight of each corner; Huber's beyond `huber_px`."""
    size = np.linalg.norm(errors, axis=-1) * problem.weights
    if huber_px is None:
        return float(np.sum(size**2)), problem.weights
    large = np.maximum(size, huber_px)
    cost = np.where(size <= huber_px, size**2, huber_px * (2 * size - huber_px))
    return float(np.sum(cost)), problem.weights * np.sqrt(huber_px / large)


def normal_equations(
    problem: BundleProblem, state: BundleState, huber_px: float | None = None
) -> NormalEquations:
    """Linearise at `state`; the shared unknowns stand as in `BundleState.moved`."""
    return _linearised(problem, state, _project(problem, state), huber_px)


def _linearised(
    problem: BundleProblem, state: BundleState, view: _Projection, huber_px: float | None
) -> NormalEquations:
    errors = _errors(problem, view)
    weights = _loss(problem, errors, huber_px)[1]
    rows, inner, ways = len(errors), state.intrinsics.shape[1], len(state.shape_mm)
    J = _derivatives(problem, state, view)
    J *= weights[:, None, None]
    J = J.reshape(rows, inner + 12 + ways, -1)
    r = np.swapaxes(errors * weights[..., None], 1, 2).reshape(rows, -1, 1)
    H, g = J @ np.swapaxes(J, 1, 2), (J @ r)[..., 0]
    cameras, moments = problem.camera_count, problem.moment_count
    rig, common = (inner + 6) * cameras - 6, inner + 6 + ways
    d = rig + ways
    shared, coupling = np.zeros((moments, d + 6, d + 6)), np.zeros((moments, d + 6, 6))
    gradient, own = np.zeros((moments, d + 6)), np.zeros((moments, 6))
    local = np.zeros((moments, 6, 6))
    for camera in range(cameras):  # in one moment a camera has one row, so no sum loses a term
        mine = np.flatnonzero(problem.camera == camera)
        at = problem.moment[mine]
        # the reference camera has no pose: its six columns (zero) go to spare places, cut off below
        pose = d if camera == 0 else inner * cameras + 6 * (camera - 1)
        parts = (
            (slice(0, inner), slice(inner * camera, inner * (camera + 1))),
            (slice(inner, inner + 6), slice(pose, pose + 6)),
            (slice(inner + 6, common), slice(rig, d)),
        )
        for here, there in parts:
            coupling[at, there] += H[mine, here, common:]
            gradient[at, there] += g[mine, here]
            for other, beside in parts:
                shared[at, there, beside] += H[mine, here, other]
        local[at] += H[mine, common:, common:]
        own[at] += g[mine, common:]
    return NormalEquations(shared[:, :d, :d], coupling[:, :d], local, gradient[:, :d], own)


def adjust(
    problem: BundleProblem,
    start: BundleState,
    *,
    huber_px: float | None = None,
    tolerance: float = TOLERANCE,
) -> BundleSolution:
    """Adjust cameras, rig and board poses to all corners together.

    Parameters
    ----------
    problem, start
        The corners and where to begin.
    huber_px
        Error beyond which a corner counts linearly instead of quadratically, px; `None` for least
        squares.
    tolerance
        Relative fall of the cost at which to stop.

    Raises
    ------
    CalibrationError
        If the fit does not settle or a board comes to lie behind a camera.

    References
    ----------
    Triggs et al., "Bundle adjustment: a modern synthesis", doi:10.1007/3-540-44480-7_21; Huber
    (1964), doi:10.1214/aoms/1177703732.
    """
    latest: list[tuple[BundleState, _Projection]] = []

    def cost(state: BundleState) -> float:
        view = _project(problem, state)
        if view.behind or not np.isfinite(view.pixels).all():
            return float("inf")
        latest[:] = [(state, view)]
        return _loss(problem, _errors(problem, view), huber_px)[0]

    def linearise(state: BundleState) -> NormalEquations:
        known = latest[0][1] if latest[0][0] is state else _project(problem, state)
        return _linearised(problem, state, known, huber_px)

    if not np.isfinite(cost(start)):
        raise CalibrationError(
            "a board pose puts the board behind a camera that sees it",
            next_step="check that images with the same file name show the same moment",
        )
    exact = 1e-20 * max(1, int(np.count_nonzero(problem.weights)))
    state = minimise(
        start,
        linearise=linearise,
        cost=cost,
        moved=BundleState.moved,
        floor=exact,
        tolerance=tolerance,
    )
    information, scores = linearise(state).reduced()
    unknowns = len(scores[0]) + 6 * problem.moment_count
    dof = 2 * int(np.count_nonzero(problem.weights)) - unknowns
    return BundleSolution(state, residuals(problem, state), information, scores, dof)


def adjust_wary(problem: BundleProblem, start: BundleState) -> tuple[BundleSolution, int | None]:
    """Adjust by least squares unless one view is grossly wrong; then robustly, and name it.

    One wrong view bends a least-squares fit of all. Huber's loss keeps the good views good, so
    that the wrong one stands out.

    Returns
    -------
    The solution, and the row of the wrong view or `None`.
    """
    rough = adjust(problem, start, tolerance=1e-3)
    sizes = _row_rms(problem, rough)
    median = float(np.median(sizes))
    if max(sizes) > max(GROSS_PX / 2, GROSS_RATIO / 2 * median):
        # half of what the wrong view misses may have gone into the others: look again robustly
        limit = max(0.05, min(0.5, median))
        robust = adjust(problem, rough.state, huber_px=limit, tolerance=1e-4)
        worst = gross_view(_row_rms(problem, robust))
        if worst is not None:
            return robust, worst
    return adjust(problem, rough.state), None


def _row_rms(problem: BundleProblem, solution: BundleSolution) -> list[float]:
    squares = np.sum(solution.residuals_px**2, axis=(1, 2))
    return [float(v) for v in np.sqrt(squares / np.count_nonzero(problem.weights, axis=1))]


def gross_view(view_rms_px: Sequence[float]) -> int | None:
    """Return the index of the worst view if it is grossly worse than the median view.

    Examples
    --------
    >>> gross_view([0.1, 0.12, 7.0, 0.11])
    2
    >>> gross_view([0.1, 0.12, 0.5, 0.11]) is None
    True
    """
    worst = int(np.argmax(view_rms_px))
    gross = view_rms_px[worst] > max(GROSS_PX, GROSS_RATIO * float(np.median(view_rms_px)))
    return worst if gross else None


def covariance(problem: BundleProblem, solution: BundleSolution) -> Floats:
    """Return the covariance of the rig, in `Rig.parameter_names`' order, shape (d, d).

    The inverse of the information that all views hold, times the residual variance, times
    `view_inflation`. Over 60 simulated calibrations (20 pairs, 12 single views, 0.1 px) the squared
    Mahalanobis distance from the truth was 0.96 of its expectation with independent corner errors
    (95 % covered), and 1.04 (87 %) with errors smooth over each view, where it was 6.8 (1 %)
    without the inflation. A full sandwich covariance by views covers 62 to 87 % where 95 % are
    claimed: a few dozen views are too few to estimate a matrix from, but enough for one factor.

    Raises
    ------
    CalibrationError
        If no redundancy is left or the views leave some parameter undetermined.
    """
    spread = residual_variance(problem, solution) * view_inflation(problem, solution)
    rig = rig_count(solution)
    inverse = spread * inverse_information(solution)[:rig, :rig]
    return 0.5 * (inverse + inverse.T)


def view_inflation(problem: BundleProblem, solution: BundleSolution) -> float:
    """Return by how much errors common to a view raise the variance of the rig, at least 1.

    View v moves the rig's parameters by the first rows of d_v = S⁻¹g_v, with g_v its score, S_v its
    information and S the sum of these. Were the errors of the corners independent, the covariance
    of g_v would be σ²(S_v − S_v S⁻¹ S_v). The ratio of Σ d_vᵀ Σ⁻¹ d_v, Σ the rig's part of S⁻¹, to
    what this makes it estimates how much more the errors within a view add up (the design effect of
    cluster sampling), averaged over the rig's parameters.

    References
    ----------
    Bell and McCaffrey (2002), "Bias reduction in standard errors for linear regression with
    multi-stage samples", Survey Methodology 28.
    """
    inverse, rig = inverse_information(solution), rig_count(solution)
    mine = inverse[:rig]
    moved, through = solution.scores @ mine.T, mine @ solution.information
    taken = through @ inverse @ np.swapaxes(through, 1, 2)
    weight = solve_scaled(mine[:, :rig], np.eye(rig))
    expected = rig - float(np.einsum("ij,vji->", weight, taken))
    variance = residual_variance(problem, solution)
    if expected <= 0 or variance <= 0:
        return 1.0
    found = float(np.einsum("vi,ij,vj->", moved, weight, moved))
    return max(1.0, found / (expected * variance))


def rig_count(solution: BundleSolution) -> int:
    """Return how many of the shared unknowns are the rig's."""
    return len(solution.scores[0]) - len(solution.state.shape_mm)


def residual_variance(problem: BundleProblem, solution: BundleSolution) -> float:
    """Return the variance of one measured coordinate of unit weight, px²."""
    if solution.degrees_of_freedom < 1:
        raise CalibrationError(
            f"{int(np.count_nonzero(problem.weights))} corners leave no redundancy",
            next_step="add board views",
        )
    weighted = solution.residuals_px * problem.weights[..., None]
    return float(np.sum(weighted**2)) / solution.degrees_of_freedom


def inverse_information(solution: BundleSolution) -> Floats:
    """Return the inverse of the shared information: the covariance for 1 px of corner noise."""
    total = solution.information.sum(axis=0)
    try:
        inverse = solve_scaled(total, np.eye(len(total)))
    except np.linalg.LinAlgError:
        inverse = np.full_like(total, np.nan)
    if not (np.isfinite(inverse).all() and (np.diag(inverse) > 0).all()):
        raise CalibrationError(
            "the board views leave some camera parameters undetermined",
            next_step="add board views tilted by 20° to 45° in several directions",
        )
    return inverse
