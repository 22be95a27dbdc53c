"""Whether the stated covariance of the RCM's location holds, with calibration: simulated sessions.

Run with ``python -m benchmarks.location [SESSIONS]``. Every session has board poses, corner errors,
robot errors and edge errors of its own; cameras are adjusted jointly to its corners (from the true
values, so that the same minimum is reached sooner), the centerlines triangulated from its edge
points, and the true RCM must lie in the stated 95 % ellipsoid in 93 to
97 of 100 sessions. Corners and edge points are simulated, not pictures. Boards of three kinds:

- as drawn, corner errors independent: what the theory assumes;
- bowed by 0.2 mm between the middle and the upper and lower ends, taken for flat and estimated;
- with columns as uneven as a real board's (set A: ± 0.1 mm on 30 mm squares, the same in all
  images), taken for even, and with ``form = "free"``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pivometer.calibration import Board, BoardView
from pivometer.calibration.board import BoardForm
from pivometer.calibration.bundle import (
    adjust,
    bundle_problem,
    bundle_state,
    covariance,
    rig_from_state,
)
from pivometer.cameras import Camera
from pivometer.geometry import RigidTransform, tangent_plane_normals
from pivometer.rcm import least_squares_rcm
from pivometer.shaft.silhouette import edge_normals
from pivometer.shaft.triangulation import lines_from_edge_normals
from pivometer.simulation.boards import Pattern, pair_poses, single_poses
from pivometer.simulation.presets import gold
from pivometer.simulation.robots import cone_directions
from pivometer.uncertainty import lies_within, location_uncertainty

Floats = NDArray[np.float64]

SESSIONS = 300
PAIRS, SINGLES, POSES = 20, 10, 40
CORNER_PX, EDGE_PX, MISS_MM = 0.05, 0.05, 0.05
COLUMNS_MM = 0.4 * np.array([-0.11, -0.01, 0.12, 0.12, 0.03, -0.05, -0.05, 0.03, -0.02])
"""Displacements of set A's columns, for squares of 12 mm instead of 30 (mean size unchanged)."""
COLUMNS_MM -= np.polyval(np.polyfit(np.arange(9), COLUMNS_MM, 1), np.arange(9))
SQUARES, SQUARE_MM = (10, 7), 12.0


@dataclass
class Edges:
    """Both edges of a shaft in one camera: what `location_uncertainty` needs."""

    camera: str
    points_px: Floats


def drawn(board: Board) -> Floats:
    """Return no displacement."""
    return np.zeros((board.corner_count, 3))


def bowed(board: Board) -> Floats:
    """Return a quadric of 0.2 mm along the height and 0.1 mm along the width."""
    x, y = (2 * board.columns_rows / (np.array(board.inner_corners) - 1.0) - 1).T
    return np.stack([0 * x, 0 * x, 0.1 * x * x + 0.2 * y * y], axis=1)


def uneven(board: Board) -> Floats:
    """Return columns of uneven width."""
    aside = COLUMNS_MM[board.columns_rows[:, 0]]
    return np.stack([aside, 0 * aside, 0 * aside], axis=1)


KINDS: dict[str, tuple[Callable[[Board], Floats], BoardForm]] = {
    "as drawn": (drawn, "bowed"),
    "as drawn, taken for flat": (drawn, "flat"),
    "bowed, taken for flat": (bowed, "flat"),
    "bowed": (bowed, "bowed"),
    "uneven columns, taken for even": (uneven, "bowed"),
    "uneven columns, free": (uneven, "free"),
}


@dataclass
class Outcome:
    """How far one session's location is from the truth, and what it states."""

    error_mm: Floats
    covariance_mm2: Floats
    inside: bool


def session(kind: str, seed: int) -> Outcome:
    """Simulate, calibrate and measure one session."""
    random = np.random.default_rng([seed, 1])
    setup = gold()
    displaced, form = KINDS[kind]
    board = Board("checkerboard", SQUARES, SQUARE_MM, form=form)
    views = board_views(setup.rig.cameras, board, board.corners_mm + displaced(board), seed)
    names = [camera.name for camera in setup.rig.cameras]
    problem = bundle_problem([view for view, _ in views], board, names, shaped=True)
    solution = adjust(problem, bundle_state(problem, setup.rig, [pose for _, pose in views]))
    rig = rig_from_state(solution.state, setup.rig.cameras)
    edges = shaft_edges(random)
    normals = np.stack(
        [
            edge_normals(np.stack([pose[c].points_px for pose in edges]), camera)
            for c, camera in enumerate(rig.cameras)
        ],
        axis=1,
    )
    points, axes, _ = lines_from_edge_normals(normals, rig.reference_from_camera)
    point = least_squares_rcm(points, axes).point_mm
    stated = location_uncertainty(edges, rig, covariance(problem, solution))
    truth = np.asarray(setup.reference_from_robot.translation_mm)
    inside = lies_within(
        truth, point, stated.total_mm2, degrees_of_freedom=stated.degrees_of_freedom
    )
    return Outcome(point - truth, stated.total_mm2, inside)


