"""Two things that turn: the wider is the shaft; two that are alike are refused."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from pivometer.shaft.detection import SeedRejection, learn_shaft
from pivometer.shaft.seed import ShaftSeed

SHAFT, OTHER = (100, 230), (230, 225)


def frames(width: int, other: int) -> list[NDArray[np.uint8]]:
    """Draw a shaft about SHAFT and another rod about OTHER, which turn differently."""
    drawn = []
    for top, there in zip((20, 60, 90, 120, 40, 75), (260, 180, 300, 215, 240, 280), strict=True):
        image = np.full((240, 320), 20, dtype=np.uint8)
        cv2.line(image, OTHER, (there, 0), 150, other, cv2.LINE_AA)
        cv2.line(image, SHAFT, (top, 20), 220, width, cv2.LINE_AA)
        drawn.append(image)
    return drawn


@pytest.mark.parametrize(("width", "other"), [(16, 8), (8, 16)])
def test_the_wider_is_the_shaft_and_a_warning_says_so(width: int, other: int) -> None:
    images = frames(width, other)
    finder = learn_shaft(images)
    assert finder.warning is not None
    assert "the wider is taken for the shaft: 1" in finder.warning
    pivot = np.array(SHAFT if width > other else OTHER, dtype=float)
    for k, image in enumerate(images):
        seed = finder.find(image, sample=k)
        assert isinstance(seed, ShaftSeed)
        one, two = seed.edges_px.mean(axis=0)
        across = (two - one)[::-1] * [1, -1] / np.hypot(*(two - one))
        assert abs((pivot - one) @ across) < 2.0


def test_two_of_one_width_are_refused_and_both_are_named() -> None:
    images = frames(12, 12)
    found = learn_shaft(images).find(images[0])
    assert isinstance(found, SeedRejection)
    assert "two things turn in these images and either may be it" in found.reason
    assert found.reason.count("px wide about") == 2


def test_one_thing_alone_needs_no_warning() -> None:
    assert learn_shaft(frames(14, 1)).warning is None
