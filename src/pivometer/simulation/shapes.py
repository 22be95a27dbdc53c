"""Shapes in a camera's frame, with exact image outlines: planes and cones through its centre."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats, checked, read_only
from pivometer.geometry import RigidTransform, tangent_plane_normals
from pivometer.geometry.line import unit
from pivometer.simulation.optics import Edge, Rays, coverage, edge_at

Painted = tuple[Floats, Floats, NDArray[np.bool_]]
NEAR_MM = 1.0

LIMB = 2.5
"""How far from a round shape's outline its shade is sampled finely, px: it falls like a root."""


@dataclass(frozen=True, slots=True, eq=False)
class Lighting:
    """Distant lamps and a uniform surround.

    Parameters
    ----------
    directions
        Unit vectors towards the lamps, shape (k, 3).
    strengths
        Irradiance of each lamp on a surface facing it, shape (k,).
    ambient
        Irradiance of the surround.
    """

    directions: Floats
    strengths: Floats
    ambient: float = 0.3

    def __post_init__(self) -> None:
        object.__setattr__(self, "directions", read_only(unit(self.directions)))
        object.__setattr__(self, "strengths", read_only(self.strengths))

    def seen_from(self, camera_from_reference: RigidTransform) -> Lighting:
        """Return the lamps in a camera's frame."""
        return Lighting(camera_from_reference.rotate(self.directions), self.strengths, self.ambient)

    def irradiance(self, normals: Floats) -> Floats:
        """Return the light that falls on surfaces of outward unit normals (..., 3)."""
        lamps: Floats = np.maximum(normals @ self.directions.T, 0) @ self.strengths
        return self.ambient + lamps


@dataclass(frozen=True, slots=True, eq=False)
class Material:
    """A surface: ``flat`` (same radiance everywhere), ``matte`` (Lambert) or ``metal``.

    Parameters
    ----------
    shading
        ``"flat"``, ``"matte"`` or ``"metal"``.
    albedo
        Diffuse reflectance, or the radiance itself where flat.
    gloss
        Strength of the lamps' mirror image.
    sharpness
        Exponent-like width of the highlight: exp(sharpness (cos − 1)).
    mirror
        Reflectance of the surround, which is brighter above than below and has a dark horizon.
    """

    shading: str = "matte"
    albedo: float = 0.5
    gloss: float = 0.0
    sharpness: float = 60.0
    mirror: float = 0.0

    def radiance(self, normals: Floats, rays: Floats, lighting: Lighting) -> Floats:
        """Return the radiance of surface points with unit normals (n, 3) seen along rays (n, 3)."""
        if self.shading == "flat":
            return np.full(normals.shape[:-1], self.albedo)
        value = self.albedo * lighting.irradiance(normals)
        if self.shading == "metal":
            view = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
            facing = np.sum(normals * view, axis=-1, keepdims=True)
            mirrored = view - 2 * facing * normals
            cosines = mirrored @ lighting.directions.T
            value = value + self.gloss * (
                np.exp(self.sharpness * (cosines - 1)) @ lighting.strengths
            )
            up = -mirrored[..., 1]
            value = value + self.mirror * (0.35 + 0.3 * up + 0.25 * np.sin(5 * mirrored[..., 0]))
        return value


def plane_edge(rays: Rays, normal: Floats) -> Edge:
    """Return the image of a plane through the camera's centre, `normal` pointing inside."""
    return edge_at(rays, normal[0] * rays.x + normal[1] * rays.y + normal[2], *normal[:2])


def cone_edge(rays: Rays, form: Floats) -> Edge:
    """Return the image of the conic rᵀ Q r = 0, inside where positive."""
    x, y = rays.x, rays.y
    dx, dy, dz = (row[0] * x + row[1] * y + row[2] for row in form)
    return edge_at(rays, x * dx + y * dy + dz, 2 * dx, 2 * dy)


