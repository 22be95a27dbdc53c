"""Both edges of a shaft, fitted together to the raw pixels of one image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats, checked, read_only
from pivometer.cameras.model import Camera
from pivometer.errors import ShaftNotFoundError
from pivometer.shaft.bands import EdgeLine, edge_lines, gather
from pivometer.shaft.detection import ShaftSeed
from pivometer.shaft.profile import BLUR_RANGE_PX, Bands, Fit, Model, linearize
from pivometer.shaft.silhouette import coimage_normal, normalized_line, outward_normals
from pivometer.shaft.weights import RowTrust, trust_rows

POINTS = 25
"""Points given along each edge: enough for an overlay and for undoing another distortion."""

SEARCH_PX = 4.0
"""Reach of the first search on each side of the seed: twice the 2 px a seed is good to."""

SEARCH_STEP_PX = 0.5
"""Half a pixel is within what the fit converges from (it does from 2 px and more)."""

SEARCH_WINDOW_PX = 3.0
"""Grey levels are compared over this far on each side in the first search."""

SEED_PENALTY_PER_PX2 = 0.02
"""What a square pixel away from the seed costs in the search, as a part of the best score of 1; it
keeps a strong highlight 4 px inside a glossy shaft from winning over a faint edge at the seed."""

INNER_PX = 5.0
OUTER_PX = 4.0
"""Reach of the fit to each side at usual blur. Wider windows meet highlights and clutter: on the
black glossy arm 6 px gave 0.030 px per edge, 4 to 5 px 0.016 to 0.023."""

CLEAR_PX = 3.0
"""Reach to both sides in chunks that the model does not fit: on the black arm this brought the
edges' error from 0.10 to 0.06 px rms and that of the largest RCM distance from 0.03 to 0.01 mm."""

MISFIT_TIMES = 1.3
"""A chunk whose mean square residual is over 1.3 times the noise's does not fit the model: chunks
have 200 pixels and more, so that noise alone scatters by 10 %. On the black arm 1.3, 1.5 and 2
gave edges good to 0.06, 0.08 and 0.10 px rms."""

CHUNK_ROWS = 24
"""Rows that share inside grey levels: on the black arm, 8, 12, 16 and 24 rows gave edges good to
0.125, 0.061, 0.061 and 0.056 px rms; longer ones would mix a collar with what is beside it."""

FIRST_BLUR_PX = 0.75
"""A lens of 0.7 px and the pixel's own 0.29 px: inside what the fit converges from."""

LARGEST_MISFIT_PART = 0.3
CLUTTER_TIMES = 2.0
LARGEST_NOISE_RISE = 1.15
"""Surroundings are cluttered, and the fit stays guarded, if more than 3 in 10 chunks have over
twice the noise's mean square (shot noise alone makes a bright chunk differ by up to 1.7, and the
ends of a white shaft before black spoil 2 in 10), or if the noise appears 15 % larger than with
grey levels of their own in every row."""

SHADED_SYSTEMATIC_PX = 0.01
CLUTTERED_SYSTEMATIC_PX = 0.02
"""What shading that no model has moves a whole edge by: on the white bearing and the black arm
(independently rendered, true cameras) edges were 0.009 and 0.02 px off at their middle where noise
alone stated 0.002 and 0.012 px. Added to each edge's offset and tilt where a limb is needed."""

TRIAL_ITERATIONS = 4
"""Iterations until that is decided."""

WIDE_INNER_PX = 12.0
WIDE_OUTER_PX = 6.0
"""Reach where nothing disturbs: a limb is told from a shift of its edge by what is further in."""

RISE_SIGMAS = 3.0
"""Grey levels are dropped where χ² rises by less than three standard deviations of their number."""

ITERATIONS = 9
FIRST_ITERATIONS = 5
"""Iterations before it is decided which chunks the model fits; then at most the rest."""

STEP_LIMIT_PX = np.array([1.0, 1.0, 1.0, 1.0, 0.2])
CONVERGED_CHI2 = 0.01
"""A step that gains less moves no estimate by more than a tenth of its uncertainty."""

