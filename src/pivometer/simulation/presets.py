"""Ready-made sessions with the paper's two set-ups, and one at the scale of microsurgery."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pivometer._arrays import Floats, read_only
from pivometer.cameras import Camera, Rig
from pivometer.errors import UsageError
from pivometer.geometry import RigidTransform
from pivometer.geometry.line import unit
from pivometer.simulation.boards import Pattern, Placement, pair_poses, single_poses
from pivometer.simulation.optics import Sensor
from pivometer.simulation.robots import (
    DoubleParallelogram,
    Motion,
    Robot,
    SoftwareRcm,
    SphericalBearing,
    cone_directions,
)
from pivometer.simulation.scene import Shaft, Stage
from pivometer.simulation.session import (
    BoardImage,
    EmptyImage,
    Picture,
    ShaftImage,
    SimulatedSession,
    motion_list,
    rig_dict,
    session_toml,
    transform_dict,
)
from pivometer.simulation.shapes import Lighting, Material

LAMPS = Lighting(
    np.array([[-0.45, -0.75, -0.5], [0.85, -0.45, -0.1], [0.5, -0.35, -0.7]]),
    np.array([0.38, 0.38, 0.25]),
    0.36,
)


LINK_ERRORS_MM = read_only([-1.55, -0.24, 1.11, -0.64, 0.22, 0.17, -0.29, 2.18])
HOLDER_OFFSET_MM = read_only([0.36, 0.51])
HOLDER_TILT_RAD = read_only([0.0011, -0.0011])
YAW_OFFSET_MM = read_only([-0.85, 0.26])
YAW_TILT_RAD = read_only([-0.0016, 0.0027])
"""Errors of the da Vinci-like arm; see `davinci`."""


@dataclass(frozen=True, slots=True, eq=False)
class Preset:
    """A set-up: cameras, robot, shaft, surroundings, and where the board is held.

    Parameters
    ----------
    rig
        The true cameras.
    pattern, placement, single_mm
        The board, where it is held for pairs, and how far from a camera for single views.
    robot, reference_from_robot
        The robot and where it stands; its origin is the design pivot.
    shaft, stage, sensor
        The shaft, what is around it, and the sensors.
    cone_deg
        Apex angle of the cone of poses.
    poses
        Number of poses.
    """

    rig: Rig
    pattern: Pattern
    placement: Placement
    single_mm: tuple[float, ...]
    robot: Robot
    reference_from_robot: RigidTransform
    shaft: Shaft
    stage: Stage
    sensor: Sensor
    cone_deg: float = 57.0
    poses: int = 70


def camera(name: str, focal: list[float], centre: list[float], beta: list[float]) -> Camera:
    """Return a camera of 640 × 480 px."""
    return Camera(name, 640, 480, read_only(focal), read_only(centre), read_only(beta))


def looking(
    centre_mm: Floats, target_mm: Floats, roll_rad: float, aside_rad: float
) -> RigidTransform:
    """Return `reference_from_camera` of a camera that looks at a target, rolled and turned aside.

    Its y axis is as near to the reference's as the sight allows.
    """
    z = unit(target_mm - centre_mm)
    x = unit(np.cross([0.0, 1.0, 0.0], z))
    facing = RigidTransform(np.column_stack([x, np.cross(z, x), z]), centre_mm)
    turn = RigidTransform.from_rotation_vector([0.0, aside_rad, 0.0], np.zeros(3))
    return facing @ turn @ RigidTransform.from_rotation_vector([0.0, 0.0, roll_rad], np.zeros(3))


def standing_at(pivot_mm: Floats, heading_rad: float) -> RigidTransform:
    """Return `reference_from_robot` for a robot on a pivot, its z up and its x towards a heading.

    The reference camera's y points down; a heading of 0 is the camera's x, π/2 its z.
    """
    x = np.array([np.cos(heading_rad), 0.0, np.sin(heading_rad)])
    z = np.array([0.0, -1.0, 0.0])
    return RigidTransform(np.column_stack([x, np.cross(z, x), z]), pivot_mm)


def gold() -> Preset:
    """Return the paper's gold standard (section V): a white shaft in a bearing before black."""
    pivot = read_only([6.4, 65.7, 478.3])
    left = camera("left", [1012.4, 1009.1], [316.8, 243.9], [-0.205, 0.108])
    right = camera("right", [986.7, 990.3], [326.1, 236.4], [-0.188, 0.094])
    height, depth = 8.0, 432.0
    centre = np.array([np.sqrt(525.65**2 - height**2 - depth**2), height, depth])
    right_pose = looking(centre, pivot - [0.0, 52.0, 0.0], 0.021, -0.06)
    white = Material("matte", 0.72)
    return Preset(
        Rig([left, right], [RigidTransform.identity(), right_pose]),
        Pattern(),
        Placement(pivot - [0.0, 42.0, 0.0], read_only([75.0, 50.0, 75.0])),
        (470.0, 330.0),
        SphericalBearing(),
        standing_at(pivot, 0.3),
        Shaft(10.0, (8.0, 156.0), ((0.0, white),)),
        Stage("bearing", pivot, LAMPS),
        Sensor(),
    )