def board_views(
    cameras: Sequence[Camera], board: Board, corners_mm: Floats, seed: int
) -> list[tuple[BoardView, RigidTransform]]:
    """Return pairs and single views of a board with corner errors, and ``camera_from_board``."""
    setup, random = gold(), np.random.default_rng([seed, 2])
    pattern = Pattern(squares=SQUARES, square_mm=SQUARE_MM)
    ids, sigma = np.arange(board.corner_count), np.full(board.corner_count, CORNER_PX)

    def seen(
        camera: Camera, view: str, camera_from_board: RigidTransform
    ) -> tuple[BoardView, RigidTransform]:
        pixels = camera.project(camera_from_board @ corners_mm)
        errors = CORNER_PX * random.standard_normal(pixels.shape)
        return BoardView(camera.name, view, ids, pixels + errors, sigma), camera_from_board

    views = []
    for number, pose in enumerate(pair_poses(pattern, setup.rig, setup.placement, PAIRS, random)):
        for camera, place in zip(cameras, setup.rig.reference_from_camera, strict=True):
            views.append(seen(camera, f"board/{number}", place.inverse() @ pose))
    for camera, far in zip(cameras, setup.single_mm, strict=True):
        for number, pose in enumerate(single_poses(pattern, camera, far, SINGLES, random)):
            views.append(seen(camera, f"intrinsics/{camera.name}/{number}", pose))
    return views


def shaft_edges(random: np.random.Generator) -> list[list[Edges]]:
    """Return a shaft's edges in poses that miss the RCM by independent errors."""
    setup = gold()
    directions = setup.reference_from_robot.rotate(cone_directions(POSES, setup.cone_deg))
    truth = setup.reference_from_robot.translation_mm
    through = truth + MISS_MM * random.standard_normal((POSES, 3))
    return [
        [
            Edges(camera.name, _edge_points(camera, place.inverse(), point, axis, random))
            for camera, place in zip(
                setup.rig.cameras, setup.rig.reference_from_camera, strict=True
            )
        ]
        for point, axis in zip(through, directions, strict=True)
    ]


def _edge_points(
    camera: Camera,
    camera_from_reference: RigidTransform,
    point: Floats,
    axis: Floats,
    random: np.random.Generator,
) -> Floats:
    """Return 40 points where the tangent planes touch the shaft, with errors of their own."""
    base, direction = camera_from_reference @ point, camera_from_reference.rotate(axis)
    along = np.linspace(20, 110, 40)[:, None]
    edges = [
        camera.project(base + 5.0 * normal + along * direction)
        for normal in tangent_plane_normals(base, direction, 5.0)
    ]
    return np.stack(edges) + EDGE_PX * random.standard_normal((2, 40, 2))


def main(sessions: int = SESSIONS) -> None:
    """Print the coverage for every kind of board."""
    heading = f"{'board':34}{'coverage':>10}{'± chance':>10}{'error rms, mm':>15}"
    print(f"{sessions} sessions each\n{heading}{'stated u, mm':>14}")
    for kind in KINDS:
        found = [session(kind, seed) for seed in range(sessions)]
        share = float(np.mean([one.inside for one in found]))
        error = np.sqrt(np.mean([one.error_mm @ one.error_mm for one in found]))
        stated = np.sqrt(np.mean([np.trace(one.covariance_mm2) for one in found]))
        chance = np.sqrt(0.95 * 0.05 / sessions)
        target = "93–97 %" if kind == "as drawn" else ""
        verdict = "" if not target else "  pass" if 0.93 <= share <= 0.97 else "  FAIL"
        print(
            f"{kind:34}{100 * share:9.1f}%{100 * chance:9.1f}%{error:15.4f}{stated:14.4f}"
            f"  {target}{verdict}",
            flush=True,
        )


if __name__ == "__main__":
    main(int(sys.argv[1]) if sys.argv[1:] else SESSIONS)
