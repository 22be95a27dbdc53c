"""The 3-D view: an SVG that is complete without JavaScript and turns with it.

Every part carries its points in mm (``data-p``); ``viewer.js`` projects them again with another
rotation or zoom. The first projection is made here, so paper and JavaScript-free readers see it.
Why not plotly: ``docs/adr/0003-report-3d.md``.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from pivometer._arrays import Floats
from pivometer.cameras.model import Camera
from pivometer.geometry.rigid import RigidTransform, rotation_from_vector
from pivometer.measurement import Measurement
from pivometer.report.digits import fixed
from pivometer.report.svg import (
    SMALLEST_MM,
    number,
    picture,
    points,
    round_step,
    step_decimals,
    tag,
)
from pivometer.report.target import deciding_poses, nearest_points_mm

WIDTH, HEIGHT = 880.0, 560.0
_FILL = 0.62
"""Part of the height from the middle to the farthest camera: a rig is wider than it is high."""

_PITCH_RAD, _YAW_RAD = math.radians(28), math.radians(-24)
"""The first look: from above and from one side, so that neither camera hides the other."""

_BAR_PX = 150.0
"""The scale bar is the round length at or below this."""

_NEAR = 5.0
"""From this zoom on the misses, numbers and spheres are shown; below they are one blot."""


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """What the 3-D view shows and from where.

    Parameters
    ----------
    parts
        The elements, still to be projected: (name, points of shape (n, 3), mm, class, text).
    centre_mm, focus_mm
        The middle of the picture at ×1, and at every other zoom (the RCM), mm.
    scale
        User units per mm at ×1.
    near_zoom
        The zoom at which the largest miss fills the picture well.
    """

    parts: tuple["Part", ...]
    centre_mm: Floats
    focus_mm: Floats
    scale: float
    near_zoom: int


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A polyline (`kind` "line"), or a mark at one point ("label", "dot", "cross", "sphere").

    What belongs to a pose has its number in `pose`, by which it can be picked.
    """

    kind: str
    points_mm: Floats
    name: str
    text: str = ""
    radius_mm: float = 0.0
    pose: str = ""


def scene(measurement: Measurement, numbers: Sequence[int]) -> Scene:
    """Collect cameras, baselines, centerlines, misses and points; `numbers` label the poses."""
    rig, rcm = measurement.calibration.rig, measurement.rcm
    focus = rcm.minimax.point_mm
    centres = np.array([transform.translation_mm for transform in rig.reference_from_camera])
    low, high = np.min([*centres, focus], axis=0), np.max([*centres, focus], axis=0)
    centre = (low + high) / 2
    reach = float(np.linalg.norm(np.array([*centres, focus]) - centre, axis=1).max())
    parts = [Part("line", np.array([centres[0], other]), "baseline") for other in centres[1:]]
    for camera, transform in zip(rig.cameras, rig.reference_from_camera, strict=True):
        parts += _camera(camera, transform, 0.16 * reach)
    parts += _axes(0.22 * reach)
    parts += _poses(measurement, numbers, 0.42 * reach)
    parts += [
        Part("sphere", focus, "ring max", radius_mm=rcm.minimax.max_mm),
        Part("sphere", focus, "ring rms", radius_mm=rcm.minimax.rms_mm),
        Part("diamond", rcm.least_squares.point_mm, "least-squares"),
        Part("cross", focus, "rcm", "RCM"),
    ]
    scale = _FILL * HEIGHT / reach
    wanted = 0.36 * HEIGHT / (scale * max(rcm.minimax.max_mm, SMALLEST_MM))
    return Scene(tuple(parts), centre, focus, scale, round(_rounded_zoom(wanted)))


def scene_picture(shown: Scene, zoom: int, identifier: str) -> Markup:
    """Draw the scene at a zoom: about its middle at ×1, else about the RCM."""
    rotation = rotation_from_vector([_PITCH_RAD, 0, 0]) @ rotation_from_vector([0, _YAW_RAD, 0])
    middle = shown.centre_mm if zoom == 1 else shown.focus_mm
    scale = shown.scale * zoom
    title = "Cameras, baseline, centerlines and the RCM"
    drawn = [_drawn(part, rotation, middle, scale) for part in shown.parts]
    return picture(
        tag("g", *drawn, transform=f"translate({number(WIDTH / 2)},{number(HEIGHT / 2)})"),
        _scale_bar(scale),
        width=WIDTH,
        height=HEIGHT,
        title=f"{title}, ×{zoom}" + ("" if zoom == 1 else " at the RCM"),
        class_="scene near" if zoom >= _NEAR else "scene far",
        id=identifier,
        data_rotation=_numbers(rotation, 9),
        data_centre=_numbers(shown.centre_mm, 4),
        data_focus=_numbers(shown.focus_mm, 6),
        data_scale=f"{shown.scale:.9g}",
        data_zoom=zoom,
        data_near=number(_NEAR),
    )


