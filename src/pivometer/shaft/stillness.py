"""Whether a camera stood still: by how much what stands still shifts from picture to picture.

A camera that is knocked by a millimetre-wide crack of its clamp sees everything shifted by pixels,
and nothing in centerlines and residuals tells that from a robot that misses. The scenery does: all
of it shifts together, turns and grows together, while robot, board and shadows go ways of their
own. The grey levels' differences from their surroundings are followed, times a gain, since pictures
of board and shaft may be exposed unlike; places that do not follow count for nothing (Tukey).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.cameras.mosaic import is_mosaic
from pivometer.shaft.finding.background import Image, averaged, shrinking

SHRINKINGS = (8, 3, 1)
"""Copies are compared from small to large: a shift shows in one if it is under two of its blurs."""

BLUR_PX = 1.5
BESIDE_PX = 13
"""A grey level counts, once blurred, by its difference from the mean over so many pixels."""

CELLS = (16, 12)
CELL_PIXELS = 40
LEAST_SLOPE = 0.1
"""In each cell of the picture so many pixels are followed, those with the steepest grey levels; not
those under a tenth of what the steep ones of all cells have."""

NOISES = 5.0
SLOPE_NOISE = 1 / (np.sqrt(8 * np.pi) * BLUR_PX**2)
LEAST_NOISE_GREY = 0.3
"""Nor those under five standard deviations of the slope that blurred noise has, of one grey level
or at least of rounding: before a dark wall all others are as alike as noise to noise."""

LEAST_CELLS = 24
"""So many cells must have some: an eighth of the picture."""

ITERATIONS = 8
LAST_PX = 0.001
TUKEY = 4.7
LEAST_EXPLAINED = 0.5
LARGEST_SIGMA_PX = 0.03
"""A picture tells its shift if half of what its places show, in squares, is what the first picture
shows there, to 0.03 px. Rendered sessions: right ones over 0.8 and under 0.015, wrong ones under
0.3."""

MOST_MISSES = 8
"""If so many more pictures do not tell their shift than do, no others are compared: before a dark
wall each would take 12 to 20 ms for nothing."""

TURNED_OVER: dict[str, tuple[slice, slice]] = {
    "mirrored, left for right,": (slice(None), slice(None, None, -1)),
    "turned by half a turn": (slice(None, None, -1), slice(None, None, -1)),
    "mirrored, upside down,": (slice(None, None, -1), slice(None)),
}

TURNED_OVER_PX = 10.0
"""Software turns pictures about their middle; a match elsewhere is chance."""

LEAST_VIEWS = 6
STILL_STEP_PX = 0.5
"""If more than half of all neighbouring pictures differ by more, what was followed is no scenery: a
camera is knocked now and then, not each time."""

LEAST_SHIFT_PX = 0.15
"""Smaller shifts are not told of: shadows, glare and lossy video shift scenery by up to 0.1 px, in
an independently rendered session by 0.05."""

SIGMAS = 5.0
MEDIAN_SIGMA = 1.2533
"""√(π/2): standard error of a median of normal deviations, over that of their mean."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraMovement:
    """What a camera's pictures of board and shaft, in this order, tell of its standing still.

    Parameters
    ----------
    camera
        Its name.
    views
        The pictures that tell it, such as ``board/000`` and ``shaft/000``.
    before, after
        The two of them between which it moved most.
    shift_px
        How far the scenery shifted then, where it did so most, raw px.
    scatter_px
        How far a picture's shift is off, apart from that, standard deviation.
    limit_px
        What chance, shadows and glare explain.
    """

    camera: str
    views: int
    before: str
    after: str
    shift_px: float
    scatter_px: float
    limit_px: float

    @property
    def significant(self) -> bool:
        """Whether the camera moved."""
        return self.shift_px > self.limit_px


class _Followed(NamedTuple):
    """The pixels of a copy that are followed; ``away`` is in half widths from its middle."""

    shrinking: int
    cell: NDArray[np.intp]
    place_px: Floats
    away: Floats
    grey: Floats
    jacobian: Floats