LEAST_ROWS = 20
LEAST_ROW_PART = 0.25
LEAST_CONTRAST_NOISES = 2.0
LARGEST_SIGMA_PX = 0.5
LEAST_WIDTH_PX = 3.0
SEED_WIDTH_PX = 4.0
SEED_WIDTH_PART = 0.2
LARGEST_TAPER = 0.5
"""Refusals: fewer rows than 20 or a quarter of the seed's; contrast under twice the noise; an
edge known to no better than half a pixel; edges closer than 3 px, or whose distance differs from
the seed's by more than two seeds' errors and a fifth, or from end to end by more than a half."""


@dataclass(frozen=True, slots=True, eq=False)
class ShaftEdges:
    """The two edges of a shaft in one image, as independent straight lines.

    Parameters
    ----------
    camera
        Name of the camera.
    points_px
        Points along each edge in the raw image, shape (2, m, 2), px: exactly on the fitted line
        once undistorted.
    normals
        Coimage normals of the edges, shape (2, 3), unit, pointing away from the shaft, camera
        frame; (6).
    normals_covariance
        Covariance of both normals as one vector of six, shape (6, 6).
    sigma_px
        Standard uncertainty of each edge's offset where it is known best, shape (2,), px.
    angle_sigma_rad
        Standard uncertainty of each edge's angle, shape (2,), rad.
    width_px
        Distance between the edges half-way along, undistorted px.
    contrast
        Mean grey step across each edge, shape (2,), grey levels, whichever side is brighter.
    blur_px
        Standard deviation of the blur across the edges, lens and pixel together, px.
    residual_px
        Root mean square of single rows' offsets from the fitted edges, px.
    used_part
        Part of each edge's rows that counts, shape (2,).
    """

    camera: str
    points_px: Floats
    normals: Floats
    normals_covariance: Floats
    sigma_px: Floats
    angle_sigma_rad: Floats
    width_px: float
    contrast: Floats
    blur_px: float
    residual_px: float
    used_part: Floats

    def __post_init__(self) -> None:
        shapes: dict[str, tuple[int | None, ...]] = {
            "points_px": (2, None, 2),
            "normals": (2, 3),
            "normals_covariance": (6, 6),
            "sigma_px": (2,),
            "angle_sigma_rad": (2,),
            "contrast": (2,),
            "used_part": (2,),
        }
        for name, shape in shapes.items():
            object.__setattr__(self, name, read_only(checked(getattr(self, name), shape, name)))


def edge_normals(points_px: ArrayLike, camera: Camera) -> Floats:
    """Return the coimage normals of two edges from raw points on them, (22) and (6).

    Points of `ShaftEdges` give its normals back, and with another camera those that the same
    image would have given: so the calibration's uncertainty is carried through.

    Parameters
    ----------
    points_px
        Points on both edges, shape (..., 2, m, 2), raw px, in the same order along the shaft.
    camera
        The camera, which undoes the distortion.

    Returns
    -------
    numpy.ndarray
        Unit normals, shape (..., 2, 3), pointing away from the shaft, camera frame.

    Raises
    ------
    ShapeError
        If the shape differs, or all points of an edge are one.

    References
    ----------
    Wilson et al., eqs. (18), (22) and (6).

    Examples
    --------
    >>> camera = Camera("left", 640, 480, [1000, 1000], [320, 240], [0, 0])
    >>> edge_normals([[[310, 0], [310, 400]], [[330, 0], [330, 400]]], camera).round(3) + 0.0
    array([[-1.  ,  0.  , -0.01],
           [ 1.  ,  0.  , -0.01]])
    """
    points = camera.undistorted_pixels(checked(points_px, (-1, 2, None, 2), "points_px"))
    middle = points.mean(axis=-2)
    apart = points - middle[..., None, :]
    scatter = np.swapaxes(apart, -1, -2) @ apart
    direction = np.linalg.eigh(scatter)[1][..., 1]
    a, b = normalized_line(direction, middle, camera.calibration_matrix)
    inside = np.concatenate([b.mean(axis=-2), np.ones_like(b[..., 0, :1])], axis=-1)
    return outward_normals(coimage_normal(a, b), inside)


