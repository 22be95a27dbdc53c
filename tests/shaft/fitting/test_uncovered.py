"""Where a known background begins beside a shaft, when its edges are fainter than what is on it."""

import numpy as np
import pytest
from tests.shaft.rendering import NOISE, camera_of, clutter, pictured, render

from pivometer.shaft.edges import fit_edges
from pivometer.shaft.fitting.lines import edge_lines
from pivometer.shaft.fitting.uncovered import uncovered_lines
from pivometer.shaft.fitting.view import ShaftView
from pivometer.shaft.seed import ShaftSeed


def cored(rng, core_px=20.0):
    """Return a shaft as bright as clutter with a dark core, its image and the empty frame."""
    camera = camera_of()
    texture = clutter(camera, rng)
    scene = render(camera, outside=texture, inside=85.0, taper=0.0)
    core = render(camera, width_px=core_px, taper=0.0, inside=60.0, outside=0.0)
    return scene, core, scene.with_noise(NOISE, rng) - core.clean, pictured(texture, scene)


def off_px(scene, lines):
    """Return how far outward the lines' ends are from the true edges, shape (2, 2)."""
    return scene.offsets_px(np.stack([[line.start_px, line.end_px] for line in lines]))


def moved(scene, seed_px, image, empty):
    lines = edge_lines(seed_px, scene.camera)
    return uncovered_lines(ShaftView.of(image, scene.camera, lines), empty)


@pytest.mark.parametrize("seed", range(5))
def test_lines_on_the_shaft_are_moved_to_its_edges(seed):
    scene, core, image, empty = cored(np.random.default_rng(seed))
    lines = moved(scene, core.seed_px, image, empty)
    assert lines is not None
    assert np.abs(off_px(scene, lines)).max() < 1.5


@pytest.mark.parametrize("seed", range(5))
def test_lines_at_the_edges_are_left_there(seed):
    scene, _, image, empty = cored(np.random.default_rng(seed))
    assert moved(scene, scene.seed_px, image, empty) is None


def test_something_beside_a_third_of_the_rows_moves_no_line():
    scene, _, image, empty = cored(np.random.default_rng(1))
    image[:80] += 60.0 * (np.arange(image.shape[1]) > scene.seed_px[:, 0, 0].max() - 10)
    assert moved(scene, scene.seed_px, image, empty) is None


def test_an_unknown_background_moves_no_line():
    scene, core, image, empty = cored(np.random.default_rng(2))
    assert moved(scene, core.seed_px, image, np.full_like(empty, np.nan)) is None


def test_edges_are_fitted_from_there():
    scene, core, image, empty = cored(np.random.default_rng(3))
    edges = fit_edges(image, scene.camera, ShaftSeed(core.seed_px), background=empty)
    offsets = scene.offsets_px(edges.points_px)
    assert np.abs(offsets).max() < 0.3
