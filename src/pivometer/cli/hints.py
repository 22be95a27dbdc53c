"""``--hint CAMERA=X,Y,WIDTH`` as values."""

from __future__ import annotations

import math
from collections.abc import Iterable

from pivometer.errors import UsageError
from pivometer.shaft.hint import ShaftHint


def shaft_hints(texts: Iterable[str]) -> dict[str, ShaftHint]:
    """Return the hints by camera.

    Raises
    ------
    UsageError
        If one is not written so, or there are two for a camera.

    Examples
    --------
    >>> shaft_hints(["left=412,300,22"])["left"].x_px
    412.0
    """
    hints: dict[str, ShaftHint] = {}
    for text in texts:
        camera, _, place = text.rpartition("=")
        numbers = _numbers(place)
        if not camera or len(numbers) not in (2, 3) or (len(numbers) == 3 and numbers[2] <= 0):
            raise UsageError(
                f"--hint {text} is not CAMERA=X,Y or CAMERA=X,Y,WIDTH in pixels",
                next_step="write, for instance, --hint left=412,300,22",
            )
        if camera in hints:
            raise UsageError(f"--hint is given twice for {camera}", next_step="leave out one")
        hints[camera] = ShaftHint(*numbers)
    return hints


def _numbers(place: str) -> list[float]:
    """Return the finite numbers between commas; none if any is not one."""
    try:
        numbers = [float(word) for word in place.split(",")]
    except ValueError:
        return []
    return numbers if all(math.isfinite(number) for number in numbers) else []
