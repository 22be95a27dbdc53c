"""Two cameras' views of one cluttered room in which a shaft, and perhaps another rod, turns.

Everything that moves is a cylinder in space, so that both cameras of a known rig see the same
things, as in a real session. Silhouettes are drawn at the pixels' undistorted places with one pixel
of analytic antialiasing: the true edges are exact.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks._stress_scenes import (
    SHADINGS,
    Floats,
    Image,
    clutter,
    photograph,
    shading,
)
from pivometer.cameras import Camera, Rig
from pivometer.geometry import RigidTransform, tangent_plane_normals
from pivometer.geometry.rigid import rotation_from_vector

SIZE = (640, 480)
FOCAL_PX, DISTANCE_MM = 1000.0, 450.0
MM = FOCAL_PX / DISTANCE_MM
"""Pixels per mm at the workspace's middle."""

Shade = Callable[[Floats, Floats], Floats]


@dataclass(frozen=True)
class View:
    """One camera, its place in the room, and the undistorted place of each of its pixels."""

    camera: Camera
    room_from_camera: RigidTransform
    places: Floats

    def edges(self, point: Floats, along: Floats, radius: float) -> Floats:
        """Return a cylinder's silhouette lines (2, 3), undistorted px, positive outside."""
        camera_from_room = self.room_from_camera.inverse()
        normals = tangent_plane_normals(
            camera_from_room @ point, camera_from_room.rotate(along), radius
        )
        lines = normals @ np.linalg.inv(self.camera.calibration_matrix)
        return np.asarray(lines / np.hypot(lines[:, 0], lines[:, 1])[:, None])

    def pixel(self, point: Floats) -> Floats:
        """Return a point's undistorted pixel."""
        seen = self.camera.calibration_matrix @ (self.room_from_camera.inverse() @ point)
        return np.asarray(seen[:2] / seen[2])

    def paint(
        self,
        image: Floats,
        point: Floats,
        along: Floats,
        radius: float,
        reach: tuple[float, float],
        shade: Shade,
    ) -> None:
        """Draw the cylinder between two places along its axis, mm from the point."""
        lines = self.edges(point, along, radius)
        ends = [self.pixel(point + s * along) for s in reach]
        direction = (ends[1] - ends[0]) / np.hypot(*(ends[1] - ends[0]))
        x, y = self.places
        one, other = (line[0] * x + line[1] * y + line[2] for line in lines)
        s = (x - ends[0][0]) * direction[0] + (y - ends[0][1]) * direction[1]
        length = float(np.hypot(*(ends[1] - ends[0])))
        cover = np.clip(0.5 - one, 0, 1) * np.clip(0.5 - other, 0, 1)
        cover *= np.clip(s + 0.5, 0, 1) * np.clip(length - s + 0.5, 0, 1)
        rows, columns = np.nonzero(cover)
        there = cover[rows, columns]
        across = ((one - other) / (one + other))[rows, columns]
        grey = shade(np.clip(-across, -1, 1), s[rows, columns])
        image[rows, columns] += there * (grey - image[rows, columns])


@dataclass(frozen=True)
class StressSession:
    """What both cameras saw, and the truth.

    Parameters
    ----------
    rig, diameter_mm
        The true ones.
    frames, empty
        By camera: the poses' images, and the room without shaft and rod.
    edges_px
        By camera: the true edges of each pose, shape (n, 2, 3), undistorted px.
    shading, has_second_rod
        What the shaft is like, and whether something else turns.
    """

    rig: Rig
    diameter_mm: float
    frames: dict[str, list[Image]]
    empty: dict[str, Image]
    edges_px: dict[str, Floats]
    shading: str
    has_second_rod: bool

    def offsets_px(self, name: str, pose: int, points_px: Floats) -> Floats:
        """Return distances (2, m) of raw points on both edges (2, m, 2) from the true ones."""
        camera = next(camera for camera in self.rig.cameras if camera.name == name)
        points = camera.undistorted_pixels(points_px)
        lines = self.edges_px[name][pose][:, None]
        there, crossed = (
            np.einsum("emk,emk->em", lines[order][..., :2], points) + lines[order][..., 2]
            for order in ([0, 1], [1, 0])
        )
        nearer = there if np.abs(there).max() < np.abs(crossed).max() else crossed
        return np.asarray(nearer)


