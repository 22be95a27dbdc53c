"""Corners of a checkerboard to a few thousandths of a pixel: a model fitted to the raw pixels.

Around a corner the image is two blurred steps that cross, under light that varies slowly::

    I(x) = (1 + g·x) (a + b · erf(d₁ / √2 s) · erf(d₂ / √2 s)),   d = n·(x − c) − ½ κ (e·(x − c))²

with d₁ the distance from the line across (positive towards *down*), d₂ from the line down
(positive towards *across*); the curvatures κ, which distortion causes, are given, not fitted. Only
pixels near the two lines are used: the others say nothing about the centre c. All corners of a
board are fitted at once.

Light multiplies: with g·x merely added to the steps, the corners of the rendered boards with known
truth are off by 0.004 px down the fall of the light, and by less than 0.001 px like this.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.calibration.grid import LocalFrames

Image = NDArray[Any]
"""A grey image of shape (rows, columns) in its native bit depth."""

LEAST_BLUR_PX = 0.25
"""A pixel is a box of standard deviation 0.29 px, so no image is sharper than about this."""
CELLS_PER_BLUR = 256
"""Cells of the table of the blurred step in one standard deviation of the blur."""
TABLE_HALF = 6 * CELLS_PER_BLUR
"""Cells from the middle of the table to either end; beyond, the step is 1 to 2e-9."""
PIXELS_AT_ONCE = 8000
"""Pixels worked on together: their arrays of 80 bytes a pixel must fit a processor's cache. A
board took 0.39 of the time of the plain fit with this, and 0.46 with all its pixels at once."""


@dataclass(frozen=True, slots=True, eq=False)
class Windows:
    """Which pixels around each corner take part.

    Parameters
    ----------
    reach_squares
        How far along each line, shape (n, 2, 2), in squares: (across, down) by (backward, forward).
    band_px
        How far to either side of a line, shape (n,), px.
    margin_squares
        How far to either side of a line in squares: less than 1 keeps clear of markers.
    stride_px
        Use only every so many pixels along a line; across it, all are used.
    """

    reach_squares: Floats
    band_px: Floats
    margin_squares: float
    stride_px: int = 1


@dataclass(frozen=True, slots=True, eq=False)
class SaddleFits:
    """The fitted corners; all arrays have n rows.

    Parameters
    ----------
    pixels
        Centres c, shape (n, 2), px.
    sigma_px
        Standard uncertainty of each coordinate of c (root mean of the two variances), px.
    angles
        Directions of the lines across and down, shape (n, 2), rad.
    blur_px
        Standard deviation s of the blur, px.
    contrast
        The coefficient b, grey values: positive where the square across and down is bright.
    noise
        Standard deviation of the residual, grey values.
    coverage
        Fraction of the window's pixels that lie inside the image.
    """

    pixels: Floats
    sigma_px: Floats
    angles: Floats
    blur_px: Floats
    contrast: Floats
    noise: Floats
    coverage: Floats


@dataclass(frozen=True, slots=True, eq=False)
class _Pixels:
    """Grey values (n, m) and places (n, 3, m) of the pixels of each corner.

    The rows of `places` are 1, x and y: a line, or a light that varies, is a product with them.
    All is zero where a corner has fewer than m pixels, which takes these out of every sum.
    """

    grey: Floats
    places: Floats
    coverage: Floats

    def of(self, corners: NDArray[np.intp]) -> _Pixels:
        """Return the pixels of some of the corners."""
        if len(corners) == len(self.grey):
            return self
        return _Pixels(self.grey[corners], self.places[corners], self.coverage[corners])


def fit_saddles(
    image: Image,
    seeds_px: Floats,
    frames: LocalFrames,
    windows: Windows,
    *,
    blur_px: Floats,
    settled_px: float,
) -> SaddleFits:
    """Fit the crossing steps at n places by Levenberg–Marquardt.

    Parameters
    ----------
    image
        Grey image, any bit depth.
    seeds_px
        Where to start, shape (n, 2), px.
    frames
        Directions and curvatures of the lines at the corners.
    windows
        Which pixels to use.
    blur_px
        Standard deviation of the blur to start from, shape (n,), px.
    settled_px
        A step of the centre shorter than this is the last, px. Convergence is quadratic near the
        end: the error that is left is a small fraction of the last step.
    """
    origin = np.rint(seeds_px)
    pixels = _gathered(image, seeds_px, origin, frames, windows)
    state = np.empty((len(seeds_px), 9))
    state[:, :2] = seeds_px - origin
    state[:, 2:4] = frames.angles
    state[:, 4] = blur_px
    state[:, 5:] = _light_and_contrast(state, pixels, frames.curvatures)
    state, normal, square_sum = _levenberg_marquardt(state, pixels, frames.curvatures, settled_px)
    freedom = np.maximum(pixels.places[:, 0].sum(axis=1) - 9, 1)
    # whole grey values alone scatter by 1/√12, also where a picture looks free of noise
    noise = np.sqrt(np.maximum(square_sum / freedom, 1 / 12))
    return SaddleFits(
        pixels=state[:, :2] + origin,
        sigma_px=noise * _unit_sigma_px(normal),
        angles=state[:, 2:4],
        blur_px=state[:, 4],
        contrast=state[:, 8],
        noise=noise,
        coverage=pixels.coverage,
    )


def _unit_sigma_px(normal: Floats) -> Floats:
    """Return the uncertainty of a coordinate for noise 1, shape (n,), from JᵀJ (n, 9, 9)."""
    scale = np.sqrt(np.einsum("nii->ni", normal)) + 1e-9
    scaled = normal / (scale[:, :, None] * scale[:, None, :]) + 1e-12 * np.eye(9)
    inverse = np.linalg.solve(scaled, np.eye(9)[:, :2])[:, range(2), range(2)] / scale[:, :2] ** 2
    sigma: Floats = np.sqrt(np.abs(inverse).mean(axis=1))
    return sigma


def _gathered(
    image: Image, seeds_px: Floats, origin: Floats, frames: LocalFrames, windows: Windows
) -> _Pixels:
    """Collect the pixels near the two lines of each corner, in the frame of its `origin`."""
    rows, columns = image.shape
    strips, wanted = _strips(seeds_px - origin, frames, windows)
    asked = wanted.sum(axis=1)
    x, y = strips[:, 1][wanted], strips[:, 2][wanted]
    column, row = x + np.repeat(origin[:, 0], asked), y + np.repeat(origin[:, 1], asked)
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    place = (row * columns + column).astype(np.intp)
    filled = np.arange(max(int(asked.max()), 1)) < asked[:, None]
    grey, places = np.zeros(filled.shape), np.zeros((len(filled), 3, filled.shape[1]))
    grey[filled] = inside * image.ravel().take(place, mode="clip")
    for k, values in enumerate((1.0, x, y)):
        places[:, k][filled] = inside * values
    return _Pixels(grey, places, places[:, 0].sum(axis=1) / np.maximum(asked, 1))


def _strips(
    shift: Floats, frames: LocalFrames, windows: Windows
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return strips of pixels along the lines, as `_Pixels.places`, and which of them to use.

    A strip follows its line in steps of one pixel along the axis to which the line lies nearer.
    """
    count = len(shift)
    # area / side is the distance between neighbouring parallel lines of the grid
    apart = np.abs(frames.areas_px2)[:, None] / frames.sides_px
    band = np.minimum(windows.band_px[:, None] / apart, windows.margin_squares)
    each, both = np.arange(count)[:, None], np.arange(2)
    main = np.abs(frames.axes).argmax(axis=1)
    along, aside = frames.axes[each, main, both], frames.axes[each, 1 - main, both]
    length = int((windows.reach_squares.max(axis=2) * np.abs(along)).max() + 1.5)
    width = int((band * apart * frames.sides_px / np.abs(along)).max() + 1.5)
    steps = np.arange(-length, length + 1.0, windows.stride_px)
    middle = np.rint(
        shift[each, 1 - main, None] + (aside / along)[..., None] * (steps - shift[each, main, None])
    )
    strips = np.ones((count, 3, 2, len(steps), 2 * width + 1))
    strips[each, 1 + main, both] = steps[:, None]
    strips[each, 2 - main, both] = middle[..., None] + np.arange(-width, width + 1.0)
    places: Floats = strips.reshape(count, 3, -1)
    return places, _in_window(places, shift, frames, windows, band)


