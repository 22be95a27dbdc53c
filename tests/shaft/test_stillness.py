"""Whether a camera stood still, as its scenery tells: drawn, rendered and real pictures."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.shaft.stillness import (
    LEAST_SHIFT_PX,
    CameraMovement,
    Scenery,
    camera_movement,
)

SIZE = (320, 240)
NOISE = 2.0
RAW_PX = 0.05
"""Above what 2 grey levels of noise do to 7000 pixels of slopes of some grey levels a pixel."""


def room(seed: int, size: tuple[int, int] = SIZE) -> Floats:
    """Draw boxes and rods, larger than the picture, with one pixel of blur."""
    rng = np.random.default_rng(seed)
    width, height = (2 * side for side in size)
    drawn = np.full((height, width), 90, dtype=np.uint8)
    for _ in range(120):
        x, y = (int(v) for v in rng.uniform((0, 0), (width, height)))
        w, h = (int(v) for v in rng.uniform(8, 90, 2))
        cv2.rectangle(drawn, (x, y), (x + w, y + h), int(rng.uniform(20, 220)), -1)
        end = tuple(int(v) for v in rng.uniform((0, 0), (width, height)))
        cv2.line(drawn, (x, y), end, int(rng.uniform(20, 220)), 3, cv2.LINE_AA)
    return cv2.GaussianBlur(drawn.astype(np.float64), (0, 0), 1.0)


def picture(
    scene: Floats,
    seed: int,
    *,
    shift: tuple[float, float] = (0, 0),
    turn: float = 0.0,
    gain: float = 1.0,
    robot: bool = True,
) -> NDArray[np.uint8]:
    """Take a picture of a room, in which a robot hides a fifth, elsewhere each time."""
    rng = np.random.default_rng(seed)
    height, width = (side // 2 for side in scene.shape)
    middle = np.array([width - 1, height - 1]) / 2
    turned = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    # From the picture's pixels to the room's, whose middle the camera sees in its own.
    back = turned.T
    offset = 2 * middle + 0.5 - back @ (middle + np.array(shift))
    matrix = np.concatenate([back, offset[:, None]], axis=1)
    seen = cv2.warpAffine(
        scene, matrix, (width, height), flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    )
    if robot:
        x, y = (int(v) for v in rng.uniform((0, 0), (0.55 * width, 0.55 * height)))
        arm = room(seed)[: int(0.45 * height), : int(0.45 * width)]
        seen[y : y + arm.shape[0], x : x + arm.shape[1]] = arm
    noisy = gain * seen + rng.normal(0, NOISE, seen.shape)
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("gain", [1.0, 0.45])
@pytest.mark.parametrize(
    ("shift", "turn"), [((0, 0), 0.0), ((0.4, -0.3), 0.0), ((-6.5, 3.0), 0.0), ((1.0, 0.5), 0.01)]
)
def test_the_scenery_tells_its_shift_behind_a_moving_robot(
    shift: tuple[float, float], turn: float, gain: float
) -> None:
    scene = room(1)
    scenery = Scenery(picture(scene, 2))
    found = scenery.shift_px(picture(scene, 3, shift=shift, turn=turn, gain=gain))
    assert found is not None
    away = np.array([[x * 80, y * 60] for y in (-1, 1) for x in (-1, 1)])
    wanted = np.array(shift) + away @ np.array([[0, turn], [-turn, 0]])
    # Turning is to first order: 0.01² of 100 px is left.
    assert np.abs(found - wanted).max() < RAW_PX + 0.01


def test_another_scene_a_blank_one_and_a_dark_one_tell_nothing() -> None:
    scenery = Scenery(picture(room(1), 2))
    assert scenery.shift_px(picture(room(7), 3)) is None
    assert scenery.shift_px(np.full(SIZE[::-1], 80, dtype=np.uint8)) is None
    assert scenery.shift_px(picture(np.zeros((480, 640)), 3, robot=False)) is None


def test_pictures_are_compared_no_longer_once_eight_more_told_nothing_than_told_something() -> None:
    same, other = picture(room(1), 3), picture(room(7), 3)
    scenery = Scenery(picture(room(1), 2))
    assert scenery.shift_px(same) is not None
    assert all(scenery.shift_px(other) is None for _ in range(8))
    assert scenery.shift_px(same) is not None
    assert all(scenery.shift_px(other) is None for _ in range(2))
    assert scenery.shift_px(same) is None


def test_a_dark_wall_with_noise_is_no_scenery() -> None:
    wall = np.full((480, 640), 6.0)
    scenery = Scenery(picture(wall, 2))  # of which a robot fills a fifth
    assert all(scenery.shift_px(picture(wall, seed)) is None for seed in range(3, 9))
    nothing = Scenery(picture(wall, 2, robot=False))
    assert nothing.shift_px(picture(wall, 2, robot=False)) is None


@pytest.mark.parametrize(
    ("turned", "how"),
    [
        ((slice(None), slice(None, None, -1)), "mirrored, left for right,"),
        ((slice(None, None, -1), slice(None, None, -1)), "turned by half a turn"),
        ((slice(None), slice(None)), None),
    ],
)
def test_pictures_that_are_turned_over_are_told(turned: tuple[slice, slice], how: str) -> None:
    scene = room(1)
    scenery = Scenery(picture(scene, 2))
    other = np.ascontiguousarray(picture(scene, 3, shift=(1, 1))[turned])
    assert scenery.turned_over(other) == how
    assert (scenery.shift_px(other) is None) == (how is not None)


@pytest.mark.parametrize("kind", ["deep", "large", "mosaic"])
def test_every_kind_of_picture_is_told_in_its_own_pixels(kind: str) -> None:
    scene = room(1, (1536, 1152) if kind == "large" else SIZE)
    first, second = picture(scene, 2, robot=False), picture(scene, 3, shift=(2, -1), robot=False)
    if kind == "deep":
        first, second = (16 * image.astype(np.uint16) for image in (first, second))
    if kind == "mosaic":  # of filters that stay where they are
        for image in (first, second):
            image[::2, ::2] = image[::2, ::2] * 0.6
    found = Scenery(first).shift_px(second)
    assert found is not None
    assert np.abs(found - [2, -1]).max() < 2 * RAW_PX


def moved(shifts: list[Floats | None]) -> CameraMovement | None:
    return camera_movement("left", [f"shaft/{i:03d}" for i in range(len(shifts))], shifts)


def alike(count: int, seed: int, sigma: float = 0.01) -> list[Floats]:
    return list(np.random.default_rng(seed).normal(0, sigma, (count, 4, 2)))


def test_chance_alone_moves_no_camera() -> None:
    for seed in range(200):
        found = moved([*alike(25, seed, 0.1)])
        assert found is not None
        assert found.limit_px > LEAST_SHIFT_PX
        assert not found.significant
        # The median deviation of 200 normal values is off by 8 %.
        assert abs(found.scatter_px - 0.1) < 5 * 0.08 * 0.1


@pytest.mark.parametrize("count", [2, 9, 23])
def test_a_knock_is_told_with_its_pictures(count: int) -> None:
    after = [shift + np.array([0.3, 0.0]) for shift in alike(25 - count, 2)]
    found = moved([*alike(count, 1), *after])
    assert found is not None
    assert found.significant
    assert (found.before, found.after) == (f"shaft/{count - 1:03d}", f"shaft/{count:03d}")
    assert found.shift_px == pytest.approx(0.3, abs=5 * 0.01)


def test_what_moves_every_time_is_no_scenery() -> None:
    assert moved(alike(25, 1, 3.0)) is None


def test_few_pictures_and_those_that_mostly_tell_nothing_tell_nothing() -> None:
    assert moved([*alike(5, 1)]) is None
    assert moved([*alike(9, 1), *[None] * 10]) is None
    told = moved([*alike(10, 1), *[None] * 10])
    assert told is not None
    assert told.views == 10


def pictures(files: list[Path]) -> Iterator[NDArray[np.uint8]]:
    for file in files:
        image = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
        assert image is not None
        yield np.asarray(image, dtype=np.uint8)


@pytest.mark.parametrize("camera", ["left", "right"])
def test_rendered_cameras_stood_still_until_one_is_knocked(shared_data: Path, camera: str) -> None:
    folder = shared_data / "rendered" / "arm_black_clutter"
    files = sorted((folder / "board" / camera).glob("*.png"))[::2]
    files += sorted((folder / "shaft" / camera).glob("*.png"))[::2]
    images = list(pictures(files))
    scenery = Scenery(images[-1])
    views = [f"{file.parent.parent.name}/{file.stem}" for file in files]
    still = camera_movement(camera, views, [scenery.shift_px(image) for image in images])
    assert still is not None
    assert not still.significant
    matrix = np.array([[1, 0, 0.4], [0, 1, 0]])
    for i in range(len(images) - 6, len(images)):
        images[i] = np.asarray(cv2.warpAffine(images[i], matrix, (640, 480)), dtype=np.uint8)
    scenery = Scenery(images[-1])
    knocked = camera_movement(camera, views, [scenery.shift_px(image) for image in images])
    assert knocked is not None
    assert knocked.significant
    assert knocked.after == views[-6]
    # Still ones were off by 0.05 px at most.
    assert knocked.shift_px == pytest.approx(0.4, abs=0.05)


def test_of_two_real_webcams_the_one_that_was_knocked_is_told(shared_data: Path) -> None:
    told = {}
    for name in ("cam_0", "cam_1"):
        video = cv2.VideoCapture(str(shared_data / "caliscope_charuco2" / f"{name}.mp4"))
        images = [
            cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
            for _, frame in (video.read() for _ in range(111))
        ][::5]
        scenery = Scenery(images[0])
        shifts = [scenery.shift_px(image) for image in images]
        told[name] = camera_movement(name, [str(5 * i) for i in range(len(images))], shifts)
    knocked, still = told["cam_0"], told["cam_1"]
    assert knocked is not None
    assert still is not None
    # Seen with the eye: posters and door are 5 px further to the right from frame 55 on.
    assert 45 <= int(knocked.before) < int(knocked.after) <= 55
    assert knocked.shift_px == pytest.approx(5.3, abs=0.5)
    assert not still.significant