def davinci() -> Preset:
    """Return the paper's da Vinci set-up (section VI): a dark shaft before a cluttered room.

    The linkage's errors are chosen so that the 70 poses miss their least-squares point by 3.0 mm
    rms and 7.0 mm at most; the paper measured 3.010 and 7.086 mm.
    """
    pivot = read_only([-2.8, 37.9, 420.8])
    left = camera("left", [1008.2, 1011.6], [322.7, 235.8], [-0.212, 0.117])
    right = camera("right", [994.9, 991.8], [313.4, 246.1], [-0.193, 0.098])
    height, depth = -4.0, 398.0
    centre = np.array([np.sqrt(551.94**2 - height**2 - depth**2), height, depth])
    right_pose = looking(centre, pivot - [0.0, 45.0, 0.0], -0.017, 0.03)
    black = Material("metal", 0.05, 0.5, 45.0, 0.07)
    return Preset(
        Rig([left, right], [RigidTransform.identity(), right_pose]),
        Pattern(),
        Placement(pivot - [0.0, 25.0, 0.0], read_only([75.0, 55.0, 75.0])),
        (440.0, 390.0),
        DoubleParallelogram(
            length_errors_mm=LINK_ERRORS_MM,
            holder_offset_mm=HOLDER_OFFSET_MM,
            holder_tilt_rad=HOLDER_TILT_RAD,
            yaw_offset_mm=YAW_OFFSET_MM,
            yaw_tilt_rad=YAW_TILT_RAD,
        ),
        standing_at(pivot, 0.72),
        Shaft(8.4, (18.0, 135.5), ((0.0, black),)),
        Stage("arm", pivot, LAMPS),
        Sensor(),
    )


def micro() -> Preset:
    """Return a rig at the scale of microsurgery: a 0.8 mm shaft, a baseline of 60 mm.

    A small 6-axis arm holds the pivot by software; its joint offsets of about 0.1° make it miss by
    a few hundredths of a millimetre.
    """
    pivot = read_only([0.6, 3.9, 43.2])
    left = camera("left", [1504.0, 1507.5], [317.2, 244.0], [-0.24, 0.15])
    right = camera("right", [1489.6, 1486.1], [324.9, 237.5], [-0.21, 0.13])
    height, depth = 0.5, 41.2
    centre = np.array([np.sqrt(60.0**2 - height**2 - depth**2), height, depth])
    right_pose = looking(centre, pivot - [0.0, 3.6, 0.0], 0.012, 0.02)
    steel = Material("metal", 0.5, 0.3, 25.0, 0.15)
    return Preset(
        Rig([left, right], [RigidTransform.identity(), right_pose]),
        Pattern(squares=(6, 5), square_mm=1.8),
        Placement(pivot - [0.0, 3.4, 0.0], read_only([5.0, 3.0, 5.0])),
        (44.0, 44.0),
        small_arm(0.25, 25.0, 1e-3 * np.array([2.0, 1.4, -2.8, 2.0, 3.5, 0.0])),
        standing_at(pivot, 0.4),
        Shaft(0.8, (-0.05, 11.0), ((0.0, steel),)),
        Stage("eye", pivot, LAMPS, dark=0.02, scale=0.08),
        Sensor(psf_sigma_px=0.75, full_well_e=15000.0),
    )


