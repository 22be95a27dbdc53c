"""What stands still is told from what moves."""

import cv2
import numpy as np
import pytest

from pivometer.shaft.finding.background import (
    GREY_UNITS,
    WorkingScale,
    gradient,
    moving_edges,
    outline_edges,
    sampled,
    shrinking,
    static_scene,
)


def bar(column: int) -> np.ndarray:
    """A static square and a bar that moves, in working grey units."""
    image = np.full((120, 160), 800, dtype=np.uint16)
    image[80:110, 10:40] = 2400
    image[5:70, column : column + 30] = 3000
    return image


def test_only_the_moved_bar_has_moving_edges_even_where_it_hides_a_pixel_in_most_frames() -> None:
    columns = (60, 66, 72, 78)
    copies = [bar(column) for column in columns]
    slopes = [gradient(copy) for copy in copies]
    scene = static_scene(copies, slopes)
    for part, column in zip(slopes, columns, strict=True):
        points = moving_edges(part, scene).points_px
        assert points[:, 1].max() < 72
        # The edge lies between two pixels, so that either of them is right.
        for side in (column - 0.5, column + 29.5):
            assert (np.abs(points[:, 0] - side) < 1.1).sum() >= 55


def test_gradient_directions_are_unit_vectors_across_the_edge() -> None:
    copies = [bar(column) for column in (50, 70, 90)]
    slopes = [gradient(copy) for copy in copies]
    edges = moving_edges(slopes[0], static_scene(copies, slopes))
    assert np.hypot(*edges.directions.T) == pytest.approx(1.0)
    upright = np.abs(edges.points_px[:, 1] - 35) < 20
    assert np.abs(edges.directions[upright, 0]) == pytest.approx(1.0, abs=1e-3)


def test_before_an_empty_frame_only_the_outline_of_a_bar_with_lanes_shows() -> None:
    rng = np.random.default_rng(5)
    clutter = cv2.GaussianBlur(rng.uniform(0, GREY_UNITS, (120, 160)), (0, 0), 4)
    room = 1800 + 2 * (clutter - clutter.mean())
    bar = room.copy()
    # 10 of 255 grey levels brighter than what is behind, but for one lane that is far brighter and
    # one that is as bright; and the light flickers by 4 %.
    bar[10:110, 60:100] = room[10:110, 60:100] + 160
    bar[10:110, 68:74] += 900
    bar[10:110, 82:86] = room[10:110, 82:86]
    noisy = [
        cv2.GaussianBlur(image, (0, 0), 0.8) + rng.normal(0, 32, room.shape)
        for image in (room, 1.04 * bar)
    ]
    empty, copy = (np.clip(np.rint(image), 0, GREY_UNITS).astype(np.uint16) for image in noisy)
    scene = static_scene([empty], [gradient(empty)], gradient(copy))
    x, y = outline_edges(copy, scene).points_px.T
    beside = (y > 15) & (y < 105)
    for side in (59.5, 99.5):
        assert (np.abs(x - side)[beside] < 1.6).sum() >= 70
    assert ((x > 81) & (x < 97) & beside).sum() <= 20
    assert ((x < 55) | (x > 104) | (y < 5) | (y > 115)).sum() <= 20


@pytest.mark.parametrize("count", [1, 2, 5, 8])
def test_the_scene_is_the_median(count: int) -> None:
    rng = np.random.default_rng(3)
    copies = [rng.integers(0, GREY_UNITS, (40, 50)).astype(np.uint16) for _ in range(count)]
    expected = np.median(np.stack(copies), axis=0)
    slopes = [gradient(copy) for copy in copies]
    assert static_scene(copies, slopes).grey == pytest.approx(np.floor(expected))


def test_raw_pixels_undo_the_shrinking() -> None:
    scale = WorkingScale(4, 0.0, 255.0)
    image = np.zeros((41, 80), dtype=np.uint8)
    image[8:12, 20:24] = 255
    copy = scale.copy(image)
    assert copy.shape == (10, 20)
    (row,), (column,) = np.nonzero(copy)
    assert scale.raw_pixels(np.array([column, row], dtype=float)) == pytest.approx([21.5, 9.5])


def test_large_images_shrink_by_a_whole_factor() -> None:
    assert shrinking(np.zeros((3000, 4000), dtype=np.uint8)) == 4
    assert shrinking(np.zeros((480, 640), dtype=np.uint16)) == 1


def test_sampling_spreads_over_all_frames() -> None:
    assert sampled(100, 5) == [0, 25, 50, 74, 99]