def _camera(camera: Camera, reference_from_camera: RigidTransform, depth_mm: float) -> list[Part]:
    """Return the pyramid of what the camera sees, its optical axis and its name."""
    right, bottom = camera.width - 1, camera.height - 1
    corners = [[0, 0], [right, 0], [right, bottom], [0, bottom]]
    flat = (np.array(corners, dtype=np.float64) - camera.principal_point_px) / camera.focal_px
    # Long lenses see little: the pyramid is drawn no deeper than twice its width.
    depth = min(depth_mm, 1.2 * depth_mm / max(float(np.ptp(flat[:, 0])), 1e-9))
    rim = reference_from_camera @ (np.column_stack([flat, np.ones(4)]) * depth)
    apex = reference_from_camera.translation_mm
    a, b, c, d = rim
    sides = np.array([a, b, c, d, a, apex, b, c, apex, d])
    behind = apex - 0.45 * depth_mm * reference_from_camera.rotation[:, 2]
    return [Part("line", sides, "camera"), Part("label", behind, "camera-name", camera.name)]


def _axes(length_mm: float) -> list[Part]:
    """Return the axes of the reference camera's frame."""
    tips = np.eye(3) * length_mm
    return [Part("line", np.array([np.zeros(3), tip]), "frame-axis") for tip in tips] + [
        Part("label", 1.14 * tip, "frame-name", name) for tip, name in zip(tips, "xyz", strict=True)
    ]


def _poses(measurement: Measurement, numbers: Sequence[int], half_mm: float) -> list[Part]:
    """Return for every used pose its centerline, its miss and its number."""
    focus = measurement.rcm.minimax.point_mm
    worst = deciding_poses(measurement)
    parts = []
    feet = nearest_points_mm(measurement)
    for pose, foot, label in zip(measurement.used, feet, numbers, strict=True):
        direction = pose.centerline.direction
        mark = " worst" if pose.pose in worst else ""
        ends = np.array([foot - half_mm * direction, foot + half_mm * direction])
        parts += [
            Part("line", ends, f"centerline{mark}", pose.pose, pose=str(label)),
            Part("line", np.array([focus, foot]), f"miss{mark}", pose=str(label)),
            Part("dot", foot, f"dot{mark}", str(label), pose=str(label)),
        ]
    return parts


def _drawn(part: Part, rotation: Floats, middle_mm: Floats, scale: float) -> Markup:
    """Project a part (orthographic: x right, y down) and build its element."""
    flat = (np.atleast_2d(part.points_mm) - middle_mm) @ rotation[:2].T * scale
    told = {"class_": part.name, "data_p": _numbers(part.points_mm, 4)}
    if part.pose:
        told["data_pose"] = part.pose
    if part.kind == "line":
        inner = [tag("title", part.text)] if part.text else []
        return tag("polyline", *inner, points=points(flat.tolist()), **told)
    place = f"translate({number(flat[0, 0])},{number(flat[0, 1])})"
    return tag("g", *_mark(part, scale), transform=place, **told)


def _mark(part: Part, scale: float) -> list[Markup]:
    match part.kind:
        case "sphere":
            return [tag("circle", r=part.radius_mm * scale, data_mm=f"{part.radius_mm:.6g}")]
        case "dot":
            return [tag("circle", r=2.6), tag("text", part.text, x=5, y=3)]
        case "diamond":
            return [tag("path", d="M0,-6L6,0L0,6L-6,0Z")]
        case "cross":
            return [tag("path", d="M-9,0H9M0,-9V9"), tag("text", part.text, x=11, y=-6)]
        case _:
            return [tag("text", part.text, text_anchor="middle", y=4)]


def _scale_bar(scale: float) -> Markup:
    # round_step rounds up, so it is asked for a length that the next step still keeps below.
    length = round_step(_BAR_PX / scale / 2.5, 1)
    text = f"{fixed(length, step_decimals(length))} mm"
    return tag(
        "g",
        tag("path", d=f"M0,-5V0H{length * scale:.1f}V-5"),
        tag("text", text, x=0, y=16),
        class_="scale-bar",
        transform=f"translate(24,{HEIGHT - 30:.0f})",
    )


def _rounded_zoom(wanted: float) -> float:
    """Return the 1, 2 or 5 × 10ⁿ at or below `wanted`, between 2 and 100 000."""
    power = 10.0 ** math.floor(math.log10(max(wanted, 1e-9)))
    factor = max(factor for factor in (1, 2, 5) if factor * power <= wanted * (1 + 1e-9))
    return min(max(factor * power, 2.0), 1e5)


def _numbers(values: Floats, decimals: int) -> str:
    return " ".join(f"{value:.{decimals}f}" for value in np.ravel(values))
