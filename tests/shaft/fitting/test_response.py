"""What a sensor that is not linear does to edges, and that it is seen."""

import numpy as np
import pytest
from scipy.special import ndtr

from pivometer.cameras import Camera
from pivometer.shaft.edges import fit_edges
from pivometer.shaft.seed import ShaftSeed

CAMERA = Camera("left", 320, 240, [400.0, 400.0], [160.0, 120.0], [0.0, 0.0])
WIDTH, TILT, BLUR, NOISE = 40.0, 0.12, 0.85, 1.5


def linear(grey):
    return grey


def gamma(grey):
    return 255 * (grey / 255) ** (1 / 2.2)


def shaft(rng, response, *, shaft=180.0, behind=20.0):
    """A flat shaft as a sensor of this response records it; the image and the edges' ends."""
    y, x = np.mgrid[0:240, 0:320].astype(float)
    middle = 158.3 + TILT * (y - 120)
    across = (x - middle) / np.hypot(1, TILT)
    cover = ndtr((across + WIDTH / 2) / BLUR) - ndtr((across - WIDTH / 2) / BLUR)
    image = response(behind + cover * (shaft - behind)) + NOISE * rng.standard_normal(y.shape)
    half = WIDTH / 2 * np.hypot(1, TILT)
    ends = [[[158.3 + TILT * (v - 120) + s * half, v] for v in (4.0, 235.0)] for s in (-1, 1)]
    return np.clip(np.rint(image), 0, 255).astype(np.uint8), np.array(ends)


def centre_sigma_px(found):
    """The stated sigma of the line midway between the edges, at their middle."""
    rows = np.zeros((2, 6))
    for edge, points in enumerate(found.points_px):
        ray = np.append((points.mean(axis=0) - CAMERA.principal_point_px) / CAMERA.focal_px, 1.0)
        steep = np.linalg.norm(found.normals[edge][:2])
        rows[edge, 3 * edge : 3 * edge + 3] = ray * CAMERA.focal_px[0] / steep
    middle = (rows[0] - rows[1]) / 2
    return np.sqrt(middle @ found.normals_covariance @ middle)


@pytest.mark.parametrize(("inside", "behind", "way"), [(180, 20, "outward"), (20, 180, "inward")])
def test_gamma_is_named_and_stated_as_uncertainty_of_the_width_only(inside, behind, way):
    rng = np.random.default_rng(2)
    image, ends = shaft(rng, gamma, shaft=inside, behind=behind)
    found = fit_edges(image, CAMERA, ShaftSeed(ends))
    (warning,) = (text for text in found.warnings if text.startswith("not linear"))
    assert way in warning
    wrong = found.width_px - WIDTH
    # A second-order response explains most of gamma 2.2, so the stated shift is nearly the real.
    assert abs(wrong) > 0.4
    assert found.sigma_px == pytest.approx([abs(wrong) / 2] * 2, rel=0.25)
    middle = found.points_px.mean(axis=(0, 1))
    off = (middle[0] - 158.3 - TILT * (middle[1] - 120)) / np.hypot(1, TILT)
    assert abs(off) < 0.005
    assert centre_sigma_px(found) < 0.005


def test_a_linear_sensor_is_not_accused():
    rng = np.random.default_rng(2)
    # Two edges over 5 sigma with the same sign: once in 10¹² images of noise.
    for _ in range(8):
        image, ends = shaft(rng, linear)
        found = fit_edges(image, CAMERA, ShaftSeed(ends))
        assert not found.warnings
        assert found.sigma_px.max() < 0.005
