"""What a calibration is good for, in mm, and the one thing that would improve it most."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats, checked, read_only
from pivometer.calibration.board import BoardView
from pivometer.calibration.frame import board_pose, pose_alone, projection_errors
from pivometer.calibration.metric_scale import triangulate_points
from pivometer.calibration.quality import GRID, shared_moments
from pivometer.calibration.result import Calibration
from pivometer.cameras import Camera, Rig

GOOD, USABLE = 1e-3, 3e-3
"""Expanded uncertainty of a point over its distance from the reference camera. The joint route on
the paper's set-up reaches 1.2e-3 to 1.6e-3 at 0.1 px corner noise, 1e-4 at today's 0.01 px."""
ENOUGH_FILLED = 0.7
"""Part of a third of the image that corners should reach."""
ENOUGH_TILT_DEG = 60.0
"""Largest angle between two boards from which more tilt brings little: 30° either way."""
FEW_PAIRS = 10
FEWEST_CORNERS = 6


@dataclass(frozen=True, slots=True, eq=False)
class Advice:
    """How far a calibration can be trusted, and what to do to trust it further.

    Parameters
    ----------
    at_mm
        The place that the figures are for: the RCM, or else the middle of the boards that several
        cameras saw; shape (3,), mm, reference frame.
    covariance_mm2
        Covariance of a point there, as far as the calibration causes it, shape (3, 3), mm².
    expanded_mm
        Expanded uncertainty along its worst direction, k = 2, mm.
    verdict
        One sentence on the calibration.
    cause
        The parameters whose uncertainty matters most at that place.
    next_step
        The one thing that would improve it most.
    """

    at_mm: Floats
    covariance_mm2: Floats
    expanded_mm: float
    verdict: str
    cause: str
    next_step: str

    def __post_init__(self) -> None:
        for name, shape in (("at_mm", (3,)), ("covariance_mm2", (3, 3))):
            object.__setattr__(self, name, read_only(checked(getattr(self, name), shape, name)))


def advice(calibration: Calibration, *, at_mm: Floats | None = None) -> Advice:
    """Say what a calibration is good for at a place, and what would improve it most.

    What matters most is found by asking, for each camera's focal lengths, principal point,
    distortion and pose, how much smaller the uncertainty were if they were known.

    Parameters
    ----------
    calibration
        The calibration.
    at_mm
        The place; the middle of the shared boards where none is given.
    """
    rig = calibration.rig
    place = middle_of_boards(calibration) if at_mm is None else checked(at_mm, (3,), "at_mm")
    jacobian = _point_jacobian(rig, calibration.covariance, place)
    total = jacobian @ calibration.covariance @ jacobian.T
    left = {
        name: np.trace(jacobian @ _known(calibration.covariance, columns) @ jacobian.T)
        for name, columns in _groups(rig).items()
    }
    cause = min(left, key=lambda name: left[name])
    expanded = 2 * float(np.sqrt(np.linalg.eigvalsh((total + total.T) / 2)[-1]))
    best = 2 * float(np.sqrt(max(float(left[cause]), 0.0) / max(float(np.trace(total)), 1e-300)))
    what = _what_to_do(calibration, cause)
    return Advice(
        at_mm=place,
        covariance_mm2=(total + total.T) / 2,
        expanded_mm=expanded,
        verdict=_verdict(calibration, expanded, float(np.linalg.norm(place))),
        cause=f"the {cause} (known exactly, it would leave {50 * best:.0f} % of the uncertainty)",
        next_step=what,
    )


def middle_of_boards(calibration: Calibration) -> Floats:
    """Return the middle of the boards that several cameras saw, shape (3,), mm."""
    shared = set(shared_moments(calibration.views))
    centres = []
    for view in calibration.views:
        if view.view in shared and len(view.ids) >= FEWEST_CORNERS:
            pose = pose_alone(view, calibration.board, calibration.rig)
            centres.append(pose @ calibration.board.corners_mm.mean(axis=0))
    if not centres:
        return np.array([0.0, 0.0, float(calibration.rig.baselines_mm[0])])
    middle: Floats = np.median(centres, axis=0)
    return middle


def corner_residuals(calibration: Calibration) -> dict[str, tuple[Floats, Floats]]:
    """Return each camera's corners, and projected minus found where known, shape (n, 2) each.

    The board's pose is estimated again for every moment, from all cameras that saw it; corners of
    views too small for that have residual 0.
    """
    moments: dict[str, list[BoardView]] = {}
    for view in calibration.views:
        moments.setdefault(view.view, []).append(view)
    places: dict[str, list[Floats]] = {one.name: [] for one in calibration.rig.cameras}
    residuals: dict[str, list[Floats]] = {name: [] for name in places}
    for views in moments.values():
        for view, errors in zip(views, _projected_again(views, calibration), strict=True):
            places[view.camera].append(view.pixels)
            residuals[view.camera].append(errors)
    none = np.zeros((0, 2))
    return {
        name: (np.concatenate([none, *places[name]]), np.concatenate([none, *residuals[name]]))
        for name in places
    }


def _projected_again(views: Sequence[BoardView], calibration: Calibration) -> list[Floats]:
    """Return projected minus found for the views of one moment, with the board's pose from all."""
    board, rig = calibration.board, calibration.rig
    whole = [view for view in views if len(view.ids) >= FEWEST_CORNERS]
    if not whole:
        return [np.zeros_like(view.pixels) for view in views]
    pose = board_pose(whole, board.corners_mm, rig, pose_alone(whole[0], board, rig))
    return [
        projection_errors([view], board.corners_mm, rig, pose)[0].reshape(-1, 2)
        if len(view.ids) >= FEWEST_CORNERS
        else np.zeros_like(view.pixels)
        for view in views
    ]


