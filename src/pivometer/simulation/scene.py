"""What stands and moves before the cameras: shaft, bearing, trocar, carriage, clutter."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pivometer._arrays import Floats
from pivometer.geometry import RigidTransform
from pivometer.geometry.line import unit
from pivometer.simulation.render import Shape
from pivometer.simulation.shapes import Box, Cylinder, Lighting, Material, Polygon, Sphere

UP = np.array([0.0, -1.0, 0.0])


@dataclass(frozen=True, slots=True, eq=False)
class Shaft:
    """The shaft, counted from the pivot outwards.

    Parameters
    ----------
    diameter_mm
        Its diameter, mm.
    span_mm
        Where it comes out of the bearing or trocar, and where it ends, mm.
    bands
        Its materials, each with the place along the shaft where it begins, mm.
    """

    diameter_mm: float
    span_mm: tuple[float, float]
    bands: tuple[tuple[float, Material], ...]


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """Everything but the shaft, in the reference frame; sizes scale with the shaft's diameter.

    Parameters
    ----------
    kind
        ``"bearing"`` (a ball in a dark housing under the pivot), ``"eye"`` (a dark dome whose top
        is the pivot), ``"arm"`` (trocar, carriage and clutter) or ``"bare"`` (nothing).
    pivot_mm
        The design pivot, shape (3,), mm.
    lighting
        The lamps, reference frame.
    dark
        Radiance where there is nothing.
    scale
        Size of trocar, carriage and clutter; 1 suits a shaft of 10 mm.
    clutter_seed
        Chooses the standing clutter of the session.
    """

    kind: str
    pivot_mm: Floats
    lighting: Lighting
    dark: float = 0.012
    scale: float = 1.0
    clutter_seed: int = 0
    carriage_mm: float = 135.0
    steel: Material = field(default_factory=lambda: Material("metal", 0.12, 0.5, 60.0, 0.35))
    plastic: Material = field(default_factory=lambda: Material("matte", 0.45))

    def standing(self, camera_from_reference: RigidTransform) -> list[Shape]:
        """Return what never moves, back to front, in a camera's frame."""
        light = self.lighting.seen_from(camera_from_reference)
        if self.kind == "bearing":
            return self._bearing(camera_from_reference, light)
        if self.kind == "eye":
            centre = camera_from_reference @ (self.pivot_mm - 50.0 * self.scale * UP)
            return [Sphere(centre, 50.0 * self.scale, Material("metal", 0.06, 0.1, 80.0), light)]
        return clutter(self, camera_from_reference, light) if self.kind == "arm" else []

    def posed(
        self,
        shaft: Shaft,
        point_mm: Floats,
        direction: Floats,
        camera_from_reference: RigidTransform,
    ) -> list[Shape]:
        """Return what is seen of one robot pose, back to front, in a camera's frame.

        `point_mm` and `direction` are the true centerline in the reference frame; places along
        the shaft count from the line's point nearest to the design pivot.
        """
        light = self.lighting.seen_from(camera_from_reference)
        point = camera_from_reference @ point_mm
        axis = camera_from_reference.rotate(direction)
        rod = Cylinder(
            point, axis, shaft.diameter_mm / 2, shaft.span_mm, shaft.bands, light, sunk=True
        )
        return self._arm(rod, camera_from_reference, light) if self.kind == "arm" else [rod]

    def _bearing(self, camera_from_reference: RigidTransform, light: Lighting) -> list[Shape]:
        """Return a dark housing with a ball whose top stands out of it."""
        k = self.scale
        pivot, up = camera_from_reference @ self.pivot_mm, camera_from_reference.rotate(UP)
        housing = ((0.0, Material("matte", 0.045)),)
        ring = ((0.0, Material("matte", 0.07)),)
        ball = Material("metal", 0.02, 0.10, 90.0, 0.05)
        return [
            Cylinder(pivot, up, 26.0 * k, (-70.0 * k, -6.0 * k), housing, light),
            Cylinder(pivot, up, 15.0 * k, (-6.0 * k, 1.0 * k), ring, light),
            Sphere(pivot, 9.5 * k, ball, light),
        ]

    def _arm(
        self, rod: Cylinder, camera_from_reference: RigidTransform, light: Lighting
    ) -> list[Shape]:
        k, axis = self.scale, rod.direction
        bright = ((0.0, self.steel),)
        black = ((0.0, Material("metal", 0.03, 0.2, 25.0, 0.03)),)
        tube = Cylinder(rod.point_mm, axis, 6.2 * k, (-8 * k, 13 * k), bright, light)
        flange = Cylinder(rod.point_mm, axis, 12.0 * k, (13 * k, 18 * k), black, light)
        trocar: list[Shape] = [tube, flange] if flange.sees_end(1) else [flange, tube]
        carriage = self._carriage(rod, camera_from_reference, light)
        below: list[Shape] = [*trocar, rod] if flange.sees_end(1) else [rod, *trocar]
        from_below = Cylinder(
            rod.point_mm, axis, k, (self.carriage_mm * k, self.carriage_mm * k + 1), bright, light
        ).sees_end(0)
        if from_below:
            return [*carriage, *below]
        return [*below, *carriage]

    def _carriage(
        self, rod: Cylinder, camera_from_reference: RigidTransform, light: Lighting
    ) -> list[Shape]:
        """Return the block that holds the shaft and the arm behind it, moving with the shaft."""
        k, y = self.scale, -rod.direction
        back = camera_from_reference.rotate(unit([-0.75, 0.1, 0.66]))
        z = unit(back - (back @ y) * y)
        turn = np.column_stack([np.cross(y, z), y, z])
        middle = rod.point_mm - (self.carriage_mm + 26.0) * k * y
        block = RigidTransform(turn, middle)
        arm = RigidTransform(turn, middle + turn @ [0.0, -4.0 * k, 96.0 * k])
        parts: list[Shape] = [
            Box(arm, np.array([13.0, 15.0, 80.0]) * k, self.plastic, light),
            Box(block, np.array([19.0, 26.0, 17.0]) * k, self.plastic, light),
        ]
        nearer = np.linalg.norm(arm.translation_mm) < np.linalg.norm(middle)
        return parts[::-1] if nearer else parts


