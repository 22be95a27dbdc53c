"""The raw points of edges, few enough to be carried through many changed cameras at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pivometer._arrays import Floats, checked
from pivometer.cameras.model import Camera
from pivometer.cameras.rig import Rig
from pivometer.errors import ShapeError
from pivometer.geometry.rigid import RigidTransform
from pivometer.rcm.least_squares import least_squares_rcm
from pivometer.rcm.result import LeastSquaresRcm
from pivometer.shaft.silhouette import edge_normals
from pivometer.shaft.triangulation import lines_from_edge_normals

POINTS_AN_EDGE = 16
"""Points by which each edge is carried through a changed camera. Distortion bends a line to second
and third order, so a few points say all; 16 and 400 agree to 1e-4 of the uncertainty."""


STEP_PART = 0.01
"""Step of the differences that tell how normals change, in standard uncertainties: so small that
parameters which are only known together stay within what the distortion model can undo."""


class EdgePoints(Protocol):
    """What is needed of `ShaftEdges`: the camera's name and points on both edges, raw px."""

    @property
    def camera(self) -> str: ...  # noqa: D102 - documented by the class
    @property
    def points_px(self) -> Floats: ...  # noqa: D102 - documented by the class


@dataclass(frozen=True, slots=True, eq=False)
class SeenAlike:
    """The poses that the same cameras saw.

    Parameters
    ----------
    poses
        Their positions among all poses, shape (n,).
    cameras
        Positions of the cameras in the rig.
    points_px
        For each of these cameras evenly chosen points of the poses' edges, shape (n, 2, 16, 2), px.
    """

    poses: NDArray[np.int64]
    cameras: tuple[int, ...]
    points_px: tuple[Floats, ...]


def thinned_points(
    edges: Sequence[Sequence[EdgePoints]], cameras: Sequence[str]
) -> tuple[SeenAlike, ...]:
    """Group the poses by the cameras that saw them, and keep a few points of every edge."""
    groups: dict[tuple[int, ...], list[int]] = {}
    for number, pose in enumerate(edges):
        seen = [one.camera for one in pose]
        known = [name for name in cameras if name in seen]
        if seen != known or len(seen) < 2:
            raise ShapeError(
                f"pose {number} has the edges of {', '.join(seen) or 'no camera'}, but the rig's "
                f"cameras are {', '.join(cameras)}",
                next_step="pass each pose's edges from two of the rig's cameras or more, in the "
                "rig's order",
            )
        groups.setdefault(tuple(cameras.index(name) for name in seen), []).append(number)
    return tuple(
        SeenAlike(
            np.array(poses),
            seen_by,
            tuple(
                np.stack([_evenly_chosen(edges[pose][place].points_px) for pose in poses])
                for place in range(len(seen_by))
            ),
        )
        for seen_by, poses in groups.items()
    )


def _evenly_chosen(points_px: ArrayLike) -> Floats:
    """Return some of the points of both edges, the ends among them, shape (2, 16, 2), px."""
    points = checked(points_px, (2, None, 2), "points_px")
    chosen = np.linspace(0, points.shape[1] - 1, POINTS_AN_EDGE).round().astype(int)
    return points[:, chosen]


@dataclass(frozen=True, slots=True, eq=False)
class Carried:
    """Raw edge points as rigs near one see them, to first order in the cameras' parameters.

    To undo the distortion anew for each of dozens of rigs would take ten times as long.

    Parameters
    ----------
    groups, rig
        The points, and the rig.
    normals, changes
        For each group the coimage normals of the edges, shape (n, c, 2, 3), and for each of its
        cameras their derivatives by its parameters, shape (n, 2, 3, m).
    """

    groups: tuple[SeenAlike, ...]
    rig: Rig
    normals: tuple[Floats, ...]
    changes: tuple[tuple[Floats, ...], ...]

    @classmethod
    def by(cls, groups: Sequence[SeenAlike], rig: Rig, sigmas: Floats) -> Carried:
        """Return what rigs see that differ by about so much, in `rig.parameter_names`' order."""
        steps = _by_camera(rig, STEP_PART * sigmas)
        changes = (
            tuple(
                _changes(px, rig.cameras[i], steps[i])
                for px, i in zip(group.points_px, group.cameras, strict=True)
            )
            for group in groups
        )
        normals = (normals_of(group, rig) for group in groups)
        return cls(tuple(groups), rig, tuple(normals), tuple(changes))

    def lines(self, delta: Floats) -> tuple[Floats, Floats]:
        """Return points and directions of the lines that `rig.perturbed(delta)` sees."""
        rig, own = self.rig.perturbed(delta), _by_camera(self.rig, delta)
        points = np.empty((sum(len(group.poses) for group in self.groups), 3))
        directions = np.empty_like(points)
        for group, normals, changes in zip(self.groups, self.normals, self.changes, strict=True):
            moves = [change @ own[i] for change, i in zip(changes, group.cameras, strict=True)]
            points[group.poses], directions[group.poses], _ = lines_from_edge_normals(
                normals + np.stack(moves, axis=1), transforms_of(group, rig)
            )
        return points, directions


