"""Sessions that cannot support an answer: how many are refused or flagged, and how many good ones.

Run with ``OMP_NUM_THREADS=1 python -m benchmarks.refusals [--instances 200] [--rendered]``. Each
instance is a random session at the level of edges: ideal edges of a cylinder with noise, measured
with a calibration from simulated corners that is itself wrong by its uncertainty (whose covariance
only the good sessions use). It goes through
the same steps as a session's pictures once their edges are fitted. ``--rendered`` adds a few whole
sessions. What a case is and from where on it counts stands beside it.
"""

from __future__ import annotations

import argparse
import re
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from pivometer._arrays import Floats
from pivometer.calibration import Board, Calibration
from pivometer.cameras import Rig
from pivometer.errors import DataError
from pivometer.geometry import RigidTransform
from pivometer.geometry.line import unit
from pivometer.io.session import ImageFile, Session, load
from pivometer.measurement import ImportedRig, Measurement
from pivometer.pipeline import foreseen_calibration, measure, simulate, two_cameras
from pivometer.pipeline.measuring import measure_edges
from pivometer.shaft.fitting.stated import ShaftEdges
from pivometer.shaft.silhouette import edge_normals
from pivometer.simulation.presets import preset_named
from pivometer.simulation.robots import (
    Motion,
    Robot,
    SphericalBearing,
    cone_directions,
    motion_from_lines,
)
from pivometer.uncertainty.foresight import Shaft, foreseen_edges

SHAFT = Shaft(10.0, (20.0, 110.0))
BOARD = Board("checkerboard", (9, 7), 15.0)
EDGE_PX = 0.1
CALIBRATIONS = 10
"""Of the same cameras; the instances take turns."""
UP = np.array([0.0, -1.0, 0.0])


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """The lines of a session and, where it moves, the true rig of each pose."""

    points_mm: Floats
    directions: Floats
    rigs: Sequence[Rig]


def turned(directions: Floats, middle: Floats) -> Floats:
    """Turn directions about z to directions about another axis."""
    x = unit(np.cross(middle, [0.3, 0.2, 1.0]))
    return directions @ np.stack([x, np.cross(middle, x), middle])


class World:
    """The cameras, their calibration, and where the RCM is."""

    def __init__(self, seed: int = 0) -> None:
        self.rig = two_cameras(
            focal_px=1000, image_size=(1280, 1024), distance_mm=480, baseline_mm=525
        )
        self.calibration: Calibration = foreseen_calibration(
            self.rig, BOARD, board_views=20, seed=seed
        )

    def rcm(self, middle: Floats) -> Floats:
        """Return the RCM that puts the visible part of the shaft where the cameras look."""
        point: Floats = np.array([0.0, 0.0, 480.0]) - sum(SHAFT.span_mm) / 2 * middle
        return point

    def scene(
        self, axes: Floats, middle: Floats, robot_mm: float, rng: np.random.Generator
    ) -> Scene:
        """Return a session of a robot with independent misses."""
        misses = robot_mm * rng.standard_normal(axes.shape)
        return Scene(self.rcm(middle) + misses, axes, [self.rig] * len(axes))

    def measured(
        self, scene: Scene, rng: np.random.Generator, *, imported: bool = False
    ) -> Measurement:
        """See the scene's edges with noise and measure them, with the rig's covariance or not."""
        names = [f"{k:03}" for k in range(len(scene.directions))]
        seen: dict[str, dict[str, ShaftEdges | DataError]] = {}
        for c, camera in enumerate(self.rig.cameras):
            seen[camera.name] = {
                name: self._edges(scene, k, c, rng) for k, name in enumerate(names)
            }
        calibration: Calibration | ImportedRig = self.calibration
        if imported:  # a third of the time
            calibration = ImportedRig(self.calibration.rig, "opencv", {})
        return measure_edges(self._session(names), calibration, seen, {})

    def _edges(self, scene: Scene, pose: int, c: int, rng: np.random.Generator) -> ShaftEdges:
        rig = scene.rigs[pose]
        camera, to = rig.cameras[c], rig.reference_from_camera[c].inverse()
        ideal = foreseen_edges(
            camera, to, scene.points_mm[pose], scene.directions[pose], SHAFT, edge_px=EDGE_PX
        )
        points = np.array(ideal.points_px)
        places = np.linspace(-1, 1, points.shape[1])
        for side in range(2):
            way = points[side, -1] - points[side, 0]
            length = float(np.linalg.norm(way))
            offset, slope = EDGE_PX * np.sqrt([1 / length, 3 / length]) * rng.standard_normal(2)
            across = np.array([-way[1], way[0]]) / length
            points[side] += (offset + slope * places)[:, None] * across
        return ShaftEdges(
            camera=camera.name,
            points_px=points,
            normals=edge_normals(points, self.calibration.rig.cameras[c]),
            normals_covariance=ideal.normals_covariance,
            sigma_px=np.full(2, EDGE_PX / np.sqrt(length)),
            angle_sigma_rad=np.full(2, EDGE_PX * np.sqrt(12 / length**3)),
            width_px=20.0,
            contrast=np.full(2, 100.0),
            blur_px=0.8,
            residual_px=EDGE_PX,
            used_part=np.ones(2),
        )

    def _session(self, names: Sequence[str]) -> Session:
        none: MappingProxyType[str, MappingProxyType[str, ImageFile]] = MappingProxyType({})
        images = {
            name: MappingProxyType(
                {c.name: ImageFile(Path(), name, c.name, f"shaft/{name}") for c in self.rig.cameras}
            )
            for name in names
        }
        return Session(
            folder=Path("simulated"),
            board=BOARD,
            diameter_mm=SHAFT.diameter_mm,
            cameras=tuple(camera.name for camera in self.rig.cameras),
            device={},
            operator={},
            notes="",
            board_views=none,
            intrinsics=none,
            shaft=MappingProxyType(images),
            background=none,
            reference_views=none,
            closing=none,
            ignored=(),
        )


