"""The cameras, live: a thread for each keeps its newest frames, and what is drawn over them."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pivometer.calibration.glimpse import shrunk
from pivometer.errors import PivometerError
from pivometer.io.images import Image
from pivometer.io.live import Frame, Source

KEPT = 12
"""Frames of each camera that are kept to find those of one moment: under a second."""
PREVIEW_PX = 960
"""Longest side of a preview: two stand side by side on a screen."""
_QUALITY = [cv2.IMWRITE_JPEG_QUALITY, 80]

Colour = tuple[int, int, int]
CYAN: Colour = (230, 190, 60)
ORANGE: Colour = (40, 150, 245)
"""Blue, green, red. Told apart by all who do not see all colours, and by their form."""


@dataclass(frozen=True, slots=True, eq=False)
class Mark:
    """Something to draw over a camera's pictures: a line, or dots.

    Parameters
    ----------
    points_px
        Shape (n, 2), raw px.
    kind
        ``"line"``, ``"dashed"`` or ``"dots"``.
    colour
        Blue, green, red.
    """

    points_px: NDArray[np.float64]
    kind: str = "line"
    colour: Colour = CYAN


class Feed:
    """One camera's thread: reads frames as they come until it is closed or the camera is lost."""

    def __init__(self, name: str, source: Source) -> None:
        self.name = name
        self.fault: str | None = None
        self.version = 0
        self._marks: Sequence[Mark] = ()
        self._source = source
        self._frames: deque[Frame] = deque(maxlen=KEPT)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._read, name=f"camera {name}", daemon=True)
        self._thread.start()

    def _read(self) -> None:
        try:
            while not self._stop.is_set():
                frame = self._source.read()
                if not self._frames or self._frames[-1].image is not frame.image:
                    self.version += 1
                self._frames.append(frame)
        except PivometerError as error:
            self.fault = str(error)
        finally:
            if not self._stop.is_set():
                self.fault = self.fault or "it stopped for a reason nobody foresaw"
            self._source.close()

    @property
    def marks(self) -> Sequence[Mark]:
        """What is drawn over the previews."""
        return self._marks

    @marks.setter
    def marks(self, marks: Sequence[Mark]) -> None:
        if marks or self._marks:
            self._marks = marks
            self.version += 1  # the preview is another one, although the picture is the same

    @property
    def frames(self) -> tuple[Frame, ...]:
        """The newest frames, the oldest first."""
        return tuple(self._frames)

    @property
    def rate_hz(self) -> float:
        """Frames per second, from the frames that are kept."""
        frames = self.frames
        if len(frames) < 2 or self.fault is not None:
            return 0.0
        return (len(frames) - 1) / max(frames[-1].time_s - frames[0].time_s, 1e-6)

    def close(self) -> None:
        """Stop reading and give the source back."""
        self._stop.set()
        self._thread.join(timeout=2.0)

    def jpeg(self) -> tuple[int, bytes]:
        """Return the version and the preview of the newest frame; there must be one."""
        version, frame = self.version, self.frames[-1]
        return version, preview(frame.image, self._marks)


def same_moment(feeds: Mapping[str, Feed]) -> dict[str, Frame] | None:
    """Return the newest frame of the camera that is behind, and the others' nearest to it in time.

    `None` where a camera has no frame yet, or is lost.
    """
    frames = {name: feed.frames for name, feed in feeds.items()}
    if not frames or not all(frames.values()) or any(feed.fault for feed in feeds.values()):
        return None
    time_s = min(kept[-1].time_s for kept in frames.values())
    return {
        name: min(kept, key=lambda frame: abs(frame.time_s - time_s))
        for name, kept in frames.items()
    }


def preview(image: Image, marks: Sequence[Mark]) -> bytes:
    """Return a picture as a small JPEG with marks drawn over it."""
    factor = -(-max(image.shape) // PREVIEW_PX)
    small = shrunk(image, factor)
    levels = np.asarray(small >> 8 if small.dtype == np.uint16 else small, dtype=np.uint8)
    if marks:
        levels = np.asarray(cv2.cvtColor(levels, cv2.COLOR_GRAY2BGR), dtype=np.uint8)
        for mark in marks:
            _draw(levels, mark, 1 / factor)
    _, data = cv2.imencode(".jpg", levels, _QUALITY)
    return data.tobytes()


_SHIFT = 4
"""Bits of a pixel's fraction in OpenCV's drawing."""


def _draw(picture: NDArray[np.uint8], mark: Mark, scale: float) -> None:
    points = ((mark.points_px + 0.5) * scale - 0.5) * (1 << _SHIFT)
    if not np.isfinite(points).all() or np.abs(points).max(initial=0) > 1e8:
        return
    places = points.round().astype(np.int32)
    if mark.kind == "dots":
        for x, y in places.tolist():
            cv2.circle(picture, (x, y), 4 << _SHIFT, mark.colour, 2, cv2.LINE_AA, _SHIFT)
        return
    pieces = [places] if mark.kind == "line" else list(_dashes(points))
    cv2.polylines(picture, pieces, False, mark.colour, 2, cv2.LINE_AA, _SHIFT)


def _dashes(points: NDArray[np.float64]) -> Sequence[NDArray[np.int32]]:
    """Cut the way between the first and the last point into dashes."""
    ends = np.linspace(points[0], points[-1], 2 * 12)
    return [pair.round().astype(np.int32) for pair in ends.reshape(-1, 2, 2)]
