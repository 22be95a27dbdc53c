"""Scenes of a shaft by dense supersampling, which share no formula with the fits."""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.interpolate import RectBivariateSpline

from pivometer._arrays import Floats
from pivometer.cameras import Camera

FACTOR = 10
"""Samples per pixel and axis."""

NOISE = 2.0


@dataclass(frozen=True)
class Scene:
    camera: Camera
    clean: Floats
    edges_px: Floats  # (2, 2, 2) ends of both edges, undistorted px
    psf_px: float

    @property
    def seed_px(self) -> Floats:
        """Ends of both edges in the raw image, inside it."""
        lever = np.linspace(0, 1, 2001)[:, None]
        seeds = []
        for start, end in self.edges_px:
            points = start + lever * (end - start)
            raw = self.camera.pixels_from_normalized(
                (points - self.camera.principal_point_px) / self.camera.focal_px
            )
            limit = np.array([self.camera.width - 1, self.camera.height - 1])
            inside = raw[((raw >= 0) & (raw <= limit)).all(axis=1)]
            seeds.append(inside[[0, -1]])
        return np.array(seeds)

    def with_noise(self, sigma: float, rng: np.random.Generator) -> Floats:
        return self.clean + rng.normal(0, sigma, self.clean.shape)

    def offsets_px(self, points_px: Floats) -> Floats:
        """Signed distances of raw points (2, m, 2) from the true edges, outward, undistorted px."""
        points = self.camera.undistorted_pixels(points_px)
        inside = self.edges_px.mean(axis=(0, 1))
        offsets = []
        for (start, end), own in zip(self.edges_px, points, strict=True):
            normal = np.array([start[1] - end[1], end[0] - start[0]])
            normal /= np.hypot(*normal)
            normal *= -np.sign(normal @ (inside - start))
            offsets.append((own - start) @ normal)
        return np.array(offsets)


def camera_of(
    width: int = 320, height: int = 240, beta: tuple[float, float] = (0.0, 0.0)
) -> Camera:
    middle = [(width - 1) / 2 + 0.3, (height - 1) / 2 - 0.2]
    return Camera("left", width, height, [1.2 * width, 1.21 * width], middle, list(beta))


def render(
    camera: Camera,
    *,
    angle_deg: float = 83.0,
    width_px: float = 30.0,
    taper: float = 0.02,
    offset_px: float = 0.37,
    inside: float = 180.0,
    outside: float | Floats = 20.0,
    limb: float = 0.0,
    side_light: float = 0.0,
    gloss_at: float | None = None,
    oblique_deg: float | None = None,
    lamp_deg: float | None = None,
    uneven: float = 0.0,
    psf_px: float = 0.7,
) -> Scene:
    """Render a shaft that crosses the whole image.

    `outside` may be a picture of FACTOR × FACTOR samples a pixel. `limb` is the part of the inside
    level that falls off towards the edges as √(1 − ξ²), and `side_light` the part that changes
    linearly from one edge to the other. `gloss_at` is the ξ of a narrow highlight of 170 levels;
    `oblique_deg` is where around it light falls on brushed metal from, in place of all other light,
    and `lamp_deg` where the only lamp of a matt one stands. `uneven` is the height of a second
    harmonic around the shaft, grey levels.
    """
    angle = np.radians(angle_deg)
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-along[1], along[0]])
    centre = camera.principal_point_px + offset_px * across
    half_length = 0.6 * np.hypot(camera.width, camera.height)
    halves = width_px / 2 * np.array([1 - taper, 1 + taper])
    edges = np.array(
        [
            [
                centre + t * half_length * along + side * h * across
                for t, h in zip((-1, 1), halves, strict=True)
            ]
            for side in (-1, 1)
        ]
    )
    textured = isinstance(outside, np.ndarray)
    clean = (
        _pictured(outside, psf_px)
        if textured
        else np.full((camera.height, camera.width), float(outside))
    )
    for tile in _tiles(camera, psf_px):
        if abs((tile.middle_px - centre) @ across) > halves.max() + tile.reach_px:
            continue
        x, y = tile.away_px(centre)
        s, d = x * along[0] + y * along[1], x * across[0] + y * across[1]
        half = width_px / 2 * (1 + taper * s / half_length)
        xi = np.clip(d / half, -1, 1)
        slope = np.hypot(1, width_px / 2 * taper / half_length)
        gap = (half - np.abs(d)) / slope
        cover = np.clip(gap * FACTOR + 0.5, 0, 1)
        ahead = np.sqrt(1 - xi**2)  # xi and this are sine and cosine of the place around the axis
        level = inside * (1 - limb + limb * ahead + side_light * xi)
        if gloss_at is not None:
            level = level + 170 * np.exp(-(((xi - gloss_at) / 0.15) ** 2))
        if oblique_deg is not None:
            lit = _facing(xi, ahead, oblique_deg)
            level = 70 + 60 * lit + 90 * lit**8
        if lamp_deg is not None:
            level = 50 + 120 * _facing(xi, ahead, lamp_deg)
        level = level + uneven * (1 - 2 * xi**2)
        behind = outside[np.ix_(*tile.samples)] if textured else outside
        clean[tile.pixels] += tile.exposed((level - behind) * cover)
    return Scene(camera, clean, edges, psf_px)


