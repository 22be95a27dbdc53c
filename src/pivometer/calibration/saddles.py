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
    """

    reach_squares: Floats
    band_px: Floats
    margin_squares: float


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
    """Grey values and places of the m pixels of each corner; `inside` is 0 for padding."""

    grey: Floats
    x: Floats
    y: Floats
    inside: Floats
    coverage: Floats

    def of(self, corners: NDArray[np.intp]) -> _Pixels:
        """Return the pixels of some of the corners."""
        if len(corners) == len(self.grey):
            return self
        parts = (self.grey, self.x, self.y, self.inside, self.coverage)
        return _Pixels(*(part[corners] for part in parts))


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
        Stop when no centre moves by more than this, px. Convergence is quadratic near the end:
        the error that is left is a small fraction of the last step.
    """
    origin = np.rint(seeds_px)
    pixels = _gathered(image, seeds_px, origin, frames, windows)
    state = np.empty((len(seeds_px), 9))
    state[:, :2] = seeds_px - origin
    state[:, 2:4] = frames.angles
    state[:, 4] = blur_px
    state[:, 5:] = 0
    state[:, 5:] = _light_and_contrast(state, pixels, frames.curvatures)
    state, normal, square_sum = _levenberg_marquardt(state, pixels, frames.curvatures, settled_px)
    freedom = np.maximum(pixels.inside.sum(axis=1) - 9, 1)
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
    inverse = np.linalg.inv(scaled)[:, range(2), range(2)] / scale[:, :2] ** 2
    sigma: Floats = np.sqrt(np.abs(inverse).mean(axis=1))
    return sigma


def _gathered(
    image: Image, seeds_px: Floats, origin: Floats, frames: LocalFrames, windows: Windows
) -> _Pixels:
    """Collect the pixels near the two lines of each corner, in the frame of its `origin`."""
    rows, columns = image.shape
    corners = np.einsum("nij,nj->ni", np.abs(frames.axes), windows.reach_squares.max(axis=2))
    half = int(np.ceil(corners.max())) + 1
    steps = np.arange(-half, half + 1, dtype=np.float64)
    x, y = (part.ravel() for part in np.meshgrid(steps, steps))
    shift = seeds_px - origin
    inverse = np.linalg.inv(frames.axes)
    u, v = (
        inverse[:, k, :1] * (x - shift[:, :1]) + inverse[:, k, 1:] * (y - shift[:, 1:])
        for k in (0, 1)
    )
    # |det| / side is the distance between neighbouring parallel lines of the grid
    apart = np.abs(np.linalg.det(frames.axes))[:, None] / frames.sides_px
    band = np.minimum(windows.band_px[:, None] / apart, windows.margin_squares)
    back, forth = -windows.reach_squares[..., 0], windows.reach_squares[..., 1]
    wanted = (u >= back[:, :1]) & (u <= forth[:, :1]) & (v >= back[:, 1:]) & (v <= forth[:, 1:])
    wanted &= (np.abs(v) <= band[:, :1]) | (np.abs(u) <= band[:, 1:])
    corner, place = np.nonzero(wanted)
    column = (origin[corner, 0] + x[place]).astype(np.intp)
    row = (origin[corner, 1] + y[place]).astype(np.intp)
    within = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    asked = np.bincount(corner, minlength=len(seeds_px))
    corner, place, column, row = (part[within] for part in (corner, place, column, row))
    count = np.bincount(corner, minlength=len(seeds_px))
    slot = np.arange(len(corner)) - np.repeat(np.cumsum(count) - count, count)
    padded = np.zeros((4, len(seeds_px), max(int(count.max()), 1)))
    padded[:, corner, slot] = (image[row, column], x[place], y[place], np.ones(len(corner)))
    return _Pixels(padded[0], padded[1], padded[2], padded[3], count / np.maximum(asked, 1))


def _steps(
    state: Floats, pixels: _Pixels, curvatures: Floats
) -> tuple[Floats, Floats, Floats, Floats, Floats, Floats]:
    """Return erf of both steps, and distance and place along the lines (d₁, d₂, t₁, t₂)."""
    from scipy.special import erf

    dx, dy = pixels.x - state[:, :1], pixels.y - state[:, 1:2]
    cosine, sine = np.cos(state[:, 2:4]), np.sin(state[:, 2:4])
    t1 = cosine[:, :1] * dx + sine[:, :1] * dy
    t2 = cosine[:, 1:] * dx + sine[:, 1:] * dy
    d1 = cosine[:, :1] * dy - sine[:, :1] * dx - (0.5 * curvatures[:, :1]) * t1**2
    d2 = sine[:, 1:] * dx - cosine[:, 1:] * dy - (0.5 * curvatures[:, 1:]) * t2**2
    scale = np.sqrt(0.5) / state[:, 4:5]
    return erf(scale * d1), erf(scale * d2), d1, d2, t1, t2