@dataclass(frozen=True, slots=True, eq=False)
class Polygon:
    """A flat convex polygon, clipped to what lies in front of the camera.

    Parameters
    ----------
    corners_mm
        Its corners in order, shape (k, 3), camera frame, mm.
    radiance
        Its radiance.
    texture
        Optional relative radiance at points (n, 3) of the surface, camera frame, mm.
    """

    corners_mm: Floats
    radiance: float
    texture: Callable[[Floats], Floats] | None = None
    _planes: Floats = field(init=False)

    def __post_init__(self) -> None:
        corners = clipped(checked(self.corners_mm, (None, 3), "corners_mm"))
        object.__setattr__(self, "corners_mm", corners)
        object.__setattr__(self, "_planes", edge_planes(corners))

    def outline_mm(self) -> Floats:
        """Return the corners, or a point behind the image's corner where nothing is in front."""
        return self.corners_mm

    def paint(self, rays: Rays, cell: float) -> Painted:
        """Return coverage, radiance and edge flags of the cells."""
        share, edge = np.ones_like(rays.x), np.zeros(rays.x.shape, dtype=bool)
        for plane in self._planes:
            side = plane_edge(rays, plane)
            share *= coverage(side, cell)
            edge |= side.near(0.75 * cell)
        value = np.full_like(rays.x, self.radiance)
        if self.texture is not None:
            hit = share > 0
            value[hit] *= self.texture(self._points(rays.select(hit)))
        return share, value, edge

    def _points(self, rays: Rays) -> Floats:
        a, b, c = self.corners_mm[:3]
        normal = np.cross(b - a, c - a)
        direction = rays.directions()
        depth = (a @ normal) / (direction @ normal)
        points: Floats = direction * depth[:, None]
        return points


def clipped(corners: Floats) -> Floats:
    """Return the part of a polygon (k, 3) with z ≥ NEAR_MM (Sutherland–Hodgman)."""
    kept = []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if a[2] >= NEAR_MM:
            kept.append(a)
        if (a[2] >= NEAR_MM) != (b[2] >= NEAR_MM):
            kept.append(a + (b - a) * (NEAR_MM - a[2]) / (b[2] - a[2]))
    return np.array(kept) if len(kept) >= 3 else np.tile([1e6, 1e6, 1.0], (3, 1))


def edge_planes(corners: Floats) -> Floats:
    """Return inward normals (k, 3) of the planes through the camera's centre and each edge."""
    planes = np.cross(corners, np.roll(corners, -1, axis=0))
    middle = corners.mean(axis=0)
    inward: Floats = planes * np.where(planes @ middle >= 0, 1.0, -1.0)[:, None]
    return inward


@dataclass(frozen=True, slots=True, eq=False)
class Box:
    """A cuboid; adjacent faces share their edge without a seam.

    Parameters
    ----------
    camera_from_box
        Where it is; its centre is the box's origin.
    half_mm
        Half its sides, shape (3,), mm.
    material, lighting
        Its surface and the lamps in the camera's frame.
    """

    camera_from_box: RigidTransform
    half_mm: Floats
    material: Material
    lighting: Lighting
    _faces: list[Polygon] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "half_mm", read_only(self.half_mm))
        faces = []
        for axis in range(3):
            for sign in (-1.0, 1.0):
                normal = np.eye(3)[axis] * sign
                middle = self.camera_from_box @ (normal * self.half_mm)
                if middle @ self.camera_from_box.rotate(normal) < 0:
                    faces.append(self._face(axis, normal, middle))
        object.__setattr__(self, "_faces", faces)

    def _face(self, axis: int, normal: Floats, middle: Floats) -> Polygon:
        u, v = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
        turn = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]], dtype=np.float64)
        corners = (normal + turn[:, :1] * u + turn[:, 1:] * v) * self.half_mm
        outward = self.camera_from_box.rotate(normal)[None]
        radiance = self.material.radiance(outward, middle[None], self.lighting)
        return Polygon(self.camera_from_box @ corners, float(radiance[0]))

    def outline_mm(self) -> Floats:
        """Return the corners of the faces that are seen."""
        return np.concatenate([face.corners_mm for face in self._faces])

    def paint(self, rays: Rays, cell: float) -> Painted:
        """Return coverage, radiance and edge flags of the cells."""
        total, light = np.zeros_like(rays.x), np.zeros_like(rays.x)
        edge = np.zeros(rays.x.shape, dtype=bool)
        for face in self._faces:
            share, value, near = face.paint(rays, cell)
            total, light, edge = total + share, light + share * value, edge | near
        return np.minimum(total, 1), light / np.maximum(total, 1e-12), edge


