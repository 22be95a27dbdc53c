"""The guarded fit, which answers where no other holds."""

import numpy as np
from tests.shaft.rendering import NOISE, camera_of, clutter, render

from pivometer.errors import ShaftNotFoundError
from pivometer.shaft.edges import fit_edges
from pivometer.shaft.seed import ShaftSeed


def test_lanes_beside_an_edge_before_clutter_are_stated_as_uncertainty():
    """They spoil a window of 5 px, not one of 2.5 px, and no model of a single window tells."""
    rng = np.random.default_rng(34)
    camera = camera_of()
    scores = []
    for x in (-60.2, -20.4, 20.3, 60.1, -40.0, 0.0):
        scene = render(camera, outside=clutter(camera, rng), inside=120.0, taper=0.0, offset_px=x)
        image = scene.with_noise(NOISE, rng)
        for at in rng.uniform(-11.0, 11.0, 12):
            lane = render(camera, width_px=2.0, taper=0.0, offset_px=x + at, inside=1, outside=0)
            image += rng.normal(0, 15) * lane.clean
        seed = ShaftSeed(scene.seed_px + rng.uniform(-1, 1, (2, 2, 2)))
        try:
            edges = fit_edges(image, camera, seed)
        except ShaftNotFoundError:
            continue
        assert edges.shading == "clutter"
        scores.append(scene.offsets_px(edges.points_px).mean(axis=1) / edges.sigma_px)
    assert len(scores) >= 3
    # Up to 12 errors within four standard uncertainties: by chance in all but 1 of 1300.
    assert np.abs(scores).max() < 4
