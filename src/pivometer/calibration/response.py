"""Whether a camera records light linearly, told by the edges of the board's squares.

A blurred straight edge looks the same from both of its sides. A response that is not linear, as of
a camera with gamma, lifts its middle: y = Φ + κ Φ (1 − Φ) to second order, from dark to bright,
whichever side is dark. A lens that blurs to one side does so, too, but the other way at edges of
opposite polarity, of which a board has as many. What is symmetric (the blur's shape, sharpening,
the ringing of JPEG) changes how large κ is, not whether it is zero.

κ is what a fit of edges without gamma leaves over. The exponent is that with which computed edges,
fitted alike, leave over as much.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pivometer._arrays import Floats
from pivometer.calibration.board import Board, BoardView
from pivometer.calibration.saddles import Image
from pivometer.cameras.mosaic import evened, is_mosaic

MOST_EDGES = 24
"""Edges of a view that are looked at. Twelve views tell κ to 0.01, compressed as JPEG to 0.03."""
LEAST_VIEWS = 5
"""Views whose scatter says how certain κ is."""
LENGTH_PX = 24
"""Of the middle of each edge."""
BLURS, MORE_PX = 4.0, 1.5
"""How far to either side of an edge its pixels are looked at, in blurs and px."""
SQUARES = 0.4
"""Not further than this part of a square, where the next edge is as far."""
END_BLURS, END_PX, END_SQUARES = 3.0, 1.0, 0.15
"""How far from its corners an edge begins."""
START_BLUR_PX = 0.7
"""Of a lens in focus, the pixel's own blur of 0.29 px in it."""
FIT_ROUNDS = 6
LEAST_PIXELS = 60
CLIPPED_PART = 0.01
LEAST_STEP_NOISES = 6.0
OUTLIER_SIGMAS = 4.0

SIGNIFICANT_SIGMAS = 5.0
LEAST_BEND = 0.08
"""κ of gamma 1.15, which moves edges by a twentieth of their blur. Linear cameras gave up to 0.02,
with JPEG of quality 80 up to 0.06 (docs/adr/0030-camera-response.md)."""

GAMMAS = np.array([1.0, 1.25, 1.5, 1.8, 2.2, 2.7, 3.3, 4.0])
LEAST_LEVEL = 2e-3
"""Of the bright level: what is darker than a five-hundredth of it is as good as black."""


@dataclass(frozen=True, slots=True, eq=False)
class CameraResponse:
    """How far a camera is from recording light linearly.

    Parameters
    ----------
    bend
        κ of the board's edges, part of their step: 0 if linear, 0.6 of gamma 2.2.
    bend_u
        Its standard uncertainty, from the scatter between views and between edges.
    gamma
        The exponent that gives this bend: 1 if it is 0 or less, 4 at most.
    gamma_u
        Its standard uncertainty, as far as that of the bend causes it.
    view_count
        Views that it rests on.
    """

    bend: float
    bend_u: float
    gamma: float
    gamma_u: float
    view_count: int

    @property
    def linear(self) -> bool:
        """Whether nothing shows that it is not, or too little to matter."""
        return abs(self.bend) < max(SIGNIFICANT_SIGMAS * self.bend_u, LEAST_BEND)


@dataclass(frozen=True, slots=True, eq=False)
class EdgeBends:
    """What the edges of one view of the board show.

    Parameters
    ----------
    bend, sigma
        κ of each edge and its standard deviation, shape (n,).
    dark_part
        The dark level over the bright one, for the median edge.
    blur_px
        Standard deviation of the blur, for the median edge.
    half_px
        How far to either side of the edges pixels were looked at.
    """

    bend: Floats
    sigma: Floats
    dark_part: float
    blur_px: float
    half_px: int


def edge_bends(image: Image, view: BoardView, board: Board) -> EdgeBends | None:
    """Measure how the edges between neighbouring corners of a board bend; `None` if none can be.

    Parameters
    ----------
    image
        The grey image, raw, shape (rows, columns).
    view
        The corners found in it.
    board
        The board.
    """
    starts, ends = _edges(view, board)
    if len(starts) == 0:
        return None
    grey = evened(image) if is_mosaic(image) else image
    top = 255.0 if image.dtype == np.uint8 else float(image.max())
    blur, found = START_BLUR_PX, None
    for _ in range(3):
        window = _Window.of(starts, ends, blur, board)
        if window is None:
            return None
        steps = _Steps.seen(grey, top, starts, ends, window)
        if len(steps.grey) == 0:
            return None
        found = _bends(steps, np.full(len(steps.grey), blur), window.half_px)
        if found is None:
            return None
        settled = abs(found.blur_px / blur - 1) < 0.15
        blur = max(found.blur_px, 0.35)
        if settled:
            break
    return found


