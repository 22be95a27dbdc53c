"""What lanes of a brushed shaft may move its edges by."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from pivometer.cameras import Camera
from pivometer.shaft.fitting.lines import edge_lines
from pivometer.shaft.fitting.shaded import FIRST_BLUR_PX, fit_shaded
from pivometer.shaft.fitting.texture import with_texture
from pivometer.shaft.fitting.view import ShaftView

SIZE = WIDTH, HEIGHT = 120, 288
CAMERA = Camera("a", WIDTH, HEIGHT, [500, 500], [59.5, 143.5], [0, 0])
STEP_PX = 0.02
LEAN = 0.08
SHAFT_GREY, NOISE = 130.0, 2.0
LANE_PX, LANE_GREY = 0.5, 8.0


def fits(rng, shading, half_px, contrast):
    """Return a guarded fit of a leaning shaft of 2 × half_px, its image and its maps.

    Its shading is a function of the distance from its axis, in bins of STEP_PX. Behind it
    something of `contrast` greys more on average changes from row to row.
    """
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
    across = (x - 59.5 - LEAN * (y - 143.5)) / np.hypot(1, LEAN)
    places = np.arange(-60, 60, STEP_PX) + STEP_PX / 2
    on = np.abs(places) < half_px
    shaft, cover = (
        gaussian_filter1d(np.where(on, v, 0.0), 0.75 / STEP_PX) for v in (shading(places), 1.0)
    )
    behind = SHAFT_GREY + contrast * (1 + 0.4 * gaussian_filter1d(rng.normal(0, 3, HEIGHT), 3))
    image = np.interp(across, places, shaft)
    image += behind[:, None] * (1 - np.interp(across, places, cover))
    image += rng.normal(0, NOISE, image.shape)
    ends = np.array([4.0, HEIGHT - 5.0])
    middle = 59.5 + LEAN * (ends - 143.5)
    sides = (k * half_px * np.hypot(1, LEAN) for k in (-1, 1))
    edges = np.stack([np.stack([middle + side, ends], axis=1) for side in sides])
    lines = edge_lines(edges, CAMERA)
    fitted = fit_shaded(image, CAMERA, lines, FIRST_BLUR_PX)
    return fitted, ShaftView.of(image, CAMERA, lines)


def lanes(rng):
    grey = rng.normal(0, LANE_GREY, 400)
    return lambda places: SHAFT_GREY + grey[np.floor(places / LANE_PX).astype(int) + 200]


def scores(fitted):
    """Return errors over standard uncertainties: the lines it started from are the true ones."""
    return fitted.parameters[[0, 2]] / np.sqrt(fitted.covariance[[0, 2], [0, 2]])


@pytest.mark.parametrize("half_px", [9.0, 15.0])
def test_what_lanes_move_edges_by_is_stated(half_px):
    """One lane moves an edge in all rows alike: what rows and windows tell is too little."""
    rng = np.random.default_rng(5)
    before, after = [], []
    for _ in range(30):
        fitted, view = fits(rng, lanes(rng), half_px, 12.0)
        before.append(scores(fitted))
        after.append(scores(with_texture(view, fitted)))
    held, without = (int((np.abs(found) < 1.96).sum()) for found in (after, before))
    # Of 60 intervals of 95 % at least 52 hold by chance in all but 1 of 100.
    assert held >= 52
    assert without < 52


@pytest.mark.parametrize(
    "shading",
    [
        lambda x: np.full_like(x, SHAFT_GREY),
        lambda x: SHAFT_GREY * (0.6 + 0.4 * np.sqrt(np.maximum(1 - 0.9 * (x / 15) ** 2, 0))),
        lambda x: SHAFT_GREY + 100 * np.exp(-(((x - 3) / 3) ** 2)),
    ],
    ids=["flat", "round", "highlight"],
)
def test_smooth_shading_is_no_texture(shading):
    fitted, view = fits(np.random.default_rng(6), shading, 15.0, 60.0)
    added = with_texture(view, fitted).covariance - fitted.covariance
    assert np.sqrt(added[[0, 2], [0, 2]]).max() < 0.02


def test_lanes_count_less_where_the_contrast_is_larger():
    rng = np.random.default_rng(7)
    shading, added = lanes(rng), []
    for contrast in (15.0, 60.0):
        fitted, view = fits(rng, shading, 15.0, contrast)
        more = with_texture(view, fitted).covariance - fitted.covariance
        added.append(np.sqrt(more[[0, 2], [0, 2]]))
    assert added[0] / added[1] == pytest.approx(np.full(2, 4.0), rel=0.3)