def fit_edges(image: ArrayLike, camera: Camera, seed: ShaftSeed) -> ShaftEdges:
    """Return both edges of a shaft by maximum likelihood on the raw pixels beside them.

    Offset and angle of both edges and the blur are common to the whole shaft; grey levels are
    free: outside in every row, inside in every chunk of rows, where they follow the limb of a
    round shaft. Rows that occlusion, collars or clutter spoil are found by their disagreement.

    Parameters
    ----------
    image
        The raw image, shape (height, width), any depth.
    camera
        Its camera.
    seed
        Where the edges roughly are, to about 2 px.

    Returns
    -------
    ShaftEdges
        The edges with their uncertainty.

    Raises
    ------
    ShaftNotFoundError
        If the pixels do not show two edges near the seed, with the reason.
    ShapeError
        If the image is not that of the camera.

    References
    ----------
    Wilson et al., section V, for what it replaces; `weights` and `profile` for the model.
    """
    pixels = checked(image, (camera.height, camera.width), "image")
    _refuse_outside(camera, seed)
    first = edge_lines(seed.edges_px, camera)
    width = _width_px(first)
    _refuse_width(camera, width, width)
    start = _search(pixels, camera, first)
    solution = _solve(pixels, camera, start, FIRST_BLUR_PX)
    _refuse(camera, solution, first)
    return _result(camera, solution)


@dataclass(frozen=True, slots=True, eq=False)
class _Solution:
    """A converged fit: the lines it started from, the pixels, the last linearization."""

    start: tuple[EdgeLine, EdgeLine]
    bands: Bands
    fit: Fit
    trust: RowTrust
    covariance: Floats  # of offset and tilt of both edges and the blur, (5, 5), px²

    @property
    def lines(self) -> tuple[EdgeLine, EdgeLine]:
        offset = self.fit.parameters
        return self.start[0].moved(*offset[:2]), self.start[1].moved(*offset[2:4])


def _width_px(lines: tuple[EdgeLine, EdgeLine]) -> float:
    return float(abs((lines[0].middle_px - lines[1].middle_px) @ lines[0].outward))


def _search(
    image: Floats, camera: Camera, lines: tuple[EdgeLine, EdgeLine]
) -> tuple[EdgeLine, EdgeLine]:
    """Return the lines moved to where most rows see a grey step, within reach of the seed."""
    half = _width_px(lines) / 2
    reach = SEARCH_PX + SEARCH_WINDOW_PX + 0.5
    bands = gather(
        image,
        camera,
        lines,
        inner_px=min(reach, half + SEARCH_PX),
        outer_px=reach,
        half_width_px=half,
        chunk_rows=1,
    )
    moves = [_best_move(bands, edge) for edge in range(2)]
    return lines[0].moved(*moves[0]), lines[1].moved(*moves[1])


def _best_move(bands: Bands, edge: int) -> tuple[float, float]:
    """Return the (offset, tilt) whose line collects most of the rows' grey steps."""
    positions = np.arange(-SEARCH_PX, SEARCH_PX + SEARCH_STEP_PX / 2, SEARCH_STEP_PX)
    steps, lever = _grey_steps(bands, edge, positions)
    if not steps.size:
        return 0.0, 0.0
    usual = float(np.median(steps.max(axis=1)))
    votes = steps / (steps + max(usual, 1e-9))  # a strong edge has one vote, not a hundred
    offset, tilt = (grid.ravel() for grid in np.meshgrid(positions, positions, indexing="ij"))
    reached = np.abs(offset) + np.abs(tilt) <= SEARCH_PX
    offset, tilt = offset[reached], tilt[reached]
    index = np.rint((offset[:, None] + tilt[:, None] * lever + SEARCH_PX) / SEARCH_STEP_PX)
    found = votes[np.arange(lever.size), np.clip(index.astype(np.intp), 0, positions.size - 1)]
    score = found.mean(axis=1) - SEED_PENALTY_PER_PX2 * (offset**2 + tilt**2 / 3)
    best = int(np.argmax(score))
    return float(offset[best]), float(tilt[best])


