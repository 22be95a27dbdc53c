"""Images of a shaft whose two edges are known exactly.

Across the shaft a scene is one-dimensional: out from the axis, shading, edge, background. That
profile is blurred by the point spread and by the pixel (a box seen at an angle is a box ⊗ a box)
in the Fourier domain, which is exact, and looked up at every pixel's distance from its edge.
Textured backgrounds are composited in 8 × 8 cells a pixel instead.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pivometer.cameras import Camera

Floats = NDArray[Any]
Shading = Callable[[Floats], Floats]

STEP_PX = 1 / 64
CELLS = 8


@dataclass(frozen=True)
class Geometry:
    """Both edges in undistorted px: x = normal · p − offset is the distance outward."""

    normals: Floats  # (2, 2)
    offsets: Floats  # (2,)

    def distances(self, points: Floats) -> Floats:
        """Return the signed distances of points (..., 2) from both edges, shape (..., 2)."""
        return points @ self.normals.T - self.offsets

    def moved(self, edge: int, shift_px: float, turn_rad: float, about: Floats) -> Geometry:
        """Return the scene with one edge shifted outward and turned about a point."""
        c, s = np.cos(turn_rad), np.sin(turn_rad)
        normals, offsets = self.normals.copy(), self.offsets.copy()
        normals[edge] = np.array([[c, -s], [s, c]]) @ normals[edge]
        offsets[edge] += shift_px + (normals[edge] - self.normals[edge]) @ about
        return Geometry(normals, offsets)


@dataclass(frozen=True)
class Look:
    """Everything about a scene but where its edges are."""

    shading: Shading
    outside: float
    psf_px: float
    noise: float
    hidden: tuple[float, float] = (0.0, 0.0)  # part of the image's height or width that is covered
    texture: NDArray[np.float32] | None = field(default=None, repr=False)


@dataclass(frozen=True)
class Scene:
    """An image, where its edges are, and what a method is given to start from."""

    camera: Camera
    geometry: Geometry
    look: Look
    clean: Floats
    image: NDArray[np.uint8]
    background: NDArray[np.uint8] | None
    seed_px: Floats  # (2, 2, 2), raw px, up to 2 px off

    @property
    def upright(self) -> bool:
        """Whether the shaft runs along image columns."""
        return bool(abs(self.geometry.normals[0, 0]) > abs(self.geometry.normals[0, 1]))


@lru_cache(maxsize=4)
def pixel_grid(size: tuple[int, int], lens: tuple[float, ...]) -> tuple[Camera, Floats, Floats]:
    """Return a camera, its pixels' undistorted positions (h, w, 2), and ∂undistorted/∂raw."""
    width, height = size
    focal = 1.1 * width
    middle = np.array([width / 2 - 0.3, height / 2 + 0.2])
    camera = Camera("a", width, height, np.array([focal, focal]), middle, np.array(lens))
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).astype(float)
    if not any(lens):
        return camera, pixels, np.broadcast_to(np.eye(2), (height, width, 2, 2))
    normalized = camera.normalized_from_pixels(pixels)
    raw_by_undistorted = camera.pixels_jacobian(normalized) / focal
    return (
        camera,
        normalized * focal + camera.principal_point_px,
        np.asarray(np.linalg.inv(raw_by_undistorted)),
    )


