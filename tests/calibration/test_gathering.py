"""The board at a glance, and how far the views gathered so far carry."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import pytest

from pivometer.calibration import Board
from pivometer.calibration.gathering import (
    ENOUGH_VIEWS,
    LEAST_VIEWS,
    Moment,
    gathering,
    says_something_new,
)
from pivometer.calibration.glimpse import BoardGlimpse, glimpse
from pivometer.simulation import simulate

SIZE = (640, 480)
CAMERAS = ("left", "right")


@pytest.mark.parametrize(("scale", "deep"), [(1, False), (1, True), (4, False)])
def test_a_glance_finds_corners_to_two_pixels_and_tilts_to_a_third(scale: int, deep: bool) -> None:
    session = simulate("gold", poses=3, board_pairs=1, single_views=0)
    path = "board/left/000.png"
    picture, camera = session.pictures[path], session.rig.cameras[0]
    image = session.image(path)
    if scale > 1:
        image = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_LINEAR)
    if deep:
        image = image.astype(np.uint16) * 16
    board = Board("checkerboard", session.pattern.squares, session.pattern.square_mm)
    seen = glimpse(image, board)
    assert seen is not None
    true = camera.project(picture.camera_from_board @ board.corners_mm)
    true = (true + 0.5) * scale - 0.5
    apart = np.linalg.norm(seen.pixels[:, None] - true[None], axis=2).min(axis=1)
    assert apart.max() < 2 * scale
    normal = picture.camera_from_board.rotation[:, 2]
    tilt = np.degrees(np.arccos(abs(normal[2])))
    assert np.degrees(np.arccos(abs(seen.normal @ normal))) < tilt / 3 + 2


def test_without_a_board_there_is_nothing() -> None:
    noise = np.random.default_rng(0).integers(0, 255, (480, 640), dtype=np.uint8)
    for board in (Board("checkerboard", (9, 7), 1.0), _charuco()):
        assert glimpse(noise, board) is None


def _charuco() -> Board:
    return Board("charuco", (5, 7), 20.0, dictionary="DICT_4X4_50", marker_mm=15.0)


def test_a_charuco_board_is_seen_in_part() -> None:
    board = _charuco()
    known = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    drawn = cv2.aruco.CharucoBoard(board.squares, 20.0, 15.0, known).generateImage((500, 700))
    image = np.full((480, 640), 255, np.uint8)
    image[20:480, 70:570] = drawn[:460]  # the rest of the board is below the image
    seen = glimpse(image, board)
    assert seen is not None
    assert 4 <= len(seen.ids) < board.corner_count
    assert abs(seen.normal[2]) > 0.98  # seen from straight ahead


def made(x: float, y: float, size: float, tilt_deg: float, around_deg: float) -> BoardGlimpse:
    """A board whose corners fill a square about (x, y)."""
    grid = np.stack(np.meshgrid([-0.5, -0.25, 0, 0.25, 0.5], [-0.5, -0.25, 0, 0.25, 0.5]), axis=-1)
    places = np.clip(np.array([x, y]) + size * grid.reshape(-1, 2), 0, 0.999)
    tilt, around = np.radians([tilt_deg, around_deg])
    normal = np.array([np.sin(tilt) * np.cos(around), np.sin(tilt) * np.sin(around), -np.cos(tilt)])
    return BoardGlimpse(np.arange(25), places * SIZE, np.array([x, y]), size, normal)


def moments(count: int, *, right: Sequence[float] = (0.2, 0.8)) -> list[Moment]:
    """Views all over the image and tilted all round; the right camera's lie between two x."""
    shown: list[Moment] = []
    for number in range(count):
        step = number / max(1, count - 1)
        tilted = 35.0, 137.5 * number
        y, size = 0.2 + 0.6 * (number % 2), 0.3 + 0.2 * (number % 3) / 2
        left = made(0.2 + 0.6 * step, y, size, *tilted)
        other = made(right[0] + (right[1] - right[0]) * step, y, size, *tilted)
        shown.append({"left": (left, SIZE), "right": (other, SIZE)})
    return shown


def test_enough_is_enough_for_every_camera_and_for_all_at_once() -> None:
    assert gathering(moments(ENOUGH_VIEWS), CAMERAS).enough
    assert gathering(moments(ENOUGH_VIEWS), CAMERAS).advice.startswith("Enough")
    fewer = gathering(moments(ENOUGH_VIEWS - 1), CAMERAS)
    assert not fewer.enough
    assert f"{ENOUGH_VIEWS - 1} of {ENOUGH_VIEWS} views" in fewer.advice
    assert gathering(moments(LEAST_VIEWS), CAMERAS).possible
    assert not gathering(moments(LEAST_VIEWS - 1), CAMERAS).possible


def test_views_that_only_one_camera_saw_do_not_count_as_shared() -> None:
    alone: list[Moment] = [{"left": moment["left"]} for moment in moments(ENOUGH_VIEWS)]
    known = gathering(alone, CAMERAS)
    assert known.shared.views == 0
    assert not known.possible
    assert known.cameras[0].views == ENOUGH_VIEWS
    assert known.cameras[1].views == 0


def test_of_three_cameras_each_must_share_moments_with_another() -> None:
    pairs = moments(2 * LEAST_VIEWS)
    chain: list[Moment] = [
        {"left": one["left"], "middle": one["right"]}
        if number % 2
        else {"middle": one["left"], "right": one["right"]}
        for number, one in enumerate(pairs)
    ]
    cameras = ("left", "middle", "right")
    assert gathering(chain, cameras).shared.views == LEAST_VIEWS
    assert gathering(chain, cameras).possible
    assert not gathering(pairs, cameras).possible


def test_the_advice_names_the_camera_and_what_it_lacks() -> None:
    known = gathering(moments(ENOUGH_VIEWS, right=(0.5, 0.5)), CAMERAS)
    assert known.advice == (
        "For camera right, move the board farther to the left and right edges of its image."
    )
    flat: list[Moment] = [
        {name: (made(0.2 + 0.1 * n, 0.5, 0.3, 1.0, 0.0), SIZE) for name in CAMERAS}
        for n in range(5)
    ]
    assert "tilt the board" in gathering(flat, CAMERAS).advice
    assert gathering([], CAMERAS).advice.startswith("Hold the board where all cameras")


@pytest.mark.parametrize(
    ("other", "new"),
    [
        (made(0.53, 0.5, 0.42, 3.0, 90.0), False),
        (made(0.57, 0.5, 0.40, 0.0, 0.0), True),
        (made(0.50, 0.5, 0.46, 0.0, 0.0), True),
        (made(0.50, 0.5, 0.40, 9.0, 0.0), True),
    ],
)
def test_a_view_is_new_by_place_size_or_tilt(other: BoardGlimpse, new: bool) -> None:
    assert says_something_new(other, [made(0.5, 0.5, 0.4, 0.0, 0.0)]) is new
