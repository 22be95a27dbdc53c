"""Thin shafts far out of focus, straight and bent: errors, stated intervals, and what is refused.

Run with ``OMP_NUM_THREADS=1 python -m benchmarks.defocused [--scenes N] [--seed S]``. Every row has
shafts 10 to 20 px wide, 1200 px long, whose blur is least (2 to 3.5 px) somewhere along them and
grows to up to 7 px at the ends, before a background that is brighter than the shaft in one place
and may be darker in another. Offsets of both edges from the straight line nearest to the true edge
are compared at both ends and in the middle; so are the bows. Seeds are off by up to 2 px, and
apart as far as a search of blurred steps sees them.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from pivometer.cameras import Camera
from pivometer.errors import ShaftNotFoundError
from pivometer.shaft.edges import ShaftEdges, fit_edges
from pivometer.shaft.seed import ShaftSeed

Floats = NDArray[Any]

SIZE = WIDTH, HEIGHT = 900, 1200
CAMERA = Camera("a", WIDTH, HEIGHT, np.full(2, 3000.0), np.array([450.0, 600.0]), np.zeros(2))
LARGE_PX = 1.0
STRIPS = 24
"""Strips of one grey level each that a shaft's shading is drawn with."""


@dataclass(frozen=True)
class Shaft:
    """A drawn shaft: its image, the lines nearest to its edges, and what a search would see.

    Parameters
    ----------
    image
        Shape (HEIGHT, WIDTH).
    edges_px, seed_px
        Ends of the lines nearest to both true edges, and of the seed, shape (2, 2, 2).
    bow_px
        How far the middle lies to the right of the line through the ends.
    """

    image: NDArray[np.uint8]
    edges_px: Floats
    seed_px: Floats
    bow_px: float


ROWS: dict[str, dict[str, Any]] = {
    "straight": {},
    "bent by 0.5 to 3 px": {"bow_px": (0.5, 3.0)},
    "... before a level that it crosses": {"bow_px": (0.5, 3.0), "crossing": True},
    "... lit from one side": {"bow_px": (0.5, 3.0), "side": 0.15},
    "... round and matt": {"bow_px": (0.5, 3.0), "round_": True},
    "... before lines and spots": {"bow_px": (0.5, 3.0), "spots": True},
    "... with a narrow highlight": {"bow_px": (0.5, 3.0), "stripe": True},
    "all of these": {
        "bow_px": (0.5, 3.0),
        "crossing": True,
        "side": 0.15,
        "round_": True,
        "spots": True,
    },
}


def drawn(
    rng: np.random.Generator,
    *,
    bow_px: tuple[float, float] = (0.0, 0.0),
    side: float = 0.0,
    crossing: bool = False,
    round_: bool = False,
    spots: bool = False,
    stripe: bool = False,
) -> Shaft:
    """Draw a shaft that leans up to 35° from the upright.

    Parameters
    ----------
    rng
        Draws everything.
    bow_px
        Least and largest bow, to either side.
    side
        How much brighter one rim is at most than the middle, as a part.
    crossing
        Whether the background becomes darker than the shaft.
    round_
        Whether it darkens towards its rims, as a matt round one lit from the camera.
    spots
        Whether the background has blurred lines and spots.
    stripe
        Whether a narrow highlight runs along it.
    """
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
    lean, width = np.tan(rng.uniform(-0.6, 0.6)), rng.uniform(10, 20)
    slant, t = np.hypot(1, lean), (y - (HEIGHT - 1) / 2) / ((HEIGHT - 17) / 2)
    bow = rng.uniform(*bow_px) * rng.choice([-1, 1])
    middle = WIDTH / 2 + rng.uniform(-15, 15)
    across = (x - middle - lean * (y - (HEIGHT - 1) / 2)) / slant + bow * (t**2 - 1 / 3)
    half = (width + rng.uniform(-1, 1) * t) / 2
    least, focus = rng.uniform(2.0, 3.5), rng.uniform(-1, 1)
    blur = np.sqrt(least**2 + (rng.uniform(0, 3.5) * (t - focus)) ** 2)
    behind = background(rng, t, x, crossing=crossing, spots=spots)
    image = behind.copy()
    tilt = rng.uniform(-side, side)
    shine, place = rng.uniform(20, 100) * stripe, rng.uniform(-0.8, 0.8)
    bounds = np.linspace(-1, 1, STRIPS + 1)
    near = np.abs(across) < half + 6 * blur
    behind, scaled, s = behind[near], across[near] / half[near], blur[near] / half[near]
    covers = [ndtr((scaled - bound) / s) for bound in bounds]
    grey = behind * (1 - covers[0] + covers[-1])
    for before, after, xi in zip(covers, covers[1:], (bounds[1:] + bounds[:-1]) / 2, strict=False):
        level = 90.0 * (1 + tilt * xi) * (0.5 + 0.5 * np.sqrt(1 - xi * xi) if round_ else 1.0)
        level += shine * np.exp(-0.5 * ((xi - place) / 0.1) ** 2)
        grey = grey + level * (before - after)
    image[near] = grey
    image += rng.uniform(2, 5) * rng.standard_normal(image.shape)
    ends = np.array([8.0, HEIGHT - 9.0])
    centre = middle + lean * (ends - (HEIGHT - 1) / 2)
    reach = np.array([half[0, 0], half[-1, 0]]) * slant
    apart = np.array([blur[0, 0], blur[-1, 0]]) * slant / 3
    edges = np.stack([np.stack([centre + k * reach, ends], axis=1) for k in (-1, 1)])
    seed = np.stack([np.stack([centre + k * (reach + apart), ends], axis=1) for k in (-1, 1)])
    seed[..., 0] += rng.uniform(-2, 2, (2, 2))
    shown = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    return Shaft(shown, edges, seed, bow)