def _grey_steps(bands: Bands, edge: int, positions: Floats) -> tuple[Floats, Floats]:
    """Return |mean inside − mean outside| for an edge at each position, (rows, positions)."""
    columns = bands.grey.shape[-1]
    grey, distance, lever, valid = (
        field[edge].reshape(-1, columns)
        for field in (bands.grey, bands.distance_px, bands.lever, bands.valid)
    )
    rows = valid.sum(axis=1) > 4 * SEARCH_WINDOW_PX * columns / (columns + 1) / 2
    grey, distance, lever, valid = (field[rows] for field in (grey, distance, lever, valid))
    if not rows.any():
        return np.zeros((0, positions.size)), np.zeros(0)
    zero = np.zeros((len(grey), 1))
    counts = np.hstack([zero, np.cumsum(valid, axis=1)])
    sums = np.hstack([zero, np.cumsum(valid * grey, axis=1)])
    slope = distance[:, 1:2] - distance[:, :1]

    def until(position: Floats) -> tuple[Floats, Floats]:
        column = np.ceil((position - distance[:, :1]) / slope)
        column = np.clip(column, 0, columns).astype(np.intp)
        count = np.take_along_axis(counts, column, axis=1)
        return count, np.take_along_axis(sums, column, axis=1)

    (n0, s0), (n1, s1), (n2, s2) = (
        until(positions + shift) for shift in (-SEARCH_WINDOW_PX, 0.0, SEARCH_WINDOW_PX)
    )
    both = (np.abs(n1 - n0) > 1) & (np.abs(n2 - n1) > 1)
    first = (s1 - s0) / np.where(n1 == n0, 1, n1 - n0)
    second = (s2 - s1) / np.where(n2 == n1, 1, n2 - n1)
    return np.where(both, np.abs(first - second), 0.0), lever.mean(axis=1)


def _solve(
    image: Floats, camera: Camera, start: tuple[EdgeLine, EdgeLine], blur_px: float
) -> _Solution:
    """Return the maximum-likelihood edges near `start`: first guarded, then as simple as fits."""
    widen = max(1.0, blur_px)
    narrow = (INNER_PX * widen, OUTER_PX * widen)
    half = _width_px(start) / 2
    model = Model(ramp=half >= INNER_PX / 2, limb=half >= INNER_PX, cluttered=True)
    bands = _gather(image, camera, start, narrow)
    fit, trust = _iterate(bands, np.array([0, 0, 0, 0, blur_px]), None, model, FIRST_ITERATIONS)
    if fit.parameters[4] > 1.3 * widen:
        solution = _solution(start, bands, fit, trust, model)
        return _solve(image, camera, solution.lines, float(fit.parameters[4]))
    simple = _simplest(image, camera, _solution(start, bands, fit, trust, model), model)
    if simple is not None:
        return simple
    misfit = _misfit(bands, fit, trust, model) > MISFIT_TIMES
    far = np.abs(bands.distances(fit.parameters)) > CLEAR_PX * widen
    valid = np.where(misfit[..., None, None] & far, 0.0, bands.valid)
    bands = Bands(
        bands.grey, bands.distance_px, bands.lever, bands.scale, valid, bands.half_width_px
    )
    fit, trust = _iterate(bands, fit.parameters, trust, model, ITERATIONS)
    return _solution(start, bands, fit, trust, model)


def _gather(
    image: Floats, camera: Camera, lines: tuple[EdgeLine, EdgeLine], reach_px: tuple[float, float]
) -> Bands:
    half = _width_px(lines) / 2
    return gather(
        image,
        camera,
        lines,
        inner_px=min(reach_px[0], half),
        outer_px=reach_px[1],
        half_width_px=half,
        chunk_rows=CHUNK_ROWS,
    )