def _in_window(
    places: Floats, shift: Floats, frames: LocalFrames, windows: Windows, band: Floats
) -> NDArray[np.bool_]:
    """Tell which pixels of both strips take part, each only once, shape (n, m)."""
    squares_from_places = np.empty((len(shift), 2, 3))
    (a, b), (c, d) = frames.axes.transpose(1, 2, 0)
    squares_from_places[..., 1:] = (
        np.array([[d, -b], [-c, a]]).transpose(2, 0, 1) / frames.areas_px2[:, None, None]
    )
    squares_from_places[..., 0] = -(squares_from_places[..., 1:] @ shift[..., None])[..., 0]
    squares = squares_from_places @ places
    back, forth = windows.reach_squares.transpose(2, 0, 1)[..., None]
    wanted: NDArray[np.bool_] = ((squares >= -back) & (squares <= forth)).all(axis=1)
    half = places.shape[2] // 2
    near_across = np.abs(squares[:, 1]) <= band[:, :1]
    wanted[:, :half] &= near_across[:, :half]
    wanted[:, half:] &= np.abs(squares[:, 0, half:]) <= band[:, 1:]
    wanted[:, half:] &= ~near_across[:, half:]
    return wanted


@functools.cache
def _step_table() -> tuple[Floats, Floats]:
    """Blurred step from −1 to 1 at the left end of each cell of the table, and its rise per cell.

    The line through both is tangent in the middle of the cell: off by 1e-6 at most.
    """
    middle = (np.arange(2 * TABLE_HALF) - TABLE_HALF + 0.5) / CELLS_PER_BLUR
    step = np.array([math.erf(value) for value in middle * math.sqrt(0.5)])
    rise = math.sqrt(2 / math.pi) / CELLS_PER_BLUR * np.exp(-0.5 * middle**2)
    rise[[0, -1]] = 0
    return step - 0.5 * rise, rise


