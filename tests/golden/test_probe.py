"""A real thin probe far out of focus, beside profile fits that share nothing with the package."""

import numpy as np
import pytest
from benchmarks.probe import CAMERA, compared, frames

from pivometer.shaft.detection import find_shaft
from pivometer.shaft.edges import fit_edges
from pivometer.shaft.seed import ShaftSeed


@pytest.fixture(scope="module")
def fitted(shared_data):
    """Return each frame's edges and how they lie beside profile fits of every 60 px."""
    images = frames(shared_data)
    if not images:
        pytest.skip(f"no parallax_probe in {shared_data}")
    found = []
    for image, seed in zip(images, find_shaft(images), strict=True):
        assert isinstance(seed, ShaftSeed), seed
        edges = fit_edges(image, CAMERA, seed)
        found.append((edges, compared(image, edges)))
    return found


def test_both_edges_lie_in_every_frame_where_profile_fits_see_them(fitted):
    assert len(fitted) == 4
    for _, beside in fitted:
        # Sixteen ends of edges, of which chance takes 1 in 20 sets beyond 3 sigma.
        assert np.abs(beside.off / beside.sigma).max() < 3
        assert beside.blocks >= 12


def test_the_two_sharper_frames_agree_to_half_a_pixel(fitted):
    for _, beside in (fitted[1], fitted[3]):
        assert np.abs(beside.off).max() < 0.5
        assert beside.sigma.max() < 0.5


def test_the_probe_bends_as_profile_fits_see_it_and_a_warning_says_so(fitted):
    for edges, beside in fitted:
        bow, sigma, theirs, their_sigma = beside.bows
        assert abs(bow - theirs) < 3 * np.hypot(sigma, their_sigma)
        assert abs(bow) > 4 * sigma
        assert any(warning.startswith("bent") for warning in edges.warnings)


def test_no_straight_line_through_the_bent_probe_is_stated_to_be_sharp(fitted):
    for edges, _ in fitted:
        assert edges.sigma_px.min() > 0.1
        assert any(warning.startswith("blurred") for warning in edges.warnings)
