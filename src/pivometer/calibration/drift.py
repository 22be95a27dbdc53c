"""Whether a camera was moved between the calibration and the board views at the end.

Only the relative poses of the cameras can be seen in views of a board that is somewhere else each
time. With the intrinsic parameters as they were, one camera's pose and the board's pose at every
closing moment are adjusted to the closing views; a movement counts where it exceeds what the noise
of these views and the covariance of the calibration allow. Real views stray further than that, as
boards are not flat and lenses not quite as modelled (χ² of 60 between pairs of the OpenCV stereo
set): the same movement fitted to moments of the calibration, where there is none, says how far.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pivometer._arrays import Floats
from pivometer.calibration.board import Board, BoardView
from pivometer.calibration.frame import (
    board_pose,
    moved,
    numbered_as_projected,
    pose_alone,
    projection_errors,
    shift_of_corners,
)
from pivometer.cameras import Rig
from pivometer.geometry.rigid import RigidTransform

CHANCE = 1e-4
"""How often chance may bring a movement where there is none."""
GROUPS = 6
"""Groups of earlier moments that say how far views stray without any movement."""
STILL_PX = 0.1
"""A camera sees an unmoved board at the same pixels to 0.01 px; see `frame.MOVED_PX`."""

Moments = Mapping[str, Sequence[BoardView]]


@dataclass(frozen=True, slots=True, eq=False)
class Drift:
    """How one camera moved against the others.

    Parameters
    ----------
    cameras
        The camera that moved; more than one name where the views cannot tell which of them did.
    angle_rad
        How far it turned, rad.
    shift_mm
        How far points at the place asked for seem to have moved, mm.
    chi_square
        Squared movement over its covariance, 6 degrees of freedom, lessened by how far earlier
        views stray.
    limit
        What chance exceeds once in ten thousand sessions.
    views
        The closing views it follows from.
    """

    cameras: tuple[str, ...]
    angle_rad: float
    shift_mm: float
    chi_square: float
    limit: float
    views: tuple[str, ...]

    @property
    def significant(self) -> bool:
        """Whether the movement exceeds what chance brings once in ten thousand sessions."""
        return self.chi_square > self.limit


def drift(
    closing: Sequence[BoardView],
    board: Board,
    rig: Rig,
    covariance: Floats,
    *,
    at_mm: Floats,
    noise_px: float,
    earlier: Sequence[BoardView] = (),
) -> Drift | None:
    """Compare the rig with board views taken at the end.

    Parameters
    ----------
    closing
        Views of the board at the end; only moments that at least two cameras saw count.
    board
        The board.
    rig, covariance
        The calibration, with the covariance of `rig.parameter_names`.
    at_mm
        Where the movement matters: the RCM, shape (3,), mm, reference frame.
    noise_px
        Noise of one corner coordinate in the calibration, px.
    earlier
        Earlier views, numbered alike. They say how far views stray without any movement; and one
        that shows the board where it still is at the end tells which camera
        moved: the one in whose image it is elsewhere.

    Returns
    -------
    Drift
        The likeliest movement of a single camera, significant or not; `None` where no moment was
        seen by two cameras.
    """
    moments = _shared(closing, board, rig)
    if not moments:
        return None
    seen = sorted({v.camera for views in moments.values() for v in views}, key=rig.index)
    suspects = [name for name in seen if name != rig.reference] or seen
    if len(seen) > 2:
        suspects = list(seen)
    name = min(suspects, key=lambda suspect: _fit(moments, board, rig, suspect).cost)
    fit = _fit(moments, board, rig, name)
    chi_square = _chi_square(moments, board, rig, covariance, name, noise_px)
    strays = [
        _chi_square(group, board, rig, covariance, name, noise_px)
        for group in _groups(_shared(earlier, board, rig), len(moments))
    ]
    chi_square /= max(1.0, float(np.mean(strays)) / 6 if strays else 1.0)
    change = moved(RigidTransform.identity(), np.concatenate([fit.step[:3], np.zeros(3)]))
    centre = rig.reference_from_camera[rig.index(name)].translation_mm
    shifted = change.rotation @ (at_mm - centre) + centre + fit.step[3:]
    names = (name,) if len(seen) > 2 else _by_still_board(closing, earlier, seen)
    return Drift(
        names,
        float(np.linalg.norm(fit.step[:3])),
        float(np.linalg.norm(shifted - at_mm)),
        chi_square,
        _limit(len(strays)),
        tuple(moments),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """A movement (6,), the board's poses with it, and ∂errors/∂movement with the poses freed."""

    step: Floats
    poses: Mapping[str, RigidTransform]
    errors: Floats
    slopes: Floats

    @property
    def cost(self) -> float:
        return float(self.errors @ self.errors)

    def step_for(self, errors: Floats) -> Floats:
        """Return the movement that undoes errors of all corners, shape (6,)."""
        step: Floats = -np.linalg.lstsq(self.slopes, errors, rcond=None)[0].astype(np.float64)
        return step


def _shared(closing: Sequence[BoardView], board: Board, rig: Rig) -> dict[str, list[BoardView]]:
    """Return the moments that two cameras saw, numbered alike in them."""
    moments: dict[str, list[BoardView]] = {}
    for view in closing:
        moments.setdefault(view.view, []).append(view)
    shared = {}
    for name, views in moments.items():
        if len(views) > 1:
            start = pose_alone(views[0], board, rig)
            shared[name] = [numbered_as_projected(view, board, rig, start) for view in views]
    return shared