def views(rng: np.random.Generator) -> list[View]:
    """Return two cameras that look at the workspace's middle."""
    wide, high = SIZE
    rows, columns = np.mgrid[0:high, 0:wide].astype(np.float64)
    pixels = np.stack([columns, rows], axis=-1)
    base = rng.uniform(80, 200)
    found = []
    for name, side in (("left", -1), ("right", 1)):
        middle = np.array([wide / 2, high / 2]) + rng.uniform(-10, 10, 2)
        beta = np.array([rng.uniform(-0.15, 0.0), 0.0])
        camera = Camera(name, wide, high, np.full(2, FOCAL_PX), middle, beta)
        turn = np.arctan2(-side * base / 2, DISTANCE_MM) + rng.normal(0, 0.01)
        rotation = rotation_from_vector([0.0, turn, 0.0])
        rotation = rotation @ rotation_from_vector(rng.normal(0, 0.02, 3))
        place = np.array([side * base / 2, rng.normal(0, 5), rng.normal(0, 5)])
        places = np.moveaxis(camera.undistorted_pixels(pixels), -1, 0)
        found.append(View(camera, RigidTransform(rotation, place), places))
    return found


@dataclass(frozen=True)
class Things:
    """What stands and turns in the room: of the shaft, one row a pose.

    Parameters
    ----------
    pivot, misses, tilts
        Where the shaft should turn, by how much each pose misses that, and its `_tilts`.
    begins, ends, reach
        Of the shaft along its axis, and a common measure of it, mm.
    radius, rod_radius, tube_radius
        Of the shaft, the other rod and the trocar, mm.
    rod_pivot, rod_tilts
        Of the other rod.
    greys
        Shades of shaft and rod.
    tube_grey
        Of the trocar.
    has_rod
        Whether the other rod is there.
    rail
        Radius of a rail of the carriage, and how far beside the shaft it lies, mm; if it has one.
    """

    pivot: Floats
    misses: Floats
    tilts: Floats
    begins: Floats
    ends: Floats
    reach: float
    radius: float
    rod_radius: float
    tube_radius: float
    rod_pivot: Floats
    rod_tilts: Floats
    greys: tuple[Shade, Shade]
    tube_grey: float
    has_rod: bool
    rail: tuple[float, float] | None

    def axis(self, pose: int) -> tuple[Floats, Floats]:
        """Return a point of the shaft's axis and its direction."""
        return np.asarray(self.pivot + self.misses[pose]), _direction(self.tilts[pose])

    def paint(self, view: View, image: Floats, pose: int) -> None:
        """Draw one pose, what is farther away first."""
        if self.has_rod and self.rod_pivot[2] > self.pivot[2]:
            self._paint_rod(view, image, pose)
        self._paint_shaft(view, image, pose)
        if self.has_rod and self.rod_pivot[2] <= self.pivot[2]:
            self._paint_rod(view, image, pose)
        self.paint_tube(view, image)

    def _paint_shaft(self, view: View, image: Floats, pose: int) -> None:
        """Draw the shaft with its collar and its carriage."""
        at, along = self.axis(pose)
        radius, end = self.radius, float(self.ends[pose])
        if self.rail is not None:
            side = np.cross(along, [0.0, 0.0, 1.0])
            beside = at + self.rail[1] * side / np.linalg.norm(side)
            reach = (0.3 * self.reach, 1.4 * self.reach)
            view.paint(image, beside, along, self.rail[0], reach, lambda a, _: 150 - 60 * a * a)
        view.paint(image, at, along, radius, (float(self.begins[pose]), end), self.greys[0])
        collar = (0.45 * self.reach, 0.45 * self.reach + 2 * radius)
        view.paint(image, at, along, 1.3 * radius, collar, lambda a, _: 90 + 40 * a)
        stout = 3.5 * radius if radius * MM < 20 else 2 * radius
        view.paint(image, at, along, stout, (end - 2, end + 2.4 * stout), _carriage_shade)

    def _paint_rod(self, view: View, image: Floats, pose: int) -> None:
        along = _direction(self.rod_tilts[pose])
        view.paint(image, self.rod_pivot, along, self.rod_radius, (-27.0, 160.0), self.greys[1])

    def paint_tube(self, view: View, image: Floats) -> None:
        """Draw the trocar, which stands still."""
        along = _direction(self.tilts.mean(axis=0))

        def shade(across: Floats, _: Floats) -> Floats:
            return np.asarray(self.tube_grey * (1 - 0.3 * across**2))

        view.paint(image, self.pivot, along, self.tube_radius, (-11.0, 11.0), shade)


def _carriage_shade(across: Floats, _: Floats) -> Floats:
    return np.where(np.abs(across) < 0.7, 70.0, 150.0)


