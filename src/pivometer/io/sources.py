"""Live pictures: capture devices, and image folders and videos that are played like cameras.

Played sources of one rig share a clock, so that the frames of one tick are of one moment, as from
cameras with a common trigger.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from pivometer.errors import ImageError, UsageError
from pivometer.io import video
from pivometer.io.bags import EXTENSIONS as BAGS
from pivometer.io.bags import PlayedBag, is_bag
from pivometer.io.genicam import GenicamCamera, genicam_words
from pivometer.io.images import EXTENSIONS, Image, read_image
from pivometer.io.live import Frame, Source
from pivometer.io.session import natural_order

USUAL_RATE_HZ = 15.0
LEAST_RATE_HZ = 15.0
"""Of the frames of an image folder; its pictures may change more slowly."""
MOST_REMEMBERED_BYTES = 64_000_000
"""Of a folder's images: a short one, played over and over, is read once."""
_STEP = (
    "name a capture device (device 0), a folder of images, a video "
    f"({', '.join(sorted(video.EXTENSIONS))}), or a ROS bag and its topic ("
    f"{', '.join(sorted(BAGS))}, as in run.bag#/left/image_raw), "
    "or a GenICam camera (genicam producer.cti 0)"
)


def open_source(text: str, *, rate_hz: float = USUAL_RATE_HZ, start_s: float = 0.0) -> Source:
    """Open what a person named as a camera.

    Parameters
    ----------
    text
        ``"device 0"``, a folder of images, a video file, or a ROS bag with a topic,
        ``"run.bag#/left/image_raw"``, or a GenICam camera, ``"genicam producer.cti 0"``.
    rate_hz
        Pictures per second at which folders and videos are played.
    start_s
        When playing starts, on the clock of `time.monotonic`: the same for all cameras of a rig.

    Raises
    ------
    UsageError
        If it is none of these, or is not there.
    """
    if not 0 < rate_hz <= 1000:
        raise UsageError(f"a rate of {rate_hz} frames a second", next_step="give 1 to 1000")
    words = text.split()
    if len(words) == 2 and words[0] == "device" and words[1].isdecimal():
        return Device(int(words[1]))
    if industrial := genicam_words(text):
        return GenicamCamera(Path(industrial[0]).expanduser(), industrial[1])
    name, _, topic = text.partition("#")
    path = Path(name if is_bag(Path(name).expanduser()) else text).expanduser()
    if not text.strip() or not path.exists():
        raise UsageError("no such source", next_step=_STEP, path=text or None)
    if is_bag(path):
        return PlayedBag(path, topic, start_s)
    if path.is_dir():
        return PlayedImages(path, rate_hz, start_s)
    if path.suffix.lower() in video.EXTENSIONS:
        return PlayedVideo(path, rate_hz, start_s)
    raise UsageError("is no source of pictures", next_step=_STEP, path=path)


def found_devices(folder: Path = Path("/dev")) -> tuple[str, ...]:
    """Return the capture devices that this computer has, as `open_source` takes them."""
    numbers = [path.name.removeprefix("video") for path in folder.glob("video*")]
    if not folder.is_dir():  # neither Linux nor anything like it: only trying tells
        numbers = [str(n) for n in range(4) if _opens(n)]
    return tuple(f"device {n}" for n in sorted(int(n) for n in numbers if n.isdecimal()))


def _opens(number: int) -> bool:
    capture = cv2.VideoCapture(number)
    opened = capture.isOpened()
    capture.release()
    return opened


class _Ticks:
    """A clock that ticks at a rate; ticks that nobody waited for are passed over."""

    def __init__(self, rate_hz: float, start_s: float) -> None:
        self._rate_hz, self._start_s = rate_hz, start_s
        self._last = -1

    def wait(self) -> tuple[int, float]:
        """Wait for the next tick; return its number and its time."""
        now = time.monotonic()
        tick = max(self._last + 1, int((now - self._start_s) * self._rate_hz))
        due = self._start_s + tick / self._rate_hz
        if due > now:
            time.sleep(due - now)
        self._last = tick
        return tick, due