def moved_rig(rig: Rig, camera: str, step: Floats) -> Rig:
    """Return the rig after one camera turned about its centre (rad) and shifted (mm), (6,).

    Where the reference camera moved, all others are elsewhere in its new frame.
    """
    poses = list(rig.reference_from_camera)
    if camera == rig.reference:
        back = moved(RigidTransform.identity(), step).inverse()
        poses[1:] = [back @ pose for pose in poses[1:]]
    else:
        poses[rig.index(camera)] = moved(poses[rig.index(camera)], step)
    return Rig(rig.cameras, poses)


WIDTHS = np.array([1e-5] * 3 + [1e-3] * 3)
"""Steps of the central differences, rad and mm: errors of 1e-8 px against 1e-2 px of noise."""


def _fit(moments: Moments, board: Board, rig: Rig, camera: str) -> _Fit:
    """Adjust one camera's pose, and the board's at each moment, by Gauss–Newton."""
    corners, step = board.corners_mm, np.zeros(6)
    poses = {name: pose_alone(views[0], board, rig) for name, views in moments.items()}
    for _ in range(6):
        now = moved_rig(rig, camera, step)
        poses = {n: board_pose(moments[n], corners, now, poses[n]) for n in moments}
        fit = _Fit(
            step,
            poses,
            _all_errors(moments, corners, now, poses),
            _freed_slopes(moments, corners, rig, camera, step, poses),
        )
        change = fit.step_for(fit.errors)
        if float(np.abs(change / WIDTHS).max()) < 1e-2:
            break
        step = step + change
    return fit


def _all_errors(
    moments: Moments, corners: Floats, rig: Rig, poses: Mapping[str, RigidTransform]
) -> Floats:
    return np.concatenate(
        [projection_errors(views, corners, rig, poses[n])[0] for n, views in moments.items()]
    )


def _freed_slopes(
    moments: Moments,
    corners: Floats,
    rig: Rig,
    camera: str,
    step: Floats,
    poses: Mapping[str, RigidTransform],
) -> Floats:
    """Return ∂errors/∂movement, (m, 6), without what the boards' own poses can undo."""
    columns = []
    for k, width in enumerate(WIDTHS):
        delta = width * np.eye(6)[k]
        there, back = (
            _all_errors(moments, corners, moved_rig(rig, camera, step + s * delta), poses)
            for s in (1, -1)
        )
        columns.append((there - back) / (2 * width))
    slopes = np.stack(columns, axis=1)
    now, at = moved_rig(rig, camera, step), 0
    for name, views in moments.items():
        local = projection_errors(views, corners, now, poses[name])[1]
        base, rows = np.linalg.qr(local)[0], slice(at, at + len(local))
        slopes[rows] -= base @ (base.T @ slopes[rows])
        at += len(local)
    return slopes


def _chi_square(
    moments: Moments, board: Board, rig: Rig, covariance: Floats, camera: str, noise_px: float
) -> float:
    fit = _fit(moments, board, rig, camera)
    spread = _covariance(moments, board, rig, covariance, camera, fit, noise_px)
    return float(fit.step @ np.linalg.solve(spread, fit.step))


def _limit(groups: int) -> float:
    """Return the largest χ² by chance; its scale is known from so many groups of 6 each."""
    from scipy.special import fdtri, gammaincinv

    known = 2 * float(gammaincinv(3, 1 - CHANCE))
    return 6 * float(fdtri(6, 6 * groups, 1 - CHANCE)) if groups else known


def _groups(moments: Moments, size: int) -> list[Moments]:
    """Return up to `GROUPS` groups of `size` moments each, spread over all of them."""
    names = list(moments)
    count = min(GROUPS, len(names) // size)
    return [{name: moments[name] for name in names[k::count][:size]} for k in range(count)]


def _covariance(
    moments: Moments,
    board: Board,
    rig: Rig,
    covariance: Floats,
    camera: str,
    fit: _Fit,
    noise_px: float,
) -> Floats:
    """Return the covariance of the movement: noise of the closing views, and the calibration."""
    freedom = max(1, len(fit.errors) - 6 * len(moments) - 6)
    variance = max(noise_px**2, fit.cost / freedom)
    spread: Floats = variance * np.linalg.inv(fit.slopes.T @ fit.slopes).astype(np.float64)
    values, vectors = np.linalg.eigh(covariance / _outer_sigma(covariance))
    kept = values > 1e-9
    root = np.sqrt(covariance.diagonal())[:, None] * vectors[:, kept] * np.sqrt(values[kept])
    for column in root.T:
        there, back = (
            _all_errors(
                moments,
                board.corners_mm,
                moved_rig(rig.perturbed(s * column), camera, fit.step),
                fit.poses,
            )
            for s in (1, -1)
        )
        half = fit.step_for((there - back) / 2)
        spread = spread + np.outer(half, half)
    return spread


def _outer_sigma(covariance: Floats) -> Floats:
    sigma = np.sqrt(np.maximum(covariance.diagonal(), 1e-300))
    return np.outer(sigma, sigma)


def _by_still_board(
    closing: Sequence[BoardView], earlier: Sequence[BoardView], cameras: Sequence[str]
) -> tuple[str, ...]:
    """Tell two cameras apart by a board that stood at one place before and after."""
    moves: dict[tuple[str, str], dict[str, float]] = {}
    for view in closing:
        for old in earlier:
            shift = shift_of_corners(old, view) if old.camera == view.camera else None
            if shift is not None:
                key = (old.view, view.view)
                size = float(np.sqrt(np.mean(np.sum(shift**2, axis=1))))
                moves.setdefault(key, {})[view.camera] = size
    for sizes in moves.values():
        still = [name for name in cameras if sizes.get(name, np.inf) < STILL_PX]
        if len(sizes) == len(cameras) and len(still) == 1:
            return tuple(name for name in cameras if name not in still)
    return tuple(cameras)
