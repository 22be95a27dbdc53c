"""Both edges of a shaft, fitted together to the raw pixels of one image."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import TypeGuard

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pivometer._arrays import Floats, checked
from pivometer.cameras.model import Camera
from pivometer.cameras.mosaic import is_mosaic, luminance
from pivometer.errors import ShaftNotFoundError, ShapeError
from pivometer.shaft.backdrop import filled
from pivometer.shaft.fitting.banded import fit_banded
from pivometer.shaft.fitting.defocused import fit_defocused
from pivometer.shaft.fitting.evidence import LARGE_BLUR_PX
from pivometer.shaft.fitting.fitted import FittedEdges
from pivometer.shaft.fitting.ladder import CLEAN_PART, fit_ladder
from pivometer.shaft.fitting.lanes import with_lanes
from pivometer.shaft.fitting.lines import Lines, edge_lines, width_px
from pivometer.shaft.fitting.mosaic_edges import ADVICE, WARNING, clipped_part, evened_beside
from pivometer.shaft.fitting.plain import fit_plain
from pivometer.shaft.fitting.refusals import refuse_fit, refuse_outside, refuse_width, strays
from pivometer.shaft.fitting.search import found_lines
from pivometer.shaft.fitting.shaded import FIRST_BLUR_PX, fit_shaded
from pivometer.shaft.fitting.stated import ShaftEdges, shaft_edges
from pivometer.shaft.fitting.texture import with_texture
from pivometer.shaft.fitting.thin import fit_thin
from pivometer.shaft.fitting.uncovered import uncovered_lines
from pivometer.shaft.fitting.view import ShaftView
from pivometer.shaft.gate import LARGEST_END_SIGMA_PX
from pivometer.shaft.seed import ShaftSeed

__all__ = ["ShaftEdges", "fit_edges"]

THIN_PX = 16.0
"""Narrower shafts are fitted with both edges in one model; `plain` needs 15 px at usual blur."""

SEARCH_ROWS = 60
"""Rows that the first search looks at: evenly spread, enough for votes of one in four."""


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
    view = ShaftView.of(pixels, camera, first)
    start = found_lines(view.every(max(1, len(view.maps[0].rows) // SEARCH_ROWS)))
    view = view.about(start)
    fitted = _fit_simple(view)
    if fitted is None:
        empty = None if background is None else _pixels(background, camera)
        behind = cache(lambda: _behind(backdrop, empty, seed if mosaic else None))
        scene = _Scene(pixels, camera, behind)
        fitted, first = _surest_fit(scene, view, first, clean=empty is None)
    refuse_fit(fitted, first)
    found = shaft_edges(camera, fitted)
    return _of_mosaic(raw, camera, fitted, found) if mosaic else found


def _of_mosaic(
    raw: NDArray[np.generic], camera: Camera, fitted: FittedEdges, found: ShaftEdges
) -> ShaftEdges:
    """Return edges found in an evened mosaic, with what the raw one clipped and a warning."""
    fitted = replace(fitted, saturated_part=clipped_part(raw, found.points_px))
    found = shaft_edges(camera, fitted)
    return replace(found, warnings=(*found.warnings, f"{WARNING}; {ADVICE}"))


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """The image as the camera took it, the camera, and who knows what stands behind the shaft."""

    pixels: NDArray[np.generic]
    camera: Camera
    behind: Callable[[], Floats | None]

    def told(self, view: ShaftView) -> Floats | None:
        """Return what stands behind the shaft, turned like a view; None if unknown."""
        seen = self.behind()
        return None if seen is None else view.turned(seen)


def _surest_fit(
    scene: _Scene, view: ShaftView, seed: Lines, *, clean: bool
) -> tuple[FittedEdges, Lines]:
    """Return a shaded shaft's edges and the lines that they were to be near.

    If edges near the seed are refused or uncertain, others may lie where the background begins.
    """
    fitted = _fit_round(scene, view, clean=clean)
    doubt = _doubt(fitted, seed)
    again = _fit_uncovered(scene, view) if doubt > LARGEST_END_SIGMA_PX else None
    return again if again is not None and _doubt(*again) < doubt else (fitted, seed)


def _fit_uncovered(scene: _Scene, view: ShaftView) -> tuple[FittedEdges, Lines] | None:
    """Return a shaded shaft's edges from where a known background begins, and where that is.

    None if it begins where the first fit started, or nobody knows it.
    """
    told = scene.told(view)
    if told is None:
        return None
    lines = uncovered_lines(view, told)
    if lines is None:
        return None
    return _fit_round(scene, ShaftView.of(scene.pixels, scene.camera, lines), clean=False), lines


def _doubt(fitted: FittedEdges, seed: Lines) -> float:
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


def _fit_simple(view: ShaftView) -> FittedEdges | None:
    """Return the edges of a shaft of flat or banded grey levels, or None if it has others."""
    fitted = fit_plain(view)
    if fitted is not None:
        return fitted
    fitted = fit_thin(view) if width_px(view.lines) < THIN_PX else None
    return fit_banded(view) if fitted is None else _unless_defocused(view, fitted)


def _fit_round(scene: _Scene, view: ShaftView, *, clean: bool) -> FittedEdges:
    """Return a shaded shaft's edges: before clutter, with the help of what the scene tells.

    Where a search from the seed took a lane of the shaft for its edge, the guarded fit, which has a
    background of its own in every row, gives a better start.
    """
    fitted = fit_ladder(view, cluttered=CLEAN_PART) if clean else None
    if _holds(fitted):
        return _unless_defocused(view, fitted)
    told = scene.told(view)
    fitted = None if told is None else fit_ladder(view, told)
    if told is not None and _holds(fitted):
        return _seconded(view, fitted, told)
    if fitted is None and clean:
        fitted = fit_ladder(view)
    if _holds(fitted):
        return _unless_defocused(view, fitted)
    guarded = fit_shaded(scene.pixels, scene.camera, view.lines, FIRST_BLUR_PX)
    # A background of its own in every row takes a large blur for its own.
    fitted = fit_defocused(view, max(float(guarded.parameters[4]), LARGE_BLUR_PX))
    if fitted is None and told is not None:
        fitted = fit_ladder(view.about(guarded.lines), told)
        if _holds(fitted):
            return _seconded(view, fitted, told)
    return fitted if _holds(fitted) else _seconded(view, guarded, told)


def _seconded(view: ShaftView, fitted: FittedEdges, told: Floats | None) -> FittedEdges:
    """Return a fit before clutter as certain as lanes let it be, and heard with the background."""
    return fitted if told is None else with_lanes(view, with_texture(view, fitted), told)


def _unless_defocused(view: ShaftView, fitted: FittedEdges) -> FittedEdges:
    """Return a fit of sharp edges, or that of edges whose blurs meet where it holds."""
    both = fit_defocused(view, float(fitted.parameters[4]))
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
