"""Both edges of a shaft, fitted together to the raw pixels of one image."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeGuard

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pivometer._arrays import Floats, checked
from pivometer.cameras.model import Camera
from pivometer.cameras.mosaic import is_mosaic, luminance
from pivometer.errors import ShaftNotFoundError, ShapeError
from pivometer.shaft.backdrop import filled
from pivometer.shaft.band_map import BandMap, band_map, near_lines
from pivometer.shaft.banded import fit_banded
from pivometer.shaft.bands import EdgeLine, edge_lines, is_upright, width_px
from pivometer.shaft.defocused import fit_defocused
from pivometer.shaft.detection import ShaftSeed
from pivometer.shaft.evidence import LARGE_BLUR_PX
from pivometer.shaft.fitted import FittedEdges, ShaftEdges, shaft_edges
from pivometer.shaft.gate import LARGEST_END_SIGMA_PX
from pivometer.shaft.ladder import CLEAN_PART, fit_ladder
from pivometer.shaft.lanes import with_lanes
from pivometer.shaft.mosaic_edges import ADVICE, WARNING, clipped_part, evened_beside
from pivometer.shaft.plain import fit_plain
from pivometer.shaft.refusals import refuse_fit, refuse_outside, refuse_width, strays
from pivometer.shaft.search import found_lines
from pivometer.shaft.shaded import FIRST_BLUR_PX, fit_shaded
from pivometer.shaft.silhouette import coimage_normal, normalized_line, outward_normals
from pivometer.shaft.texture import with_texture
from pivometer.shaft.thin import fit_thin
from pivometer.shaft.uncovered import uncovered_lines

__all__ = ["ShaftEdges", "edge_normals", "fit_edges"]

THIN_PX = 16.0
"""Narrower shafts are fitted with both edges in one model; `plain` needs 15 px at usual blur."""

SEARCH_ROWS = 60
"""Rows that the first search looks at: evenly spread, enough for votes of one in four."""

REACH_PX = 22.0
"""Where coordinates are asked for: 4 blurs of 4 px, and the search's 4 px."""


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