def small_arm(scale: float, insertion_mm: float, joint_offsets_rad: Floats) -> SoftwareRcm:
    """Return a 6-axis arm with spherical-wrist-like proportions, reaching 0.8 m times `scale`."""
    quarter = np.pi / 2
    return SoftwareRcm(
        d_mm=scale * np.array([89.2, 0.0, 0.0, 109.3, 94.75, 82.5]),
        a_mm=scale * np.array([0.0, -425.0, -392.0, 0.0, 0.0, 0.0]),
        alpha_rad=np.array([quarter, 0.0, 0.0, quarter, -quarter, 0.0]),
        joint_offsets_rad=joint_offsets_rad,
        robot_from_base=RigidTransform(np.eye(3), scale * np.array([-480.0, -110.0, -60.0])),
        insertion_mm=insertion_mm,
        start_rad=np.array([3.14, -1.35, 2.08, -2.3, -1.57, -1.57]),
    )


PRESETS: dict[str, Callable[[], Preset]] = {"gold": gold, "davinci": davinci, "micro": micro}
"""Each preset's name, as in ``pivometer simulate davinci``, and the function that makes it."""


def preset_named(name: str) -> Preset:
    """Return a preset by name.

    Raises
    ------
    UsageError
        If there is none of this name.
    """
    if name not in PRESETS:
        raise UsageError(
            f"no preset is called {name!r}", next_step=f"take one of {', '.join(PRESETS)}"
        )
    return PRESETS[name]()


def simulate(
    preset: str | Preset,
    *,
    poses: int | None = None,
    seed: int = 0,
    board_pairs: int = 20,
    single_views: int = 10,
    background_frames: int = 0,
    reference_views: int = 0,
    shading: str | None = None,
    noise: float | None = None,
    bits: int | None = None,
    robot: Robot | None = None,
    pattern: Pattern | None = None,
) -> SimulatedSession:
    """Return a simulated session, whose images are rendered as they are iterated over.

    Parameters
    ----------
    preset
        ``"gold"``, ``"davinci"`` or ``"micro"``, or a preset of your own.
    poses
        Number of robot poses; the preset's (70) by default.
    seed
        Chooses noise, board poses, clutter and the bearing's offsets.
    board_pairs, single_views
        Board views seen by all cameras at once, and further views for each camera alone.
    background_frames, reference_views
        Pictures of the empty scene, and of a board fixed at one place near the pivot.
    shading
        The shaft's: ``"flat"``, ``"matte"`` or ``"metal"``; the preset's by default.
    noise
        Scales the sensor's noise; 0 switches it off.
    bits
        8 or 16.
    robot, pattern
        Another robot, another board.

    Raises
    ------
    UsageError
        If there is no such preset, or a board does not fit into the images.

    Examples
    --------
    >>> session = simulate("gold", poses=3, board_pairs=2, single_views=1)
    >>> session.image_count
    12
    >>> session.paths[0], session.paths[-1]
    ('board/left/000.png', 'shaft/right/002.png')
    >>> session.image("shaft/left/001.png").shape
    (480, 640)
    """
    name = preset if isinstance(preset, str) else "custom"
    setup = preset_named(preset) if isinstance(preset, str) else preset
    setup = replace(
        setup,
        robot=robot or setup.robot,
        pattern=pattern or setup.pattern,
        poses=setup.poses if poses is None else poses,
        shaft=_shaded(setup.shaft, shading),
        stage=replace(setup.stage, clutter_seed=seed),
        sensor=_adjusted(setup.sensor, noise, bits),
    )
    counts = _Counts(board_pairs, single_views, background_frames, reference_views)
    return _session(name, setup, seed, counts)


@dataclass(frozen=True, slots=True, eq=False)
class _Counts:
    """How many pictures of each kind."""

    pairs: int
    singles: int
    background: int
    reference: int


def _shaded(shaft: Shaft, shading: str | None) -> Shaft:
    if shading is None:
        return shaft
    if shading not in ("flat", "matte", "metal"):
        raise UsageError(f"no shading is called {shading!r}", next_step="take flat, matte or metal")
    bands = tuple((start, replace(material, shading=shading)) for start, material in shaft.bands)
    return replace(shaft, bands=bands)


def _adjusted(sensor: Sensor, noise: float | None, bits: int | None) -> Sensor:
    return replace(
        sensor,
        noise=sensor.noise if noise is None else noise,
        bits=sensor.bits if bits is None else bits,
    )


def _session(name: str, setup: Preset, seed: int, counts: _Counts) -> SimulatedSession:
    motion = _motion(setup, seed)
    poses = _board_poses(setup, seed, counts)
    return SimulatedSession(
        preset=name,
        rig=setup.rig,
        pattern=setup.pattern,
        shaft=setup.shaft,
        stage=setup.stage,
        sensor=setup.sensor,
        motion=motion,
        pictures=_pictures(setup.rig, poses, len(motion.points_mm), counts),
        session_toml=session_toml(name, setup.pattern, setup.shaft, setup.rig, seed),
        truth=_truth(name, setup, seed, motion, poses),
        seed=seed,
    )