def _point_jacobian(rig: Rig, covariance: Floats, at_mm: Floats) -> Floats:
    """Return ∂point/∂rig with its images as they are, shape (3, d), mm per unit."""
    seen = [
        (camera, pose)
        for camera, pose in zip(rig.cameras, rig.reference_from_camera, strict=True)
        if (pose.inverse() @ at_mm)[2] > 0
    ]
    pixels = [camera.project(pose.inverse() @ at_mm) for camera, pose in seen]
    rows = [rig.index(camera.name) for camera, _ in seen]
    steps = np.sqrt(np.maximum(covariance.diagonal(), 1e-24)) * 1e-2

    def point(other: Rig) -> Floats:
        images = [
            other.cameras[i].normalized_from_pixels(at)[None]
            for i, at in zip(rows, pixels, strict=True)
        ]
        found: Floats = triangulate_points(
            np.stack(images),
            [other.reference_from_camera[i] for i in rows],
            weights=[float(other.cameras[i].focal_px.mean()) for i in rows],
        )[0]
        return found

    columns = []
    for k, step in enumerate(steps):
        delta = np.zeros(len(steps))
        delta[k] = step
        columns.append((point(rig.perturbed(delta)) - point(rig.perturbed(-delta))) / (2 * step))
    return np.stack(columns, axis=1)


def _groups(rig: Rig) -> dict[str, list[int]]:
    """Return which parameters belong together, by a name for people."""
    groups: dict[str, list[int]] = {}
    for column, name in enumerate(rig.parameter_names):
        camera, _, parameter = name.rpartition(".")
        if parameter in ("fx_px", "fy_px"):
            what = "focal length"
        elif parameter in ("ox_px", "oy_px"):
            what = "principal point"
        elif parameter.endswith(("_rad", "_mm")):
            what = "pose"
        else:
            what = "distortion"
        groups.setdefault(f"{what} of camera {camera}", []).append(column)
    return groups


def _known(covariance: Floats, columns: list[int]) -> Floats:
    """Return the covariance if some parameters were known."""
    inner = covariance[np.ix_(columns, columns)]
    across = covariance[:, columns]
    left: Floats = covariance - across @ np.linalg.pinv(inner, hermitian=True) @ across.T
    return left


def _verdict(calibration: Calibration, expanded_mm: float, distance_mm: float) -> str:
    relative = expanded_mm / distance_mm
    word = "good" if relative <= GOOD else "usable" if relative <= USABLE else "weak"
    held = calibration.held_out
    return (
        f"The calibration is {word}: it locates a point {distance_mm:.0f} mm from camera "
        f"{calibration.rig.reference} to ±{expanded_mm:.2g} mm in that camera's frame (k = 2, the "
        f"worst direction), and held-out board edges are off by {held.rms_mm:.2g} mm rms, "
        f"{held.max_mm:.2g} mm at most."
    )


def _what_to_do(calibration: Calibration, cause: str) -> str:
    what, _, name = cause.partition(" of camera ")
    pairs = len(shared_moments(calibration.views))
    if pairs < FEW_PAIRS:
        return (
            f"add {2 * FEW_PAIRS - pairs} pictures of the board taken by all cameras at once, "
            f"where the tool will be, tilted by up to 45° in all directions: there are only {pairs}"
        )
    if what == "pose":
        return (
            f"add {max(10, pairs // 2)} pictures of the board taken by all cameras at once, spread "
            "over the room around the place of the tool, near and far"
        )
    camera = calibration.rig.cameras[calibration.rig.index(name)]
    quality = next(entry for entry in calibration.cameras if entry.name == name)
    place, filled = emptiest_part(calibration, camera)
    if filled < ENOUGH_FILLED:
        return f"add 6 tilted views of the board in the {place} of camera {name}'s image"
    if quality.tilt_deg < ENOUGH_TILT_DEG:
        return (
            f"add 6 views of the board to camera {name}, tilted by 45° up, down, left and right: "
            f"its boards differ by only {quality.tilt_deg:.0f}°"
        )
    return (
        f"add {max(10, quality.view_count // 2)} views of the board to camera {name}, tilted by "
        "about 45° in all directions and filling the image"
    )


PARTS = (("upper", "middle", "lower"), ("left", "centre", "right"))


def emptiest_part(calibration: Calibration, camera: Camera) -> tuple[str, float]:
    """Return the ninth of a camera's image that corners reach least, and the part they fill."""
    counts = corner_counts(calibration, camera)
    best, name = 2.0, ""
    for row, vertical in enumerate(PARTS[0]):
        for column, horizontal in enumerate(PARTS[1]):
            rows = slice(2 * row, 2 * row + 2)
            columns = ((0, 3), (3, 5), (5, 8))[column]
            filled = float((counts[rows, slice(*columns)] > 0).mean())
            if filled < best:
                words = [w for w in (vertical, horizontal) if w not in ("middle", "centre")]
                best, name = filled, " ".join(words) or "middle"
    return name, best


def corner_counts(calibration: Calibration, camera: Camera) -> NDArray[np.int64]:
    """Return how many corners fell into each cell of an 8×6 grid, shape (6, 8)."""
    counts = np.zeros((GRID[1], GRID[0]), dtype=np.int64)
    for view in calibration.views:
        if view.camera == camera.name:
            cells = (view.pixels + 0.5) / [camera.width, camera.height] * GRID
            inside = np.clip(cells.astype(np.int64), 0, np.array(GRID) - 1)
            np.add.at(counts, (inside[:, 1], inside[:, 0]), 1)
    return counts
