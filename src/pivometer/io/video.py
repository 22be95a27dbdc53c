"""Video files as a session's frames: counted, hashed and decoded one after the other.

A frame is reached by decoding all before it: seeking lands on another frame in some containers, and
two cameras' frames of one number must be of one moment.
"""

import hashlib
from collections.abc import Iterable, Iterator
from pathlib import Path

import cv2
import numpy as np

from pivometer.errors import ImageError
from pivometer.io.images import Image

EXTENSIONS = frozenset({".avi", ".m4v", ".mkv", ".mov", ".mp4", ".mpg", ".webm"})
"""File name endings of videos, in lower case."""

_STEP = "convert it without loss, for instance to FFV1 in .mkv, or save its frames as PNG images"


def frame_count(path: Path) -> int:
    """Return how many frames a video's container states.

    Raises
    ------
    ImageError
        If it is no video that OpenCV reads, or states none.
    """
    video = _opened(path)
    count = int(video.get(cv2.CAP_PROP_FRAME_COUNT))
    video.release()
    if count < 1:
        raise ImageError("is a video that states no number of frames", next_step=_STEP, path=path)
    return count


def video_frames(path: Path, wanted: Iterable[int]) -> Iterator[Image | ImageError]:
    """Decode the wanted frames of a video, whose numbers rise; one frame is in memory at a time.

    Yields
    ------
    ndarray or ImageError
        For every number the grey frame (height, width), or why there is none.
    """
    try:
        video = _opened(path)
    except ImageError as error:
        yield from (error for _ in wanted)
        return
    place = 0
    for number in wanted:
        while place < number and video.grab():
            place += 1
        pixels = video.read()[1] if place == number else None
        place += pixels is not None
        yield _ended(path, place) if pixels is None else _grey(pixels)
    video.release()


def sha256(path: Path) -> str:
    """Return a file's SHA-256, hexadecimal, read a piece at a time."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _opened(path: Path) -> cv2.VideoCapture:
    video = cv2.VideoCapture(str(path))
    if not video.isOpened():
        raise ImageError("is no video that OpenCV reads", next_step=_STEP, path=path)
    video.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
    return video


def _grey(pixels: cv2.typing.MatLike) -> Image:
    grey: Image = np.asarray(
        pixels if pixels.ndim == 2 else cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY), dtype=np.uint8
    )
    return grey


def _ended(path: Path, place: int) -> ImageError:
    return ImageError(
        f"has no frame after number {place - 1}: it is cut off or damaged",
        next_step="copy the video again from the camera",
        path=path,
    )