class Grain:
    """Smooth random relative radiance over a surface, in three octaves.

    Parameters
    ----------
    frame
        The surface's frame in the camera's; the grain varies over its x-y plane.
    size_mm
        Size of the coarsest grain, mm.
    depth
        Amplitude.
    rng
        Chooses the pattern; cameras that share a seed see the same surface.
    """

    def __init__(
        self, frame: RigidTransform, size_mm: float, depth: float, rng: np.random.Generator
    ) -> None:
        self._inverse = frame.inverse()
        self._size_mm, self._depth = size_mm, depth
        self._table = rng.standard_normal((64, 64))

    def __call__(self, points_mm: Floats) -> Floats:
        """Return the relative radiance at points of the surface, shape (n, 3)."""
        place = (self._inverse @ points_mm)[:, :2] / self._size_mm
        octaves = [self._smooth(place * 3.1**k + 7.7 * k) / 1.6**k for k in range(3)]
        relative: Floats = np.maximum(1 + self._depth * np.sum(octaves, axis=0), 0.1)
        return relative

    def _smooth(self, place: Floats) -> Floats:
        low = np.floor(place)
        part = place - low
        part = part * part * (3 - 2 * part)
        i, j = (low % 64).astype(int).T
        a, b = part.T
        T, i1, j1 = self._table, (i + 1) % 64, (j + 1) % 64
        first = T[i, j] * (1 - b) + T[i, j1] * b
        smooth: Floats = first * (1 - a) + (T[i1, j] * (1 - b) + T[i1, j1] * b) * a
        return smooth


def clutter(stage: Stage, camera_from_reference: RigidTransform, light: Lighting) -> list[Shape]:
    """Return a room around the pivot: walls and table with straight lines, rods, boxes, a port."""
    rng = np.random.default_rng([stage.clutter_seed, 77])
    k, pivot = stage.scale, stage.pivot_mm
    floor = 46.0 * k

    def frame(x: Floats, y: Floats, at: Floats) -> RigidTransform:
        turn = np.column_stack([x, y, np.cross(x, y)])
        return camera_from_reference @ RigidTransform(turn, pivot + k * at)

    X, Y, Z = np.eye(3)
    surfaces = [
        (frame(X, Y, np.array([0.0, 0.0, 520.0])), 0.52, (-1100.0, -900.0, 1100.0, floor / k)),
        (frame(Z, Y, np.array([-560.0, 0.0, 0.0])), 0.45, (-1100.0, -900.0, 520.0, floor / k)),
        (frame(X, Z, np.array([0.0, floor / k, 0.0])), 0.62, (-560.0, -1500.0, 1100.0, 520.0)),
    ]
    shapes: list[Shape] = []
    for number, (plane, albedo, area) in enumerate(surfaces):
        normal = plane.rotation[:, 2] * -np.sign(plane.rotation[:, 2] @ plane.translation_mm)
        shade = float(light.irradiance(normal))
        grain = Grain(plane, 120.0 * k, 0.10, rng)
        corners = k * _rectangle(*area)
        shapes.append(Polygon(plane @ corners, albedo * shade, grain))
        shapes += _decals(plane, area, shade, k, number, rng)
    return shapes + _things(camera_from_reference, pivot, light, k, floor, rng)


