"""Do stated 95 % intervals hold the truth? Simulated sessions with calibration error, edges to RCM.

Run with ``python -m benchmarks.coverage [SESSIONS]``. In every session a robot of 0.05 mm rms takes
40 poses drawn at random from a cone; its misses are independent, follow the direction of the shaft
(two axes that pass each other), have heavy tails (t with 3 degrees of freedom), or are none. The
true cameras see edges with noise and light from one side; what is measured uses cameras that are
off as a calibration of 20 pairs and 20 single views leaves them. Edges and cameras are simulated,
not pictures; their covariances are right. What is held against the truth:

- location, least squares: the 95 % ellipsoid, with all parts, against the RCM (the point that all
  directions of the cone together would give, where the misses follow the direction);
- location, weighted (GLS): the same with its covariance;
- own rms, own max: the robot's own error over these poses, as `measure` states it;
- max ± U: the observed largest miss with its first-order uncertainty, k = 2. It is not stated
  as an interval anywhere, because of what this row shows: noise pushes the largest miss up.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.location import board_views
from pivometer.calibration import Board
from pivometer.calibration.bundle import adjust, bundle_problem, bundle_state, covariance
from pivometer.cameras import Camera, Rig
from pivometer.geometry import RigidTransform
from pivometer.rcm import solve
from pivometer.rcm.weighted import weighted_rcm
from pivometer.shaft.triangulation import triangulate_centerline
from pivometer.simulation.presets import gold
from pivometer.uncertainty import (
    LineErrors,
    calibration_displacements,
    intrinsic_error,
    lies_within,
    location_uncertainty,
)
from pivometer.uncertainty.foresight import ForeseenEdges, Shaft, foreseen_edges
from pivometer.uncertainty.propagation import square_root
from pivometer.uncertainty.shading import SHADING_PX, shading_displacements

Floats = NDArray[np.float64]

SESSIONS, POSES = 500, 40
ROBOT_MM, EDGE_PX = 0.05, 0.15
SHAFT = Shaft(10.0, (20.0, 110.0))


def passing_axes(axes: Floats, _: np.random.Generator) -> Floats:
    """Return misses that depend on the direction only: two tilt axes that pass each other."""
    x, y, z = axes.T
    return np.stack([3 * y**2 - 0.5 * x, x * y + 0.4 * x, 0 * z], axis=1)


FIELDS: dict[str, Callable[[Floats, np.random.Generator], Floats]] = {
    "independent": lambda axes, random: random.standard_normal(axes.shape),
    "following the direction": passing_axes,
    "heavy tails": lambda axes, random: random.standard_t(3, axes.shape),
    "none": lambda axes, _: 0 * axes,
}
STATEMENTS = ("location, least squares", "location, weighted", "own rms", "own max", "max ± U")


def cone(random: np.random.Generator, count: int) -> Floats:
    """Return directions drawn evenly from the gold standard's cone, robot's frame."""
    setup = gold()
    height = random.uniform(np.cos(np.radians(setup.cone_deg) / 2), 1, count)
    turn, across = 2 * np.pi * random.random(count), np.sqrt(1 - height**2)
    return np.stack([across * np.cos(turn), across * np.sin(turn), height], axis=1)


def sized(field: str) -> tuple[float, Floats]:
    """Return the factor that makes a field's rms the robot's, and where its RCM then lies."""
    random = np.random.default_rng(0)
    axes = cone(random, 20_000)
    misses = FIELDS[field](axes, random)
    found = solve(misses, axes).least_squares
    factor = ROBOT_MM / found.rms_mm if found.rms_mm > 0 else 0.0
    return factor, factor * found.point_mm if field == "following the direction" else np.zeros(3)


def calibrated() -> tuple[Rig, Floats]:
    """Return the true cameras, and the covariance that a joint calibration of them has."""
    setup, board = gold(), Board("checkerboard", (10, 7), 12.0)
    views = board_views(setup.rig.cameras, board, board.corners_mm, 0)
    names = [camera.name for camera in setup.rig.cameras]
    problem = bundle_problem([view for view, _ in views], board, names, shaped=True)
    solution = adjust(problem, bundle_state(problem, setup.rig, [pose for _, pose in views]))
    return setup.rig, covariance(problem, solution)


def seen(
    camera: Camera,
    camera_from_reference: RigidTransform,
    line: tuple[Floats, Floats],
    light: float,
    random: np.random.Generator,
) -> ForeseenEdges:
    """Return the edges of one pose in one camera, with noise, and with light from one side."""
    exact = foreseen_edges(camera, camera_from_reference, *line, SHAFT, edge_px=EDGE_PX)
    points = exact.points_px.copy()
    ways = points[:, -1] - points[:, 0]
    lengths = np.linalg.norm(ways, axis=1)
    across = np.stack([-ways[:, 1], ways[:, 0]], axis=1) / lengths[:, None]
    across *= np.sign(across[:, :1])  # to the right in the picture, in all poses
    places = np.linspace(-1, 1, points.shape[1])
    for side in range(2):
        offset, slope = random.standard_normal(2) * EDGE_PX / np.sqrt(lengths[side]) * [1, 3**0.5]
        points[side] += (SHADING_PX * light + offset + slope * places)[:, None] * across[side]
    return ForeseenEdges(exact.camera, points, exact.normals, exact.normals_covariance)


@dataclass
class Lines:
    """What is measured in one session."""

    edges: list[list[ForeseenEdges]]
    points: Floats
    directions: Floats
    covariances: Callable[[Floats], Floats]


def measured(edges: list[list[ForeseenEdges]], rig: Rig) -> Lines:
    """Triangulate the edges of all poses with a rig."""
    from pivometer.shaft.silhouette import edge_normals

    found = [
        triangulate_centerline(
            np.stack([edge_normals(e.points_px, rig.cameras[k]) for k, e in enumerate(pose)]),
            list(rig.reference_from_camera),
            covariances=np.stack([e.normals_covariance for e in pose]),
        )
        for pose in edges
    ]
    return Lines(
        edges,
        np.stack([line.point_mm for line in found]),
        np.stack([line.direction for line in found]),
        lambda at: np.stack([line.position_covariance_mm2(at) for line in found]),
    )


def session(field: str, seed: int, true_rig: Rig, sigma: Floats) -> list[bool]:
    """Simulate and measure one session; tell which statements hold."""
    random = np.random.default_rng([seed, *field.encode()])
    factor, shift = SIZES[field]
    inside = cone(random, POSES)
    to_reference = gold().reference_from_robot
    misses = to_reference.rotate(factor * FIELDS[field](inside, random))
    axes = to_reference.rotate(inside)
    through = to_reference.translation_mm + misses
    light = random.standard_normal(len(true_rig.cameras))
    edges = [
        [
            seen(camera, place.inverse(), (point, axis), light[k], random)
            for k, (camera, place) in enumerate(
                zip(true_rig.cameras, true_rig.reference_from_camera, strict=True)
            )
        ]
        for point, axis in zip(through, axes, strict=True)
    ]
    root = square_root(sigma)
    rig = true_rig.perturbed(root @ random.standard_normal(root.shape[1]))
    lines = measured(edges, rig)
    return judged(lines, rig, sigma, to_reference @ shift, solve(through, axes))


def judged(lines: Lines, rig: Rig, sigma: Floats, rcm_mm: Floats, truth: object) -> list[bool]:
    """Return whether each statement holds the truth."""
    found = solve(lines.points, lines.directions)
    point = found.least_squares.point_mm
    stated = location_uncertainty(lines.edges, rig, sigma)
    errors = LineErrors(
        lines.directions,
        lines.covariances(point),
        calibration_displacements(lines.edges, rig, sigma, point),
        shading_displacements(lines.edges, rig, point),
    )
    noise = errors.stated()
    own = intrinsic_error(
        lines.points,
        lines.directions,
        noise.alone_mm2,
        common_mm=noise.common_mm,
        possible=errors.possible(),
    )
    known = calibration_displacements(lines.edges, rig, sigma, point, of_misses=False)
    common = np.concatenate([known, errors.shading_mm], axis=2)
    weighted = weighted_rcm(lines.points, lines.directions, noise.alone_mm2, common_mm=common)
    freedom = stated.degrees_of_freedom
    rms, largest = truth.least_squares.rms_mm, truth.minimax.max_mm  # type: ignore[attr-defined]
    return [
        lies_within(rcm_mm, point, stated.total_mm2, degrees_of_freedom=freedom),
        lies_within(rcm_mm, weighted.point_mm, weighted.covariance_mm2, degrees_of_freedom=freedom),
        bool(own.rms_interval_mm[0] <= rms <= own.rms_interval_mm[1]),
        bool(own.max_interval_mm[0] <= largest <= own.max_interval_mm[1]),
        abs(found.minimax.max_mm - largest) <= 2 * (own.max_u_mm or 0.0),
    ]


SIZES = {field: sized(field) for field in FIELDS}
ASKED = {"location, least squares": (0.93, 0.97), "own rms": (0.93, 0.97)}
"""What is asked for. Where the robot misses by nothing, the lower end of its own rms is zero or
wrong and the upper end never: one tail is left, and 97.5 % or more must hold."""


def main(sessions: int = SESSIONS) -> None:
    """Print the coverage of every statement for every kind of misses."""
    rig, sigma = calibrated()
    chance = 100 * np.sqrt(0.95 * 0.05 / sessions)
    print(
        f"{sessions} sessions of {POSES} poses each, coverage of 95 % statements (± {chance:.1f} %)"
    )
    print(f"{'misses':26}" + "".join(f"{name:>26}" for name in STATEMENTS))
    for field in FIELDS:
        held = np.mean([session(field, seed, rig, sigma) for seed in range(sessions)], axis=0)
        cells = []
        for name, share in zip(STATEMENTS, held, strict=True):
            low, high = ASKED.get(name, (0.0, 1.0))
            if (field, name) == ("none", "own rms"):
                low, high = 0.95, 1.0
            verdict = "" if name not in ASKED else " pass" if low <= share <= high else " FAIL"
            cells.append(f"{100 * share:.1f} %{verdict}")
        print(f"{field:26}" + "".join(f"{cell:>26}" for cell in cells), flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if sys.argv[1:] else SESSIONS)