class PlayedImages:
    """A folder of images, played at a rate over and over, in the order of their names.

    Like a camera before a scene that changes at that rate, it gives at least `LEAST_RATE_HZ` frames
    a second: a slower picture is given several times.
    """

    def __init__(self, folder: Path, rate_hz: float, start_s: float) -> None:
        names = (p for p in folder.iterdir() if p.suffix.lower() in EXTENSIONS)
        self._files = sorted(
            (p for p in names if not p.name.startswith(".")), key=lambda p: natural_order(p.stem)
        )
        if not self._files:
            raise UsageError("holds no images", next_step=_STEP, path=folder)
        self._times = max(1, round(LEAST_RATE_HZ / rate_hz))
        self._ticks = _Ticks(rate_hz * self._times, start_s)
        self._images: dict[Path, Image] = {}

    def read(self) -> Frame:
        """Wait for the next image's turn and read it, unless it is remembered."""
        tick, due = self._ticks.wait()
        path = self._files[tick // self._times % len(self._files)]
        if path not in self._images:
            if sum(image.nbytes for image in self._images.values()) > MOST_REMEMBERED_BYTES:
                self._images.clear()
            self._images[path] = read_image(path)
        return Frame(self._images[path], due, tick)

    def close(self) -> None:
        """Forget the images."""
        self._images.clear()


class PlayedVideo:
    """A video, played at a rate over and over; a frame that comes too late is passed over."""

    def __init__(self, path: Path, rate_hz: float, start_s: float) -> None:
        self._path, self._count = path, video.frame_count(path)
        self._ticks = _Ticks(rate_hz, start_s)
        self._frames = cv2.VideoCapture(str(path))
        self._place = 0

    def read(self) -> Frame:
        """Wait for the next frame's turn and decode it."""
        tick, due = self._ticks.wait()
        wanted = tick % self._count
        if wanted < self._place:
            self._frames.release()
            self._frames = cv2.VideoCapture(str(self._path))
            self._place = 0
        while self._place < wanted and self._frames.grab():
            self._place += 1
        read, pixels = self._frames.read()
        self._place += 1
        if not read:
            raise ImageError(
                f"has no frame {wanted} of {self._count}",
                next_step="copy the video again from the camera",
                path=self._path,
            )
        return Frame(_grey(pixels), due, tick)

    def close(self) -> None:
        """Close the file."""
        self._frames.release()


class Device:
    """A capture device of this computer, through OpenCV."""

    def __init__(
        self, number: int, opened: Callable[[int], cv2.VideoCapture] = cv2.VideoCapture
    ) -> None:
        self._name = f"device {number}"
        self._capture = opened(number)
        self._count = 0
        if not self._capture.isOpened():
            raise UsageError(
                f"{self._name} cannot be opened",
                next_step="plug it in, close other programs that use it, and check who may read it",
            )

    def read(self) -> Frame:
        """Wait for the next picture."""
        read, pixels = self._capture.read()
        if not read:
            raise ImageError(
                f"{self._name} gives no more pictures",
                next_step="check its plug; everything taken so far is in the session folder",
            )
        self._count += 1
        return Frame(_grey(pixels), time.monotonic(), self._count - 1)

    def close(self) -> None:
        """Give the device back."""
        self._capture.release()


def _grey(pixels: cv2.typing.MatLike) -> Image:
    """Return a decoded picture as one grey channel."""
    if pixels.ndim == 3:
        pixels = cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY)
    if pixels.dtype not in (np.uint8, np.uint16):
        raise ImageError(f"pixels of type {pixels.dtype}", next_step="set 8 or 16 bit")
    if pixels.dtype == np.uint16:
        return np.ascontiguousarray(pixels, dtype=np.uint16)
    return np.ascontiguousarray(pixels, dtype=np.uint8)