def _simplest(image: Floats, camera: Camera, solution: _Solution, model: Model) -> _Solution | None:
    """Return the fit with the fewest grey levels that explain the pixels, in wider windows.

    None if the surroundings are too cluttered for grey levels in common to a chunk.

    Every grey level that is not needed costs certainty: free ones in every row and a limb where
    there is none make it four times the bound.
    """
    noise = solution.trust.noise_grey
    blur = float(solution.fit.parameters[4])
    lines = solution.lines
    widen = max(1.0, blur)
    bands = _gather(image, camera, lines, (WIDE_INNER_PX * widen, WIDE_OUTER_PX * widen))
    model = Model(ramp=model.ramp, limb=model.limb, cluttered=False)
    first = np.array([0, 0, 0, 0, blur])
    fit, trust = _iterate(bands, first, None, model, TRIAL_ITERATIONS)
    misfit = (_misfit(bands, fit, trust, model) > CLUTTER_TIMES).mean()
    if misfit > LARGEST_MISFIT_PART or trust.noise_grey > LARGEST_NOISE_RISE * noise:
        return None
    weights = bands.valid * trust.weights[..., None]
    for ramp in (False, True):
        simple = Model(ramp=ramp, limb=False, cluttered=False)
        if simple.inside_terms >= model.inside_terms:
            break
        trial = linearize(bands, fit.parameters, weights, simple)
        gain = trial.step(weights)[1]
        rise = float((weights * (trial.residual**2 - fit.residual**2)).sum()) - gain
        levels = (model.inside_terms - simple.inside_terms) * bands.grey.shape[1] * 2
        if rise < (levels + RISE_SIGMAS * np.sqrt(2 * levels)) * trust.noise_grey**2:
            model = simple
            break
    fit, trust = _iterate(bands, fit.parameters, trust, model, ITERATIONS)
    return _solution(lines, bands, fit, trust, model)


def _iterate(
    bands: Bands, parameters: Floats, before: RowTrust | None, model: Model, count: int
) -> tuple[Fit, RowTrust]:
    """Return the fit after up to `count` Gauss–Newton steps, each with the weights of the last."""
    weights = bands.valid if before is None else bands.valid * before.weights[..., None]
    fit = linearize(bands, parameters, weights, model)
    trust = trust_rows(bands, fit, model)
    for _ in range(count - 1):
        weights = bands.valid * trust.weights[..., None]
        step, gain = fit.step(weights)
        parameters = parameters + np.clip(step, -STEP_LIMIT_PX, STEP_LIMIT_PX)
        parameters[4] = np.clip(parameters[4], *BLUR_RANGE_PX)
        if gain < CONVERGED_CHI2 * trust.noise_grey**2:
            return Fit(parameters, fit.jacobian, fit.residual, fit.contrast), trust
        fit = linearize(bands, parameters, weights, model)
        trust = trust_rows(bands, fit, model)
    return fit, trust


def _misfit(bands: Bands, fit: Fit, trust: RowTrust, model: Model) -> Floats:
    """Return the mean square residual of each chunk over the noise's, shape (edges, chunks)."""
    used = bands.valid * trust.accepted[..., None]
    levels = model.levels_per_row(bands.grey.shape[2]) * trust.accepted.sum(axis=-1)
    freedom = np.maximum(used.sum(axis=(-1, -2)) - levels, 1)
    square = (used * fit.residual**2).sum(axis=(-1, -2)) / freedom
    return np.asarray(square / trust.noise_grey**2)


def _solution(
    start: tuple[EdgeLine, EdgeLine], bands: Bands, fit: Fit, trust: RowTrust, model: Model
) -> _Solution:
    """Return the fit with its covariance, raised by the scatter of the chunks' own offsets."""
    information = fit.normal_equations(bands.valid * trust.weights[..., None])[0]
    information = information / trust.noise_grey**2
    inverse = np.linalg.inv(information + np.diag(1e-9 * np.diag(information) + 1e-9))
    covariance = np.asarray(inverse * _chunk_inflation(bands, fit, trust), dtype=np.float64)
    if model.limb:
        systematic = CLUTTERED_SYSTEMATIC_PX if model.cluttered else SHADED_SYSTEMATIC_PX
        covariance[range(4), range(4)] += systematic**2
    return _Solution(start, bands, fit, trust, covariance)


