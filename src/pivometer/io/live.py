"""What every live source of pictures gives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from pivometer.io.images import Image


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One picture of a live source.

    Parameters
    ----------
    image
        Grey image, shape (height, width), uint8 or uint16.
    time_s
        When it was taken, on the clock of `time.monotonic`, s.
    number
        Counts the source's frames from 0; those that were skipped count too.
    """

    image: Image
    time_s: float
    number: int


class Source(Protocol):
    """Something that gives frames, one after the other."""

    def read(self) -> Frame:
        """Wait for the next frame and return it.

        Raises
        ------
        PivometerError
            If there is none: the camera was pulled, the file is damaged.
        """

    def close(self) -> None:
        """Give back what the source holds."""