def filled(count: int, apex_deg: float, rng: np.random.Generator, middle: Floats = UP) -> Floats:
    """Return directions that fill a cone, in an order that follows nothing."""
    return turned(rng.permutation(cone_directions(count, apex_deg)), middle)


def narrow(low: float, high: float) -> Callable[[World, np.random.Generator], Scene]:
    """Return a maker of sessions with a cone between two apex angles, deg."""

    def made(world: World, rng: np.random.Generator) -> Scene:
        axes = filled(int(rng.integers(20, 40)), float(rng.uniform(low, high)), rng)
        return world.scene(axes, UP, rng.uniform(0.005, 0.05), rng)

    return made


def few_wide(world: World, rng: np.random.Generator) -> Scene:
    """Return all but two poses within 3°, and those two 24° to 40° apart."""
    axes = filled(30, 3.0, rng)
    half, turn = np.radians(rng.uniform(12, 20)), rng.uniform(0, 2 * np.pi)
    tilted = [
        [s * np.sin(half) * np.cos(turn), s * np.sin(half) * np.sin(turn), np.cos(half)]
        for s in (1, -1)
    ]
    axes = rng.permutation(np.vstack([axes, turned(np.array(tilted), UP)]))
    return world.scene(axes, UP, 0.02, rng)


def one_joint(world: World, rng: np.random.Generator) -> Scene:
    """Return a sweep of 30° to 60° about a random axis, the other joint within ± 0.1°."""
    count, sweep = 30, np.radians(rng.uniform(30, 60))
    angles = np.linspace(-sweep / 2, sweep / 2, count)
    aside = np.radians(rng.uniform(-30, 30)) + np.radians(0.1) * rng.uniform(-1, 1, count)
    axes = np.stack(
        [np.sin(angles) * np.cos(aside), np.sin(aside), np.cos(angles) * np.cos(aside)], axis=1
    )
    middle = unit(axes.mean(axis=0))
    spun = RigidTransform.from_rotation_vector(rng.uniform(0, 2 * np.pi) * UP, np.zeros(3))
    axes = spun.rotate(turned(axes @ _frame(middle).T, UP))
    return world.scene(axes, UP, 0.02, rng)