@dataclass(frozen=True, slots=True, eq=False)
class Sphere:
    """A ball.

    Parameters
    ----------
    centre_mm, radius_mm
        Where it is in the camera's frame and its radius, mm.
    material, lighting
        Its surface and the lamps in the camera's frame.
    """

    centre_mm: Floats
    radius_mm: float
    material: Material
    lighting: Lighting

    def outline_mm(self) -> Floats:
        """Return the corners of a cube around the ball."""
        turn = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), axis=-1).reshape(-1, 3)
        corners: Floats = self.centre_mm + self.radius_mm * turn
        return corners

    def paint(self, rays: Rays, cell: float) -> Painted:
        """Return coverage, radiance and edge flags of the cells."""
        reach = self.centre_mm @ self.centre_mm - self.radius_mm**2
        rim = cone_edge(rays, np.outer(self.centre_mm, self.centre_mm) - reach * np.eye(3))
        share, value = coverage(rim, cell), np.zeros_like(rays.x)
        hit = share > 0
        direction = rays.select(hit).directions()
        a, b = np.sum(direction**2, axis=1), direction @ self.centre_mm
        depth = (b - np.sqrt(np.maximum(b * b - a * reach, 0))) / a
        normals = unit(direction * depth[:, None] - self.centre_mm) if hit.any() else direction
        value[hit] = self.material.radiance(normals, direction, self.lighting)
        return share, value, rim.near(LIMB * cell)


