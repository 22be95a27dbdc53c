"""The pictures of a pose, with the found edges and the centerline drawn over them."""

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from markupsafe import Markup

from pivometer._arrays import Floats
from pivometer.cameras.model import Camera
from pivometer.cameras.rig import Rig
from pivometer.geometry.rigid import RigidTransform
from pivometer.measurement import Measurement, RejectedPose, UsedPose
from pivometer.report.svg import DRAWN_TWICE, number, points, tag
from pivometer.report.thumbnails import Thumbnail
from pivometer.shaft.edges import ShaftEdges
from pivometer.shaft.triangulation import Centerline

_POINTS = 16
"""Points per drawn line: a distorted edge bends by less than 0.05 px between them."""


@dataclass(frozen=True, slots=True, eq=False)
class PosePicture:
    """One camera's picture of a pose.

    Parameters
    ----------
    camera
        The camera's name.
    source
        The picture as a data URI; empty where there is no picture.
    width, height
        Its size, px.
    overlay
        The SVG that lies over it.
    description
        What it shows, for those who cannot see it.
    """

    camera: str
    source: str
    width: int
    height: int
    overlay: Markup
    description: str


def pose_pictures(
    pose: UsedPose | RejectedPose,
    measurement: Measurement,
    thumbnails: Mapping[tuple[str, str], Thumbnail],
) -> tuple[PosePicture, ...]:
    """Return a picture for every camera of the rig that has a thumbnail of this pose."""
    rig = measurement.calibration.rig
    edges = {found.camera: found for found in pose.edges}
    return tuple(
        _picture(
            pose,
            camera,
            edges.get(camera.name),
            thumbnails[pose.pose, camera.name],
            photo_overlay(pose, camera, measurement),
        )
        for camera in rig.cameras
        if (pose.pose, camera.name) in thumbnails
    )


def _picture(
    pose: UsedPose | RejectedPose,
    camera: Camera,
    edges: ShaftEdges | None,
    thumbnail: Thumbnail,
    overlay: Markup,
) -> PosePicture:
    encoded = base64.b64encode(thumbnail.jpeg).decode("ascii")
    content = "no edges were found" if edges is None else "the shaft with its two fitted edges"
    if isinstance(pose, UsedPose):
        content += ", its centerline (dashed) and the RCM (cross)"
    return PosePicture(
        camera.name,
        f"data:image/jpeg;base64,{encoded}",
        thumbnail.width,
        thumbnail.height,
        overlay,
        f"Pose {pose.pose}, camera {camera.name}: {content}",
    )


@lru_cache(maxsize=DRAWN_TWICE)
def photo_overlay(
    pose: UsedPose | RejectedPose, camera: Camera, measurement: Measurement
) -> Markup:
    """Draw what was found in a camera's picture of a pose, in raw pixels, to lie over it."""
    rig = measurement.calibration.rig
    edges = next((found for found in pose.edges if found.camera == camera.name), None)
    # Integer pixel coordinates are pixel centres, so the picture begins half a pixel earlier.
    return tag(
        "svg",
        *_lines(pose, rig, camera, edges, measurement),
        viewBox=f"-0.5 -0.5 {camera.width} {camera.height}",
        preserveAspectRatio="none",
        aria_hidden="true",
    )


def _lines(
    pose: UsedPose | RejectedPose,
    rig: Rig,
    camera: Camera,
    edges: ShaftEdges | None,
    measurement: Measurement,
) -> list[Markup]:
    """Draw the edges, and for a used pose the centerline and the RCM, in the camera's pixels."""
    parts = []
    if edges is not None:
        parts += [_polyline(edge, "edge") for edge in _thinned(edges.points_px)]
    if isinstance(pose, UsedPose):
        camera_from_reference = rig.reference_from_camera[rig.index(camera.name)].inverse()
        if edges is not None:
            seen = _visible_mm(pose.centerline, edges, camera, camera_from_reference)
            parts.append(_polyline(camera.project(seen), "centerline"))
        parts += _cross(camera, camera_from_reference @ measurement.rcm.minimax.point_mm)
    return parts


def _visible_mm(
    centerline: Centerline, edges: ShaftEdges, camera: Camera, camera_from_reference: RigidTransform
) -> Floats:
    """Return points of the centerline between the ends of the edges, shape (n, 3), camera frame."""
    point = camera_from_reference @ centerline.point_mm
    direction = camera_from_reference.rotate(centerline.direction)
    ends = edges.points_px[:, [0, -1]].mean(axis=0)
    sight = np.column_stack([camera.normalized_from_pixels(ends), np.ones(2)])
    # The plane through the camera's centre that holds the ray and the common normal cuts the line
    # where the line passes the ray.
    across = np.cross(sight, np.cross(sight, direction))
    along = -(across @ point) / (across @ direction)
    steps = np.linspace(along[0], along[1], _POINTS)
    seen: Floats = point + steps[:, None] * direction
    return seen[seen[:, 2] > 0]


def _cross(camera: Camera, point_mm: Floats) -> list[Markup]:
    """Draw the RCM where it lies inside the picture."""
    if point_mm[2] <= 0:
        return []
    x, y = camera.project(point_mm)
    if not (0 <= x < camera.width and 0 <= y < camera.height):
        return []
    arm = 0.018 * camera.width
    d = f"M{number(x - arm)},{number(y)}h{number(2 * arm)}M{number(x)},{number(y - arm)}"
    return [tag("path", d=f"{d}v{number(2 * arm)}", class_="cross")]


def _polyline(pixels: Floats, name: str) -> Markup:
    return tag("polyline", points=points(pixels.tolist()), class_=name)


def _thinned(points_px: Floats) -> Floats:
    """Return at most `_POINTS` of the points along each edge, the ends among them."""
    count = points_px.shape[1]
    return points_px[:, np.linspace(0, count - 1, min(count, _POINTS)).round().astype(int)]
