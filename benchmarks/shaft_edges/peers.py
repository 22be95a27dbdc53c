"""What others offer for straight edges, each told where to look to 2 px as Pivometer is.

All return for each edge a point and a unit direction in undistorted px, shape (2, 2), or None.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.shaft_edges.scenes import Scene

Floats = NDArray[Any]
Lines = list[Floats | None]
REACH_PX = 4.0


def _beside(points: Floats, seed: Floats, reach: float = REACH_PX) -> Floats:
    """Return the points within reach of the segment between two seeds."""
    along = seed[1] - seed[0]
    length = np.hypot(*along)
    along = along / length
    away = points - seed[0]
    across = np.abs(away @ np.array([-along[1], along[0]]))
    inside = (across < reach) & (away @ along > 0) & (away @ along < length)
    return np.asarray(points[inside])


def _line(points: Floats, scene: Scene) -> Floats | None:
    """Fit a line to raw edge points, undistorted first, with Huber's weights."""
    if len(points) < 20:
        return None
    undistorted = scene.camera.undistorted_pixels(points).astype(np.float32)
    dx, dy, x, y = cv2.fitLine(undistorted, cv2.DIST_HUBER, 0, 1e-4, 1e-6).ravel().astype(float)
    return np.array([[x, y], [dx, dy]])


def canny(scene: Scene) -> Lines:
    """Canny's edge pixels and a line through them."""
    blurred = cv2.GaussianBlur(scene.image, (0, 0), 1.0)
    rows, columns = np.nonzero(cv2.Canny(blurred, 30, 90))
    points = np.stack([columns, rows], axis=-1).astype(np.float64)
    return [_line(_beside(points, seed), scene) for seed in scene.seed_px]


def lsd(scene: Scene) -> Lines:
    """OpenCV's line segment detector: all segments along the seed, by length."""
    found: Any = cv2.createLineSegmentDetector(cv2.LSD_REFINE_STD).detect(scene.image)[0]
    lines: Lines = []
    for seed in scene.seed_px:
        parts = []
        for a, b in [] if found is None else found.reshape(-1, 2, 2).astype(np.float64):
            points = a + np.linspace(0, 1, max(2, int(np.hypot(*(b - a)))))[:, None] * (b - a)
            near = _beside(points, seed)
            if len(near) > 0.8 * len(points) and len(points) > 10:
                parts.append(near)
        lines.append(_line(np.concatenate(parts), scene) if parts else None)
    return lines


def devernay(scene: Scene) -> Lines:
    """Gradient maxima along the gradient's main axis to a part of a pixel, by a parabola.

    Devernay, "A non-maxima suppression method for edge detection with sub-pixel accuracy", INRIA
    RR-2724 (1995).
    """
    image = cv2.GaussianBlur(scene.image.astype(np.float32), (0, 0), 1.0)
    gx = cv2.Sobel(image, cv2.CV_32F, 1, 0, ksize=1)
    gy = cv2.Sobel(image, cv2.CV_32F, 0, 1, ksize=1)
    g = np.hypot(gx, gy)
    found = []
    for axis, steep in ((1, np.abs(gx) >= np.abs(gy)), (0, np.abs(gx) < np.abs(gy))):
        before, after = np.roll(g, 1, axis), np.roll(g, -1, axis)
        top = steep & (g > before) & (g >= after) & (g > 4.0)
        top[[0, -1]] = top[:, [0, -1]] = False
        rows, columns = np.nonzero(top)
        a, b, c = before[top], g[top], after[top]
        shift = 0.5 * (a - c) / (a - 2 * b + c)
        points = np.stack([columns, rows], axis=-1).astype(np.float64)
        points[:, 1 - axis] += shift
        found.append(points)
    points = np.concatenate(found)
    return [_line(_beside(points, seed), scene) for seed in scene.seed_px]


def erf_profiles(scene: Scene) -> Lines:
    """Fit an error function to one resampled profile a pixel, then a line."""
    lines: Lines = []
    for seed in scene.seed_px:
        along = seed[1] - seed[0]
        length = np.hypot(*along)
        normal = np.array([-along[1], along[0]]) / length
        stations = seed[0] + np.linspace(0.01, 0.99, int(length))[:, None] * along
        x = np.arange(-8, 8.1, 0.5)
        points = stations[:, None] + x[:, None] * normal
        u, v = np.moveaxis(points.astype(np.float32), -1, 0)
        grey = cv2.remap(scene.image.astype(np.float32), u, v, cv2.INTER_CUBIC).astype(np.float64)
        centre, good = _fit_erf(grey, x)
        lines.append(_line((stations + centre[:, None] * normal)[good], scene))
    return lines


def _fit_erf(grey: Floats, x: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Fit a + b Φ((x − c) / s) to many profiles at once by Gauss–Newton."""
    from scipy.special import ndtr

    steps = np.abs(grey[:, 4:] - grey[:, :-4])
    c = x[2:-2][steps.argmax(axis=1)]
    s = np.full(len(grey), 1.0)
    for _ in range(12):
        z = (x - c[:, None]) / s[:, None]
        bell = np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi)
        basis = np.stack([np.ones_like(z), ndtr(z)], axis=-1)
        gram = np.swapaxes(basis, 1, 2) @ basis + 1e-9 * np.eye(2)
        levels = np.linalg.solve(gram, np.swapaxes(basis, 1, 2) @ grey[..., None])
        residual = grey - (basis @ levels)[..., 0]
        b = levels[:, 1]
        J = np.stack([-b * bell / s[:, None], -b * bell * z / s[:, None]], axis=-1)
        full = np.concatenate([basis, J], axis=-1)
        normal = np.swapaxes(full, 1, 2) @ full
        normal = normal + 1e-6 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(4)
        step = np.linalg.solve(normal, np.swapaxes(full, 1, 2) @ residual[..., None])[:, 2:, 0]
        c = c + np.clip(step[:, 0], -0.5, 0.5)
        s = np.clip(s + np.clip(step[:, 1], -0.2, 0.2), 0.3, 6)
    step = np.abs(b[:, 0])
    good = (np.abs(c) < 6) & (step > 0.3 * np.median(step))
    return c, good


PEERS = {"Canny": canny, "LSD": lsd, "Devernay": devernay, "erf": erf_profiles}