def _frame(middle: Floats) -> Floats:
    x = unit(np.cross(middle, [0.3, 0.2, 1.0]))
    return np.stack([x, np.cross(middle, x), middle])


def static(world: World, rng: np.random.Generator) -> Scene:
    """Return a tool that stands still to within 0.02°."""
    return world.scene(filled(24, rng.uniform(0.001, 0.04), rng), UP, 0.002, rng)


def flat(world: World, rng: np.random.Generator) -> Scene:
    """Return a cone whose middle lies in the plane of the RCM and both cameras."""
    turn = rng.uniform(-0.3, 0.3)
    middle = np.array([np.cos(turn), 0.0, np.sin(turn)])
    return world.scene(filled(30, 57.0, rng, middle), middle, 0.02, rng)


def too_few(world: World, rng: np.random.Generator) -> Scene:
    """Return 3 to 19 poses."""
    return world.scene(filled(int(rng.integers(3, 20)), 57.0, rng), UP, 0.02, rng)


def robot_jump(world: World, rng: np.random.Generator) -> Scene:
    """Move the robot by 0.15 to 1 mm across the shaft, a third to two thirds on."""
    count = int(rng.integers(20, 71))
    scene = world.scene(filled(count, 57.0, rng), UP, 0.015, rng)
    way = rng.uniform(0, 2 * np.pi)
    step = rng.uniform(0.15, 1.0) * np.array([np.cos(way), 0.0, np.sin(way)])
    after = np.arange(count) >= rng.integers(count // 3, 2 * count // 3 + 1)
    return replace(scene, points_mm=scene.points_mm + np.outer(after, step))


def camera_jump(world: World, rng: np.random.Generator) -> Scene:
    """Turn the right camera by 0.5 to 2 mrad about the vertical: 0.25 to 1 mm at the RCM."""
    count = int(rng.integers(20, 71))
    scene = world.scene(filled(count, 57.0, rng), UP, 0.015, rng)
    left, right = world.rig.reference_from_camera
    size = rng.choice([-1, 1]) * rng.uniform(0.5e-3, 2e-3)
    turn = RigidTransform.from_rotation_vector([0.0, size, 0.0], np.zeros(3))
    moved = Rig(world.rig.cameras, [left, right @ turn])
    at = int(rng.integers(count // 3, 2 * count // 3 + 1))
    return replace(scene, rigs=[world.rig] * at + [moved] * (count - at))


def drift(world: World, rng: np.random.Generator) -> Scene:
    """Let the robot drift by 0.2 to 1 mm across the shaft over 30 to 70 poses."""
    count = int(rng.integers(30, 71))
    scene = world.scene(filled(count, 57.0, rng), UP, 0.015, rng)
    way = rng.uniform(0, 2 * np.pi)
    step = rng.uniform(0.2, 1.0) * np.array([np.cos(way), 0.0, np.sin(way)])
    return replace(scene, points_mm=scene.points_mm + np.outer(np.arange(count) / count, step))


def good_bearing(world: World, rng: np.random.Generator) -> Scene:
    """Return a bearing with independent misses, 20 to 70 poses in a cone of 30° to 70°."""
    axes = filled(int(rng.integers(20, 71)), rng.uniform(30, 70), rng)
    return world.scene(axes, UP, rng.uniform(0.005, 0.05), rng)


def good_arm(world: World, rng: np.random.Generator) -> Scene:
    """Return the da Vinci-like arm, 20 to 70 poses in a random order or from in to out."""
    count = int(rng.integers(20, 71))
    cone = cone_directions(count, 57.0)
    cone = rng.permutation(cone) if rng.random() < 0.5 else cone
    motion = preset_named("davinci").robot.move(cone, rng)
    points = rng.uniform(0.05, 1.0) * turned(motion.points_mm, UP)
    return Scene(world.rcm(UP) + points, turned(motion.directions, UP), [world.rig] * count)


CASES: dict[str, tuple[Callable[[World, np.random.Generator], Scene], str]] = {
    "cone of 0.5° to 5°": (narrow(0.5, 4.9), "cone"),
    "cone of 5° to 20°": (narrow(5.2, 19.5), "cone"),
    "wide by two poses only": (few_wide, "cone"),
    "one joint moves": (one_joint, "one joint"),
    "tool stands still": (static, "cone"),
    "plane through the baseline": (flat, "apart"),
    "3 to 19 poses": (too_few, "only"),
    "robot jumps half-way": (robot_jump, "moved during"),
    "camera turns half-way": (camera_jump, "moved during"),
    "robot drifts": (drift, "moved during"),
    "good: bearing": (good_bearing, ""),
    "good: arm": (good_arm, ""),
}


def outcome(world: World, make: Callable[..., Scene], word: str, seed: int) -> tuple[str, str]:
    """Return "refused", "flagged" or "passed", and what was said."""
    rng = np.random.default_rng(seed)
    try:
        measurement = world.measured(make(world, rng), rng, imported=bool(word))
    except DataError as error:
        return "refused", error.what
    told = [f.text for f in measurement.findings if word in f.text]
    told += [pose.reason for pose in measurement.rejected if word and word in pose.reason]
    return ("flagged" if told else "passed"), "; ".join(told)


def _gist(text: str) -> str:
    """Return the beginning of what was said, without its numbers."""
    return re.sub(r"[0-9.]+", "…", text)[:60]


def table(instances: int) -> None:
    """Print one row for each case."""
    worlds = [World(seed) for seed in range(CALIBRATIONS)]
    print(f"{'case':30}{'instances':>10}{'refused':>9}{'flagged':>9}{'passed':>8}{'s each':>8}")
    for name, (make, word) in CASES.items():
        start = time.process_time()
        found = [
            outcome(worlds[seed % CALIBRATIONS], make, word, seed) for seed in range(instances)
        ]
        each = (time.process_time() - start) / instances
        counts = [sum(one == kind for one, _ in found) for kind in ("refused", "flagged", "passed")]
        row = f"{name:30}{instances:10}{counts[0]:9}{counts[1]:9}{counts[2]:8}{each:8.2f}"
        print(row, flush=True)
        if name.startswith("good"):
            said = Counter(_gist(t) for k, told in found if k != "passed" for t in told.split("; "))
            for text, times in said.most_common():
                print(f"    {times:4} × {text}", flush=True)


@dataclass(frozen=True, slots=True, eq=False)
class Spoilt:
    """A robot that is moved half-way, or moves one joint only."""

    robot: Robot
    jump_mm: float = 0.0
    joint: bool = False

    def move(self, directions: Floats, rng: np.random.Generator) -> Motion:
        """Return where the shaft truly is."""
        order = rng.permutation(len(directions))
        asked = directions[order]
        if self.joint:
            asked = unit(asked * [1.0, 0.0, 1.0])
        motion = self.robot.move(asked, rng)
        after = np.arange(len(asked)) >= len(asked) // 2
        points = motion.points_mm + np.outer(after, [self.jump_mm, 0, 0])
        return motion_from_lines(motion.joint_names, motion.joints, points, motion.directions)


def rendered() -> None:
    """Render a few whole sessions and measure them."""
    gold, bearing = replace(preset_named("gold"), poses=20), SphericalBearing()
    sessions = {
        "good": gold,
        "robot jumps by 0.3 mm": replace(gold, robot=Spoilt(bearing, jump_mm=0.3)),
        "one joint moves": replace(gold, robot=Spoilt(bearing, joint=True)),
        "cone of 3°": replace(gold, cone_deg=3.0),
        "cone of 12°": replace(gold, cone_deg=12.0),
        "tool stands still": replace(gold, cone_deg=0.02),
    }
    for name, preset in sessions.items():
        with tempfile.TemporaryDirectory() as folder:
            root = simulate(preset, Path(folder) / "session", seed=1)
            try:
                found = measure(load(root)).findings
                told = "; ".join(one.text for one in found) or "no finding"
            except DataError as error:
                told = f"refused: {error.what}"
        print(f"{name:24}{told}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--instances", type=int, default=200)
    parser.add_argument("--rendered", action="store_true")
    given = parser.parse_args()
    table(given.instances)
    if given.rendered:
        rendered()