def _rectangle(left: float, top: float, right: float, bottom: float) -> Floats:
    return np.array([[left, top, 0], [right, top, 0], [right, bottom, 0], [left, bottom, 0]])


def _decals(
    plane: RigidTransform,
    area: tuple[float, float, float, float],
    shade: float,
    k: float,
    number: int,
    rng: np.random.Generator,
) -> list[Shape]:
    """Return panels and straight strips on a surface, where the cameras look."""
    shapes: list[Shape] = []
    low = np.maximum([area[0], area[1]], [-330.0, -330.0])
    high = np.minimum([area[2], area[3]], [330.0, 250.0])
    for _ in range(7):
        middle, size = rng.uniform(low, high), rng.uniform(25, 110, 2)
        box = np.concatenate(
            [np.maximum(middle - size, area[:2]), np.minimum(middle + size, area[2:])]
        )
        shapes.append(Polygon(plane @ (k * _rectangle(*box)), shade * rng.uniform(0.2, 0.85)))
    for _ in range(11 if number < 2 else 6):
        start, heading = rng.uniform(low, high), rng.uniform(0, np.pi)
        way = np.array([np.cos(heading), np.sin(heading)])
        half, thick = rng.uniform(90, 300), rng.uniform(1.2, 7.0)
        across = thick * np.array([-way[1], way[0]])
        ends = [start - half * way, start + half * way]
        strip = [ends[0] - across, ends[1] - across, ends[1] + across, ends[0] + across]
        flat = np.clip(strip, area[:2], area[2:])
        corners = k * np.column_stack([flat, np.zeros(4)])
        shapes.append(Polygon(plane @ corners, shade * rng.choice([0.06, 0.1, 0.25, 0.75, 0.9])))
    return shapes


def _things(
    camera_from_reference: RigidTransform,
    pivot: Floats,
    light: Lighting,
    k: float,
    floor: float,
    rng: np.random.Generator,
) -> list[Shape]:
    """Return rods, boxes and the port's block on the table, far to near."""
    things: list[tuple[float, Shape]] = []
    up = camera_from_reference.rotate(UP)

    def add(shape: Shape, at: Floats) -> None:
        things.append((float(np.linalg.norm(camera_from_reference @ at)), shape))

    # Behind the pivot in one view and beside it in the other, clear of the cone itself.
    for x, z in ((-150.0, 190.0), (-215.0, 60.0), (95.0, 260.0), (-240.0, -90.0)):
        at = pivot + k * np.array([x + rng.uniform(-15, 15), 0, z + rng.uniform(-15, 15)])
        metal = Material("metal", 0.10, 0.4, 40.0, rng.uniform(0.05, 0.4))
        span = (-floor, rng.uniform(150, 400) * k)
        rod = Cylinder(
            camera_from_reference @ at, up, rng.uniform(2, 4) * k, span, ((0.0, metal),), light
        )
        add(rod, at)
    for x, z in ((-90.0, 230.0), (170.0, 250.0), (-260.0, 150.0), (-230.0, -20.0)):
        half = rng.uniform(18, 42, 3) * k
        at = pivot + np.array([x * k, floor - half[1], z * k])
        turn = RigidTransform.from_rotation_vector([0, rng.uniform(-0.7, 0.7), 0], at)
        matte = Material("matte", rng.uniform(0.2, 0.75))
        add(Box(camera_from_reference @ turn, half, matte, light), at)
    half = np.array([30.0, (floor / k - 9.0) / 2, 27.0]) * k
    at = pivot + np.array([0.0, floor - half[1], 0.0])
    turn = RigidTransform.from_rotation_vector([0, 0.3, 0], at)
    add(Box(camera_from_reference @ turn, half, Material("matte", 0.5), light), at)
    return [shape for _, shape in sorted(things, key=lambda pair: -pair[0])]
