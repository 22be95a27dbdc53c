import cv2
import numpy as np
import pytest

from pivometer.errors import ShapeError
from pivometer.report import make_thumbnail


def decoded(thumbnail):
    return cv2.imdecode(np.frombuffer(thumbnail.jpeg, np.uint8), cv2.IMREAD_UNCHANGED)


def test_size_and_scale_belong_together():
    thumbnail = make_thumbnail(np.zeros((1200, 1920), np.uint8))
    assert (thumbnail.width, thumbnail.height, thumbnail.scale) == (480, 300, 0.25)
    assert decoded(thumbnail).shape == (300, 480)


def test_small_images_are_not_enlarged():
    thumbnail = make_thumbnail(np.zeros((60, 80), np.uint8))
    assert (thumbnail.width, thumbnail.height, thumbnail.scale) == (80, 60, 1.0)


def test_dim_twelve_bit_images_become_visible():
    image = np.full((480, 640), 300, np.uint16)
    image[:, 300:340] = 700
    grey = decoded(make_thumbnail(image))
    assert grey[180, 240] > 245
    assert grey[180, 50] < 10


@pytest.mark.parametrize("shape", [(480, 640), (2048, 2448)])
def test_pure_noise_stays_within_the_budget(shape):
    rng = np.random.default_rng(1)
    thumbnail = make_thumbnail(rng.integers(0, 256, shape, dtype=np.uint8))
    assert len(thumbnail.jpeg) <= 18_000
    assert thumbnail.scale == thumbnail.width / shape[1]


def test_colour_images_are_refused():
    with pytest.raises(ShapeError, match="shape"):
        make_thumbnail(np.zeros((4, 4, 3), np.uint8))