def _by_camera(rig: Rig, parameters: Floats) -> list[Floats]:
    """Return each camera's own part of a rig's parameters."""
    ends = np.cumsum([len(camera.parameters) for camera in rig.cameras])
    return np.split(parameters, ends)[:-1]


def _changes(points_px: Floats, camera: Camera, steps: Floats) -> Floats:
    """Return the derivatives of normals (n, 2, 3) by a camera's parameters; 0 for known ones."""
    changes = np.zeros((*points_px.shape[:2], 3, len(steps)))
    for k in np.flatnonzero(steps):
        step = np.where(np.arange(len(steps)) == k, steps, 0.0)
        ahead, back = (
            edge_normals(points_px, camera.with_parameters(camera.parameters + sign * step))
            for sign in (1, -1)
        )
        changes[..., k] = (ahead - back) / (2 * steps[k])
    return changes


def lines_of(groups: Sequence[SeenAlike], rig: Rig) -> tuple[Floats, Floats]:
    """Return points and directions of the lines behind raw edge points: (22), (6)–(16)."""
    points = np.empty((sum(len(group.poses) for group in groups), 3))
    directions = np.empty_like(points)
    for group in groups:
        points[group.poses], directions[group.poses], _ = lines_from_edge_normals(
            normals_of(group, rig), transforms_of(group, rig)
        )
    return points, directions


def passing_through(
    groups: Sequence[SeenAlike], rig: Rig, point_mm: Floats
) -> tuple[SeenAlike, ...]:
    """Return the points that would be seen if every line were moved, without a turn, to a point.

    A raw point's ray passes the line at some place; that place is moved and seen again.
    """
    points, directions = lines_of(groups, rig)
    feet = feet_of(points, directions, point_mm)
    moved = []
    for group in groups:
        through, along, shift = (x[group.poses] for x in (points, directions, feet))
        seen = tuple(
            _seen_again(px, rig.cameras[i], rig.reference_from_camera[i], through, along, shift)
            for px, i in zip(group.points_px, group.cameras, strict=True)
        )
        moved.append(SeenAlike(group.poses, group.cameras, seen))
    return tuple(moved)


def _seen_again(
    points_px: Floats,
    camera: Camera,
    reference_from_camera: RigidTransform,
    through: Floats,
    along: Floats,
    shift: Floats,
) -> Floats:
    """Return where points (n, 2, m, 2) are seen after what they show is moved by −shift (n, 3)."""
    normalized = camera.normalized_from_pixels(points_px)
    rays = np.concatenate([normalized, np.ones_like(normalized[..., :1])], axis=-1)
    camera_from_reference = reference_from_camera.inverse()
    base = (camera_from_reference @ through)[:, None, None]
    axis = camera_from_reference.rotate(along)[:, None, None]
    off = rays - np.vecdot(rays, axis)[..., None] * axis  # the camera's centre is the origin
    depth = np.vecdot(off, base) / np.vecdot(off, off)
    moved = depth[..., None] * rays - camera_from_reference.rotate(shift)[:, None, None]
    return camera.project(moved)


def normals_of(group: SeenAlike, rig: Rig) -> Floats:
    """Return the coimage normals of both edges in each camera that saw them, (n, c, 2, 3)."""
    seen = zip(group.points_px, group.cameras, strict=True)
    return np.stack([edge_normals(px, rig.cameras[i]) for px, i in seen], axis=1)


def transforms_of(group: SeenAlike, rig: Rig) -> list[RigidTransform]:
    """Return where these cameras stand."""
    return [rig.reference_from_camera[i] for i in group.cameras]


def feet_of(points_mm: Floats, directions: Floats, point_mm: Floats) -> Floats:
    """Return the ways from a point to lines, perpendicular to each, shape (n, 3), mm."""
    offsets = points_mm - point_mm
    return np.asarray(offsets - np.vecdot(offsets, directions)[..., None] * directions)


def rcm_of_points(points_px: Sequence[SeenAlike], rig: Rig) -> LeastSquaresRcm:
    """Return the least-squares RCM of raw edge points seen by a rig: (22), (6)–(16), 2-norm."""
    return least_squares_rcm(*lines_of(points_px, rig))