class Scenery:
    """One picture of a camera, to which its others are compared.

    Parameters
    ----------
    image
        The picture, shape (height, width), 8 or 16 bit.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> room = cv2.GaussianBlur(rng.uniform(0, 255, (120, 160)), (0, 0), 2.0)
    >>> room = ((room - room.min()) / np.ptp(room) * 255).astype(np.uint8)
    >>> scenery = Scenery(room[:, :150])
    >>> shift = scenery.shift_px(room[:, 2:152])
    >>> bool(np.abs(shift - [-2, 0]).max() < 0.01)
    True
    >>> scenery.shift_px(np.full((120, 150), 90, dtype=np.uint8)) is None
    True
    """

    def __init__(self, image: Image) -> None:
        self._factor = max(shrinking(image), 1 + is_mosaic(image))
        small = averaged(image, self._factor)
        height, width = small.shape
        quarter = height / width / 2
        self._places = np.array([[x, y] for y in (-quarter, quarter) for x in (-0.5, 0.5)])
        self._copies = [_followed(small, shrinking) for shrinking in SHRINKINGS]
        self._last = np.zeros(4)
        cells = len(np.unique(self._copies[-1].cell))
        self._patience = MOST_MISSES if cells >= LEAST_CELLS else 0

    def shift_px(self, image: Image) -> Floats | None:
        """Return how far the scenery is shifted in another picture of the same size.

        Returns
        -------
        numpy.ndarray or None
            Shifts at the middles of the picture's four quarters, shape (4, 2), raw px; `None` where
            too little of the scenery is seen again, or was in most others.
        """
        if self._patience <= 0:
            return None
        small = averaged(image, self._factor)
        # From where the last picture was, usually the largest copy tells.
        for first in reversed(range(len(self._copies))):
            moved = _registered(small, self._copies[first:], self._last)
            if moved is not None:
                self._last = moved
                self._patience += 1
                return _shifts(moved, self._places) * self._factor
        self._patience -= 1
        return None

    def turned_over(self, image: Image) -> str | None:
        """Return how a picture without the scenery has it all the same, None if it has not."""
        for how, turned in TURNED_OVER.items():
            shift = self.shift_px(cast("Image", np.ascontiguousarray(image[turned])))
            if shift is not None and np.abs(shift).max() < TURNED_OVER_PX * self._factor:
                return how
        return None


def _followed(small: Image, shrinking: int) -> _Followed:
    """Choose the pixels of a copy that tell most, in all parts of it."""
    copy = averaged(small, shrinking)
    band = _band(copy)
    slope = np.stack([cv2.Scharr(band, -1, *along, scale=1 / 32) for along in ((1, 0), (0, 1))])
    steep = np.square(slope).sum(axis=0)
    # Beside the border the blur mirrors what is inside.
    border = int(np.ceil(2 * BLUR_PX))
    inside = np.zeros_like(steep)
    inside[border:-border, border:-border] = 1
    cells, rows, columns = _steepest(inside * steep)
    enough = steep[rows, columns]
    least = NOISES * SLOPE_NOISE * _noise(copy)
    kept = enough > np.maximum(LEAST_SLOPE**2 * np.percentile(enough, 90), least**2)
    cells, rows, columns = cells[kept], rows[kept], columns[kept]
    place = np.stack([columns, rows]).astype(np.float64)
    height, width = band.shape
    away = (place - np.array([[width - 1], [height - 1]]) / 2) / (width / 2)
    gx, gy = slope[:, rows, columns].astype(np.float64)
    jacobian = np.stack([gx, gy, gy * away[0] - gx * away[1], gx * away[0] + gy * away[1]])
    grey = band[rows, columns].astype(np.float64)
    return _Followed(shrinking, cells, place, away, grey, jacobian)


def _band(copy: Image) -> NDArray[np.float32]:
    """Return the blurred grey levels of a copy less their surroundings' mean."""
    smooth = cv2.GaussianBlur(copy.astype(np.float32), (0, 0), BLUR_PX)
    return np.asarray(smooth - cv2.boxFilter(smooth, -1, (BESIDE_PX, BESIDE_PX)), dtype=np.float32)


def _noise(copy: Image) -> float:
    """Return the noise's standard deviation, grey levels.

    References
    ----------
    Immerkær, doi:10.1006/cviu.1996.0060, with the median instead of the mean.
    """
    kernel = np.outer([1, -2, 1], [1, -2, 1]).astype(np.float32)
    rough = cv2.filter2D(copy.astype(np.float32), -1, kernel)
    return max(1.4826 * float(np.median(np.abs(rough))) / 6, LEAST_NOISE_GREY)


def _steepest(steep: NDArray[np.float32]) -> NDArray[np.intp]:
    """Return cells, rows and columns of the steepest pixels of each cell, shape (3, n)."""
    found: list[NDArray[np.intp]] = []
    for rows in np.array_split(np.arange(steep.shape[0]), CELLS[1]):
        for columns in np.array_split(np.arange(steep.shape[1]), CELLS[0]):
            cell = steep[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1].ravel()
            place = np.argpartition(cell, -min(CELL_PIXELS, cell.size))[-CELL_PIXELS:]
            row, column = np.divmod(place, len(columns))
            number = np.full(len(place), len(found))
            found.append(np.stack([number, rows[0] + row, columns[0] + column]))
    return np.concatenate(found, axis=1)


