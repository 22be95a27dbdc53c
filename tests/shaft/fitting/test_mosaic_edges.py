"""Edges in raw mosaics of colour filters are no worse than in grey pictures."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from pivometer.cameras import Camera
from pivometer.shaft.edges import ShaftEdges, fit_edges
from pivometer.shaft.seed import ShaftSeed

SIZE = 320, 240
CAMERA = Camera("left", *SIZE, [400, 400], [159.5, 119.5], [0, 0])
WIDTH_PX, BLUR_PX, NOISE = 26.0, 0.8, 2.0
DARK, BRIGHT = 30.0, 180.0
STEP_PX = 1 / 32

FILTERS = {
    "gains": ((1.0, 0.9, 0.9, 0.7), (1.0, 0.9, 0.9, 0.7)),
    "yellow on grey": ((1.0, 1.0, 1.0, 1.0), (1.0, 0.88, 0.88, 0.62)),
    "two colours": ((1.3, 0.6, 0.6, 0.5), (0.6, 1.0, 1.0, 0.8)),
}
"""What each filter passes of the dark and of the bright thing, row by row."""


def scene(rng: np.random.Generator) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the bright part of every pixel of a round shaft, and its edges' ends (2, 2, 2)."""
    angle = np.radians(rng.uniform(65, 85))
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-along[1], along[0]])
    centre = np.array(SIZE) / 2 + rng.uniform(-5, 5, 2)
    s = np.arange(-200, 200, STEP_PX)
    round_part = np.sqrt(np.clip(1 - (2 * s / WIDTH_PX) ** 2, 0, None))
    profile = np.where(np.abs(s) < WIDTH_PX / 2, 0.6 + 0.4 * round_part, 0)
    blurred = cv2.GaussianBlur(profile[None], (0, 0), BLUR_PX / STEP_PX)[0]
    x, y = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    part = np.interp((x - centre[0]) * across[0] + (y - centre[1]) * across[1], s, blurred)
    sides = np.array([-0.5, 0.5])[:, None, None] * WIDTH_PX * across
    return part, centre + sides + np.array([-110.0, 110.0])[:, None] * along


def pictured(
    part: NDArray[np.float64], filters: str, rng: np.random.Generator
) -> NDArray[np.uint8]:
    """Return an 8-bit picture through filters; "" for none."""
    dark, bright = FILTERS.get(filters, ((1.0,) * 4, (1.0,) * 4))
    image = np.empty_like(part)
    for place, (low, high) in enumerate(zip(dark, bright, strict=True)):
        at = slice(place // 2, None, 2), slice(place % 2, None, 2)
        image[at] = low * DARK + (high * BRIGHT - low * DARK) * part[at]
    return np.clip(np.rint(image + rng.normal(0, NOISE, part.shape)), 0, 255).astype(np.uint8)


def offsets_px(edges: ShaftEdges, truth: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how far both edges are off at their middle."""
    off = []
    for points, (start, end) in zip(edges.points_px, truth, strict=True):
        normal = np.array([start[1] - end[1], end[0] - start[0]]) / np.hypot(*(end - start))
        off.append((points.mean(axis=0) - start) @ normal)
    return np.array(off)


@pytest.mark.parametrize("filters", FILTERS)
def test_an_edge_behind_colour_filters_is_as_good_as_without(filters):
    rng = np.random.default_rng(3)
    grey, filtered = [], []
    for _ in range(12):
        part, truth = scene(rng)
        seed = ShaftSeed(truth + rng.uniform(-1, 1, 2))
        grey.append(offsets_px(fit_edges(pictured(part, "", rng), CAMERA, seed), truth))
        edges = fit_edges(pictured(part, filters, rng), CAMERA, seed)
        assert any("mosaic" in warning for warning in edges.warnings)
        filtered.append(offsets_px(edges, truth))
    # A filter's noise grows as its contrast falls. Of rms values from 24 edges each, one is 1.95
    # times the other once in a thousand (F test).
    low, high = (np.array(side) for side in FILTERS[filters])
    noisier = np.sqrt(np.mean(((BRIGHT - DARK) / (high * BRIGHT - low * DARK)) ** 2))
    assert np.sqrt(np.mean(np.square(filtered)) / np.mean(np.square(grey))) < 1.95 * noisier


def test_saturated_pixels_of_a_mosaic_are_told():
    rng = np.random.default_rng(0)
    part, truth = scene(rng)
    bright = np.clip(pictured(part, "gains", rng).astype(np.float64) * 2.0, 0, 255)
    edges = fit_edges(bright.astype(np.uint8), CAMERA, ShaftSeed(truth))
    assert edges.saturated_part.min() > 0.05
    assert any("saturated" in warning for warning in edges.warnings)
