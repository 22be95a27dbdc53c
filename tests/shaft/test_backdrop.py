"""What stands behind the shaft is told by the frames in which it stands elsewhere."""

import numpy as np
import pytest

from pivometer.shaft.backdrop import LEAST_FRAMES, backdrop_of, filled

SIZE = (60, 160)
WIDTH = 12
PLACES = range(6, 126, 10)
NOISE = 2.0


def edges_at(x):
    return np.array([[[x, 0], [x, SIZE[0] - 1]], [[x + WIDTH, 0], [x + WIDTH, SIZE[0] - 1]]], float)


def frames_of(scene, places, rng=None):
    """Draw a bright shaft at each place before the scene."""
    frames = []
    for x in places:
        frame = scene.astype(np.float64)
        frame[:, x : x + WIDTH] = 230
        if rng is not None:
            frame += rng.normal(0, NOISE, SIZE)
        frames.append(np.rint(frame).clip(0, 255).astype(np.uint8))
    return frames, [edges_at(x) for x in places]


@pytest.fixture
def scene(rng):
    return rng.integers(20, 200, SIZE).astype(np.float64)


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def test_what_the_shaft_hides_in_some_frames_others_show(scene):
    told = backdrop_of(*frames_of(scene, PLACES))
    np.testing.assert_array_equal(told, scene)


def test_its_noise_is_that_of_a_median(scene, rng):
    told = backdrop_of(*frames_of(scene, [4 + 5 * k for k in range(24)], rng))
    beside = told[:, 148:] - scene[:, 148:]
    # Two medians of 12: variance π/2 σ²/12 each, half of that for their mean; 720 pixels tell it
    # to 1/√1440 = 2.6 %, and a median of 12 is up to 8 % better than the limit of many.
    expected = NOISE * np.sqrt(np.pi / 2 / 24)
    assert beside.std() == pytest.approx(expected, rel=0.08 + 3 * 0.026)


def test_where_the_shaft_always_stands_nothing_is_told(scene):
    told = backdrop_of(*frames_of(scene, [50 + k % 3 for k in range(12)]))
    assert np.isnan(told[:, 52 : 50 + WIDTH]).all()
    np.testing.assert_array_equal(told[:, 80:], scene[:, 80:])


def test_what_stood_there_for_half_of_the_session_is_not_told(scene):
    frames, edges = frames_of(scene, PLACES)
    for frame in frames[len(frames) // 2 :]:
        frame[20:30, 145:155] = 255
    told = backdrop_of(frames, edges)
    assert np.isnan(told[20:30, 145:155]).all()
    np.testing.assert_array_equal(told[35:], scene[35:])


def test_few_frames_tell_nothing(scene):
    frames, edges = frames_of(scene, PLACES)
    few = LEAST_FRAMES - 1
    assert backdrop_of(frames[:few], edges[:few]) is None
    assert backdrop_of(frames[: few + 1], edges[: few + 1]) is not None


def test_an_empty_frame_shows_the_rest(scene):
    told = np.where(np.arange(SIZE[1]) < 30, np.nan, scene)
    empty = (scene + 1).astype(np.uint8)
    both = filled(told, empty)
    np.testing.assert_array_equal(both[:, :30], empty[:, :30])
    np.testing.assert_array_equal(both[:, 30:], scene[:, 30:])
    np.testing.assert_array_equal(filled(None, empty), empty)
