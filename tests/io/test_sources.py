"""Folders and videos played like cameras, and capture devices, which a fake plays here."""

import itertools
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from pivometer.errors import ImageError, UsageError
from pivometer.io.images import write_image
from pivometer.io.sources import Device, PlayedImages, PlayedVideo, found_devices, open_source


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for level in (10, 20, 30):
        write_image(tmp_path / "left" / f"{level // 10}.png", np.full((6, 8), level, np.uint16))
    (tmp_path / "left" / "notes.txt").write_text("no image", encoding="utf-8")
    return tmp_path / "left"


def test_a_folder_is_played_over_and_over_at_its_rate(folder: Path) -> None:
    start = time.monotonic()
    source = PlayedImages(folder, 50.0, start)
    frames = [source.read() for _ in range(5)]
    assert time.monotonic() - start >= 4 / 50 - 1e-6
    for frame in frames:
        assert frame.time_s == pytest.approx(start + frame.number / 50, abs=1e-9)
        assert int(frame.image[0, 0]) == 10 * (1 + frame.number % 3)
        assert frame.image.dtype == np.uint16
    assert all(b.number > a.number for a, b in itertools.pairwise(frames))


def test_two_sources_of_one_start_show_the_same_moment(folder: Path) -> None:
    start = time.monotonic() - 100.0  # as if one had been opened much later
    a, b = (PlayedImages(folder, 20.0, start) for _ in range(2))
    first, second = a.read(), b.read()
    while second.number < first.number:
        second = b.read()
    assert second.number - first.number <= 1
    assert first.number >= 1999  # ticks that nobody waited for are passed over


def test_a_video_is_played_and_started_again(tmp_path: Path) -> None:
    path = tmp_path / "left.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10, (64, 48))
    for level in (40, 120, 200):
        writer.write(np.full((48, 64, 3), level, dtype=np.uint8))
    writer.release()
    source = PlayedVideo(path, 40.0, time.monotonic())
    for _ in range(7):
        frame = source.read()
        assert float(frame.image.mean()) == pytest.approx((40, 120, 200)[frame.number % 3], abs=3)
    source.close()


class FakeCapture:
    def __init__(self, frames: int) -> None:
        self.left = frames
        self.released = False

    def isOpened(self) -> bool:  # noqa: N802
        return self.left > 0

    def read(self) -> tuple[bool, np.ndarray | None]:
        self.left -= 1
        return (True, np.full((4, 6, 3), 9, np.uint8)) if self.left >= 0 else (False, None)

    def release(self) -> None:
        self.released = True


def test_a_device_that_is_pulled_is_told() -> None:
    fake = FakeCapture(2)
    device = Device(3, opened=lambda _: fake)
    assert [device.read().number for _ in range(2)] == [0, 1]
    with pytest.raises(ImageError, match="device 3 gives no more pictures"):
        device.read()
    device.close()
    assert fake.released


def test_a_device_that_cannot_be_opened_is_told() -> None:
    with pytest.raises(UsageError, match="device 0 cannot be opened"):
        Device(0, opened=lambda _: FakeCapture(0))


def test_devices_are_listed_by_number(tmp_path: Path) -> None:
    for name in ("video10", "video2", "video-x", "audio1"):
        (tmp_path / name).touch()
    assert found_devices(tmp_path) == ("device 2", "device 10")


@pytest.mark.parametrize("text", ["", "  ", "device x", "/no/such/place", "device -1"])
def test_what_is_no_source_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="no such source"):
        open_source(text)


def test_an_empty_folder_a_text_file_and_a_rate_of_none_are_refused(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").touch()
    with pytest.raises(UsageError, match="holds no images"):
        open_source(str(tmp_path))
    with pytest.raises(UsageError, match="no source of pictures"):
        open_source(str(tmp_path / "notes.txt"))
    with pytest.raises(UsageError, match="a rate of 0"):
        open_source(str(tmp_path), rate_hz=0)