def _motion(setup: Preset, seed: int) -> Motion:
    directions = cone_directions(setup.poses, setup.cone_deg)
    motion = setup.robot.move(directions, np.random.default_rng([seed, 1]))
    return motion.moved(setup.reference_from_robot)


def _board_poses(setup: Preset, seed: int, counts: _Counts) -> dict[str, list[RigidTransform]]:
    """Return board poses: under "board" and "reference" in the reference frame, else per camera."""
    rig, pattern = setup.rig, setup.pattern
    rng = np.random.default_rng([seed, 2])
    poses = {"board": pair_poses(pattern, rig, setup.placement, counts.pairs, rng)}
    for number, (view, distance) in enumerate(zip(rig.cameras, setup.single_mm, strict=True)):
        rng = np.random.default_rng([seed, 3, number])
        poses[view.name] = single_poses(pattern, view, distance, counts.singles, rng)
    if counts.reference:
        near = replace(setup.placement, spread_mm=0.2 * setup.placement.spread_mm, tilt_deg=6.0)
        rng = np.random.default_rng([seed, 4])
        fixed = pair_poses(pattern, rig, near, 1, rng)
        poses["reference"] = fixed * counts.reference
    return poses


def _pictures(
    rig: Rig, poses: dict[str, list[RigidTransform]], count: int, counts: _Counts
) -> dict[str, Picture]:
    names = [camera.name for camera in rig.cameras]
    pictures: dict[str, Picture] = _pair_pictures(rig, "board", poses["board"])
    for name in names:
        for number, pose in enumerate(poses[name]):
            pictures[f"intrinsics/{name}/{number:03d}.png"] = BoardImage(name, pose)
    for number in range(count):
        for name in names:
            pictures[f"shaft/{name}/{number:03d}.png"] = ShaftImage(name, number)
    for number in range(counts.background):
        for name in names:
            pictures[f"background/{name}/{number:03d}.png"] = EmptyImage(name)
    return pictures | _pair_pictures(rig, "reference", poses.get("reference", []))


def _pair_pictures(rig: Rig, folder: str, poses: list[RigidTransform]) -> dict[str, Picture]:
    cameras = list(zip(rig.cameras, rig.reference_from_camera, strict=True))
    return {
        f"{folder}/{camera.name}/{number:03d}.png": BoardImage(
            camera.name, transform.inverse() @ pose
        )
        for number, pose in enumerate(poses)
        for camera, transform in cameras
    }


def _truth(
    name: str, setup: Preset, seed: int, motion: Motion, poses: dict[str, list[RigidTransform]]
) -> dict[str, Any]:
    sensor, pattern = setup.sensor, setup.pattern
    cameras = [camera.name for camera in setup.rig.cameras]
    return {
        "schema": "pivometer-truth/1",
        "units": "mm, px (integer = pixel centre), rad",
        "preset": name,
        "seed": seed,
        "reference_camera": setup.rig.reference,
        "cameras": rig_dict(setup.rig),
        "baselines_mm": setup.rig.baselines_mm.tolist(),
        "board": {
            "kind": pattern.kind,
            "squares": list(pattern.squares),
            "square_mm": pattern.square_mm,
            "frame": "inner corner 0, x across, y down, z away from the viewer",
        },
        "reference_from_board": {
            folder: [transform_dict(pose) for pose in poses.get(folder, [])]
            for folder in ("board", "reference")
        },
        "camera_from_board": {
            camera: [transform_dict(pose) for pose in poses[camera]] for camera in cameras
        },
        "shaft": {"diameter_mm": setup.shaft.diameter_mm, "span_mm": list(setup.shaft.span_mm)},
        "cone_deg": setup.cone_deg,
        "design_pivot_mm": setup.reference_from_robot.translation_mm.tolist(),
        "poses": motion_list(motion),
        "sensor": {
            "psf_sigma_px": sensor.psf_sigma_px,
            "full_well_e": sensor.full_well_e,
            "read_noise_e": sensor.read_noise_e * sensor.noise,
            "noise": sensor.noise,
            "pedestal": sensor.pedestal,
            "gain": sensor.gain,
            "bits": sensor.bits,
            "response": "linear",
        },
    }