def fit_edges(
    image: ArrayLike,
    camera: Camera,
    seed: ShaftSeed,
    *,
    background: ArrayLike | None = None,
    backdrop: Callable[[], Floats | None] | None = None,
) -> ShaftEdges:
    """Return both edges of a shaft by maximum likelihood on the raw pixels beside them.

    Offset and angle of both edges and the blur are common to the whole shaft; grey levels are
    free in every short chunk of it. Where they are flat, a quick fit suffices; else the inside
    follows the limb of a round shaft, and the outside, if it must, is free in every row. Rows that
    occlusion, collars or clutter spoil are found by their disagreement. A raw mosaic of colour
    filters is evened first, with a warning.

    Parameters
    ----------
    image
        The raw image, shape (height, width), any depth.
    camera
        Its camera.
    seed
        Where the edges roughly are, to about 2 px.
    background
        An empty frame: the same view without the shaft, same shape. Before clutter it makes edges
        far more certain.
    backdrop
        Gives what the session's own frames tell of that, as `backdrop.backdrop_of`; asked only
        where a shaded shaft stands before clutter.

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
    Wilson et al., section V, for what it replaces; `plain` and `shaded` for the models.
    """
    raw = _pixels(image, camera)
    refuse_outside(camera, seed)
    mosaic = is_mosaic(raw)
    pixels = evened_beside(raw, seed.edges_px) if mosaic else raw
    first = edge_lines(seed.edges_px, camera)
    width = width_px(first)
    refuse_width(width, width)
    upright = is_upright(np.stack([[line.start_px, line.end_px] for line in first]))
    turned = pixels if upright else pixels.T
    maps = one, other = _maps(camera, first, upright)
    step = max(1, len(one.rows) // SEARCH_ROWS)
    start = found_lines(turned, (one.every(step), other.every(step)), first)
    fitted = _fit_simple(turned, maps, start)
    if fitted is None:
        empty = None if background is None else _pixels(background, camera)

        def told() -> Floats | None:
            seen = _behind(backdrop, empty, seed if mosaic else None)
            return seen if seen is None or upright else seen.T

        clean = empty is None
        fitted = _fit_round(pixels, turned, camera, maps, start, told, clean=clean)
        doubt = _doubt(fitted, first)
        if doubt > LARGEST_END_SIGMA_PX:
            again = _fit_uncovered(pixels, turned, camera, maps, start, told)
            if again is not None and _doubt(*again) < doubt:
                fitted, first = again
    refuse_fit(fitted, first)
    found = shaft_edges(camera, fitted)
    if not mosaic:
        return found
    fitted = replace(fitted, saturated_part=clipped_part(raw, found.points_px))
    found = shaft_edges(camera, fitted)
    return replace(found, warnings=(*found.warnings, f"{WARNING}; {ADVICE}"))


def _fit_uncovered(
    pixels: NDArray[np.generic],
    turned: NDArray[np.generic],
    camera: Camera,
    maps: tuple[BandMap, BandMap],
    start: tuple[EdgeLine, EdgeLine],
    behind: Callable[[], Floats | None],
) -> tuple[FittedEdges, tuple[EdgeLine, EdgeLine]] | None:
    """Return a shaded shaft's edges from where a known background begins, and where that is.

    None if it begins where the first fit started, or nobody knows it.
    """
    told = behind()
    if told is None:
        return None
    lines = uncovered_lines(turned, told, near_lines(maps, start), start)
    if lines is None:
        return None
    again = _maps(camera, lines, turned is pixels)
    return _fit_round(pixels, turned, camera, again, lines, behind, clean=False), lines


def _maps(
    camera: Camera, lines: tuple[EdgeLine, EdgeLine], upright: bool
) -> tuple[BandMap, BandMap]:
    """Return the maps of both edges' bands in the image turned so that the shaft is upright."""
    shape = (camera.height, camera.width) if upright else (camera.width, camera.height)
    one, other = (
        band_map(camera, line, shape, upright=upright, reach_px=REACH_PX) for line in lines
    )
    return one, other


def _doubt(fitted: FittedEdges, seed: tuple[EdgeLine, EdgeLine]) -> float:
    """Return how uncertain an edge is at its ends at most, px; infinitely if the fit is refused."""
    try:
        refuse_fit(fitted, seed)
    except ShaftNotFoundError:
        return float("inf")
    variance = fitted.covariance.diagonal()[:4].reshape(2, 2)
    return float(np.sqrt(variance.sum(axis=1).max()))


def _behind(
    backdrop: Callable[[], Floats | None] | None,
    empty: NDArray[np.generic] | None,
    mosaic: ShaftSeed | None,
) -> Floats | None:
    """Return what frames and an empty one tell; evened beside the seed where they are mosaics."""
    seen = None if backdrop is None else backdrop()
    if mosaic is not None:
        seen = None if seen is None else luminance(seen).astype(np.float64)
        empty = None if empty is None else evened_beside(empty, mosaic.edges_px)
    return seen if empty is None else filled(seen, empty)


def _fit_simple(
    turned: NDArray[np.generic], maps: tuple[BandMap, BandMap], start: tuple[EdgeLine, EdgeLine]
) -> FittedEdges | None:
    """Return the edges of a shaft of flat or banded grey levels, or None if it has others."""
    fitted = fit_plain(turned, maps, start)
    if fitted is not None:
        return fitted
    fitted = fit_thin(turned, maps, start) if width_px(start) < THIN_PX else None
    if fitted is not None:
        return _unless_defocused(turned, maps, start, fitted)
    return fit_banded(turned, maps, start)


def _fit_round(
    pixels: NDArray[np.generic],
    turned: NDArray[np.generic],
    camera: Camera,
    maps: tuple[BandMap, BandMap],
    start: tuple[EdgeLine, EdgeLine],
    behind: Callable[[], Floats | None],
    *,
    clean: bool,
) -> FittedEdges:
    """Return a shaded shaft's edges: before clutter, with the help of what `behind` tells.

    Where a search from the seed took a lane of the shaft for its edge, the guarded fit, which has a
    background of its own in every row, gives a better start.
    """
    fitted = fit_ladder(turned, maps, start, cluttered=CLEAN_PART) if clean else None
    if _holds(fitted):
        return _unless_defocused(turned, maps, start, fitted)
    told = behind()
    fitted = None if told is None else fit_ladder(turned, maps, start, told)
    if told is not None and _holds(fitted):
        return _seconded(turned, maps, fitted, told)
    if fitted is None and clean:
        fitted = fit_ladder(turned, maps, start)
    if _holds(fitted):
        return _unless_defocused(turned, maps, start, fitted)
    guarded = fit_shaded(pixels, camera, start, FIRST_BLUR_PX)
    # A background of its own in every row takes a large blur for its own.
    blur_px = max(float(guarded.parameters[4]), LARGE_BLUR_PX)
    fitted = fit_defocused(turned, maps, start, blur_px)
    if fitted is None and told is not None:
        fitted = fit_ladder(turned, maps, guarded.lines, told)
        if _holds(fitted):
            return _seconded(turned, maps, fitted, told)
    if _holds(fitted):
        return fitted
    return _seconded(turned, maps, guarded, told)


def _seconded(
    turned: NDArray[np.generic],
    maps: tuple[BandMap, BandMap],
    fitted: FittedEdges,
    told: Floats | None,
) -> FittedEdges:
    """Return a fit before clutter as certain as lanes let it be, and heard with the background."""
    if told is None:
        return fitted
    return with_lanes(turned, maps, with_texture(turned, maps, fitted), told)


def _unless_defocused(
    turned: NDArray[np.generic],
    maps: tuple[BandMap, BandMap],
    start: tuple[EdgeLine, EdgeLine],
    fitted: FittedEdges,
) -> FittedEdges:
    """Return a fit of sharp edges, or that of edges whose blurs meet where it holds."""
    both = fit_defocused(turned, maps, start, float(fitted.parameters[4]))
    return fitted if both is None else both


def _holds(fitted: FittedEdges | None) -> TypeGuard[FittedEdges]:
    """Tell whether there is a fit, of the edges that it started from."""
    return fitted is not None and not strays(fitted)


def _pixels(image: ArrayLike, camera: Camera) -> NDArray[np.generic]:
    """Return the image as it is, or as float64 if it is not of whole numbers."""
    pixels = np.asarray(image)
    if pixels.dtype.kind not in "ui":
        return checked(image, (camera.height, camera.width), "image")
    if pixels.shape != (camera.height, camera.width):
        raise ShapeError(
            f"image has shape {pixels.shape}, not ({camera.height}, {camera.width})",
            next_step="pass the image of this camera",
        )
    return pixels
