"""A shaft that only shifts: one pair of edges outranks all others in every frame."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from pivometer.shaft.detection import SeedRejection, find_shaft, learn_shaft
from pivometer.shaft.seed import ShaftSeed


def shifted(places: tuple[int, ...], *, second: bool) -> list[NDArray[np.uint8]]:
    """Draw a dark rod at each place, and another that shifts otherwise if there is to be one."""
    frames = []
    for k, x in enumerate(places):
        image = np.full((240, 320), 150, dtype=np.uint8)
        cv2.line(image, (x, 200), (x + 60, 0), 30, 10, cv2.LINE_AA)
        if second:
            cv2.line(image, (290 - 20 * (k % 3), 200), (280 - 20 * (k % 3), 0), 30, 10, cv2.LINE_AA)
        frames.append(image)
    return frames


def test_a_shifting_shaft_is_found_and_a_warning_says_that_it_only_shifts() -> None:
    frames = shifted((20, 60, 110, 160), second=False)
    warning = learn_shaft(frames).warning
    assert warning is not None
    assert "shifts and does not turn" in warning
    for seed, x in zip(find_shaft(frames), (20, 60, 110, 160), strict=True):
        assert isinstance(seed, ShaftSeed)
        middle = seed.edges_px.mean(axis=0)
        across = np.array([200, 60]) / np.hypot(200, 60)
        assert np.abs((middle - [x, 200]) @ across).max() < 2.0


def test_of_two_that_shift_alike_none_is_taken() -> None:
    found = find_shaft(shifted((20, 60, 110, 140, 35, 90), second=True))
    assert all(isinstance(seed, SeedRejection) for seed in found)


def test_a_real_thin_probe_is_found_in_every_frame(shared_data: Path) -> None:
    files = sorted((shared_data / "parallax_probe").glob("*.jpg"))
    frames = [np.asarray(cv2.imread(str(f), cv2.IMREAD_GRAYSCALE), dtype=np.uint8) for f in files]
    assert len(frames) == 4
    for seed in find_shaft(frames):
        assert isinstance(seed, ShaftSeed), seed
        along = seed.edges_px[:, 1] - seed.edges_px[:, 0]
        assert np.hypot(*along.T).min() > 1000
        one, other = seed.edges_px.mean(axis=1)
        normal = np.array([-along[0, 1], along[0, 0]]) / np.hypot(*along[0])
        # 17 px by the edge fit of its two sharp frames; the blurred ends widen the others.
        assert abs((other - one) @ normal) == pytest.approx(19, abs=4)
