"""Mosaics of colour filters are told from other pictures, and evened where two colours meet."""

import cv2
import numpy as np
import pytest

from pivometer.cameras.mosaic import evened, is_mosaic, luminance

DARK = np.array([[39.0, 18.0], [18.0, 15.0]])
BRIGHT = np.array([[108.0, 180.0], [180.0, 144.0]])
"""Grey levels of two things behind four filters."""


def halves(noise: float) -> np.ndarray:
    """Return a picture whose left half is dark and whose right one is bright."""
    picture = np.concatenate([np.tile(DARK, (48, 24)), np.tile(BRIGHT, (48, 24))], axis=1)
    return picture + np.random.default_rng(0).normal(0, noise, picture.shape)


def test_two_colours_become_two_grey_levels():
    apart = np.abs(evened(halves(0)) - luminance(halves(0)))
    beside = np.r_[32:46, 50:64]  # the mean is blurred where they meet
    assert apart[16:80, beside].max() < 0.02 * (BRIGHT - DARK).mean()


@pytest.mark.parametrize("depth", [np.uint8, np.uint16])
def test_pictures_without_filters_are_no_mosaics(depth):
    rng = np.random.default_rng(0)
    gain = np.iinfo(depth).max / 255
    ramp = np.linspace(20, 220, 320) * np.ones((240, 1))
    board = np.where((np.indices((240, 320)) // 15).sum(axis=0) % 2, 200.0, 30.0)
    texture = cv2.GaussianBlur(rng.uniform(0, 255, (240, 320)), (0, 0), 0.8)
    for picture in (ramp, board, texture):
        noisy = np.clip((picture + rng.normal(0, 2, picture.shape)) * gain, 0, 255 * gain)
        assert not is_mosaic(noisy.astype(depth))


def test_a_mosaic_is_found_in_noise():
    assert is_mosaic(halves(5))
