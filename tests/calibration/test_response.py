"""A board's edges tell whether a camera is linear, whatever else is done to its pictures."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from scipy.special import ndtr

from pivometer._arrays import Floats
from pivometer.calibration import Board, BoardView
from pivometer.calibration.response import CameraResponse, camera_response, edge_bends

BOARD = Board("checkerboard", (7, 6), 10.0)
SIDE_PX, BLUR_PX, FINE = 24.0, 0.6, 2
DARK, STEP, NOISE = 15.0, 160.0, 1.0
VIEWS = 6

Spread = Callable[[Floats], Floats]


def even(u: Floats) -> Floats:
    return ndtr(u / BLUR_PX)


def lopsided(u: Floats) -> Floats:
    """A lens that throws a tenth of its light a pixel and a half to one side."""
    return 0.9 * ndtr(u / BLUR_PX) + 0.1 * ndtr((u - 1.5) / BLUR_PX)


def lines(u: Floats, count: int, spread: Spread) -> Floats:
    """Return +1 and −1 in turns between lines, and beyond the first and the last."""
    nearest = np.clip(np.rint(u / SIDE_PX), 0, count - 1)
    return (-1) ** nearest * (1 - 2 * spread(u - nearest * SIDE_PX))


def seen(
    rng: np.random.Generator,
    *,
    gamma: float = 1.0,
    spread: Spread = even,
    then: Callable[[Floats], Floats] | None = None,
    full: float = 255.0,
    gain: float = 1.0,
) -> tuple[np.ndarray, BoardView]:
    """Return a turned board as an ideal sensor would see it, and its corners."""
    size, across, down = 180, *BOARD.inner_corners
    angle, start = rng.uniform(-0.4, 0.4), np.array([size / 2, size / 2]) + rng.uniform(-1, 1, 2)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    middle = (np.array([across, down]) - 1) / 2 * SIDE_PX
    fine = (np.arange(size * FINE) + 0.5) / FINE - 0.5
    places = (np.stack(np.meshgrid(fine, fine), axis=-1) - start) @ turn + middle
    pattern = lines(places[..., 0], across, spread) * lines(places[..., 1], down, spread)
    light = DARK + STEP * (1 + pattern) / 2
    light = light.reshape(size, FINE, size, FINE).mean(axis=(1, 3)) * gain
    light = np.clip(light + rng.normal(0, NOISE, light.shape), 0, 255) / 255
    grey = 255 * light ** (1 / gamma)
    grey = grey if then is None else then(grey)
    pixels = (BOARD.columns_rows * SIDE_PX - middle) @ turn.T + start
    sigma = np.full(BOARD.corner_count, 0.01)
    view = BoardView("left", "board/000", np.arange(BOARD.corner_count), pixels, sigma)
    kind = np.uint8 if full == 255 else np.uint16
    return np.clip(np.rint(grey * full / 255), 0, full).astype(kind), view


def response(seed: int, views: int = VIEWS, **options: object) -> CameraResponse | None:
    rng = np.random.default_rng(seed)
    found = [edge_bends(*seen(rng, **options), BOARD) for _ in range(views)]
    return camera_response([one for one in found if one is not None])


def sharpened(grey: Floats) -> Floats:
    return grey + 0.5 * (grey - cv2.GaussianBlur(grey, (0, 0), 1.2))


def compressed(grey: Floats) -> Floats:
    _, data = cv2.imencode(".jpg", np.clip(np.rint(grey), 0, 255).astype(np.uint8), [1, 80])
    return cv2.imdecode(data, cv2.IMREAD_GRAYSCALE).astype(np.float64)


def test_linear_cameras_have_no_bend_but_what_noise_explains():
    found = [response(seed) for seed in range(8)]
    bend, u = np.array([(one.bend, one.bend_u) for one in found]).T
    # The mean of eight: 4 standard deviations are exceeded once in 16,000 times.
    assert abs(bend.mean()) < 4 * np.sqrt(np.square(u).mean() / 8)
    assert u.max() < 0.03
    assert all(one.linear for one in found)


@pytest.mark.parametrize("gamma", [1.5, 2.2, 3.0])
def test_the_exponent_is_told(gamma):
    found = response(1, gamma=gamma)
    assert not found.linear
    assert found.gamma == pytest.approx(gamma, rel=0.1)
    assert found.gamma_u < 0.1 * gamma


def test_gamma_of_16_bit_pictures_is_told():
    found = response(2, gamma=2.2, full=65535.0)
    assert not found.linear
    assert found.gamma == pytest.approx(2.2, rel=0.1)


def test_a_lopsided_lens_is_no_gamma_since_it_is_opposite_at_edges_of_opposite_polarity():
    rng = np.random.default_rng(4)
    views = [edge_bends(*seen(rng, spread=lopsided), BOARD) for _ in range(VIEWS)]
    found = camera_response(views)
    each = np.concatenate([one.bend for one in views])
    assert np.median(np.abs(each)) > 0.15  # what a gamma of 1.3 does to every edge
    assert found.linear


@pytest.mark.parametrize("then", [sharpened, compressed])
def test_what_is_done_to_pictures_passes_neither_for_gamma_nor_hides_it(then):
    assert response(5, then=then).linear
    found = response(5, then=then, gamma=2.2)
    assert not found.linear
    assert 1.5 < found.gamma < 3  # JPEG and sharpening leave no more than that


def test_clipped_edges_are_not_looked_at():
    rng = np.random.default_rng(6)
    assert edge_bends(*seen(rng, gain=1.6), BOARD) is None


def test_few_views_say_nothing():
    assert response(7, views=4) is None
    assert response(7, views=5) is not None