def _registered(small: Image, copies: Sequence[_Followed], start: Floats) -> Floats | None:
    """Return the shift (px), and turn and growth times half the width, if the picture shows them.

    Gauss-Newton steps of these and of the gain, with Tukey's weights: see Baker and Matthews,
    doi:10.1023/B:VISI.0000011205.11775.fd, for the steps.
    """
    moved, gain = start.copy(), 0.0
    for followed in copies:
        band = _band(averaged(small, followed.shrinking))
        moved = moved / followed.shrinking
        gain = gain or _usual(_seen(band, followed, moved)) / _usual(followed.grey)
        for _ in range(ITERATIONS):
            seen = _seen(band, followed, moved)
            rest = seen - gain * followed.grey
            noise = 1.4826 * _usual(rest)
            weight = np.clip(1 - (rest / (TUKEY * noise)) ** 2, 0, None) ** 2
            columns = np.concatenate([gain * followed.jacobian, -followed.grey[None]])
            normal = (columns * weight) @ columns.T
            normal.flat[:: len(normal) + 1] += 1e-9 * (1 + normal.diagonal())
            covariance = np.linalg.inv(normal)
            step = -covariance @ ((columns * weight) @ rest)
            moved, gain = moved + step[:4], gain + float(step[4])
            if np.abs(step[:4]).max() < LAST_PX:
                break
        moved = moved * followed.shrinking
    unexplained = float((weight * rest**2).sum() / max(float((weight * seen**2).sum()), 1e-12))
    sigma = noise * float(np.sqrt(covariance[range(4), range(4)].max()))
    shows = gain > 0 and unexplained < 1 - LEAST_EXPLAINED and sigma < LARGEST_SIGMA_PX
    return moved if shows else None


def _seen(band: NDArray[np.float32], followed: _Followed, moved: Floats) -> Floats:
    """Return what a copy of a picture shows at the places that are followed."""
    x, y = (followed.place_px + _shifts(moved, followed.away.T).T).astype(np.float32)
    seen = cv2.remap(band, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(seen, dtype=np.float64).ravel()


def _shifts(moved: Floats, away: Floats) -> Floats:
    """Return the shifts of places away from the middle, shape (n, 2)."""
    x, y, turn, growth = moved
    u, v = away.T
    return np.stack([x - turn * v + growth * u, y + turn * u + growth * v], axis=-1)


def _usual(values: Floats) -> float:
    return max(float(np.median(np.abs(values))), 1e-6)


def camera_movement(
    camera: str, views: Sequence[str], shifts_px: Sequence[Floats | None]
) -> CameraMovement | None:
    """Return between which pictures a camera moved most, or None where its pictures do not tell.

    Parameters
    ----------
    camera
        Its name.
    views, shifts_px
        Its pictures in the order in which they were taken, and what `Scenery.shift_px` says.

    Examples
    --------
    >>> views = [f"shaft/{i}" for i in range(8)]
    >>> shifts = [np.full((4, 2), 0.01 * (-1) ** i + (0.5 if i > 4 else 0)) for i in range(8)]
    >>> moved = camera_movement("left", views, shifts)
    >>> moved.before, moved.after, round(moved.shift_px, 1), moved.significant
    ('shaft/4', 'shaft/5', 0.7, True)
    """
    told = [(v, s.ravel()) for v, s in zip(views, shifts_px, strict=True) if s is not None]
    if len(told) < max(LEAST_VIEWS, len(views) / 2):
        return None
    shifts = np.stack([shift for _, shift in told])
    if float(np.median(_largest(np.diff(shifts, axis=0)))) > STILL_STEP_PX:
        return None
    split = min(range(2, len(told) - 1), key=lambda k: _apart(shifts[:k]) + _apart(shifts[k:]))
    parts = shifts[:split], shifts[split:]
    first, second = (np.median(part, axis=0) for part in parts)
    rest = np.concatenate([parts[0] - first, parts[1] - second])
    scatter = 1.4826 * _usual(rest)
    chance = MEDIAN_SIGMA * scatter * np.sqrt(1 / len(parts[0]) + 1 / len(parts[1]))
    return CameraMovement(
        camera=camera,
        views=len(told),
        before=told[split - 1][0],
        after=told[split][0],
        shift_px=float(_largest(second - first)),
        scatter_px=scatter,
        limit_px=max(LEAST_SHIFT_PX, SIGMAS * float(chance)),
    )


def _largest(shifts: Floats) -> Floats:
    """Return the largest of the shifts at four places, px."""
    return np.asarray(np.hypot(shifts[..., ::2], shifts[..., 1::2]).max(axis=-1))


def _apart(shifts: Floats) -> float:
    """Return the sum of the distances from the median."""
    return float(np.abs(shifts - np.median(shifts, axis=0)).sum())
