"""Industrial cameras through GenICam: GigE Vision, USB3 Vision and others, with a maker's producer.

A camera is named by the producer's file and its number there: ``genicam /opt/maker/tl.cti 0``.
"""

from __future__ import annotations

import time
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from pivometer.errors import ImageError, UsageError
from pivometer.io.live import Frame

PREFIX = "genicam"
_WAIT_S = 3.0
_EXTRA = 'pip install "pivometer[genicam]"'


def genicam_words(text: str) -> tuple[str, int] | None:
    """Return the producer's file and the camera's number where a text names such a camera.

    Examples
    --------
    >>> genicam_words("genicam /opt/a maker/tl.cti 1")
    ('/opt/a maker/tl.cti', 1)
    >>> genicam_words("device 0") is None
    True
    """
    words = text.split(maxsplit=1)
    producer, _, number = words[1].rpartition(" ") if len(words) == 2 else ("", "", "")
    if not words or words[0] != PREFIX or not number.isdecimal():
        return None
    return producer.strip(), int(number)


class GenicamCamera:
    """A camera of a GenICam producer, in grey at its own bit depth.

    Parameters
    ----------
    producer
        The producer's ``.cti`` file.
    number
        The camera's number in the producer's list, from 0.
    harvester
        What lists the cameras; that of harvesters where none is given.

    Raises
    ------
    UsageError
        If the extra is not installed, or there is no such producer or camera.
    """

    def __init__(self, producer: Path, number: int, harvester: Any = None) -> None:
        self._name = f"camera {number} of {producer.name}"
        self._harvester = _harvester() if harvester is None else harvester
        if not producer.is_file():
            raise UsageError("no such GenICam producer", next_step="name its .cti", path=producer)
        self._harvester.add_file(str(producer))
        self._harvester.update()
        there = len(self._harvester.device_info_list)
        if number >= there:
            self._harvester.reset()
            raise UsageError(
                f"there is no camera {number}; {there} are connected",
                next_step="plug it in, or name another number",
                path=producer,
            )
        self._camera = self._harvester.create(number)
        self._camera.start()
        self._count = 0

    def read(self) -> Frame:
        """Wait for the next picture."""
        try:
            with self._camera.fetch(timeout=_WAIT_S) as buffer:
                part = buffer.payload.components[0]
                kind = str(part.data_format)
                pixels = np.array(part.data).reshape(part.height, part.width)
        except Exception as error:  # producers raise what they like
            raise ImageError(
                f"{self._name} gives no picture: {error}",
                next_step="check its plug and trigger; all taken so far is in the session folder",
            ) from error
        if not kind.startswith("Mono") or pixels.dtype not in (np.uint8, np.uint16):
            raise ImageError(f"{self._name} gives {kind}", next_step="set Mono8 or Mono16 in it")
        self._count += 1
        return Frame(pixels, time.monotonic(), self._count - 1)

    def close(self) -> None:
        """Stop the camera and give it back."""
        self._camera.stop()
        self._camera.destroy()
        self._harvester.reset()


def _harvester() -> Any:
    if find_spec("harvesters") is None:
        raise UsageError(
            "GenICam cameras need harvesters, which is not installed", next_step=_EXTRA
        )
    return import_module("harvesters.core").Harvester()
