"""Two things that turn: the wider is the shaft; two that are alike are refused."""

from dataclasses import fields

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from pivometer.shaft.detection import SeedRejection, learn_shaft
from pivometer.shaft.finding.motion import PairTable
from pivometer.shaft.finding.rivals import turning_things
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


def turning(
    pivot_px: tuple[float, float], width_px: float, length_px: float, frames: NDArray[np.intp]
) -> PairTable:
    """Return the pairs of edges of one thing that turns about a pivot, one a frame."""
    angles = 0.1 + 0.08 * frames + 0.001 * width_px
    normals = np.column_stack([np.cos(angles), np.sin(angles)])
    along = np.column_stack([-normals[:, 1], normals[:, 0]])
    same = np.ones(len(frames))
    return PairTable(
        at=frames,
        which=np.zeros(len(frames), dtype=np.intp),
        normal=normals,
        offset=normals @ np.array(pivot_px),
        middle=np.array(pivot_px) + 100.0 * along,
        width=width_px * same,
        taper=0.0 * same,
        run=length_px * same,
        length=length_px * same,
        weight=length_px * same,
    )


def test_what_few_frames_show_by_chance_hides_nothing_that_many_show() -> None:
    parts = [
        turning((150.0, 180.0), 5.0, 380.0, np.arange(12)),
        turning((30.0, 200.0), 9.0, 60.0, np.arange(12)),
        turning((80.0, 190.0), 120.0, 300.0, np.array([1, 4, 9])),
    ]
    columns = [np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(PairTable)]
    order = np.argsort(columns[0], kind="stable")
    found = turning_things(PairTable(*(column[order] for column in columns)))
    assert [thing.motion.width_px for thing in found] == pytest.approx([5.0, 9.0])
