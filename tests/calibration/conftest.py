"""A simulated set-up of known truth: the paper's geometry, corners only, no images."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import pytest

from pivometer.calibration.board import Board, BoardView
from pivometer.cameras import Camera, Rig
from pivometer.geometry.rigid import RigidTransform, rotation_from_vector


@dataclass(frozen=True)
class Scene:
    """Cameras, a board, and where the board stood at each moment."""

    rig: Rig
    board: Board
    moments: Mapping[str, RigidTransform]  # reference_from_board

    @property
    def sizes(self) -> dict[str, tuple[int, int]]:
        return {c.name: (c.width, c.height) for c in self.rig.cameras}

    def who(self, moment: str) -> list[str]:
        """Return the cameras that see a moment: all, or the one its name holds."""
        parts = moment.split("/")
        return [parts[1]] if parts[0] == "intrinsics" else [c.name for c in self.rig.cameras]

    def camera_from_board(self, camera: str, moment: str) -> RigidTransform:
        pose = self.rig.reference_from_camera[self.rig.index(camera)]
        return pose.inverse() @ self.moments[moment]

    def view(self, camera: str, moment: str, pose: RigidTransform | None = None) -> BoardView:
        """Project the board without noise."""
        pose = self.camera_from_board(camera, moment) if pose is None else pose
        pixels = self.rig.cameras[self.rig.index(camera)].project(pose @ self.board.corners_mm)
        ids = np.arange(self.board.corner_count)
        return BoardView(camera, moment, ids, pixels, np.full(len(ids), 0.1))

    def views(self, noise_px: float = 0.0, seed: int = 0) -> list[BoardView]:
        """Project every moment into every camera that sees it."""
        rng = np.random.default_rng(seed)
        exact = [self.view(c, m) for m in self.moments for c in self.who(m)]
        return [noisy(v, noise_px, rng) for v in exact]

    def only(self, keep: Callable[[str], bool]) -> "Scene":
        return replace(self, moments={m: p for m, p in self.moments.items() if keep(m)})


def noisy(view: BoardView, noise_px: float, rng: np.random.Generator) -> BoardView:
    pixels = view.pixels + noise_px * rng.standard_normal(view.pixels.shape)
    return BoardView(view.camera, view.view, view.ids, pixels, view.sigma_px)


def make_scene(
    *,
    pairs: int = 12,
    singles: int = 6,
    squares: tuple[int, int] = (9, 7),
    third: bool = False,
    seed: int = 1,
) -> Scene:
    rng = np.random.default_rng(seed)
    left = Camera("left", 640, 480, [980, 984], [314, 245], [-0.17, 0.08])
    right = Camera("right", 640, 480, [1012, 1009], [327, 234], [-0.22, 0.11])
    # the right camera stands to the right and looks across: 84° between the optical axes
    left_from_right = RigidTransform.from_rotation_vector([0.03, -1.466, 0.02], [470, 5, 430])
    cameras, poses = [left, right], [RigidTransform.identity(), left_from_right]
    if third:
        cameras.append(Camera("top", 800, 600, [1150, 1152], [405, 296], [-0.1, 0.02]))
        poses.append(RigidTransform.from_rotation_vector([0.5, -0.75, 0.0], [300, 300, 60]))
    board = Board("checkerboard", squares, 15.0)
    scene = Scene(Rig(cameras, poses), board, {})
    moments = {}
    for i in range(pairs):
        name = f"board/{i:03d}"
        moments[name] = _seen_pose(scene, [c.name for c in cameras], -np.pi / 4, 0.45, rng)
    for camera in cameras:
        for i in range(singles):
            pose = _seen_pose(scene, [camera.name], None, 0.6, rng)
            moments[f"intrinsics/{camera.name}/{i:03d}"] = pose
    return replace(scene, moments=moments)


def _seen_pose(
    scene: Scene,
    names: list[str],
    turn_rad: float | None,
    spread_rad: float,
    rng: np.random.Generator,
) -> RigidTransform:
    """Draw board poses until every camera named sees all corners."""
    for _ in range(10_000):
        index = scene.rig.index(names[0])
        tilt = rotation_from_vector(rng.normal(0, spread_rad, 3))
        if turn_rad is not None:
            tilt = rotation_from_vector([0, turn_rad, 0]) @ tilt
        centre = np.array([0, 10, 470]) + rng.uniform(-1, 1, 3) * [90, 70, 90]
        pose = RigidTransform(tilt, centre - tilt @ scene.board.corners_mm.mean(axis=0))
        if turn_rad is None:
            pose = scene.rig.reference_from_camera[index] @ pose
        drawn = replace(scene, moments={"drawn": pose})
        if all(_inside(drawn, name) for name in names):
            return pose
    raise RuntimeError("no pose is seen by all cameras")


def _inside(scene: Scene, name: str) -> bool:
    pose = scene.camera_from_board(name, "drawn")
    points = pose @ scene.board.corners_mm
    if pose.rotation[2, 2] < 0.3 or points[:, 2].min() < 100:
        return False
    camera = scene.rig.cameras[scene.rig.index(name)]
    pixels = camera.project(points)
    return bool((pixels > 8).all() and (pixels < [camera.width - 8, camera.height - 8]).all())


@pytest.fixture(scope="session")
def scene() -> Scene:
    """Two cameras, 12 pairs, 6 single views a camera, a board that looks the same half-turned."""
    return make_scene()


@pytest.fixture(scope="session")
def three_cameras() -> Scene:
    return make_scene(third=True, pairs=10, singles=4)


@pytest.fixture(scope="session")
def build_scene() -> Callable[..., Scene]:
    return make_scene


@pytest.fixture(scope="session")
def add_noise() -> Callable[[BoardView, float, np.random.Generator], BoardView]:
    return noisy