def _light_and_contrast(state: Floats, pixels: _Pixels, curvatures: Floats) -> Floats:
    """First a, g and b, shape (n, 4), for the geometry in `state`: a linear fit with g added."""
    erf1, erf2, *_ = _steps(state, pixels, curvatures)
    columns = np.stack([pixels.inside, pixels.x, pixels.y, erf1 * erf2 * pixels.inside], axis=1)
    normal = columns @ columns.transpose(0, 2, 1)
    normal[:, range(4), range(4)] += 1e-9
    right = columns @ pixels.grey[:, :, None]
    solution: Floats = np.linalg.solve(normal, right)[..., 0]
    solution[:, 1:3] /= np.maximum(solution[:, :1], 1.0)
    return solution


def _residual_and_jacobian(
    state: Floats, pixels: _Pixels, curvatures: Floats
) -> tuple[Floats, Floats]:
    """Residual (n, m) and ∂model/∂state (n, 9, m), both zero on padding."""
    erf1, erf2, d1, d2, t1, t2 = _steps(state, pixels, curvatures)
    cosine, sine = np.cos(state[:, 2:4]), np.sin(state[:, 2:4])
    light = pixels.inside + state[:, 6:7] * pixels.x + state[:, 7:8] * pixels.y
    blur, contrast = state[:, 4:5], state[:, 8:9] * light
    peak = np.sqrt(2 / np.pi) / blur
    slope1 = contrast * erf2 * (peak * np.exp(-0.5 * (d1 / blur) ** 2))
    slope2 = contrast * erf1 * (peak * np.exp(-0.5 * (d2 / blur) ** 2))
    bent1, bent2 = slope1 * (curvatures[:, :1] * t1), slope2 * (curvatures[:, 1:] * t2)
    crossing = erf1 * erf2
    unlit = state[:, 5:6] + state[:, 8:9] * crossing
    jacobian = np.empty((len(state), 9, pixels.x.shape[1]))
    jacobian[:, 0] = sine[:, :1] * slope1 - sine[:, 1:] * slope2
    jacobian[:, 0] += cosine[:, :1] * bent1 + cosine[:, 1:] * bent2
    jacobian[:, 1] = cosine[:, 1:] * slope2 - cosine[:, :1] * slope1
    jacobian[:, 1] += sine[:, :1] * bent1 + sine[:, 1:] * bent2
    jacobian[:, 2] = -t1 * slope1 - d1 * bent1
    jacobian[:, 3] = t2 * slope2 + d2 * bent2
    jacobian[:, 4] = -(slope1 * d1 + slope2 * d2) / blur
    jacobian[:, 5] = light
    jacobian[:, 6], jacobian[:, 7] = unlit * pixels.x, unlit * pixels.y
    jacobian[:, 8] = light * crossing
    return pixels.grey - light * unlit, jacobian


def _levenberg_marquardt(
    state: Floats, pixels: _Pixels, curvatures: Floats, settled_px: float, *, iterations: int = 15
) -> tuple[Floats, Floats, Floats]:
    """Return the fitted state, JᵀJ at it, and the sum of squared residuals of every corner.

    Only corners that still move are worked on: most settle in three steps, a few take ten.
    """
    state = state.copy()
    cost, normal, right = _equations(state, pixels, curvatures)
    damping = np.full(len(state), 1e-3)
    moving = np.arange(len(state))
    for _ in range(iterations):
        trial = _stepped(state[moving], normal[moving], right[moving], damping[moving])
        new = _equations(trial, pixels.of(moving), curvatures[moving])
        better = new[0] <= cost[moving]
        damping[moving] = np.where(better, damping[moving] * 0.1, damping[moving] * 10)
        length = np.abs(trial[:, :2] - state[moving, :2]).max(axis=1)
        taken = moving[better]
        state[taken] = trial[better]
        cost[taken], normal[taken], right[taken] = (part[better] for part in new)
        moving = moving[length >= settled_px]
        if len(moving) == 0:
            break
    return state, normal, cost


def _equations(state: Floats, pixels: _Pixels, curvatures: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the sum of squared residuals (n,), JᵀJ (n, 9, 9) and Jᵀr (n, 9)."""
    residual, jacobian = _residual_and_jacobian(state, pixels, curvatures)
    normal: Floats = jacobian @ jacobian.transpose(0, 2, 1)
    right: Floats = (jacobian @ residual[:, :, None])[..., 0]
    return (residual**2).sum(axis=1), normal, right


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
