"""Edges that are none: what stands behind the shaft does not show beside them."""

import numpy as np
import pytest
from tests.shaft.rendering import NOISE, camera_of, clutter, pictured, render

from pivometer.errors import ShaftNotFoundError
from pivometer.shaft.edges import fit_edges
from pivometer.shaft.fitting.beside import shown_part
from pivometer.shaft.fitting.samples import Behind, Samples
from pivometer.shaft.seed import ShaftSeed


def samples(rng, shown, changes=10.0):
    """Return four chunks of 24 rows, of which some show the background from 0 px on."""
    x = np.tile(np.arange(-4.0, 5.0), (4, 24))
    behind = 80 + changes * rng.normal(size=x.shape)
    light = np.array([0.0, 10.0, -20.0, 5.0])[:, None]  # shadows do not hide what changes
    grey = np.where((x > 0) & np.array(shown)[:, None], behind + light, 90 + 3 * x)
    return Samples(
        grey=grey + rng.normal(0, 2.0, x.shape),
        x_px=x,
        lever=np.zeros_like(x),
        count=np.ones_like(x),
        scale=np.ones((4, 1)),
        half_px=np.full((4, 1), 20.0),
        edge=np.zeros(4, dtype=np.intp),
        behind=Behind(behind, np.zeros_like(x)),
    )


@pytest.mark.parametrize("count", range(5))
def test_it_shows_in_the_chunks_in_which_it_shows(count):
    shown = np.arange(4) < count
    assert shown_part(samples(np.random.default_rng(1), shown), 1.0, 2.0) == count / 4


def test_a_background_without_changes_tells_nothing():
    found = shown_part(samples(np.random.default_rng(2), [True] * 4, changes=0.5), 1.0, 2.0)
    assert np.isnan(found)


def test_a_step_on_the_shaft_is_not_taken_for_its_edge_before_a_known_background():
    """A dark core has sharper edges than a shaft as bright as clutter, whose edges are far off."""
    rng = np.random.default_rng(3)
    camera = camera_of()
    texture = clutter(camera, rng)
    scene = render(camera, width_px=50.0, outside=texture, inside=85.0, taper=0.0)
    core = render(camera, width_px=20.0, taper=0.0, inside=60.0, outside=0.0)
    empty = pictured(texture, scene)
    image = scene.with_noise(NOISE, rng) - core.clean
    assert fit_edges(image, camera, ShaftSeed(core.seed_px)).width_px == pytest.approx(20, abs=0.5)
    with pytest.raises(ShaftNotFoundError, match="does not show"):
        fit_edges(image, camera, ShaftSeed(core.seed_px), background=empty)
