"""How far the board views gathered so far will carry a calibration, and what to show next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pivometer._arrays import Floats
from pivometer.calibration.advice import ENOUGH_TILT_DEG
from pivometer.calibration.glimpse import BoardGlimpse
from pivometer.calibration.quality import GRID

ENOUGH_VIEWS = 20
"""Moments that all cameras share: the README's 20, which halve the uncertainty of 10."""
LEAST_VIEWS = 6
"""Shared moments from which a calibration may be tried."""
ENOUGH_SPAN = 0.8
"""Part of the image's width and height that corners should reach."""
ENOUGH_SIZES = 1.4
"""Largest over smallest board in the image: nearer and farther tell focal length from distance."""
NEW_MIDDLE, NEW_SIZE, NEW_TILT_DEG = 0.06, 0.12, 8.0
"""A view says something new if its board is elsewhere by 6 % of the image, 12 % larger or smaller,
or tilted by 8° more: about five steps to either side of the middle."""


@dataclass(frozen=True, slots=True)
class Coverage:
    """How far the views of one camera, or those all cameras share, fill what is wanted.

    Parameters
    ----------
    name
        The camera; ``"shared"`` for the moments that cameras share.
    views
        Their number; of shared moments, that of the camera with the fewest.
    x, y
        Part of the image's width and height that corners reach, over what is wanted, 0 to 1.
    size
        Range of sizes, over what is wanted, 0 to 1.
    tilt
        Largest angle between two boards, over what is wanted, 0 to 1.
    """

    name: str
    views: int
    x: float
    y: float
    size: float
    tilt: float

    @property
    def least(self) -> tuple[str, float]:
        """The emptiest of the four, and how full it is."""
        parts = {"x": self.x, "y": self.y, "size": self.size, "tilt": self.tilt}
        name = min(parts, key=lambda part: parts[part])
        return name, parts[name]


@dataclass(frozen=True, slots=True, eq=False)
class Gathering:
    """What is gathered: coverage of each camera and of the shared moments, and what to do next.

    Parameters
    ----------
    cameras
        Coverage of each camera.
    shared
        Coverage of the moments that two cameras or more share, as the first camera sees them.
    advice
        One sentence.
    """

    cameras: tuple[Coverage, ...]
    shared: Coverage
    advice: str

    @property
    def possible(self) -> bool:
        """Whether a calibration may be tried."""
        return self.shared.views >= LEAST_VIEWS

    @property
    def enough(self) -> bool:
        """Whether more views would bring little."""
        full = all(cover.least[1] >= 1 for cover in self.cameras)
        return full and self.shared.tilt >= 1 and self.shared.views >= ENOUGH_VIEWS


Moment = Mapping[str, tuple[BoardGlimpse, tuple[int, int]]]
"""By camera, the board at one moment, and the width and height of the image."""


def gathering(moments: Sequence[Moment], cameras: Sequence[str]) -> Gathering:
    """Say how far the views carry.

    Parameters
    ----------
    moments
        What the cameras saw of the board, moment by moment.
    cameras
        All cameras, the reference first.
    """
    covers = tuple(_coverage(name, [m[name] for m in moments if name in m]) for name in cameras)
    together = [moment for moment in moments if len(moment) > 1]
    seen = _coverage("shared", [m[cameras[0]] for m in together if cameras[0] in m])
    fewest = min(sum(name in moment for moment in together) for name in cameras)
    shared = replace(seen, views=fewest)
    return Gathering(covers, shared, _advice(covers, shared))


def says_something_new(seen: BoardGlimpse, before: Sequence[BoardGlimpse]) -> bool:
    """Tell whether a board is placed or tilted unlike all of those before.

    Examples
    --------
    >>> def at(x, tilt): return BoardGlimpse(np.arange(4), np.zeros((4, 2)), np.array([x, 0.5]),
    ...     0.4, np.array([np.sin(tilt), 0.0, -np.cos(tilt)]))
    >>> says_something_new(at(0.5, 0.0), [at(0.52, 0.05)])
    False
    >>> says_something_new(at(0.5, 0.3), [at(0.52, 0.05)])
    True
    """
    return not any(_alike(seen, old) for old in before)


def _alike(a: BoardGlimpse, b: BoardGlimpse) -> bool:
    near = float(np.abs(a.middle - b.middle).max()) < NEW_MIDDLE
    same_size = abs(np.log(a.size / b.size)) < NEW_SIZE
    return near and same_size and _angle_deg(a.normal, b.normal) < NEW_TILT_DEG


def _angle_deg(a: Floats, b: Floats) -> float:
    return float(np.degrees(np.arccos(np.clip(a @ b, -1, 1))))


def _coverage(name: str, views: Sequence[tuple[BoardGlimpse, tuple[int, int]]]) -> Coverage:
    if not views:
        return Coverage(name, 0, 0.0, 0.0, 0.0, 0.0)
    places = np.concatenate([seen.pixels / size for seen, size in views])
    spans = [_span(places[:, axis], GRID[axis]) / ENOUGH_SPAN for axis in (0, 1)]
    sizes = [seen.size for seen, _ in views]
    growth = np.log(max(sizes) / min(sizes)) / np.log(ENOUGH_SIZES)
    normals = np.stack([seen.normal for seen, _ in views])
    widest = float(np.degrees(np.arccos(np.clip(normals @ normals.T, -1, 1).min())))
    x, y, size, tilt = (
        float(min(1.0, part)) for part in (*spans, growth, widest / ENOUGH_TILT_DEG)
    )
    return Coverage(name, len(views), x, y, size, tilt)


def _span(places: Floats, cells: int) -> float:
    """Return the part of the cells along one axis that hold a corner."""
    return len(np.unique(np.clip((places * cells).astype(np.int64), 0, cells - 1))) / cells


_DO = {
    "x": "move the board farther to the left and right edges of its image",
    "y": "move the board farther to the top and bottom of its image",
    "size": "hold the board nearer, then farther away",
    "tilt": "tilt the board by up to 45° up, down, left and right",
}


def _advice(covers: Sequence[Coverage], shared: Coverage) -> str:
    if shared.views == 0:
        return "Hold the board where all cameras see all of it, and keep it still for a moment."
    if shared.tilt < 1 and shared.views >= 3:
        return "In view of all cameras, tilt the board by up to 45° up, down, left and right."
    if shared.views < LEAST_VIEWS:
        return (
            f"Show the board to all cameras at once, tilted in other ways: {shared.views} of at "
            f"least {LEAST_VIEWS} views."
        )
    emptiest = min(covers, key=lambda cover: cover.least[1])
    part, filled = emptiest.least
    if filled < 1:
        return f"For camera {emptiest.name}, {_DO[part]}."
    if shared.views < ENOUGH_VIEWS:
        return (
            f"Show the board to all cameras at once in new places: {shared.views} of "
            f"{ENOUGH_VIEWS} views."
        )
    return "Enough: calibrate, or add views where the tool will be."
