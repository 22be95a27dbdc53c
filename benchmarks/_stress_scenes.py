"""Image sequences drawn to provoke a wrong shaft: clutter, carriage, collar, trocar, a second rod.

Straight strips are drawn from their exact edges with one pixel of analytic antialiasing, so
that the truth is exact; everything else is only there to mislead.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[Any]
Image = NDArray[np.uint8]

SHADINGS = ("bright", "dark", "striped", "brushed", "glossy")


@dataclass(frozen=True)
class Strip:
    """A straight strip about a pivot: the truth of one frame."""

    pivot: Floats
    angle: float
    width: float
    taper: float
    begin: float
    end: float

    @property
    def along(self) -> Floats:
        """Unit vector from the pivot to the carriage."""
        return np.array([np.sin(self.angle), -np.cos(self.angle)])

    def edge_error_px(self, points: Floats) -> float:
        """Largest distance of points (2, m, 2) on two fitted edges from the two true ones."""
        local = points - self.pivot
        s = local @ self.along
        across = local @ np.array([self.along[1], -self.along[0]])
        half = self.width * (1 + self.taper * s) / 2
        off = [np.abs(across - side * half) for side in (-1, 1)]
        same = max(off[0][0].max(), off[1][1].max())
        return float(min(same, max(off[0][1].max(), off[1][0].max())))


def paint(image: Floats, strip: Strip, shade: Callable[[Floats, Floats], Floats]) -> None:
    """Draw a strip; `shade` gives grey from place across (−1 to 1) and along (px)."""
    height, width = image.shape
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    x -= strip.pivot[0]
    y -= strip.pivot[1]
    s = x * strip.along[0] + y * strip.along[1]
    across = x * strip.along[1] - y * strip.along[0]
    half = np.maximum(strip.width * (1 + strip.taper * s) / 2, 0.5)
    cover = np.clip(half - np.abs(across) + 0.5, 0, 1)
    cover *= np.clip(s - strip.begin + 0.5, 0, 1) * np.clip(strip.end - s + 0.5, 0, 1)
    rows, columns = np.nonzero(cover)
    there = cover[rows, columns]
    grey = shade(np.clip(across / half, -1, 1)[rows, columns], s[rows, columns])
    image[rows, columns] += there * (grey - image[rows, columns])


def shading(kind: str, rng: np.random.Generator) -> Callable[[Floats, Floats], Floats]:
    """Return grey across and along a shaft of one of the `SHADINGS`."""
    base = {"bright": 215.0, "dark": 30.0, "striped": 60.0, "brushed": 130.0, "glossy": 18.0}[kind]
    base += rng.uniform(-10, 10)
    place, wide = rng.uniform(-0.5, 0.5), rng.uniform(0.08, 0.2)
    period, noise = rng.uniform(25, 60), rng.normal(0, 8, 64)

    def grey(across: Floats, along: Floats) -> Floats:
        round_ = np.sqrt(1 - 0.9 * across**2)
        if kind == "bright":
            return base * (0.6 + 0.4 * round_)
        if kind == "dark":
            return base * (0.8 + 0.4 * round_)
        if kind == "striped":
            return base + 150 * ((along / period) % 1 < 0.4)
        if kind == "brushed":
            lanes = np.interp(across, np.linspace(-1, 1, 64), noise)
            return base + 50 * np.exp(-(((across - place) / 0.4) ** 2)) + lanes
        return base + 170 * np.exp(-(((across - place) / wide) ** 2))

    return grey


def clutter(rng: np.random.Generator, width: int, height: int) -> Floats:
    """Draw a room: soft texture, boxes, bars, discs, text and stripes."""
    coarse = rng.normal(0, 1, (height // 24 + 2, width // 24 + 2)).astype(np.float32)
    soft = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    image = (rng.uniform(60, 150) + rng.uniform(5, 30) * soft).astype(np.float32)
    unit = height / 480
    for _ in range(rng.integers(6, 30)):
        a = rng.uniform(0, 1, 2) * [width, height]
        b = a + rng.normal(0, 120, 2) * unit
        grey, thick = rng.uniform(15, 240), int(rng.uniform(2, 16) * unit)
        p, q = (tuple(int(v) for v in np.rint(c)) for c in (a, b))
        kind = rng.integers(4)
        if kind == 0:
            cv2.rectangle(image, p, q, grey, -1, cv2.LINE_AA)
        elif kind == 1:
            cv2.line(image, p, q, grey, thick, cv2.LINE_AA)
        elif kind == 2:
            cv2.circle(image, p, 3 * thick, grey, thick // 2 + 1, cv2.LINE_AA)
        else:
            letters = np.zeros(image.shape, dtype=np.uint8)
            cv2.putText(letters, "RCM 4711", p, 0, thick / 8, 255, 2, cv2.LINE_AA)
            image += letters / np.float32(255) * (grey - image)
    grain = rng.normal(0, rng.uniform(0, 6), (height, width)).astype(np.float32)
    return np.asarray(image + cv2.GaussianBlur(grain, (0, 0), 1.2))


@dataclass(frozen=True)
class Sequence:
    """The frames of one camera, the empty scene, and the true strip of every frame."""

    frames: list[Image]
    empty: Image
    truth: list[Strip]
    has_second_rod: bool


def sequence(
    seed: int,
    *,
    count: int,
    hard: bool = False,
    size: tuple[int, int] = (640, 480),
    width_px: float | None = None,
) -> Sequence:
    """Draw one sequence; everything in it follows from the seed."""
    rng = np.random.default_rng([seed, 77])
    wide, high = size
    unit = high / 480
    kind = SHADINGS[seed % len(SHADINGS)]
    width = width_px or float(np.exp(rng.uniform(np.log(9), np.log(60)))) * unit
    pivot = np.array([rng.uniform(0.35, 0.65) * wide, rng.uniform(0.75, 0.98) * high])
    room = clutter(rng, wide, high)
    grey = shading(kind, rng)
    centre, half = rng.uniform(-0.3, 0.3), rng.uniform(0.35, 0.7)
    angles = rng.permutation(np.linspace(centre - half, centre + half, count))
    second = bool(rng.uniform() < 0.5)
    rod_pivot = pivot + np.array([rng.choice([-1, 1]) * rng.uniform(40, 200), -40]) * unit
    rod_width, rod_grey = width * rng.uniform(0.35, 0.7), shading(SHADINGS[(seed + 2) % 5], rng)
    rod_angles = rng.choice([-1, 1]) * rng.uniform(0.5, 1.0) * angles + rng.uniform(-0.3, 0.3)
    rod_angles = rod_angles + rng.normal(0, 0.05, count)
    trocar = rng.uniform(1.6, 2.4) * width
    trocar_grey = float(rng.choice([40, 120, 200]))
    reach = rng.uniform(250, 420) * unit
    frames, truth = [], []
    for i in range(count):
        miss = rng.normal(0, 0.1 * width, 2)
        strip = Strip(
            pivot + miss,
            float(angles[i]),
            width * (1 + rng.normal(0, 0.002)),
            float(rng.uniform(-3e-4, 3e-4)) / unit,
            -rng.uniform(30, 120) * unit,
            reach * rng.uniform(0.8, 1.2),
        )
        image = room.copy()
        if second:
            rod = Strip(rod_pivot, float(rod_angles[i]), rod_width, 0.0, -60 * unit, 350 * unit)
            paint(image, rod, rod_grey)
        paint(image, strip, grey)
        collar = Strip(strip.pivot, strip.angle, 1.3 * width, 0, 0.45 * reach, 0.45 * reach + width)
        paint(image, collar, lambda a, _: 90 + 40 * a)
        box = 3.5 * width if width < 40 * unit else 2 * width
        carriage = Strip(strip.pivot, strip.angle, box, 0, strip.end - 5, strip.end + 1.2 * box)
        paint(image, carriage, lambda a, _: np.where(np.abs(a) < 0.7, 70.0, 150.0))
        tube = Strip(pivot, float(centre), trocar, 0, -25 * unit, 25 * unit)
        paint(image, tube, lambda a, _: trocar_grey * (1 - 0.3 * a**2))
        frames.append(photograph(image, rng, hard))
        truth.append(strip)
    tube = Strip(pivot, float(centre), trocar, 0, -25 * unit, 25 * unit)
    paint(room, tube, lambda a, _: trocar_grey * (1 - 0.3 * a**2))
    return Sequence(frames, photograph(room, rng, False), truth, second)


def photograph(image: Floats, rng: np.random.Generator, hard: bool) -> Image:
    """Blur and add noise; with a moving shadow and 3 % flicker if it is to be hard."""
    seen = cv2.GaussianBlur(image, (0, 0), 0.7)
    if hard:
        height, width = image.shape
        shadow = Strip(
            rng.uniform(0.2, 0.8, 2) * [width, height],
            float(rng.uniform(-1.5, 1.5)),
            float(rng.uniform(30, 90)) * height / 480,
            0.0,
            -9999,
            9999,
        )
        dark = np.ones_like(seen)
        paint(dark, shadow, lambda a, _: np.full_like(a, 0.7))
        soft = cv2.GaussianBlur(dark, (0, 0), 3)
        seen = seen * soft * (1 + rng.uniform(-0.03, 0.03))
    noisy = seen + rng.normal(0, 2, seen.shape)
    return np.asarray(np.clip(np.rint(noisy), 0, 255), dtype=np.uint8)
