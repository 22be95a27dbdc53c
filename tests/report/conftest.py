"""A measurement made up from known geometry: the paper's set-up with 70 poses and 2 rejected."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest

from pivometer.calibration.board import Board, BoardView
from pivometer.calibration.result import (
    Calibration,
    CameraQuality,
    LengthError,
    PaperRoute,
    RejectedView,
)
from pivometer.cameras import Camera, Rig
from pivometer.geometry import RigidTransform
from pivometer.measurement import (
    BoardFrame,
    Measurement,
    PoseDistances,
    Provenance,
    RejectedPose,
    Setup,
    UsedPose,
)
from pivometer.rcm import Finding, solve
from pivometer.report import Thumbnail, make_thumbnail
from pivometer.shaft.edges import ShaftEdges
from pivometer.shaft.triangulation import Centerline
from pivometer.uncertainty.frame import BoardFrameUncertainty
from pivometer.uncertainty.propagation import LocationUncertainty

RCM_MM = np.array([6.436, 65.741, 478.266])
NAMES = ("left", "right")
INTRINSICS_U = [0.8, 0.8, 1.4, 1.2, 0.002, 0.011]


def paper_rig(names: Sequence[str] = NAMES) -> Rig:
    """The paper's two cameras, and where a third is named, one between them."""
    left = Camera("left", 640, 480, [1002.4, 1001.8], [318.2, 243.9], [-0.21, 0.12])
    right = Camera("right", 640, 480, [998.1, 997.2], [325.6, 238.0], [-0.19, 0.09])
    turn = np.radians(86.0)
    place = 525.65 * np.array([np.cos(np.radians(43)), 0.02, np.sin(np.radians(43))])
    middle = Camera("middle", 800, 600, [1100.0, 1100.0], [400, 300], [-0.1, 0.0])
    transforms = [
        RigidTransform.identity(),
        RigidTransform.from_rotation_vector([0, -turn, 0], place),
        RigidTransform.from_rotation_vector([0, -turn / 2, 0], 0.4 * place),
    ]
    return Rig([left, right, middle][: len(names)], transforms[: len(names)])


def directions(count: int, rng: np.random.Generator) -> np.ndarray:
    """Spread directions over a 57° cone about the camera's y axis, Fibonacci-wise."""
    tilt = np.arccos(1 - (1 - np.cos(np.radians(28.5))) * (np.arange(count) + 0.5) / count)
    azimuth = np.arange(count) * 2.399963 + rng.uniform(0, 2 * np.pi)
    return np.stack(
        [np.sin(tilt) * np.cos(azimuth), np.cos(tilt), np.sin(tilt) * np.sin(azimuth)], axis=1
    )


def shaft_edges(rig: Rig, index: int, point: np.ndarray, direction: np.ndarray) -> ShaftEdges:
    camera = rig.cameras[index]
    camera_from_reference = rig.reference_from_camera[index].inverse()
    middle = camera_from_reference @ point
    along = camera_from_reference.rotate(direction)
    side = np.cross(along, middle)
    side *= 5.0 / np.linalg.norm(side)
    axis = middle + np.linspace(-260, 30, 25)[:, None] * along
    edges = np.stack([camera.project(axis - side), camera.project(axis + side)])
    return ShaftEdges(
        camera=camera.name,
        points_px=edges,
        normals=np.array([[0.0, 0, 1], [0, 0, 1]]),
        normals_covariance=np.zeros((6, 6)),
        sigma_px=np.array([0.021, 0.034]),
        angle_sigma_rad=np.array([2e-4, 3e-4]),
        width_px=20.4,
        contrast=np.array([143.0, 120.0]),
        blur_px=0.72,
        residual_px=0.058,
        used_part=np.array([0.97, 0.88]),
    )


def fake_calibration(rig: Rig, board: Board) -> Calibration:
    count = len(rig.cameras)
    spread = INTRINSICS_U * count + [2e-4, 3e-4, 2e-4, 0.11, 0.09, 0.15] * (count - 1)
    view = BoardView("left", "board/000", [0, 1], [[10, 20], [30, 20]], [0.02, 0.02])
    return Calibration(
        rig=rig,
        covariance=np.diag(np.square(spread)),
        edge_length_error=LengthError(0.241, 0.097, 1640),
        held_out=LengthError(0.263, 0.112, 1640),
        cameras=tuple(
            CameraQuality(camera.name, 0.113, 30, 1440, INTRINSICS_U, 0.83, 61, "board/007", 0.21)
            for camera in rig.cameras
        ),
        epipolar_rms_px=0.094,
        board=board,
        views=(view,) * 60,
        rejected=(RejectedView("right", "board/013", "only 31 of 48 corners are in the picture"),),
        notes=("3 views were turned by half a turn to agree with the others",),
        method="joint",
        paper=PaperRoute(rig, LengthError(0.252, 0.131, 1640), 0.103),
        noise_px=0.081,
    )


