"""What a measurement will be good for, before anything is built or moved."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pivometer._arrays import Floats
from pivometer.calibration import Board, BoardView, Calibration, calibrate_rig
from pivometer.cameras import Camera, Rig
from pivometer.errors import UsageError
from pivometer.geometry import RigidTransform
from pivometer.geometry.line import projectors
from pivometer.measurement import ImportedRig
from pivometer.rcm.lines import FEWEST_LINES
from pivometer.simulation.boards import Pattern, Placement, pair_poses, single_poses
from pivometer.simulation.robots import cone_directions
from pivometer.uncertainty import LocationUncertainty, coverage_factor
from pivometer.uncertainty.foresight import (
    ForeseenLines,
    Foresight,
    Shaft,
    foresee,
    foreseen_lines,
    foreseen_location,
)

MOST_POSES = 500
"""More are not looked at: from here on another board view does more than another pose."""

NORMAL_K = coverage_factor(np.inf)


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """What to expect.

    Parameters
    ----------
    rig
        The cameras.
    point_mm
        Where the RCM is taken to be, shape (3,), mm, reference camera's frame.
    cone_deg
        Apex angle of the cone of poses.
    foresight
        What the planned number of poses will be good for.
    limit
        What is larger in the largest expanded uncertainty: ``"calibration"`` or ``"poses"``.
    wanted_mm
        The expanded uncertainty that was asked for, mm; `None` where none was.
    fewest
        What the smallest number of poses that reaches it will be good for; `None` where none was
        asked for or none reaches it.
    """

    rig: Rig
    point_mm: Floats
    cone_deg: float
    foresight: Foresight
    limit: Literal["calibration", "poses"]
    wanted_mm: float | None
    fewest: Foresight | None


def plan(
    calibration: Calibration | ImportedRig,
    shaft: Shaft,
    *,
    edge_px: float = 0.1,
    cone_deg: float = 57.0,
    poses: int = 70,
    robot_rms_mm: float = 0.0,
    distance_mm: float | None = None,
    wanted_mm: float | None = None,
) -> Plan:
    """Return what a measurement will be good for.

    The shaft stands upright in the reference camera's image, with the middle of its visible part
    where the cameras look.

    Parameters
    ----------
    calibration
        A calibration, or a foreseen one: see `foreseen_calibration`.
    shaft
        The shaft and the part of it that is seen.
    edge_px
        Standard deviation of the edge in one row of an image, px.
    cone_deg, poses
        Apex angle of the cone, and number of poses that fill it evenly.
    robot_rms_mm
        The robot's own rms miss, mm.
    distance_mm
        From the reference camera to the shaft along its optical axis, mm; where the optical axes
        meet if none is given.
    wanted_mm
        Expanded uncertainty that every coordinate shall have at most, mm.

    Raises
    ------
    UsageError
        If the rig has no uncertainty, or a camera does not see the shaft.
    DataError
        If the poses do not determine the RCM.
    """
    if isinstance(calibration, ImportedRig):
        raise UsageError(
            f"the rig was imported ({calibration.file_format}) without its uncertainty",
            next_step="give a rig.json of pivometer calibrate, or the rig's measures",
        )
    rig = calibration.rig
    middle = _sight(rig) if distance_mm is None else np.array([0.0, 0.0, distance_mm])
    point = middle + np.array([0.0, sum(shaft.span_mm) / 2, 0.0])

    def seen(count: int) -> ForeseenLines:
        axes = cone_directions(count, cone_deg)[:, [0, 2, 1]] * [1.0, -1.0, 1.0]
        return foreseen_lines(rig, point, axes, shaft, edge_px=edge_px)

    def expected(lines: ForeseenLines) -> LocationUncertainty:
        return foreseen_location(lines, rig, calibration.covariance, robot_rms_mm=robot_rms_mm)

    def foresight_of(count: int) -> Foresight:
        lines = seen(count)
        return foresee(lines, rig, calibration.covariance, robot_rms_mm=robot_rms_mm)

    foresight = foresight_of(poses)
    fewest = None
    calibration_u = np.sqrt(foresight.uncertainty.calibration_mm2.diagonal().max())
    if wanted_mm is not None and NORMAL_K * calibration_u < wanted_mm:
        fewest = _fewest(lambda count: float(expected(seen(count)).expanded_mm.max()), wanted_mm)
    worst = int(np.argmax(foresight.uncertainty.expanded_mm))
    ours = foresight.uncertainty.lines_mm2[worst, worst]
    return Plan(
        rig=rig,
        point_mm=point,
        cone_deg=cone_deg,
        foresight=foresight,
        limit="poses"
        if ours > foresight.uncertainty.calibration_mm2[worst, worst]
        else "calibration",
        wanted_mm=wanted_mm,
        fewest=None if fewest is None else foresight_of(fewest),
    )


def _sight(rig: Rig) -> Floats:
    """Return the point nearest to all optical axes, shape (3,), mm."""
    axes = np.stack([pose.rotation[:, 2] for pose in rig.reference_from_camera])
    centres = np.stack([pose.translation_mm for pose in rig.reference_from_camera])
    across = projectors(axes)
    right = np.einsum("nij,nj->i", across, centres)
    point: Floats = np.linalg.lstsq(across.sum(axis=0), right, rcond=1e-9)[0]
    return point


def _fewest(largest_mm: Callable[[int], float], wanted_mm: float) -> int | None:
    """Return the smallest number of poses that reaches an expanded uncertainty.

    Doubled until it is reached, then bisected: more poses cost more time.
    """
    few, many = FEWEST_LINES - 1, FEWEST_LINES
    while largest_mm(many) > wanted_mm:
        if many == MOST_POSES:
            return None
        few, many = many, min(2 * many, MOST_POSES)
    while many - few > 1:
        middle = (few + many) // 2
        if largest_mm(middle) <= wanted_mm:
            many = middle
        else:
            few = middle
    return many


# --- A rig that is not built yet ---


def two_cameras(
    *,
    focal_px: float,
    image_size: tuple[int, int],
    distance_mm: float | None = None,
    baseline_mm: float | None = None,
    convergence_deg: float | None = None,
) -> Rig:
    """Return two cameras at the same distance from what they both look at.

    Parameters
    ----------
    focal_px, image_size
        Of both, px.
    distance_mm, baseline_mm, convergence_deg
        From each to what they look at, from each other, and the angle between their optical axes:
        two of the three.

    Raises
    ------
    UsageError
        If not two of the three are given, or the baseline is too long for the distance.

    Examples
    --------
    >>> rig = two_cameras(focal_px=1000, image_size=(640, 480), distance_mm=500, convergence_deg=60)
    >>> rig.baselines_mm.round(6)
    array([500.])
    """
    if sum(value is None for value in (distance_mm, baseline_mm, convergence_deg)) != 1:
        raise UsageError(
            "the cameras stand where two of three measures say",
            next_step="give two of --distance-mm, --baseline-mm and --convergence-deg",
        )
    if convergence_deg is not None:
        ratio = 2 * float(np.sin(np.radians(convergence_deg) / 2))
        distance_mm = distance_mm or (baseline_mm or 0.0) / ratio
        baseline_mm = ratio * distance_mm
    distance_mm, baseline_mm = float(distance_mm or 0.0), float(baseline_mm or 0.0)
    half = baseline_mm / (2 * distance_mm)
    if not 0 < half < 1:
        raise UsageError(
            f"two cameras {baseline_mm:g} mm apart cannot both be {distance_mm:g} mm from the "
            "shaft",
            next_step="give a baseline below twice the distance",
        )
    width, height = image_size
    centre = np.array([(width - 1) / 2, (height - 1) / 2])
    cameras = [
        Camera(name, width, height, np.full(2, focal_px), centre, np.zeros(2))
        for name in ("left", "right")
    ]
    turn = 2 * np.arcsin(half)
    middle = np.array([0.0, 0.0, distance_mm])
    rotation = RigidTransform.from_rotation_vector([0.0, -turn, 0.0], np.zeros(3)).rotation
    right = RigidTransform(rotation, middle - distance_mm * rotation[:, 2])
    return Rig(cameras, [RigidTransform.identity(), right])


def foreseen_calibration(
    rig: Rig, board: Board, *, board_views: int = 30, corner_px: float = 0.1, seed: int = 0
) -> Calibration:
    """Return the calibration of a rig from simulated corners of a board.

    Parameters
    ----------
    rig
        The cameras.
    board
        The board; the uncertainty of its square counts.
    board_views
        Number of views that all cameras share; half as many again of each camera alone.
    corner_px
        Standard deviation of a corner's coordinate, px.
    seed
        Chooses board positions and noise.

    Raises
    ------
    UsageError
        If the board does not fit into the images.
    CalibrationError
        If the views do not determine the cameras.
    """
    middle = _sight(rig)
    pattern = Pattern("checkerboard", board.squares, board.square_mm)
    rng = np.random.default_rng(seed)
    reach = 0.15 * float(np.linalg.norm(middle))
    placement = Placement(middle, np.full(3, reach))
    pairs = pair_poses(pattern, rig, placement, board_views, rng)
    views = []
    for camera, pose in zip(rig.cameras, rig.reference_from_camera, strict=True):
        distance = float(np.linalg.norm(middle - pose.translation_mm))
        single = single_poses(pattern, camera, distance, board_views // 2, rng)
        held = [(f"board/{k:03}", pose.inverse() @ pair) for k, pair in enumerate(pairs)]
        held += [(f"intrinsics/{camera.name}/{k:03}", one) for k, one in enumerate(single)]
        ids = np.arange(len(board.corners_mm))
        for name, camera_from_board in held:
            corners = camera.project(camera_from_board @ board.corners_mm)
            corners = corners + corner_px * rng.standard_normal(corners.shape)
            views.append(BoardView(camera.name, name, ids, corners, np.full(len(ids), corner_px)))
    sizes = {camera.name: (camera.width, camera.height) for camera in rig.cameras}
    return calibrate_rig(views, board, sizes, reference=rig.reference)


def seen_length_mm(rig: Rig, part: float = 0.6) -> float:
    """Return how long a stretch about what the cameras look at all of them see, mm."""
    middle = _sight(rig)
    heights = []
    for camera, pose in zip(rig.cameras, rig.reference_from_camera, strict=True):
        depth = float((pose.inverse() @ middle)[2])
        heights.append(part * camera.height * depth / float(camera.focal_px[1]))
    return min(heights)