def background(
    rng: np.random.Generator, t: Floats, x: Floats, *, crossing: bool, spots: bool
) -> Floats:
    """Return what stands behind the shaft."""
    grey = rng.uniform(150, 180) + rng.uniform(-0.03, 0.03) * (x - WIDTH / 2)
    if crossing:
        place, wide = rng.uniform(-0.3, 0.3), rng.uniform(0.1, 0.4)
        grey = 45 + (grey - 45) * ndtr((t - place) / wide)
    if spots:
        texture = np.zeros(t.shape, dtype=np.float32)
        for _ in range(60):
            ends = rng.uniform(0, [WIDTH, HEIGHT], (2, 2)).astype(int)
            cv2.line(texture, ends[0].tolist(), ends[1].tolist(), float(rng.uniform(-60, 20)), 3)
        grey = grey + cv2.GaussianBlur(texture, (0, 0), float(rng.uniform(1.5, 4)))
    return np.asarray(grey, dtype=np.float64)


def scores(shaft: Shaft, found: ShaftEdges) -> tuple[Floats, Floats]:
    """Return errors (px) of both edges at an end, the middle and the other end, and their sigmas.

    Both of shape (2, 3).
    """
    error, sigma = np.zeros((2, 2, 3))
    for edge, (start, end) in enumerate(shaft.edges_px):
        normal = found.normals[edge] / np.hypot(*found.normals[edge, :2])
        points = start + np.array([[0.0], [0.5], [1.0]]) * (end - start)
        rays = np.ones((3, 3))
        rays[:, :2] = (points - CAMERA.principal_point_px) / CAMERA.focal_px
        error[edge] = -rays @ normal * CAMERA.focal_px[0]
        own = slice(3 * edge, 3 * edge + 3)
        scale = CAMERA.focal_px[0] / np.hypot(*found.normals[edge, :2])
        covariance = found.normals_covariance[own, own]
        sigma[edge] = np.sqrt(np.einsum("ij,jk,ik->i", rays, covariance, rays)) * scale
    return error, sigma


def bow_score(shaft: Shaft, found: ShaftEdges) -> tuple[float, float]:
    """Return the error of the bow over the length that was seen, and its sigma, px."""
    # Edge 0 is the left one, whose outward is to the left.
    bow = float(found.curvature_px[1] - found.curvature_px[0]) / 2
    seen = np.ptp(found.points_px[:, :, 1]) / np.ptp(shaft.edges_px[:, :, 1])
    return bow - shaft.bow_px * float(seen) ** 2, float(np.hypot(*found.curvature_sigma_px)) / 2


def measured(name: str, looks: dict[str, Any], scenes: int, seed: int) -> str:
    """Return a row."""
    rng = np.random.default_rng(seed)
    errors, bows, bent, times, seen = [], [], 0, [], 0
    for _ in range(scenes):
        shaft = drawn(rng, **looks)
        begin = time.process_time()
        try:
            found = fit_edges(shaft.image, CAMERA, ShaftSeed(shaft.seed_px))
        except ShaftNotFoundError:
            continue
        finally:
            times.append(time.process_time() - begin)
        errors.append(scores(shaft, found))
        bows.append(bow_score(shaft, found))
        bent += any(warning.startswith("bent") for warning in found.warnings)
        seen += 1
    error, sigma = np.moveaxis(np.array(errors), 1, 0)
    off, u = np.array(bows).T
    large = int((np.abs(error).max(axis=(1, 2)) > LARGE_PX).sum())
    return (
        f"{name:36}{seen:4}/{scenes:<4}{rms(error):8.3f}{rms(sigma):8.3f}"
        f"{covered(error, sigma):6.0f} %{large:8}{rms(off):8.3f}{rms(u):8.3f}"
        f"{covered(off, u):6.0f} %{bent:8}{1e3 * np.median(times):8.0f}"
    )


def rms(values: Floats) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def covered(error: Floats, sigma: Floats) -> float:
    """Return how many errors the stated 95 % intervals hold, per cent."""
    return 100 * float(np.mean(np.abs(error) < 1.96 * sigma))


def main() -> None:
    """Print one row for each kind of shaft."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="")
    options = parser.parse_args()
    print(f"{'':45}{'edges, px':>9}{'':25}{'bow, px':>9}")
    print(
        f"{'':36}{'found':>9}{'rms':>8}{'stated':>8}{'held':>8}{'> 1 px':>8}"
        f"{'rms':>8}{'stated':>8}{'held':>8}{'warned':>8}{'CPU ms':>8}"
    )
    for name, looks in ROWS.items():
        if options.only in name:
            print(measured(name, looks, options.scenes, options.seed), flush=True)


if __name__ == "__main__":
    main()
