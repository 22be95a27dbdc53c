"""The profile across an edge shows the grey levels, and a misplaced edge as such."""

import numpy as np
import pytest
from scipy.special import ndtr

from pivometer.cameras import Camera
from pivometer.shaft.across import BILINEAR_PX, profiles_across
from pivometer.shaft.edges import ShaftEdges

CAMERA = Camera("left", 320, 240, [800, 800], [160, 120], [-0.2, 0.05])
BLUR_PX, WIDTH_PX = 0.8, 24.0


def scene(shift_px=0.0):
    """A leaning bright shaft in a lens's picture, and its edges, both shifted to one side."""
    x, y = np.meshgrid(np.arange(320.0), np.arange(240.0))
    straight = CAMERA.undistorted_pixels(np.stack([x, y], axis=-1))
    across = (straight - [160, 120]) @ [0.8, 0.6]
    image = 40 + 100 * (
        ndtr((across + WIDTH_PX / 2) / BLUR_PX) - ndtr((across - WIDTH_PX / 2) / BLUR_PX)
    )
    along = np.linspace(-80, 80, 9)[:, None] * [-0.6, 0.8] + [160, 120]
    lines = np.stack(
        [along + (s * WIDTH_PX / 2 + shift_px) * np.array([0.8, 0.6]) for s in (-1, 1)]
    )
    points = CAMERA.pixels_from_normalized((lines - CAMERA.principal_point_px) / CAMERA.focal_px)
    edges = ShaftEdges(
        "left", points, np.eye(3)[:2], np.eye(6), [0.01] * 2, [1e-4] * 2, WIDTH_PX, [100.0] * 2,
        BLUR_PX, 0.1, [1.0, 1.0],
    )  # fmt: skip
    return image, edges


def test_levels_are_those_of_the_image_and_the_step_fits_them():
    image, edges = scene()
    found = profiles_across(image, edges, CAMERA)
    truth = 40 + 100 * ndtr(-found.distance_px / np.hypot(BLUR_PX, BILINEAR_PX))
    assert found.distance_px[0] == pytest.approx(-7.5)
    # Interpolation changes the steepest part by a few levels of 100, as the pixels fall.
    assert np.abs(found.grey - truth).max() < 4
    assert np.abs(found.grey - found.fitted).max() < 4


def test_an_edge_beside_the_step_does_not_fit():
    image, edges = scene(shift_px=1.0)
    found = profiles_across(image, edges, CAMERA)
    assert np.abs(found.grey - found.fitted).max() > 15


def test_near_the_border_the_last_pixels_are_repeated():
    image, edges = scene()
    found = profiles_across(image[:, :172], edges, CAMERA)
    assert np.isfinite(found.grey).all()