def camera_response(seen: Sequence[EdgeBends]) -> CameraResponse | None:
    """Return what the views of one camera say together; `None` of fewer than five views."""
    if len(seen) < LEAST_VIEWS:
        return None
    bend = np.concatenate([one.bend for one in seen])
    sigma = np.concatenate([one.sigma for one in seen])
    number = np.repeat(np.arange(len(seen)), [len(one.bend) for one in seen])
    weight = 1 / np.maximum(sigma, np.median(sigma)) ** 2
    middle = np.median(bend)
    scatter = 1.4826 * np.median(np.abs(bend - middle))
    weight = weight * (np.abs(bend - middle) <= OUTLIER_SIGMAS * scatter + 1e-9)
    mean = float((weight * bend).sum() / weight.sum())
    pulls = weight * (bend - mean)
    # Edges of a view may miss together; few views that do by chance agree must not look certain.
    views = np.square(np.bincount(number, pulls, len(seen))).sum() * len(seen) / (len(seen) - 1)
    u = float(np.sqrt(max(views, np.square(pulls).sum())) / weight.sum())
    return CameraResponse(mean, u, *_gamma(mean, u, seen), len(seen))


def _gamma(bend: float, bend_u: float, seen: Sequence[EdgeBends]) -> tuple[float, float]:
    """Return the exponent that gives edges as these a bend, and its standard uncertainty."""
    typical = sorted(seen, key=lambda one: one.blur_px)[len(seen) // 2]
    dark = float(np.median([one.dark_part for one in seen]))
    bends = np.maximum.accumulate(_bends_of_gammas(dark, typical.blur_px, typical.half_px))
    gamma = float(np.interp(bend, bends, GAMMAS))
    slope = np.gradient(bends, GAMMAS)
    return gamma, bend_u / max(float(np.interp(gamma, GAMMAS, slope)), 0.05)


def _bends_of_gammas(dark_part: float, blur_px: float, half_px: int) -> Floats:
    """Return κ that each of `GAMMAS` gives to edges between a dark level and 1."""
    across = np.tile(np.linspace(-half_px, half_px, 16 * half_px + 1), (len(GAMMAS), 1))
    used = np.ones_like(across)
    dark = np.maximum(dark_part, LEAST_LEVEL) ** GAMMAS[:, None]
    blur = np.full(len(GAMMAS), blur_px)
    for _ in range(2):  # until the fit finds the blur that was found in the images
        light = dark + (1 - dark) * _pixel_step(across, blur[:, None])
        steps = _Steps(light ** (1 / GAMMAS[:, None]), across, 0 * across, used)
        fit = _fitted(steps, np.full(len(GAMMAS), blur_px))
        blur *= np.clip(blur_px / fit.blur_px, 0.7, 1.4)
    return fit.bend


def _pixel_step(across: Floats, blur_px: Floats) -> Floats:
    """Return the mean over a pixel of a step whose whole blur, the pixel's too, is `blur_px`."""
    blur = np.sqrt(np.maximum(blur_px**2 - 1 / 12, 0.15**2))
    step: Floats = blur * (_summed((across + 0.5) / blur) - _summed((across - 0.5) / blur))
    return step


def _summed(u: Floats) -> Floats:
    """Return the integral of Φ up to u."""
    from scipy.special import ndtr

    total: Floats = u * ndtr(u) + np.exp(-u * u / 2) / np.sqrt(2 * np.pi)
    return total


def _edges(view: BoardView, board: Board) -> tuple[Floats, Floats]:
    """Return both ends of edges of squares, shape (n, 2) each.

    As many are chosen of either direction and either polarity, for a lopsided lens to cancel.
    """
    row = np.full(board.corner_count, -1)
    row[view.ids] = np.arange(len(view.ids))
    edges = board.edges[(row[board.edges] >= 0).all(axis=1)]
    step = np.diff(board.columns_rows[edges], axis=1)[:, 0, 0]
    kind = 2 * step + board.columns_rows[edges[:, 0]].sum(axis=1) % 2
    kinds = [np.flatnonzero(kind == k) for k in range(4)]
    most = min(MOST_EDGES // 4, *(len(one) for one in kinds))
    chosen = np.concatenate([one[np.arange(most) * len(one) // max(most, 1)] for one in kinds])
    return view.pixels[row[edges[chosen, 0]]], view.pixels[row[edges[chosen, 1]]]


@dataclass(frozen=True, slots=True)
class _Window:
    """Which pixels beside an edge count: so far across it, and so far from its corners."""

    half_px: int
    end_px: float

    @classmethod
    def of(cls, starts: Floats, ends: Floats, blur_px: float, board: Board) -> _Window | None:
        """Return the window for a blur, or `None` if the squares are too small for it."""
        length = np.linalg.norm(ends - starts, axis=1)
        side = float(np.percentile(length, 10))
        half = min(np.ceil(BLURS * blur_px + MORE_PX), SQUARES * side)
        if board.marker_mm is not None:
            margin = (1 - board.marker_mm / board.square_mm) / 2
            half = min(half, margin * side - 1.5 * blur_px)
        end = max(END_BLURS * blur_px + END_PX, END_SQUARES * side)
        if half < BLURS * blur_px - 1 or float(np.median(length)) < 2 * end + 4:
            return None
        return cls(int(half), end)


@dataclass(frozen=True, slots=True, eq=False)
class _Steps:
    """Pixels of n edges, shape (n, m) each.

    Grey level, distance across the edge (px), place along it (−1 to 1 from corner to corner), and
    whether it counts, 0 or 1.
    """

    grey: Floats
    across: Floats
    along: Floats
    used: Floats

    @classmethod
    def seen(
        cls, image: Image, top: float, starts: Floats, ends: Floats, window: _Window
    ) -> _Steps:
        """Take the pixels around each edge, without edges that the sensor's limits clip."""
        x, y = _beside(starts, ends, window.half_px)
        middle, length = (starts + ends) / 2, np.linalg.norm(ends - starts, axis=1)[:, None]
        dx, dy = np.split((ends - starts) / length, 2, axis=1)
        u, v = x - middle[:, :1], y - middle[:, 1:]
        along, across = u * dx + v * dy, v * dx - u * dy
        height, width = image.shape
        used = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        used &= np.abs(along) < length / 2 - window.end_px
        row, column = (np.clip(v, 0, n - 1).astype(np.intp) for v, n in ((y, height), (x, width)))
        grey = image[row, column].astype(np.float64)
        clipped = ((grey >= top) | (grey <= 0)) & used
        count = used.sum(axis=1)
        fit = (count >= LEAST_PIXELS) & (clipped.sum(axis=1) <= CLIPPED_PART * count)
        values = (grey, across, 2 * along / length, used.astype(np.float64))
        return cls(*(one[fit] for one in values))


def _beside(starts: Floats, ends: Floats, half_px: int) -> tuple[Floats, Floats]:
    """Return x and y of the whole pixels around the middles of edges, shape (n, m) each.

    One for each step along the axis that an edge is nearer to, and each across it.
    """
    steps, beside = np.arange(LENGTH_PX) - LENGTH_PX // 2, np.arange(-half_px, half_px + 1)
    (u, v), (x, y) = (ends - starts).T, ((starts + ends) / 2).T
    steep = np.abs(v) > np.abs(u)
    slope = np.where(steep, u, v) / np.where(steep, v, u)
    middle, aside = np.where(steep, y, x)[:, None], np.where(steep, x, y)[:, None]
    at = np.rint(middle) + steps
    other = np.rint(aside + (at - middle) * slope[:, None])[..., None] + beside
    at = np.broadcast_to(at[..., None], other.shape)
    lying = ~steep[:, None, None]
    x, y = np.where(lying, at, other), np.where(lying, other, at)
    return x.reshape(len(x), -1), y.reshape(len(y), -1)


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Of each edge: κ and its deviation, noise², levels at both sides (n, 2), and blur."""

    bend: Floats
    sigma: Floats
    noise: Floats
    levels: Floats
    blur_px: Floats


def _bends(steps: _Steps, blur_px: Floats, half_px: int) -> EdgeBends | None:
    """Return the bends of the edges that could be fitted, `None` if they are few."""
    fit = _fitted(steps, blur_px)
    step = fit.levels[:, 1] - fit.levels[:, 0]
    good = np.isfinite(fit.bend) & (np.abs(step) > LEAST_STEP_NOISES * np.sqrt(fit.noise))
    good &= (fit.sigma < 1) & (fit.levels.max(axis=1) > 0)
    if good.sum() < MOST_EDGES // 4:
        return None
    levels = fit.levels[good]
    dark = float(np.median(levels.min(axis=1) / levels.max(axis=1)))
    bend = (fit.bend * np.sign(step))[good]
    return EdgeBends(bend, fit.sigma[good], dark, float(np.median(fit.blur_px[good])), half_px)


def _fitted(steps: _Steps, blur_px: Floats) -> _Fit:
    """Fit blurred steps by Gauss–Newton; κ is what their rest shows of Φ (1 − Φ).

    Both sides' levels may slope, and the edge may bow. The third Hermite polynomial takes what the
    blur's shape leaves, since pixels do not lie symmetrically about an edge.
    """
    shape, levels = _start(steps, blur_px)
    for _ in range(FIT_ROUNDS):
        design, rest = _linearized(steps, shape, levels)
        change = _solved(design[..., :10], rest)[0]
        levels = levels + change[:, :6]
        shape = shape + np.clip(change[:, 6:10], -0.3, 0.3) * [1, 1, 1, 0]
        growth = np.clip(change[:, 9] / shape[:, 3], -0.3, 0.3)
        shape[:, 3] = np.clip(shape[:, 3] * np.exp(growth), 0.25, 10)
    design, rest = _linearized(steps, shape, levels)
    change, variance = _solved(design, rest)
    left = rest - (design @ change[..., None])[..., 0]
    freedom = np.maximum(steps.used.sum(axis=1) - design.shape[-1], 1)
    noise = np.square(left).sum(axis=1) / freedom
    sigma = np.sqrt(np.maximum(variance * noise, 0))
    return _Fit(change[:, -1], sigma, noise, levels[:, :2], shape[:, 3])


def _start(steps: _Steps, blur_px: Floats) -> tuple[Floats, Floats]:
    """Return where a fit begins.

    Offset, tilt, bow and blur, (n, 4); levels of both sides, their slopes across and along, (n, 6).
    """
    shape = np.zeros((len(blur_px), 4))
    shape[:, 3] = blur_px
    levels = np.zeros((len(blur_px), 6))
    for side, beyond in enumerate((steps.across < -1, steps.across > 1)):
        weight = steps.used * beyond
        levels[:, side] = (steps.grey * weight).sum(axis=1) / np.maximum(weight.sum(axis=1), 1)
    return shape, levels


def _linearized(steps: _Steps, shape: Floats, levels: Floats) -> tuple[Floats, Floats]:
    """Return the derivatives by levels, shape, blur's third moment and κ, (n, m, 12), and rests."""
    from scipy.special import ndtr

    offset, tilt, bow, blur = shape.T[..., None]
    d, s = steps.across, steps.along
    u = (d - offset - tilt * s - bow * s * s) / blur
    part, density = ndtr(u), np.exp(-u * u / 2) / np.sqrt(2 * np.pi)
    low, high = (levels[:, [i]] + levels[:, [i + 2]] * d + levels[:, [i + 4]] * s for i in (0, 1))
    slope = -(high - low) * density / blur
    third = (high - low) * density * (u**3 - 3 * u)
    bent = (levels[:, [1]] - levels[:, [0]]) * part * (1 - part)
    sides = [1 - part, part]
    columns = [*sides, *(d * p for p in sides), *(s * p for p in sides)]
    columns += [slope, slope * s, slope * s * s, slope * u, third, bent]
    design = np.stack(columns, axis=-1) * steps.used[..., None]
    return design, (steps.grey - low * (1 - part) - high * part) * steps.used


def _solved(design: Floats, rest: Floats) -> tuple[Floats, Floats]:
    """Return the least-squares solutions, (n, k), and the last unknown's variance per noise²."""
    transposed = np.swapaxes(design, 1, 2)
    scale = np.sqrt(np.maximum(np.square(design).sum(axis=1), 1e-30))
    normal = transposed @ design / scale[:, :, None] / scale[:, None, :]
    inverse = np.linalg.inv(normal + 1e-9 * np.eye(design.shape[-1]))
    right = (transposed @ rest[..., None])[..., 0] / scale
    solution: Floats = (inverse @ right[..., None])[..., 0] / scale
    return solution, inverse[:, -1, -1] / scale[:, -1] ** 2