def _facing(sine: Floats, cosine: Floats, lamp_deg: float) -> Floats:
    lamp = np.radians(lamp_deg)
    return np.clip(cosine * np.cos(lamp) + sine * np.sin(lamp), 0, None)


@dataclass(frozen=True)
class _Tile:
    """Part of an image and the samples it is made of."""

    camera: Camera
    pixels: tuple[slice, slice]
    samples: tuple[Floats, Floats]  # rows and columns of samples, the outermost repeated
    blurs: tuple[Floats, Floats]  # weights of rows and of columns, (pixels, samples)

    @property
    def middle_px(self) -> Floats:
        rows, columns = (samples[[0, -1]].mean() for samples in self.samples)
        return self.camera.undistorted_pixels(_sample_px(np.array([columns, rows])))

    @property
    def reach_px(self) -> float:
        """Farthest sample from the middle, by half more for what a lens does."""
        return 0.75 * np.hypot(*(len(samples) for samples in self.samples)) / FACTOR

    def away_px(self, point_px: Floats) -> tuple[Floats, Floats]:
        """Return what all samples are away from a point, undistorted px, (rows, columns) each."""
        y, x = (_sample_px(samples) for samples in self.samples)
        if not self.camera.distortion.any():
            return x - point_px[0], (y - point_px[1])[:, None]
        knots = [np.linspace(at[0], at[-1], len(at) // (FACTOR // 2)) for at in (x, y)]
        coarse = np.stack(np.meshgrid(*knots), axis=-1)
        moved = self.camera.undistorted_pixels(coarse) - point_px
        return tuple(RectBivariateSpline(*knots[::-1], moved[..., k])(y, x) for k in range(2))

    def exposed(self, sharp: Floats) -> Floats:
        down, right = self.blurs
        return down @ sharp @ right.T


def _tiles(camera: Camera, psf_px: float) -> Iterator[_Tile]:
    across = list(_spans(camera.width, psf_px))
    for rows, rows_of, down in _spans(camera.height, psf_px):
        for columns, columns_of, right in across:
            yield _Tile(camera, (rows, columns), (rows_of, columns_of), (down, right))


def _sample_px(samples: Floats) -> Floats:
    return (samples + 0.5) / FACTOR - 0.5


def _spans(size: int, psf_px: float, length: int = 24) -> Iterator[tuple[slice, Floats, Floats]]:
    """Yield pixels, the samples they are made of, and with which weights."""
    reach = int(np.ceil(5 * psf_px * FACTOR))
    kernel = cv2.getGaussianKernel(2 * reach + 1, psf_px * FACTOR).ravel()
    pixel = np.convolve(kernel, np.full(FACTOR, 1 / FACTOR))
    for first in range(0, size, length):
        last = min(first + length, size)
        weights = np.zeros((last - first, (last - first) * FACTOR + 2 * reach))
        for i, row in enumerate(weights):
            row[i * FACTOR : i * FACTOR + len(pixel)] = pixel
        samples = np.arange(first * FACTOR - reach, last * FACTOR + reach)
        yield slice(first, last), np.clip(samples, 0, size * FACTOR - 1), weights


def clutter(camera, rng):
    """Return sharp texture, FACTOR × FACTOR samples a pixel."""
    texture = np.full((camera.height * FACTOR, camera.width * FACTOR), 80.0)
    for _ in range(300):
        place = rng.uniform(0, [camera.width * FACTOR, camera.height * FACTOR]).astype(int)
        axes = rng.uniform(3 * FACTOR, 20 * FACTOR, 2).astype(int)
        cv2.ellipse(texture, place.tolist(), axes.tolist(), 30, 0, 360, rng.uniform(30, 130), -1)
    return texture


def pictured(texture: Floats, scene: Scene) -> Floats:
    """Return what a scene's camera sees of texture without the shaft."""
    return _pictured(texture, scene.psf_px)


def _pictured(texture: Floats, psf_px: float) -> Floats:
    height, width = (size // FACTOR for size in texture.shape)
    blurred = cv2.GaussianBlur(texture, (0, 0), psf_px * FACTOR, borderType=cv2.BORDER_REPLICATE)
    return blurred.reshape(height, FACTOR, width, FACTOR).mean(axis=(1, 3))