def _chunk_inflation(bands: Bands, fit: Fit, trust: RowTrust) -> float:
    """Return how much the chunks' own offsets scatter beyond the rows' variances, at least 1."""
    information = (bands.valid * fit.jacobian[..., 0] ** 2).sum(axis=-1)
    information = trust.weights * information / trust.noise_grey**2
    chunk = information.sum(axis=-1)
    offset = (information * trust.offset_px).sum(axis=-1)
    chi2 = float((offset[chunk > 0] ** 2 / chunk[chunk > 0]).sum())
    return max(1.0, chi2 / max(int((chunk > 0).sum()) - 4, 1))


def _refuse(camera: Camera, solution: _Solution, seed: tuple[EdgeLine, EdgeLine]) -> None:
    """Raise `ShaftNotFoundError` where the fit does not show the two edges of the seed."""
    lines = solution.lines
    _refuse_width(camera, _width_px(lines), _width_px(seed))
    gaps = [
        float(abs((lines[0].at(np.array(lever)) - lines[1].middle_px) @ lines[1].outward))
        for lever in (-1.0, 1.0)
    ]
    if min(gaps) < (1 - LARGEST_TAPER) * max(gaps):
        raise ShaftNotFoundError(
            f"camera {camera.name}: the edges found are {gaps[0]:.1f} px apart at one end and "
            f"{gaps[1]:.1f} px at the other, not nearly parallel",
            next_step="look at the overlay and give a hint for this pose",
        )
    rows = np.asarray(solution.bands.valid.any(axis=-1))
    used = solution.trust.accepted
    contrast = _contrasts(solution)
    sigma = _sigmas(solution)[0]
    for edge, name in enumerate(("first", "second")):
        count, total = int(used[edge].sum()), int(rows[edge].sum())
        if count < max(LEAST_ROWS, LEAST_ROW_PART * total):
            raise ShaftNotFoundError(
                f"camera {camera.name}: only {count} of {total} rows show the {name} edge of the "
                "shaft as one straight line",
                next_step="look for what hides the shaft or crosses it, or shorten the region",
            )
        noise = solution.trust.noise_grey
        if contrast[edge] < LEAST_CONTRAST_NOISES * noise or sigma[edge] > LARGEST_SIGMA_PX:
            raise ShaftNotFoundError(
                f"camera {camera.name}: the {name} edge has a contrast of {contrast[edge]:.1f} "
                f"grey levels at a noise of {noise:.1f} and is known to {sigma[edge]:.2f} px only",
                next_step="put a background behind the shaft that differs from it in brightness",
            )


def _refuse_outside(camera: Camera, seed: ShaftSeed) -> None:
    """Raise `ShaftNotFoundError` unless both edges of the seed cross a good part of the image."""
    lever = np.linspace(0, 1, 101)[:, None]
    for start, end in seed.edges_px:
        points = start + lever * (end - start)
        limit = np.array([camera.width - 1, camera.height - 1])
        inside = ((points >= 0) & (points <= limit)).all(axis=1)
        length = float(inside.mean() * np.hypot(*(end - start)))
        if length < LEAST_ROWS:
            raise ShaftNotFoundError(
                f"camera {camera.name}: only {length:.0f} px of an edge of the seed lie inside the "
                f"image, outside of which nothing is seen; {LEAST_ROWS} px are needed",
                next_step="check the hint or the region of this pose",
            )


def _refuse_width(camera: Camera, width_px: float, seed_px: float) -> None:
    allowed = SEED_WIDTH_PX + SEED_WIDTH_PART * seed_px
    if width_px < LEAST_WIDTH_PX or abs(width_px - seed_px) > allowed:
        raise ShaftNotFoundError(
            f"camera {camera.name}: the edges found are {width_px:.1f} px apart, where the seed "
            f"has {seed_px:.1f} px and at least {LEAST_WIDTH_PX:.0f} px are needed",
            next_step="look at the overlay; move the camera closer if the shaft is this thin",
        )


