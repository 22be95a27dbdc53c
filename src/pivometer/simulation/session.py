"""A simulated session: its images one by one, its settings and the truth behind them."""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pivometer.cameras import Rig
from pivometer.errors import UsageError
from pivometer.geometry import RigidTransform
from pivometer.simulation.boards import BoardShape, Pattern
from pivometer.simulation.optics import Sensor
from pivometer.simulation.render import Renderer, Shape
from pivometer.simulation.robots import Motion
from pivometer.simulation.scene import Shaft, Stage


@dataclass(frozen=True, slots=True, eq=False)
class BoardImage:
    """A picture of the board: the camera and where the board is, in the camera's frame."""

    camera: str
    camera_from_board: RigidTransform


@dataclass(frozen=True, slots=True, eq=False)
class ShaftImage:
    """A picture of the shaft: the camera and the number of the robot's pose."""

    camera: str
    pose: int


@dataclass(frozen=True, slots=True, eq=False)
class EmptyImage:
    """A picture of the scene without robot and board."""

    camera: str


Picture = BoardImage | ShaftImage | EmptyImage


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedSession:
    """A session folder that exists only as recipes; images are rendered when asked for.

    Iterating yields ``(relative path, image)`` in the order board, intrinsics, shaft, then the
    optional folders. Every image has its own noise, fixed by the seed and its path, so a single
    image can be rendered again alone.

    Parameters
    ----------
    preset
        The name of the preset.
    rig, pattern, shaft, stage, sensor
        The cameras, the board, the shaft, what stands around it, and the sensors.
    motion
        The robot's true centerlines, reference frame.
    pictures
        What to render, by relative POSIX path.
    session_toml
        The text of ``session.toml``.
    truth
        What is true of the session, ready for JSON.
    seed
        Chooses the noise.
    """

    preset: str
    rig: Rig
    pattern: Pattern
    shaft: Shaft
    stage: Stage
    sensor: Sensor
    motion: Motion
    pictures: Mapping[str, Picture]
    session_toml: str
    truth: dict[str, Any]
    seed: int
    _renderers: dict[str, Renderer] = field(default_factory=dict, init=False)

    @property
    def image_count(self) -> int:
        """The number of images."""
        return len(self.pictures)

    @property
    def paths(self) -> tuple[str, ...]:
        """The images' paths relative to the session folder, in order."""
        return tuple(self.pictures)

    def __iter__(self) -> Iterator[tuple[str, NDArray[Any]]]:
        for path in self.pictures:
            yield path, self.image(path)

    def image(self, path: str) -> NDArray[Any]:
        """Return one image, uint8 or uint16, shape (height, width).

        Raises
        ------
        UsageError
            If the session has no image of this path.
        """
        if path not in self.pictures:
            raise UsageError(
                f"the simulated session has no image {path!r}", next_step="take one of `paths`"
            )
        picture = self.pictures[path]
        rng = np.random.default_rng([self.seed, zlib.crc32(path.encode())])
        return self.renderer(picture.camera).image(self.shapes(picture), rng)

    def renderer(self, camera: str) -> Renderer:
        """Return a camera's renderer, which is made when first asked for."""
        if camera not in self._renderers:
            transform = self.rig.reference_from_camera[self.rig.index(camera)].inverse()
            self._renderers[camera] = Renderer(
                self.rig.cameras[self.rig.index(camera)],
                self.sensor,
                self.stage.standing(transform),
                self.stage.dark,
            )
        return self._renderers[camera]

    def shapes(self, picture: Picture) -> list[Shape]:
        """Return what stands before the background of a picture, back to front."""
        transform = self.rig.reference_from_camera[self.rig.index(picture.camera)].inverse()
        if isinstance(picture, BoardImage):
            light = self.stage.lighting.seen_from(transform)
            return [BoardShape(self.pattern, picture.camera_from_board, light)]
        if isinstance(picture, ShaftImage):
            point = self.motion.points_mm[picture.pose]
            direction = self.motion.directions[picture.pose]
            return self.stage.posed(self.shaft, point, direction, transform)
        return []


def poses_csv(motion: Motion) -> str:
    """Return the text of a simulated session's ``poses.csv``: the joint values of each pose."""
    rows = [
        ",".join([f"{number:03d}", *(repr(float(value)) for value in joints)])
        for number, joints in enumerate(motion.joints)
    ]
    return "\n".join([",".join(["pose", *motion.joint_names]), *rows, ""])


def session_toml(preset: str, pattern: Pattern, shaft: Shaft, rig: Rig, seed: int) -> str:
    """Return the text of a simulated session's ``session.toml``."""
    board = [
        "[board]",
        f'kind = "{pattern.kind}"',
        f"squares = [{pattern.squares[0]}, {pattern.squares[1]}]",
        f"square_mm = {pattern.square_mm}",
    ]
    if pattern.kind == "charuco":
        board += [f'dictionary = "{pattern.dictionary}"', f"marker_mm = {pattern.marker}"]
    names = ", ".join(f'"{camera.name}"' for camera in rig.cameras)
    return "\n".join(
        [
            f'notes = "Simulated: preset {preset}, seed {seed}."',
            "",
            *board,
            "",
            "[shaft]",
            f"diameter_mm = {shaft.diameter_mm}",
            "",
            "[cameras]",
            f"names = [{names}]",
            f'reference = "{rig.reference}"',
            "",
        ]
    )


def transform_dict(transform: RigidTransform) -> dict[str, Any]:
    """Return a transform for JSON."""
    return {
        "rotation": transform.rotation.tolist(),
        "translation_mm": transform.translation_mm.tolist(),
    }


def rig_dict(rig: Rig) -> dict[str, Any]:
    """Return the cameras for JSON, by name."""
    cameras = {}
    for camera, transform in zip(rig.cameras, rig.reference_from_camera, strict=True):
        cameras[camera.name] = {
            "width_px": camera.width,
            "height_px": camera.height,
            "fx_px": float(camera.focal_px[0]),
            "fy_px": float(camera.focal_px[1]),
            "ox_px": float(camera.principal_point_px[0]),
            "oy_px": float(camera.principal_point_px[1]),
            "beta": camera.distortion.tolist(),
            "reference_from_camera": transform_dict(transform),
        }
    return cameras


def motion_list(motion: Motion) -> list[dict[str, Any]]:
    """Return the robot's poses for JSON."""
    return [
        {
            "pose": f"{number:03d}",
            "joints": dict(zip(motion.joint_names, map(float, joints), strict=True)),
            "centerline": {"point_mm": point.tolist(), "direction": direction.tolist()},
        }
        for number, (joints, point, direction) in enumerate(
            zip(motion.joints, motion.points_mm, motion.directions, strict=True)
        )
    ]