def _steps(
    state: Floats, pixels: _Pixels, curvatures: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return, shape (n, 2, m) each: distance from both lines, place along them, step, its rise.

    Distances and rises are in cells of the table.
    """
    cells = CELLS_PER_BLUR / state[:, 4]
    (cos1, cos2), (sin1, sin2) = np.cos(state[:, 2:4]).T, np.sin(state[:, 2:4]).T
    lines = np.empty((len(state), 4, 3))
    lines[:, 0, 1], lines[:, 0, 2] = -sin1 * cells, cos1 * cells
    lines[:, 1, 1], lines[:, 1, 2] = sin2 * cells, -cos2 * cells
    lines[:, 2, 1], lines[:, 2, 2] = cos1, sin1
    lines[:, 3, 1], lines[:, 3, 2] = cos2, sin2
    lines[..., 0] = -(lines[..., 1:] @ state[:, :2, None])[..., 0]
    lines = lines @ pixels.places
    distance, along = lines[:, :2], lines[:, 2:]
    distance -= (0.5 * cells[:, None] * curvatures)[..., None] * along**2
    steps, rises = _step_table()
    place = distance + TABLE_HALF
    left = np.floor(place)
    place -= left
    cell = left.astype(np.intp)
    rise = rises.take(cell, mode="clip")
    place *= rise
    place += steps.take(cell, mode="clip")
    return distance, along, place, rise


def _light_and_contrast(state: Floats, pixels: _Pixels, curvatures: Floats) -> Floats:
    """First a, g and b, shape (n, 4), for the geometry in `state`: a linear fit with g added."""
    # every third pixel will do for a start
    pixels = _Pixels(pixels.grey[:, ::3], pixels.places[..., ::3], pixels.coverage)
    _, _, step, _ = _steps(state, pixels, curvatures)
    crossing = (step[:, 0] * step[:, 1] * pixels.places[:, 0])[:, None]
    columns = np.concatenate([pixels.places, crossing], axis=1)
    normal = columns @ columns.transpose(0, 2, 1)
    normal[:, range(4), range(4)] += 1e-9
    right = columns @ pixels.grey[:, :, None]
    solution: Floats = np.linalg.solve(normal, right)[..., 0]
    solution[:, 1:3] /= np.maximum(solution[:, :1], 1.0)
    return solution


def _terms(state: Floats, pixels: _Pixels, curvatures: Floats) -> Floats:
    """Return what derivatives consist of (see `_by_state`) and the residual, shape (n, 10, m)."""
    distance, along, step, rise = _steps(state, pixels, curvatures)
    light = state[:, 6:7] * pixels.places[:, 1]
    light += state[:, 7:8] * pixels.places[:, 2]
    light += pixels.places[:, 0]
    terms = np.empty((len(state), 10, light.shape[1]))
    rise *= step[:, ::-1]
    np.multiply(rise, light[:, None], out=terms[:, :2])
    np.multiply(terms[:, :2], along, out=terms[:, 2:4])
    distance *= terms[:, :2]
    np.add(distance[:, 0], distance[:, 1], out=terms[:, 4])
    crossing = step[:, 0] * step[:, 1]
    terms[:, 5] = light
    np.multiply(light, crossing, out=terms[:, 8])
    crossing *= state[:, 8:9]
    crossing += state[:, 5:6]
    np.multiply(pixels.places[:, 1:], crossing[:, None], out=terms[:, 6:8])
    crossing *= light
    np.subtract(pixels.grey, crossing, out=terms[:, 9])
    return terms


def _by_state(state: Floats, curvatures: Floats) -> Floats:
    """∂model/∂state as combinations of the first nine of `_terms`, shape (n, 9, 9).

    Turning a line also moves the foot of the perpendicular along the bend; with κ d below 0.01
    this is left out.
    """
    cosine, sine = np.cos(state[:, 2:4]), np.sin(state[:, 2:4])
    slope = state[:, 8] * CELLS_PER_BLUR / state[:, 4]
    result = np.zeros((len(state), 9, 9))
    result[:, 0, :2], result[:, 1, :2] = sine * [1, -1], cosine * [-1, 1]
    result[:, 0, 2:4], result[:, 1, 2:4] = cosine * curvatures, sine * curvatures
    result[:, 2, 2], result[:, 3, 3] = -1, 1
    result[:, :4] *= slope[:, None, None]
    result[:, 4, 4] = -state[:, 8] / state[:, 4]
    result[:, range(5, 9), range(5, 9)] = 1
    return result


def _levenberg_marquardt(
    state: Floats, pixels: _Pixels, curvatures: Floats, settled_px: float, *, iterations: int = 12
) -> tuple[Floats, Floats, Floats]:
    """Return the fitted state, JᵀJ at it, and the sum of squared residuals of every corner.

    Only corners that still move are worked on. The last step, being short, is taken unseen.
    """
    count = len(state)
    state, trial = state.copy(), state
    cost, normal, right = np.full(count, np.inf), np.zeros((count, 9, 9)), np.zeros((count, 9))
    damping = np.full(count, 1e-3)
    moving = np.arange(count)
    for _ in range(iterations):
        new = _equations(trial, pixels.of(moving), curvatures[moving])
        better = new[0] <= cost[moving]
        damping[moving] *= np.where(better, 0.1, 10)
        taken = moving[better]
        state[taken] = trial[better]
        cost[taken], normal[taken], right[taken] = (part[better] for part in new)
        trial = _stepped(state[moving], normal[moving], right[moving], damping[moving])
        step = trial - state[moving]
        still = np.abs(step[:, :2]).max(axis=1) >= settled_px
        last = moving[~still]
        state[last] = trial[~still]
        cost[last] -= (step[~still] * right[last]).sum(axis=1)
        moving, trial = moving[still], trial[still]
        if len(moving) == 0:
            break
    return state, normal, cost


def _equations(state: Floats, pixels: _Pixels, curvatures: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the sum of squared residuals (n,), JᵀJ (n, 9, 9) and Jᵀr (n, 9)."""
    products = np.empty((len(state), 10, 10))
    at_once = 1 + PIXELS_AT_ONCE // pixels.grey.shape[1]
    for first in range(0, len(state), at_once):
        part = slice(first, first + at_once)
        some = _Pixels(pixels.grey[part], pixels.places[part], pixels.coverage[part])
        terms = _terms(state[part], some, curvatures[part])
        np.matmul(terms, terms.transpose(0, 2, 1), out=products[part])
    by_state = _by_state(state, curvatures)
    normal = by_state @ products[:, :9, :9] @ by_state.transpose(0, 2, 1)
    right = (by_state @ products[:, :9, 9:])[..., 0]
    return products[:, 9, 9], normal, right


def _stepped(state: Floats, normal: Floats, right: Floats, damping: Floats) -> Floats:
    """Take a damped Gauss–Newton step, the blur at most halving and staying physical."""
    diagonal = np.arange(9)
    damped = normal.copy()
    damped[:, diagonal, diagonal] *= 1 + damping[:, None]
    damped[:, diagonal, diagonal] += 1e-9
    step = np.linalg.solve(damped, right[..., None])[..., 0]
    # a centre moves by at most 3 px and a line by half a radian at once
    step[:, :4] = np.clip(step[:, :4], [-3, -3, -0.5, -0.5], [3, 3, 0.5, 0.5])
    trial: Floats = state + step
    trial[:, 4] = np.clip(trial[:, 4], np.maximum(0.5 * state[:, 4], LEAST_BLUR_PX), 50)
    return trial