@dataclass(frozen=True, slots=True, eq=False)
class Cylinder:
    """A straight circular cylinder with flat ends: a shaft, a trocar, a rod, a housing.

    Its outline is exact: two tangent planes (`geometry.tangent_plane_normals`) between the
    conics of its end circles.

    Parameters
    ----------
    point_mm, direction
        A point of the axis (mm) and the axis, shape (3,), camera frame.
    radius_mm
        The radius, mm.
    span_mm
        Where it starts and ends along the axis, counted from `point_mm`, mm.
    bands
        Materials with the place along the axis (mm) where each begins, in order.
    lighting
        The lamps in the camera's frame.
    sunk
        Whether the first end is sunk into what is painted before, so that its face never shows.
    """

    point_mm: Floats
    direction: Floats
    radius_mm: float
    span_mm: tuple[float, float]
    bands: Sequence[tuple[float, Material]]
    lighting: Lighting
    sunk: bool = False
    _sides: Floats = field(init=False)
    _chords: Floats = field(init=False)
    _ends: tuple[Floats, Floats] = field(init=False)

    def __post_init__(self) -> None:
        axis = unit(self.direction)
        object.__setattr__(self, "point_mm", checked(self.point_mm, (3,), "point_mm"))
        object.__setattr__(self, "direction", axis)
        outward = tangent_plane_normals(self.point_mm, axis, self.radius_mm)
        contact = self.point_mm + self.radius_mm * outward
        chords = [np.cross(contact[0] + t * axis, contact[1] + t * axis) for t in self.span_mm]
        middle = self.point_mm + axis * sum(self.span_mm) / 2
        chords = [chord * np.sign(chord @ middle) for chord in chords]
        object.__setattr__(self, "_sides", -outward)
        object.__setattr__(self, "_chords", np.array(chords))
        object.__setattr__(self, "_ends", tuple(self._circle(t) for t in self.span_mm))

    def _circle(self, place_mm: float) -> Floats:
        """Return the conic Q of an end circle: rᵀ Q r ≥ 0 for rays that pass inside it."""
        axis, centre = self.direction, self.point_mm + place_mm * self.direction
        miss = (centre @ axis) * np.eye(3) - np.outer(centre, axis)
        form: Floats = self.radius_mm**2 * np.outer(axis, axis) - miss.T @ miss
        return form

    def outline_mm(self) -> Floats:
        """Return points around both ends and between them."""
        axis = self.direction
        u = unit(np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))]))
        turn = np.linspace(0, 2 * np.pi, 12, endpoint=False)[:, None]
        rim = 1.04 * self.radius_mm * (np.cos(turn) * u + np.sin(turn) * np.cross(axis, u))
        places = np.linspace(*self.span_mm, 5)
        points = (self.point_mm + places[:, None, None] * axis + rim).reshape(-1, 3)
        return points[points[:, 2] > NEAR_MM]

    def sees_end(self, end: int) -> bool:
        """Return whether the camera looks onto the first (0) or the second (1) end's face."""
        height = -(self.point_mm @ self.direction) - self.span_mm[end]
        return bool(height > 0 if end else height < 0)

    def paint(self, rays: Rays, cell: float) -> Painted:
        """Return coverage, radiance and edge flags of the cells."""
        share, edge = np.ones_like(rays.x), np.zeros(rays.x.shape, dtype=bool)
        for plane, reach in zip(
            (*self._sides, *self._chords), (LIMB, LIMB, 0.75, 0.75), strict=True
        ):
            side = plane_edge(rays, plane)
            share *= coverage(side, cell)
            edge |= side.near(reach * cell)
        discs = []
        for form in self._ends:
            rim = cone_edge(rays, form)
            discs.append(coverage(rim, cell))
            edge |= rim.near(0.75 * cell)
        total = np.maximum(share, np.maximum(*discs))
        edge &= total > 0  # away from the outline nothing is painted
        if self.sunk and self.sees_end(0):
            total = total - np.minimum(discs[0], total)
        value = np.zeros_like(rays.x)
        hit = total > 0
        value[hit], seam = self._side_radiance(rays.select(hit))
        edge[hit] |= seam
        return total, self._with_caps(value, discs), edge

    def _with_caps(self, value: Floats, discs: list[Floats]) -> Floats:
        for end, disc in enumerate(discs):
            if self.sees_end(end):
                centre = self.point_mm + self.span_mm[end] * self.direction
                outward = self.direction * (1 if end else -1)
                cap = self.bands[-end][1].radiance(outward[None], centre[None], self.lighting)
                value = value + disc * (cap[0] - value)
        return value

    def _side_radiance(self, rays: Rays) -> tuple[Floats, NDArray[np.bool_]]:
        """Return the radiance of the round side, and where it changes from band to band."""
        direction = rays.directions()
        across = direction - np.outer(direction @ self.direction, self.direction)
        foot = self.point_mm - (self.point_mm @ self.direction) * self.direction
        a, b = np.sum(across**2, axis=1), across @ foot
        inside = np.maximum(b * b - a * (foot @ foot - self.radius_mm**2), 0)
        depth = (b - np.sqrt(inside)) / a
        normals = across * depth[:, None] - foot
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        if len(self.bands) == 1:
            only = self.bands[0][1].radiance(normals, direction, self.lighting)
            return only, np.zeros(only.shape, dtype=bool)
        along = depth * (direction @ self.direction) - self.point_mm @ self.direction
        starts = np.array([place for place, _ in self.bands[1:]])
        index = np.searchsorted(starts, along)
        value = np.zeros_like(depth)
        for k, (_, material) in enumerate(self.bands):
            at = index == k
            value[at] = material.radiance(normals[at], direction[at], self.lighting)
        px_mm = depth * np.hypot(rays.x_u, rays.y_v) / np.maximum(np.sqrt(a), 0.1)
        return value, np.abs(along[:, None] - starts).min(axis=1) < px_mm