def blurred_profile(
    shading: Shading, outside: float, width_px: float, psf_px: float, normal: Floats
) -> tuple[Floats, Floats]:
    """Return positions from the axis and blurred grey levels across a shaft."""
    count = int(2 ** np.ceil(np.log2((width_px + 80) / STEP_PX)))
    s = (np.arange(count) - count // 2) * STEP_PX
    cover = np.clip((width_px / 2 - np.abs(s)) / STEP_PX + 0.5, 0, 1)
    inside = shading(np.clip(2 * s / width_px, -1, 1))
    sharp = outside + (inside - outside) * cover
    f = np.fft.rfftfreq(count, STEP_PX)
    kernel = (
        np.exp(-2 * (np.pi * f * psf_px) ** 2) * np.sinc(f * normal[0]) * np.sinc(f * normal[1])
    )
    return s, np.asarray(np.fft.irfft(np.fft.rfft(sharp) * kernel, count))


def _shaded(
    points: Floats, by_raw: Floats | None, geometry: Geometry, look: Look, widths: Floats
) -> Floats:
    """Return the grey levels at undistorted points (n, 2), from tables by distance and width."""
    x = geometry.distances(points)
    if by_raw is not None:
        x = x / np.linalg.norm(geometry.normals @ by_raw, axis=-1)
    width = -x.sum(axis=-1)
    out = np.full(len(points), look.outside)
    for edge in range(2):
        own = (x[:, edge] >= x[:, 1 - edge]) & (x[:, edge] < 25)
        reach = widths[-1] / 2 + 27
        grid = np.arange(-reach, 25, STEP_PX)
        sign = 1 if edge == 0 else -1
        table = []
        for w in widths:
            s, level = blurred_profile(
                look.shading, look.outside, w, look.psf_px, geometry.normals[edge]
            )
            table.append(np.interp(sign * (grid + w / 2), s, level))
        tables = np.array(table)
        i = (x[own, edge] + reach) / STEP_PX
        j = np.clip((width[own] - widths[0]) / max(widths[1] - widths[0], 1e-9), 0, len(widths) - 1)
        i0, j0 = (
            np.clip(i.astype(int), 0, len(grid) - 2),
            np.minimum(j.astype(int), len(widths) - 2),
        )
        a, b = i - i0, j - j0
        near = tables[j0, i0] * (1 - a) + tables[j0, i0 + 1] * a
        far = tables[j0 + 1, i0] * (1 - a) + tables[j0 + 1, i0 + 1] * a
        out[own] = near * (1 - b) + far * b
    return out


def render(
    camera_key: tuple[tuple[int, int], tuple[float, ...]], g: Geometry, look: Look
) -> Floats:
    """Return the noiseless image, shape (height, width)."""
    camera, points, by_raw = pixel_grid(*camera_key)
    if look.texture is not None:
        return composited(g, look.texture, look, shaft=True)
    x = g.distances(points)
    near = x.max(axis=-1) < 20
    width = -x.sum(axis=-1)[near]
    if any(camera.distortion):
        width = width / np.linalg.norm(g.normals[0] @ by_raw[near], axis=-1)
    widths = np.linspace(width.min() - 0.01, width.max() + 0.01, 7)
    image = np.full(near.shape, look.outside)
    jacobian = by_raw[near] if any(camera.distortion) else None
    image[near] = _shaded(points[near], jacobian, g, look, widths)
    return image


def composited(g: Geometry, texture: NDArray[np.float32], look: Look, *, shaft: bool) -> Floats:
    """Return the image of a sharp texture of CELLS² cells a pixel with the shaft before it."""
    sharp = texture
    if shaft:
        height, width = texture.shape
        u = ((np.arange(width) + 0.5) / CELLS - 0.5).astype(np.float32)
        v = ((np.arange(height) + 0.5) / CELLS - 0.5).astype(np.float32)
        cover = np.ones(texture.shape, dtype=np.float32)
        for normal, offset in zip(g.normals, g.offsets, strict=True):
            x = u[None, :] * np.float32(normal[0]) + (v * normal[1] - offset)[:, None]
            cover *= np.clip(0.5 - x * CELLS, 0, 1).astype(np.float32)
        sharp = texture + (np.float32(look.shading(np.zeros(1))[0]) - texture) * cover
    blurred = cv2.GaussianBlur(sharp, (0, 0), look.psf_px * CELLS, borderType=cv2.BORDER_REPLICATE)
    size = texture.shape[1] // CELLS, texture.shape[0] // CELLS
    return cv2.resize(blurred, size, interpolation=cv2.INTER_AREA).astype(np.float64)


def geometry(
    rng: np.random.Generator, size: tuple[int, int], angle_deg: float, width_px: float, taper: float
) -> Geometry:
    """Return two edges about an axis that passes near the image's middle."""
    angle = np.radians(angle_deg)
    across = np.array([-np.sin(angle), np.cos(angle)])
    centre = (np.array(size) - 1) / 2 + rng.uniform(-20, 20, 2)
    normals, offsets = [], []
    for side in (1, -1):
        turn = side * taper
        c, s = np.cos(turn), np.sin(turn)
        normal = side * np.array([[c, -s], [s, c]]) @ across
        normals.append(normal)
        offsets.append(normal @ (centre + side * width_px / 2 * across))
    return Geometry(np.array(normals), np.array(offsets))


def ends(camera: Camera, g: Geometry, edge: int, margin: float = 3.0) -> Floats:
    """Return the visible ends of an edge in undistorted px, shape (2, 2)."""
    normal, offset = g.normals[edge], g.offsets[edge]
    along = np.array([-normal[1], normal[0]])
    middle = np.array([camera.width - 1, camera.height - 1]) / 2
    foot = middle + (offset - normal @ middle) * normal
    points = foot + np.linspace(-0.75, 0.75, 4001)[:, None] * camera.width * along
    raw = camera.pixels_from_normalized((points - camera.principal_point_px) / camera.focal_px)
    limit = np.array([camera.width, camera.height]) - 1 - margin
    inside = points[((raw >= margin) & (raw <= limit)).all(axis=1)]
    return np.asarray(inside[[0, -1]])


def make(
    rng: np.random.Generator,
    look: Look,
    *,
    size: tuple[int, int] = (640, 480),
    lens: tuple[float, ...] = (),
    angle_deg: float | None = None,
    width_px: float | None = None,
    taper: float = 0.004,
) -> Scene:
    """Return one random scene: upright or lying, at any phase and within 30° of an axis."""
    angle = rng.uniform(60, 88) if angle_deg is None else angle_deg
    angle = (angle if rng.random() < 0.5 else 180 - angle) + (90 if rng.random() < 0.3 else 0)
    g = geometry(rng, size, angle, rng.uniform(24, 60) if width_px is None else width_px, taper)
    camera = pixel_grid(size, lens)[0]
    clean = render((size, lens), g, look)
    first, last = (int(part * max(size)) for part in look.hidden)
    if last > first:
        patch = (
            clean[first:last]
            if abs(g.normals[0, 0]) > abs(g.normals[0, 1])
            else clean[:, first:last]
        )
        patch[...] = rng.uniform(30, 200)
    background = None
    if look.texture is not None:
        background = exposed(composited(g, look.texture, look, shaft=False), look.noise, rng)
    seeds = np.stack([ends(camera, g, edge) for edge in range(2)])
    raw = camera.pixels_from_normalized((seeds - camera.principal_point_px) / camera.focal_px)
    seed_px = raw + rng.uniform(-1, 1, (2, 2, 1)) * 2.0 * g.normals[:, None]
    return Scene(camera, g, look, clean, exposed(clean, look.noise, rng), background, seed_px)


def exposed(clean: Floats, noise: float, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return an 8-bit image with Gaussian noise."""
    draw = rng.standard_normal(clean.shape, dtype=np.float32)
    return np.asarray(np.clip(np.rint(clean + noise * draw), 0, 255), dtype=np.uint8)


def middle_of(scene: Scene, edge: int) -> Floats:
    """Return the middle of the visible edge, undistorted px."""
    return np.asarray(ends(scene.camera, scene.geometry, edge).mean(axis=0))


def bound_px(scene: Scene) -> tuple[float, float]:
    """Return the Cramér–Rao bounds (px) of an edge's offset at its middle and of the centre's."""
    covariance = bound_covariance(scene)
    each = np.sqrt((covariance[0, 0] + covariance[2, 2]) / 2)
    centre = np.sqrt(covariance[0, 0] + covariance[2, 2] - 2 * covariance[0, 2]) / 2
    return float(each), float(centre)


def bound_covariance(scene: Scene) -> Floats:
    """Return the Cramér–Rao bound of both edges: offset (px) and angle (rad) at `middle_of` each.

    Shape (4, 4): offset and angle of the first edge, then of the second. From the clean image's
    derivatives by offset and angle of both edges, the outside level, the inside's gain and the
    blur: these seven are unknown, the shape of the shading is known. Quantisation counts as noise
    of 1/12.
    """
    key = (scene.camera.width, scene.camera.height), tuple(scene.camera.distortion)
    about = [middle_of(scene, edge) for edge in range(2)]
    looks = scene.look
    gain = 0.002

    def brighter(sign: int) -> Look:
        return replace(looks, shading=lambda xi: looks.shading(xi) * (1 + sign * gain))

    pairs = []
    for edge in range(2):
        for shift, turn in ((0.02, 0.0), (0.0, 1e-4)):
            pairs.append(
                [
                    render(key, scene.geometry.moved(edge, k * shift, k * turn, about[edge]), looks)
                    for k in (1, -1)
                ]
            )
    pairs.append([render(key, scene.geometry, brighter(k)) for k in (1, -1)])
    pairs.append(
        [
            render(key, scene.geometry, replace(looks, psf_px=looks.psf_px + k * 0.01))
            for k in (1, -1)
        ]
    )
    if looks.texture is None:
        pairs.append(
            [
                render(key, scene.geometry, replace(looks, outside=looks.outside + k))
                for k in (1, -1)
            ]
        )
    steps = np.array([0.02, 1e-4, 0.02, 1e-4, gain, 0.01, 1.0][: len(pairs)])
    seen = np.ones(scene.clean.shape, dtype=bool)
    first, last = (int(part * max(key[0])) for part in looks.hidden)
    (seen if scene.upright else seen.T)[first:last] = False
    J = np.stack([(a - b)[seen] / (2 * h) for (a, b), h in zip(pairs, steps, strict=True)], axis=1)
    covariance = np.linalg.inv(J.T @ J) * (looks.noise**2 + 1 / 12)
    return np.asarray(covariance[:4, :4])


def supersampled_difference(scene: Scene, samples: int = 32) -> float:
    """Return the largest difference in grey levels from plain supersampling, near one edge."""
    look, g = scene.look, scene.geometry
    centre = np.rint(middle_of(scene, 0)).astype(int)
    u = np.arange((centre[0] - 9) * samples, (centre[0] + 10) * samples)
    v = np.arange((centre[1] - 9) * samples, (centre[1] + 10) * samples)
    points = np.stack(np.meshgrid((u + 0.5) / samples - 0.5, (v + 0.5) / samples - 0.5), axis=-1)
    x = g.distances(
        scene.camera.undistorted_pixels(points) if any(scene.camera.distortion) else points
    )
    xi = np.clip((x[..., 0] - x[..., 1]) / -x.sum(axis=-1), -1, 1)
    cover = np.clip(0.5 - x.max(axis=-1) * samples, 0, 1)
    sharp = (look.outside + cover * (look.shading(xi) - look.outside)).astype(np.float32)
    blurred = cv2.GaussianBlur(sharp, (0, 0), look.psf_px * samples)
    small = cv2.resize(blurred, (19, 19), interpolation=cv2.INTER_AREA)[6:13, 6:13]
    ours = scene.clean[centre[1] - 3 : centre[1] + 4, centre[0] - 3 : centre[0] + 4]
    return float(np.abs(small - ours).max())