def things(
    seed: int,
    rng: np.random.Generator,
    count: int,
    rod: tuple[float, float] | None,
    rail: bool,
) -> Things:
    """Draw what is in the room."""
    rails = np.random.default_rng([seed, 5])
    rail_part, rail_aside = rails.uniform(1.3, 3.0), rails.choice([-1, 1]) * rails.uniform(20, 50)
    diameter = float(np.exp(rng.uniform(np.log(9), np.log(60)))) / MM
    pivot = np.array([rng.uniform(-45, 45), rng.uniform(54, 103), rng.uniform(-20, 20)])
    pivot[2] += DISTANCE_MM
    has_rod = rod is not None or bool(rng.uniform() < 0.5)
    rod_part = rng.uniform(*(rod or (0.35, 0.7)))
    aside = rng.choice([-1, 1]) * rng.uniform(18, 90)
    rod_pivot = pivot + np.array([aside, rng.uniform(-18, 0), rng.uniform(-40, 40)])
    tilts = _tilts(rng, count)
    rod_tilts = rng.choice([-1, 1]) * rng.uniform(0.5, 1.0) * tilts + rng.uniform(-0.3, 0.3, 2)
    rod_tilts = rod_tilts + rng.normal(0, 0.05, (count, 2))
    greys = shading(SHADINGS[seed % 5], rng), shading(SHADINGS[(seed + 2) % 5], rng)
    reach = rng.uniform(112, 190)
    return Things(
        pivot=pivot,
        tilts=tilts,
        begins=-rng.uniform(13, 54, count),
        ends=reach * rng.uniform(0.8, 1.2, count),
        misses=rng.normal(0, 0.1 * diameter, (count, 3)),
        reach=reach,
        radius=diameter / 2,
        rod_radius=rod_part * diameter / 2,
        tube_radius=rng.uniform(0.8, 1.2) * diameter,
        rod_pivot=rod_pivot,
        rod_tilts=rod_tilts,
        greys=greys,
        tube_grey=float(rng.choice([40, 120, 200])),
        has_rod=has_rod,
        rail=(rail_part * diameter / 2, rail_aside) if rail else None,
    )


def stress_session(
    seed: int,
    *,
    count: int,
    hard: bool = False,
    rod: tuple[float, float] | None = None,
    rail: bool = False,
) -> StressSession:
    """Draw one session; everything in it follows from the seed.

    Parameters
    ----------
    seed
        Of everything random.
    count
        Poses.
    hard
        With a moving shadow and 3 % flicker.
    rod
        Range of a second rod's diameter in shaft diameters; 0.35 to 0.7 in half of the sessions
        where none is given.
    rail
        With a rail of the carriage, 1.3 to 3 times as wide as the shaft and 20 to 50 mm beside it.
    """
    rng = np.random.default_rng([seed, 78])
    seen = views(rng)
    here = things(seed, rng, count, rod, rail)
    frames: dict[str, list[Image]] = {}
    empty, edges = {}, {}
    for view in seen:
        name = view.camera.name
        room = clutter(rng, *SIZE)
        frames[name] = []
        for pose in range(count):
            image = room.copy()
            here.paint(view, image, pose)
            frames[name].append(photograph(image, rng, hard))
        edges[name] = np.stack([view.edges(*here.axis(i), here.radius) for i in range(count)])
        here.paint_tube(view, room)
        empty[name] = photograph(room, rng, False)
    rig = Rig(
        [view.camera for view in seen],
        [
            RigidTransform.identity(),
            *(seen[0].room_from_camera.inverse() @ view.room_from_camera for view in seen[1:]),
        ],
    )
    kind = SHADINGS[seed % len(SHADINGS)]
    return StressSession(rig, 2 * here.radius, frames, empty, edges, kind, here.has_rod)


def _tilts(rng: np.random.Generator, count: int) -> Floats:
    """Return tangents of the tilt sideways and towards the cameras, shape (count, 2)."""
    centre, half = rng.uniform(-0.3, 0.3), rng.uniform(0.35, 0.7)
    sideways = rng.permutation(np.linspace(centre - half, centre + half, count))
    towards = rng.uniform(-0.1, 0.1) + rng.uniform(0.1, 0.35) * rng.uniform(-1, 1, count)
    return np.column_stack([np.tan(sideways), towards])


def _direction(tilts: Floats) -> Floats:
    """Return the unit direction up from the pivot."""
    along = np.array([tilts[0], -1.0, tilts[1]])
    return np.asarray(along / np.linalg.norm(along))
