"""Cameras in a ROS bag: ``.bag`` of ROS 1, and folders, ``.db3`` or ``.mcap`` of ROS 2.

A topic of ``sensor_msgs/Image`` or ``CompressedImage`` plays a camera, at the times its messages
bear. It is named after the file: ``/data/run.bag#/left/image_raw``.
"""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np

from pivometer.errors import ImageError, UsageError
from pivometer.io.images import Image, decode_image
from pivometer.io.live import Frame

EXTENSIONS = frozenset({".bag", ".db3", ".mcap"})
_TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
_EXTRA = 'pip install "pivometer[ros]"'
_CHANNELS = {"mono": 1, "8UC1": 1, "16UC1": 1, "bgra": 4, "rgba": 4, "bgr": 3, "rgb": 3, "bayer": 1}
_TO_GREY = {
    "bgr": cv2.COLOR_BGR2GRAY,
    "rgb": cv2.COLOR_RGB2GRAY,
    "bgra": cv2.COLOR_BGRA2GRAY,
    "rgba": cv2.COLOR_RGBA2GRAY,
    "bayer_rggb": cv2.COLOR_BayerRGGB2GRAY,
    "bayer_bggr": cv2.COLOR_BayerBGGR2GRAY,
    "bayer_gbrg": cv2.COLOR_BayerGBRG2GRAY,
    "bayer_grbg": cv2.COLOR_BayerGRBG2GRAY,
}


def is_bag(path: Path) -> bool:
    """Tell whether a path is named like a bag, or is the folder of one of ROS 2."""
    return path.suffix.lower() in EXTENSIONS or (path / "metadata.yaml").is_file()


class PlayedBag:
    """A camera's topic in a bag, played at the times of its messages, over and over.

    Parameters
    ----------
    path
        The bag.
    topic
        The camera's topic.
    start_s
        When playing starts, on the clock of `time.monotonic`; topics of one bag share it.

    Raises
    ------
    UsageError
        If the extra is not installed, the bag cannot be read, or has no such topic of pictures.
    """

    def __init__(self, path: Path, topic: str, start_s: float) -> None:
        self._path, self._topic, self._start_s = path, topic, start_s
        with _opened(path) as reader:
            topics = _picture_topics(reader)
            if topic not in topics:
                named = f"no pictures under the topic {topic!r}" if topic else "no topic is named"
                there = ", ".join(f"{path.name}#{name}" for name in sorted(topics)) or "none"
                raise UsageError(named, next_step=f"name one of its cameras: {there}", path=path)
            self._first_ns, self._length_ns = reader.start_time, reader.duration
        self._count = 0
        self._frames = self._play()

    def read(self) -> Frame:
        """Wait for the next message's time and decode its picture."""
        return next(self._frames)

    def close(self) -> None:
        """Close the bag."""
        self._frames.close()

    def _play(self) -> Generator[Frame, None, None]:
        begin = self._start_s
        while True:
            with _opened(self._path) as reader:
                mine = [one for one in reader.connections if one.topic == self._topic]
                for connection, stamp_ns, data in reader.messages(connections=mine):
                    due = begin + (stamp_ns - self._first_ns) / 1e9
                    time.sleep(max(0.0, due - time.monotonic()))
                    message = reader.deserialize(data, connection.msgtype)
                    yield Frame(self._picture(message), due, self._count)
                    self._count += 1
            begin += self._length_ns / 1e9

    def _picture(self, message: Any) -> Image:
        if hasattr(message, "encoding"):
            return _decoded(message, self._path)
        return decode_image(bytes(message.data), self._path)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Open a bag of either kind; what the library says of a broken one becomes a message."""
    if find_spec("rosbags") is None:
        raise UsageError("ROS bags need rosbags, which is not installed", next_step=_EXTRA)
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.typesys import Stores, get_typestore

    place = path.parent if (path.parent / "metadata.yaml").is_file() else path
    known = get_typestore(Stores.ROS2_HUMBLE)
    try:
        with AnyReader([place], default_typestore=known) as reader:
            yield reader
    except (AnyReaderError, OSError) as error:
        raise UsageError(
            f"is no bag that can be read: {error}",
            next_step="copy it again; a ROS 2 bag is a folder with metadata.yaml",
            path=path,
        ) from error


def _picture_topics(reader: Any) -> set[str]:
    return {one.topic for one in reader.connections if one.msgtype in _TYPES}


def _decoded(message: Any, path: Path) -> Image:
    """Return the grey picture of an ``Image`` message.

    References
    ----------
    ROS, ``sensor_msgs/Image`` and ``sensor_msgs/image_encodings.hpp``.
    """
    kind = str(message.encoding)
    deep = kind.endswith("16") or kind == "16UC1"
    name = kind.removesuffix("16").removesuffix("8")
    channels = next((n for start, n in _CHANNELS.items() if kind.startswith(start)), None)
    if channels is None:
        raise ImageError(
            f"holds pictures encoded as {kind}",
            next_step="record mono8, mono16, bgr8, rgb8 or a Bayer pattern",
            path=path,
        )
    width = 2 if deep else 1
    rows = np.frombuffer(bytes(message.data), np.uint8)
    if len(rows) < message.step * message.height or message.step < width * channels * message.width:
        raise ImageError("holds a picture that is cut off", next_step="record it again", path=path)
    rows = rows[: message.step * message.height].reshape(message.height, message.step)
    line = np.ascontiguousarray(rows[:, : width * channels * message.width])
    order = ">" if message.is_bigendian else "<"
    values = line.view(np.dtype(f"{order}u{width}"))
    pixels: Image = values.astype(np.uint16) if deep else values.astype(np.uint8)
    if channels > 1:
        pixels = pixels.reshape(message.height, message.width, channels)
    if name in _TO_GREY:
        pixels = cast("Image", cv2.cvtColor(pixels, _TO_GREY[name]))
    return pixels