def fake_measurement(
    *,
    count: int = 70,
    miss_mm: float = 0.1,
    findings: tuple[Finding, ...] = (),
    notes: str = "Arm 2, cannula remounted before the run.\nRoom at 22 °C.",
    names: Callable[[int], str] = "{:03d}".format,
    cameras: Sequence[str] = NAMES,
) -> Measurement:
    rng = np.random.default_rng(7)
    rig, board = paper_rig(cameras), Board("checkerboard", (9, 7), 15.0, 0.01)
    axes = directions(count, rng)
    points = RCM_MM + rng.normal(0, miss_mm, (count, 3))
    points -= axes * np.sum(axes * points, axis=1)[:, None]
    rcm = solve(points, axes)
    diameters = (10.02, 9.98, 10.0)[: len(cameras)]
    poses: list[UsedPose | RejectedPose] = []
    for i in range(count):
        edges = tuple(shaft_edges(rig, c, RCM_MM, axes[i]) for c in range(len(cameras)))
        line = Centerline(
            points[i], axes[i], np.radians(80), diameters, np.zeros((4, 4)), np.eye(3)[:2]
        )
        distance = PoseDistances(
            float(rcm.minimax.distances_mm[i]), float(rcm.least_squares.distances_mm[i])
        )
        dihedral = 60 + 25 * np.sin(i)
        poses.append(UsedPose(names(i), line, distance, dihedral, diameters, edges))
    poses.insert(
        count // 3,
        RejectedPose(
            names(count),
            "no shaft in camera right: the strongest pair of edges has a contrast of 6 grey levels",
            "light the shaft or move it into both views, then take this pose again",
            (shaft_edges(rig, 0, RCM_MM, axes[0]),),
        ),
    )
    poses.append(
        RejectedPose(
            names(count + 1),
            "the centerline planes are 3.2° apart, under 5°: the shaft is in a plane with the "
            "baseline",
            "tilt the shaft out of the plane through both cameras",
        )
    )
    lines, shared = np.diag([2e-4, 5e-4, 2e-4]), np.diag([0.11, 0.06, 0.13]) ** 2
    return Measurement(
        rcm=rcm,
        uncertainty=LocationUncertainty(
            lines_mm2=lines,
            calibration_mm2=shared,
            total_mm2=lines + shared,
            coverage=0.95,
            coverage_factor=1.98,
            expanded_mm=1.98 * np.sqrt(np.diag(lines + shared)),
            degrees_of_freedom=137.0,
            max_calibration_u_mm=0.0031,
            rms_calibration_u_mm=0.0012,
        ),
        poses=tuple(poses),
        findings=findings,
        calibration=fake_calibration(rig, board),
        setup=Setup(
            "gold-standard",
            board,
            10.0,
            {"name": "spherical bearing", "serial": "GS-01", "arm": {"number": 2}},
            {"name": "A. Engineer"},
            notes,
        ),
        inputs={f"shaft/{name}/{i:03d}.png": f"{i:064x}" for name in cameras for i in range(count)},
        software="pivometer 0.1.0",
        provenance=fake_provenance(),
    )


def fake_image(pose: UsedPose | RejectedPose, camera: str, noise: float = 3.0) -> np.ndarray:
    """Paint a bright shaft on a dark, uneven ground."""
    rng = np.random.default_rng(len(pose.pose))
    rows, columns = np.mgrid[:480, :640].astype(np.float64)
    image = 90 + 30 * np.sin(columns / 90) * np.cos(rows / 70)
    for edges in pose.edges:
        if edges.camera == camera:
            (a, b), (c, d) = edges.points_px[0, [0, -1]], edges.points_px[1, [0, -1]]
            image[_side(a, b, columns, rows) * _side(c, d, columns, rows) < 0] = 190
    return np.clip(image + rng.normal(0, noise, image.shape), 0, 255).astype(np.uint8)


def _side(a: np.ndarray, b: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return (x - a[0]) * (b[1] - a[1]) - (y - a[1]) * (b[0] - a[0])


def fake_provenance() -> Provenance:
    return Provenance(
        "pivometer measure gold-standard",
        "2026-11-22T09:30:00+00:00",
        {"pivometer": "0.1.0", "numpy": "2.4.0", "opencv": "5.0.0"},
    )


@pytest.fixture(scope="session")
def make_measurement() -> Callable[..., Measurement]:
    return fake_measurement


@pytest.fixture(scope="session")
def measurement() -> Measurement:
    return fake_measurement()


@pytest.fixture(scope="session")
def thumbnails(measurement: Measurement) -> Mapping[tuple[str, str], Thumbnail]:
    """Thumbnails of every pose; all of one camera are alike, to save time."""
    shown = {name: make_thumbnail(fake_image(measurement.used[0], name)) for name in NAMES}
    return {(pose.pose, name): shown[name] for pose in measurement.poses for name in NAMES}


@pytest.fixture(scope="session")
def provenance() -> Provenance:
    return fake_provenance()


@pytest.fixture(scope="session")
def with_board_frame(measurement: Measurement) -> Measurement:
    """The measurement with a board that stood 40 mm from the RCM."""
    pose = RigidTransform.from_rotation_vector([0.0, -0.7, 0.1], RCM_MM - [30.0, 20.0, 10.0])
    to_board = pose.inverse()
    lines, corners = np.diag([1e-5, 3e-5, 1e-5]), np.diag([1e-5, 1e-5, 2e-5])
    frame = BoardFrame(
        reference_from_board=pose,
        covariance=np.eye(6) * 1e-8,
        minimax_point_mm=to_board @ measurement.rcm.minimax.point_mm,
        least_squares_point_mm=to_board @ measurement.rcm.least_squares.point_mm,
        uncertainty=BoardFrameUncertainty(
            lines_mm2=lines,
            calibration_mm2=corners,
            board_mm2=corners,
            total_mm2=lines + 2 * corners,
            degrees_of_freedom=140.0,
            coverage=0.95,
            coverage_factor=1.98,
            expanded_mm=1.98 * np.sqrt(np.diag(lines + 2 * corners)),
        ),
        centerlines=(),
        views=("reference/000", "reference/001"),
        rejected=(),
        rms_px=0.021,
        note="the reference board looks the same after a turn in its plane",
    )
    return replace(measurement, board_frame=frame)
