"""Scenes of a shaft by dense supersampling, which share no formula with the fits."""

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
    fine = (np.arange(FACTOR) + 0.5) / FACTOR - 0.5
    x = (np.arange(camera.width)[:, None] + fine).ravel()
    y = (np.arange(camera.height)[:, None] + fine).ravel()
    scene = Scene(camera, np.zeros((0, 0)), edges, psf_px)
    # Rows of fine samples in strips, so that the undistortion never holds millions of points.
    grid = np.stack(np.meshgrid(x, y), axis=-1)
    points = grid
    if camera.distortion.any():
        small = np.stack(np.meshgrid(x[:: FACTOR // 2], y[:: FACTOR // 2]), axis=-1)
        moved = camera.undistorted_pixels(small) - small
        points = grid + _upsampled(moved, x, y, FACTOR // 2)
    away = points - centre
    s, d = away @ along, away @ across
    half = width_px / 2 * (1 + taper * s / half_length)
    xi = np.clip(d / half, -1, 1)
    slope = np.hypot(1, width_px / 2 * taper / half_length)
    gap = (half - np.abs(d)) / slope
    cover = np.clip(gap * FACTOR + 0.5, 0, 1)
    level = inside * (1 - limb + limb * np.sqrt(1 - xi**2) + side_light * xi)
    if gloss_at is not None:
        level = level + 170 * np.exp(-(((xi - gloss_at) / 0.15) ** 2))
    if oblique_deg is not None:
        lit = np.clip(np.cos(np.arcsin(xi) - np.radians(oblique_deg)), 0, None)
        level = 70 + 60 * lit + 90 * lit**8
    if lamp_deg is not None:
        level = 50 + 120 * np.clip(np.cos(np.arcsin(xi) - np.radians(lamp_deg)), 0, None)
    level = level + uneven * np.cos(2 * np.arcsin(xi))
    sharp = outside + (level - outside) * cover
    blurred = cv2.GaussianBlur(sharp, (0, 0), psf_px * FACTOR, borderType=cv2.BORDER_REPLICATE)
    clean = blurred.reshape(camera.height, FACTOR, camera.width, FACTOR).mean(axis=(1, 3))
    return Scene(camera, clean, scene.edges_px, psf_px)


def _upsampled(coarse: Floats, x: Floats, y: Floats, step: int) -> Floats:
    """Cubic interpolation of a smooth field from every `step`-th sample to all of them."""
    fields = [
        RectBivariateSpline(y[::step], x[::step], coarse[..., k])(y, x, grid=True) for k in range(2)
    ]
    return np.stack(fields, axis=-1)


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
    camera = scene.camera
    blurred = cv2.GaussianBlur(texture, (0, 0), scene.psf_px * FACTOR)
    return blurred.reshape(camera.height, FACTOR, camera.width, FACTOR).mean(axis=(1, 3))