def _contrasts(solution: _Solution) -> Floats:
    weights = solution.trust.weights
    total = np.maximum(weights.sum(axis=(1, 2)), 1e-12)
    mean: Floats = (weights * np.abs(solution.fit.contrast)).sum(axis=(1, 2)) / total
    return mean


def _sigmas(solution: _Solution) -> tuple[Floats, Floats]:
    """Return the sigma of each edge's offset where it is smallest (px) and of its angle (rad)."""
    offset, angle = [], []
    for edge, line in enumerate(solution.start):
        (pp, pq), (_, qq) = solution.covariance[2 * edge : 2 * edge + 2, 2 * edge : 2 * edge + 2]
        offset.append(np.sqrt(max(pp - pq * pq / qq, 0.0)))
        angle.append(np.sqrt(qq) / np.hypot(*line.half_px))
    return np.array(offset), np.array(angle)


def _normals(camera: Camera, lines: tuple[EdgeLine, EdgeLine]) -> Floats:
    direction = np.stack([line.half_px for line in lines])
    middle = np.stack([line.middle_px for line in lines])
    a, b = normalized_line(direction, middle, camera.calibration_matrix)
    return outward_normals(coimage_normal(a, b), np.append(b.mean(axis=0), 1.0))


def _result(camera: Camera, solution: _Solution) -> ShaftEdges:
    lines = solution.lines
    weights = solution.trust.weights
    used = solution.trust.accepted
    rows = solution.bands.valid.any(axis=-1)
    sigma, angle = _sigmas(solution)
    total = np.maximum(weights.sum(), 1e-12)
    residual = np.sqrt((weights * solution.trust.offset_px**2).sum() / total)
    return ShaftEdges(
        camera=camera.name,
        points_px=np.stack([_points(camera, solution, edge) for edge in range(2)]),
        normals=_normals(camera, lines),
        normals_covariance=_normals_covariance(camera, solution),
        sigma_px=sigma,
        angle_sigma_rad=angle,
        width_px=_width_px(lines),
        contrast=_contrasts(solution),
        blur_px=float(solution.fit.parameters[4]),
        residual_px=float(residual),
        used_part=used.sum(axis=(1, 2)) / np.maximum(rows.sum(axis=(1, 2)), 1),
    )


def _points(camera: Camera, solution: _Solution, edge: int) -> Floats:
    """Return raw points on an edge between its first and last row that counts."""
    bands = solution.bands
    used = solution.trust.accepted[edge]
    lever = bands.lever[edge, ..., bands.lever.shape[-1] // 2][used]
    fine = np.linspace(float(lever.min()), float(lever.max()), 20 * POINTS)
    line = solution.lines[edge]
    raw = camera.pixels_from_normalized(
        (line.at(fine) - camera.principal_point_px) / camera.focal_px
    )
    inside = ((raw >= 0) & (raw <= [camera.width - 1, camera.height - 1])).all(axis=1)
    first, last = (float(end) for end in fine[inside][[0, -1]])
    along = line.at(np.linspace(first, last, POINTS))
    return camera.pixels_from_normalized((along - camera.principal_point_px) / camera.focal_px)


def _normals_covariance(camera: Camera, solution: _Solution) -> Floats:
    """Propagate the covariance of offsets and tilts to the normals, by central differences."""
    step = 1e-3
    lines = solution.lines
    columns = []
    for index in range(4):
        ends = []
        for sign in (step, -step):
            move = np.zeros((2, 2))
            move.flat[index] = sign
            ends.append(_normals(camera, (lines[0].moved(*move[0]), lines[1].moved(*move[1]))))
        columns.append((ends[0] - ends[1]).ravel() / (2 * step))
    jacobian = np.stack(columns, axis=1)
    covariance: Floats = jacobian @ solution.covariance[:4, :4] @ jacobian.T
    return covariance
