"""The poses that are advised are those that are missing, in words that mean them."""

import numpy as np
import pytest

from pivometer.rcm.cone import cone_deg
from pivometer.rcm.geometry_check import equivalent_cone_deg
from pivometer.rcm.pose_advice import advice_text, poses_to_add
from pivometer.simulation.robots import cone_directions


@pytest.mark.parametrize("apex", [0.5, 4.0, 15.0])
def test_a_narrow_cone_that_follows_the_advice_is_wide(apex):
    axes = np.vstack([cone_directions(12, apex), poses_to_add(cone_directions(12, apex), count=6)])
    assert cone_deg(axes) == pytest.approx(57.0, abs=apex)
    assert equivalent_cone_deg(axes) > 20


def test_the_side_that_is_missing_is_advised():
    axes = cone_directions(60, 57.0)[:, [0, 2, 1]]  # about y
    half = axes[axes[:, 0] < 0.05]
    new = poses_to_add(half, count=2, cone_deg=80.0)
    assert (np.abs(new[:, 1]) < 0.95).all()
    text = advice_text(half, camera="left")
    assert "its upper end goes" in text
    # The upper end points to −y; it is missing on the side of −x of the other end: to the left.
    assert "to the left" in text.partition("goes")[2].partition(";")[0]


def test_what_the_cameras_do_not_measure_is_not_advised():
    axes = cone_directions(12, 3.0)
    new = poses_to_add(axes, count=4, allowed=lambda d: np.abs(d[:, 0]) < 0.1)
    assert (np.abs(new[:, 0]) < 0.1).all()
    assert advice_text(axes, allowed=lambda d: np.zeros(len(d), dtype=bool)) == ""


@pytest.mark.parametrize(("axis", "end"), [(0, "left"), (1, "upper"), (2, "nearer")])
def test_the_end_of_the_shaft_is_named_as_it_is_seen(axis, end):
    axes = np.roll(cone_directions(12, 3.0), axis - 2, axis=1)
    assert f"its {end} end goes" in advice_text(axes, camera="left")
